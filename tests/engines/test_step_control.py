"""From attempt to attempt: when the next one is made, with which step, what all have cost, and why there is none."""

import math
import re

import numpy as np
import pytest
from helpers.example_scenes import smooth

from lmpchain import RunFailed, ToleranceNotMet
from lmpchain.engines import Native, step_control
from lmpchain.engines.base import Candidate, Engine, ErrorBudget, Run
from lmpchain.engines.step_control import (
    Attempt,
    first_attempt,
    loosened,
    next_attempt,
    solve_to_tolerance,
)
from lmpchain.trajectory.record import Cost

SCENE = smooth(samples=5)
STEP = 1e-7
CANDIDATE = Candidate(STEP, 8, 0.0, 1e-6, 1e-3, steps_per_landing=10, integrator="rkn6")
COST = Cost(1.0, 0.5, 0.25, 40, 280, 8, "rkn6", STEP, 1)


def budget(truncation: float, roundoff: float = 1e-15, smooth: bool = True) -> ErrorBudget:
    """Return an error, and differences that reach it at the third of five samples."""
    return ErrorBudget(
        truncation, roundoff, smooth, truncation * np.array([0.0, 1e-9, 1.0, 1.0, 1.0])
    )


class Scripted(Engine):
    """An engine whose runs take 1.75 s and have the errors of a script: None for one that breaks down."""

    name = "native"
    equation = 1

    def __init__(self, errors, now):
        self.errors, self.now, self.steps, self.last = list(errors), now, [], False

    def refuses(self, scene):
        """Do everything."""
        return []

    def candidate(self, scene, tolerance):
        """Propose the same step."""
        return CANDIDATE

    def refine(self, candidate, error, tolerance):
        """Halve the step, unless that was the last one."""
        return None if self.last else candidate.with_steps(2 * candidate.steps_per_landing)

    def start(self, scenes, candidate, state=None):
        """Start the next run of the script."""
        self.steps.append(candidate.step)
        return ScriptedRun(self.errors.pop(0), self.now, len(scenes))

    def describe(self, scene, candidate):
        """There is nothing to say."""
        return {}


class ScriptedRun(Run):
    """A run without samples."""

    def __init__(self, error, now, size):
        self.error, self.now, self.size, self.closed = error, now, size, 0

    def blocks(self):
        """Spend the time."""
        self.now[0] += 1.75
        if self.error is None:
            raise RunFailed("it broke down")
        yield from ()

    @property
    def progress(self):
        """It is done."""
        return 1.0

    def errors(self):
        """Return the error of the script, one a scene."""
        return self.error if isinstance(self.error, list) else [self.error] * self.size

    def cost(self):
        """Return what it has cost."""
        return COST

    def state(self):
        """There is none."""
        return {}

    def close(self):
        """Count."""
        self.closed += 1


@pytest.fixture
def now(monkeypatch):
    """Have a clock that stands still but in runs."""
    time = [0.0]
    monkeypatch.setattr(step_control, "clock", lambda: time[0])
    return time


@pytest.fixture
def pairs(monkeypatch):
    """Return the candidates of pairs of nearby runs; these stay within `apart`, to begin with 0."""
    seen: list[Candidate] = []

    def divergence(scene, candidate, change):
        assert change == 1e-15
        seen.append(candidate)
        return np.array([0.0, 0.0, 0.0, pairs.apart, 2 * pairs.apart])

    pairs = type("Pairs", (), {"seen": seen, "apart": 0.0})()
    monkeypatch.setattr(step_control, "divergence", divergence)
    return pairs


def solve(engine: Scripted, tolerance: float = 1e-6, scenes=(SCENE,), **options):
    attempt = Attempt("native", CANDIDATE, tolerance, planned_s=0.125)
    return solve_to_tolerance(
        engine, list(scenes), attempt, lambda run: list(run.blocks()), **options
    )


def test_steps_shorten_until_the_tolerance_is_met(now, pairs):
    """The costs of all attempts come together: earlier ones count to the estimate, what is around them to the setup."""
    engine = Scripted([budget(1e-3), budget(1e-5), budget(1e-6 - 1e-15)], now)
    outcome = solve(engine)
    assert engine.steps == pytest.approx([STEP, STEP / 2, STEP / 4], rel=1e-12)
    assert outcome.missed == ""
    assert outcome.error.truncation == 1e-6 - 1e-15
    assert outcome.attempt.truncations == (1e-3, 1e-5)
    assert outcome.attempt.number == 3
    assert (outcome.cost.integration_s, outcome.cost.steps) == (1.0, 40)
    assert outcome.cost.estimate_s == pytest.approx(0.5 + 2 * 1.5, rel=1e-12)
    assert outcome.cost.setup_s == pytest.approx(0.25 + 0.125 + 2 * 0.25, rel=1e-12)
    assert not pairs.seen


def test_of_several_scenes_the_worst_decides(now, pairs):
    engine = Scripted([[budget(1e-9), budget(1e-4)], [budget(1e-9), budget(2e-9)]], now)
    outcome = solve(engine, scenes=(SCENE, SCENE))
    assert [error.truncation for error in outcome.errors] == [1e-9, 2e-9]
    assert outcome.error.truncation == 2e-9
    assert len(engine.steps) == 2


def test_a_run_that_breaks_down_is_tried_three_times(now, pairs):
    engine = Scripted([None, None, budget(1e-9)], now)
    assert solve(engine).attempt.number == 3
    engine = Scripted([None, None, None, budget(1e-9)], now)
    with pytest.raises(RunFailed, match="it broke down"):
        solve(engine)
    assert len(engine.steps) == 3
    engine = Scripted([None, budget(1e-9)], now)
    with pytest.raises(RunFailed):
        solve_to_tolerance(
            engine,
            [SCENE],
            Attempt("native", CANDIDATE._replace(fixed=True), 1e-6),
            lambda run: list(run.blocks()),
        )
    assert len(engine.steps) == 1


def test_a_given_step_meets_any_tolerance(now, pairs):
    attempt = Attempt("native", CANDIDATE._replace(fixed=True), 1e-6)
    assert next_attempt(Scripted([], now), SCENE, attempt, budget(0.5)) == (None, "")


def test_a_pilot_is_followed_by_the_answer_that_it_asks_for(now, pairs):
    pilot = Attempt("native", CANDIDATE, 1e-6, pilot=True)
    following, missed = next_attempt(Scripted([], now), SCENE, pilot, budget(0.5))
    assert missed == ""
    assert (following.pilot, following.pilots, following.number, following.truncations) == (
        False,
        1,
        2,
        (),
    )
    assert following.candidate.step == pytest.approx(STEP / 2, rel=1e-12)
    after, _ = next_attempt(Scripted([], now), SCENE, pilot, None)
    assert (after.pilots, after.breakdowns) == (1, 0)
    assert not pairs.seen


def test_where_rounding_is_the_limit_it_says_so(now, pairs):
    engine = Scripted([budget(2e-9, 3.3e-6)], now)
    engine.last = True
    outcome = solve(engine)
    assert outcome.missed == (
        "the error is estimated at 3.3e-06, above the tolerance of 1e-06, and steps shorter than 1e-07 s do not help, "
        "for round-off alone makes 3.3e-06: ask for less"
    )


def test_three_attempts_that_do_not_help_end_it_where_rounding_is_near(now, pairs):
    """With the time of the sample at which runs differ by more than the tolerance."""
    engine = Scripted([budget(truncation, 1e-6) for truncation in (9e-3, 7e-3, 5e-3)], now)
    outcome = solve(engine)
    assert len(engine.steps) == 3
    time = SCENE.time[2]
    assert outcome.missed == (
        "the error is estimated at 0.005, above the tolerance of 1e-06, and steps shorter than 2.5e-08 s do not help: "
        f"this scene amplifies round-off beyond the tolerance at t = {time:.4g} s; record up to there, or ask for less"
    )


def test_three_attempts_that_help_do_not_end_it(now, pairs):
    """An error that falls by more than three tenths each time; or one that is erratic, far above round-off."""
    falling = [9e-3 * 0.69**n for n in range(4)]
    engine = Scripted([*(budget(x, 1e-6) for x in falling), budget(1e-8)], now)
    assert solve(engine).missed == ""
    erratic = Scripted([*(budget(x, 1e-9) for x in (9e-3, 8e-3, 7e-3)), budget(1e-8)], now)
    assert solve(erratic).missed == ""
    assert len(erratic.steps) == 4
    assert len(pairs.seen) == 1  # nothing diverges there: one pair at steps of one length
    pairs.apart = 1.0
    erratic = Scripted([*(budget(x, 1e-9) for x in (9e-3, 8e-3, 7e-3)), budget(1e-8)], now)
    assert "amplifies round-off" in solve(erratic).missed


def test_an_error_that_doubles_is_looked_at_twice(now, pairs):
    engine = Scripted([budget(1e-3), budget(2.1e-3), budget(1e-8)], now)
    assert solve(engine).missed == ""
    pairs.apart = 1.0
    engine = Scripted([budget(1e-3), budget(2.1e-3), budget(1e-8)], now)
    assert "steps shorter than 5e-08 s do not help: this scene amplifies" in solve(engine).missed
    engine = Scripted([budget(1e-3), budget(1.9e-3), budget(1e-8)], now)
    assert solve(engine).missed == ""


def test_there_are_at_most_twelve_attempts(now, pairs):
    errors = [9e-3 * 0.69**n for n in range(20)]
    engine = Scripted([budget(error) for error in errors], now)
    outcome = solve(engine)
    assert len(engine.steps) == 12
    assert re.search(r"steps shorter than 4.9e-11 s do not help: ask for less$", outcome.missed)


def test_chaos_is_looked_for_in_the_first_two_attempts_that_miss_by_far(now, pairs):
    """Two runs must diverge by ten tolerances; the time is when they differ by one."""
    pairs.apart = 3e-6
    engine = Scripted([budget(1.1e-2), budget(1e-8)], now)
    assert solve(engine).missed == ""  # by six tolerances at most
    pairs.apart = 5e-6
    engine = Scripted([budget(1.1e-2), budget(1e-8)], now)
    assert solve(engine).missed == (
        "the error is estimated at 0.011, above the tolerance of 1e-06: this scene amplifies round-off beyond the "
        f"tolerance at t = {SCENE.time[3]:.4g} s; record up to there, or ask for less"
    )
    engine = Scripted([budget(1.1e-2), budget(1e-8)], now)
    assert solve(engine, patient=True).missed == ""
    engine = Scripted([budget(0.9e-2), budget(1e-8)], now)
    assert solve(engine).missed == ""  # a miss by so little is no sign of it
    engine = Scripted([budget(0.29), budget(1e-8)], now)
    assert solve(engine, tolerance=1e-4).missed == ""
    pairs.apart = 5e-4
    engine = Scripted([budget(0.31), budget(1e-8)], now)
    assert "amplifies" in solve(engine, tolerance=1e-4).missed
    pairs.apart = 0.0
    engine = Scripted([budget(0.9), budget(0.5), budget(0.2), budget(1e-8)], now)
    pairs.seen.clear()
    assert solve(engine).missed == ""
    assert len(pairs.seen) == 2  # the third attempt is not looked at


def test_pairs_of_runs_are_made_with_adaptive_steps_and_with_those_of_one_length(now, pairs):
    pairs.apart = 1.0
    attempt = Attempt(
        "native", CANDIDATE._replace(adaptive=True, stride=2, steps_per_landing=20), 1e-6
    )
    _, missed = next_attempt(Scripted([], now), SCENE, attempt, budget(0.9))
    assert "amplifies" in missed
    assert sorted(pair.adaptive for pair in pairs.seen) == [False, True]
    assert {(pair.steps_per_landing, pair.stride) for pair in pairs.seen} == {(10, 1)}


def test_pairs_of_runs_take_no_more_steps_than_show_it(now, pairs):
    """Three hundred thousand, or four a radian of the highest frequency."""
    pairs.apart = 1.0
    many = CANDIDATE._replace(steps_per_landing=300_000, step=STEP / 3e4)
    next_attempt(Scripted([], now), SCENE, Attempt("native", many, 1e-6), budget(0.9))
    assert pairs.seen[-1].steps(SCENE.samples) == 300_000
    long = SCENE.replace(duration=1e5 / SCENE.highest_frequency)
    next_attempt(Scripted([], now), long, Attempt("native", many, 1e-6), budget(0.9))
    assert pairs.seen[-1].steps(SCENE.samples) == pytest.approx(4e5, rel=1e-4)


def test_a_pair_that_breaks_down_says_nothing(now, monkeypatch):
    def fail(*_):
        raise RunFailed("too close")

    monkeypatch.setattr(step_control, "divergence", fail)
    engine = Scripted([budget(0.9), budget(1e-8)], now)
    assert solve(engine).missed == ""


def test_a_tolerance_is_loosened_fourfold_until_it_can_be_met():
    asked = []

    def propose(tolerance):
        asked.append(tolerance)
        if tolerance < least:
            raise ToleranceNotMet(f"not {tolerance:g}")
        return "candidate"

    least = 0.05
    assert loosened(propose, 1e-3) == ("candidate", 0.064, "not 0.001")
    assert asked == [1e-3, 4e-3, 0.016, 0.064]
    assert loosened(propose, 0.5) == ("candidate", 0.5, "")
    least = math.inf
    asked.clear()
    with pytest.raises(ToleranceNotMet, match=r"not 0.256"):
        loosened(propose, 1e-3)
    assert asked == [1e-3, 4e-3, 0.016, 0.064, 0.256]


def test_a_refusal_of_the_engine_stays_with_the_attempt():
    """Beyond the last digits nothing is promised; with best effort the tolerance is what can be had."""
    with pytest.raises(ToleranceNotMet, match="round-off alone makes an error of about"):
        first_attempt(Native(), SCENE, 1e-16)
    attempt = first_attempt(Native(), SCENE, 1e-16, best_effort=True)
    assert attempt.tolerance == pytest.approx(
        1e-16 * 4 ** round(math.log(attempt.tolerance / 1e-16, 4)), rel=1e-9
    )
    assert attempt.tolerance < 1e-13
    assert "round-off alone" in attempt.refusal
    assert (attempt.engine, attempt.number) == ("native", 1)
