"""Engine selection: the cheapest engine that is expected to meet the tolerance.

Nothing here knows one engine from another: what counts is which equation they solve, what they cost, and how far they
expect to be off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .. import engines
from ..engines.base import Candidate, Engine
from ..errors import InputError, ToleranceNotMet
from ..scene.scene import Scene
from ..util.tables import finite

THEORY = {
    3: "linear theory",
    4: "the homogeneous chain",
    27: "the continuum",
}  # by the equation that it solves
# analysis/calibration/linear_model_error.py
WORTH = 0.8  # a sharper bound, with the answer that it speaks for, must cost less than this part of the cheapest
AT_ONCE_S = 0.05  # what an estimate that decides nothing may take
ROUNDING = 1 + 1e-9  # of a sum of errors that is equal to the tolerance


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
    bounded : bool
        Whether its model error was bounded from the linear solution.
    estimate : float
        Estimate of its model error where it is not kept for the bound on it; NaN if none was made.
    hopeless : bool
        Whether it was not asked, for its equation leaves out more than the tolerance anyway.
    """

    engine: str
    equation: int | None = None
    candidate: Candidate | None = None
    kept: bool = False
    why: str = ""
    bounded: bool = False
    estimate: float = math.nan
    hopeless: bool = False

    @property
    def integrator(self) -> str:
        """The method that steps through time; empty where the solution is exact."""
        return self.candidate.integrator if self.candidate else ""

    @property
    def model_error(self) -> float:
        """Bound on the relative error of the equation; NaN if it is not known."""
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

    def to_json(self) -> dict[str, Any]:
        """Return what goes into a JSON file; numbers that are not known are null."""
        names = [
            "engine",
            "equation",
            "integrator",
            "model_error",
            "estimate",
            "solver_error",
            "active_grains",
            "step",
            "cost_s",
            "kept",
            "why",
        ]
        return finite({name: getattr(self, name) for name in names})

    @property
    def price_s(self) -> float:
        """Expected time, s; infinite if it is not kept."""
        return self.candidate.cost_s if self.candidate and self.kept else math.inf


def propose_hopeful(scene: Scene, tolerance: float) -> list[Proposal]:
    """Do the same as `propose_all` as far as the choice goes: engines that cannot be kept are not asked.

    Of these there is the first one, with why it was not.
    """
    asked: dict[str, Engine] = {}
    dropped: list[Proposal] = []
    for name in engines.automatic():
        engine = engines.plain(name)
        least = engine.least_model_error(scene)
        if least <= tolerance * ROUNDING:
            asked[name] = engine
        elif not dropped:
            dropped = [
                Proposal(
                    name,
                    engine.equation,
                    why=_too_much(engine.equation, scene, least),
                    hopeless=True,
                )
            ]
    proposals = _weighed(
        asked, [_ask(engine, scene, tolerance) for engine in asked.values()], scene, tolerance
    )
    kept = any(proposal.kept for proposal in proposals)
    return [*proposals, *dropped] if kept else propose_all(scene, tolerance)


def propose_all(scene: Scene, tolerance: float) -> list[Proposal]:
    """Ask every engine, bound model errors more sharply where that pays, and judge every candidate."""
    every = {name: engines.plain(name) for name in engines.automatic()}
    proposals = [_ask(engine, scene, tolerance) for engine in every.values()]
    if any(proposal.candidate for proposal in proposals):
        why = "only if asked for by name, or if no other engine can do the scene"
        proposals += [Proposal(name, why=why) for name in engines.ON_REQUEST]
    else:
        proposals += [_ask(engines.plain(name), scene, tolerance) for name in engines.ON_REQUEST]
    return _weighed(every, proposals, scene, tolerance)


def _weighed(
    every: Mapping[str, Engine], proposals: list[Proposal], scene: Scene, tolerance: float
) -> list[Proposal]:
    """Return proposals with the verdicts on them, after sharper bounds where these pay."""
    while True:
        proposals = [_judge(proposal, scene, tolerance) for proposal in proposals]
        cheapest_s = min(proposal.price_s for proposal in proposals)
        promising = [
            proposal for proposal in proposals if _promises(proposal, tolerance, cheapest_s)
        ]
        if not promising:
            return proposals
        first = min(promising, key=_price_with_bound)
        assert first.candidate
        engine = every[first.engine]
        bound = engine.bound_model_error(engine.part(scene), first.candidate)
        proposals = [
            proposal._replace(
                candidate=proposal.candidate._replace(model_error=bound), bounded=True
            )
            if proposal.candidate and proposal.equation == first.equation  # whoever solves it
            else proposal
            for proposal in proposals
        ]


def _ask(engine: Engine, scene: Scene, tolerance: float) -> Proposal:
    part, name = engine.part(scene), engine.name
    if reasons := engine.obstacles(scene):
        why = "cannot do it: " + "; ".join(dict.fromkeys(reason for _, reason in reasons))
        return Proposal(name, engine.equation, why=why)
    try:
        return Proposal(name, engine.equation, engine.candidate(part, tolerance))
    except ToleranceNotMet as error:
        return Proposal(name, engine.equation, why=error.reason)
    except InputError as error:
        return Proposal(
            name, engine.equation, why="; ".join(f"{key}: {fault}" for key, fault in error.faults)
        )


def _judge(proposal: Proposal, scene: Scene, tolerance: float) -> Proposal:
    """Return a proposal with the verdict on it."""
    candidate = proposal.candidate
    if not candidate:
        return proposal
    theory = _theory(proposal.equation)
    kept = candidate.model_error + candidate.solver_error <= tolerance * ROUNDING
    if kept:
        why = "within the tolerance"
    elif candidate.solver_error > tolerance:
        why = f"its solver leaves about {candidate.solver_error:.1g}, above the tolerance"
    elif math.isnan(candidate.model_error):
        why = _unknown(theory)
    elif proposal.bounded:
        error = percent(candidate.model_error)
        why = f"strike number {scene.strike_number:.2g}: {theory} is up to {error} off"
    else:
        reaches = "reaches" if candidate.model_error >= 1 else "is"
        error = percent(candidate.model_error)
        why = f"strike number {scene.strike_number:.2g}: {theory}, a priori bound {reaches} {error}"
    return proposal._replace(kept=kept, why=why)


def _theory(equation: int | None) -> str:
    return THEORY.get(equation or 1, f"Eq. ({equation})")


def _unknown(theory: str) -> str:
    return f"how far off {theory} is here is not known before the run"


def _too_much(equation: int, scene: Scene, least: float) -> str:
    """Say why an engine is not even asked."""
    theory = _theory(equation)
    if least == math.inf:
        return _unknown(theory)
    return f"strike number {scene.strike_number:.2g}: {theory} leaves out at least {percent(least)}"


def estimated(proposals: Sequence[Proposal], scene: Scene) -> list[Proposal]:
    """Add to proposals dropped for a bound on their model error what it is about, where that is cheap."""
    known: dict[int | None, float] = {}
    told = []
    for proposal in proposals:
        look = proposal.candidate.sharper if proposal.candidate and not proposal.kept else None
        if look and look.cost_s < AT_ONCE_S and proposal.solver_error < proposal.model_error:
            if proposal.equation not in known:
                engine = engines.plain(proposal.engine)
                known[proposal.equation] = engine.estimate_model_error(engine.part(scene))
            estimate = known[proposal.equation]
            why = f"{proposal.why}; the linear wave itself tells about {percent(estimate)}"
            proposal = proposal._replace(estimate=estimate, why=why)
        told.append(proposal)
    return told


def percent(error: float) -> str:
    """Return an error in per cent, or as a number if it is far below one."""
    if error < 1e-4:
        return f"{error:.1g} of the answer"
    return f"{100 * error:.0f} %" if error > 0.1 else f"{100 * error:.2g} %"


def _price_with_bound(proposal: Proposal) -> float:
    assert proposal.candidate
    assert proposal.candidate.sharper
    return proposal.candidate.sharper.cost_s + proposal.candidate.cost_s


def _promises(proposal: Proposal, tolerance: float, cheapest_s: float) -> bool:
    """Say whether a sharper bound may find a proposal good enough, and pays if it does."""
    candidate = proposal.candidate
    if not candidate or proposal.kept or proposal.bounded or not candidate.sharper:
        return False
    within = candidate.sharper.least + candidate.solver_error <= tolerance
    return within and _price_with_bound(proposal) < WORTH * cheapest_s


def cheapest(proposals: Sequence[Proposal]) -> Proposal:
    """Return the proposal to take.

    Raises
    ------
    ToleranceNotMet
        With what every engine that was asked says, if none is good enough.
    """
    best = min(proposals, key=lambda proposal: proposal.price_s)
    if not best.kept:
        asked = [proposal for proposal in proposals if proposal.candidate or proposal.equation == 1]
        raise ToleranceNotMet("; ".join(f"{proposal.engine}: {proposal.why}" for proposal in asked))
    return best


def reason(best: Proposal, proposals: Sequence[Proposal]) -> str:
    """Return why the cheapest proposal is taken."""
    others = [proposal for proposal in proposals if proposal.kept and proposal is not best]
    if others:
        return (
            f"solves Eq. ({best.equation}), the cheapest of {len(others) + 1} within the tolerance"
        )
    dropped = (
        proposal
        for proposal in proposals
        if proposal.hopeless or (proposal.candidate and not proposal.kept)
    )
    simpler = next((proposal.why for proposal in dropped), "")
    return f"solves Eq. ({best.equation}), the only one within the tolerance{'; ' if simpler else ''}{simpler}"
