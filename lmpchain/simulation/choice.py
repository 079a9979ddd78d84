"""Choice of the engine: the named one, or with "auto" the cheapest one for the scene.

With "auto", engines are compared only by their equations, expected costs and expected errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from .. import engines
from ..engines.base import Engine, ErrorBudget, Proposal
from ..engines.cost_model import speed
from ..engines.step_control import Attempt, first_attempt
from ..errors import InputError, ToleranceNotMet, not_among
from ..scene.scene import Scene
from ..util.compilation import clock
from ..util.provenance import versions

AUTO = "auto"
REFUSED = "cannot do it: "  # Start of the verdict on an engine that refuses a scene.
GIVEN_STEP = "none, for a step was given"  # Recorded instead of a tolerance.
# Names of theories by equation.
THEORY = {3: "linear theory", 4: "the homogeneous chain", 27: "the continuum"}


def engine_for(engine: str | Engine, **options: Any) -> Engine | None:
    """Return an engine by name; None for "auto", which chooses an engine for each scene.

    With options, "auto" stands for the engine `engines.DEFAULT`.

    Raises
    ------
    InputError
        If there is no such engine or an option is wrong.
    """
    if engine == AUTO and not options:
        return None
    if isinstance(engine, str) and engine != AUTO and engine not in engines.REGISTRY:
        raise InputError.at("engine", not_among(engine, (AUTO, *engines.names())))
    return engines.get(engines.DEFAULT if engine == AUTO else engine, **options)


def refusals(scene: Scene, engine: Engine | None) -> list[tuple[str, str]]:
    """Return the reasons why an engine, or every engine (None), cannot solve a scene."""
    if engine:
        return engines.obstacles(engine, scene)
    reasons = []
    # One possible engine is enough.
    for other in map(engines.plain, (*engines.automatic(), *engines.automatic("last"))):
        faults = engines.obstacles(other, scene)
        if not faults:
            return []
        reasons += faults
    return reasons


def choose(
    scene: Scene, engine: Engine | None, tolerance: float, best_effort: bool = False
) -> Attempt:
    """Return the first attempt with an engine, or with the cheapest engine for None.

    With `best_effort`, a larger tolerance is used if the given one cannot be met.

    Raises
    ------
    ToleranceNotMet
        If it is known beforehand that the tolerance cannot be met.
    """
    ask = partial(engine.propose, engine.part(scene)) if engine else partial(_choose, scene)
    return first_attempt(ask, tolerance, best_effort)


def _choose(scene: Scene, tolerance: float) -> Proposal:
    """Return the proposal of the cheapest engine; raise `ToleranceNotMet` if there is none."""
    proposals = propose(scene, tolerance)
    best = cheapest(proposals)
    return _explain(best, plan=f"{best.engine}: {reason(best, proposals)}")


def _explain(proposal: Proposal, **why: str) -> Proposal:
    """Return a proposal that records the reasons of the choice."""
    return proposal._replace(choices={**proposal.choices, **why})


def fall_back(scene: Scene, attempt: Attempt, error: ErrorBudget) -> Attempt | None:
    """Return an attempt with Eq. (1) if the measured model error is too large; otherwise None.

    Raises
    ------
    ToleranceNotMet
        If no engine for Eq. (1) can meet the tolerance.
    """
    before = engines.plain(attempt.proposal.engine)
    tolerance = attempt.tolerance
    if before.equation == 1 or (error.bound <= tolerance and not error.remark):
        return None
    began = clock()
    bound = max(error.model, error.model_bound)
    left_out = f"Eq. ({before.equation}) leaves out up to {bound:.1g} of the solution"
    if error.remark:
        left_out += f", {error.remark}"
    # Engines that were not asked are listed with their reasons as well.
    exact = [each for each in propose(scene, tolerance) if each.equation in (1, None)]
    if not any(proposal.kept for proposal in exact):
        why = "; ".join(f"{proposal.engine}: {proposal.why}" for proposal in exact)
        raise ToleranceNotMet(f"{left_out}, more than the tolerance of {tolerance:.2g}; {why}")
    best = cheapest(exact)
    expected = f"expected: {attempt.proposal.model_error:.1g}"
    redone = (
        f"{left_out} in the run of {before.name} ({expected}): "
        f"run again with {best.engine}, Eq. (1)"
    )
    best = _explain(best, plan=f"{best.engine}: {redone}", redone=redone)
    return Attempt(best, tolerance, planned_s=clock() - began)


def propose(scene: Scene, tolerance: float, every: bool = False) -> list[Proposal]:
    """Return the proposals of the engines, with the verdicts.

    Engines for Eq. (1) are asked first. Another engine is asked only if its start-up time is less
    than the cost of these proposals.

    Parameters
    ----------
    scene : Scene
        The scene to solve.
    tolerance : float
        Largest relative error of equation and solver together.
    every : bool
        Whether to ask all engines, whatever their start-up times are.
    """
    automatic = [engines.plain(name) for name in engines.automatic()]
    exact = [engine for engine in automatic if engine.equation == 1]
    proposals = [ask(engine, scene, tolerance) for engine in exact]
    cheapest_s = min(proposal.price_s for proposal in proposals)
    for engine in automatic:
        # A proposal never costs less than its start-up time.
        begins_s, _ = speed(engine.name, engine.start_up_s)
        if engine.equation != 1 and (every or begins_s < cheapest_s):
            proposals.append(ask(engine, scene, tolerance))
    return proposals + _ask_on_request(scene, tolerance, proposals)


def _ask_on_request(scene: Scene, tolerance: float, others: Sequence[Proposal]) -> list[Proposal]:
    """Return the proposals of engines that are asked only if no other engine is possible."""
    if any(proposal.possible for proposal in others):
        why = "used only if requested by name, or if no other engine can solve the scene"
        return [Proposal(name, why=why) for name in engines.automatic("last")]
    return [ask(engines.plain(name), scene, tolerance) for name in engines.automatic("last")]


def ask(engine: Engine, scene: Scene, tolerance: float) -> Proposal:
    """Return the proposal of an engine for a scene, with the verdict on it.

    Parameters
    ----------
    engine : Engine
        The engine that is asked.
    scene : Scene
        The scene to solve.
    tolerance : float
        Largest relative error of equation and solver together.

    Returns
    -------
    Proposal
        A proposal without steps if the engine cannot solve the scene or meet the tolerance.
    """
    name = engine.name
    equation = engine.equation
    if reasons := engines.obstacles(engine, scene):
        why = REFUSED + "; ".join(dict.fromkeys(reason for _, reason in reasons))
        return Proposal(name, equation, why=why)
    try:
        proposal = engine.propose(engine.part(scene), tolerance)
    except ToleranceNotMet as error:
        return Proposal(name, equation, why=error.reason)
    except InputError as error:
        why = "; ".join(f"{key}: {fault}" for key, fault in error.faults)
        return Proposal(name, equation, why=why)
    return judge(proposal, scene, tolerance)


def judge(proposal: Proposal, scene: Scene, tolerance: float) -> Proposal:
    """Return a proposal with the verdict on it."""
    theory = THEORY.get(proposal.equation or 1, f"Eq. ({proposal.equation})")
    # The sum of the errors may exceed an equal tolerance by rounding.
    if proposal.model_error + proposal.solver_error <= tolerance * (1 + 1e-9):
        return proposal._replace(kept=True, why="within the tolerance")
    if proposal.solver_error > tolerance:
        why = f"its solver error is about {proposal.solver_error:.1g}, above the tolerance"
    elif math.isnan(proposal.model_error):
        why = f"the error of {theory} is not known before the run"
    else:
        error = percent(proposal.model_error)
        why = f"strike number {scene.strike_number:.2g}: {theory} leaves out up to {error}"
    return proposal._replace(kept=False, why=why)


def percent(error: float) -> str:
    """Return an error as text, in per cent unless it is far below one per cent."""
    if error < 1e-4:
        return f"{error:.1g} of the solution"
    return f"{100 * error:.0f} %" if error > 0.1 else f"{100 * error:.2g} %"


def cheapest(proposals: Sequence[Proposal]) -> Proposal:
    """Return the cheapest valid proposal.

    Raises
    ------
    ToleranceNotMet
        If no proposal is valid. The message has the reasons of all engines that were asked.
    """
    best = min(proposals, key=lambda proposal: proposal.price_s)
    if not best.kept:
        # Engines that cannot solve the scene at all are excluded from the reasons.
        asked = [proposal for proposal in proposals if proposal.possible or proposal.equation == 1]
        raise ToleranceNotMet("; ".join(f"{proposal.engine}: {proposal.why}" for proposal in asked))
    return best


def reason(best: Proposal, proposals: Sequence[Proposal]) -> str:
    """Return why the cheapest proposal is chosen, and why each cheaper one was rejected."""
    why = f"solves Eq. ({best.equation}), the cheapest within the tolerance"
    for proposal in proposals:
        if proposal.cost_s < best.cost_s:
            return f"{why}; {proposal.engine} would cost less, but {proposal.why}"
    return why


def record(engine: Engine, scene: Scene, proposal: Proposal, tolerance: float) -> dict[str, str]:
    """Return the record of a trajectory: versions, choices, and remarks of the engine."""
    asked = GIVEN_STEP if engine.step else f"{tolerance:g}"
    return {
        **versions(),
        "tolerance": asked,
        **proposal.record(),
        **engine.describe(scene, proposal),
        **damping_record(scene),
    }


def damping_record(scene: Scene) -> dict[str, str]:
    """Return the record of damping: the change if damping were neglected."""
    return {"damping": scene.damping_remark} if scene.chain.damped else {}
