"""Error estimate by Richardson extrapolation: an answer beside companion runs at other step sizes.

The answer runs at the step h. Beside it run native companions, see `companions`; one whose step is longer than the
time between two samples passes over some. An engine that rounds in another way than the native one also has a native
twin at the same step. Twin and answer are the same map in exact arithmetic: what they differ by is round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFailed
from ..integrators.batch import ChainBatch
from ..integrators.kernels.reductions import (
    NO_NUMBERS,
    SOUND,
    TOO_CLOSE,
    TOO_FAST,
    compared,
    in_parts,
)
from ..integrators.methods import Method
from ..integrators.step_schedule import StepSchedule
from ..integrators.stepper import NativeStepper, Stepper, room_for
from ..scene.scene import Scene
from ..trajectory.record import Block, Cost
from ..util.arrays import Array, as_slice
from ..util.compilation import clock
from .amplification import amplified_digit, walked
from .base import Candidate, ErrorBudget, Run
from .companions import CLOSE_TO_OPENING, Companions
from .round_off import between_loss, native_floor, plain_loss, rounded_energy

PIECE_S = 0.1  # longest stretch of work between two opportunities to stop
GUESSED_RATE = 1e8  # grain-steps a second, a low guess to begin with
BLOCK_BYTES = 2**25  # of the samples that are compared at a time,
BLOCK_S = 0.5  # and how long they may take: what is stopped or killed loses no more
WRONG = {
    TOO_CLOSE: "grains overlap more than all the energy there is allows",
    TOO_FAST: "the kinetic energy exceeds all the energy there is",
    NO_NUMBERS: "positions or velocities are no longer numbers",
}
# analysis/calibration/amplified_rounding.py measures the next ones
# over round-off: what two runs may differ by for that reason alone, which no law of the step divides, where contacts
# open and waves may come back, or not: reflections through opening contacts make much of a little
GROWN, STEADY = 300.0, 3.0
# rounding that all runs share (of the parameters, say), where contacts open, as a multiple of what becomes of a last
# digit; looked for below that estimate, if it can grow so far: from so much, by less than that exponent a radian
SHARED, NEAR_ROUNDOFF, SHORT, GROWTH = 1.0, 0.1, 1e-13, 0.05
SCATTER = 10.0  # multiple of that, and of the walk of rounding, by which two runs may differ for rounding alone
BY_CHANCE = 3.0  # factor on what they do differ by then, for roundings may agree by chance
MOTION = np.zeros((0, 2))  # errors are relative to that, and to nothing instead


class CompanionRun(Run):
    """An answer at one step size, with companions at others that show its error.

    Parameters
    ----------
    make : callable
        Makes the stepper of the answer from its schedule and its kept state, with its companions if it is native.
    method : Method
    scenes : sequence of Scene
        One, or a batch of like ones.
    candidate : Candidate
    state : mapping, optional
        What `state` returned.
    twin : bool
        Whether the answer is not native, so that a native twin at the same step measures its round-off.
    """

    def __init__(
        self,
        make: Callable[[Sequence[StepSchedule], Mapping[str, Array]], Stepper],
        method: Method,
        scenes: Sequence[Scene],
        candidate: Candidate,
        state: Mapping[str, Array] | None,
        twin: bool,
    ):
        began = clock()
        self.method, self.scene, self.candidate, self._scenes = method, scenes[0], candidate, scenes
        self._amplified: dict[int, float] = {}
        self._companions = chosen = Companions(method, scenes, candidate, twin)
        own, self._twin = chosen.own, int(twin)
        if twin:
            batch, kept = ChainBatch(scenes), _of("native", state)
            self.native = NativeStepper(batch, method, own, kept, companions=chosen.schedules)
            self._answer = make((own,), _of("answer", state))
            self._steppers: tuple[Stepper, ...] = self._answer, self.native
            pressed = rounded_energy(
                self.scene, candidate.steps(self.scene.samples) * method.evaluations
            )
            self._allowed = batch.allowed + 3 * pressed
        else:
            self._answer = make((own, *chosen.schedules), _of("native", state))
            self.native = cast(NativeStepper, self._answer)
            self._steppers, self._allowed = (self._answer,), self.native.chains.allowed
        self._chains, self.realisations, others = (
            self.native.chains,
            len(scenes),
            len(chosen.against),
        )
        self._furthest = math.inf
        if (
            self._chains.imposed.acts
        ):  # no energy bounds what is driven, but a million times as close as long, it is broken
            self._furthest = 1e6 * min(scene.chain.diameters.sum() for scene in scenes)
        samples, grains = self.scene.samples, self.scene.chain.grains
        self._together = math.lcm(chosen.together, self._answer.stride)
        self._most = _block(others + 1, self.realisations, grains, samples, self._together)
        self._sample_s = candidate.cost_s * self.realisations / samples  # a guess to begin with
        # the fields of the companions, with sample 0 in the first block
        self._beside = room_for(others, self.realisations, self._most + 1, grains)
        self._lost: NDArray[np.bool_] | None = None  # realisations that companions have lost
        shape = (others, samples, self.realisations, 2)
        self._differences, self._peaks, self._sample = (
            np.zeros(shape),
            np.zeros((self.realisations, 2)),
            -1,
        )
        if state is not None:
            self._differences, self._peaks = state["differences"].copy(), state["peaks"].copy()
            self._sample = int(state["sample"])
            apart = any(stepper.sample != max(self._sample, 0) for stepper in self._steppers)
            if (
                self._differences.shape != shape
                or self._peaks.shape != (self.realisations, 2)
                or apart
            ):
                raise ValueError("the state that was kept does not fit")
        self._rate = [GUESSED_RATE / (self.realisations * grains * method.evaluations)] * len(
            self._steppers
        )
        self._seconds, self._compared_s = [0.0] * len(self._steppers), 0.0
        self._setup_s = clock() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the answer; samples that a restored state already had are not repeated."""
        final = self.scene.samples - 1
        while self._sample < final:
            first, spent = self._sample + 1, sum(self._seconds) + self._compared_s
            fit, together = min(self._most, int(BLOCK_S / self._sample_s)), self._together
            begun, count = max(self._sample, 0), max(1, fit // together) * together
            until = final if begun + fit >= final else min(begun + count, final)
            own = room_for(self.realisations, until + 1 - first, self.scene.chain.grains)
            if first == 0:
                own[0][:, 0], own[1][:, 0] = self._chains.initial
            native, beside, fills = own, self._beside, []
            if self._twin:
                u, v = self._beside
                native, beside = (u[0], v[0]), (u[1:], v[1:])
                fills = [partial(self._answer.fill, *own, first)]
            for index, fill in enumerate(
                [*fills, partial(self.native.fill, *native, first, beside=beside)]
            ):
                while not self._moved(index, fill, until):
                    self._leave_broken(first, until)  # adaptive steps would be ever shorter
                    nothing = np.empty((self.realisations, 0, self.scene.count(self.scene.chain)))
                    yield Block(slice(first, first), nothing, nothing)
            yield self._keep(*own, first, until + 1)
            if until < final:
                self._sample_s = (sum(self._seconds) + self._compared_s - spent) / (
                    until + 1 - first
                )

    def _moved(self, index: int, fill: Callable[[int, int], int], until: int) -> bool:
        """Move one stepper on for as long as nothing may interrupt; say whether it is there."""
        max_steps = max(1, int(self._rate[index] * PIECE_S))
        began = clock()
        done = fill(until, max_steps)
        took = clock() - began
        self._rate[index] = done / max(took, 1e-9)
        self._seconds[index] += took
        return done < max_steps or self._steppers[index].sample >= until

    def _leave_broken(self, first: int, until: int) -> None:
        """Leave native chains whose grains are too close; their error is infinite. Raise if it is the answer."""
        most = self._chains.contacts.overlap_bound(self._allowed[:, None]).max(1)
        broken = self.native.closest() > np.minimum(most, self._furthest)
        if broken.any():
            if not self._twin and broken[0].any():
                raise RunFailed(self._broke_down(first, WRONG[TOO_CLOSE]))
            self.native.leave(broken, until)
            self._lost = broken[1 - self._twin :]

    def _keep(self, u: Array, v: Array, first: int, stop: int) -> Block:
        """Check the samples first ... stop - 1 of the answer, and keep its differences from the companions."""
        began = clock()
        of_others, kept = self._companions, (self._differences, self._peaks)
        beside = *self._beside, of_others.against, of_others.strides
        own = self._chains.contacts
        at_rest = own.overlap, own.stiffness, own.constant, own.exponent
        seen = self._allowed, self.native.watched, *at_rest, self._furthest
        verdict = compared(u, v, *beside, self._chains.masses, first, *kept, *seen)
        if verdict != SOUND:
            self._leave_broken(first, stop - 1)
            if verdict != TOO_CLOSE:
                raise RunFailed(self._broke_down(first, WRONG[verdict]))
        if self._lost is not None:
            self._differences.swapaxes(1, 2)[self._lost] = np.inf
        self._sample = stop - 1
        self._compared_s += clock() - began
        if self.scene.grains != "all":
            rows = as_slice(self.scene.recorded - 1)
            u, v = (np.array(field[:, :, rows]) for field in (u, v))
        return Block(slice(first, stop), u, v)

    def _broke_down(self, sample: int, what: str) -> str:
        t = sample * self.scene.duration / (self.scene.samples - 1)
        return f"{what} after t = {t:.4g} s with steps of {self.candidate.step:.3g} s: use a shorter step or a tolerance"

    @property
    def peaks(self) -> Array:
        """Largest displacement and speed so far, (R, 2) m and m/s."""
        return np.maximum(self._peaks, self.native.largest())

    @property
    def closest(self) -> Array:
        """Largest approach of two grains beyond that at rest, (R,) m, in the native companions."""
        return self.native.closest().max(0)

    @property
    def progress(self) -> float:
        """Part of the samples done."""
        if not self._twin:
            return self.native.progress
        return (self._answer.sample / (self.scene.samples - 1) + self.native.progress) / 2

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation."""
        chains, instead = self._chains, MOTION
        if self._twin and not self.native.largest()[0, 1]:  # only what rounding presses moves
            farthest, fastest = self.peaks[0]
            instead = np.array([[farthest, max(fastest, self.scene.highest_frequency * farthest)]])
        told, every = in_parts(
            self._differences, self._peaks, instead, chains.scale, chains.units, self.native.watched
        )
        plain, adaptive, found = chains.plain, self.candidate.adaptive, []
        for real, ((lowest, taken), (farthest, fastest), (span, _), *pairs) in enumerate(
            told.tolist()
        ):
            scene, opens = self._scenes[real], lowest <= CLOSE_TO_OPENING
            differences = pairs[self._twin :]  # between steps h, 2h (and 4h), or h and h/2
            smooth = adaptive or self.method.order == 2 or (scene.excitation.smooth and not opens)
            truncation = self._companions.truncation(real, differences, opens, smooth)
            most = max(differences[0])
            if self._companions.scatters[real]:
                most = min(most, max(differences[-1]))  # rounding makes all of these differ
            most *= BY_CHANCE if opens else 1.0
            radians, displaced = (
                scene.highest_frequency * scene.duration,
                scene.highest_frequency * span,
            )
            flies = opens and not adaptive  # in flight steps of one length round to one side
            roundoff = native_floor(taken * self.method.evaluations, radians, displaced, flies)
            if plain[real] and taken:
                roundoff += self.method.spread * plain_loss(scene, taken) / fastest
            returns = opens and (self._companions.scatters[real] or not adaptive)
            truncation = max(truncation, min(most, (GROWN if returns else STEADY) * roundoff))
            if self._twin:
                roundoff += max(pairs[0])
            elif returns and truncation + roundoff < min(
                NEAR_ROUNDOFF, SHORT * math.exp(min(GROWTH * radians, 99))
            ):
                grown = SHARED * self._grown(real, np.array([farthest, fastest]))
                truncation = max(
                    truncation, min(most, SCATTER * walked(taken * self.method.evaluations) * grown)
                )
                roundoff += grown
            if self.candidate.stride > 1:
                roundoff += between_loss(taken, displaced / radians)
            ordered = smooth and not (opens and self._companions.kinks)
            found.append(ErrorBudget(truncation, roundoff, ordered, every[real]))
        return found

    def _grown(self, real: int, peaks: Array) -> float:
        """Return what becomes of a last digit in the whole run; 0 before its end, and where nothing meets."""
        if (
            self._scenes[real].at_rest
            or self._sample < self.scene.samples - 1
            or not self.closest[real] > 0
        ):
            return 0.0
        if real not in self._amplified:
            began = clock()
            self._amplified[real] = amplified_digit(
                self._scenes[real], peaks, self._answer.steps[real]
            )
            self._compared_s += clock() - began
        return self._amplified[real]

    def cost(self) -> Cost:
        """Return what it has cost so far; steps and evaluations are those of the realisation that took most."""
        steps, part = (
            int(max(self._answer.steps.tolist())),
            1.0 if self._twin else self.native.own_part,
        )
        integration_s = part * self._seconds[0]
        return Cost(
            integration_s=integration_s,
            estimate_s=sum(self._seconds) - integration_s + self._compared_s,
            setup_s=self._setup_s,
            steps=steps,
            force_evaluations=steps * self.method.evaluations,
            active_grains=self.scene.chain.grains,
            integrator=self.method.name,
            step_s=self.candidate.step,
            ranks=self._answer.ranks,
        )

    def state(self) -> dict[str, Array]:
        """Return what `start` needs to go on from the last sample with the same bits."""
        kept = {
            "sample": np.array(self._sample),
            "differences": self._differences,
            "peaks": self.peaks,
        }
        for stepper in self._steppers:
            who = "native" if stepper is self.native else "answer"
            kept |= {f"{who}.{name}": array for name, array in stepper.state().items()}
        return kept

    def close(self) -> None:
        """Release every stepper."""
        for stepper in self._steppers:
            stepper.close()


def _block(steppers: int, realisations: int, grains: int, samples: int, together: int) -> int:
    """Return the samples of a block: all, or a multiple of those after which all steppers stop together."""
    fit = BLOCK_BYTES // (16 * steppers * realisations * grains)
    return samples - 1 if fit >= samples else max(1, fit // together) * together


def _of(who: str, state: Mapping[str, Array] | None) -> dict[str, Array]:
    """Return what is kept of a stepper."""
    if not state:
        return {}
    return {
        key.removeprefix(f"{who}."): array
        for key, array in state.items()
        if key.startswith(f"{who}.")
    }
