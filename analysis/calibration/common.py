"""Common parts of the calibration scripts: rows and tables, arguments, runs, true errors."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from lmpchain import Scene
from lmpchain.benchmark.reference import Reference, reference
from lmpchain.engines.base import Engine, ErrorBudget, Proposal, Run
from lmpchain.engines.native import Native
from lmpchain.engines.step_control import first_attempt, solve_to_tolerance
from lmpchain.engines.stepping.time_stepping import SteppingRun
from lmpchain.errors import RunFailed, ToleranceNotMet
from lmpchain.util.provenance import processor
from lmpchain.util.tables import align

NINE_IN_TEN = 0.9
ALL_BUT_ONE = 0.99


class Row(NamedTuple):
    """A measured constant.

    Its value in the code, the value measured, and the interval that the measurement supports.
    """

    name: str
    shipped: float
    measured: float
    low: float
    high: float
    says: str

    @property
    def holds(self) -> bool:
        """Whether the measurement supports the shipped value."""
        return self.low <= self.shipped * (1 + 1e-9) and self.shipped <= self.high * (1 + 1e-9)


def table(rows: Iterable[Row]) -> list[str]:
    """Return aligned lines.

    Constant, shipped and measured value, supported interval and what it means.
    """
    head = ("constant", "shipped", "measured", "supported", "", "of what")
    lines = [
        (
            row.name,
            f"{row.shipped:.4g}",
            f"{row.measured:.4g}",
            f"{row.low:.3g} ... {row.high:.3g}",
            "" if row.holds else "NOT SUPPORTED",
            row.says,
        )
        for row in rows
    ]
    return align([head, *lines])


def command(main: Callable[[bool], list[Row]], doc: str | None) -> None:
    """Run a script from the command line.

    Read --quick, print the table and how long it took, on which processor.
    """
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="seconds, with few scenes, as the tests run it"
    )
    quick = parser.parse_args().quick
    began = time.perf_counter()
    rows = main(quick)
    print("\n".join(table(rows)))
    print(f"{time.perf_counter() - began:.0f} s on {processor()}")


@dataclass(frozen=True, eq=False)
class Answer:
    """One run at a given step.

    Attributes
    ----------
    motion : (2, T, G) array
        Displacement and velocity.
    differences : tuple of float
        Largest relative differences of its companions, at 2h and 4h as far as there are any.
    lowest : float
        The smallest r / eps that any contact had in any of these runs; -1 is an opening.
    """

    candidate: Proposal
    error: ErrorBudget
    motion: np.ndarray
    steps: int
    evaluations: int
    differences: tuple[float, ...]
    lowest: float


def answer(engine: Engine, scene: Scene, candidate: Proposal) -> Answer | None:
    """Run a candidate; return None if the run breaks down."""
    motion = np.zeros((2, scene.samples, scene.recorded.size))
    run = engine.start([scene], candidate)
    try:
        for block in run.blocks():
            motion[0, block.samples, block.columns] = block.displacement[0]
            motion[1, block.samples, block.columns] = block.velocity[0]
        cost = run.cost()
        differences, lowest = _companions(run)
        return Answer(
            candidate,
            run.errors()[0],
            motion,
            cost.steps,
            cost.force_evaluations,
            differences,
            lowest,
        )
    except RunFailed:
        return None
    finally:
        run.close()


def _companions(run: Run) -> tuple[tuple[float, ...], float]:
    """Return distances of the auxiliary runs from the main run, and the lowest r / eps of all."""
    if not isinstance(run, SteppingRun):
        return (), 0.0
    peaks = np.where(run.monitor.peaks[0] > 0, run.monitor.peaks[0], 1.0)
    relative = np.asarray(run.state()["differences"])[:, :, 0] / peaks
    return tuple(relative.max((1, 2)).tolist()), float(
        run.monitor.native.watched["least_strain"].min()
    )


def with_reach(scene: Scene, candidate: Proposal, reach: float) -> Proposal:
    """Return the candidate with the longest step up to omega h = reach that divides an interval."""
    interval = scene.duration / (scene.samples - 1)
    steps = max(1, math.ceil(interval * scene.highest_frequency / reach * (1 - 1e-12)))
    return sampled(candidate, steps)


def sampled(candidate: Proposal, count: int) -> Proposal:
    """Return a proposal with this number of steps per sampling interval."""
    return candidate.with_steps(candidate.steps.sampled.shorten(count))


@contextmanager
def changed(record: Any, **values: object) -> Iterator[None]:
    """Change fields of a frozen record of constants in all modules that import it."""
    other = replace(record, **values)
    modules = [module for name, module in sys.modules.items() if name.startswith("lmpchain")]
    with ExitStack() as stack:
        for module in modules:
            for name in [name for name, value in vars(module).items() if value is record]:
                stack.enter_context(mock.patch.object(module, name, other))
        yield


def proposal(engine: Engine, scene: Scene, tolerance: float) -> Proposal | None:
    """Return the proposal of the engine; None if it cannot meet the tolerance."""
    try:
        return engine.propose(scene, tolerance)
    except ToleranceNotMet:
        return None


@dataclass(frozen=True, eq=False)
class Case:
    """A scene with its true motion, computed once.

    Taylor series in extended precision, independent of all engines.
    """

    scene: Scene

    @cached_property
    def reference(self) -> Reference:
        """The independent solution of Eq. (1)."""
        return reference(self.scene)

    @cached_property
    def motion(self) -> np.ndarray:
        """True displacement and velocity of the recorded grains, (2, T, G)."""
        columns = self.scene.recorded - 1
        return np.array(
            [self.reference.displacement[:, columns], self.reference.velocity[:, columns]]
        )

    def error(self, motion: np.ndarray) -> float:
        """Return the true relative error.

        The larger of displacement and velocity, over the largest true sample.
        """
        return distance(motion, self.motion)

    @property
    def known(self) -> bool:
        """Whether the reference exists and is accurate to 1e-12."""
        try:
            return self.reference.error < 1e-12
        except RunFailed:
            return False


def distance(motion: np.ndarray, true: np.ndarray) -> float:
    """Return the largest difference of two motions (2, T, G), relative to the second motion."""
    size = np.abs(true).max((1, 2))
    return float((np.abs(motion - true).max((1, 2)) / np.where(size > 0, size, 1.0)).max())


def quantile(values: Iterable[float], part: float) -> float:
    """Return a quantile; NaN for an empty list."""
    values = np.array(list(values), dtype=float)
    return float(np.quantile(values, part)) if values.size else math.nan


def best(work: Callable[[], object], repeats: int) -> float:
    """Return the shortest of several times, s."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def near_best(costs: dict[float, float], within: float = 1.1) -> tuple[float, float, float]:
    """Return the value of least cost, and the range of values of at most 10 % higher cost."""
    best = min(costs, key=lambda value: costs[value])
    good = [value for value, cost in costs.items() if cost <= within * costs[best]]
    return best, min(good), max(good)


class Job(NamedTuple):
    """A scene, a tolerance, and the factor on the usual first step."""

    engine: Engine
    scene: Scene
    tolerance: float
    longer: float = 1.0

    @property
    def work(self) -> float:
        """Number of force evaluations in all attempts together.

        Infinite if the tolerance is not met.
        """
        evaluations = []

        def collect(run: Run) -> None:
            for _ in run.blocks():
                pass
            evaluations.append(run.cost().force_evaluations)

        try:
            attempt = first_attempt(partial(self.engine.propose, self.scene), self.tolerance)
            if self.longer > 1:
                steps = math.ceil(attempt.proposal.steps.per_landing / self.longer)
                attempt = attempt._replace(
                    proposal=attempt.proposal.with_steps(attempt.proposal.steps.shorten(steps))
                )
            outcome = solve_to_tolerance(self.engine, [self.scene], attempt, collect)
        except (RunFailed, ToleranceNotMet):
            return math.inf
        return math.inf if outcome.missed else sum(evaluations)


def row_of_work(
    record: Any, field: str, values: Sequence[float], jobs: Sequence[Job], what: str
) -> Row:
    """Return the row of a field that affects the choice of steps.

    Supported within 10 % of the least work.
    """
    shipped = getattr(record, field)
    each = {}
    for value in sorted({*values, shipped}):
        with changed(record, **{field: value}):
            each[value] = np.array([job.work for job in jobs])
    met = np.all([np.isfinite(work) for work in each.values()], axis=0)
    usual = np.log(each[shipped][met])
    costs = {
        value: float(np.exp(np.mean(np.log(work[met]) - usual))) for value, work in each.items()
    }
    listed = ", ".join(f"{value:g}: {cost:.2f}" for value, cost in costs.items())
    says = f"{what}; evaluations in {met.sum()} answers: {listed}"
    return Row(label(record, field), shipped, *near_best(costs), says)


def label(record: Any, field: str) -> str:
    """Return the name of a field of a record as in the code, such as TRUST.safety."""
    module = sys.modules[type(record).__module__]
    name = next(name for name, value in vars(module).items() if isinstance(value, type(record)))
    return f"{name}.{field}"


NATIVE = Native()
