"""Where methods fail on a scene: what laws predict, what runs show, and where the scene itself lies.

`steps` (too long a step, drifting energy, openings), `precision` (round-off, chaos), `theories` (linear, homogeneous,
continuous chain), `limits`, `overlaps` and `horizons` hold the laws and what measures them. Maps over many
scenes are drawn by `analysis/stability_map.py`; this module goes through all of them for one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import engines
from ..chain import LARGEST_OVERLAP
from ..engines.methods import METHODS
from ..errors import EngineUnavailable, InputError, LmpchainError, ToleranceNotMet
from ..fields import Array
from ..scene import Scene
from ..tables import aligned, finite

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TOLERANCE = 1e-6  # of the horizon
RUNS = 60  # that a bisection takes
LONGEST_S = 20.0  # that one measurement may be expected to take
DIVISIONS = 40.0  # of the fastest oscillation by the step at which energies are compared
PERIODS = 1000.0  # for which they are
STRENGTHS = np.logspace(-8, 2, 11)  # of the strike, over its own
STRONG = {"velocity", "displacement", "amplitude"}  # what of an excitation is as strong as the strike


@dataclass(frozen=True)
class Boundary:
    """Where something fails; numbers are NaN where they are not known.

    Attributes
    ----------
    what : str
        "longest step", "smallest error" ...
    method : str
        Engine or integrator.
    unit : str
    predicted : float
        By a law.
    measured : float
        On this scene.
    here : float
        What the scene has; NaN where the user chooses.
    beyond : bool
        Whether the scene lies beyond the boundary.
    """

    what: str
    method: str
    unit: str
    predicted: float
    measured: float = math.nan
    here: float = math.nan
    beyond: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """What was measured along the way, for the picture.

    Attributes
    ----------
    panel : "energy", "growth" or "strength"
    name : str
    x, y : arrays
    """

    panel: str
    name: str
    x: Array
    y: Array


@dataclass(frozen=True, eq=False)
class Stability:
    """The boundaries of a scene.

    Attributes
    ----------
    scene : Scene
    boundaries : tuple of Boundary
    curves : tuple of Curve
    left_out : tuple of str
        What could not be measured, and why.
    """

    scene: Scene
    boundaries: tuple[Boundary, ...]
    curves: tuple[Curve, ...]
    left_out: tuple[str, ...]

    def table(self) -> str:
        """Return the boundaries as a table; what the scene lies beyond bears a mark."""
        rows: list[tuple[str, ...]] = [("", "", "", "predicted", "measured", "this scene")]
        for found in self.boundaries:
            numbers = (_shown(x, found.unit) for x in (found.predicted, found.measured, found.here))
            rows.append(("!" if found.beyond else "", found.what, found.method, *numbers))
        return "\n".join(aligned(rows))

    def to_json(self) -> dict[str, Any]:
        """Return what goes into a JSON file; numbers that are not finite become None."""
        rows = [finite(vars(found)) for found in self.boundaries]
        curves = [vars(curve) | {key: _list(getattr(curve, key)) for key in "xy"} for curve in self.curves]
        return {"rows": rows, "curves": curves, "left_out": list(self.left_out)}

    def plot(self, axes: Sequence[Axes] | None = None) -> Figure:
        """Draw the longest steps, energy and small changes over time, and errors over the strength of the strike.

        Parameters
        ----------
        axes : four axes, optional
            By default those of a new figure.
        """
        from .chart import draw

        return draw(self, axes)


def stability(scene: Scene, *, progress: bool = False) -> Stability:
    """Find where methods fail on a scene.

    What would take longer than some seconds to measure is predicted only.

    Parameters
    ----------
    scene : Scene
    progress : bool
        Whether to show a progress bar.
    """
    from tqdm.auto import tqdm

    boundaries: list[Boundary] = []
    curves: list[Curve] = []
    left_out: list[str] = []
    layout = "{desc}: {n_fmt} of {total_fmt} |{bar}| {elapsed}"
    with tqdm(list(_parts(scene)), disable=not progress, leave=False, bar_format=layout) as bar:
        for name, part in bar:
            bar.set_description(name)
            try:
                for found in part():
                    (boundaries if isinstance(found, Boundary) else curves).append(found)  # type: ignore[arg-type]
            except InputError as error:
                left_out.append(f"{name}: {error.faults[0][1]}")
            except ToleranceNotMet as error:
                left_out.append(f"{name}: {error.reason}")
            except (EngineUnavailable, LmpchainError) as error:
                left_out.append(f"{name}: {error}")
    return Stability(scene, tuple(boundaries), tuple(curves), tuple(left_out))


def _parts(scene: Scene) -> Iterator[tuple[str, Callable[[], Iterator[Boundary | Curve]]]]:
    """Return what there is to find out, by name."""
    for integrator in METHODS:
        yield f"longest step, {integrator}", partial(_step, scene, "native", integrator)
    yield "longest step, lammps", partial(_step, scene, "lammps", "verlet")
    for integrator in METHODS:
        yield f"energy, {integrator}", partial(_energy, scene, integrator)
    yield "smallest error, native", partial(_floor, scene, "native", "physical")
    for diameter in ("physical", "gauge"):
        yield f"smallest error, lammps, {diameter} diameter", partial(_floor, scene, "lammps", diameter)
    yield "predictable", partial(_horizon, scene)
    yield "linear theory", partial(_linear, scene)
    yield "overlap", partial(_overlap, scene)
    yield "strength", partial(_strength, scene)


def _step(scene: Scene, engine: str, integrator: str) -> Iterator[Boundary]:
    from .steps import blow_up, limit

    predicted = limit(scene, integrator)
    solver = engines.get(engine, integrator=integrator)
    cost = METHODS[integrator].evaluations * scene.duration / predicted * scene.chain.grains
    affordable = RUNS * cost * solver.seconds_per_grain_step < LONGEST_S  # type: ignore[attr-defined]
    measured = blow_up(scene, integrator, engine) if affordable and not solver.refuses(scene) else math.nan
    yield Boundary("longest step", f"{engine} {integrator}", "s", predicted, measured)


def _energy(scene: Scene, integrator: str) -> Iterator[Curve]:
    from .steps import energy_error

    if scene.drive:
        raise InputError([("kind", "a drive does work: the energy is not that of the start")])
    if not scene.chain.compressed:
        raise InputError([("gravity", "without gravity and load there is no period to count by")])
    step = 2 * math.pi / scene.highest_frequency / DIVISIONS  # far below every stability limit
    cost = METHODS[integrator].evaluations * PERIODS * DIVISIONS * scene.chain.grains
    if cost * engines.get("native").seconds_per_grain_step > LONGEST_S:  # type: ignore[attr-defined]
        raise InputError([("grains", "too many to follow the energy for a thousand periods")])
    found = energy_error(scene, integrator, step, PERIODS, samples=401)
    yield Curve("energy", integrator, found.time, np.abs(found.error))


def _floor(scene: Scene, engine: str, diameter: str) -> Iterator[Boundary]:
    from .precision import floor, measured_floor

    name = engine if engine == "native" else f"{engine}, {diameter} diameter"
    measured = math.nan if scene.drive or _too_long(scene) else measured_floor(scene, engine, diameter)
    yield Boundary("smallest error", name, "", floor(scene, engine, diameter), measured)


def _horizon(scene: Scene) -> Iterator[Boundary | Curve]:
    from .horizons import amplifies, predicted_horizon
    from .precision import growth, horizon_of

    predicted = predicted_horizon(scene, TOLERANCE) if amplifies(scene) else math.nan
    measured = math.nan
    if not _too_long(scene):
        times, apart = growth(scene)
        yield Curve("growth", "", times, apart)
        measured = horizon_of(times, apart, TOLERANCE)
    beyond = measured < scene.duration
    yield Boundary("predictable to 1e-6 until", "any", "s", predicted, measured, scene.duration, beyond)


def _linear(scene: Scene) -> Iterator[Boundary]:
    from .theories import strike_number_at

    engine = engines.Chebyshev()
    if reasons := engine.refuses(scene):
        raise InputError(reasons)
    for error in (0.01, 0.1):
        bound, number = strike_number_at(error, "package", scene.chain.exponent), scene.strike_number
        yield Boundary(
            f"linear theory {100 * error:g} % off at v0*", "Eq. (3)", "", bound, here=number, beyond=number > bound
        )


def _overlap(scene: Scene) -> Iterator[Boundary]:
    from .overlaps import deepest

    here = deepest(scene)
    beyond = LARGEST_OVERLAP < here < math.inf  # a drive has no bound
    yield Boundary("Hertz's law: overlap over diameter", "Eq. (1)", "", LARGEST_OVERLAP, here=here, beyond=beyond)


def _strength(scene: Scene) -> Iterator[Curve]:
    from .precision import floor

    linear, weaker = engines.Chebyshev(), [_times(scene, factor) for factor in STRENGTHS]
    if not linear.refuses(scene):
        found = [linear.look(s, linear.candidate(s, 0.9)).model_error for s in weaker]
        yield Curve("strength", "Eq. (3), bound", STRENGTHS, np.array(found))
    for engine, diameter in (("native", "physical"), ("lammps", "physical"), ("lammps", "gauge")):
        name = "native, round-off" if engine == "native" else f"lammps, {diameter} diameter, round-off"
        yield Curve("strength", name, STRENGTHS, np.array([floor(s, engine, diameter) for s in weaker]))


def _too_long(scene: Scene) -> bool:
    from ..reference import expected_seconds

    return expected_seconds(scene) > LONGEST_S


def _times(scene: Scene, factor: float) -> Scene:
    """Return the scene with a strike that is so many times as strong."""
    excitation = scene.excitation
    given = excitation.given()
    louder = {key: np.asarray(given[key]) * factor for key in STRONG & given.keys() if given[key] is not None}
    changed = type(excitation)(**given | {k: x if x.ndim else float(x) for k, x in louder.items()})
    return Scene(**scene.given() | {"excitation": changed})


def _shown(value: float, unit: str) -> str:
    if not math.isfinite(value):
        return "" if math.isnan(value) else "none"
    return f"{value:.3g} {unit}".rstrip()


def _list(values: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in values]
