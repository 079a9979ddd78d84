"""Time steps by compiled loops: those of the native engine, and of the trials of other engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from ...errors import ToleranceNotMet
from ...integrators.batch import ChainBatch, force_form, name_of
from ...integrators.kernels.contact_forces import ROOTS
from ...integrators.kernels.layout import PAD
from ...integrators.method import Method
from ...integrators.methods import BY_NAME, METHODS
from ...integrators.stepper import NativeStepper
from ...integrators.steps import Steps
from ...scene.scene import Scene
from ...util.arrays import Array
from ..base import Proposal
from .rounding import native_floor, plain_loss
from .time_stepping import TimeSteppingEngine


class CompiledSteps(TimeSteppingEngine):
    """Integrate Eq. (1) in displacements with compiled loops, by options that were checked."""

    name: ClassVar[str] = "native"
    equation: ClassVar[int] = 1
    integrators: ClassVar[tuple[str, ...]] = ("auto", *METHODS)
    start_up_s: ClassVar[float] = 1e-4
    # with the auxiliary runs that show the error
    seconds_per_grain_step: ClassVar[float] = 8e-10
    threads: int = 1
    force: str = "auto"

    def __init__(self, integrator: str, step: float | None, adaptive: bool = False):
        super().__init__(integrator, step)
        self.adaptive = adaptive

    def propose_steps(
        self, scene: Scene, tolerance: float, method: Method, steps: Steps
    ) -> Proposal:
        """Propose these steps, unless round-off alone exceeds the tolerance."""
        proposal = super().propose_steps(scene, tolerance, method, steps)
        # a given step is taken, whatever it leaves, and what is held has no error
        if not proposal.fixed and scene.recorded[0] <= scene.chain.movable:
            evaluations = steps.total(scene.intervals) * method.evaluations
            floor = native_floor(evaluations, scene.total_phase)
            if floor > tolerance:
                cure = "ask for less"
                if self.integrator != "auto" and method.order < METHODS["rkn6"].order:
                    cure = f'use integrator "rkn6", which takes fewer steps, or {cure}'
                raise ToleranceNotMet(
                    f"round-off alone may make an error of {floor:.1g}, above the tolerance: {cure}"
                )
        return proposal

    def choices(self, scene: Scene) -> dict[str, str]:
        """Return the form of the force."""
        return {"force": name_of(force_form(scene, self.force))}

    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Predict round-off: a random walk of force evaluations, and the loss of a plain force.

        The phase shifts by a quarter of what `native_floor` allows for.
        """
        walk = native_floor(steps * self.methods(scene)[0].evaluations, scene.total_phase / 4)
        if force_form(scene, self.force) in ROOTS:
            walk += plain_loss(scene, steps) / speed
        return walk

    def computed(self, scene: Scene) -> float:
        """Return the grains that a step computes, on average: those that waves have reached."""
        first, last = scene.excitation.reach(scene.chain)
        # a front runs at half the highest frequency, so on average the cone has half its width
        reached = last - first + 1 + 2 * PAD + scene.total_phase / 4
        return min(scene.chain.grains, reached)

    def stepper(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array],
    ) -> NativeStepper:
        """Make the stepper of the answer and of its auxiliary runs."""
        answer, *beside = schedules
        chains = ChainBatch(scenes, self.force)
        method = BY_NAME[proposal.integrator]
        return NativeStepper(chains, method, answer, state, self.threads, beside)
