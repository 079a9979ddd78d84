"""Step control: shorter steps until the tolerance is met, or until it is clear that it cannot be.

It serves a single run, a batch of like scenes and the scenes of a sweep alike: `next_attempt` judges an attempt from
its error estimate, `solve_to_tolerance` goes from attempt to attempt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from ..errors import RunFailed, ToleranceNotMet
from ..integrators.methods import METHODS
from ..scene.scene import Scene
from ..trajectory.record import Cost
from ..util.arrays import Array
from ..util.compilation import clock, compiled_s
from .amplification import COARSE, LAST_DIGIT, walked
from .base import Candidate, Engine, ErrorBudget, Run
from .perturbation import divergence

# analysis/calibration/chaos_test.py measures these
ATTEMPTS = 12
STALLS = 2  # attempts in a row that do not help: round-off or chaos, not the step, is the limit
STALLED = 0.7  # truncation error over that of the attempt before, from which on it is no help
WORSE = 2.0  # the same from which on shorter steps may have made it worse, by rounding
# test for chaos if one of the first attempts misses by so many tolerances or so much: two runs one ulp apart at t = 0
# must diverge by so many tolerances; of 290 random scenes, 250 of which can be answered, none of these did
CHAOS_MISS, CHAOS_ERROR, CHAOS_DIVERGENCE, SUSPECT = 1e4, 0.3, 10.0, 2
ERRATIC = 1e5  # truncation over round-off: an estimate that stalls above that is erratic, or the scene is chaotic
ROUNDING_ULPS = (
    30.0  # rounding all along a run does as much as a change of up to so many ulps at t = 0
)
ENOUGH = 3e5  # steps that show what a scene makes of a last digit
T = TypeVar("T")


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
    pilot : bool
        Whether it is one at longer steps that shows which steps the next one needs.
    pilots : int
        How many of these came before.
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
    pilot: bool = False
    pilots: int = 0

    @property
    def number(self) -> int:
        """Which attempt it is, from 1."""
        return len(self.truncations) + self.breakdowns + self.pilots + 1


class Outcome(NamedTuple, Generic[T]):
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
    """

    collected: T
    attempt: Attempt
    errors: list[ErrorBudget]
    error: ErrorBudget
    cost: Cost
    missed: str


def first_attempt(
    engine: Engine, scene: Scene, tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt; `best_effort` loosens a tolerance that the engine refuses.

    Raises
    ------
    ToleranceNotMet
        If the engine knows beforehand that it cannot meet the tolerance.
    """
    began, compiled, refusal = clock(), compiled_s(), ""
    if best_effort:
        candidate, tolerance, refusal = loosened(partial(engine.candidate, scene), tolerance)
    else:
        candidate = engine.candidate(scene, tolerance)
    return to_begin_with(
        engine, scene, candidate, tolerance, refusal, clock() - began, compiled_s() - compiled
    )


def to_begin_with(
    engine: Engine,
    scene: Scene,
    candidate: Candidate,
    tolerance: float,
    refusal: str = "",
    planned_s: float = 0.0,
    compiled_s: float = 0.0,
) -> Attempt:
    """Return the attempt to begin with where a candidate was chosen: that, or a pilot; see `Attempt`."""
    first = engine.pilot(scene, candidate, tolerance)
    pilot = first is not candidate
    return Attempt(
        engine.name, first, tolerance, refusal, planned_s, compiled_s=compiled_s, pilot=pilot
    )


def run_to_tolerance(
    engine: Engine, scene: Scene, tolerance: float, collect: Callable[[Run], T]
) -> Outcome[T]:
    """Solve a scene from the first attempt on; see `solve_to_tolerance`."""
    return solve_to_tolerance(engine, [scene], first_attempt(engine, scene, tolerance), collect)


def solve_to_tolerance(
    engine: Engine,
    scenes: Sequence[Scene],
    attempt: Attempt,
    collect: Callable[[Run], T],
    begin: Callable[[Attempt], Mapping[str, Array] | None] = lambda _: None,
    patient: bool = False,
) -> Outcome[T]:
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
        Told of every attempt before it starts; returns the state to start it from, None for the beginning.
    patient : bool
        Whether to go on, for the best answer there is, where the first attempt shows that none meets the tolerance.

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
        except RunFailed:
            if attempt.candidate.fixed or attempt.breakdowns == STALLS:
                raise
        finally:
            cost = run.cost()
            run.close()
        place = max(range(len(errors)), key=lambda i: errors[i].solver) if len(errors) > 1 else 0
        error, judged = errors[place] if errors else None, clock()
        following, missed = next_attempt(engine, scenes[place], attempt, error, patient)
        judging_s = clock() - judged  # an integration, where chaos is tested for
        if not following:
            assert error
            setup_s, estimate_s = (
                cost.setup_s + attempt.planned_s,
                cost.estimate_s + attempt.spent_s + judging_s,
            )
            cost = cost._replace(
                setup_s=setup_s, estimate_s=estimate_s, compile_s=compiled_s() - compiled
            )
            return Outcome(collected, attempt, errors, error, cost, attempt.refusal or missed)
        run_s = cost.integration_s + cost.estimate_s + judging_s
        planned_s = clock() - began - run_s
        spent_s = attempt.spent_s + run_s
        attempt = following._replace(planned_s=attempt.planned_s + planned_s, spent_s=spent_s)


def next_attempt(
    engine: Engine, scene: Scene, attempt: Attempt, error: ErrorBudget | None, patient: bool = False
) -> tuple[Attempt | None, str]:
    """Judge an attempt by its error, None if it broke down.

    Returns
    -------
    the next attempt, None if this was the last one; and why it missed the tolerance, empty if it did not
    """
    candidate = attempt.candidate
    if error and (candidate.fixed or error.solver <= attempt.tolerance):
        return None, ""
    better = engine.refine(candidate, error, attempt.tolerance)
    if attempt.pilot and better:
        return attempt._replace(candidate=better, pilot=False, pilots=1), ""
    if error is None:
        assert better
        return attempt._replace(candidate=better, breakdowns=attempt.breakdowns + 1), ""
    made = attempt._replace(truncations=(*attempt.truncations, error.truncation))
    missed = _why_not(scene, error, made, better) or (
        "" if patient else _chaotic(scene, error, made)
    )
    if missed:
        return None, missed
    assert better
    return made._replace(candidate=better), ""


def loosened(propose: Callable[[float], T], tolerance: float) -> tuple[T, float, str]:
    """Return what is proposed for a tolerance, or for a looser one while `ToleranceNotMet` is raised.

    Returns
    -------
    the proposal, the tolerance it is for, and why the one asked for was refused (empty if it was not)

    Raises
    ------
    ToleranceNotMet
        If nothing tighter than 0.1 can be met.
    """
    reason = ""
    while True:
        try:
            return propose(tolerance), tolerance, reason
        except ToleranceNotMet as refusal:
            if tolerance > 0.1:
                raise
            reason = reason or refusal.reason
            tolerance *= 4


def _why_not(scene: Scene, error: ErrorBudget, attempt: Attempt, better: Candidate | None) -> str:
    """Return why shorter steps will not help after this attempt, or nothing if they may.

    An estimate that does not fall may be erratic, where contacts open, or show that rounding has grown to that size.
    """
    tolerance, truncations = attempt.tolerance, attempt.truncations
    recent = truncations[-STALLS - 1 :]
    worse = len(recent) > 1 and recent[-1] > WORSE * recent[-2]
    stalled = len(recent) > STALLS and all(b > STALLED * a for a, b in pairwise(recent))
    if better and not stalled and not worse and len(truncations) < ATTEMPTS:
        return ""
    rounding = better is None or (stalled and error.truncation < ERRATIC * error.roundoff)
    rounding = (
        rounding
        or _divergence_time(scene, attempt.candidate, tolerance / _ulps(scene, attempt)) is not None
    )
    if not rounding and len(truncations) < ATTEMPTS:
        return ""
    reason = (
        f"the error is estimated at {error.solver:.2g}, above the tolerance of {tolerance:.2g}, and steps shorter than "
        f"{attempt.candidate.step:.2g} s do not help"
    )
    if better is None:
        reason += f", for round-off alone makes {error.roundoff:.2g}"
    time_s = error.first_beyond(tolerance, scene.time)
    known = rounding and time_s < float("inf")
    return f"{reason}: {_amplifies(time_s)}" if known else f"{reason}: ask for less"


def _ulps(scene: Scene, attempt: Attempt) -> float:
    """Return how many last digits at t = 0 do as much as rounding all along a run."""
    candidate = attempt.candidate
    steps = candidate.steps(scene.samples)
    evaluations = METHODS[candidate.integrator].evaluations if candidate.integrator else 0
    return max(ROUNDING_ULPS, walked(steps * evaluations, alike=not candidate.adaptive))


def _chaotic(scene: Scene, error: ErrorBudget, attempt: Attempt) -> str:
    """Return why no step will help, if one of the first attempts shows chaos, or nothing."""
    tolerance = attempt.tolerance
    suspect = error.truncation > min(CHAOS_MISS * tolerance, CHAOS_ERROR)
    if len(attempt.truncations) > SUSPECT or not suspect:
        return ""
    time_s = _divergence_time(scene, attempt.candidate, tolerance, CHAOS_DIVERGENCE)
    if time_s is None:
        return ""
    return f"the error is estimated at {error.solver:.2g}, above the tolerance of {tolerance:.2g}: {_amplifies(time_s)}"


def _divergence_time(
    scene: Scene, candidate: Candidate, distance: float, times: float = 1.0
) -> float | None:
    """Return when two runs one ulp apart at t = 0 reach a distance, s, if they diverge to `times` it.

    Two runs may differ in where their steps shorten, so in more than the scene makes of an ulp; at steps of one length
    they are the same map, but further off. Both pairs must diverge.
    """
    if not candidate.integrator:
        return None
    enough = max(ENOUGH, scene.duration * scene.highest_frequency / COARSE) / candidate.steps(
        scene.samples
    )
    if enough < 1:
        candidate = candidate.with_steps(math.ceil(candidate.steps_per_landing * enough))
    time_s = scene.duration
    for adaptive in {candidate.adaptive, False}:
        try:
            apart = divergence(scene, candidate.sampled._replace(adaptive=adaptive), LAST_DIGIT)
        except RunFailed:
            return None
        if apart.max() < times * distance:
            return None
        time_s = min(time_s, float(scene.time[np.argmax(apart > distance)]))
    return time_s


def _amplifies(time_s: float) -> str:
    return (
        f"this scene amplifies round-off beyond the tolerance at t = {time_s:.4g} s; record up to there, "
        "or ask for less"
    )
