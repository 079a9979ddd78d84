"""A scene fitted to measured traces, by exact derivatives, with what is known of its parameters afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, RunFailed, ToleranceNotMet, shown
from ..integrators.adjoint import DifferentiableRun, Inputs
from ..integrators.splittings import SPLITTINGS
from ..scene.scene import Scene
from ..util.arrays import Array
from . import parameters as params
from .changes import changed
from .traces import Traces, model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TURN = 0.5  # of the fastest motion in a step of rkn4 at first, through all of which quintic splines go, rad
BIAS = 0.05  # of a standard deviation: what the steps may add to an estimate
HALVINGS = 8
SIGNED = ("displacement", "velocity", "drive", "force", "amplitude")  # what may change its sign
LEAST = 0.9  # by how much anything else may become less, of itself


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
    _problem: _Problem

    @property
    def error(self) -> Array:
        """Standard deviations, (K,)."""
        return np.sqrt(np.diag(self.covariance))

    def table(self) -> str:
        """Return the numbers as text, a line each."""
        from ..util.tables import aligned

        rows = [(name, f"{value:.8g}", f"+- {off:.2g}") for name, value, off in
                zip(self.names, self.estimate, self.error, strict=True)]  # fmt: skip
        return "\n".join([*aligned(rows), f"chi square: {self.chi_square:.5g} of {self.freedom}"])

    def profile(self, name: str, reach: float = 3.0, points: int = 13) -> tuple[Array, Array]:
        """Return values of one number, (points,), and by how much chi square grows with all others fitted anew.

        Parameters
        ----------
        name : str
            One of `names`.
        reach : float
            Standard deviations to either side.
        """
        if name not in self.names:
            raise InputError([("name", f"must be one of {', '.join(self.names)} (got {shown(name)})")])
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
            growth[k] = (problem.residuals(theta)[0] ** 2).sum() / problem.variance - self.chi_square
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
                return -0.5 * float((problem.residuals(problem.free(estimate))[0] ** 2).sum()) / problem.variance
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
            self._problem.traces, self._problem.predicted(self._problem.free(self.estimate)), strict=True
        ):
            for place, measured, line in zip(traces.places, traces.values.T, said.T, strict=True):
                colour = colours[column % len(colours)]
                ax.plot(traces.time, measured, ".", ms=2, color=colour, alpha=0.5)
                ax.plot(traces.time, line, color=colour, label=f"{traces.field} {place}")
                column += 1
        legend(ax)
        return ax


class _Problem:
    """What is not known, as K relative changes, and the residuals that they leave."""

    def __init__(self, scene: Scene, traces: Sequence[Traces], parameters: Mapping[str, Any]):
        self.scene, self.traces, self.variance = scene, traces, 1.0
        self.names: list[str] = []
        self.units: list[float] = []  # of the estimates, in relative changes
        self.origin: list[float] = []
        self.along: list[tuple[str, Array]] = []
        for name in params.check(scene, parameters):
            self._add(name, params.values(scene, name), parameters[name])
        for number, one in enumerate(traces):
            suffix = f" {number + 1}" if len(traces) > 1 else ""
            span, size = one.time[-1] - one.time[0], float(np.abs(one.values).max()) or 1.0
            nuisance = [("trigger" + suffix, 0.0, span)] * one.trigger + [("gain" + suffix, 1.0, 1.0)] * one.gain
            places = [f"offset{suffix} {place}" for place in one.places] if one.offset else []
            for label, begin, unit in nuisance + [(label, 0.0, size) for label in places]:
                self.names.append(label)
                self.origin.append(begin)
                self.units.append(unit)
        self.looks = max(8, int(np.ceil(scene.duration * scene.highest_frequency / TURN)))
        self.grains = np.unique(np.concatenate([one.grains(scene) for one in traces]))

    def _add(self, name: str, base: Array, how: Any) -> None:
        if isinstance(how, str) and how == "common":
            if not base.any():
                raise InputError([(name, "is 0 everywhere, which no factor changes: name entries")])
            given = base[base != 0]
            one = bool((given == given[0]).all())
            self.names.append(name)
            self.origin.append(float(given[0]) if one else 1.0)
            self.units.append(float(given[0]) if one else 1.0)
            self.along.append((name, base))
            return
        entries = range(1, base.size + 1) if isinstance(how, str) and how == "each" else how
        if isinstance(entries, str) or not all(1 <= entry <= base.size for entry in entries):
            raise InputError([(name, f'must be "common", "each" or numbers from 1 to {base.size} (got {shown(how)})')])
        for entry in entries:
            unit = float(base[entry - 1]) or float(np.abs(base).max()) or 1.0
            self.names.append(f"{name} {entry}")
            self.origin.append(float(base[entry - 1]))
            self.units.append(unit)
            self.along.append((name, unit * (np.arange(base.size) == entry - 1)))

    def estimates(self, theta: Array) -> Array:
        """Return the numbers in their units."""
        return np.array(self.origin) + np.array(self.units) * theta

    def free(self, estimate: Array) -> Array:
        """Return the relative changes for numbers in their units."""
        return (estimate - np.array(self.origin)) / np.array(self.units)

    def by_name(self, theta: Array) -> dict[str, Array]:
        """Return the parameters of the scene."""
        made: dict[str, Array] = {}
        for change, (name, direction) in zip(theta, self.along, strict=False):
            made[name] = made.get(name, params.values(self.scene, name).astype(float)) + change * direction
        return made

    def _directions(self, scene: Scene) -> Inputs:
        """Return how all inputs change with each relative change of the scene."""
        parts = [params.push(scene, name, direction[None]) for name, direction in self.along]
        return Inputs(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def _said(self, theta: Array, derivatives: bool) -> list[tuple[Array, Array]]:
        """Return what the scene says of all traces, (T, G), and the derivatives, (K, T, G)."""
        from scipy.interpolate import make_interp_spline

        scene = changed(self.scene, self.by_name(theta))
        run = DifferentiableRun(scene, SPLITTINGS["rkn4"], scene.duration, self.looks, self.grains)
        if not np.isfinite(run.velocity).all():
            raise RunFailed(f"the motion breaks down with steps of {run.step:.3g} s")
        change = self._directions(scene) if derivatives and self.along else None
        moved = None if change is None else run.push(change)
        said, at = [], len(self.along)
        for one in self.traces:
            values, rates = model(scene, run, one, change, moved)
            together = np.concatenate((values[None], rates)).transpose(1, 0, 2)
            spline = make_interp_spline(run.time, together, k=5)
            late = theta[at] * self.units[at] if one.trigger else 0.0
            when = one.time - late
            inside = np.clip(when, 0.0, scene.duration)
            found = spline(inside)
            found[when < 0, 1:] = 0.0
            value, jacobian = found[:, 0], np.zeros((len(self.names), *found[:, 0].shape))
            if derivatives:
                jacobian[: len(self.along)] = found[:, 1:].transpose(1, 0, 2)
            rate = spline(inside, 1)[:, 0] * ((when > 0)[:, None])
            gain = 1.0
            if one.trigger:
                jacobian[at] = -rate * self.units[at]
                at += 1
            if one.gain:
                gain = 1.0 + theta[at]
                jacobian *= gain
                jacobian[at] = value
                at += 1
            value = gain * value
            if one.offset:
                for column in range(value.shape[1]):
                    value[:, column] += theta[at] * self.units[at]
                    jacobian[at, :, column] = self.units[at]
                    at += 1
            said.append((value, jacobian))
        return said

    def predicted(self, theta: Array) -> list[Array]:
        """Return what is expected in every trace, (T, G)."""
        return [value for value, _ in self._said(theta, False)]

    def residuals(self, theta: Array, derivatives: bool = False) -> tuple[Array, Array]:
        """Return all differences over the noise, (R,), and their derivatives, (R, K)."""
        left, rates = [], []
        for one, (value, jacobian) in zip(self.traces, self._said(theta, derivatives), strict=True):
            noise = 1.0 if one.noise is None else one.noise
            left.append(((value - one.values) / noise).ravel())
            rates.append((jacobian / noise).reshape(len(self.names), -1))
        return np.concatenate(left), np.concatenate(rates, axis=1).T

    def least(self, start: Array, whole: Any, free: Any) -> Array:
        """Return what leaves the least squares, by Gauss and Newton's steps within a trust region."""
        from scipy.optimize import least_squares

        positive = [name not in SIGNED for name, _ in self.along]
        lowest = np.full(len(self.names), -np.inf)
        lowest[: len(positive)][positive] = -LEAST
        return least_squares(
            lambda rest: self.residuals(whole(rest))[0], start,
            lambda rest: self.residuals(whole(rest), True)[1][:, free],
            x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100, bounds=(lowest[free], np.inf),
        ).x  # fmt: skip


def fit(traces: Traces | Sequence[Traces], scene: Scene, parameters: Mapping[str, Any] | Sequence[str]) -> Fit:
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
    given = [traces] if isinstance(traces, Traces) else list(traces)
    wanted = dict(parameters) if isinstance(parameters, Mapping) else dict.fromkeys(parameters, "common")
    problem = _Problem(scene, given, wanted)
    theta = np.zeros(len(problem.names))
    for _ in range(HALVINGS):
        theta = problem.least(theta, lambda rest: rest, slice(None))
        left, jacobian = problem.residuals(theta, True)
        scale = np.linalg.norm(jacobian, axis=0)
        if not (scale > 0).all() or np.linalg.cond(jacobian / scale) > 1e10:
            raise InputError([("parameters", "the traces do not tell these apart: fit fewer of them")])
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
        raise ToleranceNotMet("the steps change the estimates however short they are: use a shorter time")
    for one, name in ((one, name) for name in problem.names for one in given if name.startswith("trigger")):
        latest = one.time[-1] - problem.estimates(theta)[problem.names.index(name)]
        if latest > scene.duration * (1 + 1e-6):
            raise InputError([("duration", f"of the scene must reach to the last value, {latest:.6g} s or more")])
    units = np.array(problem.units)
    values = problem.by_name(theta)
    return Fit(
        changed(scene, values), problem.names, problem.estimates(theta), covariance * np.outer(units, units),
        square / problem.variance, freedom, values, np.abs(bias) * np.abs(units), problem,
    )  # fmt: skip
