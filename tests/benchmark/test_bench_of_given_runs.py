"""Steps and tolerances that a bench measures for runs with given errors and times."""

import math
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import smooth

from lmpchain import RunFailed, ToleranceNotMet
from lmpchain.benchmark import bench
from lmpchain.benchmark.bench import Bench, repeat
from lmpchain.benchmark.comparison import ComparisonRow
from lmpchain.benchmark.reference import Reference
from lmpchain.trajectory.record import Cost

SCENE = smooth(samples=5)
INTERVAL = SCENE.duration / 4
TRUTH = Reference(SCENE.time, np.zeros((5, 8)), np.zeros((5, 8)), 1e-16, "none")


class Given(Bench):
    """A bench of runs with given errors and times, on a simulated clock."""

    def __init__(
        self, error: Callable[[int], float], seconds: Callable[[int], float] = lambda _: 0.01
    ):
        self.clock = 0.0
        self.error = error
        self.seconds = seconds
        self.tried: list[int] = []
        self.tolerances: list[float] = []
        self.tightest = 0.0  # A tighter tolerance is not met.
        super().__init__(SCENE, TRUTH)

    def _run(self, engine: Any, tolerance: float | None = None) -> Any:
        if tolerance is None:
            steps = round(INTERVAL / engine.step)
            assert engine.step == pytest.approx(INTERVAL / steps, rel=1e-12)
        elif tolerance < self.tightest:
            raise ToleranceNotMet("no", None)
        else:
            steps = math.ceil(tolerance**-0.25)
            self.tolerances.append(tolerance)
        self.tried.append(steps)
        self.clock += self.seconds(steps)
        error = self.error(steps)
        if not math.isfinite(error):
            raise RunFailed("it broke down")
        count = len(self.tried)
        times = 2.0 + 0.1 / count, 1.0 - 0.1 / count, 0.5 + 0.1 / count
        cost = Cost(*times, steps, 4 * steps, 8, "rkn4", 1e-9, 1)
        return SimpleNamespace(cost=cost, error=error, provenance={})

    def _row(self, answer: Any) -> ComparisonRow:
        cost = answer.cost
        times = 0.0, 0.0, cost.integration_s
        work = cost.steps, cost.force_evaluations, 0.0
        return ComparisonRow("native", 1, "rkn4", answer.error, answer.error, *times, *work)


def timed(monkeypatch: pytest.MonkeyPatch, made: Given) -> Given:
    monkeypatch.setattr(bench.time, "perf_counter", lambda: made.clock)
    return made


def fourth_order(stable: int, floor: float = 0.0) -> Callable[[int], float]:
    return lambda steps: max((stable / steps) ** 4 / 2, floor) if steps >= stable else math.inf


@pytest.mark.parametrize("stable", [1, 2, 7, 37, 700])
def test_steps_shorten_by_the_root_of_2_from_the_longest_stable_step(
    monkeypatch: pytest.MonkeyPatch, stable: int
):
    made = timed(monkeypatch, Given(fourth_order(stable, 1e-9)))
    points = list(made.over_steps("native", "rkn4"))
    steps = [point.steps for point in points]
    assert stable <= steps[0] <= max(1.1 * (stable - 1), stable)
    assert all(after == math.ceil(before * math.sqrt(2)) for before, after in pairwise(steps))
    assert [point.longest for point in points] == [True, *[False] * (len(points) - 1)]
    errors = [point.error for point in points]
    at_floor = errors.count(1e-9)
    # The search ends after four points without improvement.
    assert at_floor == (5 if 0.8 * errors[-at_floor - 1] > 1e-9 else 4)


def test_a_step_with_an_error_of_1_is_unstable(monkeypatch: pytest.MonkeyPatch):
    made = timed(monkeypatch, Given(lambda steps: 1.0 if steps < 16 else 0.999 * (16 / steps) ** 4))
    assert next(made.over_steps("native", "rkn4")).steps == 16


def test_improvements_by_a_fifth_continue_the_search(monkeypatch: pytest.MonkeyPatch):
    """The search stops after four points that do not reduce the error by a fifth."""
    for factor, ends in ((0.75, False), (0.85, True)):
        made = timed(monkeypatch, Given(lambda steps, f=factor: 0.5 * f ** (2 * math.log2(steps))))
        points = list(zip(range(16), made.over_steps("native", "rkn4"), strict=False))
        assert (len(points) < 16) == ends


@pytest.mark.parametrize("share", [1.0, 3.0, 100.0])
def test_no_point_begins_that_would_exceed_the_time_limit(
    monkeypatch: pytest.MonkeyPatch, share: float
):
    made = timed(monkeypatch, Given(lambda steps: 0.5 / steps, lambda steps: 1e-3 * steps))
    made.share_s = share
    spent = []
    before = 0.0
    for _ in made.over_steps("native", "rkn4"):
        spent.append((made.spent_s, before))
        before = made.spent_s
    for number, (after, begun) in enumerate(spent):
        late = after + math.sqrt(2) * (after - begun) > share
        assert late == (number == len(spent) - 1)


def test_the_search_takes_a_quarter_of_the_time(monkeypatch: pytest.MonkeyPatch):
    """A step is found by doubling, and its refinement stops when the time is used up."""
    for share, steps in ((math.inf, 544), (0.12, 640), (0.06, 768)):  # Between 512 and 1024.
        made = timed(monkeypatch, Given(fourth_order(520), lambda _: 0.02))
        made.share_s = share
        assert next(made.over_steps("native", "rkn4")).steps == steps


def test_nothing_is_measured_if_no_step_is_stable(monkeypatch: pytest.MonkeyPatch):
    made = timed(monkeypatch, Given(lambda _: math.inf))
    assert list(made.over_steps("native", "rkn4")) == []
    assert made.tried == [2**k for k in range(20)]


def test_tolerances_tighten_by_the_root_of_10_until_one_is_not_met(monkeypatch: pytest.MonkeyPatch):
    made = timed(monkeypatch, Given(lambda steps: steps**-4.0))
    made.tightest = 1e-9
    points = list(made.over_tolerances("native"))
    asked = [point.tolerance for point in points]
    counts = {}
    for k in range(17):
        tolerance = 10.0 ** (-1 - k / 2)
        counts.setdefault(math.ceil(tolerance**-0.25), tolerance)
    # Points with equal steps are listed once.
    assert asked == pytest.approx(list(counts.values()), rel=1e-12)
    assert [point.steps for point in points] == list(counts)


def test_the_tightest_tolerance_is_limited_by_rounding(monkeypatch: pytest.MonkeyPatch):
    made = timed(monkeypatch, Given(lambda steps: steps**-4.0))
    list(made.over_tolerances("native"))
    assert sorted(set(made.tolerances)) == pytest.approx(
        [10.0**-k for k in np.arange(14.5, 0.9, -0.5)], rel=1e-9
    )
    made.share_s = 0.5
    made.tolerances = []
    made.seconds = lambda _: 0.1
    list(made.over_tolerances("native"))
    assert len(set(made.tolerances)) == 2


@pytest.mark.parametrize(
    ("seconds", "runs"), [(0.1, 3), (0.02, 3), (0.0101, 5), (0.004, 13), (1e-6, 15)]
)
def test_short_runs_are_repeated_more_often(
    monkeypatch: pytest.MonkeyPatch, seconds: float, runs: int
):
    """Short runs are repeated 3 to 15 times, until they have taken 50 ms."""
    clock = [0.0]
    monkeypatch.setattr(bench.time, "perf_counter", lambda: clock[0])

    def run() -> int:
        clock[0] += seconds
        return len(clock)

    assert len(repeat(run)) == runs  # type: ignore[arg-type]


def test_a_point_has_the_least_of_each_time(monkeypatch: pytest.MonkeyPatch):
    made = timed(monkeypatch, Given(lambda steps: 0.5 * steps**-4.0, lambda _: 0.02))
    point = next(made.over_steps("native", "rkn4"))
    last = len(made.tried)
    assert last == 1 + 1 + 3  # One run for the search, one to warm up, and three that are timed.
    assert point.integration_s == point.seconds == pytest.approx(2.0 + 0.1 / last, rel=1e-12)
    assert point.setup_s == pytest.approx(0.5 + 0.1 / last, rel=1e-12)
    # This is the cost of the run that was timed first.
    assert point.estimate_s == pytest.approx(1.0 - 0.1 / 3, rel=1e-12)
    assert point.grain_steps_per_s == pytest.approx(
        4 * point.steps * 8 / point.integration_s, rel=1e-12
    )
    assert (point.step_s, point.tolerance, point.force_evaluations) == (1e-9, None, 4 * point.steps)
    assert made.dropped == 0
    tight = next(made.over_tolerances("native"))
    assert tight.tolerance == 0.1
    assert tight.seconds == pytest.approx(3.0, rel=1e-12)  # Includes the estimate.


def test_errors_below_the_accuracy_of_the_reference_are_dropped(monkeypatch: pytest.MonkeyPatch):
    # The search stops after four points without an improvement.
    for error, listed, dropped in ((1.01e-15, 5, 0), (0.99e-15, 0, 4)):
        made = timed(monkeypatch, Given(lambda _, e=error: e))
        points = list(made.over_steps("native", "rkn4"))
        assert (len(points), made.dropped) == (listed, dropped)
    made = timed(monkeypatch, Given(fourth_order(2)))
    assert min(point.error for point in made.over_steps("native", "rkn4")) >= 1e-15
    assert made.dropped == 4
