"""Which engine answers a scene: the one that was named, or "auto", the cheapest one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from .. import engines
from ..engines.base import Engine, ErrorBudget, Proposal
from ..engines.step_control import Attempt, first_attempt, loosen
from ..errors import InputError, ToleranceNotMet
from ..scene.scene import Scene
from ..util.compilation import clock, compiled_s
from ..util.provenance import versions
from ..util.suggestions import not_among
from .selection import cheapest, propose, reason

AUTO = "auto"
GIVEN_STEP = "none, for a step was given"  # on record in place of the tolerance


@dataclass(frozen=True)
class Named:
    """The engine that was asked for."""

    chosen: Engine

    @property
    def name(self) -> str:
        """Name of the engine."""
        return self.chosen.name

    def options(self) -> dict[str, Any]:
        """Return the options with which `policy_for` makes an equal policy from the name."""
        return self.chosen.options()

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why the engine cannot do this scene."""
        return self.chosen.obstacles(scene)

    def first(self, scene: Scene, tolerance: float, best_effort: bool) -> Attempt:
        """Return the first attempt of the engine."""
        return first_attempt(self.chosen, self.chosen.part(scene), tolerance, best_effort)

    def engine(self, attempt: Attempt) -> Engine:
        """Return the engine."""
        return self.chosen

    def fallback(self, scene: Scene, attempt: Attempt, error: ErrorBudget) -> None:
        """Stay with the engine."""


@dataclass(frozen=True)
class Auto:
    """The cheapest engine that is expected to meet the tolerance, model error included."""

    name: str = AUTO
    chosen: None = None

    def options(self) -> dict[str, Any]:
        """There are none."""
        return {}

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why no engine can do this scene, as (key, reason); empty if one can."""
        faults = []
        # one engine that can is enough; its faults are told only if none can
        for engine in map(engines.plain, (*engines.automatic(), *engines.ON_REQUEST)):
            reasons = engine.obstacles(scene)
            if not reasons:
                return []
            faults += reasons
        return faults

    def first(self, scene: Scene, tolerance: float, best_effort: bool) -> Attempt:
        """Return the first attempt of the cheapest engine; `best_effort` loosens the tolerance.

        Raises
        ------
        ToleranceNotMet
            If none will meet it.
        """
        began = clock()
        compiled = compiled_s()
        choose = partial(_cheapest, scene)
        attempt, _, refusal = loosen(choose, tolerance, best_effort)
        return attempt._replace(
            refusal=refusal, planned_s=clock() - began, compiled_s=compiled_s() - compiled
        )

    def engine(self, attempt: Attempt) -> Engine:
        """Return the engine that was chosen."""
        return engines.plain(attempt.proposal.engine)

    def fallback(self, scene: Scene, attempt: Attempt, error: ErrorBudget) -> Attempt | None:
        """Return an attempt with Eq. (1) if the measured model error exceeds the tolerance.

        Raises
        ------
        ToleranceNotMet
            If there is none.
        """
        before = self.engine(attempt)
        tolerance = attempt.tolerance
        if before.equation == 1 or (error.bound <= tolerance and not error.remark):
            return None
        began = clock()
        bound = max(error.model, error.model_bound)
        left_out = f"Eq. ({before.equation}) leaves out up to {bound:.1g} of the solution"
        if error.remark:
            left_out += f", {error.remark}"
        # engines that were not asked are listed with their reason, too
        exact = [
            proposal for proposal in propose(scene, tolerance) if proposal.equation in (1, None)
        ]
        if not any(proposal.kept for proposal in exact):
            why = "; ".join(f"{proposal.engine}: {proposal.why}" for proposal in exact)
            raise ToleranceNotMet(
                f"{left_out}, with the tolerance of {tolerance:.2g} exceeded; {why}"
            )
        best = cheapest(exact)
        expected = f"expected were {attempt.proposal.model_error:.1g}"
        redone = (
            f"{left_out} along the run of {before.name}, {expected}: "
            f"run again with {best.engine}, Eq. (1)"
        )
        attempt = _attempt(best, tolerance, plan=f"{best.engine}: {redone}", redone=redone)
        return attempt._replace(planned_s=clock() - began)


Policy = Named | Auto


def _cheapest(scene: Scene, tolerance: float) -> Attempt:
    """Return the first attempt of the cheapest engine, or raise `ToleranceNotMet`."""
    proposals = propose(scene, tolerance)
    best = cheapest(proposals)
    why = reason(best, proposals)
    return _attempt(best, tolerance, plan=f"{best.engine}: {why}")


def _attempt(proposal: Proposal, tolerance: float, **why: str) -> Attempt:
    """Return the first attempt of a proposal, which keeps on record why it was chosen."""
    return Attempt(proposal._replace(choices={**proposal.choices, **why}), tolerance)


def policy_for(engine: str | Engine, **options: Any) -> Policy:
    """Return the policy for an engine or its name; "auto" with options is the native engine.

    Raises
    ------
    InputError
        If there is no such engine or an option is wrong.
    """
    if engine == AUTO and not options:
        return Auto()
    if isinstance(engine, str) and engine != AUTO and engine not in engines.REGISTRY:
        raise InputError.at("engine", not_among(engine, (AUTO, *engines.names())))
    return Named(engines.get("native" if engine == AUTO else engine, **options))


def record(engine: Engine, scene: Scene, proposal: Proposal, tolerance: float) -> dict[str, str]:
    """Return the record of an answer: versions, choices, and the remarks of the engine."""
    asked = GIVEN_STEP if engine.step else f"{tolerance:g}"
    return {
        **versions(),
        "tolerance": asked,
        **proposal.record(),
        **engine.describe(scene, proposal),
        **damping_record(scene),
    }


def damping_record(scene: Scene) -> dict[str, str]:
    """Return the record of damping: what leaving it out would change."""
    return {"damping": scene.damping_remark} if scene.chain.damped else {}
