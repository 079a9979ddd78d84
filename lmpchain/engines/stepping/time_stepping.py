"""Engines that step through time: options, proposal of steps, and the run block by block."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np

from ...chain.ground import kernel_of
from ...errors import InputError, ToleranceNotMet, not_among, shown
from ...integrators.batch import ChainBatch, force_form, name_of
from ...integrators.kernels.contact_forces import PLAIN
from ...integrators.kernels.layout import PAD
from ...integrators.methods import BY_NAME, METHODS, methods_of
from ...integrators.stepper import UNFIT, NativeStepper, Stepper, room_for
from ...integrators.steps import Method, Steps
from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import Array, as_slice
from ...util.compilation import clock
from ..base import Engine, ErrorBudget, Proposal, Run
from ..cost_model import seconds
from .auxiliary_runs import LONGER, AuxiliarySteps, longer_steps
from .monitor import Fill, Monitor, TwinMonitor
from .rounding import native_floor, plain_loss
from .step_choice import FIRST_STEP, STEP_CONTROL, choose_steps

PIECE_S = 0.1  # Longest time of one call of a stepper: a run can be stopped between two calls.
# Memory of the samples of one block, bytes, and the longest time that a block may take, s: a run
# that is interrupted loses one block at most.
BLOCK_BYTES = 2**25
BLOCK_S = 0.5


class SteppingRun(Run):
    """A run in time steps, whose error a monitor estimates from auxiliary runs.

    Parameters
    ----------
    steppers : mapping
        Steppers by the name under which their state is stored; the stepper of the answer is first.
    monitor : Monitor
        Monitor that estimates the errors.
    method : Method
        Integration method of all runs.
    scenes : sequence of R scenes
        Scenes that are computed: one scene, or a batch of scenes that differ only in numbers.
    asked : Scene
        First requested scene. If it is driven from below, the computed scene is upside down.
    proposal : Proposal
        Proposed steps of the run.
    state : mapping, optional
        Arrays that the method `state` of an interrupted run returned.
    work_s : float
        Expected wall time of the steps, s, from which the times of judging the run follow.
    began : float
        Time of `util.compilation.clock` before the steppers were made, s.
    """

    def __init__(
        self,
        steppers: Mapping[str, Stepper],
        monitor: Monitor,
        method: Method,
        scenes: Sequence[Scene],
        asked: Scene,
        proposal: Proposal,
        state: Mapping[str, Array] | None,
        work_s: float,
        began: float,
    ):
        self.scene = scenes[0]
        self.asked = asked
        self.method = method
        self.proposal = proposal
        self.monitor = monitor
        self.realisations = len(scenes)
        samples = self.scene.samples
        grains = self.scene.chain.grains
        self._names = list(steppers)
        self._steppers = list(steppers.values())
        self._answer = self._steppers[0]
        # Time spent in each stepper, s, and its steps a second in the last call.
        work = self.realisations * grains * method.evaluations
        self._seconds = [0.0] * len(steppers)
        self._rates = [stepper.guessed_rate / work for stepper in self._steppers]
        self._begun = [0.0] * len(steppers)
        self._together = math.lcm(monitor.together, self._answer.stride)
        bytes_a_sample = 16 * (monitor.runs + 1) * self.realisations * grains
        self._longest_block = fit_block(BLOCK_BYTES // bytes_a_sample, samples, self._together)
        # Time of a sample, s; a guess until the first block is done.
        self._sample_s = proposal.cost_s * self.realisations / samples
        self._looks = monitor.choose_looks(work_s, self._together)
        monitor.make_room(self._longest_block + 1)
        self._sample = -1
        if state is not None:
            self._sample = int(state["sample"])
            begin = max(self._sample, 0)
            if any(stepper.sample != begin for stepper in steppers.values()):
                raise ValueError(UNFIT)
            self._begun = [stepper.progress for stepper in self._steppers]
            monitor.restore(state)
        self._setup_s = clock() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the solution in blocks, without the samples before a restored state."""
        final = self.scene.intervals
        while self._sample < final:
            if self._sample in self._looks:
                self.judge(self)
            first = self._sample + 1
            until = self._end_of_block(final)
            spent_s = self._spent_s
            u, v = room_for(self.realisations, until + 1 - first, self.scene.chain.grains)
            if first == 0:
                u[:, 0], v[:, 0] = self.monitor.initial
            fills = self.monitor.fills(self._answer, u, v, first)
            for number, fill in enumerate(fills):
                while not self._move(number, fill, until):
                    # The adaptive steps of a run that broke down become ever shorter.
                    self.monitor.leave_broken(first, until)
                    nothing = np.empty((self.realisations, 0, self.scene.count(self.scene.chain)))
                    yield Block(slice(first, first), nothing, nothing)
            self.monitor.compare(u, v, first, until)
            self._sample = until
            if self.asked.excitation.from_below:
                u, v = -u[:, :, ::-1], -v[:, :, ::-1]
            if self.asked.grains != "all":
                columns = as_slice(self.asked.recorded - 1)
                u = np.array(u[:, :, columns])
                v = np.array(v[:, :, columns])
            yield Block(slice(first, until + 1), u, v)
            if until < final:
                self._sample_s = (self._spent_s - spent_s) / (until + 1 - first)

    def _move(self, number: int, fill: Fill, until: int) -> bool:
        """Advance a stepper by about a tenth of a second; return whether it reached its sample."""
        max_steps = max(1, int(self._rates[number] * PIECE_S))
        began = clock()
        steps = fill(until, max_steps)
        spent_s = clock() - began
        self._rates[number] = steps / max(spent_s, 1e-9)
        self._seconds[number] += spent_s
        return steps < max_steps or self._steppers[number].sample >= until

    def _end_of_block(self, final: int) -> int:
        """Return the last sample of the next block.

        A block ends at a sample on which steps of all runs end.
        """
        begin = max(self._sample, 0)
        fit = min(self._longest_block, int(BLOCK_S / self._sample_s))
        # The run is judged at samples that do not depend on its speed, so that the bits do not
        # either.
        end = min((look for look in self._looks if look > begin), default=final)
        if begin + fit >= end:
            return end
        return min(begin + fit_block(fit, self.scene.samples, self._together), end)

    @property
    def _spent_s(self) -> float:
        return sum(self._seconds, self.monitor.seconds)

    @property
    def progress(self) -> float:
        """Part of the work done, 0 to 1, weighted by the expected time of each stepper."""
        done = [stepper.progress for stepper in self._steppers]
        # A stepper that has not moved yet has no weight.
        lasts_s = [
            spent_s / (part - begun) if part > begun else 0.0
            for spent_s, part, begun in zip(self._seconds, done, self._begun, strict=True)
        ]
        if not any(lasts_s):
            return min(done)
        return float(np.dot(lasts_s, done) / sum(lasts_s))

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation."""
        return self.monitor.errors()

    def outlook(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation, extrapolated to the end."""
        return self.monitor.outlook()

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return the dissipated energy and the work of the forcing, with their errors."""
        return self.monitor.energies(errors)

    def cost(self) -> Cost:
        """Return the cost so far.

        The numbers of steps and of evaluations are those of the realisation with the most steps.
        """
        steps = int(max(self._answer.steps.tolist()))
        integration_s = self._answer.own_part * self._seconds[0]
        return Cost(
            integration_s=integration_s,
            estimate_s=self._spent_s - integration_s,
            setup_s=self._setup_s,
            steps=steps,
            force_evaluations=steps * self.method.evaluations,
            active_grains=self.scene.chain.grains,
            integrator=self.method.name,
            step_s=self.proposal.step,
            ranks=self._answer.ranks,
        )

    def state(self) -> dict[str, Array]:
        """Return the state of all runs and of their comparison at the last sample."""
        state = {"sample": np.array(self._sample)} | self.monitor.state()
        for name, stepper in zip(self._names, self._steppers, strict=True):
            state |= {f"{name}.{key}": array for key, array in stepper.state().items()}
        return state

    def close(self) -> None:
        """Release every stepper."""
        for stepper in self._steppers:
            stepper.close()


def fit_block(fit: int, samples: int, together: int) -> int:
    """Return the samples of a block: all if they fit, or a multiple of `together`."""
    return samples - 1 if fit >= samples else max(1, fit // together) * together


def restrict(stepper: str, state: Mapping[str, Array] | None) -> dict[str, Array]:
    """Return the state of one stepper, by the names of its own arrays."""
    if state is None:
        return {}
    prefix = f"{stepper}."
    return {
        key.removeprefix(prefix): array for key, array in state.items() if key.startswith(prefix)
    }


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
        """Return the methods from which the engine chooses for a scene, or raise `InputError`."""
        if faults := self.refuses(scene):
            raise InputError(faults)
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
            method.evaluations * steps * (self.count_active(scene) + self.overhead(scene, method))
        )
        return seconds(self.name, self.start_up_s, self.seconds_per_grain_step * grain_steps)

    @abstractmethod
    def typical_round_off(self, scene: Scene, steps: int, speed: float) -> float:
        """Return the expected rounding error of this number of steps at this largest speed, m/s."""

    def overhead(self, scene: Scene, method: Method) -> int:
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
