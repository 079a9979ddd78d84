"""Which engine: the cheapest one whose answer is as good as it is to be, by what each of them proposes.

Nothing here knows one engine from another: what counts is which equation they solve, how far they expect to be off and
what that costs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from .. import engines
from ..engines.base import Candidate, Engine, Run, SolverError
from ..errors import InputError, ToleranceNotMet
from ..scene.scene import Scene
from ..util.arrays import Array

THEORY = {3: "linear theory", 4: "the homogeneous chain", 27: "the continuum"}  # what solves an equation but Eq. (1)
# analysis/calibration/light_cone.py
WORTH = 0.8  # a closer look and what it speaks for must together be so much cheaper
ROUNDING = 1 + 1e-9  # of a sum of errors that is equal to the tolerance


@dataclass
class Rung:
    """An engine and what it would do, judged by and by.

    Attributes
    ----------
    engine : str
    equation : int or None
        None if nobody asked the engine.
    candidate : Candidate or None
        None if it has nothing to propose.
    kept : bool
        Whether it is expected to meet the tolerance.
    why : str
        Why it is kept or not.
    looked : bool
        Whether it was looked at closer.
    """

    engine: str
    equation: int | None = None
    candidate: Candidate | None = None
    kept: bool = False
    why: str = ""
    looked: bool = False

    @property
    def cost_s(self) -> float:
        """Expected time, s; infinite if it is not kept."""
        return self.candidate.cost_s if self.candidate and self.kept else math.inf


def climb(scene: Scene, tolerance: float) -> list[Rung]:
    """Ask every engine, and look closer where that may pay; return a rung for each, judged."""
    rungs = [_asked(name, scene, tolerance) for name in engines.LADDER]
    if not any(rung.candidate for rung in rungs):
        rungs += [_asked(name, scene, tolerance) for name in engines.ON_REQUEST]
    else:
        why = "only if asked for by name, or if no other engine can do the scene"
        rungs += [Rung(name, why=why) for name in engines.ON_REQUEST]
    while True:
        for rung in rungs:
            _judge(rung, scene, tolerance)
        best = min(rung.cost_s for rung in rungs)
        promising = [rung for rung in rungs if _promises(rung, tolerance, best)]
        if not promising:
            return rungs
        first = min(promising, key=_with_look)
        assert first.candidate
        seen = engines.get(first.engine).look(scene, first.candidate).model_error
        for rung in rungs:
            if rung.candidate and rung.equation == first.equation:  # leaves out the same, whoever solves it
                rung.candidate, rung.looked = replace(rung.candidate, model_error=seen), True


def _asked(name: str, scene: Scene, tolerance: float) -> Rung:
    engine = engines.get(name)
    if reasons := engine.refuses(scene):
        return Rung(
            name, engine.equation, why="cannot do it: " + "; ".join(dict.fromkeys(reason for _, reason in reasons))
        )
    try:
        return Rung(name, engine.equation, engine.candidate(scene, tolerance))
    except ToleranceNotMet as error:
        return Rung(name, engine.equation, why=error.reason)
    except InputError as error:
        return Rung(name, engine.equation, why="; ".join(f"{key}: {fault}" for key, fault in error.faults))


def _judge(rung: Rung, scene: Scene, tolerance: float) -> None:
    """Pass the verdict on a rung."""
    found = rung.candidate
    if not found:
        return
    theory = THEORY.get(rung.equation or 1, f"Eq. ({rung.equation})")
    rung.kept = found.model_error + found.solver_error <= tolerance * ROUNDING
    if rung.kept:
        rung.why = "within the tolerance"
    elif found.solver_error > tolerance:
        rung.why = f"its solver leaves about {found.solver_error:.1g}, above the tolerance"
    elif math.isnan(found.model_error):
        rung.why = f"how far off {theory} is here is not known before the run"
    else:
        would = "is up to" if rung.looked else "would be" if found.model_error >= 1 else "may be up to"
        rung.why = f"strike number {scene.strike_number:.2g}: {theory} {would} {percent(found.model_error)} off"
        rung.why += "" if rung.looked else " in the velocities"


def percent(error: float) -> str:
    """Return an error in per cent, or as a number if it is far below one."""
    if error < 1e-4:
        return f"{error:.1g} of the answer"
    return f"{100 * error:.0f} %" if error > 0.1 else f"{100 * error:.2g} %"


def _with_look(rung: Rung) -> float:
    assert rung.candidate
    return rung.candidate.look_s + rung.candidate.cost_s


def _promises(rung: Rung, tolerance: float, best: float) -> bool:
    """Say whether a closer look may find a rung good enough, and pays if it does."""
    found = rung.candidate
    if not found or rung.kept or rung.looked or not math.isfinite(found.look_s):
        return False
    return found.model_least + found.solver_error <= tolerance and _with_look(rung) < WORTH * best


def cheapest(rungs: Sequence[Rung]) -> Rung:
    """Return the rung to take.

    Raises
    ------
    ToleranceNotMet
        With what every engine that was asked says, if none is good enough.
    """
    best = min(rungs, key=lambda rung: rung.cost_s)
    if not best.kept:
        asked = [rung for rung in rungs if rung.candidate or rung.equation == 1]
        raise ToleranceNotMet("; ".join(f"{rung.engine}: {rung.why}" for rung in asked))
    return best


def reason(rungs: Sequence[Rung]) -> str:
    """Return why the cheapest rung is taken."""
    best = cheapest(rungs)
    others = [rung for rung in rungs if rung.kept and rung is not best]
    if others:
        return f"solves Eq. ({best.equation}), the cheapest of {len(others) + 1} within the tolerance"
    simpler = next((rung.why for rung in rungs if rung.candidate and not rung.kept), "")
    return f"solves Eq. ({best.equation}), the only one within the tolerance{'; ' if simpler else ''}{simpler}"


def _chosen(rung: Rung, **why: str) -> Candidate:
    assert rung.candidate
    return replace(rung.candidate, engine=rung.engine, choices={**rung.candidate.choices, **why})


class Auto(Engine):
    """The cheapest engine whose answer is expected to be within the tolerance, equation and solution together.

    Where the run shows that the equation leaves out more than was expected, it is done again with the cheapest engine
    for Eq. (1).
    """

    name: ClassVar[str] = "auto"
    equation: ClassVar[int] = 1

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why no engine can do this scene."""
        found = []
        for name in (*engines.LADDER, *engines.ON_REQUEST):
            reasons = engines.get(name).refuses(scene)
            if not reasons:
                return []
            found += reasons
        return found

    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose what the cheapest engine does."""
        rungs = climb(scene, tolerance)
        best = cheapest(rungs)
        return _chosen(best, plan=f"{best.engine}: {reason(rungs)}")

    def of(self, candidate: Candidate) -> Engine:
        """Return the engine that answers with a candidate."""
        return engines.get(candidate.engine)

    def refine(self, candidate: Candidate, error: SolverError | None, tolerance: float) -> Candidate | None:
        """Propose what the engine proposes that did the last try."""
        return self.of(candidate).refine(candidate, error, tolerance)

    def instead(self, scene: Scene, candidate: Candidate, error: SolverError, tolerance: float) -> Candidate | None:
        """Propose the cheapest engine for Eq. (1) if what another equation leaves out takes the answer too far."""
        before = self.of(candidate)
        if before.equation == 1 or (error.at_most <= tolerance and not error.remark):
            return None
        found = f"Eq. ({before.equation}) leaves out up to {max(error.model, error.model_at_most):.1g} of the answer"
        found = f"{found}, {error.remark}" if error.remark else found
        exact = [rung for rung in climb(scene, tolerance) if rung.equation in (1, None)]
        if not any(rung.kept for rung in exact):
            why = "; ".join(f"{rung.engine}: {rung.why}" for rung in exact)
            raise ToleranceNotMet(f"{found}, with the tolerance of {tolerance:.2g} exceeded; {why}")
        best = cheapest(exact)
        planned = f"it was to be at most {candidate.model_error:.1g}"
        told = f"{found} along the run of {before.name}, {planned}: done again with {best.engine}, Eq. (1)"
        return _chosen(best, plan=f"{best.engine}: {told}", redone=told)

    def start(self, scenes: Sequence[Scene], candidate: Candidate, state: Mapping[str, Array] | None = None) -> Run:
        """Start the engine that was chosen."""
        return self.of(candidate).start(scenes, candidate, state)

    def describe(self, scene: Scene, candidate: Candidate) -> dict[str, str]:
        """Return what the chosen engine says, and why it was chosen."""
        why = {key: candidate.choices[key] for key in ("plan", "redone") if key in candidate.choices}
        return self.of(candidate).describe(scene, candidate) | why
