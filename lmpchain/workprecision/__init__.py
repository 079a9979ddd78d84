"""Speed against accuracy: what every engine and integrator needs in time and force evaluations for an error."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import engines
from ..engines.methods import METHODS
from ..engines.stepping import SteppedEngine
from ..errors import EngineUnavailable, InputError
from ..reference import Reference, expected_seconds, reference
from ..scene import Scene
from ..tables import aligned, finite
from .bench import Bench, Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BUDGET_S = 60.0
LONGEST_S = 600.0  # for the reference
LOOSEST = 0.5  # tolerance: nothing is refused for it
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
WITHOUT = "{}, without the estimate"
Way = tuple[str, str, Callable[[Bench], Iterator[Point]]]  # engine, integrator, what measures them


@dataclass(frozen=True)
class Curve:
    """The points of one way to answer, from the cheapest on.

    Attributes
    ----------
    engine, integrator : str
        The latter is empty where the engine has none or chooses itself.
    points : tuple of Point
    """

    engine: str
    integrator: str
    points: tuple[Point, ...]

    @property
    def to_tolerance(self) -> bool:
        """Whether a tolerance was asked for, so that the engine chose the steps."""
        return self.points[0].tolerance is not None

    @property
    def name(self) -> str:
        """Engine, and integrator or "to a tolerance"."""
        return ", ".join(filter(None, (self.engine, "to a tolerance" if self.to_tolerance else self.integrator)))


@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """Speed against accuracy on one scene.

    Attributes
    ----------
    scene : Scene
    reference : Reference
    curves : tuple of Curve
    dropped : int
        Points left out because their error is below ten times that of the reference.
    left_out : tuple of str
        Engines that cannot do the scene, and why.
    versions : dict of str
    """

    scene: Scene
    reference: Reference
    curves: tuple[Curve, ...]
    dropped: int
    left_out: tuple[str, ...]
    versions: dict[str, str]

    @property
    def points(self) -> list[Point]:
        """All points, curve by curve."""
        return [point for curve in self.curves for point in curve.points]

    def to_json(self) -> dict[str, Any]:
        """Return what goes into a JSON file; numbers that are not finite become None."""
        rows = [finite(asdict(point)) for point in self.points]
        truth = {"method": self.reference.method, "error": self.reference.error}
        about = {"machine": machine(), "versions": self.versions, "dropped": self.dropped}
        return {"reference": truth, **about, "rows": rows}

    def table(self, others: Mapping[str, Iterable[tuple[float, float]]] = {}) -> str:
        """Return as text the time to several errors: of every curve, and of others, {name: (seconds, error) ...}."""
        found: dict[str, Iterable[tuple[float, float]]] = {}
        for curve in self.curves:
            found[curve.name] = [(point.seconds, point.error) for point in curve.points]
            if curve.to_tolerance:
                found[WITHOUT.format(curve.name)] = [(point.integration_s, point.error) for point in curve.points]
        lines = [["time to an error of", *(f"{target:.0e}" for target in TARGETS)]]
        for name, points in (found | dict(others)).items():
            times = [time_to(target, points) for target in TARGETS]
            lines.append([name, *("-" if math.isnan(t) else f"{t * 1e3:.3g} ms" for t in times)])
        return "\n".join(aligned(lines))

    def plot(self, axes: Sequence[Axes] | None = None, others: Sequence[Mapping[str, Any]] = ()) -> Figure:
        """Draw error against time and against force evaluations.

        Parameters
        ----------
        axes : two axes, optional
            By default those of a new figure.
        others : sequence of mappings
            Points of other codes: code, error, seconds, force_evaluations (or None).
        """
        from .chart import draw

        return draw(self, axes, others)


def time_to(error: float, points: Iterable[tuple[float, float]]) -> float:
    """Return the time at which points (seconds, error) first come down to an error, s; NaN if they do not.

    Between two points it is interpolated as a power law.

    Examples
    --------
    >>> round(time_to(1e-4, [(1.0, 1e-2), (4.0, 1e-6)]), 9)
    2.0
    """
    before = None
    for seconds, reached in sorted(points):
        if reached <= error:
            if before is None:
                return seconds
            part = math.log(before[1] / error) / math.log(before[1] / reached)
            return float(before[0] * (seconds / before[0]) ** part)
        before = seconds, reached
    return math.nan


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the places of the points (cost, error) that no other beats in both, cheapest first.

    Examples
    --------
    >>> front([(2.0, 0.1), (1.0, 0.5), (3.0, 0.2)])
    [1, 0]
    """
    least, places = math.inf, []
    for place in sorted(range(len(points)), key=points.__getitem__):
        if points[place][1] < least:
            least = points[place][1]
            places.append(place)
    return places


def work_precision(scene: Scene, budget_s: float = BUDGET_S, *, progress: bool = False) -> WorkPrecision:
    """Measure error and time of every engine and integrator that can do a scene.

    Steps are shortened from the longest that holds by factors of sqrt(2) until the error stops falling or the time is
    used up, tolerances by factors of sqrt(10). Each time is the least of three runs or more after one to warm up.

    Parameters
    ----------
    scene : Scene
    budget_s : float
        About how long it may take beside the reference and what has to be compiled, s.
    progress : bool
        Whether to show a progress bar.

    Raises
    ------
    InputError
        If the budget is not a time above 0, or the reference would take more than `LONGEST_S`.
    """
    from tqdm.auto import tqdm

    if not 0 < budget_s < math.inf:
        raise InputError([("budget", f"must be a time above 0 s (got {budget_s:g})")])
    if (needed := expected_seconds(scene)) > LONGEST_S:
        raise InputError([("duration", f"the reference alone would take about {needed:.2g} s: shorten it")])
    truth = reference(scene)
    bench, curves = Bench(scene, truth), []
    ways, left_out = _ways(scene, budget_s)
    left_s = budget_s
    layout = "{desc}: {n_fmt} of {total_fmt} |{bar}| {elapsed}"
    with tqdm(ways, disable=not progress, leave=False, bar_format=layout) as bar:
        for place, (engine, integrator, scan) in enumerate(bar):
            bar.set_description(f"{engine} {integrator}".strip())
            bench.share_s = left_s / (len(ways) - place)
            try:
                points = tuple(scan(bench))
            except EngineUnavailable as error:
                left_out.append(f"{engine}: {error}")
                continue
            left_s -= bench.spent_s
            if points:
                curves.append(Curve(engine, integrator, points))
    return WorkPrecision(scene, truth, _with_front(curves), bench.dropped, tuple(left_out), bench.versions)


def _ways(scene: Scene, budget_s: float) -> tuple[list[Way], list[str]]:
    """Return all ways to answer, with LAMMPS, the slowest, at the end; and why some engines have none."""
    ways: list[Way] = []
    refusals = []
    for name in sorted(engines.names(), key="lammps".__eq__):
        engine = engines.get(name)
        if reasons := engine.refuses(scene):
            refusals.append(f"{name}: {reasons[0][1]}")
        elif isinstance(engine, SteppedEngine):
            kinds = [kind for kind in METHODS if kind in engine.integrators]
            ways += [(name, kind, partial(Bench.over_steps, name=name, integrator=kind)) for kind in kinds]
        elif (cost := engine.candidate(scene, LOOSEST).cost_s) > budget_s / 10:
            refusals.append(f"{name}: a run would take about {cost:.2g} s; give more time")
        else:
            ways.append((name, "", partial(Bench.once, name=name)))
    return [("native", "", partial(Bench.over_tolerances, name="native")), *ways], refusals


def _with_front(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Mark the points that no other beats in both time and error."""
    points = [point for curve in curves for point in curve.points]
    for place in front([(point.seconds, point.error) for point in points]):
        points[place] = replace(points[place], pareto=True)
    marked = iter(points)
    return tuple(replace(curve, points=tuple(islice(marked, len(curve.points)))) for curve in curves)


def machine() -> str:
    """Return the name of the processor and how many cores this process may use."""
    about = Path("/proc/cpuinfo")
    named = about.read_text(encoding="utf-8", errors="replace").splitlines() if about.exists() else []
    model = next((line.partition(":")[2].strip() for line in named if line.startswith("model name")), "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model or platform.processor() or platform.machine()}, {cores} core{'s' if cores != 1 else ''}"
