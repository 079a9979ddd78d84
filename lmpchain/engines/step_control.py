"""Step control: shorter steps until the tolerance is met, or until it is clear that it cannot be.

It serves a single run, a batch of like scenes and the scenes of a sweep alike: `next_attempt`
judges an attempt from its error estimate, `solve_to_tolerance` goes from attempt to attempt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, NamedTuple, TypeVar

from ..errors import RunFailed, ToleranceNotMet
from ..scene.scene import Scene
from ..trajectory.record import LARGEST_ERROR, Cost
from ..util.arrays import Array
from ..util.compilation import clock, compiled_s
from .base import Engine, ErrorBudget, Proposal, Run
from .cost_model import check_budget, check_time, is_long


@dataclass(frozen=True)
class Patience:
    """When shorter steps are given up; analysis/calibration/chaos_test.py.

    Attributes
    ----------
    attempts : int
        Most attempts that run through.
    hopeless : float
        Rounding error over the tolerance beyond which no attempt can meet the tolerance,
    hopeless_attempts : int
        and the largest number of attempts then: shorter steps would only improve an answer that
        misses its tolerance anyway.
    breakdowns : int
        Most attempts that break down.
    stalls : int
        Attempts after which the truncation error must have fallen
    stalled : float
        to this share of what it was: one alone may be erratic, where contacts open.
    lost : float
        Error over the tolerance on the way at which an attempt is lost; analysis/lost_attempts.py.
    known : float
        Share of the tolerance that amplified rounding takes where the answer to a scene ends that
        cannot be predicted further: the shorter steps that it may need round more often.
    visible : float
        Amplified rounding, relative to the motion, beyond which a run with a given step, which has
        no tolerance, is said to be unpredictable.
    beginning : int
        Attempts at such an answer after which it ends at half the time: what amplifies rounding
        amplifies errors of steps alike, which must be as small for it to last so long.
    """

    attempts: int = 12
    hopeless: float = 1e3
    hopeless_attempts: int = 3
    breakdowns: int = 2
    stalls: int = 3
    stalled: float = 0.7
    lost: float = 2.0
    known: float = 0.25
    visible: float = 0.1
    beginning: int = 3


PATIENCE = Patience()
# what chaos leaves to know, and its call
AVERAGES = "averages over time (lmpchain.averages)"
Collected = TypeVar("Collected")  # of the blocks of a run


class Attempt(NamedTuple):
    """One attempt of several, with what the decision about the next one rests on.

    Attributes
    ----------
    proposal : Proposal
    tolerance : float
        That it is to meet.
    refusal : str
        Why that is not the one that was asked for, if it is not.
    planned_s : float
        Time spent before it on finding proposals and setting up, s.
    spent_s : float
        Time spent before it on integrations and their estimates, s.
    compiled_s : float
        Time spent before it on compilation, part of none of these, s.
    truncations : tuple of float
        Truncation errors of the attempts before it that did not break down; infinite of one that
        ended on the way, for it was lost.
    breakdowns : int
        How many did not.
    best : (float, Proposal), optional
        The least error of these attempts, and the steps that gave it.
    repeats : bool
        Whether it is this best one again, for none met the tolerance.
    known_until : float
        Time up to which the scene is answered, s, for it cannot be predicted any longer.
    """

    proposal: Proposal
    tolerance: float
    refusal: str = ""
    planned_s: float = 0.0
    spent_s: float = 0.0
    compiled_s: float = 0.0
    truncations: tuple[float, ...] = ()
    breakdowns: int = 0
    best: tuple[float, Proposal] | None = None
    repeats: bool = False
    known_until: float = math.inf

    @property
    def number(self) -> int:
        """Which attempt it is, from 1."""
        return len(self.truncations) + self.breakdowns + 1

    def work(self, samples: int) -> str:
        """Return in words what the attempt is, and why it takes its time."""
        proposal = self.proposal
        words = f"the run by {proposal.engine}"
        if proposal.integrator:
            steps = proposal.steps.total(samples - 1)
            words += f" with {steps} steps of {proposal.integrator}"
        if proposal.fixed:
            return f"{words} of the given length"
        return f"{words} for a tolerance of {self.tolerance:.2g}"


class Outcome(NamedTuple, Generic[Collected]):
    """The last attempt: what was collected from it, and why it missed the tolerance, if it did.

    Attributes
    ----------
    collected : object
        What `collect` returned.
    attempt : Attempt
    errors : list of ErrorBudget
        Of every scene.
    error : ErrorBudget
        The largest of these.
    cost : Cost
        With the planning and the attempts before.
    missed : str
        Empty if the tolerance was met, or none is enforced.
    known_until : float
        Time at which amplified round-off exceeds the tolerance, s; infinite if it never does, or if
        the answer met its tolerance.
    """

    collected: Collected
    attempt: Attempt
    errors: list[ErrorBudget]
    error: ErrorBudget
    cost: Cost
    missed: str
    known_until: float = math.inf


class _Lost(Exception):
    """An attempt that will miss its tolerance, with the one that is to follow."""

    def __init__(self, following: Attempt):
        self.following = following


def first_attempt(
    propose: Callable[[float], Proposal], tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt, from the proposal for a tolerance.

    If the tolerance is refused, `best_effort` asks for four times as much, and so on.

    Raises
    ------
    ToleranceNotMet
        If it is known beforehand that the tolerance cannot be met, or with `best_effort` that
        nothing tighter than 0.1 can.
    """
    began = clock()
    compiled = compiled_s()
    reason = ""
    while True:
        try:
            proposal = propose(tolerance)
            break
        except ToleranceNotMet as refusal:
            if tolerance > 0.1 or not best_effort:
                raise
            reason = reason or refusal.reason
            # a refusal names no tolerance that would do
            tolerance *= 4
    planned_s = clock() - began
    compiled = compiled_s() - compiled
    return Attempt(proposal, tolerance, reason, planned_s=planned_s, compiled_s=compiled)


def solve_to_tolerance(
    engine: Engine,
    scenes: Sequence[Scene],
    attempt: Attempt,
    collect: Callable[[Run], Collected],
    begin: Callable[[Attempt], Mapping[str, Array] | None] = lambda _: None,
    patient: bool = False,
) -> Outcome[Collected]:
    """Run a scene, or a batch of like ones, at ever shorter steps until the tolerance is met.

    An attempt whose estimate shows on the way that it is lost ends there.

    Parameters
    ----------
    engine : Engine
    scenes : sequence of Scene
        The parts that the engine computes. The one with the largest error decides.
    attempt : Attempt
        To begin with.
    collect : callable
        Takes a run and goes through its blocks.
    begin : callable
        Told of every attempt before it starts; returns the state to start it from, None for the
        beginning.
    patient : bool
        Whether to go on, for the best answer there is, where the first attempt shows that none
        meets the tolerance.

    Raises
    ------
    RunFailed
        If the run breaks down, at a given step or again and again.
    ToleranceNotMet
        If it is clear on the way that the scene cannot be predicted to its end, unless `patient`;
        or that the beginning of one takes too long.
    """
    compiled = compiled_s() - attempt.compiled_s
    while True:
        # A native trial, too, may need far more steps than its first attempt.
        cost_s = attempt.proposal.cost_s + attempt.spent_s
        if is_long(cost_s):
            check_budget(cost_s, attempt.work(scenes[0].samples))
        check_time()
        began = clock()
        run = engine.start(scenes, attempt.proposal, begin(attempt))
        if not attempt.proposal.fixed:
            run.judge = partial(_judge, engine, scenes[0], attempt, patient)
        errors: list[ErrorBudget] = []
        lost: Attempt | None = None
        try:
            collected = collect(run)
            errors = run.errors()
        except _Lost as verdict:
            lost = verdict.following
        except RunFailed as failure:
            # a given step is not shortened
            if attempt.proposal.fixed or attempt.breakdowns == PATIENCE.breakdowns:
                if engine.suspect:
                    raise RunFailed(f"{engine.suspect}; {failure}") from failure
                raise
        finally:
            cost = run.cost()
            run.close()
        # a batch has one step, so its worst scene decides
        error = _worst(errors) if errors else None
        following, missed = lost, ""
        if not lost:
            following, missed = next_attempt(engine, scenes[0], attempt, error, patient)
        _check_beginning(scenes[0], attempt, following, missed)
        if not following:
            assert error
            cost = cost._replace(
                setup_s=cost.setup_s + attempt.planned_s,
                estimate_s=cost.estimate_s + attempt.spent_s,
                compile_s=compiled_s() - compiled,
            )
            missed, known_s = _conclude(engine, scenes[0], attempt, error, missed)
            return Outcome(collected, attempt, errors, error, cost, missed, known_s)
        run_s = cost.integration_s + cost.estimate_s
        planned_s = attempt.planned_s + clock() - began - run_s
        attempt = following._replace(planned_s=planned_s, spent_s=attempt.spent_s + run_s)


def _check_beginning(
    scene: Scene, attempt: Attempt, following: Attempt | None, missed: str
) -> None:
    """Raise `ToleranceNotMet` if a shorter beginning of an unpredictable scene is to be solved.

    What is kept of such a scene is within the tolerance.
    """
    if attempt.known_until == math.inf:
        return
    known_s = attempt.known_until / 2
    many = following is not None and len(following.truncations) == PATIENCE.beginning
    if many or (missed and scene.until(known_s) is not scene):
        raise ToleranceNotMet(attempt.refusal, known_until=known_s)


def _conclude(
    engine: Engine, scene: Scene, attempt: Attempt, error: ErrorBudget, missed: str
) -> tuple[str, float]:
    """Return why the last attempt missed its tolerance, if so, and until when it is right, s."""
    missed = attempt.refusal or missed
    if missed and engine.suspect:
        missed = f"{engine.suspect}; {missed}"
    known_s = math.inf
    if attempt.proposal.fixed:
        known_s = _find_horizon(error, PATIENCE.visible, scene)
    elif missed:
        known_s = _find_horizon(error, attempt.tolerance, scene)
    return missed, min(known_s, attempt.known_until)


def _worst(errors: Sequence[ErrorBudget]) -> ErrorBudget:
    """Return the largest error of several scenes."""
    return max(errors, key=lambda budget: budget.solver)


def _judge(engine: Engine, scene: Scene, attempt: Attempt, patient: bool, run: Run) -> None:
    """End an attempt on the way that will miss its tolerance, if another one may meet it.

    Raises
    ------
    ToleranceNotMet
        If no step does, for rounding is amplified, and nobody wants the best answer there is.
    """
    error = _worst(run.errors())
    tolerance = attempt.tolerance
    on_course = error.solver <= PATIENCE.lost * tolerance
    if attempt.repeats or (on_course and patient):
        return
    expected = _worst(run.outlook())
    known_s = _find_horizon(expected, tolerance, scene)
    if on_course and known_s == math.inf:
        return
    helps = engine.refine(attempt.proposal, expected, tolerance)
    if known_s < math.inf and not (helps or patient):
        so_far = expected._replace(truncation=error.truncation)
        raise ToleranceNotMet(_explain(scene, so_far, attempt), known_until=known_s)
    following, _ = next_attempt(engine, scene, attempt, expected, patient, ended=False)
    if following:
        raise _Lost(following)
    # what it comes to is the answer
    run.judge = Run.judge


def next_attempt(
    engine: Engine,
    scene: Scene,
    attempt: Attempt,
    error: ErrorBudget | None,
    patient: bool = False,
    ended: bool = True,
) -> tuple[Attempt | None, str]:
    """Judge an attempt by its error, None if it broke down; expected, if it has not `ended`.

    Returns
    -------
    the next attempt, None if this was the last one; and why it missed the tolerance, empty if it
    did not
    """
    proposal = attempt.proposal
    if error is None:
        better = engine.refine(proposal, None, attempt.tolerance)
        assert better
        return attempt._replace(proposal=better, breakdowns=attempt.breakdowns + 1), ""
    if proposal.fixed or error.solver <= attempt.tolerance:
        return None, ""
    if attempt.repeats:
        return None, _explain(scene, error, attempt)
    best = attempt.best
    if ended and (best is None or error.solver < best[0]):
        best = error.solver, proposal
    truncation = error.truncation if ended else math.inf
    attempt = attempt._replace(truncations=(*attempt.truncations, truncation), best=best)
    better = None if _stalls(attempt) else _shorten(engine, attempt, error, patient)
    if better:
        return attempt._replace(proposal=better), ""
    if ended and best and _is_worth_repeating(best[1], proposal, error, attempt.tolerance):
        return attempt._replace(proposal=best[1], repeats=True), ""
    return None, _explain(scene, error, attempt)


def _is_worth_repeating(
    best: Proposal, proposal: Proposal, error: ErrorBudget, tolerance: float
) -> bool:
    """Return whether an earlier attempt is run again: samples of one run alone are held.

    Shorter steps may have been worse by chance; where rounding is the limit, the shortest are right
    for longest.
    """
    return best != proposal and error.roundoff <= tolerance


def _shorten(
    engine: Engine, attempt: Attempt, error: ErrorBudget, patient: bool
) -> Proposal | None:
    """Return shorter steps, for the tolerance or the best that rounding leaves; None if none help.

    Where rounding alone is too much, a patient user gets what is right as long as round-off allows,
    and others an error that is no more than three times that of rounding: distances of runs, which
    count twice, are themselves as large as rounding there. If rounding exceeds the tolerance by
    far, others get the best of few attempts.
    """
    proposal = attempt.proposal
    tolerance = attempt.tolerance
    better = engine.refine(proposal, error, tolerance)
    floor = tolerance if patient else max(tolerance, 2 * error.roundoff)
    hopeless = error.roundoff > PATIENCE.hopeless * tolerance
    last = hopeless and len(attempt.truncations) >= PATIENCE.hopeless_attempts
    if better is None and error.truncation > floor and (patient or not last):
        better = engine.refine(proposal, error._replace(roundoff=0.0), floor)
    return better


def _stalls(attempt: Attempt) -> bool:
    """Say whether shorter steps hardly make the error smaller, or there were many attempts."""
    truncations = attempt.truncations
    if len(truncations) <= PATIENCE.stalls:
        return False
    # of several attempts, for one alone may be erratic
    stalls = truncations[-1] > PATIENCE.stalled * truncations[-1 - PATIENCE.stalls]
    return stalls or len(truncations) == PATIENCE.attempts


def _explain(scene: Scene, error: ErrorBudget, attempt: Attempt) -> str:
    """Return why an attempt missed its tolerance, and the cure."""
    tolerance = attempt.tolerance
    solver = error.estimate.solver
    unknown = " (nothing is known)" if solver == LARGEST_ERROR else ""
    above = f"{unknown}, above the tolerance of {tolerance:.2g}"
    reason = f"the error is estimated at {solver:.2g}{above}"
    if len(attempt.truncations) == PATIENCE.attempts:
        reason += f", after {PATIENCE.attempts} attempts at ever shorter steps"
    elif _stalls(attempt):
        reason += f", and steps shorter than {attempt.proposal.step:.2g} s do not help"
    if error.roundoff > tolerance / 2:
        reason += f", for round-off alone may make {min(error.roundoff, LARGEST_ERROR):.2g}"
    time_s = _find_horizon(error, tolerance, scene)
    if time_s == math.inf:
        return f"{reason}: ask for less"
    return (
        f"{reason}: this scene amplifies round-off, which may exceed the tolerance at "
        f"t = {time_s:.4g} s; record up to there, ask for less, or take {AVERAGES}"
    )


def _find_horizon(error: ErrorBudget, tolerance: float, scene: Scene) -> float:
    """Return until when amplified round-off leaves room for other errors, s; infinite if always."""
    if error.amplified.max(initial=0.0) <= tolerance:
        return math.inf
    # from the beginning on it is rounding as it is, and no later time is to be named
    return error.last_known(PATIENCE.known * tolerance, scene.time) or math.inf
