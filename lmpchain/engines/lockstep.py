"""One answer in the making, with companions in lock-step that show its error.

The answer runs at the step h. Beside it run native companions at longer steps (2h and 4h, or shorter
ones if the step does not divide or those would be unstable): their differences show how the error
falls with the step. An answer that is not native also has a native twin at the same step. Twin and
answer are the same map in exact arithmetic, so what they differ by is round-off, measured.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np

from ..errors import RunFailed
from ..fields import Array
from ..scene import Scene
from .base import Block, Candidate, Cost, Run, SolverError
from .native.stepper import NativeStepper
from .splittings import Splitting

PIECE_S = 0.1  # longest stretch of work between two chances to stop
BLOCK = 16  # samples a block
SAFETY = 2.0  # between the expected error and the estimate
CLOSE_TO_OPENING = -0.5  # r / eps below which a contact's force is no longer a smooth function of time
EPSILON = float(np.finfo(float).eps)


class Stepper(Protocol):
    """A batch of chains that can be moved forward in time."""

    u: Array  # (R, N) displacement, m
    v: Array  # (R, N) velocity, m/s

    @property
    def ranks(self) -> int:
        """How many processes share a chain."""

    def advance(self, steps: int) -> None:
        """Move forward by `steps` steps."""

    def lowest(self) -> Array:
        """Return the smallest r / eps that any contact of each chain has had, (R,); -1 is an opening."""

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""

    def close(self) -> None:
        """Release everything."""


class LockstepRun(Run):
    """An answer at one step, with companions at others that show its error."""

    def __init__(
        self,
        make: Callable[[Mapping[str, Array]], Stepper],
        splitting: Splitting,
        scenes: Sequence[Scene],
        candidate: Candidate,
        state: Mapping[str, Array] | None,
    ):
        began = time.perf_counter()
        self.splitting, self.scene, self.candidate = splitting, scenes[0], candidate
        self._columns = self.scene.recorded - 1
        k = candidate.steps_per_sample
        unstable = 4 * candidate.step * max(scene.chain.band_edge for scene in scenes) > splitting.stability_limit
        self._finer = k % 4 != 0 or unstable
        counts = [k, 2 * k, 4 * k] if self._finer else [k, k // 2, k // 4]
        interval = self.scene.duration / (self.scene.samples - 1)
        kept = _unpack(state)
        self._answer = make(kept[0])
        self._steppers: list[tuple[Stepper, int]] = [(self._answer, k)]
        if isinstance(self._answer, NativeStepper):
            counts = counts[1:]
        for count, old in zip(counts, kept[1:], strict=False):
            self._steppers.append((NativeStepper(scenes, splitting, interval / count, old), count))
        self.realisations = len(scenes)
        self._energy = np.array([scene.energy for scene in scenes])
        self._at_rest = [scene.at_rest for scene in scenes]
        self._kinked = [scene.drive is not None and not scene.drive.smooth for scene in scenes]
        self._masses = np.array([scene.chain.masses for scene in scenes])
        # the energy of the contacts is never below that at rest, so the kinetic energy cannot exceed what was put in
        self._scale = np.array([(c.length_scale, c.length_scale / c.time_scale) for c in (s.chain for s in scenes)])
        self._noise = 1e-3 * self._scale[:, 1]
        shape = (len(self._steppers) - 1, self.scene.samples, self.realisations, 2)
        self._differences = np.zeros(shape) if state is None else state["differences"].copy()
        self.peaks = np.zeros((self.realisations, 2)) if state is None else state["peaks"].copy()
        self._sample = 0 if state is None else int(state["sample"])
        self._done_steps = 0.0
        self._rate = np.zeros(len(self._steppers))  # steps a second: begin with one step and measure
        self._integration_s = self._estimate_s = 0.0
        self._setup_s = time.perf_counter() - began

    def blocks(self) -> Iterator[Block]:
        """Yield the answer; samples that a restored state already had are not repeated."""
        u, v, first = [], [], self._sample
        waited = time.perf_counter()
        while self._sample < self.scene.samples:
            if self._sample > 0:
                yield from self._to_next_sample()
            self._compare(self._sample)
            u.append(self._answer.u[:, self._columns].copy())
            v.append(self._answer.v[:, self._columns].copy())
            self._sample += 1
            if len(u) == BLOCK or self._sample == self.scene.samples or time.perf_counter() - waited > PIECE_S:
                yield Block(slice(first, self._sample), np.stack(u, 1), np.stack(v, 1))
                u, v, first = [], [], self._sample
                waited = time.perf_counter()

    def _to_next_sample(self) -> Iterator[Block]:
        """Advance all steppers by one sample interval, in pieces short enough to be interrupted."""
        nothing = np.empty((self.realisations, 0, self._columns.size))
        for index, (stepper, count) in enumerate(self._steppers):
            left = count
            while left:
                piece = int(min(left, max(1, self._rate[index] * PIECE_S)))
                began = time.perf_counter()
                stepper.advance(piece)
                took = time.perf_counter() - began
                self._rate[index] = piece / max(took, 1e-9)
                left -= piece
                if index == 0:
                    self._integration_s += took
                    self._done_steps += piece
                else:
                    self._estimate_s += took
                if left:
                    yield Block(slice(self._sample, self._sample), nothing, nothing)

    def _compare(self, sample: int) -> None:
        """Check the answer and keep its differences from the companions."""
        began = time.perf_counter()
        u, v = self._answer.u, self._answer.v
        self.peaks[:, 0] = np.maximum(self.peaks[:, 0], np.abs(u).max(1))
        self.peaks[:, 1] = np.maximum(self.peaks[:, 1], np.abs(v).max(1))
        if not np.isfinite(self.peaks).all():
            raise RunFailed(self._broke_down("positions or velocities are no longer numbers"))
        if ((self._masses * v**2).sum(1) > 3 * self._energy + self._masses.sum(1) * self._noise**2).any():
            raise RunFailed(self._broke_down("the kinetic energy exceeds all the energy there is"))
        with np.errstate(over="ignore", invalid="ignore"):
            for index, ((left, _), (right, _)) in enumerate(zip(self._steppers, self._steppers[1:], strict=False)):
                self._differences[index, sample, :, 0] = np.abs(left.u - right.u).max(1)
                self._differences[index, sample, :, 1] = np.abs(left.v - right.v).max(1)
        self._estimate_s += time.perf_counter() - began

    def _broke_down(self, what: str) -> str:
        t = self._sample * self.scene.duration / (self.scene.samples - 1)
        return f"{what} at t = {t:.4g} s with steps of {self.candidate.step:.3g} s: use a shorter step or a tolerance"

    @property
    def closest(self) -> Array:
        """By how much two grains have come closer than at rest at most, (R,) m, as the native companions saw it."""
        return np.max([s.closest() for s, _ in self._steppers if isinstance(s, NativeStepper)], axis=0)

    @property
    def progress(self) -> float:
        """Part of the steps done."""
        return self._done_steps / max(1, self.candidate.steps_per_sample * (self.scene.samples - 1))

    def errors(self) -> list[SolverError]:
        """Return the estimate for every realisation."""
        return [self._error(real) for real in range(self.realisations)]

    def _error(self, real: int) -> SolverError:
        # nothing is put in: there is no motion to be relative to, but that of a strike number of 1
        peaks = self._scale[real] if self._at_rest[real] else self.peaks[real]
        peaks = np.where(peaks > 0, peaks, 1.0)
        relative = self._differences[:, :, real, :] / peaks
        relative = np.where(np.isnan(relative), np.inf, relative)
        order = self.splitting.order
        lowest = min(stepper.lowest()[real] for stepper, _ in self._steppers)
        smooth = order == 2 or (lowest > CLOSE_TO_OPENING and not self._kinked[real])
        first, second = relative[-2].max(0), relative[-1].max(0)
        if self._finer:
            truncation = (first + second + extrapolate(order, smooth, first, second)).max()
        else:
            truncation = extrapolate(order, smooth, second, first).max()
        total_steps = self.candidate.steps_per_sample * (self.scene.samples - 1)
        roundoff = native_floor(total_steps * self.splitting.evaluations)
        if not isinstance(self._answer, NativeStepper):
            roundoff += float(relative[0].max())
        time_ = self.scene.time
        return SolverError(float(truncation), roundoff, bool(smooth), relative.max((0, 2)), time_)

    def cost(self) -> Cost:
        """Return what it has cost so far."""
        steps = self.candidate.steps_per_sample * (self.scene.samples - 1)
        return Cost(
            integration_s=self._integration_s,
            estimate_s=self._estimate_s,
            setup_s=self._setup_s,
            steps=steps,
            force_evaluations=steps * self.splitting.evaluations,
            active_grains=self.candidate.active_grains,
            integrator=self.splitting.name,
            step_s=self.candidate.step,
            ranks=self._answer.ranks,
        )

    def state(self) -> dict[str, Array]:
        """Return what `start` needs to go on from the last sample with the same bits."""
        kept = {"sample": np.array(self._sample), "differences": self._differences, "peaks": self.peaks}
        for index, (stepper, _) in enumerate(self._steppers):
            kept |= {f"{index}.{name}": array.copy() for name, array in stepper.state().items()}
        return kept

    def close(self) -> None:
        """Release every stepper."""
        for stepper, _ in self._steppers:
            stepper.close()


def extrapolate(order: int, smooth: bool, coarse: Array, fine: Array) -> Array:
    """Estimate the error of the finest of three runs at steps 4h, 2h and h from their differences.

    Where contacts open or nearly so, a high order falls to about 2.5 with a coefficient that depends
    on where in a step the opening falls: the error at h can then be as large as the difference.
    Measured on some hundred random chains, the estimate is between 1 and 5 times the true error while
    the order holds and rarely below it elsewhere.
    """
    if not smooth:
        return 1.5 * np.maximum(fine, coarse / 4)
    best = 2.0**order
    ratio = np.clip(coarse / np.maximum(fine, 1e-300), 1.5, best)
    return SAFETY * np.maximum(fine / (ratio - 1), coarse / (best * (best - 1)))


def native_floor(evaluations: int) -> float:
    """Round-off of the native integration in displacements: a random walk of half-ulps."""
    return EPSILON * (2 + math.sqrt(evaluations))


def _unpack(state: Mapping[str, Array] | None) -> list[dict[str, Array]]:
    """Split a kept state into those of the steppers."""
    kept: list[dict[str, Array]] = [{}, {}, {}, {}]
    for key, value in (state or {}).items():
        if "." in key:
            index, name = key.split(".", 1)
            kept[int(index)][name] = value
    return kept
