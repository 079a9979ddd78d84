"""Engines that step through time: options, proposal of steps, and start of a run."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from ...chain.ground import kernel_of
from ...errors import InputError, ToleranceNotMet, shown
from ...integrators.batch import ChainBatch, force_form, name_of
from ...integrators.kernels.contact_forces import PLAIN
from ...integrators.kernels.layout import PAD
from ...integrators.method import Method
from ...integrators.methods import BY_NAME, METHODS, methods_of
from ...integrators.stepper import NativeStepper, Stepper
from ...integrators.steps import Steps
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.compilation import clock
from ...util.suggestions import not_among
from ..base import Engine, ErrorBudget, Proposal
from ..cost_model import seconds
from .auxiliary_runs import LONGER, AuxiliarySteps, longer_steps
from .monitor import Monitor, TwinMonitor
from .rounding import native_floor, plain_loss
from .run import SteppingRun, restrict
from .step_choice import FIRST_STEP, STEP_CONTROL, choose_steps

AUTOMATIC = ("rkn4", "rkn6")  # Integrators of "auto", which chooses the cheaper one.
AUTOMATIC_DAMPED = ("dop853",)  # The cheapest method for damped chains at every tolerance.
LONGEST_RUN_S = 3e8  # Ten years.
# Overhead of a force evaluation in units of grains; see analysis/calibration/cost_model.py.
EVALUATION_OVERHEAD = 40


class TimeSteppingEngine(Engine):
    """An engine that integrates in time steps.

    Attributes
    ----------
    monitor : type
        Class of the monitor that estimates the errors of a run.
    adaptive : bool
        Whether steps are shorter near openings and may pass over samples, if the method allows it.
    foreign : tuple of str
        Integrators of another program that users cannot choose; `lmpchain check` compares them.
    dissipates : bool
        Whether the engine computes damped chains.
    """

    adaptive: bool = False
    monitor: ClassVar[type[Monitor]] = TwinMonitor
    foreign: ClassVar[tuple[str, ...]] = ()
    dissipates: ClassVar[bool] = True

    def __init__(self, integrator: str, step: float | None):
        if integrator not in (*self.integrators, *self.foreign):
            raise InputError.at("integrator", not_among(integrator, self.integrators))
        if step is not None and not (
            isinstance(step, int | float)
            and not isinstance(step, bool)
            and math.isfinite(step)
            and step > 0
        ):
            raise InputError.at("step", f"must be a time above 0 s (got {shown(step)})")
        self.integrator = integrator
        self.step = step

    def methods(self, scene: Scene) -> list[Method]:
        """Return the methods from which the engine chooses for a scene."""
        methods = methods_of(scene.chain)
        automatic = AUTOMATIC_DAMPED if scene.chain.damped else AUTOMATIC
        names = automatic if self.integrator == "auto" else [self.integrator]
        return [methods[name] for name in names]

    def refuses(self, scene: Scene) -> list[tuple[str, str]]:
        """Return the reasons why the method does not apply to this chain, damped or not."""
        names = methods_of(scene.chain)
        if self.integrator in ("auto", *names):
            return []
        best_first = sorted(names, key=lambda name: -names[name].order)
        cure = f"use {' or '.join(name for name in best_first if name in self.integrators)}"
        kind = "without" if scene.chain.damped else "with"
        fault = f"{self.integrator} is a method for chains {kind} damping: {cure}, or leave it out"
        return [("integrator", fault)]

    @abstractmethod
    def stepper(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array],
    ) -> Stepper:
        """Return the stepper of the main run at t = 0 or at a stored state.

        A native stepper also advances the auxiliary runs.
        """

    def steppers(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array] | None,
    ) -> dict[str, Stepper]:
        """Return the steppers of a run by the names of their states; the main stepper is first.

        The stepper "native" advances the native twin and the auxiliary runs.
        """
        twin, *beside = schedules
        method = BY_NAME[proposal.integrator]
        start = restrict("native", state)
        native = NativeStepper(ChainBatch(scenes), method, twin, start, auxiliary=beside)
        answer = self.stepper(scenes, proposal, schedules, restrict("answer", state))
        return {"answer": answer, "native": native}

    def propose(self, scene: Scene, tolerance: float) -> Proposal:
        """Propose the given step, or the longest step that should meet the tolerance."""
        scene = scene.driven_from_above
        methods = self.methods(scene)
        way = choose_steps(scene, methods, tolerance, self.adaptive, self.step)
        return self.propose_steps(scene, tolerance, *way)

    def propose_steps(
        self, scene: Scene, tolerance: float, method: Method, steps: Steps
    ) -> Proposal:
        """Propose this number of steps of a method."""
        fixed = self.step is not None
        cost_s = self.cost(scene, method, steps.total(scene.intervals))
        # Years of work come from a wrong unit, such as seconds in place of microseconds.
        if cost_s > LONGEST_RUN_S:
            years = cost_s / 3.15e7
            cure = "shorten it, or use a larger tolerance"
            raise InputError.at("duration", f"would take some {years:.1g} years: {cure}")
        return Proposal(
            engine=self.name,
            equation=self.equation,
            steps=steps,
            active_grains=scene.chain.grains,
            model_error=0.0,
            solver_error=math.nan if fixed else tolerance,
            cost_s=cost_s,
            tolerance=math.inf if fixed else tolerance,
            fixed=fixed,
            integrator=method.name,
            choices=self.choices(scene),
        )

    def choices(self, scene: Scene) -> Mapping[str, str | float]:
        """Return the choices that the engine makes for the user."""
        return {}

    def cost(self, scene: Scene, method: Method, steps: int) -> float:
        """Return the expected time of this number of steps, s."""
        grain_steps = (
            method.evaluations * steps * (self.count_active(scene) + self.overhead(method))
        )
        return seconds(self.name, self.start_up_s, self.seconds_per_grain_step * grain_steps)

    @abstractmethod
    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Return the expected rounding error of this number of steps at this largest speed, m/s."""

    def overhead(self, method: Method) -> int:
        """Return the overhead of a force evaluation in units of grains."""
        return EVALUATION_OVERHEAD

    def count_active(self, scene: Scene) -> float:
        """Return the mean number of grains that a step computes."""
        return scene.chain.grains

    def refine(
        self, proposal: Proposal, error: ErrorBudget | None, tolerance: float
    ) -> Proposal | None:
        """Propose a shorter step, adaptive near openings if contacts have opened."""
        method = BY_NAME[proposal.integrator]
        steps = proposal.steps
        ratio = STEP_CONTROL.ratio(error, tolerance)
        if ratio is None:
            # Samples that are not interpolated have a smaller rounding error.
            return proposal.with_steps(steps.sampled) if steps.stride > 1 else None
        if error is None or error.order < method.order:
            # The run opened contacts that were expected to stay closed.
            steps = steps._replace(adaptive=self.adaptive and method.adaptive)
            if steps.coarse_openings:
                # Steps near openings become shorter; the other steps may stay as long.
                ratio = max(1.0, ratio / FIRST_STEP.coarse_error ** (1 / method.order))
        shorter = steps.shorten(math.ceil(steps.per_landing * ratio))
        # With one step a sample or more, landing on every sample is cheaper.
        every = shorter.per_landing > shorter.stride
        return proposal.with_steps(shorter.sampled if every else shorter)

    def lengthen(
        self, scene: Scene, proposal: Proposal, error: ErrorBudget, tolerance: float
    ) -> Proposal | None:
        """Propose the longest step that the error allows; None if little is gained.

        Auxiliary runs with four times the step must remain stable, because they show the order of
        convergence. A step that the user gave is not changed.
        """
        method = BY_NAME[proposal.integrator]
        steps = proposal.steps
        interval = steps.step * steps.per_landing
        longest = min(method.stability_limit, math.pi) / LONGER[-1] / scene.highest_frequency
        aimed = steps.per_landing * STEP_CONTROL.aim(error, tolerance)
        # Auxiliary runs that broke down show no error.
        if math.isinf(aimed):
            return None
        fewer = math.ceil(max(aimed, interval / longest))
        gains = steps.per_landing >= STEP_CONTROL.least * fewer
        return proposal.with_steps(steps.shorten(fewer)) if gains and not proposal.fixed else None

    def batch_key(self, scene: Scene, proposal: Proposal) -> tuple:
        """Return a key; scenes with equal keys are similar and have the same steps."""
        steps = proposal.steps
        longer = longer_steps(BY_NAME[proposal.integrator], scene, steps)
        return *kind(scene), steps, proposal.integrator, *longer, *proposal.choices.items()

    def start(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None = None,
    ) -> SteppingRun:
        """Start a run of one scene, or of a batch of scenes that differ only in numbers."""
        if len(scenes) > 1 and len({kind(scene) for scene in scenes}) > 1:
            raise ValueError(
                "a batch needs chains of the same kind and length, and equal recording"
            )
        began = clock()
        method = BY_NAME[proposal.integrator]
        asked = scenes[0]
        scenes = [scene.driven_from_above for scene in scenes]
        scene = scenes[0]
        # This is the time on the reference machine, because bits must not depend on when a run is
        # judged.
        evaluations = method.evaluations * proposal.steps.total(scene.intervals)
        work_s = self.seconds_per_grain_step * evaluations * scene.chain.grains * len(scenes)
        auxiliary = AuxiliarySteps(method, scenes, proposal.steps, self.monitor.twins)
        schedules = proposal.steps, *auxiliary.schedules
        try:
            steppers = self.steppers(scenes, proposal, schedules, state)
            native = steppers["native"]
            assert isinstance(native, NativeStepper)
            monitor = self.monitor(native, auxiliary, method, scenes, proposal)
            run = steppers, monitor, method, scenes, asked, proposal, state, work_s, began
            return SteppingRun(*run)
        except (LookupError, TypeError, ValueError) as error:
            # Only a stored state can be the cause.
            if state is None or isinstance(error, InputError):
                raise
            why = "does not belong to its run, or was changed: run the scene anew"
            raise InputError.at("checkpoint", why) from error


class CompiledSteps(TimeSteppingEngine):
    """Integrate Eq. (1) in displacements with compiled loops; base class of the native engine."""

    name: ClassVar[str] = "native"
    equation: ClassVar[int] = 1
    integrators: ClassVar[tuple[str, ...]] = ("auto", *METHODS)
    start_up_s: ClassVar[float] = 1e-4
    # The time includes the auxiliary runs.
    seconds_per_grain_step: ClassVar[float] = 8e-10
    monitor: ClassVar[type[Monitor]] = Monitor
    threads: int = 1
    force: str = "auto"

    def __init__(self, integrator: str, step: float | None, adaptive: bool = False):
        super().__init__(integrator, step)
        self.adaptive = adaptive

    def propose_steps(
        self, scene: Scene, tolerance: float, method: Method, steps: Steps
    ) -> Proposal:
        """Propose these steps; raise `ToleranceNotMet` if rounding alone exceeds the tolerance."""
        proposal = super().propose_steps(scene, tolerance, method, steps)
        # A given step has no tolerance, and held grains have no error.
        if not proposal.fixed and scene.recorded[0] <= scene.chain.movable:
            evaluations = steps.total(scene.intervals) * method.evaluations
            floor = native_floor(evaluations, scene.total_phase)
            if floor > tolerance:
                cure = "use a larger tolerance"
                if self.integrator != "auto" and method.order < METHODS["rkn6"].order:
                    cure = f'use integrator "rkn6", which takes fewer steps, or {cure}'
                raise ToleranceNotMet(
                    f"round-off alone may make an error of {floor:.1g}, above the tolerance: {cure}"
                )
        return proposal

    def choices(self, scene: Scene) -> dict[str, str]:
        """Return the form of the force as a choice of the engine."""
        return {"force": name_of(force_form(scene, self.force))}

    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Return the expected rounding error: a random walk, and the loss of a plain force.

        The phase error is assumed to be a quarter of the bound in `native_floor`.
        """
        walk = native_floor(steps * self.methods(scene)[0].evaluations, scene.total_phase / 4)
        if force_form(scene, self.force) in PLAIN:
            walk += plain_loss(scene, steps) / speed
        return walk

    def count_active(self, scene: Scene) -> float:
        """Return the mean number of grains that a step computes, those that waves have reached."""
        first, last = scene.excitation.reach(scene.chain)
        # A front advances by half a grain a radian, and the mean width is half the final one.
        reached = last - first + 1 + 2 * PAD + scene.total_phase / 4
        return min(scene.chain.grains, reached)

    def stepper(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array],
    ) -> NativeStepper:
        """Return the stepper of the main run and of its auxiliary runs."""
        answer, *beside = schedules
        chains = ChainBatch(scenes, self.force)
        method = BY_NAME[proposal.integrator]
        return NativeStepper(chains, method, answer, state, self.threads, beside)

    def steppers(
        self,
        scenes: Sequence[Scene],
        proposal: Proposal,
        schedules: Sequence[Steps],
        state: Mapping[str, Array] | None,
    ) -> dict[str, Stepper]:
        """Return the only stepper of a run by the name of its state."""
        return {"native": self.stepper(scenes, proposal, schedules, restrict("native", state))}


def kind(scene: Scene) -> tuple:
    """Return a key of scenes that fit into one batch: equal chain type, ends and recording."""
    chain = scene.chain
    excitation = scene.excitation
    ends = chain.top, chain.bottom, chain.loose_grains
    built = chain.grains, *ends, chain.law.form, chain.compressed, chain.damped
    on_ground = chain.ground and kernel_of(chain.ground)
    acted = excitation.driven, excitation.does_work, excitation.from_below
    return *built, on_ground, *acted, scene.samples, scene.duration, scene.grains
