"""Fits of scenes to measured traces, with the uncertainty of their parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, RunFailed, ToleranceNotMet, shown
from ..integrators.halving import SAFETY, HalvedAnswer, halve
from ..measure.fit.table import Fitted, FittedNumber
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array
from ..util.plotting import SHADES, Axes, chart, finish, letter_panels, panels, window
from ..util.tabular import NamedColumn, Tabular
from ..util.units import FIELD_UNITS
from ..util.validation import check_positive, check_whole
from .parameters import as_names, changed
from .traces import Traces
from .unknowns import NOTHING, Problem

NAMES_OF_TRACES = {
    "velocity": "velocity, downward",
    "displacement": "displacement, downward",
    "force": "force above rest",
    "contact": "force above rest",
}
BIAS = 0.05  # Largest error of an estimate by the time steps, in standard deviations.


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Fitted, Tabular):
    """A fitted scene with the uncertainty of its parameters.

    Attributes
    ----------
    scene : Scene
        The fitted scene.
    names : list of str
        Names of the K fitted parameters.
    estimate : (K,) array
        Fitted values. The value is a factor if different entries of a parameter change together;
        otherwise it has the unit of the parameter.
    covariance : (K, K) array
        Covariance of the estimate.
    chi_square : float
        Sum of the squared ratios of residual to noise.
    freedom : int
        Number of measured values minus K.
    values : dict
        Parameters of the scene by name.
    bias : (K,) array
        Estimated error of the estimate caused by the step length.
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
        """Standard deviations of the fitted parameters, (K,)."""
        return np.sqrt(np.diag(self.covariance))

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the fitted parameters with errors and units; factors have no unit."""
        symbols = self._problem.symbols
        for name, value, error, unit in zip(
            self.names, self.estimate.tolist(), self.error.tolist(), symbols, strict=True
        ):
            yield FittedNumber("traces", name, value, error, unit=unit)

    def notes(self) -> Iterator[str]:
        """Yield a sentence on the goodness of fit and the source of the noise level."""
        noise = "" if self._problem.noisy else "; the noise is estimated from the residuals"
        yield f"chi square: {self.chi_square:.5g} of {self.freedom}{noise}"

    def profile(self, name: str, reach: float = 3.0, points: int = 13) -> tuple[Array, Array]:
        """Return values of a parameter and the increases of chi square, with the others refitted.

        Parameters
        ----------
        name : str
            One of `names`.
        reach : float
            Largest distance from the estimate, in standard deviations.
        points : int
            Number of values.
        """
        if name not in self.names:
            message = f"must be one of {', '.join(self.names)} (got {shown(name)})"
            raise InputError.at("name", message)
        check_positive("reach", reach)
        check_whole("points", points, 1)
        problem = self._problem
        index = self.names.index(name)
        others = np.arange(self.estimate.size) != index
        # The other parameters start at their values in a linear model of the residuals.
        along = self.covariance[:, index] / self.covariance[index, index]
        offsets = np.linspace(-reach, reach, points) * self.error[index]
        growth = np.zeros(points)
        for k, offset in enumerate(offsets):
            theta = problem.free(self.estimate + along * offset)
            if others.any():
                theta = problem.minimise(theta, others)
            growth[k] = problem.chi_square(theta) - self.chi_square
        return self.estimate[index] + offsets, growth

    def posterior(self, samples: int = 10000, walkers: int = 32, seed: int = 0) -> Array:
        """Return samples (S, K) of the posterior with flat priors, drawn by `emcee`.

        The package `emcee` must be installed (D. Foreman-Mackey, D. W. Hogg, D. Lang and J.
        Goodman, Publ. Astron. Soc. Pacific 125, 306, 2013).
        """
        try:
            import emcee
        except ImportError as error:
            raise InputError.at("posterior", "needs emcee: pip install emcee") from error
        for key, value, low in (
            ("samples", samples, 1),
            ("walkers", walkers, 1),
            ("seed", seed, 0),
        ):
            check_whole(key, value, low)
        rng = np.random.default_rng(seed)
        problem = self._problem
        count = self.estimate.size
        walkers = max(walkers, 2 * count + 2)

        def log_probability(estimate: Array) -> float:
            # An invalid scene has probability 0.
            try:
                return -0.5 * problem.chi_square(problem.free(estimate))
            except (InputError, RunFailed):
                return -np.inf

        sampler = emcee.EnsembleSampler(walkers, count, log_probability)
        sampler.random_state = np.random.RandomState(seed).get_state()
        # Walkers start in the Gaussian of the linear error theory, so that hardly any samples are
        # discarded.
        start = rng.multivariate_normal(self.estimate, self.covariance, walkers)
        steps = -(-samples // walkers)
        state = sampler.run_mcmc(start, max(50, steps // 10))
        sampler.reset()
        sampler.run_mcmc(state, steps)
        return np.asarray(sampler.get_chain(flat=True))[:samples]

    def plot(self, ax: Axes | Sequence[Axes] | None = None) -> Axes | list[Axes]:
        """Plot measured and fitted values against time, and return the axes.

        Each unit of the traces has its own axes. If there are several units, `ax` may be a list of
        as many axes, and a list is returned.
        """
        problem = self._problem
        units = list(dict.fromkeys(FIELD_UNITS[trace.field] for trace in problem.traces))
        given = window().subplots(len(units), sharex=True) if ax is None else ax
        axes = panels(given)
        if len(axes) != len(units):
            raise InputError.at("ax", f"give {len(units)} axes, one for each of {units}")
        fitted = problem.predict(problem.free(self.estimate))
        for single, unit in zip(axes, units, strict=True):
            traces = [
                (trace, prediction)
                for trace, prediction in zip(problem.traces, fitted, strict=True)
                if FIELD_UNITS[trace.field] == unit
            ]
            fields = dict.fromkeys(NAMES_OF_TRACES[trace.field] for trace, _ in traces)
            chart(single, "time [s]", f"{' or '.join(fields)} [{unit}]")
            colours = cycle(SHADES)
            for trace, prediction in traces:
                for column, place in enumerate(trace.places):
                    colour = next(colours)
                    measured = trace.values[:, column]
                    single.plot(trace.time, measured, ".", ms=3, color=colour, alpha=0.5)
                    kind = "contact" if trace.field == "contact" else f"{trace.field} of grain"
                    label = f"{kind} {place}"
                    single.plot(trace.time, prediction[:, column], color=colour, label=label)
            finish(single)
        if ax is None:
            letter_panels(axes)
        return axes if len(axes) > 1 else axes[0]

    def _columns(self) -> Iterator[NamedColumn]:
        fitted = self._problem.predict(self._problem.free(self.estimate))
        # Traces may have different times, so each value has a row.
        rows = [
            (k, time, place, measured, prediction)
            for k, (traces, values) in enumerate(zip(self._problem.traces, fitted, strict=True), 1)
            for column, place in enumerate(traces.places)
            for time, measured, prediction in zip(
                traces.time, traces.values[:, column], values[:, column], strict=True
            )
        ]
        names = (("trace", ""), ("time", "s"), ("place", ""), ("measured", ""), ("fitted", ""))
        for (name, unit), values in zip(names, zip(*rows, strict=True), strict=True):
            yield NamedColumn(name, unit, np.array(values))


def _check_reach(scene: Scene, latest: float) -> None:
    """Raise `InputError` if the scene ends before the last value of a trace."""
    if latest > scene.duration * (1 + 1e-6):
        message = f"must reach the last value of the traces: use {latest:.6g} s or more"
        raise InputError.at("duration", message)


def _check_noise(traces: Sequence[Traces]) -> None:
    """Raise `InputError` unless the traces can be weighted by their noise."""
    units = {FIELD_UNITS[trace.field] for trace in traces}
    unknown = [trace.noise is None for trace in traces]
    if any(unknown) and len(units) > 1:
        reason = f"because squares of {' and '.join(sorted(units))} cannot be added"
        raise InputError.at("noise", f"must be given for each trace, {reason}")
    if any(unknown) and not all(unknown):
        reason = "because the traces are weighted by it"
        raise InputError.at("noise", f"must be given for each trace or for none, {reason}")


def fit(
    traces: Traces | Sequence[Traces], scene: Scene, parameters: Mapping[str, Any] | Sequence[str]
) -> Fit:
    """Fit a scene to measured traces; return it with the covariance of its parameters.

    The Gauss-Newton method is used with exact Jacobians, from the tangent of the native integrator
    along each unknown. With a law by formula or a ground, Jacobians are differences of native runs.
    Steps are halved until the step error of every estimate is below a twentieth of its standard
    deviation.

    Parameters
    ----------
    traces : Traces, or several
        Measured traces.
    scene : Scene
        Scene with a guess of the parameters, and with a duration that includes the traces.
    parameters : mapping, or names
        Unknowns by the parameter names of `gradient`: "common" is one factor for all entries,
        "each" makes every entry an unknown, and a list selects entries by number, from 1. A name
        alone means "common". Parameters of formulas, such as "chain.law.c", keep the sign of the
        guess.

    Returns
    -------
    Fit
        The fitted `scene` with `estimate`, `covariance` and `values`.

    Raises
    ------
    InputError
        If traces, scene and parameters do not fit together, if the traces cannot distinguish the
        parameters, or if a parameter falls to a tenth of its guess.
    ToleranceNotMet
        If the step error remains too large after several halvings of the steps.

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
    check_scene(scene)
    measured: list[Any] = list(traces) if isinstance(traces, list | tuple) else [traces]
    if not measured or not all(isinstance(trace, Traces) for trace in measured):
        raise InputError.at("traces", f"must be Traces, or several (got {shown(traces)})")
    _check_noise(measured)
    if isinstance(parameters, Mapping):
        choices = dict(parameters)
    else:
        choices = dict.fromkeys(as_names(parameters), "common")
    ends = [trace.time[-1] for trace in measured if not trace.trigger]
    _check_reach(scene, max(ends, default=0.0))
    problem = Problem(scene, measured, choices)
    first = problem.looks
    theta = np.zeros(len(problem.names))

    def attempt(halvings: int) -> HalvedAnswer[_Estimate]:
        nonlocal theta
        problem.looks = first * 2**halvings
        # Each fit starts from the estimate at longer steps, which is close.
        theta = problem.minimise(theta)
        estimate = _estimate(problem, theta)
        allowed = BIAS * np.sqrt(np.diag(estimate.covariance)) + 1e-9
        return HalvedAnswer(estimate, float((estimate.bias / allowed).max()))

    # At most eight attempts: no step suffices for chaos, and each halving doubles the cost.
    best, excess = halve(attempt, 8)
    if excess > 1:
        message = "the estimates depend on the time step even if it is short: fit a shorter time"
        raise ToleranceNotMet(message)
    # At its lower bound a parameter is not an estimate, unless it vanishes there.
    limited = (problem.lowest > NOTHING) & (theta < problem.lowest + 1e-6)
    if limited.any():
        name = problem.names[int(np.flatnonzero(limited)[0])]
        message = "the fit ends at a tenth of the guess: start from a smaller one"
        raise InputError.at(name, message)
    estimates = problem.estimates(theta)
    # The end of a trace in the scene is known only after the strike time is fitted.
    late = [trace.time[-1] for trace in measured if trace.trigger]
    strikes = [
        value
        for name, value in zip(problem.names, estimates, strict=True)
        if name.startswith("trigger")
    ]
    _check_reach(scene, max(np.subtract(late, strikes), default=0.0))
    units = np.array(problem.units)
    values = problem.by_name(theta)
    return Fit(
        scene=changed(scene, values),
        names=problem.names,
        estimate=estimates,
        covariance=best.covariance * np.outer(units, units),
        chi_square=best.square / problem.variance,
        freedom=best.freedom,
        values=values,
        bias=best.bias * np.abs(units),
        _problem=problem,
    )


class _Estimate(NamedTuple):
    """Uncertainty of the fitted relative changes (K,), and their error by the time steps (K,)."""

    covariance: Array
    square: float
    freedom: int
    bias: Array


def _estimate(problem: Problem, theta: Array) -> _Estimate:
    """Return the uncertainty of relative changes, and their error from a run at half the steps."""
    residuals, jacobian = problem.residuals(theta, True)
    scale = np.linalg.norm(jacobian, axis=0)
    if not (scale > 0).all() or np.linalg.cond(jacobian / scale) > 1e10:
        message = "the traces cannot distinguish these parameters: fit fewer of them"
        raise InputError.at("parameters", message)
    # Scaled columns keep the inverse accurate whatever the units of the unknowns are.
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale)) / np.outer(scale, scale)
    freedom = residuals.size - theta.size
    square = float(residuals @ residuals)
    # Noise that is not given is estimated from the residuals.
    if not problem.noisy:
        if freedom < 1:
            reason = f"{residuals.size} values do not show it beside {theta.size} unknowns"
            raise InputError.at("noise", f"must be given, because {reason}")
        problem.variance = max(square, np.finfo(float).tiny) / freedom
    problem.looks *= 2
    finer = problem.residuals(theta)[0]
    problem.looks //= 2
    bias = SAFETY * np.abs(inverse @ jacobian.T @ (finer - residuals))
    return _Estimate(problem.variance * inverse, square, freedom, bias)
