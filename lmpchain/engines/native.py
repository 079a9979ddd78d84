"""The native engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numba

from ..errors import InputError, ToleranceNotMet, shown
from ..integrators.batch import FORCES, ChainBatch, force_form, name_of
from ..integrators.damped_verlet import LAGGED
from ..integrators.kernels.contact_forces import PLAIN
from ..integrators.kernels.layout import PAD
from ..integrators.method import Method
from ..integrators.methods import BY_NAME, METHODS
from ..integrators.stepper import NativeStepper
from ..integrators.steps import Steps
from ..scene.scene import Scene
from ..util.arrays import Array, check_flags
from ..util.plotting import COLOURS
from ..util.suggestions import not_among
from .base import Proposal
from .stepping.round_off import native_floor, plain_loss
from .stepping.time_stepping import TimeSteppingEngine


class Native(TimeSteppingEngine):
    """Integrate Eq. (1) in displacements with compiled loops.

    Parameters
    ----------
    integrator : "auto", "rkn6", "rkn4", "kahan-li8", "kahan-li6", "verlet", "dop853" or "gear4"
        auto takes the cheaper one of rkn4 and rkn6.
    step : float, optional
        s; the largest step up to it that divides the sample interval is used, and no tolerance is
        enforced.
    threads : int
        Over which a batch of chains is shared out, or one long chain, of which each takes at least
        4096 grains in motion; not with dop853 and gear4. The bits are those of one thread.
    force : "auto", "exact" or "plain"
        The form of the force: exact keeps the digits of the weakest wave, plain is faster and wrong
        by the last digit of the force at rest, auto takes what loses nothing.
    adaptive : bool
        Whether steps shorten where a contact is about to open or has just closed, which keeps the
        order of the method there; not with a given step.

    Raises
    ------
    InputError
        If an option is wrong.
    """

    name: ClassVar[str] = "native"
    equation: ClassVar[int] = 1
    auto = "cheapest"
    style = (COLOURS["blue"], "s")
    integrators: ClassVar[tuple[str, ...]] = ("auto", *METHODS)
    foreign: ClassVar[tuple[str, ...]] = (LAGGED.name,)
    batches: ClassVar[bool] = True
    twin: ClassVar[bool] = False
    start_up_s: ClassVar[float] = 1e-4
    seconds_per_grain_step: ClassVar[float] = 8e-10  # with the companions that show the error

    def __init__(
        self,
        integrator: str = "auto",
        step: float | None = None,
        threads: int = 1,
        force: str = "auto",
        adaptive: bool = True,
    ):
        super().__init__(integrator, step)
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
            raise InputError.at("threads", f"must be a whole number from 1 (got {shown(threads)})")
        if force not in FORCES:
            raise InputError.at("force", not_among(force, FORCES))
        check_flags(adaptive=adaptive)
        self.threads = threads
        self.force = force
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
        if force_form(scene, self.force) in PLAIN:
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
        """Make the stepper of the answer and its companions."""
        answer, *companions = schedules
        chains = ChainBatch(scenes, self.force)
        method = BY_NAME[proposal.integrator]
        return NativeStepper(chains, method, answer, state, self.threads, companions)

    def describe(self, scene: Scene, proposal: Proposal) -> dict[str, str]:
        """Return the version of the compiler."""
        return {"numba": numba.__version__}
