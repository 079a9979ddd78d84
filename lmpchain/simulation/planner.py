"""Which engine, how many grains, which step: what `simulate` would do with a scene, and why not something else."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..errors import check_tolerance
from ..scene.scene import Scene
from ..util.tables import aligned, finite
from . import selection as ladder

HEAD = ("", "engine", "Eq.", "model error", "solver error", "grains", "step", "cost", "")


@dataclass(frozen=True)
class Proposal:
    """What an engine would do; NaN and None where it proposes nothing.

    Attributes
    ----------
    engine : str
    equation : int or None
        Number in the paper of the equation that it solves.
    integrator : str
        Empty where the solution is exact.
    model_error, solver_error : float
        Expected relative errors of the equation and of its solution; both are bounds, as defined for `ErrorEstimate`.
    active_grains : int or None
        Grains that are computed; the others are out of reach.
    step : float
        s.
    cost_s : float
        Expected time, s.
    kept : bool
        Whether it is within the tolerance.
    why : str
        Why it is, or is not.
    """

    engine: str
    equation: int | None
    integrator: str
    model_error: float
    solver_error: float
    active_grains: int | None
    step: float
    cost_s: float
    kept: bool
    why: str

    @classmethod
    def of(cls, rung: ladder.Rung) -> Proposal:
        """Return what a rung stands for."""
        found = rung.candidate
        if not found:
            nothing = math.nan
            return cls(rung.engine, rung.equation, "", nothing, nothing, None, nothing, nothing, rung.kept, rung.why)
        return cls(
            rung.engine,
            rung.equation,
            found.integrator,
            found.model_error,
            found.solver_error,
            found.active_grains,
            found.step,
            found.cost_s,
            rung.kept,
            rung.why,
        )


@dataclass(frozen=True)
class Plan:
    """How a scene is answered within a tolerance at the least expected cost.

    Attributes
    ----------
    engine, integrator : str
    active_grains : int
        Grains that are computed.
    step : float
        s; of an exact solution, the time between two samples.
    expected_error : float
        Of equation and solver together, a bound.
    expected_cost_s : float
        Time for setting up, integrating and estimating the error, s.
    why : str
    candidates : tuple of Proposal
        What every engine proposed; that of the plan is among them.
    tolerance : float
    """

    engine: str
    integrator: str
    active_grains: int
    step: float
    expected_error: float
    expected_cost_s: float
    why: str
    candidates: tuple[Proposal, ...]
    tolerance: float

    def table(self) -> str:
        """Return all candidates as a table, and why the first is taken."""
        ordered = sorted(self.candidates, key=lambda found: (not found.kept, found.kept and found.cost_s))
        rows = [HEAD, *(("*" if found.engine == self.engine else "", *_cells(found)) for found in ordered)]
        return "\n".join([*aligned(rows), f"{self.engine} {self.why}"])

    def to_json(self) -> dict[str, Any]:
        """Return the plan in plain numbers; what is not known is null."""
        own = {key: value for key, value in self.__dict__.items() if key != "candidates"}
        rows = [finite(vars(found)) for found in self.candidates]
        return own | {"candidates": rows}


def plan(scene: Scene, tolerance: float = 1e-6) -> Plan:
    """Say which engine `simulate` takes for a scene with engine "auto", with which step, and why.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Largest relative error, of equation and solver together.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        If the tolerance is not between 0 and 1.
    ToleranceNotMet
        If no engine expects to meet it.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> strike = Impulse(velocity=8.57e-4)
    >>> scene = Scene(chain=Chain(grains=120, diameter=1e-3), excitation=strike, duration=100e-6)
    >>> plan(scene).engine
    'native'
    """
    check_tolerance(tolerance)
    rungs = ladder.climb(scene, tolerance)
    best = ladder.cheapest(rungs)
    found = best.candidate
    assert found
    return Plan(
        engine=best.engine,
        integrator=found.integrator,
        active_grains=found.active_grains,
        step=found.step,
        expected_error=found.model_error + found.solver_error,
        expected_cost_s=found.cost_s,
        why=ladder.reason(rungs),
        candidates=tuple(Proposal.of(rung) for rung in rungs),
        tolerance=tolerance,
    )


def _cells(found: Proposal) -> Iterator[str]:
    yield f"{found.engine}{f' {found.integrator}' if found.integrator else ''}"
    yield "" if found.equation is None else f"({found.equation})"
    yield "0" if found.model_error == 0 else _shown(found.model_error, ".1g")
    yield _shown(found.solver_error, ".1g")
    yield "" if found.active_grains is None else str(found.active_grains)
    yield _shown(found.step, ".3g", " s")
    yield _shown(1e3 * found.cost_s, ".3g", " ms")
    yield f"{'kept' if found.kept else 'dropped'}: {found.why}"


def _shown(value: float, form: str, unit: str = "") -> str:
    return "" if math.isnan(value) else f"{value:{form}}{unit}"
