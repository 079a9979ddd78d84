"""Choice of the engine: the one that was named, or with "auto" the cheapest one for the scene.

With "auto" nothing here distinguishes one engine from another: what counts is which equation they
solve, what they cost, and how large they expect their errors to be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

from .. import engines
from ..engines.base import Candidate, Engine, ErrorBudget
from ..engines.cost_model import speed
from ..engines.step_control import Attempt, first_attempt, loosen
from ..errors import InputError, ToleranceNotMet
from ..scene.scene import Scene
from ..util.compilation import clock, compiled_s
from ..util.provenance import versions
from ..util.suggestions import not_among
from ..util.tables import finite

AUTO = "auto"
GIVEN_STEP = "none, for a step was given"  # on record in place of the tolerance
# by the equation that it solves
THEORY = {3: "linear theory", 4: "the homogeneous chain", 27: "the continuum"}
COLUMNS = ("engine", "equation", "integrator", "model_error", "solver_error", "active_grains",
           "step", "cost_s", "kept", "why")  # fmt: skip
SUM_ROUNDING = 1 + 1e-9  # of a sum of errors that is equal to the tolerance


class Proposal(NamedTuple):
    """An engine's candidate and the verdict on it.

    Attributes
    ----------
    engine : str
    equation : int or None
        Number in the paper of the equation that it solves; None if the engine was not asked.
    candidate : Candidate or None
        None if it has nothing to propose.
    kept : bool
        Whether it is expected to meet the tolerance.
    why : str
        Why it is kept or not.
    """

    engine: str
    equation: int | None = None
    candidate: Candidate | None = None
    kept: bool = False
    why: str = ""

    @property
    def integrator(self) -> str:
        """The method that steps through time; empty where the solution is exact."""
        return self.candidate.integrator if self.candidate else ""

    @property
    def model_error(self) -> float:
        """Expected relative error of the equation; NaN if it is not known."""
        return self.candidate.model_error if self.candidate else math.nan

    @property
    def solver_error(self) -> float:
        """Expected relative error of the numerical solution; NaN if it is not known."""
        return self.candidate.solver_error if self.candidate else math.nan

    @property
    def active_grains(self) -> int | None:
        """Grains that are computed; the others are out of reach."""
        return self.candidate.active_grains if self.candidate else None

    @property
    def step(self) -> float:
        """Time step, s; of an exact solution, the time between two samples."""
        return self.candidate.step if self.candidate else math.nan

    @property
    def cost_s(self) -> float:
        """Expected time, s."""
        return self.candidate.cost_s if self.candidate else math.nan

    @property
    def price_s(self) -> float:
        """Expected time, s; infinite if it is not kept."""
        return self.cost_s if self.kept else math.inf

    def to_json(self) -> dict[str, Any]:
        """Return the fields for a JSON file; numbers that are not known are null."""
        return finite({name: getattr(self, name) for name in COLUMNS})


def engine_for(engine: str | Engine, **options: Any) -> Engine | None:
    """Return an engine by its name; None for "auto", with which each scene gets its own engine.

    Options without a name are those of the native engine.

    Raises
    ------
    InputError
        If there is no such engine or an option is wrong.
    """
    if engine == AUTO and not options:
        return None
    if isinstance(engine, str) and engine != AUTO and engine not in engines.REGISTRY:
        raise InputError.at("engine", not_among(engine, (AUTO, *engines.names())))
    return engines.get("native" if engine == AUTO else engine, **options)


def refusals(scene: Scene, engine: Engine | None) -> list[tuple[str, str]]:
    """Return why an engine, or with None any engine, cannot do a scene, as (key, reason)."""
    if engine:
        return engines.obstacles(engine, scene)
    reasons = []
    # one engine that can is enough; its faults are told only if none can
    for other in map(engines.plain, (*engines.automatic(), *engines.automatic("last"))):
        faults = engines.obstacles(other, scene)
        if not faults:
            return []
        reasons += faults
    return reasons


def choose(
    scene: Scene, engine: Engine | None, tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt of an engine, or with None of the cheapest engine.

    `best_effort` loosens a tolerance that cannot be met.

    Raises
    ------
    ToleranceNotMet
        If it is known beforehand that the tolerance cannot be met.
    """
    if engine:
        return first_attempt(engine, engine.part(scene), tolerance, best_effort)
    began = clock()
    compiled = compiled_s()
    attempt, _, refusal = loosen(partial(_cheapest, scene), tolerance, best_effort)
    return attempt._replace(
        refusal=refusal, planned_s=clock() - began, compiled_s=compiled_s() - compiled
    )


def _cheapest(scene: Scene, tolerance: float) -> Attempt:
    """Return the first attempt of the cheapest engine, or raise `ToleranceNotMet`."""
    proposals = propose(scene, tolerance)
    best = cheapest(proposals)
    return _attempt(best, tolerance, plan=f"{best.engine}: {reason(best, proposals)}")


def _attempt(proposal: Proposal, tolerance: float, **why: str) -> Attempt:
    """Return the first attempt of a proposal, which keeps on record why it was chosen."""
    assert proposal.candidate
    choices = {**proposal.candidate.choices, **why}
    return Attempt(proposal.engine, proposal.candidate._replace(choices=choices), tolerance)


def fall_back(scene: Scene, attempt: Attempt, error: ErrorBudget) -> Attempt | None:
    """Return an attempt with Eq. (1) if the measured model error exceeds the tolerance.

    Raises
    ------
    ToleranceNotMet
        If there is none.
    """
    before = engines.plain(attempt.engine)
    tolerance = attempt.tolerance
    if before.equation == 1 or (error.bound <= tolerance and not error.remark):
        return None
    began = clock()
    bound = max(error.model, error.model_bound)
    left_out = f"Eq. ({before.equation}) leaves out up to {bound:.1g} of the solution"
    if error.remark:
        left_out += f", {error.remark}"
    # engines that were not asked are listed with their reason, too
    exact = [each for each in propose(scene, tolerance) if each.equation in (1, None)]
    if not any(proposal.kept for proposal in exact):
        why = "; ".join(f"{proposal.engine}: {proposal.why}" for proposal in exact)
        raise ToleranceNotMet(f"{left_out}, with the tolerance of {tolerance:.2g} exceeded; {why}")
    best = cheapest(exact)
    expected = f"expected were {attempt.candidate.model_error:.1g}"
    redone = (
        f"{left_out} along the run of {before.name}, {expected}: "
        f"run again with {best.engine}, Eq. (1)"
    )
    following = _attempt(best, tolerance, plan=f"{best.engine}: {redone}", redone=redone)
    return following._replace(planned_s=clock() - began)


def propose(scene: Scene, tolerance: float, every: bool = False) -> list[Proposal]:
    """Return the proposals of the engines, with the verdicts.

    Engines for Eq. (1) are asked first. Most scenes they answer before another engine would have
    begun, which is then not asked.

    Parameters
    ----------
    scene : Scene
    tolerance : float
    every : bool
        Whether to ask all, for a table: those that take longer to begin are never the cheapest.
    """
    automatic = [engines.plain(name) for name in engines.automatic()]
    exact = [engine for engine in automatic if engine.equation == 1]
    proposals = [ask(engine, scene, tolerance) for engine in exact]
    cheapest_s = min(proposal.price_s for proposal in proposals)
    for engine in automatic:
        # no proposal costs less than its start
        begins_s, _ = speed(engine.name, engine.start_up_s)
        if engine.equation != 1 and (every or begins_s < cheapest_s):
            proposals.append(ask(engine, scene, tolerance))
    return proposals + _ask_on_request(scene, tolerance, proposals)


def _ask_on_request(scene: Scene, tolerance: float, others: Sequence[Proposal]) -> list[Proposal]:
    """Return the proposals of engines that are asked only where no other one can do the scene."""
    if any(proposal.candidate for proposal in others):
        why = "only if asked for by name, or if no other engine can do the scene"
        return [Proposal(name, why=why) for name in engines.automatic("last")]
    return [ask(engines.plain(name), scene, tolerance) for name in engines.automatic("last")]


def ask(engine: Engine, scene: Scene, tolerance: float) -> Proposal:
    """Return the proposal of an engine for a scene, with the verdict on it.

    Parameters
    ----------
    engine : Engine
    scene : Scene
    tolerance : float

    Returns
    -------
    Proposal
        Without a candidate where the engine cannot do the scene or meet the tolerance.
    """
    name = engine.name
    equation = engine.equation
    if reasons := engines.obstacles(engine, scene):
        why = "cannot do it: " + "; ".join(dict.fromkeys(reason for _, reason in reasons))
        return Proposal(name, equation, why=why)
    try:
        candidate = engine.candidate(engine.part(scene), tolerance)
    except ToleranceNotMet as error:
        return Proposal(name, equation, why=error.reason)
    except InputError as error:
        why = "; ".join(f"{key}: {fault}" for key, fault in error.faults)
        return Proposal(name, equation, why=why)
    return judge(Proposal(name, equation, candidate), scene, tolerance)


def judge(proposal: Proposal, scene: Scene, tolerance: float) -> Proposal:
    """Return a proposal with the verdict on its candidate."""
    theory = THEORY.get(proposal.equation or 1, f"Eq. ({proposal.equation})")
    if proposal.model_error + proposal.solver_error <= tolerance * SUM_ROUNDING:
        return proposal._replace(kept=True, why="within the tolerance")
    if proposal.solver_error > tolerance:
        why = f"its solver leaves about {proposal.solver_error:.1g}, above the tolerance"
    elif math.isnan(proposal.model_error):
        why = f"the error of {theory} here is not known before the run"
    else:
        error = percent(proposal.model_error)
        why = f"strike number {scene.strike_number:.2g}: {theory} leaves out up to {error}"
    return proposal._replace(kept=False, why=why)


def percent(error: float) -> str:
    """Return an error in per cent, or as a number if it is far below one."""
    if error < 1e-4:
        return f"{error:.1g} of the solution"
    return f"{100 * error:.0f} %" if error > 0.1 else f"{100 * error:.2g} %"


def cheapest(proposals: Sequence[Proposal]) -> Proposal:
    """Return the proposal to take.

    Raises
    ------
    ToleranceNotMet
        With what every engine that was asked says, if none is good enough.
    """
    best = min(proposals, key=lambda proposal: proposal.price_s)
    if not best.kept:
        # an engine that cannot do the scene at all says nothing of the tolerance
        asked = [proposal for proposal in proposals if proposal.candidate or proposal.equation == 1]
        raise ToleranceNotMet("; ".join(f"{proposal.engine}: {proposal.why}" for proposal in asked))
    return best


def reason(best: Proposal, proposals: Sequence[Proposal]) -> str:
    """Return why the cheapest proposal is taken, and why none that would cost less."""
    why = f"solves Eq. ({best.equation}), the cheapest within the tolerance"
    for proposal in proposals:
        if proposal.cost_s < best.cost_s:
            return f"{why}; {proposal.engine} would cost less, but {proposal.why}"
    return why


def record(engine: Engine, scene: Scene, candidate: Candidate, tolerance: float) -> dict[str, str]:
    """Return the record of an answer: versions, choices, and the remarks of the engine."""
    asked = GIVEN_STEP if engine.step else f"{tolerance:g}"
    return {
        **versions(),
        "tolerance": asked,
        **candidate.choices,
        **engine.describe(scene, candidate),
        **damping_record(scene),
    }


def damping_record(scene: Scene) -> dict[str, str]:
    """Return the record of damping: what leaving it out would change."""
    return {"damping": scene.damping_remark} if scene.chain.damped else {}
