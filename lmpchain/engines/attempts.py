"""Trying until the tolerance is met, or until it is clear that it cannot be."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Generic, TypeVar

from ..errors import RunFailed, ToleranceNotMet
from ..scene import Scene
from .base import Candidate, Cost, Engine, Run, SolverError

ATTEMPTS = 12
STALLS = 2  # attempts in a row that do not help: round-off or chaos, not the step, is the limit
T = TypeVar("T")


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """The last attempt: what was collected from it, and why it missed the tolerance, if it did."""

    collected: T
    candidate: Candidate
    error: SolverError
    cost: Cost
    missed: str


def until_tolerance(
    engine: Engine, scene: Scene, tolerance: float, collect: Callable[[Run], T], best_effort: bool = False
) -> Outcome[T]:
    """Run a scene, at ever shorter steps unless the step is given, and collect each run's blocks.

    With `best_effort`, a tolerance that the engine refuses beforehand is loosened until it does not.

    Raises
    ------
    ToleranceNotMet
        If the engine knows beforehand that it cannot meet the tolerance.
    RunFailed
        If the run breaks down, at a given step or again and again.
    """
    began = time.perf_counter()
    refusal = ""
    if best_effort:
        candidate, tolerance, refusal = best_candidate(engine, scene, tolerance)
    else:
        candidate = engine.candidate(scene, tolerance)
    errors: list[SolverError] = []
    breakdowns = 0
    while True:
        looked = time.perf_counter() - began
        run = engine.start([scene], candidate)
        error = None
        try:
            collected = collect(run)
            error, cost = run.errors()[0], run.cost()
        except RunFailed:
            breakdowns += 1
            if candidate.fixed or breakdowns > STALLS:
                raise
        finally:
            run.close()
        if error:
            errors.append(error)
        better = None if candidate.fixed else engine.refine(candidate, error, tolerance)
        if error:
            enough = candidate.fixed or error.total <= tolerance
            missed = "" if enough else _why_not(errors, tolerance, candidate.step, better)
            if enough or missed:
                cost = replace(cost, estimate_s=cost.estimate_s + looked)
                return Outcome(collected, candidate, error, cost, refusal or missed)
        assert better
        candidate = better


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


def _why_not(errors: list[SolverError], tolerance: float, step: float, better: Candidate | None) -> str:
    """Return why shorter steps will not help, or nothing if they may."""
    error = errors[-1]
    recent = [e.truncation for e in errors[-STALLS - 1 :]]
    stalled = len(recent) > STALLS and all(b > 0.7 * a for a, b in pairwise(recent))
    if better and not stalled and len(errors) < ATTEMPTS:
        return ""
    reason = (
        f"the error is estimated at {error.total:.2g}, above the tolerance of {tolerance:.2g}, and steps shorter than "
        f"{step:.2g} s do not help"
    )
    if better is None:
        reason += f", for round-off alone makes {error.roundoff:.2g}"
    horizon = error.horizon(tolerance)
    if horizon == float("inf"):
        return f"{reason}: ask for less"
    return (
        f"{reason}: this scene amplifies round-off beyond the tolerance at t = {horizon:.4g} s; record up to there, "
        "or ask for less"
    )
