"""Interface of engines: an engine is a method to solve a scene.

Every engine states which equation it solves, predicts the cost and the error of an answer, and
yields the answer in blocks with an estimate of its own error. `lmpchain.simulation` does the rest
for all engines: light cone, choice of the engine, step control, progress, Ctrl-C and output.

In the terms of differential equations, an engine is the solver, and `step_control` is the step-size
controller. The engine proposes `Steps`, and its `Run` integrates with these steps and estimates the
error. If the error exceeds the tolerance, the engine refines its proposal.
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

# Fields of a proposal in a plan.
PLAN_COLUMNS = ("engine", "equation", "integrator", "model_error", "solver_error", "active_grains",
           "step", "cost_s", "kept", "why")  # fmt: skip


class Proposal(NamedTuple):
    """An engine's proposal for a scene: steps, cost, expected errors, and whether it is chosen.

    Attributes
    ----------
    engine : str
        Name of the engine.
    equation : int or None
        Number of the equation of the paper that the engine solves; None if the engine was not
        considered.
    steps : Steps
        Time steps; an exact solution has one step from sample to sample.
    active_grains : int
        Number of computed grains; 0 if the engine cannot solve the scene.
    model_error, solver_error : float
        Expected relative error of the equation; expected relative error of its numerical solution.
        Both are NaN if not estimated.
    cost_s : float
        Expected computing time, s.
    tolerance : float
        Tolerance for which the steps were chosen; infinite with a given step.
    fixed : bool
        Whether the user gave the step, so that no tolerance is enforced.
    integrator : str
        Name of the method of time integration; empty if the solution is exact.
    choices : mapping
        Choices that the engine made for the user. `Engine.start` and the record of the trajectory
        read them.
    kept : bool
        Whether the proposal is expected to meet the tolerance.
    why : str
        Reason for `kept`.
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
        """Whether the engine can solve the scene at all."""
        return self.active_grains > 0

    @property
    def step(self) -> float:
        """Time step, s; for an exact solution, the time between two samples."""
        return self.steps.step

    @property
    def price_s(self) -> float:
        """Expected time, s; infinite if the proposal was rejected."""
        return self.cost_s if self.kept else math.inf

    def with_steps(self, steps: Steps) -> Proposal:
        """Return this proposal with a different number of steps and their cost."""
        rate = steps.per_landing / steps.stride
        before = self.steps.per_landing / self.steps.stride
        return self._replace(steps=steps, cost_s=self.cost_s * rate / before)

    def record(self) -> dict[str, str]:
        """Return the choices of the proposal as text."""
        return {
            key: value if isinstance(value, str) else repr(value)
            for key, value in self.choices.items()
        }

    def to_json(self) -> dict[str, Any]:
        """Return the fields of a plan for a JSON file; unknown numbers are null."""
        fields = {name: getattr(self, name) for name in PLAN_COLUMNS}
        return finite(fields | {"active_grains": self.active_grains or None})


class ErrorBudget(NamedTuple):
    """Estimated error of a run with its parts, as defined for `ErrorEstimate`.

    A trajectory stores an `ErrorEstimate`, which is at most 2. Step control also needs the parts,
    without this limit.

    Attributes
    ----------
    truncation, roundoff : float
        Truncation error of the steps; rounding error.
    order : float
        Order of convergence of the truncation error, as far as it can be trusted.
    model : float
        Estimated error of the equation itself; 0 for Eq. (1).
    remark : str
        Why the equation is not valid for this scene; empty if it is valid or if this is unknown.
    model_bound : float
        Upper bound on the error of the equation, if it is larger than the estimate; otherwise 0.
    amplified : (T,) array
        Rounding error at each sample, as amplified by the scene; empty if it was not measured.
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
        """Sum of truncation and rounding error."""
        return self.truncation + self.roundoff

    @property
    def total(self) -> float:
        """Sum of the errors of the equation and of its solution."""
        return self.model + self.solver

    @property
    def bound(self) -> float:
        """An upper bound on the sum of the errors of the equation and of its solution."""
        return max(self.model, self.model_bound) + self.solver

    @property
    def estimate(self) -> ErrorEstimate:
        """The error estimate of a trajectory, at most `LARGEST_ERROR`."""
        return ErrorEstimate(min(self.model, LARGEST_ERROR), min(self.solver, LARGEST_ERROR))

    def last_known(self, tolerance: float, time: Array) -> float:
        """Return the first time, s, at which the amplified rounding error exceeds the tolerance.

        The time is infinite if the error never exceeds the tolerance. `time` are the times of the
        samples, (T,) s.
        """
        beyond = np.flatnonzero(self.amplified > tolerance)
        return float(time[beyond[0]]) if beyond.size else float("inf")


class Run(ABC):
    """A running solution of one scene or of a batch; call `close` in any case, also after an error.

    Attributes
    ----------
    judge : callable
        Function that is called with the run at some samples before the end. It raises an exception
        to end the attempt.
    """

    judge: Callable[[Run], None] = staticmethod(lambda _: None)

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Yield the solution in order, with at most about 0.2 s of work between two blocks."""

    @property
    @abstractmethod
    def progress(self) -> float:
        """Fraction of the work that is done, 0 to 1."""

    @abstractmethod
    def errors(self) -> list[ErrorBudget]:
        """Return the error estimate of every realisation for the samples computed so far."""

    def outlook(self) -> list[ErrorBudget]:
        """Return the error of every realisation, extrapolated to the end of the run."""
        return self.errors()

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return the energies of every realisation that the run has integrated, by name.

        `errors` are the estimates at the end of the run. The names are listed in
        `trajectory.gathered.ENERGIES`. By default a run integrates no energies.
        """
        return []

    @abstractmethod
    def cost(self) -> Cost:
        """Return the cost of the run so far."""

    @abstractmethod
    def state(self) -> Mapping[str, Array]:
        """Return the arrays from which `Engine.start` continues bit for bit."""

    def close(self) -> None:
        """Release all resources; by default there are none."""
        return


class Engine(ABC):
    """A method to solve a scene; its options are constructor arguments and attributes.

    Attributes
    ----------
    name : str
        Name of the engine.
    equation : int
        Number of the equation of the paper that the engine solves.
    auto : "never", "cheapest" or "last"
        Whether "auto" chooses the engine never, if it is the cheapest engine, or if no other engine
        can solve the scene.
    style : (str, str)
        Colour and marker of the engine in charts.
    citation : str
        Reference that publications with this engine should cite, in addition to this package.
    integrators : tuple of str
        Names of the methods that a user may choose; empty if the engine does not step through time.
    inputs, logs : tuple of str
        Input files in a run folder, with which a proposal runs without this package; log files.
    integrator, step
        Integrator as given by the user; longest step as given by the user, s.
    batches : bool
        Whether a batch of similar scenes takes less time than single runs.
    whole : bool
        Whether the engine needs all grains of a scene, not only those of the light cone.
    suspect : str
        Commands of the user that may change the motion, and what to do about them. Messages on a
        failed estimate name them.
    dissipates : bool
        Whether the engine solves chains with damping.
    knows_ground : bool
        Whether the engine solves chains with a force from the ground.
    ranks_of_mpi : bool
        Whether the ranks of MPI share a scene.
    start_up_s, seconds_per_grain_step : float
        Start-up time of every answer, s; time of a force evaluation for one grain, s. Both were
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
    knows_ground: ClassVar[bool] = False
    ranks_of_mpi: ClassVar[bool] = False
    start_up_s: ClassVar[float] = 3e-4
    seconds_per_grain_step: ClassVar[float] = 0.0
    whole: bool = False
    suspect: str = ""
    integrator: str = ""
    step: float | None = None

    def methods(self, scene: Scene) -> Sequence[Method]:
        """Return the methods for a scene; an empty list if the engine has no time steps."""
        return ()

    @property
    def moves_grains(self) -> bool:
        """Whether the engine solves an equation of motion of the grains, Eq. (1) or Eq. (3)."""
        return self.equation in (1, 3)

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return reasons why the engine cannot solve a scene, as (key, reason); by default none."""
        return []

    def trial_s(self, scene: Scene, tolerance: float) -> float:
        """Return the expected time of trial runs for the step, s; 0 without trial runs."""
        return 0.0

    @abstractmethod
    def propose(self, scene: Scene, tolerance: float) -> Proposal:
        """Propose steps that are expected to meet the tolerance.

        Raises
        ------
        ToleranceNotMet
            If it is known beforehand that no steps can meet the tolerance.
        """

    @abstractmethod
    def refine(
        self, proposal: Proposal, error: ErrorBudget | None, tolerance: float
    ) -> Proposal | None:
        """Propose the next attempt after a run that missed the tolerance.

        The error is None if the run broke down. Return None if nothing can help, because the
        rounding error alone exceeds the tolerance.
        """

    def batch_key(self, scene: Scene, proposal: Proposal) -> Hashable:
        """Return a key; scenes of one key have equal results and errors in a batch and alone.

        By default the key is None, and the scene is solved alone.
        """
        return None

    @abstractmethod
    def start(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None = None,
    ) -> Run:
        """Start a run of one scene, or of a batch of scenes that differ only in numbers."""

    def describe(self, scene: Scene, proposal: Proposal) -> dict[str, str]:
        """Return the options that affect the result, besides the choices of a proposal.

        Examples are the versions of compilers and libraries. By default the dict is empty.
        """
        return {}

    def options(self) -> dict[str, Any]:
        """Return the constructor arguments of an equal engine for another process.

        Raises
        ------
        InputError
            If one of the arguments cannot be written to a file.
        """
        return {name: getattr(self, name) for name in signature(type(self)).parameters}

    def prepare(self, folder: Path) -> Self:
        """Return an engine that writes its files to this run folder."""
        return copy(self)

    def write_inputs(
        self, scene: Scene, proposal: Proposal, tolerance: float, folder: Path
    ) -> None:
        """Write to a folder the input files that run a proposal without this package."""
        return

    def part(self, scene: Scene) -> Scene:
        """Return the part of a scene that the engine solves: the light cone, or all grains."""
        return scene.fine if self.whole else scene.fine.reached
