"""A run in time steps: it moves an answer and the auxiliary runs beside it, block by block."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ...integrators.method import Method
from ...integrators.stepper import Stepper, room_for
from ...scene.scene import Scene
from ...trajectory.record import Block, Cost
from ...util.arrays import Array, as_slice
from ...util.compilation import clock
from ..base import ErrorBudget, Proposal, Run
from .monitor import UNFIT, Fill, Monitor

PIECE_S = 0.1  # longest stretch of work between two opportunities to stop
BLOCK_BYTES = 2**25  # of the samples that are compared at a time,
BLOCK_S = 0.5  # and how long they may take: what is stopped or killed loses no more


class Mover:
    """A stepper that moves in short calls, so that a run can be stopped between them.

    Attributes
    ----------
    name : str
        Under which the state of the stepper is stored.
    stepper : Stepper
    seconds : float
        Time spent in it, s.
    """

    def __init__(self, name: str, stepper: Stepper, rate: float):
        self.name = name
        self.stepper = stepper
        self.seconds = 0.0
        self._rate = rate
        self._begun = stepper.progress

    def move(self, fill: Fill, until: int) -> bool:
        """Move on by as many steps as take a tenth of a second; say whether it has arrived."""
        # at the rate of the call before
        max_steps = max(1, int(self._rate * PIECE_S))
        began = clock()
        steps = fill(until, max_steps)
        spent_s = clock() - began
        self._rate = steps / max(spent_s, 1e-9)
        self.seconds += spent_s
        return steps < max_steps or self.stepper.sample >= until

    @property
    def lasts_s(self) -> float:
        """Expected time of the whole run at the speed so far, s; 0 if it has not moved yet."""
        moved = self.stepper.progress - self._begun
        return self.seconds / moved if moved > 0 else 0.0


class SteppingRun(Run):
    """An answer in time steps, whose error a monitor estimates from auxiliary runs.

    Parameters
    ----------
    steppers : mapping
        Steppers by the name under which their state is stored, that of the answer first.
    monitor : Monitor
    method : Method
    scenes : sequence of R scenes
        One, or a batch of like ones.
    proposal : Proposal
    state : mapping, optional
        What `state` returned.
    work_s : float
        Expected time of its steps, s, which decides when the run is judged on the way.
    began : float
        When the steppers were begun to be made, on `util.compilation.clock`, s.
    """

    def __init__(
        self,
        steppers: Mapping[str, Stepper],
        monitor: Monitor,
        method: Method,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None,
        work_s: float,
        began: float,
    ):
        self.scene = scenes[0]
        self.method = method
        self.proposal = proposal
        self.monitor = monitor
        self.realisations = len(scenes)
        work = self.realisations * self.scene.chain.grains * method.evaluations
        self._movers = [
            Mover(name, stepper, stepper.guessed_rate / work) for name, stepper in steppers.items()
        ]
        self._answer = self._movers[0].stepper
        samples = self.scene.samples
        grains = self.scene.chain.grains
        self._together = math.lcm(monitor.together, self._answer.stride)
        bytes_a_sample = 16 * (monitor.runs + 1) * self.realisations * grains
        self._longest_block = fit_block(BLOCK_BYTES // bytes_a_sample, samples, self._together)
        # a guess to begin with
        self._sample_s = proposal.cost_s * self.realisations / samples
        self._looks = monitor.choose_looks(work_s, self._together)
        monitor.make_room(self._longest_block + 1)
        self._sample = -1
        if state is not None:
            self._sample = int(state["sample"])
            begin = max(self._sample, 0)
            if any(stepper.sample != begin for stepper in steppers.values()):
                raise ValueError(UNFIT)
            monitor.restore(state)
        self._setup_s = clock() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the answer; samples that a restored state already had are not repeated."""
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
            for mover, fill in zip(self._movers, fills, strict=True):
                while not mover.move(fill, until):
                    # adaptive steps of broken runs would be ever shorter
                    self.monitor.leave_broken(first, until)
                    nothing = np.empty((self.realisations, 0, self.scene.count(self.scene.chain)))
                    yield Block(slice(first, first), nothing, nothing)
            self.monitor.compare(u, v, first, until)
            self._sample = until
            if self.scene.grains != "all":
                columns = as_slice(self.scene.recorded - 1)
                u = np.array(u[:, :, columns])
                v = np.array(v[:, :, columns])
            yield Block(slice(first, until + 1), u, v)
            if until < final:
                self._sample_s = (self._spent_s - spent_s) / (until + 1 - first)

    def _end_of_block(self, final: int) -> int:
        """Return the last sample of the next block.

        Blocks end where all runs land on a sample together.
        """
        begin = max(self._sample, 0)
        fit = min(self._longest_block, int(BLOCK_S / self._sample_s))
        # it is judged at samples that do not rest on the speed of the run, so that bits do not
        end = min((look for look in self._looks if look > begin), default=final)
        if begin + fit >= end:
            return end
        return min(begin + fit_block(fit, self.scene.samples, self._together), end)

    @property
    def _spent_s(self) -> float:
        return sum([mover.seconds for mover in self._movers], self.monitor.seconds)

    @property
    def progress(self) -> float:
        """Part done of the time that all takes at its speed."""
        done = [mover.stepper.progress for mover in self._movers]
        # a stepper that has not begun counts for nothing
        lasts_s = [mover.lasts_s for mover in self._movers]
        if not any(lasts_s):
            return min(done)
        return float(np.dot(lasts_s, done) / sum(lasts_s))

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation."""
        return self.monitor.errors()

    def outlook(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation that is expected at the end."""
        return self.monitor.outlook()

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return what damping has taken and what was put in, with their errors."""
        return self.monitor.energies(errors)

    def cost(self) -> Cost:
        """Return the cost so far.

        Steps and evaluations are those of the realisation that took most.
        """
        steps = int(max(self._answer.steps.tolist()))
        integration_s = self._answer.own_part * self._movers[0].seconds
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
        for mover in self._movers:
            arrays = mover.stepper.state()
            state |= {f"{mover.name}.{key}": array for key, array in arrays.items()}
        return state

    def close(self) -> None:
        """Release every stepper."""
        for mover in self._movers:
            mover.stepper.close()


def fit_block(fit: int, samples: int, together: int) -> int:
    """Return the samples of a block: all if they fit, or a multiple of `together`."""
    return samples - 1 if fit >= samples else max(1, fit // together) * together


def restrict(stepper: str, state: Mapping[str, Array] | None) -> dict[str, Array]:
    """Return the state of one stepper, under the names that it knows."""
    prefix = f"{stepper}."
    arrays = (state or {}).items()
    return {key.removeprefix(prefix): array for key, array in arrays if key.startswith(prefix)}
