"""Trying until the tolerance is met, or until it is clear that it cannot be."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from ..errors import RunFailed, ToleranceNotMet
from ..scene.scene import Scene
from ..trajectory.record import Cost
from ..util.arrays import Array
from .base import Candidate, Engine, Run, SolverError

ATTEMPTS = 12
STALLS = 2  # attempts in a row that do not help: round-off or chaos, not the step, is the limit
# a first try that misses by so many tolerances, or so much, may be lost in chaos; it is if two runs, a last digit apart
# at t = 0, part by so many tolerances: of 290 random scenes, 250 of which can be answered, none of these did
LOOK, LOOK_AT_MOST, LOST = 1e4, 0.3, 10.0
FAR = 1e5  # times the expected round-off: what stalls above it is chaos or scatter
DIGITS = 30.0  # rounding all along a run does as much as a change of up to so many last digits at t = 0
T = TypeVar("T")


@dataclass(frozen=True)
class Attempt:
    """One try of several, with what the decision about the next one rests on.

    Attributes
    ----------
    candidate : Candidate
    tolerance : float
        That it is to meet.
    refusal : str
        Why that is not the one that was asked for, if it is not.
    planned_s : float
        Time spent before it on finding candidates and setting up, s.
    looked_s : float
        Time spent before it on integrations and their estimates, s.
    truncations : tuple of float
        Truncation errors of the tries before it that ran through.
    breakdowns : int
        How many did not.
    """

    candidate: Candidate
    tolerance: float
    refusal: str = ""
    planned_s: float = 0.0
    looked_s: float = 0.0
    truncations: tuple[float, ...] = ()
    breakdowns: int = 0

    @property
    def number(self) -> int:
        """Which try it is, from 1."""
        return len(self.truncations) + self.breakdowns + 1


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """The last attempt: what was collected from it, and why it missed the tolerance, if it did."""

    collected: T
    candidate: Candidate
    error: SolverError
    cost: Cost
    missed: str


def first_attempt(engine: Engine, scene: Scene, tolerance: float, best_effort: bool = False) -> Attempt:
    """Return the first try; with `best_effort`, a tolerance that the engine refuses is loosened until it does not.

    Raises
    ------
    ToleranceNotMet
        If the engine knows beforehand that it cannot meet the tolerance.
    """
    began = time.perf_counter()
    if best_effort:
        attempt = Attempt(*best_candidate(engine, scene, tolerance))
    else:
        attempt = Attempt(engine.candidate(scene, tolerance), tolerance)
    return replace(attempt, planned_s=time.perf_counter() - began)


def until_tolerance(engine: Engine, scene: Scene, tolerance: float, collect: Callable[[Run], T]) -> Outcome[T]:
    """Run a scene as `pursue` does, from the first attempt on."""
    return pursue(engine, scene, first_attempt(engine, scene, tolerance), collect)


def pursue(
    engine: Engine,
    scene: Scene,
    attempt: Attempt,
    collect: Callable[[Run], T],
    begin: Callable[[Attempt], Mapping[str, Array] | None] = lambda _: None,
    patient: bool = False,
) -> Outcome[T]:
    """Run a scene, at ever shorter steps unless the step is given, and collect each run's blocks.

    Parameters
    ----------
    engine : Engine
    scene : Scene
    attempt : Attempt
        To begin with.
    collect : callable
        Takes a run and goes through its blocks.
    begin : callable
        Told of every attempt before it starts; returns the state to start it from, None for the beginning.
    patient : bool
        Whether to go on, for the best answer there is, where the first try shows that none meets the tolerance.

    Raises
    ------
    RunFailed
        If the run breaks down, at a given step or again and again.
    """
    while True:
        began = time.perf_counter()
        candidate, tolerance = attempt.candidate, attempt.tolerance
        run = engine.start([scene], candidate, begin(attempt))
        error = None
        try:
            collected = collect(run)
            error, cost = run.errors()[0], run.cost()
        except RunFailed:
            if candidate.fixed or attempt.breakdowns == STALLS:
                raise
        finally:
            run.close()
        better, other, alone = None, None, ""
        if not candidate.fixed:
            try:
                other = engine.instead(scene, candidate, error, tolerance) if error else None
            except ToleranceNotMet as refusal:
                alone = refusal.reason
            better = other or engine.refine(candidate, error, tolerance)
        if error:
            attempt = replace(attempt, truncations=() if other else (*attempt.truncations, error.truncation))
            enough = candidate.fixed or (error.total <= tolerance and not other and not alone)
            missed = alone
            if not (enough or other or missed):
                look_began = time.perf_counter()
                missed = _why_not(scene, error, attempt, better) or ("" if patient else _lost(scene, error, attempt))
                look_s = time.perf_counter() - look_began
                began += look_s  # it is no planning
                attempt = replace(attempt, looked_s=attempt.looked_s + look_s)
            if enough or missed:
                setup, estimate = cost.setup_s + attempt.planned_s, cost.estimate_s + attempt.looked_s
                cost = replace(cost, setup_s=setup, estimate_s=estimate)
                return Outcome(collected, candidate, error, cost, attempt.refusal or missed)
        else:
            attempt = replace(attempt, breakdowns=attempt.breakdowns + 1)
        assert better
        spent = run.cost()
        looked = spent.integration_s + spent.estimate_s
        planned = time.perf_counter() - began - looked
        attempt = replace(
            attempt,
            candidate=better,
            planned_s=attempt.planned_s + planned,
            looked_s=attempt.looked_s + looked,
        )


def best_candidate(engine: Engine, scene: Scene, tolerance: float) -> tuple[Candidate, float, str]:
    """Return a candidate, loosening a tolerance that the engine refuses.

    Returns
    -------
    candidate, the tolerance it is for, and why the one asked for was refused (empty if it was not)

    Raises
    ------
    ToleranceNotMet
        If nothing tighter than 0.1 can be met.
    """
    reason = ""
    while True:
        try:
            return engine.candidate(scene, tolerance), tolerance, reason
        except ToleranceNotMet as refusal:
            if tolerance > 0.1:
                raise
            reason = reason or refusal.reason
            tolerance *= 4


def _why_not(scene: Scene, error: SolverError, attempt: Attempt, better: Candidate | None) -> str:
    """Return why shorter steps will not help after this attempt, or nothing if they may.

    An estimate that does not fall may be erratic, where contacts open, or show that rounding has grown to that size.
    """
    tolerance, truncations = attempt.tolerance, attempt.truncations
    recent = truncations[-STALLS - 1 :]
    stalled = len(recent) > STALLS and all(b > 0.7 * a for a, b in pairwise(recent))
    if better and not stalled and len(truncations) < ATTEMPTS:
        return ""
    rounding = better is None or error.truncation < FAR * error.roundoff
    rounding = rounding or _parts(scene, attempt.candidate, tolerance / DIGITS) is not None
    if not rounding and len(truncations) < ATTEMPTS:
        return ""
    reason = (
        f"the error is estimated at {error.total:.2g}, above the tolerance of {tolerance:.2g}, and steps shorter than "
        f"{attempt.candidate.step:.2g} s do not help"
    )
    if better is None:
        reason += f", for round-off alone makes {error.roundoff:.2g}"
    horizon = error.horizon(tolerance)
    known = rounding and horizon < float("inf")
    return f"{reason}: {_amplifies(horizon)}" if known else f"{reason}: ask for less"


def _lost(scene: Scene, error: SolverError, attempt: Attempt) -> str:
    """Return why no step will help, if the first try shows it, or nothing."""
    tolerance = attempt.tolerance
    suspect = error.truncation > min(LOOK * tolerance, LOOK_AT_MOST)
    if len(attempt.truncations) > 1 or not suspect:
        return ""
    horizon = _parts(scene, attempt.candidate, tolerance, LOST)
    if horizon is None:
        return ""
    return f"the error is estimated at {error.total:.2g}, above the tolerance of {tolerance:.2g}: {_amplifies(horizon)}"


def _parts(scene: Scene, candidate: Candidate, distance: float, times: float = 1.0) -> float | None:
    """Return when two runs, a last digit apart at t = 0, are as far apart as that, s, if they part by so many times it.

    Two runs may differ in where their steps shorten, so in more than the scene makes of a digit; at steps of one length
    they are the same map, but further off. Both pairs must part.
    """
    if not candidate.integrator:
        return None
    from .perturbation import LAST_DIGIT, divergence

    horizon = scene.duration
    for adaptive in {candidate.adaptive, False}:
        try:
            apart = divergence(scene, replace(candidate, adaptive=adaptive), LAST_DIGIT)
        except RunFailed:
            return None
        if apart.max() < times * distance:
            return None
        horizon = min(horizon, float(scene.time[np.argmax(apart > distance)]))
    return horizon


def _amplifies(horizon: float) -> str:
    return (
        f"this scene amplifies round-off beyond the tolerance at t = {horizon:.4g} s; record up to there, "
        "or ask for less"
    )
