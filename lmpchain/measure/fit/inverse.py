"""Inverse problem: strike, load or Young's modulus of a scene from a measured trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from ...chain.materials import Material
from ...errors import InputError, shown
from ...scene.excitation import Impulse
from ...scene.scene import Scene
from ...trajectory.trajectory import Trajectory
from ...util.arrays import Array, numbers, whole_numbers
from ...util.notebook import Shown
from ...util.plotting import Axes, chart, choose_few, finish, with_error
from ...util.tables import counted
from ...util.tabular import NamedColumn, Tabular, number_columns
from ...util.units import FIELD_UNITS
from ..bodies import motion
from ..contact import sensor
from .table import Fitted, FittedNumber, round_to_error

Field = Literal["velocity", "displacement", "force"]
Parameter = Literal["velocity", "top_load", "youngs_modulus"]
UNITS_OF_TRACES = {
    "velocity": "m/s",
    "displacement": "m",
    "force": "N",
    "top_load": "N",
    "youngs_modulus": "Pa",
}


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Shown):
    """A measured trace: velocity, displacement or force of some grains over time.

    Parameters
    ----------
    time : (T,) array
        Increasing times since the strike, s.
    grain : int or (G,) sequence
        Numbers of the grains.
    values : (T,) or (T, G) array
        Measured values, m/s, m or N; velocities and displacements are positive downward.
    field : "velocity", "displacement" or "force"
        Measured quantity. The force is the signal of a sensor in the grain, `contact.sensor`: the
        mean of the two contact forces minus its value at rest.

    Raises
    ------
    InputError
        If an argument is not valid; the error lists every fault.
    """

    time: Array
    grain: np.ndarray
    values: Array
    field: Field

    def __init__(
        self,
        time: Any,
        grain: int | Sequence[int] | np.ndarray,
        values: Any,
        field: Field = "velocity",
    ):
        # Copies cannot be changed by the caller later.
        times = np.array(numbers(time, "time"))
        rows = np.array(numbers(values, "values"))
        grains = np.atleast_1d(whole_numbers(grain, "grain"))
        rows = rows[:, None] if rows.ndim == 1 else rows
        if faults := list(_trace_faults(times, grains, rows, field)):
            raise InputError(faults)
        for key, value in {"time": times, "grain": grains, "values": rows, "field": field}.items():
            object.__setattr__(self, key, value)

    @classmethod
    def of(
        cls, trajectory: Trajectory, grains: Sequence[int] | None = None, field: Field = "velocity"
    ) -> Trace:
        """Return the trace of grains of a trajectory; by default of all recorded moving grains.

        Raises
        ------
        InputError
            If a grain was not recorded.
        """
        if grains is None:
            grains = [int(n) for n in trajectory.grains if n <= trajectory.scene.chain.movable]
        chosen = np.atleast_1d(whole_numbers(grains, "grain"))
        if not chosen.size or not np.isin(chosen, trajectory.grains).all():
            raise InputError.at("grain", f"must be recorded grains (got {shown(grains)})")
        return cls(trajectory.time, chosen, _select(trajectory, chosen, field), field)


def _trace_faults(
    time: Array, grains: np.ndarray, values: Array, field: Any
) -> Iterator[tuple[str, str]]:
    """Yield the faults of a trace; values are (T, G)."""
    if field not in get_args(Field):
        yield "field", f"must be one of {', '.join(get_args(Field))} (got {shown(field)})"
    finite = time.ndim == 1 and time.size > 2 and np.isfinite(time).all()
    if not finite or time[0] < 0 or np.diff(time).min() <= 0:
        yield "time", "must be three or more finite times that increase from 0 or later"
    if grains.ndim != 1 or np.unique(grains).size < grains.size:
        yield "grain", "must be the number of a grain, or a list of different numbers"
    if values.shape != (time.size, grains.size):
        shape = f"({time.size}, {grains.size}), not {values.shape}"
        yield "values", f"must have one row per time and one column per grain, {shape}"
    elif not np.isfinite(values).all() or not values.any():
        yield "values", "must be finite, and not all 0: leave out what was not measured"


@dataclass(frozen=True, eq=False, repr=False)
class ParameterFit(Fitted, Tabular):
    """A parameter of a scene, fitted to a trace.

    Attributes
    ----------
    parameter : str
        Name of the parameter.
    value : float
        Fitted value, m/s, N or Pa.
    error : float
        Standard error in the same unit, which assumes independent residuals such as noise.
    trace : Trace
        Trace that was fitted.
    model : (T, G) array
        Values in the scene with the fitted parameter, in the units of the trace.
    residual : float
        Root mean square of trace - model relative to the root mean square of the trace.
    scene : Scene
        Scene with the fitted parameter.
    runs : int
        Number of runs of the engine.
    """

    parameter: Parameter
    value: float
    error: float
    trace: Trace
    model: Array
    residual: float
    scene: Scene
    runs: int

    def __repr__(self) -> str:
        """Return the parameter with its error, and the relative residual of the trace."""
        unit = UNITS_OF_TRACES[self.parameter]
        value = f"{round_to_error(self.value, self.error)} ± {self.error:.1g} {unit}"
        left = f"residual {self.residual:.1g}, {counted(self.runs, 'run')}"
        return f"ParameterFit({self.parameter} = {value}, {left})"

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the parameter, and the relative residual of the trace."""
        unit = UNITS_OF_TRACES[self.parameter]
        yield FittedNumber("parameter", self.parameter, self.value, self.error, unit=unit)
        yield FittedNumber("parameter", "residual", self.residual, expected=0.0)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw some of the traces as points and the fit as lines; return the axes."""
        trace = self.trace
        field = "force above rest" if trace.field == "force" else f"{trace.field}, downward"
        ax = chart(ax, "time [s]", f"{field} [{UNITS_OF_TRACES[trace.field]}]")
        for i in choose_few(trace.grain.size):
            label = f"grain {trace.grain[i]}"
            (points,) = ax.plot(trace.time, trace.values[:, i], ".", markersize=4, label=label)
            ax.plot(trace.time, self.model[:, i], color=points.get_color(), lw=1)
        unit = UNITS_OF_TRACES[self.parameter]
        name = self.parameter.replace("_", " ").replace("youngs", "Young's")
        title = f"{name} {with_error(self.value, self.error, unit)} (lines)"
        return finish(ax, title)

    def _columns(self) -> Iterator[NamedColumn]:
        trace = self.trace
        unit = FIELD_UNITS[trace.field]
        grains = np.atleast_1d(trace.grain)
        shape = len(trace.time), grains.size
        yield NamedColumn("time", "s", trace.time)
        yield from number_columns(trace.field, unit, grains, np.reshape(trace.values, shape))
        yield from number_columns(
            f"{trace.field}_fitted", unit, grains, np.reshape(self.model, shape)
        )


def fit_parameter(
    trace: Trace | Trajectory,
    scene: Scene,
    parameter: Parameter,
    simulate: Callable[[Scene], Trajectory],
    span: float = 2.0,
) -> ParameterFit:
    """Fit the strike velocity, top load or Young's modulus of a scene to a trace.

    Nine values from 1/span to span times the value of the scene are tried. A least-squares fit then
    starts from the best value and may change it by a factor of up to 2 span. The fit of an
    oscillation can be off by a period, so start near the solution, or include the arrival of the
    wave in the trace.

    Parameters
    ----------
    trace : Trace or Trajectory
        Measured trace, whose times count from the strike. For a trajectory, the velocities of all
        recorded moving grains are fitted; see `Trace.of`.
    scene : Scene
        Scene with all other parameters; its duration, samples and recorded grains are not used.
    parameter : "velocity", "top_load" or "youngs_modulus"
        Velocity of an impulse, top load of the chain, or Young's modulus of its material.
        Impurities and walls with their own material keep their modulus.
    simulate : callable
        Function that solves a scene: `lmpchain.simulate`, or for a certain engine
        ``functools.partial(lmpchain.simulate, engine="native", tolerance=1e-9)``.
    span : float
        Range of the values that are tried, 1 or more; with 1, only the value of the scene is tried.

    Returns
    -------
    ParameterFit

    Raises
    ------
    InputError
        If the scene does not have the parameter or a grain of the trace, the trace does not depend
        on the parameter, or no value in the range fits.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=12, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=8e-4)
    >>> true = lmpchain.Scene(chain=chain, excitation=strike, duration=2e-5, samples=41)
    >>> guess = true.replace(excitation=lmpchain.Impulse(velocity=1e-3))
    >>> trace = Trace.of(lmpchain.simulate(true, engine="native", tolerance=1e-9), grains=[5])
    >>> fit = fit_parameter(trace, guess, "velocity", lmpchain.simulate)
    >>> f"{fit.value:.5e} m/s"
    '8.00000e-04 m/s'
    """
    trace = trace if isinstance(trace, Trace) else Trace.of(trace)
    first, make = _parameter(scene, parameter, trace, span)
    scale = float(np.sqrt(np.mean(trace.values**2)))
    runs = 0

    def residuals(x: Array) -> Array:
        nonlocal runs
        runs += 1
        predicted = _predict(make(first * float(x[0])), trace, simulate)
        return ((predicted - trace.values) / scale).ravel()

    start = _find_start(residuals, np.geomspace(1 / span, span, 9) if span > 1 else np.ones(1))
    bounds = (start / (2 * span), start * 2 * span)
    solution = least_squares(
        residuals,
        [start],
        jac="3-point",
        diff_step=1e-3,  # This step is far above the noise that a tolerance leaves.
        bounds=bounds,
        x_scale=[start],
        xtol=1e-12,
        ftol=1e-15,
        gtol=1e-15,
    )
    x = float(solution.x[0])
    slope = float(np.linalg.norm(solution.jac))
    # A parameter without effect would be fitted to rounding errors.
    if slope < 1e-9:
        raise InputError.at(
            parameter, "the trace does not depend on it: choose another parameter or another grain"
        )
    if min(x / bounds[0], bounds[1] / x) < 1 + 1e-6:
        cure = "start from a value closer to the true one, or use a larger span"
        ends = f"{first * bounds[0]:.4g} and {first * bounds[1]:.4g}"
        raise InputError.at(parameter, f"no value between {ends} fits: {cure}")
    deviation = float(np.sqrt(2 * solution.cost / (trace.values.size - 1)) / slope)
    return ParameterFit(
        parameter=parameter,
        value=first * x,
        error=abs(first) * deviation,
        trace=trace,
        model=trace.values + scale * solution.fun.reshape(trace.values.shape),
        residual=float(np.sqrt(2 * solution.cost / trace.values.size)),
        scene=make(first * x),
        runs=runs,
    )


def _find_start(residuals: Callable[[Array], Array], values: Array) -> float:
    """Return the value with the smallest residuals; raise `InputError` without any."""
    misfits = []
    faults = [("simulate", "returns no finite values: start from another value of the parameter")]
    for value in values:
        try:
            misfits.append(float(np.sum(residuals(np.array([value])) ** 2)))
        except InputError as error:
            # A large load may crush the grains.
            misfits.append(np.inf)
            faults = error.faults
    if not np.isfinite(misfits).any():
        raise InputError(faults)
    return float(values[int(np.argmin(misfits))])


def _parameter(
    scene: Scene, parameter: Parameter, trace: Trace, span: float
) -> tuple[float, Callable[[float], Scene]]:
    """Return the parameter's value in the scene, and a function that replaces the value."""
    chain = scene.chain
    if parameter not in get_args(Parameter):
        names = ", ".join(get_args(Parameter))
        raise InputError.at("parameter", f"must be one of {names} (got {shown(parameter)})")
    value = 0.0
    faults = list(_parameter_faults(scene, parameter))
    if not faults:
        holders: dict[str, Any] = {
            "velocity": scene.excitation,
            "top_load": chain,
            "youngs_modulus": chain.material,
        }
        value = getattr(holders[parameter], parameter)
        if not value:
            cure = "start from a value of the right order of magnitude"
            faults.append((parameter, f"is 0 in the scene: {cure}"))
    if not np.isfinite(span) or span < 1:
        faults.append(("span", f"must be 1 or more (got {shown(span)})"))
    if trace.grain.min() < 1 or trace.grain.max() > chain.movable:
        faults.append(
            (
                "grain",
                f"the trace has grain {trace.grain.max()}, but only 1 to {chain.movable} move",
            )
        )
    if faults:
        raise InputError(faults)
    # The force on a grain also needs the motion of its neighbours.
    near = np.unique(np.clip([trace.grain - 1, trace.grain, trace.grain + 1], 1, chain.grains))
    time = _times(scene, trace.time)
    recording = {"duration": float(time[-1]), "samples": time.size, "grains": near.tolist()}
    fields = {"chain": chain, "excitation": scene.excitation} | recording
    return float(value), lambda x: Scene(**fields | _change(scene, parameter, x))


def _parameter_faults(scene: Scene, parameter: Parameter) -> Iterator[tuple[str, str]]:
    """Yield the reasons why a scene lacks the parameter."""
    if parameter == "velocity" and not isinstance(scene.excitation, Impulse):
        yield "excitation", "only an impulse has a velocity to fit: give the scene an impulse"
    if parameter == "youngs_modulus":
        if not isinstance(scene.chain.material, Material):
            yield (
                "material",
                "the grains have different materials: give the chain a single material",
            )
        elif scene.chain.given().get("contact_constants") is not None:
            fault = "are given, so that Young's modulus changes nothing: leave them out"
            yield "contact_constants", fault


def _change(scene: Scene, parameter: Parameter, value: float) -> dict[str, Any]:
    """Return the changed field of the scene for this value of the parameter."""
    if parameter == "velocity":
        return {"excitation": scene.excitation.replace(velocity=value)}
    if parameter == "top_load":
        return {"chain": scene.chain.replace(top_load=value)}
    material: Any = scene.chain.material
    return {"chain": scene.chain.replace(material=material.replace(youngs_modulus=value))}


def _times(scene: Scene, times: Array) -> Array:
    """Return evenly spaced times from 0: the given ones, or times fine enough to interpolate."""
    even = np.arange(times.size) * times[-1] / (times.size - 1)
    if np.abs(even - times).max() <= 1e-9 * times[-1]:
        return even
    edge = scene.chain.band_edge
    # With 60 samples a period of the fastest wave, quintic splines are exact to rounding errors.
    interval = min(0.1 / edge, times[-1] / 200) if edge else times[-1] / 2000
    return np.linspace(0, times[-1], int(np.ceil(times[-1] / interval)) + 1)


def _predict(scene: Scene, trace: Trace, simulate: Callable[[Scene], Trajectory]) -> Array:
    """Return the trace that the engine predicts, (T, G)."""
    trajectory = simulate(scene)
    values = _select(trajectory, trace.grain, trace.field)
    times = trace.time
    if len(values) == times.size and np.abs(trajectory.time - times).max() <= 1e-9 * times[-1]:
        return values
    return make_interp_spline(trajectory.time, values, k=5)(times)


def _select(trajectory: Trajectory, grains: np.ndarray, field: Field) -> Array:
    """Return a field of some grains, (T, G)."""
    if field == "force":
        return np.stack([sensor(trajectory, int(n)).change for n in grains], axis=1)
    if field not in get_args(Field):
        names = ", ".join(get_args(Field))
        raise InputError.at("field", f"must be one of {names} (got {shown(field)})")
    u, v = motion(trajectory, grains)
    return v if field == "velocity" else u
