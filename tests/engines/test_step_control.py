"""Step control: the sequence of attempts.

When the next one is made, with which step, what all have cost, and why there is none.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import smooth
from helpers.taylor_series import reference

from lmpchain import Chain, Impulse, RunFailed, Scene, ToleranceNotMet, simulate
from lmpchain.engines import Native, step_control
from lmpchain.engines.base import Engine, ErrorBudget, Proposal, Run
from lmpchain.engines.cost_model import TooLong, in_words, is_long
from lmpchain.engines.cost_model import budget as time_budget
from lmpchain.engines.step_control import (
    Attempt,
    Outcome,
    first_attempt,
    next_attempt,
    solve_to_tolerance,
)
from lmpchain.integrators.steps import Steps
from lmpchain.trajectory.record import Cost

SCENE = smooth(samples=5)
STEP = 1e-7
TOLERANCE = 1e-6
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


# --- early ends, unpredictable scenes and long work


class Judged(ScriptedRun):
    """A run that is judged once, before its end."""

    def __init__(self, error: Any, early: ErrorBudget | None):
        super().__init__(error, [0.0], 1)
        self.early = early
        self.complete = False

    def blocks(self) -> Iterator[Any]:
        """Let step control judge the run."""
        if self.early is not None:
            self.judge(self)
        self.complete = True
        yield from super().blocks()

    def errors(self) -> list[ErrorBudget]:
        """Return the error so far, or at the end."""
        return [self.error if self.complete or self.early is None else self.early]

    def outlook(self) -> list[ErrorBudget]:
        """Return an error that has grown by ten."""
        (error,) = self.errors()
        return [error._replace(truncation=10 * error.truncation)]


class Watched(Scripted):
    """An engine whose runs have a first and a final error."""

    def start(self, scenes: Any, candidate: Any, state: Any = None) -> Judged:
        """Start the next run of the script."""
        self.steps.append(candidate.step)
        early, final = self.errors.pop(0)
        return Judged(final, early)


def settle(engine: Watched, attempt: Attempt | None = None, patient: bool = False) -> Outcome:
    return solve_to_tolerance(
        engine,
        [SCENE],
        attempt or Attempt(PROPOSAL, TOLERANCE),
        lambda run: list(run.blocks()),
        patient=patient,
    )


def quiet(truncation: float) -> ErrorBudget:
    """Return an error without amplified rounding."""
    return ErrorBudget(truncation, 0.0, 6.0)


def test_a_run_with_more_than_twice_the_error_ends_early() -> None:
    for part, attempts in ((1.9, 1), (2.1, 2)):
        script = [(quiet(part * TOLERANCE), quiet(1e-7)), (None, quiet(1e-8))]
        engine = Watched(script, [0.0])
        outcome = settle(engine)
        assert len(engine.steps) == attempts
        # The error of the run that has ended early is unknown.
        assert outcome.attempt.truncations == (math.inf,) * (attempts - 1)
        assert outcome.error.truncation == (1e-7 if attempts == 1 else 1e-8)


def test_the_last_attempt_is_complete_even_if_it_misses_its_tolerance() -> None:
    engine = Watched([(quiet(1e-3), quiet(1e-2))], [0.0])
    engine.last = True
    outcome = settle(engine)
    assert "the error is estimated at 0.01, above the tolerance" in outcome.missed
    # An attempt that repeats the best one is not judged.
    engine = Watched([(quiet(1e-3), quiet(1e-4))], [0.0])
    repeated = Attempt(PROPOSAL, TOLERANCE, repeats=True)
    outcome = settle(engine, repeated)
    assert (len(engine.steps), outcome.error.truncation) == (1, 1e-4)
    # Nor is a run with a given step.
    engine = Watched([(quiet(1e-3), quiet(1e-4))], [0.0])
    outcome = settle(engine, Attempt(PROPOSAL._replace(fixed=True), TOLERANCE))
    assert (len(engine.steps), outcome.missed, outcome.error.truncation) == (1, "", 1e-4)


def test_an_unpredictable_scene_ends_at_its_horizon() -> None:
    """A quarter of the tolerance is left for amplified rounding, unless other steps help."""
    amplified = TOLERANCE * np.array([0.0, 0.2, 0.26, 3.0, 9.0])
    early = ErrorBudget(1e-9, 9e-6, 6.0, amplified=amplified)
    engine = Watched([(early, quiet(1e-8))], [0.0])
    engine.last = True
    with pytest.raises(ToleranceNotMet, match="amplifies round-off, which may exceed") as missed:
        settle(engine)
    assert missed.value.known_until == SCENE.time[2]
    assert "the error is estimated at 9e-06, above the tolerance of 1e-06" in missed.value.reason
    # A search for the best answer continues.
    engine = Watched([(early, early)], [0.0])
    engine.last = True
    assert settle(engine, patient=True).known_until == SCENE.time[2]
    # Amplified rounding below the tolerance is no horizon.
    fine = early._replace(roundoff=0.0, amplified=TOLERANCE * np.array([0, 0.2, 0.26, 0.9, 1.0]))
    engine = Watched([(fine, quiet(1e-8))], [0.0])
    assert settle(engine).missed == ""
    # If shorter steps help, another attempt is made.
    engine = Watched([(early._replace(truncation=1e-4), None), (None, quiet(1e-8))], [0.0])
    assert len(settle(engine).attempt.truncations) == 1


def test_a_given_step_is_unpredictable_if_rounding_becomes_visible() -> None:
    for largest, known in ((0.11, SCENE.time[3]), (0.09, math.inf)):
        amplified = largest * np.array([0.0, 1e-3, 0.2, 0.5, 1.0])
        error = ErrorBudget(1e-9, 1e-3, 6.0, amplified=amplified)
        engine = Watched([(None, error)], [0.0])
        outcome = settle(engine, Attempt(PROPOSAL._replace(fixed=True), TOLERANCE))
        assert (outcome.known_until, outcome.missed) == (known, "")


def test_a_part_up_to_the_horizon_is_halved_if_it_needs_many_attempts() -> None:
    attempt = Attempt(PROPOSAL, TOLERANCE, refusal="it is chaotic", known_until=1e-5)
    misses = [(None, quiet(x)) for x in (1e-3, 1e-4, 1e-5)]
    # The third attempt that misses its tolerance is the last.
    engine = Watched([*misses, (None, quiet(1e-8))], [0.0])
    with pytest.raises(ToleranceNotMet, match="it is chaotic") as missed:
        settle(engine, attempt)
    assert (missed.value.known_until, len(engine.steps)) == (5e-6, 3)
    engine = Watched([*misses[:2], (None, quiet(1e-8))], [0.0])
    outcome = settle(engine, attempt)
    assert (outcome.missed, outcome.known_until) == ("it is chaotic", 1e-5)
    engine = Watched([*misses, (None, quiet(1e-8))], [0.0])
    assert settle(engine).missed == ""


def test_commands_of_the_user_are_named_if_a_run_fails() -> None:
    engine = Watched([(None, quiet(1e-2))], [0.0])
    engine.last, engine.suspect = True, "your commands may change the motion"
    assert settle(engine).missed.startswith("your commands may change the motion; the error is")
    engine = Watched([(None, None)], [0.0])
    engine.suspect = "your commands may change the motion"
    with pytest.raises(RunFailed, match="your commands may change the motion; it broke down"):
        settle(engine, Attempt(PROPOSAL._replace(fixed=True), TOLERANCE))


def test_an_attempt_is_repeated_unless_rounding_is_the_limit() -> None:
    better = PROPOSAL.with_steps(PROPOSAL.steps.shorten(20))
    attempt = Attempt(better, TOLERANCE, truncations=(1e-4,), best=(1e-4, PROPOSAL))
    engine = Scripted([], [0.0])
    engine.last = True
    following, missed = next_attempt(engine, SCENE, attempt, budget(1e-3, 0.9e-6))
    assert following is not None
    assert (following.proposal, following.repeats, missed) == (PROPOSAL, True, "")
    assert next_attempt(engine, SCENE, attempt, budget(1e-3, 1.1e-6))[0] is None
    # The present attempt is the best one, or it is not complete.
    assert next_attempt(engine, SCENE, attempt, budget(1e-5, 0.0))[0] is None
    assert next_attempt(engine, SCENE, attempt, budget(1e-3, 0.0), ended=False)[0] is None
    # A repeated attempt is the last.
    again = following._replace(proposal=PROPOSAL)
    assert next_attempt(engine, SCENE, again, budget(1e-4))[0] is None
    assert next_attempt(engine, SCENE, again, budget(1e-7)) == (None, "")


def test_the_time_of_compilation_belongs_to_no_attempt() -> None:
    engine = Watched([(None, quiet(1e-8))], [0.0])
    attempt = Attempt(PROPOSAL, TOLERANCE, planned_s=3.0, spent_s=5.0, compiled_s=0.25)
    cost = settle(engine, attempt).cost
    assert cost.setup_s == COST.setup_s + 3.0
    assert cost.estimate_s == COST.estimate_s + 5.0
    assert cost.compile_s == pytest.approx(0.25, abs=1e-9)


def test_long_attempts_are_refused_within_a_budget_of_time() -> None:
    """The time of earlier attempts counts; the message names the run."""
    assert not is_long(29.0)
    assert is_long(31.0)
    script = [(None, quiet(1e-8))] * 4
    for spent_s, fixed, words in (
        (9.0, False, "for a tolerance of 1e-06"),
        (9.0, True, "of the given length"),
        (6.0, False, ""),
    ):
        proposal = PROPOSAL._replace(cost_s=3.0, fixed=fixed)
        attempt = Attempt(proposal, TOLERANCE, spent_s=spent_s)
        engine = Watched(script, [0.0])
        with time_budget(10.0):
            if not words:
                assert settle(engine, attempt).missed == ""
                continue
            steps = PROPOSAL.steps.total(SCENE.intervals)
            work = f"the run by native with {steps} steps of rkn6 {words} would take about 12 s"
            with pytest.raises(TooLong, match=work):
                settle(engine, attempt)
    exact = Attempt(PROPOSAL._replace(integrator=""), TOLERANCE)
    assert exact.work(5) == "the run by native for a tolerance of 1e-06"


def test_times_in_words() -> None:
    """The unit changes where two of the larger unit are reached."""
    assert [in_words(x) for x in (0.034, 9.94, 119, 121, 7100, 7300, 172_000, 173_000, 1e7)] == [
        "0.034 s",
        "9.9 s",
        "119 s",
        "2 minutes",
        "118 minutes",
        "2 hours",
        "48 hours",
        "2 days",
        "116 days",
    ]


def test_proposals_with_other_steps_cost_in_proportion() -> None:
    proposal = PROPOSAL._replace(steps=Steps(10, 4, STEP), cost_s=2.0)
    assert proposal.with_steps(Steps(15, 1, STEP)).cost_s == pytest.approx(12.0, rel=1e-12)
    assert (proposal.price_s, proposal._replace(kept=True).price_s) == (math.inf, 2.0)
    assert proposal.possible
    assert not proposal._replace(active_grains=0).possible
    assert proposal._replace(choices={"a": "x", "b": 0.5}).record() == {"a": "x", "b": "0.5"}
    table = proposal._replace(active_grains=0, model_error=math.nan).to_json()
    assert (table["active_grains"], table["model_error"], table["cost_s"]) == (None, None, 2.0)
