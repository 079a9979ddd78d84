"""Step control: the sequence of attempts.

When the next one is made, with which step, what all have cost, and why there is none.
"""

import math
from functools import partial

import numpy as np
import pytest
from helpers.example_scenes import smooth
from helpers.taylor_series import reference

from lmpchain import Chain, Impulse, RunFailed, Scene, ToleranceNotMet, simulate
from lmpchain.engines import Native, step_control
from lmpchain.engines.base import Engine, ErrorBudget, Proposal, Run
from lmpchain.engines.step_control import (
    Attempt,
    first_attempt,
    next_attempt,
    solve_to_tolerance,
)
from lmpchain.integrators.steps import Steps
from lmpchain.trajectory.record import Cost

SCENE = smooth(samples=5)
STEP = 1e-7
PROPOSAL = Proposal("native", 1, Steps(10, 1, STEP), 8, 0.0, 1e-6, 1e-3, integrator="rkn6")
COST = Cost(1.0, 0.5, 0.25, 40, 280, 8, "rkn6", STEP, 1)


def budget(truncation: float, roundoff: float = 1e-15) -> ErrorBudget:
    """Return an error whose amplified rounding reaches it from the third of five samples on."""
    amplified = roundoff * np.array([0.0, 1e-9, 1.0, 1.0, 1.0])
    return ErrorBudget(truncation, roundoff, 6.0, amplified=amplified)


class Scripted(Engine):
    """An engine whose runs take 1.75 s and have given errors.

    None for one that breaks down.
    """

    name = "native"
    equation = 1

    def __init__(self, errors, now):
        self.errors = list(errors)
        self.now = now
        self.steps = []
        self.last = False

    def refuses(self, scene):
        """Refuse nothing."""
        return []

    def propose(self, scene, tolerance):
        """Propose the same step."""
        return PROPOSAL

    def refine(self, candidate, error, tolerance):
        """Halve the step, unless it was the last attempt."""
        steps = candidate.steps
        return None if self.last else candidate.with_steps(steps.shorten(2 * steps.per_landing))

    def start(self, scenes, candidate, state=None):
        """Start the next run of the script."""
        self.steps.append(candidate.step)
        return ScriptedRun(self.errors.pop(0), self.now, len(scenes))

    def describe(self, scene, candidate):
        """Return no options."""
        return {}


class ScriptedRun(Run):
    """A run without samples."""

    def __init__(self, error, now, size):
        self.error = error
        self.now = now
        self.size = size
        self.closed = 0

    def blocks(self):
        """Spend the time of the run."""
        self.now[0] += 1.75
        if self.error is None:
            raise RunFailed("it broke down")
        yield from ()

    @property
    def progress(self):
        """Return 1, because the run is done."""
        return 1.0

    def errors(self):
        """Return the scripted error, one for each scene."""
        return self.error if isinstance(self.error, list) else [self.error] * self.size

    def cost(self):
        """Return the cost."""
        return COST

    def state(self):
        """Return an empty state."""
        return {}

    def close(self):
        """Count the closed runs."""
        self.closed += 1


@pytest.fixture
def now(monkeypatch):
    """Install a clock that advances only in runs."""
    time = [0.0]
    monkeypatch.setattr(step_control, "clock", lambda: time[0])
    return time


def solve(engine: Scripted, tolerance: float = 1e-6, scenes=(SCENE,), **options):
    attempt = Attempt(PROPOSAL, tolerance, planned_s=0.125)
    return solve_to_tolerance(
        engine, list(scenes), attempt, lambda run: list(run.blocks()), **options
    )


def test_steps_shorten_until_the_tolerance_is_met(now):
    """The cost is the sum over all attempts.

    Earlier ones count to the estimate, what is around them to the setup.
    """
    engine = Scripted([budget(1e-3), budget(1e-5), budget(1e-6 - 2e-15)], now)
    outcome = solve(engine)
    assert engine.steps == pytest.approx([STEP, STEP / 2, STEP / 4], rel=1e-12)
    assert outcome.missed == ""
    assert outcome.error.truncation == 1e-6 - 2e-15
    assert outcome.attempt.truncations == (1e-3, 1e-5)
    assert outcome.attempt.number == 3
    assert (outcome.cost.integration_s, outcome.cost.steps) == (1.0, 40)
    assert outcome.cost.estimate_s == pytest.approx(0.5 + 2 * 1.5, rel=1e-12)
    assert outcome.cost.setup_s == pytest.approx(0.25 + 0.125 + 2 * 0.25, rel=1e-12)


def test_the_worst_of_several_scenes_decides(now):
    engine = Scripted([[budget(1e-9), budget(1e-4)], [budget(1e-9), budget(2e-9)]], now)
    outcome = solve(engine, scenes=(SCENE, SCENE))
    assert [error.truncation for error in outcome.errors] == [1e-9, 2e-9]
    assert outcome.error.truncation == 2e-9
    assert len(engine.steps) == 2


def test_a_breakdown_is_retried_three_times(now):
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
            Attempt(PROPOSAL._replace(fixed=True), 1e-6),
            lambda run: list(run.blocks()),
        )
    assert len(engine.steps) == 1


def test_a_given_step_meets_any_tolerance(now):
    attempt = Attempt(PROPOSAL._replace(fixed=True), 1e-6)
    assert next_attempt(Scripted([], now), SCENE, attempt, budget(0.5)) == (None, "")


def test_a_limit_by_rounding_is_reported_with_its_time(now):
    engine = Scripted([budget(2e-9, 3.3e-6)], now)
    engine.last = True
    reason = (
        "the error is estimated at 3.3e-06, above the tolerance of 1e-06, "
        "because round-off alone may make an error of 3.3e-06: "
    )
    time = f"{SCENE.time[2]:.4g}"
    assert solve(engine).missed == (
        f"{reason}this scene amplifies round-off, which may exceed the tolerance at t = {time} s; "
        "record up to this time, use a larger tolerance, or take averages over time "
        "(lmpchain.averages)"
    )
    engine = Scripted([budget(2e-9, 3.3e-6)._replace(amplified=np.zeros(0))], now)
    engine.last = True
    assert solve(engine).missed == f"{reason}use a larger tolerance"


def test_three_attempts_without_improvement_end_the_search(now):
    truncations = (9e-3, 1e-3, 8e-3, 6.4e-3, 1e-3)
    engine = Scripted([budget(truncation) for truncation in truncations], now)
    outcome = solve(engine)
    assert len(engine.steps) == 5
    assert outcome.missed == (
        "the error is estimated at 0.001, above the tolerance of 1e-06, and steps shorter than "
        "5e-08 s do not help: "
        "use a larger tolerance"
    )


def test_the_best_attempt_that_misses_the_tolerance_is_returned(now):
    """The second of four attempts is the best by chance; it is repeated after being discarded."""
    truncations = (9e-3, 1e-3, 8e-3, 6.4e-3, 1e-3)
    engine = Scripted([budget(truncation) for truncation in truncations], now)
    outcome = solve(engine)
    assert outcome.error.truncation == 1e-3
    assert engine.steps[-1] == engine.steps[1]
    assert outcome.attempt.proposal.step == engine.steps[1]


def test_a_refusal_returns_the_best_result_that_rounding_allows():
    """The best attempt is returned: once it was the first, with 2.7 instead of 2e-10."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0, exponent=1.5, bottom="wall", top="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=4e-4, samples=11)
    with pytest.raises(ToleranceNotMet) as refusal:
        simulate(scene, "native", 1e-11)
    answer = refusal.value.trajectory
    truth, doubt = reference(scene, 1e-20)
    error = truth.error(answer.displacement, answer.velocity)
    assert doubt < error / 10
    assert error <= answer.error_estimate.solver < 1e-8
    assert "steps shorter" not in str(refusal.value)


def test_three_attempts_with_improvement_do_not_end_the_search(now):
    """The error decreases by more than three tenths in three attempts, even if irregularly."""
    falling = [9e-3 * 0.88**n for n in range(7)]
    engine = Scripted([*(budget(x) for x in falling), budget(1e-8)], now)
    assert solve(engine).missed == ""
    engine = Scripted([budget(x) for x in (1e-3, 2e-3, 1e-3, 6.9e-4, 1e-8)], now)
    assert solve(engine).missed == ""


def test_there_are_at_most_twelve_attempts(now):
    errors = [9e-3 * 0.69**n for n in range(20)]
    engine = Scripted([budget(error) for error in errors], now)
    outcome = solve(engine)
    assert len(engine.steps) == 12
    assert outcome.missed.endswith(
        "after 12 attempts with ever shorter steps: use a larger tolerance"
    )


def test_the_best_possible_result_is_returned_on_request(now):
    """Steps shorten until all errors but rounding, which is too large, meet the tolerance."""
    errors = [budget(1e-2, 3e-6), budget(1e-4, 3e-6), budget(2e-6, 3e-6), budget(1e-7, 3e-6)]
    engine = Native("rkn6")
    attempt = Attempt(engine.propose(SCENE, 1e-6), 1e-6)
    for error in errors:
        # Other searches continue while the truncation error can be reduced.
        further = next_attempt(engine, SCENE, attempt, error)[0]
        assert (further is not None) == (error.truncation > error.roundoff)
        following, missed = next_attempt(engine, SCENE, attempt, error, patient=True)
        if error is not errors[-1]:
            assert missed == ""
            assert following.proposal.step < attempt.proposal.step
            attempt = following
    assert following is None
    assert "because round-off alone may make an error of 3e-06" in missed


def test_a_hopeless_tolerance_ends_with_the_third_attempt():
    """Rounding alone exceeds the tolerance by far; further attempts once took minutes."""
    engine = Native("rkn6")
    attempt = Attempt(engine.propose(SCENE, 1e-11), 1e-11)
    for further in (True, True, False):
        error = budget(1e-2, 1e-6)
        following, missed = next_attempt(engine, SCENE, attempt, error)
        assert (following is not None) == further
        patient, _ = next_attempt(engine, SCENE, attempt, error, patient=True)
        assert patient is not None
        attempt = following
    assert "because round-off alone may make an error of 1e-06" in missed


def test_a_tolerance_is_loosened_fourfold_until_it_is_met():
    asked = []

    def propose(tolerance):
        asked.append(tolerance)
        if tolerance < least:
            raise ToleranceNotMet(f"not {tolerance:g}")
        return PROPOSAL

    least = 0.05
    loosened = first_attempt(propose, 1e-3, best_effort=True)
    assert loosened[:3] == (PROPOSAL, 0.064, "not 0.001")
    assert asked == [1e-3, 4e-3, 0.016, 0.064]
    assert first_attempt(propose, 0.5, best_effort=True)[:3] == (PROPOSAL, 0.5, "")
    least = math.inf
    asked.clear()
    with pytest.raises(ToleranceNotMet, match=r"not 0.256"):
        first_attempt(propose, 1e-3, best_effort=True)
    assert asked == [1e-3, 4e-3, 0.016, 0.064, 0.256]


def test_a_refusal_of_the_engine_is_recorded_with_the_attempt():
    """Accuracy beyond the last digits is not promised.

    With best effort the tolerance is what can be had.
    """
    with pytest.raises(ToleranceNotMet, match="round-off alone may make an error of"):
        first_attempt(partial(Native().propose, SCENE), 1e-16)
    attempt = first_attempt(partial(Native().propose, SCENE), 1e-16, best_effort=True)
    assert attempt.tolerance == pytest.approx(
        1e-16 * 4 ** round(math.log(attempt.tolerance / 1e-16, 4)), rel=1e-9
    )
    assert attempt.tolerance < 1e-13
    assert "round-off alone" in attempt.refusal
    assert (attempt.proposal.engine, attempt.number) == ("native", 1)
