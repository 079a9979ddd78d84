"""Inverse problem: strike, load or Young's modulus of a scene from a measured trace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares

from ...chain.materials import Material
from ...errors import InputError, shown
from ...scene.excitation import Impulse
from ...scene.scene import Scene
from ...trajectory.trajectory import Trajectory
from ...util.arrays import Array
from ...util.notebook import Shown
from ...util.plotting import axes_in_units, legend, set_title
from ..bodies import motion
from ..contact import sensor

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Field = Literal["velocity", "displacement", "force"]
Parameter = Literal["velocity", "top_load", "youngs_modulus"]
UNITS = {
    "velocity": "m/s",
    "displacement": "m",
    "force": "N",
    "top_load": "N",
    "youngs_modulus": "Pa",
}
TRIES = 9  # values tried for the start of the fit
STEP = 1e-3  # relative, for finite differences: far above the noise that a tolerance leaves
DRAWN = 4  # traces in a picture


@dataclass(frozen=True, eq=False)
class Trace:
    """A measured trace: velocity, displacement or force of some grains over time.

    Parameters
    ----------
    time : (T,) array
        Increasing, from 0 (the strike) or later, s.
    grain : int or (G,) sequence
    values : (T,) or (T, G) array
        m/s, m or N, velocity and displacement positive downward.
    field : "velocity", "displacement" or "force"
        A force is what a sensor in the grain shows above that at rest: the mean of its two
        contacts, N.

    Raises
    ------
    InputError
        With every fault found.
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
        try:
            clock = np.array(time, float)
            rows = np.array(values, float)
            numbers = np.atleast_1d(np.array(grain))
        except (TypeError, ValueError):
            raise InputError.at("values", "time and values must be numbers, without gaps") from None
        rows = rows[:, None] if rows.ndim == 1 else rows
        faults = []
        if field not in get_args(Field):
            faults.append(
                ("field", f"must be one of {', '.join(get_args(Field))} (got {shown(field)})")
            )
        increasing = (
            clock.ndim == 1
            and clock.size > 2
            and np.isfinite(clock).all()
            and np.diff(clock).min() > 0
        )
        if not increasing or clock[0] < 0:
            faults.append(
                (
                    "time",
                    "must be three or more finite times, 0 or later, each above the one before",
                )
            )
        if (
            not np.issubdtype(numbers.dtype, np.integer)
            or numbers.ndim != 1
            or np.unique(numbers).size < numbers.size
        ):
            faults.append(("grain", "must be the number of a grain, or a list of different ones"))
        if rows.shape != (clock.size, numbers.size):
            shape = f"({clock.size}, {numbers.size})"
            faults.append(
                (
                    "values",
                    f"must have one row a time and one column a grain, {shape}, not {rows.shape}",
                )
            )
        elif not np.isfinite(rows).all() or not rows.any():
            faults.append(
                ("values", "must be finite, and not all 0: leave out what was not measured")
            )
        if faults:
            raise InputError(faults)
        for key, value in {"time": clock, "grain": numbers, "values": rows, "field": field}.items():
            object.__setattr__(self, key, value)

    @classmethod
    def of(
        cls, trajectory: Trajectory, grains: Sequence[int] | None = None, field: Field = "velocity"
    ) -> Trace:
        """Return the trace of some grains of a trajectory; by default of all recorded ones that move."""
        if grains is None:
            grains = [int(n) for n in trajectory.grains if n <= trajectory.scene.chain.movable]
        return cls(trajectory.time, grains, _seen(trajectory, np.array(grains), field), field)


@dataclass(frozen=True, eq=False, repr=False)
class ParameterFit(Shown):
    """A parameter of a scene, fitted to a trace.

    Attributes
    ----------
    parameter : str
    value, error : float
        m/s, N or Pa; one standard error, which assumes independent residuals, as of noise.
    trace : Trace
    model : (T, G) array
        What the scene with this value gives, in the units of the trace.
    residual : float
        Root mean square of trace - model over that of the trace.
    scene : Scene
        With this value.
    runs : int
        Of the engine.
    """

    parameter: Parameter
    value: float
    error: float
    trace: Trace
    model: Array
    residual: float
    scene: Scene
    runs: int

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw some of the traces as points and the fit as lines; returns the axes."""
        from matplotlib.ticker import EngFormatter

        trace = self.trace
        ax = axes_in_units(ax, "s", UNITS[trace.field])
        for i in np.unique(np.linspace(0, trace.grain.size - 1, DRAWN).round().astype(int)):
            (points,) = ax.plot(
                trace.time, trace.values[:, i], ".", markersize=4, label=f"grain {trace.grain[i]}"
            )
            ax.plot(trace.time, self.model[:, i], color=points.get_color(), lw=1)
        ax.set(
            xlabel="time",
            ylabel="force above rest" if trace.field == "force" else f"{trace.field}, downward",
        )
        shown = EngFormatter(UNITS[self.parameter], places=4)
        name = self.parameter.replace("_", " ").replace("youngs", "Young's")
        title = (
            f"{name} {shown(self.value)} ± "
            f"{EngFormatter(UNITS[self.parameter], places=1)(self.error)} (lines)"
        )
        set_title(ax, title)
        legend(ax)
        return ax


def fit_parameter(
    trace: Trace | Trajectory,
    scene: Scene,
    parameter: Parameter,
    simulate: Callable[[Scene], Trajectory],
    span: float = 2.0,
) -> ParameterFit:
    """Fit the strike velocity, top load or Young's modulus of a scene to a trace.

    Nine values between 1/span and span times that of the scene are tried, then least squares
    continues from the best; the solution may lie 2 span away. An oscillation can be matched a
    period too early or late: start near, or include the arrival of the wave in the trace.

    Parameters
    ----------
    trace : Trace or Trajectory
        Of a trajectory, the velocities of all recorded grains are taken; see `Trace.of`. It begins
        with the strike.
    scene : Scene
        Everything else that is known; its recording is not used.
    parameter : "velocity", "top_load" or "youngs_modulus"
        Of an impulse, of the chain, of its material (not that of impurities and walls with one of
        their own).
    simulate : callable
        Solver of a scene: `lmpchain.simulate`, or with an engine of your choice
        ``functools.partial(lmpchain.simulate, engine="native", tolerance=1e-9)``.
    span : float
        Above 1; a span of 1 begins with the value of the scene and tries no others.

    Returns
    -------
    ParameterFit

    Raises
    ------
    InputError
        If the scene has no such parameter, lacks a grain of the trace, or the trace does not depend
        on it.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=12, diameter=1e-3)
    >>> seen = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=8e-4), duration=2e-5, samples=41)
    >>> guess = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=2e-5)
    >>> trace = Trace.of(lmpchain.simulate(seen, engine="native", tolerance=1e-9), grains=[5])
    >>> fit = fit_parameter(trace, guess, "velocity", lmpchain.simulate)
    >>> f"{fit.value:.5e} m/s"
    '8.00000e-04 m/s'
    """
    trace = trace if isinstance(trace, Trace) else Trace.of(trace)
    first, make = _parameter(scene, parameter, trace, span)
    scale = float(np.sqrt(np.mean(trace.values**2)))
    runs = 0

    def model(x: float) -> Array:
        nonlocal runs
        runs += 1
        return _answer(make(first * float(x)), trace, simulate)

    def off(x: Array) -> Array:
        return ((model(x[0]) - trace.values) / scale).ravel()

    tries = np.geomspace(1 / span, span, TRIES) if span > 1 else np.ones(1)
    misfit = []
    faults = []
    for x in tries:
        try:
            misfit.append(float(np.sum(off(np.array([x])) ** 2)))
        except InputError as error:  # such as a load that crushes the grains
            misfit.append(np.inf)
            faults = error.faults
    if not np.isfinite(misfit).any():
        raise InputError(
            faults
            or [("simulate", "gives nothing that is finite: choose another value to begin with")]
        )
    start = tries[int(np.argmin(misfit))]
    bounds = (start / (2 * span), start * 2 * span)
    solution = least_squares(
        off,
        [start],
        jac="3-point",
        diff_step=STEP,
        bounds=bounds,
        x_scale=[start],
        xtol=1e-12,
        ftol=1e-15,
        gtol=1e-15,
    )
    x = float(solution.x[0])
    slope = float(np.linalg.norm(solution.jac))
    if slope < 1e-9:
        raise InputError.at(
            parameter, "the trace does not depend on it: choose another parameter or another grain"
        )
    if min(x / bounds[0], bounds[1] / x) < 1 + 1e-6:
        ends = [first * x for x in bounds]
        cure = "start from a value closer to the true one, or use a larger span"
        raise InputError.at(
            parameter, f"no value between {ends[0]:.4g} and {ends[1]:.4g} fits: {cure}"
        )
    spread = float(np.sqrt(2 * solution.cost / (trace.values.size - 1)) / slope)
    fitted = trace.values + scale * solution.fun.reshape(trace.values.shape)
    return ParameterFit(
        parameter=parameter,
        value=first * x,
        error=abs(first) * spread,
        trace=trace,
        model=fitted,
        residual=float(np.sqrt(2 * solution.cost / trace.values.size)),
        scene=make(first * x),
        runs=runs,
    )


def _parameter(
    scene: Scene, parameter: Parameter, trace: Trace, span: float
) -> tuple[float, Callable[[float], Scene]]:
    """Return the value of the parameter in the scene, and a function that replaces it."""
    chain = scene.chain
    given = scene.excitation
    faults = []
    value = 0.0
    if parameter == "velocity" and isinstance(given, Impulse):
        value = given.velocity
    elif parameter == "velocity":
        faults.append(("excitation", "only an impulse has a velocity to fit: give the scene one"))
    elif parameter == "top_load":
        value = chain.top_load
    elif parameter != "youngs_modulus":
        known = ", ".join(get_args(Parameter))
        raise InputError.at("parameter", f"must be one of {known} (got {shown(parameter)})")
    elif not isinstance(chain.material, Material):
        faults.append(
            ("material", "the grains have materials of their own: give the chain one for all")
        )
    elif chain.given().get("contact_constants") is not None:
        faults.append(
            (
                "contact_constants",
                "are given, so that Young's modulus changes nothing: leave them out",
            )
        )
    else:
        value = chain.material.youngs_modulus
    if not value and not faults:
        faults.append(
            (parameter, "is 0 in the scene: give it a value of the right size to begin with")
        )
    if not np.isfinite(span) or span < 1:
        faults.append(("span", f"must be 1 or more (got {shown(span)})"))
    if trace.grain.min() < 1 or trace.grain.max() > chain.movable:
        faults.append(
            ("grain", f"the trace is of grain {trace.grain.max()}, but 1 to {chain.movable} move")
        )
    if faults:
        raise InputError(faults)
    near = np.unique(np.clip([trace.grain - 1, trace.grain, trace.grain + 1], 1, chain.grains))
    time = _times(scene, trace.time)
    recording = {"duration": float(time[-1]), "samples": time.size, "grains": near.tolist()}
    whole = {"chain": chain, "excitation": given} | recording
    return float(value), lambda x: Scene(**whole | _changed(scene, parameter, x))


def _changed(scene: Scene, parameter: Parameter, value: float) -> dict[str, Any]:
    """Return the part of the scene that has the parameter, with this value."""
    chain = scene.chain
    given = scene.excitation
    if parameter == "velocity":
        grain = given.grain  # type: ignore[attr-defined]
        return {"excitation": Impulse(velocity=value, grain=grain)}
    changed: dict[str, Any] = {"top_load": value}
    if parameter == "youngs_modulus":
        material = chain.material.replace(youngs_modulus=value)  # type: ignore[union-attr]
        changed = {"material": material}
    return {"chain": chain.replace(**changed)}


def _times(scene: Scene, wanted: Array) -> Array:
    """Return evenly spaced times from 0: those wanted, or close enough to interpolate between."""
    even = np.arange(wanted.size) * wanted[-1] / (wanted.size - 1)
    if np.abs(even - wanted).max() <= 1e-9 * wanted[-1]:
        return even
    edge = scene.chain.band_edge
    apart = min(0.1 / edge, wanted[-1] / 200) if edge else wanted[-1] / 2000
    return np.linspace(0, wanted[-1], int(np.ceil(wanted[-1] / apart)) + 1)


def _answer(scene: Scene, trace: Trace, simulate: Callable[[Scene], Trajectory]) -> Array:
    """Return the trace that the engine predicts, (T, G)."""
    trajectory = simulate(scene)
    seen = _seen(trajectory, trace.grain, trace.field)
    wanted = trace.time
    if len(seen) == wanted.size and np.abs(trajectory.time - wanted).max() <= 1e-9 * wanted[-1]:
        return seen
    return make_interp_spline(trajectory.time, seen, k=5)(wanted)


def _seen(trajectory: Trajectory, grains: np.ndarray, field: Field) -> Array:
    """Return a field of some grains, (T, G)."""
    if field == "force":
        return np.stack([sensor(trajectory, int(n)).change for n in grains], axis=1)
    if field not in get_args(Field):
        raise InputError.at(
            "field", f"must be one of {', '.join(get_args(Field))} (got {shown(field)})"
        )
    u, v = motion(trajectory, grains)
    return v if field == "velocity" else u
