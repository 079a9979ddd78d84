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
GIVEN = Attempt(PROPOSAL._replace(fixed=True), TOLERANCE)
COST = Cost(1.0, 0.5, 0.25, 40, 280, 8, "rkn6", STEP, 1)


def budget(truncation: float, roundoff: float = 1e-15) -> ErrorBudget:
    """Return an error whose amplified rounding reaches it from the third of five samples on."""
    amplified = roundoff * np.array([0.0, 1e-9, 1.0, 1.0, 1.0])
    return ErrorBudget(truncation, roundoff, 6.0, amplified=amplified)


def quiet(truncation: float) -> ErrorBudget:
    """Return an error without amplified rounding."""
    return ErrorBudget(truncation, 0.0, 6.0)


class Scripted(Engine):
    """An engine whose runs take 1.75 s and have given errors, None for one that breaks down.

    A run with a pair of errors is judged once, with the first of them, before its end.
    """

    name = "native"
    equation = 1

    def __init__(self, *errors: Any, last: bool = False):
        self.errors = list(errors)
        self.steps: list[float] = []
        self.last = last
        self.now = 0.0

    def refuses(self, scene):
        return []

    def propose(self, scene, tolerance):
        return PROPOSAL

    def refine(self, candidate, error, tolerance):
        """Halve the step, unless it was the last attempt."""
        steps = candidate.steps
        return None if self.last else candidate.with_steps(steps.shorten(2 * steps.per_landing))

    def start(self, scenes, candidate, state=None):
        self.steps.append(candidate.step)
        return ScriptedRun(self, self.errors.pop(0), len(scenes))

    def describe(self, scene, candidate):
        return {}


class ScriptedRun(Run):
    """A run without samples."""

    progress = 1.0

    def __init__(self, engine: Scripted, error: Any, size: int):
        self.engine = engine
        self.size = size
        self.judged = type(error) is tuple
        self.error, self.final = error if self.judged else (error, error)

    def blocks(self) -> Iterator[Any]:
        """Spend the time of the run, and let step control judge it if it has two errors."""
        if self.judged:
            self.judge(self)
        self.engine.now += 1.75
        self.error = self.final
        if self.error is None:
            raise RunFailed("it broke down")
        yield from ()

    def errors(self):
        """Return the error so far, or at the end, for each scene."""
        return self.error if isinstance(self.error, list) else [self.error] * self.size

    def outlook(self):
        """Return an error that has grown by ten."""
        (error,) = self.errors()
        return [error._replace(truncation=10 * error.truncation)]

    def cost(self):
        return COST

    def state(self):
        return {}


def solve(engine: Scripted, attempt: Attempt | None = None, scenes=(SCENE,), **options) -> Outcome:
    attempt = attempt or Attempt(PROPOSAL, TOLERANCE)
    return solve_to_tolerance(
        engine, list(scenes), attempt, lambda run: list(run.blocks()), **options
    )


def test_steps_shorten_until_the_tolerance_is_met(monkeypatch: pytest.MonkeyPatch):
    """The estimate includes the cost of earlier attempts, the setup the time between them."""
    engine = Scripted(budget(1e-3), budget(1e-5), budget(1e-6 - 2e-15))
    monkeypatch.setattr(step_control, "clock", lambda: engine.now)
    outcome = solve(engine, Attempt(PROPOSAL, TOLERANCE, planned_s=0.125))
    assert engine.steps == pytest.approx([STEP, STEP / 2, STEP / 4], rel=1e-12)
    assert outcome.missed == ""
    assert outcome.error.truncation == 1e-6 - 2e-15
    assert outcome.attempt.truncations == (1e-3, 1e-5)
    assert outcome.attempt.number == 3
    assert (outcome.cost.integration_s, outcome.cost.steps) == (1.0, 40)
    assert outcome.cost.estimate_s == pytest.approx(0.5 + 2 * 1.5, rel=1e-12)
    assert outcome.cost.setup_s == pytest.approx(0.25 + 0.125 + 2 * 0.25, rel=1e-12)


def test_the_worst_of_several_scenes_decides():
    engine = Scripted([budget(1e-9), budget(1e-4)], [budget(1e-9), budget(2e-9)])
    outcome = solve(engine, scenes=(SCENE, SCENE))
    assert [error.truncation for error in outcome.errors] == [1e-9, 2e-9]
    assert outcome.error.truncation == 2e-9
    assert len(engine.steps) == 2


def test_a_breakdown_is_retried_three_times():
    assert solve(Scripted(None, None, budget(1e-9))).attempt.number == 3
    for attempt, count in ((None, 3), (GIVEN, 1)):
        engine = Scripted(None, None, None, budget(1e-9))
        with pytest.raises(RunFailed, match="it broke down"):
            solve(engine, attempt)
        assert len(engine.steps) == count


def test_a_limit_by_rounding_is_reported_with_its_time():
    reason = (
        "the error is estimated at 3.3e-06, above the tolerance of 1e-06, "
        "because round-off alone may make an error of 3.3e-06: "
    )
    chaos = (
        f"this scene amplifies round-off, which may exceed the tolerance at t = {SCENE.time[2]:.4g}"
        " s; record up to this time, use a larger tolerance, or take averages over time "
        "(lmpchain.averages)"
    )
    error = budget(2e-9, 3.3e-6)
    plain = error._replace(amplified=np.zeros(0))
    for each, cure in ((error, chaos), (plain, "use a larger tolerance")):
        assert solve(Scripted(each, last=True)).missed == f"{reason}{cure}"


def test_three_attempts_without_improvement_end_the_search():
    """The second of four attempts is the best by chance; it is repeated after being discarded."""
    engine = Scripted(*map(budget, (9e-3, 1e-3, 8e-3, 6.4e-3, 1e-3)))
    outcome = solve(engine)
    assert len(engine.steps) == 5
    assert outcome.missed == (
        "the error is estimated at 0.001, above the tolerance of 1e-06, and steps shorter than "
        "5e-08 s do not help: use a larger tolerance"
    )
    assert outcome.error.truncation == 1e-3
    assert engine.steps[-1] == engine.steps[1] == outcome.attempt.proposal.step


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


def test_three_attempts_with_improvement_do_not_end_the_search():
    """The error decreases by more than three tenths in three attempts, even if irregularly."""
    for errors in ([9e-3 * 0.88**n for n in range(7)], [1e-3, 2e-3, 1e-3, 6.9e-4]):
        assert solve(Scripted(*map(budget, errors), budget(1e-8))).missed == ""
    engine = Scripted(*(budget(9e-3 * 0.69**n) for n in range(20)))
    outcome = solve(engine)
    assert len(engine.steps) == 12
    assert outcome.missed.endswith(
        "after 12 attempts with ever shorter steps: use a larger tolerance"
    )


def test_the_best_possible_result_is_returned_on_request():
    """Steps shorten until all errors but rounding, which is too large, meet the tolerance."""
    engine = Native("rkn6")
    attempt = Attempt(engine.propose(SCENE, 1e-6), 1e-6)
    for truncation in (1e-2, 1e-4, 2e-6, 1e-7):
        error = budget(truncation, 3e-6)
        # Other searches continue while the truncation error can be reduced.
        further = next_attempt(engine, SCENE, attempt, error)[0]
        assert (further is not None) == (error.truncation > error.roundoff)
        following, missed = next_attempt(engine, SCENE, attempt, error, patient=True)
        if truncation > 1e-6:
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


def test_a_run_with_more_than_twice_the_error_ends_early() -> None:
    for part, attempts in ((1.9, 1), (2.1, 2)):
        engine = Scripted((quiet(part * TOLERANCE), quiet(1e-7)), quiet(1e-8))
        outcome = solve(engine)
        assert len(engine.steps) == attempts
        # The error of the run that has ended early is unknown.
        assert outcome.attempt.truncations == (math.inf,) * (attempts - 1)
        assert outcome.error.truncation == (1e-7 if attempts == 1 else 1e-8)


def test_the_last_attempt_is_complete_even_if_it_misses_its_tolerance() -> None:
    outcome = solve(Scripted((quiet(1e-3), quiet(1e-2)), last=True))
    assert "the error is estimated at 0.01, above the tolerance" in outcome.missed
    # An attempt that repeats the best one is not judged, nor is a run with a given step.
    for attempt in (Attempt(PROPOSAL, TOLERANCE, repeats=True), GIVEN):
        engine = Scripted((quiet(1e-3), quiet(1e-4)))
        outcome = solve(engine, attempt)
        assert (len(engine.steps), outcome.error.truncation) == (1, 1e-4)
        assert (outcome.missed == "") == (attempt is GIVEN)


def test_an_unpredictable_scene_ends_at_its_horizon() -> None:
    """A quarter of the tolerance is left for amplified rounding, unless other steps help."""
    amplified = TOLERANCE * np.array([0.0, 0.2, 0.26, 3.0, 9.0])
    early = ErrorBudget(1e-9, 9e-6, 6.0, amplified=amplified)
    with pytest.raises(ToleranceNotMet, match="amplifies round-off, which may exceed") as missed:
        solve(Scripted((early, quiet(1e-8)), last=True))
    assert missed.value.known_until == SCENE.time[2]
    assert "the error is estimated at 9e-06, above the tolerance of 1e-06" in missed.value.reason
    # A search for the best answer continues.
    assert solve(Scripted((early, early), last=True), patient=True).known_until == SCENE.time[2]
    # Amplified rounding below the tolerance is no horizon.
    fine = early._replace(roundoff=0.0, amplified=TOLERANCE * np.array([0, 0.2, 0.26, 0.9, 1.0]))
    assert solve(Scripted((fine, quiet(1e-8)))).missed == ""
    # If shorter steps help, another attempt is made.
    helped = solve(Scripted((early._replace(truncation=1e-4), None), quiet(1e-8)))
    assert len(helped.attempt.truncations) == 1


def test_a_given_step_is_unpredictable_if_rounding_becomes_visible() -> None:
    for largest, known in ((0.11, SCENE.time[3]), (0.09, math.inf)):
        amplified = largest * np.array([0.0, 1e-3, 0.2, 0.5, 1.0])
        outcome = solve(Scripted(ErrorBudget(1e-9, 1e-3, 6.0, amplified=amplified)), GIVEN)
        assert (outcome.known_until, outcome.missed) == (known, "")


def test_a_part_up_to_the_horizon_is_halved_if_it_needs_many_attempts() -> None:
    attempt = Attempt(PROPOSAL, TOLERANCE, refusal="it is chaotic", known_until=1e-5)
    errors = [quiet(x) for x in (1e-3, 1e-4, 1e-5, 1e-8)]
    # The third attempt that misses its tolerance is the last.
    engine = Scripted(*errors)
    with pytest.raises(ToleranceNotMet, match="it is chaotic") as missed:
        solve(engine, attempt)
    assert (missed.value.known_until, len(engine.steps)) == (5e-6, 3)
    outcome = solve(Scripted(*errors[:2], errors[3]), attempt)
    assert (outcome.missed, outcome.known_until) == ("it is chaotic", 1e-5)
    assert solve(Scripted(*errors)).missed == ""


def test_commands_of_the_user_are_named_if_a_run_fails() -> None:
    engine = Scripted(quiet(1e-2), None, last=True)
    engine.suspect = "your commands may change the motion"
    assert solve(engine).missed.startswith("your commands may change the motion; the error is")
    with pytest.raises(RunFailed, match="your commands may change the motion; it broke down"):
        solve(engine, GIVEN)


def test_an_attempt_is_repeated_unless_rounding_is_the_limit() -> None:
    better = PROPOSAL.with_steps(PROPOSAL.steps.shorten(20))
    attempt = Attempt(better, TOLERANCE, truncations=(1e-4,), best=(1e-4, PROPOSAL))
    engine = Scripted(last=True)
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
    attempt = Attempt(PROPOSAL, TOLERANCE, planned_s=3.0, spent_s=5.0, compiled_s=0.25)
    cost = solve(Scripted(quiet(1e-8)), attempt).cost
    assert cost.setup_s == COST.setup_s + 3.0
    assert cost.estimate_s == COST.estimate_s + 5.0
    assert cost.compile_s == pytest.approx(0.25, abs=1e-9)


def test_long_attempts_are_refused_within_a_budget_of_time() -> None:
    """The time of earlier attempts counts; the message names the run."""
    assert not is_long(29.0)
    assert is_long(31.0)
    steps = PROPOSAL.steps.total(SCENE.intervals)
    for fixed, words in ((False, "for a tolerance of 1e-06"), (True, "of the given length")):
        proposal = PROPOSAL._replace(cost_s=3.0, fixed=fixed)
        attempt = Attempt(proposal, TOLERANCE, spent_s=9.0)
        work = f"the run by native with {steps} steps of rkn6 {words} would take about 12 s"
        with time_budget(10.0), pytest.raises(TooLong, match=work):
            solve(Scripted(), attempt)
        with time_budget(10.0):
            assert solve(Scripted(quiet(1e-8)), attempt._replace(spent_s=6.0)).missed == ""
    exact = Attempt(PROPOSAL._replace(integrator=""), TOLERANCE)
    assert exact.work(5) == "the run by native for a tolerance of 1e-06"


def test_times_in_words() -> None:
    """The unit changes where two of the larger unit are reached."""
    times = (0.034, 9.94, 119, 121, 7100, 7300, 172_000, 173_000, 1e7)
    words = "0.034 s, 9.9 s, 119 s, 2 minutes, 118 minutes, 2 hours, 48 hours, 2 days, 116 days"
    assert ", ".join(map(in_words, times)) == words


def test_proposals_with_other_steps_cost_in_proportion() -> None:
    proposal = PROPOSAL._replace(steps=Steps(10, 4, STEP), cost_s=2.0)
    assert proposal.with_steps(Steps(15, 1, STEP)).cost_s == pytest.approx(12.0, rel=1e-12)
    assert (proposal.price_s, proposal._replace(kept=True).price_s) == (math.inf, 2.0)
    assert proposal.possible
    assert not proposal._replace(active_grains=0).possible
    assert proposal._replace(choices={"a": "x", "b": 0.5}).record() == {"a": "x", "b": "0.5"}
    table = proposal._replace(active_grains=0, model_error=math.nan).to_json()
    assert (table["active_grains"], table["model_error"], table["cost_s"]) == (None, None, 2.0)
