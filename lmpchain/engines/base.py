"""The seam: an engine is a way to answer a scene.

Every engine states which equation it solves, says beforehand what an answer will cost and how far
off it will be, and delivers the answer in blocks with an estimate of its own error. The light cone,
the choice of the engine, step control, progress, Ctrl-C and where the output goes are not its
business: `lmpchain.simulation` does that for all.

In the terms of solvers of differential equations: an engine is the solver, and `step_control` the
controller. The engine proposes `Steps`, its `Run` takes them and estimates the error, and if that
exceeds the tolerance, the engine refines its proposal.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from copy import copy
from inspect import signature
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from ..integrators.methods import Method
from ..integrators.steps import Steps
from ..scene.scene import Scene
from ..trajectory.record import LARGEST_ERROR, Block, Cost, ErrorEstimate
from ..util.arrays import Array
from ..util.tables import finite

# fields of a proposal in a plan
PLAN_COLUMNS = ("engine", "equation", "integrator", "model_error", "solver_error", "active_grains",
           "step", "cost_s", "kept", "why")  # fmt: skip


class Proposal(NamedTuple):
    """An engine's proposal for a scene: steps, cost and expected errors, and the verdict on it.

    Attributes
    ----------
    engine : str
        Name of the engine.
    equation : int or None
        Number in the paper of the equation that it solves; None if the engine was not asked.
    steps : Steps
        Time steps; of an exact solution, one from sample to sample.
    active_grains : int
        Grains that are computed; 0 if the engine has no answer to propose.
    model_error, solver_error : float
        Expected relative errors: of the equation, and of its numerical solution (NaN if not
        estimated).
    cost_s : float
        Expected time, s.
    tolerance : float
        Tolerance for which the steps were chosen; infinite if no tolerance chose them, as with a
        given step.
    fixed : bool
        Whether the user gave the step, so that no tolerance is enforced.
    integrator : str
        The method that steps through time; empty where the solution is exact.
    choices : mapping
        What the engine chose on the user's behalf, for `Engine.start` and for the record: numbers
        as numbers.
    kept : bool
        Whether it is expected to meet the tolerance.
    why : str
        Why it is kept or not.
    """

    engine: str
    equation: int | None = None
    steps: Steps = Steps(1, 1, math.nan)
    active_grains: int = 0
    model_error: float = math.nan
    solver_error: float = math.nan
    cost_s: float = math.nan
    tolerance: float = math.inf
    fixed: bool = False
    integrator: str = ""
    choices: Mapping[str, str | float] = {}
    kept: bool = False
    why: str = ""

    @property
    def possible(self) -> bool:
        """Whether the engine has an answer to propose."""
        return self.active_grains > 0

    @property
    def step(self) -> float:
        """Time step, s; of an exact solution, the time between two samples."""
        return self.steps.step

    @property
    def price_s(self) -> float:
        """Expected time, s; infinite if it is not kept."""
        return self.cost_s if self.kept else math.inf

    def with_steps(self, steps: Steps) -> Proposal:
        """Return this proposal with other steps, at their cost."""
        rate = steps.per_landing / steps.stride
        before = self.steps.per_landing / self.steps.stride
        return self._replace(steps=steps, cost_s=self.cost_s * rate / before)

    def record(self) -> dict[str, str]:
        """Return the choices in words."""
        return {
            key: value if isinstance(value, str) else repr(value)
            for key, value in self.choices.items()
        }

    def to_json(self) -> dict[str, Any]:
        """Return the fields of a plan for a JSON file; numbers that are not known are null."""
        fields = {name: getattr(self, name) for name in PLAN_COLUMNS}
        return finite(fields | {"active_grains": self.active_grains or None})


class ErrorBudget(NamedTuple):
    """Estimated error of a run and its parts, as defined for `ErrorEstimate`.

    A trajectory and its files hold an `ErrorEstimate`, which is at most 2. Step control also needs
    the parts, and values however large.

    Attributes
    ----------
    truncation, roundoff : float
        From the step and from rounding.
    order : float
        Order at which the truncation error falls with the step, as far as it is trusted.
    model : float
        Estimated error of the equation itself, where it is not Eq. (1).
    remark : str
        Why the equation does not hold here, if it is known not to.
    model_bound : float
        A bound on the error of the equation, if that is larger than the estimate.
    amplified : (T,) array
        Round-off that the scene has made larger, sample by sample; empty if it was not measured.
    """

    truncation: float
    roundoff: float
    order: float
    model: float = 0.0
    remark: str = ""
    model_bound: float = 0.0
    amplified: Array = np.zeros(0)

    @property
    def solver(self) -> float:
        """Truncation and round-off together."""
        return self.truncation + self.roundoff

    @property
    def total(self) -> float:
        """Equation and solution together."""
        return self.model + self.solver

    @property
    def bound(self) -> float:
        """A bound on the error of equation and solution together."""
        return max(self.model, self.model_bound) + self.solver

    @property
    def estimate(self) -> ErrorEstimate:
        """Estimate that goes with a trajectory, at most `LARGEST_ERROR`."""
        return ErrorEstimate(min(self.model, LARGEST_ERROR), min(self.solver, LARGEST_ERROR))

    def last_known(self, tolerance: float, time: Array) -> float:
        """Return the first time at which amplified round-off exceeds the tolerance, s, or infinity.

        `time` holds the times of the samples, (T,) s.
        """
        beyond = np.flatnonzero(self.amplified > tolerance)
        return float(time[beyond[0]]) if beyond.size else float("inf")


class Run(ABC):
    """An answer in the making. Close it, also after an error.

    Attributes
    ----------
    judge : callable
        Called with the run where its estimate is looked at on the way; raises to end the attempt.
    """

    judge: Callable[[Run], None] = staticmethod(lambda _: None)

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Yield the answer in order, at most some 0.2 s of work apart."""

    @property
    @abstractmethod
    def progress(self) -> float:
        """Part of the work done, 0 to 1."""

    @abstractmethod
    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation, once all blocks are out."""

    def outlook(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation that is expected at the end."""
        return self.errors()

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return the energies that every realisation has summed up along the run, by name.

        `errors` are the estimates that `errors()` returned at the end.
        The names are those of `trajectory.gathered.ENERGIES`. By default none are summed up.
        """
        return []

    @abstractmethod
    def cost(self) -> Cost:
        """Return the cost so far."""

    @abstractmethod
    def state(self) -> Mapping[str, Array]:
        """Return the arrays from which `Engine.start` goes on, bit by bit, after the last block."""

    def close(self) -> None:
        """Release everything; by default there is nothing to release."""
        return


class Engine(ABC):
    """A way to answer a scene; its options are constructor arguments, kept under their names.

    Attributes
    ----------
    name : str
    equation : int
        Number in the paper of the equation that it solves.
    auto : "never", "cheapest" or "last"
        When "auto" takes the engine: never, where it is the cheapest, or where no other engine can
        do the scene.
    style : (str, str)
        Colour and marker of its points in charts.
    citation : str
        What a publication that shows its answers cites beside this package.
    integrators : tuple of str
        The methods among which it lets choose; empty if it does not step through time.
    inputs, logs : tuple of str
        Files that it may write to a run folder: with which a proposal runs without this package,
        and what it says on the way.
    integrator, step
        What the user gave of these.
    batches : bool
        Whether like scenes are answered in less time together.
    whole : bool
        Whether it needs all grains of a scene, also those outside of the light cone.
    suspect : str
        What of a user's own may move grains as the scene does not say, and what to do; named where
        an estimate fails.
    dissipates : bool
        Whether it knows chains that lose energy.
    ranks_of_mpi : bool
        Whether it shares a scene out over the ranks of MPI.
    start_up_s, seconds_per_grain_step : float
        Timings of the cost model, s: of every answer, and of a force evaluation for one grain;
        measured by analysis/calibration/cost_model.py.
    """

    name: ClassVar[str]
    equation: ClassVar[int]
    auto: ClassVar[Literal["never", "cheapest", "last"]] = "never"
    style: ClassVar[tuple[str, str]] = ("#000000", "x")
    citation: ClassVar[str] = ""
    integrators: ClassVar[tuple[str, ...]] = ()
    inputs: ClassVar[tuple[str, ...]] = ()
    logs: ClassVar[tuple[str, ...]] = ()
    batches: ClassVar[bool] = False
    dissipates: ClassVar[bool] = False
    ranks_of_mpi: ClassVar[bool] = False
    start_up_s: ClassVar[float] = 3e-4
    seconds_per_grain_step: ClassVar[float] = 0.0
    whole: bool = False
    suspect: str = ""
    integrator: str = ""
    step: float | None = None

    def methods(self, scene: Scene) -> Sequence[Method]:
        """Return the methods that it may take; none if it does not step through time."""
        return ()

    @property
    def moves_grains(self) -> bool:
        """Whether it solves an equation of motion of the grains, Eq. (1) or (3)."""
        return self.equation in (1, 3)

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return why a scene cannot be done, as (key, reason); empty by default: it can."""
        return []

    def trial_s(self, scene: Scene, tolerance: float) -> float:
        """Return the expected time of the runs by which an engine finds its step, s; 0 if none."""
        return 0.0

    @abstractmethod
    def propose(self, scene: Scene, tolerance: float) -> Proposal:
        """Propose how to answer within the tolerance.

        Raises
        ------
        ToleranceNotMet
            If it knows beforehand that it cannot.
        """

    @abstractmethod
    def refine(
        self, proposal: Proposal, error: ErrorBudget | None, tolerance: float
    ) -> Proposal | None:
        """Propose the next attempt after a run that missed the tolerance.

        Its error is None if it broke down. Return None if nothing can help, for round-off alone
        exceeds the tolerance.
        """

    def batch_key(self, scene: Scene, proposal: Proposal) -> Hashable:
        """Return a key of scenes that have the answers and errors in a batch that they have alone.

        None by default: such a scene is answered alone.
        """
        return None

    @abstractmethod
    def start(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None = None,
    ) -> Run:
        """Start one scene, or a batch of scenes that differ in numbers only."""

    def describe(self, scene: Scene, proposal: Proposal) -> dict[str, str]:
        """Describe, for the record, what shapes the answer besides the choices of a proposal.

        Versions of compilers and libraries, for example; nothing by default.
        """
        return {}

    def options(self) -> dict[str, Any]:
        """Return the constructor arguments that make an equal engine in another process.

        Raises
        ------
        InputError
            If one of them cannot be written down.
        """
        return {name: getattr(self, name) for name in signature(type(self)).parameters}

    def prepare(self, folder: Path) -> Self:
        """Return an engine that leaves what it writes on the way in this run folder."""
        return copy(self)

    def write_inputs(
        self, scene: Scene, proposal: Proposal, tolerance: float, folder: Path
    ) -> None:
        """Write input files to a run folder, with which the proposal runs without this package."""
        return

    def part(self, scene: Scene) -> Scene:
        """Return the part of a scene that is computed: the light cone, or all grains."""
        return scene.fine if self.whole else scene.fine.reached
