"""Error estimate by Richardson extrapolation: an answer beside companion runs at other step sizes.

The answer runs at the step h. Beside it run native companions at about 2h and 4h (where those are unstable, or the run
has too few steps for them, one at h/2): the rate at which their differences shrink gives the truncation error. Where
contacts open again and again, errors scatter, and two may agree by chance: there runs one more, at about 1.5h (1.75h
and from the first opening on for springs, whose force has a kink there). Where a companion's step is longer than the
time between two samples, it passes over some. An engine that rounds in another way than the native one also has a
native twin at the same step. Twin and answer are the same map in exact arithmetic: what they differ by is round-off.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFailed
from ..integrators.batch import ChainBatch
from ..integrators.kernels.reductions import compared
from ..integrators.methods import Method
from ..integrators.step_schedule import StepSchedule
from ..integrators.stepper import NativeStepper, Stepper
from ..scene.scene import Scene
from ..trajectory.record import Block, Cost
from ..util.arrays import Array, as_slice
from ..util.compilation import clock
from .amplification import amplified_digit, walked
from .base import Candidate, ErrorBudget, Run
from .richardson import extrapolate
from .round_off import native_floor, plain_loss, rounded_energy

PIECE_S = 0.1  # longest stretch of work between two opportunities to stop
GUESSED_RATE = 1e7  # grain-steps a second, a low guess to begin with
BLOCK_BYTES = 2**25  # of the samples that are compared at a time,
BLOCK_S = 0.5  # and how long they may take: what is stopped or killed loses no more
# analysis/calibration/richardson_estimate.py measures the constants of the estimate
FEWEST = 8  # steps of a run from which on companions have longer steps; of these there are then no two alike
# analysis/calibration/amplified_rounding.py measures the next ones
# over round-off: what two runs may differ by for that reason alone, which no law of the step divides, where contacts
# open or not; reflections through opening contacts make much of a little
GROWN, STEADY = 300.0, 3.0
# rounding that all runs share (of the parameters, say), where contacts open, as a multiple of what becomes of a last
# digit; looked for below that estimate, if it can grow so far: from so much, by less than that exponent a radian
SHARED, NEAR_ROUNDOFF, SHORT, GROWTH = 1.0, 0.1, 1e-13, 0.05
SCATTER = 10.0  # multiple of that, and of the walk of rounding, by which two runs may differ for rounding alone
BY_CHANCE = 3.0  # factor on what they do differ by then, for roundings may agree by chance
# analysis/calibration/richardson_estimate.py
CLOSE_TO_OPENING = -0.5  # r / eps below which a contact's force is no longer a smooth function of time
# order assumed in the Richardson estimate after adaptive steps through an opening, where differences scatter
ORDER_AT_OPENINGS = 4
# radians a grain from which on waves come back to where contacts opened, and the step of one more companion then
COMES_BACK, NEARBY = 10.0, 1.5
# the same for exponents below that, whose force has a kink at an opening: errors scatter from the first one on, so far
# that all runs may agree by chance on less than the error; a factor on the estimate makes up for it
KINKED_BELOW, ORDER_AT_KINKS, NEARBY_AT_KINKS, SAFETY_AT_KINKS = 1.25, 2, 1.75, 2.0


class CompanionRun(Run):
    """An answer at one step size, with companions at others that show its error.

    Parameters
    ----------
    make : callable
        Makes the stepper of the answer from its schedule and its kept state.
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
        make: Callable[[StepSchedule, Mapping[str, Array]], Stepper],
        method: Method,
        scenes: Sequence[Scene],
        candidate: Candidate,
        state: Mapping[str, Array] | None,
        twin: bool,
    ):
        began = clock()
        self.method, self.scene, self.candidate, self._scenes = method, scenes[0], candidate, scenes
        self._amplified: dict[int, float] = {}
        self._rows = as_slice(scenes[0].recorded - 1)
        kept = _unpack(state)
        own = candidate.steps_per_sample, candidate.step, candidate.adaptive
        self._answer = make(StepSchedule.of(*own), kept[0])
        self._steppers: list[Stepper] = [self._answer]
        reach = candidate.step * max(scene.chain.band_edge for scene in scenes)
        steps = candidate.steps_per_sample * (final := self.scene.samples - 1)
        longer: list[float] = [ratio for ratio in (2, 4) if ratio * reach <= method.stability_limit and steps >= FEWEST]
        self._twin, self._finer = twin, not longer
        self._stretched = stretched = candidate.adaptive and method.adaptive == "error"  # samples cut some of its steps
        self._kinks = self.scene.chain.exponent < KINKED_BELOW
        scatters = [bool(longer) and candidate.adaptive and _scatters(scene, self._kinks) for scene in scenes]
        self._scatters = np.array(scatters)
        if any(scatters):
            longer.append(NEARBY_AT_KINKS if self._kinks else NEARBY)
        schedules = [StepSchedule.of(*own, ratio, stretched) for ratio in longer] or [StepSchedule.of(*own).halved]
        self._ratios = [steps / schedule.total(final) for schedule in schedules]
        if twin:
            schedules = [StepSchedule.of(*own), *schedules]
        shared = None if twin else cast(NativeStepper, self._answer)
        chains, threads = (shared.chains, shared.threads) if shared else (ChainBatch(scenes), 1)
        companions = [
            NativeStepper(chains, method, schedule, old, threads)
            for schedule, old in zip(schedules, kept[1:], strict=False)
        ]
        self._against = np.arange(len(schedules))  # each differs from the next longer step, one nearby from the answer
        if any(scatters):
            self._against[-1] = 0
        self._native = [*([shared] if shared else []), *companions]
        self._steppers += companions
        self.realisations, self._at_rest = len(scenes), chains.scale[:, 1] == 0
        self._radians = [scene.highest_frequency * scene.duration for scene in scenes]
        self._kinked = np.array([not scene.excitation.smooth for scene in scenes])
        self._masses, self._scale = chains.masses, chains.units
        # contacts never hold less energy than at rest: the kinetic one cannot exceed what is put in, or rounded
        pressed = rounded_energy(self.scene, steps * method.evaluations) if twin else 0.0
        energy = 3 * np.array([scene.energy + pressed for scene in scenes])
        self._most_energy = energy + self._masses.sum(1) * (1e-3 * self._scale[:, 1]) ** 2
        # m; nothing bounds what is driven, but if it is a million times as close as it is long, it has broken down
        bounds = chains.contacts.overlap_bound(self._most_energy[:, None]).max(1)
        self._deepest = np.minimum(bounds, [1e6 * scene.chain.diameters.sum() for scene in scenes])
        samples, grains = self.scene.samples, self.scene.chain.grains
        self._together = math.lcm(4, *(stepper.stride for stepper in self._steppers))
        self._most = _block(len(self._steppers), self.realisations, grains, samples, self._together)
        self._sample_s = candidate.cost_s * self.realisations / samples  # a guess to begin with
        self._begin = chains.initial
        shape = (len(self._steppers) - 1, self.realisations, self._most + 1, grains)  # with sample 0 in the first block
        self._beside = np.zeros(shape), np.zeros(shape)  # the fields of the companions
        shape = (len(self._steppers) - 1, samples, self.realisations, 2)
        self._differences = np.zeros(shape) if state is None else state["differences"].copy()
        self.peaks = np.zeros((self.realisations, 2)) if state is None else state["peaks"].copy()
        self._sample = -1 if state is None else int(state["sample"])
        apart = any(stepper.sample != max(self._sample, 0) for stepper in self._steppers)
        if self._differences.shape != shape or self.peaks.shape != (self.realisations, 2) or apart:
            raise ValueError("the state that was kept does not fit")
        self._rate = np.full(len(self._steppers), GUESSED_RATE / (self.realisations * grains * method.evaluations))
        self._integration_s = self._estimate_s = 0.0
        self._setup_s = clock() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the answer; samples that a restored state already had are not repeated."""
        final = self.scene.samples - 1
        while self._sample < final:
            first, spent = self._sample + 1, self._integration_s + self._estimate_s
            fit, together = min(self._most, int(BLOCK_S / self._sample_s)), self._together
            count = max(1, fit // together) * together
            until = min(max(self._sample, 0) + count, final)
            shape = (self.realisations, until + 1 - first, self.scene.chain.grains)
            own = np.zeros(shape), np.zeros(shape)  # what no wave has reached stays so
            if first == 0:
                for field, begin in zip((*own, *self._beside), (*self._begin, *self._begin), strict=True):
                    field[..., 0, :] = begin
            for index in range(len(self._steppers)):
                u, v = own if index == 0 else (field[index - 1] for field in self._beside)
                yield from self._fill(index, u, v, first, until)
            yield self._keep(*own, first, until + 1)
            self._sample_s = (self._integration_s + self._estimate_s - spent) / (until + 1 - first)

    def _fill(self, index: int, u: Array, v: Array, first: int, until: int) -> Iterator[Block]:
        """Move one stepper through a block of samples, in pieces short enough to be interrupted."""
        nothing = np.empty((self.realisations, 0, self.scene.recorded.size))
        stepper = self._steppers[index]
        while True:
            max_steps = max(1, int(self._rate[index] * PIECE_S))
            began = clock()
            done = stepper.fill(u, v, first, until, max_steps)
            took = clock() - began
            self._rate[index] = done / max(took, 1e-9)
            if index == 0:
                self._integration_s += took
            else:
                self._estimate_s += took
            broken = self._broken(index)
            if index == 0 and broken.any():
                raise RunFailed(self._broke_down(first, "grains overlap more than all the energy there is allows"))
            if broken.any():  # adaptive steps would be ever shorter
                cast(NativeStepper, stepper).leave(broken, until)
            if stepper.sample >= until:
                return
            yield Block(slice(first, first), nothing, nothing)

    def _broken(self, index: int) -> NDArray[np.bool_]:
        """Return which realisations of a native stepper have broken down, (R,); their error is infinite."""
        stepper = self._steppers[index]
        if not isinstance(stepper, NativeStepper):
            return np.zeros(self.realisations, bool)
        return stepper.closest() > self._deepest

    def _keep(self, u: Array, v: Array, first: int, stop: int) -> Block:
        """Check the samples first ... stop - 1 of the answer, and keep its differences from the companions."""
        began = clock()
        samples = np.arange(first, stop)
        peaks, energy, differences = compared(u, v, *self._beside, self._against, self._masses)
        self.peaks = np.maximum(np.maximum(self.peaks, peaks), self._native[0].largest())
        if not np.isfinite(energy).all():
            raise RunFailed(self._broke_down(first, "positions or velocities are no longer numbers"))
        if (energy > self._most_energy).any():
            raise RunFailed(self._broke_down(first, "the kinetic energy exceeds all the energy there is"))
        for index, right in enumerate(self._steppers[1:]):
            stops = (samples % right.stride == 0) | (samples == self.scene.samples - 1)
            self._differences[index, samples[stops]] = differences[index, stops]
            self._differences[index, :, self._broken(index + 1)] = np.inf
        self._sample = stop - 1
        self._estimate_s += clock() - began
        if self.scene.grains != "all":
            u, v = (np.array(field[:, :, self._rows]) for field in (u, v))
        return Block(slice(first, stop), u, v)

    def _broke_down(self, sample: int, what: str) -> str:
        t = sample * self.scene.duration / (self.scene.samples - 1)
        return (
            f"{what} after t = {t:.4g} s with steps of {self.candidate.step:.3g} s: use a shorter step or a tolerance"
        )

    @property
    def closest(self) -> Array:
        """Largest approach of two grains beyond that at rest, (R,) m, in the native companions."""
        return np.max([stepper.closest() for stepper in self._native], axis=0)

    @property
    def progress(self) -> float:
        """Part of the samples done."""
        reached = sum(stepper.sample / stepper.stride for stepper in self._steppers)
        return reached / sum((self.scene.samples - 1) / stepper.stride for stepper in self._steppers)

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation."""
        # nothing is put in: there is no motion to be relative to, but that of a strike number of 1
        peaks = np.where(self._at_rest[:, None], self._scale, self.peaks)
        if self._twin and not (self._at_rest[0] or self._native[0].largest()[0, 1]):  # only what rounding presses moves
            peaks[0, 1] = max(peaks[0, 1], self.scene.highest_frequency * peaks[0, 0])
        peaks = np.where(peaks > 0, peaks, 1.0)
        relative = self._differences / peaks
        relative[np.isnan(relative)] = np.inf
        lowest = np.min([stepper.lowest() for stepper in self._steppers], axis=0)
        steps = relative[int(self._twin) :].max(1)  # largest differences between steps h, 2h (and 4h), or h and h/2
        rounding, every = relative[0].max((0, 2)).tolist(), np.ascontiguousarray(relative.max((0, 3)).T)
        time, opening, plain = self.scene.time, lowest <= CLOSE_TO_OPENING, self._native[0].chains.plain
        even = (self.candidate.adaptive or self.method.order == 2) | ~(opening | self._kinked)
        straight = opening & (not self.candidate.adaptive)  # roundings of steps of one length are alike at h and 2h
        apart = np.where(straight, steps.max((0, 2)), steps[0].max(1)) * np.where(opening, BY_CHANCE, 1.0)
        truncations, moving = self._truncations(steps, opening, even), self.peaks[:, 1] > 0
        of_each = opening, even, plain, moving, self._answer.steps, truncations, apart, straight, *peaks.T
        found = []
        for real, row in enumerate(zip(*(x.tolist() for x in of_each), strict=True)):
            opens, smooth, rounded, moves, taken, truncation, most, flies, farthest, fastest = row
            radians = self._radians[real]
            displaced = radians / self.scene.duration * farthest / fastest if moves else 0.0
            roundoff = native_floor(taken * self.method.evaluations, radians, displaced, flies)
            if rounded and taken:
                roundoff += self.method.spread * plain_loss(self._scenes[real], taken) / fastest
            truncation = max(truncation, min(most, (GROWN if opens else STEADY) * roundoff))
            if self._twin:
                roundoff += rounding[real]
            elif opens and truncation + roundoff < min(NEAR_ROUNDOFF, SHORT * math.exp(min(GROWTH * radians, 99))):
                grown = SHARED * self._grown(real, peaks[real])
                truncation = max(truncation, min(most, SCATTER * walked(taken * self.method.evaluations) * grown))
                roundoff += grown
            found.append(ErrorBudget(truncation, roundoff, smooth, every[real], time))
        return found

    def _truncations(self, steps: Array, opening: NDArray[np.bool_], even: NDArray[np.bool_]) -> Array:
        """Return the truncation errors, (R,), from the differences between steps h, 2h (and 4h), or h and h/2.

        Where errors scatter, the last differences are those from one more companion.
        """
        if self._finer:
            return 2 * steps[0].max(1)
        order, falls_to = self.method.order, ORDER_AT_KINKS if self._kinks else ORDER_AT_OPENINGS
        at_openings = min(order, falls_to) if self.candidate.adaptive else order
        found = np.empty(self.realisations)
        for opens, smooth in itertools.product((True, False), repeat=2):
            these = (opening == opens) & (even == smooth)
            if these.any():
                coarse = steps[1, these] if len(steps) - self._scatters.any() > 1 else None
                trusted = at_openings if opens else order - self._stretched
                found[these] = extrapolate(trusted, smooth, coarse, steps[0, these], self._ratios[:2]).max(1)
        found = np.where(opening & self._scatters, np.maximum(found, steps[-1].max(1)), found)
        return np.where(opening & self._kinks, SAFETY_AT_KINKS * found, found)

    def _grown(self, real: int, peaks: Array) -> float:
        """Return what becomes of a last digit in the whole run; 0 before its end, and where nothing meets."""
        if self._at_rest[real] or self._sample < self.scene.samples - 1 or not self.closest[real] > 0:
            return 0.0
        if real not in self._amplified:
            began = clock()
            self._amplified[real] = amplified_digit(self._scenes[real], peaks, self._answer.steps[real])
            self._estimate_s += clock() - began
        return self._amplified[real]

    def cost(self) -> Cost:
        """Return what it has cost so far; steps and evaluations are those of the realisation that took most."""
        steps = int(self._answer.steps.max())
        return Cost(
            integration_s=self._integration_s,
            estimate_s=self._estimate_s,
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
        kept = {"sample": np.array(self._sample), "differences": self._differences, "peaks": self.peaks}
        for index, stepper in enumerate(self._steppers):
            kept |= {f"{index}.{name}": array for name, array in stepper.state().items()}
        return kept

    def close(self) -> None:
        """Release every stepper."""
        for stepper in self._steppers:
            stepper.close()


def _scatters(scene: Scene, kinks: bool) -> bool:
    """Whether contacts may open again and again, by reflections or a drive; or once, at a kink."""
    crossed = 1 if scene.excitation.does_work else scene.chain.grains
    near = min(scene.largest_strain, scene.linear_strain) > -CLOSE_TO_OPENING
    return near and (kinks or scene.highest_frequency * scene.duration > COMES_BACK * crossed)


def _block(steppers: int, realisations: int, grains: int, samples: int, together: int) -> int:
    """Return the number of samples in a block, a multiple of those after which all steppers stop together."""
    fit = BLOCK_BYTES // (16 * steppers * realisations * grains)
    return max(1, min(fit, samples) // together) * together


def _unpack(state: Mapping[str, Array] | None) -> list[dict[str, Array]]:
    """Split a kept state into those of the steppers."""
    kept: list[dict[str, Array]] = [{}, {}, {}, {}]
    for key, value in (state or {}).items():
        if "." in key:
            index, name = key.split(".", 1)
            kept[int(index)][name] = value
    return kept
