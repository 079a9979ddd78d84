"""The seam: an engine is a way to answer a scene.

Every engine states which equation it solves, says beforehand what an answer will cost and how far
off it will be, and delivers the answer in blocks with an estimate of its own error. Progress,
Ctrl-C and where the output goes are not its business: `lmpchain.simulation.api` does that for all.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..scene.scene import Scene
from ..trajectory.record import Block, Cost
from ..util.arrays import Array


@dataclass(frozen=True)
class Candidate:
    """What an engine proposes for a scene.

    Attributes
    ----------
    steps_per_sample : int
        Steps between two recorded times.
    step : float
        Their length, s.
    fixed : bool
        Whether the user gave the step, so that no tolerance is enforced.
    active_grains : int
        Grains that are computed, from `first_grain` on.
    model_error, solver_error : float
        Expected relative errors: of the equation, and of its solution (NaN if nobody looked).
    cost_s : float
        Expected time, s.
    choices : mapping
        What the engine chose on the user's behalf, for the record and for `Engine.start`.
    adaptive : bool
        Whether steps shorten where a contact is about to open or close.
    first_grain : int
        The first grain that is computed.
    integrator : str
        The method that steps through time, if one does.
    model_least : float
        The least that a closer look can find: where it is above a tolerance, none is taken.
    look_s : float
        Time that `Engine.look` takes, s; infinite where it knows no more.
    engine : str
        Who proposed it, where several engines were asked (`Auto`).
    """

    steps_per_sample: int
    step: float
    fixed: bool
    active_grains: int
    model_error: float
    solver_error: float
    cost_s: float
    choices: Mapping[str, str] = field(default_factory=dict)
    adaptive: bool = False
    first_grain: int = 1
    integrator: str = ""
    model_least: float = 0.0
    look_s: float = math.inf
    engine: str = ""


@dataclass(frozen=True)
class SolverError:
    """Estimated error of a solution relative to its equation, as defined for a trajectory.

    Attributes
    ----------
    truncation, roundoff : float
        From the step and from rounding.
    smooth : bool
        Whether no contact came near to opening, so that the method kept its order.
    differences : (T,) array
        Largest relative difference between runs at two steps, sample by sample.
    time : (T,) array
        s.
    model : float
        Estimated error of the equation itself, where it is not Eq. (1).
    remark : str
        Why the equation does not hold here, if it is known not to.
    model_at_most : float
        A bound on the error of the equation, if that is larger than the estimate.
    """

    truncation: float
    roundoff: float
    smooth: bool
    differences: Array
    time: Array
    model: float = 0.0
    remark: str = ""
    model_at_most: float = 0.0

    @property
    def total(self) -> float:
        """Truncation and round-off together."""
        return self.truncation + self.roundoff

    @property
    def at_most(self) -> float:
        """A bound on the error of equation and solution together."""
        return max(self.model, self.model_at_most) + self.total

    def horizon(self, tolerance: float) -> float:
        """Return the first time at which the difference between two runs exceeds the tolerance, s."""
        beyond = np.flatnonzero(~(self.differences <= tolerance))
        return float(self.time[beyond[0]]) if beyond.size else float("inf")


class Run(ABC):
    """An answer in the making. Close it, also after an error."""

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Yield the answer in order, at most some 0.2 s of work apart."""

    @property
    @abstractmethod
    def progress(self) -> float:
        """Part of the work done, 0 to 1."""

    @abstractmethod
    def errors(self) -> list[SolverError]:
        """Return the estimate for every realisation, once all blocks are out."""

    @abstractmethod
    def cost(self) -> Cost:
        """Return what it has cost so far."""

    @abstractmethod
    def state(self) -> Mapping[str, Array]:
        """Return what `Engine.start` needs to go on with the same bits after the last block with samples."""

    @abstractmethod
    def close(self) -> None:
        """Release everything."""


class Engine(ABC):
    """A way to answer a scene; its options are constructor arguments."""

    name: ClassVar[str]
    equation: ClassVar[int]

    @abstractmethod
    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why it cannot do this scene, as (key, reason); empty if it can."""

    @abstractmethod
    def candidate(self, scene: Scene, tolerance: float) -> Candidate:
        """Propose how to answer within the tolerance.

        Raises
        ------
        ToleranceNotMet
            If it knows beforehand that it cannot.
        """

    @abstractmethod
    def refine(self, candidate: Candidate, error: SolverError | None, tolerance: float) -> Candidate | None:
        """Propose the next try after a run that missed the tolerance (or broke down: error None).

        None says that nothing can help: round-off alone exceeds the tolerance.
        """

    def look(self, scene: Scene, candidate: Candidate) -> Candidate:
        """Look closer, for `candidate.look_s`, at what the equation leaves out of this scene."""
        return candidate

    def instead(self, scene: Scene, candidate: Candidate, error: SolverError, tolerance: float) -> Candidate | None:
        """Propose a try with another engine where a run shows that this one's equation leaves out too much.

        Raises
        ------
        ToleranceNotMet
            If there is none.
        """
        return None

    def of(self, candidate: Candidate) -> Engine:
        """Return the engine that answers with a candidate: this one, unless it chooses among others."""
        return self

    @abstractmethod
    def start(self, scenes: Sequence[Scene], candidate: Candidate, state: Mapping[str, Array] | None = None) -> Run:
        """Start one scene, or a batch of scenes that differ in numbers only."""

    @abstractmethod
    def describe(self, scene: Scene, candidate: Candidate) -> dict[str, str]:
        """Return the choices that shape the answer and the versions behind it, for the record."""
