"""A scene fitted to measured traces, and what is known of its parameters afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, RunFailed, ToleranceNotMet, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from .changes import changed
from .traces import Traces
from .unknowns import Problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BIAS = 0.05  # of a standard deviation: what the steps may add to an estimate
HALVINGS = 8


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted scene, and how well its parameters are known.

    Attributes
    ----------
    scene : Scene
    names : list of str
        Of the K numbers that were fitted.
    estimate : (K,) array
        A factor where entries of one parameter differ and change together, else in the unit of the parameter.
    covariance : (K, K) array
    chi_square : float
        Sum of squares of what is left, over the noise.
    freedom : int
        Measured values less K.
    values : dict
        Parameters of the scene by name.
    bias : (K,) array
        Estimated error of the estimate by the length of the steps.
    """

    scene: Scene
    names: list[str]
    estimate: Array
    covariance: Array
    chi_square: float
    freedom: int
    values: dict[str, Array]
    bias: Array
    _problem: Problem

    @property
    def error(self) -> Array:
        """Standard deviations, (K,)."""
        return np.sqrt(np.diag(self.covariance))

    def table(self) -> str:
        """Return the numbers as text, a line each."""
        from ..util.tables import align

        rows = [(name, f"{value:.8g}", f"+- {off:.2g}") for name, value, off in
                zip(self.names, self.estimate, self.error, strict=True)]  # fmt: skip
        return "\n".join([*align(rows), f"chi square: {self.chi_square:.5g} of {self.freedom}"])

    def profile(self, name: str, reach: float = 3.0, points: int = 13) -> tuple[Array, Array]:
        """Return values of one number, (points,), and how much chi square grows, others refitted.

        Parameters
        ----------
        name : str
            One of `names`.
        reach : float
            Standard deviations to either side.
        """
        if name not in self.names:
            raise InputError(
                [("name", f"must be one of {', '.join(self.names)} (got {shown(name)})")]
            )
        at, problem = self.names.index(name), self._problem
        others = np.arange(self.estimate.size) != at
        offsets, growth = np.linspace(-reach, reach, points), np.zeros(points)
        along = self.covariance[:, at] / self.covariance[at, at]
        for k, offset in enumerate(offsets * self.error[at]):
            theta = problem.free(self.estimate + along * offset)

            def whole(rest: Array, theta: Array = theta) -> Array:
                together = theta.copy()
                together[others] = rest
                return together

            if others.any():
                theta = whole(problem.least(theta[others], whole, others))
            growth[k] = (
                problem.residuals(theta)[0] ** 2
            ).sum() / problem.variance - self.chi_square
        return self.estimate[at] + offsets * self.error[at], growth

    def posterior(self, samples: int = 10000, walkers: int = 32, seed: int = 0) -> Array:
        """Return draws (S, K) from the posterior with flat priors, by the sampler of `emcee`.

        Foreman-Mackey, Hogg, Lang, Goodman, Publ. Astron. Soc. Pacific 125, 306 (2013); it must be installed.
        """
        try:
            import emcee
        except ImportError as error:
            raise InputError([("posterior", "needs emcee: pip install emcee")]) from error
        rng = np.random.default_rng(seed)
        count, problem = self.estimate.size, self._problem
        walkers = max(walkers, 2 * count + 2)

        def log_probability(estimate: Array) -> float:
            try:
                return (
                    -0.5
                    * float((problem.residuals(problem.free(estimate))[0] ** 2).sum())
                    / problem.variance
                )
            except (InputError, RunFailed):
                return -np.inf

        sampler = emcee.EnsembleSampler(walkers, count, log_probability)
        sampler.random_state = np.random.RandomState(seed).get_state()
        start = rng.multivariate_normal(self.estimate, self.covariance, walkers)
        steps = -(-samples // walkers)
        state = sampler.run_mcmc(start, max(50, steps // 10))
        sampler.reset()
        sampler.run_mcmc(state, steps)
        return np.asarray(sampler.get_chain(flat=True))[:samples]

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw what was measured and what the fitted scene says; returns the axes."""
        from ..util.plotting import COLOURS, axes_in_units, legend

        ax = axes_in_units(ax, "s", "")
        colours = list(COLOURS.values())
        column = 0
        for traces, said in zip(
            self._problem.traces,
            self._problem.predicted(self._problem.free(self.estimate)),
            strict=True,
        ):
            for place, measured, line in zip(traces.places, traces.values.T, said.T, strict=True):
                colour = colours[column % len(colours)]
                ax.plot(traces.time, measured, ".", ms=2, color=colour, alpha=0.5)
                ax.plot(traces.time, line, color=colour, label=f"{traces.field} {place}")
                column += 1
        legend(ax)
        return ax


def _check_reach(scene: Scene, latest: float) -> None:
    """Raise `InputError` if the scene ends before the last value of a trace."""
    if latest > scene.duration * (1 + 1e-6):
        raise InputError(
            [("duration", f"of the scene must reach to the last value, {latest:.6g} s or more")]
        )


def fit(
    traces: Traces | Sequence[Traces], scene: Scene, parameters: Mapping[str, Any] | Sequence[str]
) -> Fit:
    """Return the scene that fits measured traces best, with the covariance of what was fitted.

    Gauss-Newton with exact Jacobians, from the tangent of the native integrator along each unknown number. Steps are
    halved until they add less than a twentieth of a standard deviation to every estimate.

    Parameters
    ----------
    traces : Traces, or several
    scene : Scene
        With a guess of the parameters, and long enough for the traces.
    parameters : mapping, or names
        By a name that `gradient` knows: "common", one factor for all entries, which a name alone means; "each"; or the
        numbers of entries, from 1.

    Returns
    -------
    Fit
        Its `estimate` and `covariance`, `scene` and `values`.

    Raises
    ------
    InputError
        If traces, scene and parameters do not fit together, or the traces do not tell the parameters apart.
    ToleranceNotMet
        If halving steps does not help any more.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse, Scene, simulate
    >>> chain = Chain(grains=8, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=3e-5, samples=61)
    >>> run = simulate(scene, tolerance=1e-8)
    >>> measured = Traces(run.time, [4], run.velocity[:, [3]])
    >>> guess = scene.replace(excitation=Impulse(velocity=1.1e-3))
    >>> round(float(fit(measured, guess, ["velocity"]).estimate[0]), 9)
    0.001
    """
    given: list[Any] = list(traces) if isinstance(traces, list | tuple) else [traces]
    if not given or not all(isinstance(one, Traces) for one in given):
        raise InputError([("traces", f"must be Traces, or several (got {shown(traces)})")])
    names = [parameters] if isinstance(parameters, str) else parameters
    wanted = dict(names) if isinstance(names, Mapping) else dict.fromkeys(names, "common")
    _check_reach(scene, max((one.time[-1] for one in given if not one.trigger), default=0.0))
    problem = Problem(scene, given, wanted)
    theta = np.zeros(len(problem.names))
    for _ in range(HALVINGS):
        theta = problem.least(theta, lambda rest: rest, slice(None))
        left, jacobian = problem.residuals(theta, True)
        scale = np.linalg.norm(jacobian, axis=0)
        if not (scale > 0).all() or np.linalg.cond(jacobian / scale) > 1e10:
            raise InputError(
                [("parameters", "the traces do not tell these apart: fit fewer of them")]
            )
        inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale)) / np.outer(scale, scale)
        freedom = left.size - theta.size
        square = float(left @ left)
        known = all(one.noise is not None for one in given)
        problem.variance = 1.0 if known else max(square, np.finfo(float).tiny) / max(freedom, 1)
        covariance = problem.variance * inverse
        problem.looks *= 2
        finer = problem.residuals(theta)[0]
        problem.looks //= 2
        bias = inverse @ jacobian.T @ (finer - left)
        if (np.abs(bias) <= BIAS * np.sqrt(np.diag(covariance)) + 1e-9).all():
            break
        problem.looks *= 2
    else:
        raise ToleranceNotMet(
            "the steps change the estimates however short they are: use a shorter time"
        )
    for one, name in (
        (one, name) for name in problem.names for one in given if name.startswith("trigger")
    ):
        _check_reach(scene, one.time[-1] - problem.estimates(theta)[problem.names.index(name)])
    units = np.array(problem.units)
    values = problem.by_name(theta)
    return Fit(
        changed(scene, values), problem.names, problem.estimates(theta), covariance * np.outer(units, units),
        square / problem.variance, freedom, values, np.abs(bias) * np.abs(units), problem,
    )  # fmt: skip
