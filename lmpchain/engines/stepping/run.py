"""A run in time steps: advances the main run and its auxiliary runs block by block."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...integrators.method import Method
from ...integrators.stepper import UNFIT, Stepper, room_for
from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import Array, as_slice
from ...util.compilation import clock
from ..base import ErrorBudget, Proposal, Run
from .monitor import Fill, Monitor

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
