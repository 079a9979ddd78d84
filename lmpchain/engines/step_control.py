"""Step-size control: shortens steps until the tolerance is met or proves to be unreachable.

Single runs, batches of similar scenes and sweeps use it. `next_attempt` judges an attempt by its
error estimate, and `solve_to_tolerance` makes one attempt after another.
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
    """Limits beyond which no shorter steps are tried; analysis/calibration/chaos_test.py.

    Attributes
    ----------
    attempts : int
        Largest number of complete attempts.
    hopeless : float
        Ratio of rounding error to tolerance beyond which no attempt can meet the tolerance.
    hopeless_attempts : int
        Largest number of attempts beyond `hopeless`. There, shorter steps would only improve an
        answer that misses its tolerance in any case.
    breakdowns : int
        Largest number of attempts that break down before the last one.
    stalls, stalled : int, float
        The truncation error must fall by the factor `stalled` within `stalls` attempts. A single
        attempt may be erratic if contacts open.
    lost : float
        Ratio of error to tolerance at which an attempt ends early; analysis/lost_attempts.py.
    known : float
        An unpredictable run ends when the amplified rounding error reaches this fraction of the
        tolerance. The next attempt has more steps and therefore a larger rounding error, for which
        the rest of the tolerance remains.
    visible : float
        Amplified rounding error, relative to the motion, beyond which a run with a given step is
        called unpredictable.
    beginning : int
        Number of attempts after which the duration of an unpredictable run is halved. The scene
        amplifies truncation errors as much as rounding errors, so that both must be equally small.
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
# Suggested when no trajectory can be predicted.
AVERAGES = "averages over time (lmpchain.averages)"
Collected = TypeVar("Collected")  # Type of a collected result of a run.


class Attempt(NamedTuple):
    """An attempt to meet a tolerance, with the history of earlier attempts.

    Attributes
    ----------
    proposal : Proposal
        The engine's proposal for this attempt.
    tolerance : float
        Tolerance of this attempt.
    refusal : str
        Why the tolerance differs from the requested one; empty if it does not.
    planned_s : float
        Time of earlier attempts for proposals and for setting up runs, s.
    spent_s : float
        Time of earlier attempts for integrations and error estimates, s.
    compiled_s : float
        Time of earlier attempts for compilation, s, which the other two times do not include.
    truncations : tuple of float
        Truncation errors of the earlier attempts that did not break down; infinite for an attempt
        that was ended early.
    breakdowns : int
        Number of earlier attempts that broke down.
    best : (float, Proposal), optional
        Smallest error of the complete attempts, and the proposal of that attempt.
    repeats : bool
        Whether this attempt repeats the best earlier one.
    known_until : float
        Predictability horizon of the scene, s, at which the run ends; infinite if none is known.
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
        """Number of this attempt, counted from 1."""
        return len(self.truncations) + self.breakdowns + 1

    def work(self, samples: int) -> str:
        """Return a description of the run for messages about its time."""
        proposal = self.proposal
        words = f"the run by {proposal.engine}"
        if proposal.integrator:
            steps = proposal.steps.total(samples - 1)
            words += f" with {steps} steps of {proposal.integrator}"
        if proposal.fixed:
            return f"{words} of the given length"
        return f"{words} for a tolerance of {self.tolerance:.2g}"


class Outcome(NamedTuple, Generic[Collected]):
    """The result of the last attempt.

    Attributes
    ----------
    collected : object
        Return value of `collect`.
    attempt : Attempt
        The last attempt.
    errors : list of ErrorBudget
        Error of every scene.
    error : ErrorBudget
        The largest of these errors.
    cost : Cost
        Cost including the planning and the earlier attempts.
    missed : str
        Why the tolerance was missed; empty if it was met, or if none is enforced.
    known_until : float
        Time at which the amplified rounding error exceeds the tolerance, s. It is infinite if this
        never happens, or if the answer met its tolerance.
    """

    collected: Collected
    attempt: Attempt
    errors: list[ErrorBudget]
    error: ErrorBudget
    cost: Cost
    missed: str
    known_until: float = math.inf


class _Lost(Exception):
    """Raised when an attempt will miss its tolerance; contains the next attempt."""

    def __init__(self, following: Attempt):
        self.following = following


def first_attempt(
    propose: Callable[[float], Proposal], tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt.

    With `best_effort`, a tolerance that cannot be met is multiplied by four until it can be met.

    Raises
    ------
    ToleranceNotMet
        If it is known beforehand that the tolerance cannot be met; with `best_effort`, if no
        tolerance below 0.1 can be met.
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
    """Run a scene, or a batch of similar scenes, with shorter and shorter steps.

    The last attempt meets the tolerance, or shows that no steps can meet it. An attempt ends early
    when its error estimate shows that it will miss the tolerance.

    Parameters
    ----------
    engine : Engine
    scenes : sequence of Scene
        The parts of scenes that the engine computes. The largest error of any scene must meet the
        tolerance.
    attempt : Attempt
        The first attempt.
    collect : callable
        Function that is called with a run. It iterates over the blocks of the run and returns the
        data to be stored.
    begin : callable
        Function that is called with every attempt before it starts. It returns the state from which
        the run continues, or None.
    patient : bool
        Whether to search for the best answer even if the first attempt shows that no answer can
        meet the tolerance.

    Raises
    ------
    RunFailed
        If a run with a given step, or the last of several attempts, breaks down.
    ToleranceNotMet
        If an attempt shows that the scene cannot be predicted to its end, unless `patient` is true;
        or if the part up to the predictability horizon needs too many attempts.
    """
    compiled = compiled_s() - attempt.compiled_s
    while True:
        # A native trial may need far more steps than its first attempt as well.
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
            # A given step is not shortened.
            if attempt.proposal.fixed or attempt.breakdowns == PATIENCE.breakdowns:
                if engine.suspect:
                    raise RunFailed(f"{engine.suspect}; {failure}") from failure
                raise
        finally:
            cost = run.cost()
            run.close()
        # All scenes of a batch have the same steps, so that the largest error decides.
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
    """Raise `ToleranceNotMet` if an unpredictable scene must be halved in duration."""
    if attempt.known_until == math.inf:
        return
    known_s = attempt.known_until / 2
    many = following is not None and len(following.truncations) == PATIENCE.beginning
    if many or (missed and scene.until(known_s) is not scene):
        raise ToleranceNotMet(attempt.refusal, known_until=known_s)


def _conclude(
    engine: Engine, scene: Scene, attempt: Attempt, error: ErrorBudget, missed: str
) -> tuple[str, float]:
    """Return why the last attempt missed its tolerance, and the predictability horizon, s."""
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
    """Return the error with the largest solver error."""
    return max(errors, key=lambda budget: budget.solver)


def _judge(engine: Engine, scene: Scene, attempt: Attempt, patient: bool, run: Run) -> None:
    """Stop a run that will miss its tolerance if another attempt may meet it.

    Raises
    ------
    ToleranceNotMet
        If no steps can meet the tolerance, because the scene amplifies rounding errors, unless
        `patient` is true.
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
    # No attempt follows: this run gives the answer.
    run.judge = Run.judge


def next_attempt(
    engine: Engine,
    scene: Scene,
    attempt: Attempt,
    error: ErrorBudget | None,
    patient: bool = False,
    ended: bool = True,
) -> tuple[Attempt | None, str]:
    """Return the next attempt, and the reason why this one missed the tolerance.

    Parameters
    ----------
    engine, scene, attempt
        As for `solve_to_tolerance`.
    error : ErrorBudget, optional
        Error of the attempt; None if it broke down.
    patient : bool
        As for `solve_to_tolerance`.
    ended : bool
        Whether the run is complete; otherwise the error is extrapolated to its end.

    Returns
    -------
    attempt : Attempt or None
        The next attempt; None if this was the last attempt.
    missed : str
        The reason; empty if the tolerance was met, or if another attempt follows.
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
    """Return whether to repeat the best earlier attempt, because its samples were not stored.

    Shorter steps may have given a larger error by chance. If rounding errors limit the accuracy,
    the shortest steps are accurate for the longest time, and no attempt is repeated.
    """
    return best != proposal and error.roundoff <= tolerance


def _shorten(
    engine: Engine, attempt: Attempt, error: ErrorBudget, patient: bool
) -> Proposal | None:
    """Return a proposal of shorter steps, or None if they do not help.

    If the rounding error alone exceeds the tolerance, a patient run still reduces its truncation
    error to the tolerance. Other runs accept a truncation error of twice the rounding error. The
    truncation error is estimated as twice the difference between runs, which is then as large as
    the rounding error. If the rounding error is hopeless, these runs end after a few attempts.
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
    """Return whether the error has nearly stopped falling, or the attempts are used up."""
    truncations = attempt.truncations
    if len(truncations) <= PATIENCE.stalls:
        return False
    stalls = truncations[-1] > PATIENCE.stalled * truncations[-1 - PATIENCE.stalls]
    return stalls or len(truncations) == PATIENCE.attempts


def _explain(scene: Scene, error: ErrorBudget, attempt: Attempt) -> str:
    """Return the reason why an attempt missed its tolerance, and the remedy."""
    tolerance = attempt.tolerance
    solver = error.estimate.solver
    unknown = " (nothing is known)" if solver == LARGEST_ERROR else ""
    above = f"{unknown}, above the tolerance of {tolerance:.2g}"
    reason = f"the error is estimated at {solver:.2g}{above}"
    if len(attempt.truncations) == PATIENCE.attempts:
        reason += f", after {PATIENCE.attempts} attempts with ever shorter steps"
    elif _stalls(attempt):
        reason += f", and steps shorter than {attempt.proposal.step:.2g} s do not help"
    if error.roundoff > tolerance / 2:
        floor = min(error.roundoff, LARGEST_ERROR)
        reason += f", because round-off alone may make an error of {floor:.2g}"
    time_s = _find_horizon(error, tolerance, scene)
    if time_s == math.inf:
        return f"{reason}: use a larger tolerance"
    return (
        f"{reason}: this scene amplifies round-off, which may exceed the tolerance at "
        f"t = {time_s:.4g} s; record up to this time, use a larger tolerance, or take {AVERAGES}"
    )


def _find_horizon(error: ErrorBudget, tolerance: float, scene: Scene) -> float:
    """Return the time until which the amplified rounding error leaves room for other errors, s.

    The time is infinite if the rounding error leaves this room to the end of the scene, or if it is
    too large from the beginning.
    """
    if error.amplified.max(initial=0.0) <= tolerance:
        return math.inf
    return error.last_known(PATIENCE.known * tolerance, scene.time) or math.inf
