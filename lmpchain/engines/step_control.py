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
from ..trajectory.record import Cost
from ..util.arrays import Array
from ..util.compilation import clock, compiled_s
from .base import Candidate, Engine, ErrorBudget, Run


@dataclass(frozen=True)
class Patience:
    """When shorter steps are given up; analysis/calibration/chaos_test.py.

    Attributes
    ----------
    attempts : int
        Most attempts that run through.
    breakdowns : int
        Most attempts that break down.
    stalls : int
        Attempts after which the truncation error must have fallen
    stalled : float
        to this share of what it was: one alone may be erratic, where contacts open.
    """

    attempts: int = 12
    breakdowns: int = 2
    stalls: int = 3
    stalled: float = 0.7


PATIENCE = Patience()
# what chaos leaves to know, and its call
AVERAGES = "averages over time (lmpchain.averages)"
Collected = TypeVar("Collected")  # of the blocks of a run
Proposed = TypeVar("Proposed")


class Attempt(NamedTuple):
    """One attempt of several, with what the decision about the next one rests on.

    Attributes
    ----------
    engine : str
        Its name.
    candidate : Candidate
    tolerance : float
        That it is to meet.
    refusal : str
        Why that is not the one that was asked for, if it is not.
    planned_s : float
        Time spent before it on finding candidates and setting up, s.
    spent_s : float
        Time spent before it on integrations and their estimates, s.
    compiled_s : float
        Time spent before it on compilation, part of none of these, s.
    truncations : tuple of float
        Truncation errors of the attempts before it that ran through.
    breakdowns : int
        How many did not.
    best : (float, Candidate), optional
        The least error of these attempts, and the steps that gave it.
    repeats : bool
        Whether it is this best one again, for none met the tolerance.
    """

    engine: str
    candidate: Candidate
    tolerance: float
    refusal: str = ""
    planned_s: float = 0.0
    spent_s: float = 0.0
    compiled_s: float = 0.0
    truncations: tuple[float, ...] = ()
    breakdowns: int = 0
    best: tuple[float, Candidate] | None = None
    repeats: bool = False

    @property
    def number(self) -> int:
        """Which attempt it is, from 1."""
        return len(self.truncations) + self.breakdowns + 1


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


def first_attempt(
    engine: Engine, scene: Scene, tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt; `best_effort` loosens a tolerance that the engine refuses.

    Raises
    ------
    ToleranceNotMet
        If the engine knows beforehand that it cannot meet the tolerance.
    """
    began = clock()
    compiled = compiled_s()
    propose = partial(engine.candidate, scene)
    candidate, tolerance, refusal = loosen(propose, tolerance, best_effort)
    planned_s = clock() - began
    compiled = compiled_s() - compiled
    return Attempt(
        engine.name, candidate, tolerance, refusal, planned_s=planned_s, compiled_s=compiled
    )


def run_to_tolerance(
    engine: Engine, scene: Scene, tolerance: float, collect: Callable[[Run], Collected]
) -> Outcome[Collected]:
    """Solve a scene from the first attempt on; see `solve_to_tolerance`."""
    return solve_to_tolerance(engine, [scene], first_attempt(engine, scene, tolerance), collect)


def solve_to_tolerance(
    engine: Engine,
    scenes: Sequence[Scene],
    attempt: Attempt,
    collect: Callable[[Run], Collected],
    begin: Callable[[Attempt], Mapping[str, Array] | None] = lambda _: None,
    patient: bool = False,
) -> Outcome[Collected]:
    """Run a scene, or a batch of like ones, at ever shorter steps until the tolerance is met.

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
    """
    compiled = compiled_s() - attempt.compiled_s
    while True:
        began = clock()
        run = engine.start(scenes, attempt.candidate, begin(attempt))
        errors: list[ErrorBudget] = []
        try:
            collected = collect(run)
            errors = run.errors()
        except RunFailed as failure:
            # a given step is not shortened
            if attempt.candidate.fixed or attempt.breakdowns == PATIENCE.breakdowns:
                if engine.suspect:
                    raise RunFailed(f"{engine.suspect}; {failure}") from failure
                raise
        finally:
            cost = run.cost()
            run.close()
        # a batch has one step, so its worst scene decides
        error = max(errors, key=lambda budget: budget.solver) if errors else None
        following, missed = next_attempt(engine, scenes[0], attempt, error, patient)
        if not following:
            assert error
            cost = cost._replace(
                setup_s=cost.setup_s + attempt.planned_s,
                estimate_s=cost.estimate_s + attempt.spent_s,
                compile_s=compiled_s() - compiled,
            )
            missed = attempt.refusal or missed
            if missed and engine.suspect:
                missed = f"{engine.suspect}; {missed}"
            known_s = math.inf
            if missed or attempt.candidate.fixed:
                known_s = _known_until(error, attempt.tolerance, scenes[0])
            return Outcome(collected, attempt, errors, error, cost, missed, known_s)
        run_s = cost.integration_s + cost.estimate_s
        planned_s = attempt.planned_s + clock() - began - run_s
        attempt = following._replace(planned_s=planned_s, spent_s=attempt.spent_s + run_s)


def next_attempt(
    engine: Engine,
    scene: Scene,
    attempt: Attempt,
    error: ErrorBudget | None,
    patient: bool = False,
) -> tuple[Attempt | None, str]:
    """Judge an attempt by its error, None if it broke down.

    Returns
    -------
    the next attempt, None if this was the last one; and why it missed the tolerance, empty if it
    did not
    """
    candidate = attempt.candidate
    if error is None:
        better = engine.refine(candidate, None, attempt.tolerance)
        assert better
        return attempt._replace(candidate=better, breakdowns=attempt.breakdowns + 1), ""
    if candidate.fixed or error.solver <= attempt.tolerance:
        return None, ""
    if attempt.repeats:
        return None, _explain(scene, error, attempt)
    best = attempt.best
    if best is None or error.solver < best[0]:
        best = error.solver, candidate
    attempt = attempt._replace(truncations=(*attempt.truncations, error.truncation), best=best)
    better = None if _stalls(attempt) else _shorten(engine, attempt, error, patient)
    if better:
        return attempt._replace(candidate=better), ""
    if best[1] != candidate and error.roundoff <= attempt.tolerance:
        # shorter steps may have been worse by chance, and samples of one run alone are held; where
        # rounding is the limit, the shortest are right for longest
        return attempt._replace(candidate=best[1], repeats=True), ""
    return None, _explain(scene, error, attempt)


def _shorten(
    engine: Engine, attempt: Attempt, error: ErrorBudget, patient: bool
) -> Candidate | None:
    """Return shorter steps, for the tolerance or the best that rounding leaves; None if none help.

    Where rounding alone is too much, a patient user gets what is right as long as round-off allows,
    and others an error that is no more than twice that of rounding.
    """
    candidate = attempt.candidate
    tolerance = attempt.tolerance
    better = engine.refine(candidate, error, tolerance)
    floor = tolerance if patient else max(tolerance, error.roundoff)
    if better is None and error.truncation > floor:
        better = engine.refine(candidate, error._replace(roundoff=0.0), floor)
    return better


def loosen(
    propose: Callable[[float], Proposed], tolerance: float, best_effort: bool = True
) -> tuple[Proposed, float, str]:
    """Return the proposal for a tolerance; by `best_effort`, for a looser one that can be met.

    Returns
    -------
    the proposal, the tolerance it is for, and why the one asked for was refused (empty if it was
    not)

    Raises
    ------
    ToleranceNotMet
        If nothing tighter than 0.1 can be met, or not even this tolerance without `best_effort`.
    """
    reason = ""
    while True:
        try:
            return propose(tolerance), tolerance, reason
        except ToleranceNotMet as refusal:
            if tolerance > 0.1 or not best_effort:
                raise
            reason = reason or refusal.reason
            # a refusal names no tolerance that would do
            tolerance *= 4


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
    reason = f"the error is estimated at {error.solver:.2g}, above the tolerance of {tolerance:.2g}"
    if len(attempt.truncations) == PATIENCE.attempts:
        reason += f", after {PATIENCE.attempts} attempts at ever shorter steps"
    elif _stalls(attempt):
        reason += f", and steps shorter than {attempt.candidate.step:.2g} s do not help"
    if error.roundoff > tolerance / 2:
        reason += f", for round-off alone may make {error.roundoff:.2g}"
    time_s = _known_until(error, tolerance, scene)
    if time_s == math.inf:
        return f"{reason}: ask for less"
    return (
        f"{reason}: this scene amplifies round-off, which may exceed the tolerance at "
        f"t = {time_s:.4g} s; record up to there, ask for less, or take {AVERAGES}"
    )


def _known_until(error: ErrorBudget, tolerance: float, scene: Scene) -> float:
    """Return when amplified round-off takes half the tolerance, s; infinite if it never does."""
    if error.amplified.max(initial=0.0) <= tolerance:
        return math.inf
    # from the beginning on it is rounding as it is, and no later time is to be named
    return error.last_known(tolerance / 2, scene.time) or math.inf
