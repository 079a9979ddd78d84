"""Engine selection: the cheapest engine that is expected to meet the tolerance.

Nothing here knows one engine from another: what counts is which equation they solve, what they
cost, and how far they expect to be off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from .. import engines
from ..engines.base import Engine, Proposal
from ..engines.cost_model import speed
from ..errors import InputError, ToleranceNotMet
from ..scene.scene import Scene

# by the equation that it solves
THEORY = {3: "linear theory", 4: "the homogeneous chain", 27: "the continuum"}
SUM_ROUNDING = 1 + 1e-9  # of a sum of errors that is equal to the tolerance


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
    if any(proposal.possible for proposal in others):
        why = "only if asked for by name, or if no other engine can do the scene"
        return [Proposal(name, why=why) for name in engines.ON_REQUEST]
    return [ask(engines.plain(name), scene, tolerance) for name in engines.ON_REQUEST]


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
        Without steps where the engine cannot do the scene or meet the tolerance.
    """
    name = engine.name
    equation = engine.equation
    if reasons := engine.obstacles(scene):
        why = "cannot do it: " + "; ".join(dict.fromkeys(reason for _, reason in reasons))
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
        asked = [proposal for proposal in proposals if proposal.possible or proposal.equation == 1]
        raise ToleranceNotMet("; ".join(f"{proposal.engine}: {proposal.why}" for proposal in asked))
    return best


def reason(best: Proposal, proposals: Sequence[Proposal]) -> str:
    """Return why the cheapest proposal is taken, and why none that would cost less."""
    why = f"solves Eq. ({best.equation}), the cheapest within the tolerance"
    for proposal in proposals:
        if proposal.cost_s < best.cost_s:
            return f"{why}; {proposal.engine} would cost less, but {proposal.why}"
    return why
