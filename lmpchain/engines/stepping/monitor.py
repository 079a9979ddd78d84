"""Monitor of a run: estimates its error from auxiliary runs with other steps.

A run of an engine that rounds differently from the native engine also has a native twin, which is a
native run with the same steps. In exact arithmetic the twin and the answer are equal, so that the
distance between them is the rounding error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...chain import ground
from ...errors import RunFailed
from ...integrators.kernels.reductions import NOT_A_NUMBER, SOUND, TOO_FAST, compare
from ...integrators.kernels.table import ROUNDED
from ...integrators.stepper import UNFIT, NativeStepper, Stepper, room_for
from ...integrators.steps import Method
from ...scene.scene import Scene
from ...trajectory.record import LARGEST_ERROR
from ...util.arrays import EPSILON, SMALLEST, Array, last_digit
from ...util.compilation import clock
from ...util.lazy import cached_property
from ..base import ErrorBudget, Proposal
from .auxiliary_runs import OPENINGS, AuxiliarySteps
from .rounding import (
    GROWTH,
    amplify_rounding,
    could_grow,
    count_digits,
    drift,
    flown,
    free_flights,
    grow_digit,
    interpolation_loss,
    native_floor,
    plain_loss,
    reduced_loss,
    repeat_rounding,
    rounded_energy,
)


@dataclass(frozen=True)
class JudgingTimes:
    """Times at which a run is judged before its end; see analysis/lost_attempts.py.

    Attributes
    ----------
    begin_s : float
        Shortest expected wall time of the steps after which a run is judged, s.
    apart : float
        Ratio of two successive times at which a run is judged.
    window : float
        Ratio of the time at which a run is judged to the earlier time with which its error is
        compared, to measure how fast the error grows.
    steepest : float
        Largest power of time with which errors are extrapolated.
    """

    begin_s: float = 0.01
    apart: float = 1.1
    window: float = 1.25
    steepest: float = 12.0


JUDGING = JudgingTimes()
# Factor on the error of an energy: two energies may agree by chance although the motions differ.
SUMMED = 4.0
TOO_CLOSE = "a contact overlaps more than the total energy allows: the run is unstable"
WRONG = {
    TOO_FAST: "the kinetic energy exceeds the total energy: the run is unstable",
    NOT_A_NUMBER: "positions or velocities are no longer numbers",
}

# Advances a stepper to a sample by at most this number of steps; returns the number of steps.
Fill = Callable[[int, int], int]


class Monitor:
    """The error estimates of a native run, from auxiliary runs in the same compiled call.

    Parameters
    ----------
    native : NativeStepper
        Stepper of the answer or of its twin, and of the auxiliary runs.
    auxiliary : AuxiliarySteps
        Steps of the auxiliary runs, and their comparison.
    method : Method
        Integration method of all runs.
    scenes : sequence of R scenes
        Scenes that are computed together.
    proposal : Proposal
        Proposed steps of the run, with the tolerance.

    Attributes
    ----------
    initial : two (R, N) arrays
        Displacements and velocities at t = 0, m and m/s.
    runs : int
        Number of twins and auxiliary runs.
    together : int
        Number of samples after which all runs land on the same sample again.
    sample : int
        Last sample at which the runs were compared; -1 before the first comparison.
    seconds : float
        Wall time spent on comparisons and on measurements of the rounding error, s.
    """

    # Number of additional runs with the steps of the main run.
    twins = 0

    def __init__(
        self,
        native: NativeStepper,
        auxiliary: AuxiliarySteps,
        method: Method,
        scenes: Sequence[Scene],
        proposal: Proposal,
    ):
        self.native = native
        self.runs = len(auxiliary.against)
        self.together = auxiliary.together
        self.sample = -1
        self.seconds = 0.0
        self._auxiliary = auxiliary
        self._method = method
        self._scenes = scenes
        self._scene = scenes[0]
        self._proposal = proposal
        self._chains = native.chains
        # Rounding steps in a time step: force evaluations, weighted by their effect.
        self._rounded_in_step = max(method.evaluations, method.spread**2)
        # Amplified rounding error beyond which no steps can meet the tolerance.
        self._hopeless = GROWTH.pessimism * min(proposal.tolerance, LARGEST_ERROR)
        self.initial = self._chains.initial
        self._allowed = self._allow_energy()
        self._sure_approach = self._bound_sure_approach()
        # Auxiliary runs of each realisation that have broken down, (S, R).
        self._lost: NDArray[np.bool_] | None = None
        # Growth of rounding errors, by realisation.
        self._growth: dict[int, Array] = {}
        size = len(scenes)
        samples = self._scene.samples
        self._differences = np.zeros((self.runs, samples, size, 2))
        self._peaks = np.zeros((size, 2))
        # A ground of time does work that is not included in the balance.
        if self._chains.arrays.damped and not self._scene.chain.ground_in_time:
            native.balance = np.zeros((1 + len(auxiliary.schedules), size, samples, 2))

    def make_room(self, samples: int) -> None:
        """Allocate the samples of a block for the auxiliary runs."""
        grains = self._scene.chain.grains
        self._fields = room_for(self.runs, len(self._scenes), samples, grains)

    def _allow_energy(self) -> Array:
        """Return an upper bound on twice the kinetic energy, (R,) J."""
        return self._chains.arrays.allowed

    def _bound_sure_approach(self) -> float:
        """Return an approach beyond that at rest, m, up to which every run is certainly stable."""
        # A single scene has computed this bound for the choice of its steps.
        single = len(self._scenes) == 1 and not self._chains.arrays.acts
        return float(self._scene.approach_bounds.max()) if single else 0.0

    @cached_property
    def _closest_allowed(self) -> Array:
        """Largest approach of two grains beyond that at rest, (R,) m, in a stable run.

        The bound is that of the overlap, so that the overlap at rest is a margin.
        """
        if self._chains.arrays.acts:
            # No energy bounds a driven motion. An approach of a million lengths of the column is
            # certainly unstable.
            lengths = [scene.chain.diameters.sum() for scene in self._scenes]
            return np.full(len(lengths), 1e6 * min(lengths))
        # The energy of the weakest motions underflows.
        energy = np.maximum(self._allowed, np.finfo(float).tiny)
        return self._chains.contacts.overlap_bound(energy[:, None]).max(1)

    def choose_looks(self, work_s: float, together: int) -> frozenset[int]:
        """Return the samples for judging a run of this expected time, s: multiples of `together`.

        `work_s` is the expected wall time of the steps, s. If the scene may be unpredictable, the
        run is judged at the first possible sample, too.
        """
        intervals = self._scene.intervals
        looks = place_looks(work_s, intervals, together)
        evaluations = self._proposal.steps.total(intervals) * self._rounded_in_step
        chaotic = any(
            self._may_grow(real, evaluations, self._hopeless) for real in range(len(self._scenes))
        )
        return looks | {together} if chaotic and together < intervals else looks

    def fills(self, answer: Stepper, u: Array, v: Array, first: int) -> list[Fill]:
        """Return functions that advance each stepper and fill u and v from a given sample on."""
        return [partial(self.native.fill, u, v, first, beside=self._fields)]

    def leave_broken(self, first: int, until: int) -> None:
        """Stop native runs whose grains are too close, so that their errors become infinite.

        Raises
        ------
        RunFailed
            If the grains of the answer are too close.
        """
        closest = self.native.closest()
        if closest.max() <= self._sure_approach:
            return
        broken = ~(closest <= self._closest_allowed)
        if not broken.any():
            return
        # Row 0 of the native stepper is the answer, if it has no twin.
        if not self.twins and broken[0].any():
            raise RunFailed(self._describe_breakdown(first, TOO_CLOSE))
        self.native.leave(broken, until)
        self._lost = broken[1 - self.twins :]

    def compare(self, u: Array, v: Array, first: int, until: int) -> None:
        """Check samples `first` ... `until`, and store the distances from the auxiliary runs."""
        began = clock()
        runs = (*self._fields, self._auxiliary.against, self._auxiliary.strides)
        verdict = compare(
            u, v, runs, first, self._chains.masses, self._allowed, self._differences, self._peaks
        )
        self.leave_broken(first, until)
        if verdict != SOUND:
            raise RunFailed(self._describe_breakdown(first, WRONG[verdict]))
        if self._lost is not None:
            self._differences.swapaxes(1, 2)[self._lost] = np.inf
        self.sample = until
        self.seconds += clock() - began

    def _describe_breakdown(self, sample: int, cause: str) -> str:
        t = self._scene.time[sample]
        step = self._proposal.step
        return (
            f"{cause}, after t = {t:.4g} s at steps of {step:.3g} s: "
            "use a shorter step or a tolerance"
        )

    @property
    def peaks(self) -> Array:
        """Largest displacement and speed of any grain so far, (R, 2) m and m/s."""
        return np.maximum(self._peaks, self.native.largest())

    @property
    def closest(self) -> Array:
        """Largest approach of two grains beyond that at rest in the native runs, (R,) m."""
        return self.native.closest().max(0)

    @property
    def lowest(self) -> Array:
        """Smallest r / eps of any contact in the native runs, (R,); -1 is an opening."""
        return self.native.watched["least_strain"].reshape(-1, len(self._scenes)).min(0)

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate of every realisation; see `auxiliary_runs` for the formula."""
        scale = self._scale()
        # A copy with the samples last is reduced three times as fast.
        largest = np.maximum.reduce(self._differences.swapaxes(1, 3).copy(), 3)  # Shape (S, 2, R).
        distances = (largest / scale.T).transpose(2, 0, 1).tolist()
        evaluations = self.native.steps * self._rounded_in_step
        rows = zip(
            scale.tolist(), self.lowest.tolist(), evaluations.tolist(), distances, strict=True
        )
        return [
            self._estimate(real, size, lowest <= OPENINGS.near, evaluations, _finite(distances))
            for real, (size, lowest, evaluations, distances) in enumerate(rows)
        ]

    def _scale(self) -> Array:
        """Return the displacement and velocity to which errors are relative, (R, 2) m and m/s."""
        scale = self._largest_values()
        if self._chains.arrays.damped:
            # If nothing moves, the velocities are the rounding errors of reduced velocities.
            closest = self.native.closest()[0].tolist()
            largest = scale[:, 0].tolist()
            lost = [*map(reduced_loss, self._scenes, largest, closest)]
            floor = np.where(scale[:, 1] <= lost, ROUNDED * self._chains.arrays.scale[:, 1], 0.0)
            scale[:, 1] = np.maximum(scale[:, 1], floor)
        # If nothing moves, errors are relative to the units of the chain.
        idle = self._chains.arrays.scale[:, 1] == 0.0
        scale[idle] = self._chains.arrays.units[idle]
        scale[scale == 0.0] = 1.0
        return scale

    def _largest_values(self) -> Array:
        """Return the largest displacement and velocity of the motion, (R, 2) m and m/s."""
        return self.peaks

    def _estimate(
        self,
        real: int,
        size: list[float],
        opens: bool,
        evaluations: float,
        distances: list[list[float]],
    ) -> ErrorBudget:
        """Return the estimate for one realisation from the S pairs of distances between its runs.

        `size` has the largest displacement, m, and the largest velocity, m/s, of the realisation.
        `opens` is true if a contact opened or nearly opened.
        """
        scene = self._scenes[real]
        if scene.recorded[0] > scene.chain.movable:
            # Held grains do not move.
            return ErrorBudget(0.0, 0.0, self._method.order)
        order = self._auxiliary.order(opens, scene.excitation.smooth_until(scene.duration))
        truncation = self._auxiliary.truncation(real, distances[self.twins :], order, opens)
        # Only grains that have lost contact fly freely.
        flights = free_flights(scene, *size) if opens else 0.0
        roundoff, amplified = self._measure_rounding(
            real, size, evaluations, distances, truncation, flights
        )
        return ErrorBudget(truncation, roundoff, order, amplified=amplified)

    def _measure_rounding(
        self,
        real: int,
        size: list[float],
        evaluations: float,
        distances: list[list[float]],
        truncation: float,
        flights: float,
    ) -> tuple[float, Array]:
        """Return the rounding error, and the amplified one at each sample, (T,) or empty."""
        scene = self._scenes[real]
        roundoff = self._round(real, size, evaluations, flights)
        # Measured once, at the end, because it takes a fraction of the time of the answer.
        complete = self.sample == scene.intervals
        counts = min(truncation + roundoff, self._proposal.tolerance)
        if not (complete and self._may_grow(real, evaluations, counts)):
            return roundoff, np.zeros(0)
        began = clock()
        amplified = self._amplify(real, evaluations)
        if amplified.max() > self._hopeless:
            amplified = amplify_rounding(scene, evaluations)
        touching = self._round(real, size, evaluations, 0.0)
        bound = max(roundoff, float(amplified.max()))
        if self._shall_repeat(truncation, touching, bound, evaluations):
            repeated = repeat_rounding(scene, self._method, self._proposal.steps)
            amplified = np.fmin(amplified, repeated)
            # A one-sided drift is the same in all runs with the steps of the answer, but not in
            # the auxiliary runs.
            one_sided = EPSILON * drift(evaluations, flights)
            least = touching + min(one_sided, max(distances[0]))
            roundoff = max(least, min(roundoff, float(repeated.max())))
        self.seconds += clock() - began
        return max(roundoff, float(amplified.max())), amplified

    def _shall_repeat(
        self, truncation: float, touching: float, bound: float, evaluations: float
    ) -> bool:
        """Return whether to measure the rounding error by runs that take several times as long.

        `touching` is the part of the rounding error that these runs cannot reduce, and `bound` is
        the estimate without these runs; both are relative to the largest motion.
        """
        tolerance = self._proposal.tolerance
        if tolerance == math.inf:
            # Measure if rounding may be the larger part of the error, but not if a single ulp
            # grows as large as the motion.
            return max(truncation, 2 * touching) < bound < count_digits(evaluations)
        # Do not measure if the tolerance is met anyway, nor if shorter steps follow anyway. A bound
        # above half the truncation error would end the attempts, see `step_control`.
        decides = max(truncation / 2, tolerance - truncation) < bound < self._hopeless
        return decides and touching < tolerance / 2

    def _amplify(self, real: int, evaluations: float) -> Array:
        """Return the amplified rounding error per sample, (T,), until it exceeds any tolerance."""
        if real not in self._growth:
            self._growth[real] = grow_digit(self._scenes[real], self._hopeless)
        return count_digits(evaluations) * self._growth[real]

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return the dissipated energy and the work of the forcing, with their errors.

        If another engine computed the answer, the energies are taken from its native twin. The
        list has one dictionary of (T,) arrays, J, for each realisation. It is empty if the chain
        has no damping, or if its ground changes in time.
        """
        balance = self.native.balance
        if not balance.size:
            return []
        lowest = self.lowest
        differences = self._auxiliary.compare_energies(balance)
        results = []
        for real, (scene, budget) in enumerate(zip(self._scenes, errors, strict=True)):
            chain = scene.chain
            lost, work = balance[0, real].T.copy()
            wave = scene.excitation.waveform
            if wave and scene.excitation.driven:
                # The force on a driven grain accelerates the grain itself, too.
                speed = wave.at(scene.time, 1)
                work += chain.masses[0] / 2 * (speed**2 - speed[0] ** 2)
                if chain.ground is not None:
                    held = ground.energy(chain.ground.of_grains([1]), wave.at(scene.time))
                    work += held - held[0]
            put_in = float(chain.excess_energy(*scene.excitation.initial(chain)))
            scale = max(put_in, np.abs(lost).max(), np.abs(work).max()) or 1.0
            distances = _finite((differences[:, real] / scale).tolist())
            opens = bool(lowest[real] <= OPENINGS.near)
            order = self._auxiliary.order(opens, scene.excitation.smooth_until(scene.duration))
            truncation = SUMMED * self._auxiliary.truncation(real, distances, order, opens)
            # Inequality of Cauchy and Schwarz, with the lightest grain as the fastest.
            spread = math.sqrt(chain.masses.sum() / chain.masses[: chain.movable].min())
            error = np.array(scale * (truncation + 2 * spread * budget.roundoff))
            energies = {"dissipated": lost, "dissipated_error": error}
            if scene.excitation.does_work:
                energies |= {"drive": work, "drive_error": error}
            results.append(energies)
        return results

    def outlook(self) -> list[ErrorBudget]:
        """Return the error of every realisation, extrapolated to the end of the run.

        A truncation error is extrapolated with the power of time at which it grew recently. The
        amplified rounding error is included if it is far above the tolerance.
        """
        samples = self.sample + 1
        scale = self._scale()
        # Distances from the nearest auxiliary run.
        apart = self._differences[0]
        late = apart.max(0) / scale
        early = apart[: math.ceil(samples / JUDGING.window)].max(0) / scale
        field = late.argmax(1)[:, None]
        grown = np.take_along_axis(np.fmax(late, 1e-300) / np.fmax(early, 1e-300), field, 1)[:, 0]
        power = np.clip(np.log(grown) / math.log(JUDGING.window), 0.0, JUDGING.steepest)
        remaining = self._scene.intervals / self.sample
        budgets = []
        for real, error in enumerate(self.errors()):
            truncation = error.truncation * remaining ** float(power[real])
            order = error.order
            if self._proposal.steps.adaptive:
                # Errors that grow fast after openings converge at the order of coarse steps.
                order = min(order, OPENINGS.coarse_order)
            error = error._replace(truncation=truncation, order=order)
            budgets.append(self._foresee_chaos(real, error, remaining))
        return budgets

    def _foresee_chaos(self, real: int, error: ErrorBudget, remaining: float) -> ErrorBudget:
        """Return an estimate with amplified rounding if no steps can meet the tolerance."""
        evaluations = float(self.native.steps[real]) * self._rounded_in_step * remaining
        if not self._may_grow(real, evaluations, self._hopeless):
            return error
        amplified = self._amplify(real, evaluations)
        largest = float(amplified.max())
        if largest < self._hopeless:
            return error
        return error._replace(roundoff=max(error.roundoff, largest), amplified=amplified)

    def _may_grow(self, real: int, evaluations: float, size: float) -> bool:
        """Return whether rounding could be amplified beyond a size relative to the motion.

        Rounding errors are amplified only if waves return to contacts that may open, and if the run
        is long enough.
        """
        # Strong waves are amplified even if no contact opens after all.
        recurs = self._auxiliary.recurrent[real]
        return recurs and could_grow(self._scenes[real], evaluations) > size

    def _round(self, real: int, size: list[float], evaluations: float, flights: float) -> float:
        """Return the rounding error without amplification; `flights` as for `accumulate`."""
        scene = self._scenes[real]
        displacement, velocity = size
        radians = scene.total_phase
        # A path below the smallest double counts as one.
        path = max(velocity * scene.duration, SMALLEST)
        digit = last_digit(min(displacement, velocity, path))
        roundoff = digit / EPSILON * native_floor(evaluations, radians, flights)
        steps = max(evaluations / self._rounded_in_step, 1.0)
        if self._chains.plain[real]:
            roundoff += self._method.spread * plain_loss(scene, steps) / velocity
        if self._proposal.steps.stride > 1:
            roundoff += interpolation_loss(steps, flown(scene, *size))
        if scene.chain.damped:
            # Row 0 is the answer or its twin; auxiliary runs may have broken down.
            closer = float(self.native.closest()[0, real])
            farthest = float(self.peaks[real, 0])
            roundoff += reduced_loss(scene, farthest, closer) / velocity
        return roundoff

    def state(self) -> dict[str, Array]:
        """Return the arrays of the estimates, besides the state of the native stepper."""
        state = {"differences": self._differences, "peaks": self.peaks}
        return state | ({"balance": self.native.balance} if self.native.balance.size else {})

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a state of `state`; raise `ValueError` if it does not fit."""
        pairs = [(self._differences, state["differences"]), (self._peaks, state["peaks"])]
        if self.native.balance.size:
            pairs.append((self.native.balance, state["balance"]))
        if any(own.shape != stored.shape for own, stored in pairs):
            raise ValueError(UNFIT)
        for own, stored in pairs:
            own[:] = stored
        self.sample = int(state["sample"])


class TwinMonitor(Monitor):
    """The error estimates of a run that is not native; a native twin measures rounding."""

    twins = 1

    def _allow_energy(self) -> Array:
        """Return an upper bound on twice the kinetic energy with rounded heights, (R,) J."""
        steps = self._proposal.steps.total(self._scene.intervals)
        rounded = rounded_energy(self._scene, steps * self._method.evaluations)
        return super()._allow_energy() + 3 * rounded

    def choose_looks(self, work_s: float, together: int) -> frozenset[int]:
        """Return no samples, because the run is judged only at its end.

        The rounding error of the heights does not depend on the size of the motion, which may still
        grow: an early relative error would be too large. Also, a native trial was judged before.
        """
        return frozenset()

    def fills(self, answer: Stepper, u: Array, v: Array, first: int) -> list[Fill]:
        """Return functions that advance each stepper and fill u and v from a given sample on."""
        displacement, velocity = self._fields
        beside = displacement[1:], velocity[1:]
        return [
            partial(answer.fill, u, v, first),
            partial(self.native.fill, displacement[0], velocity[0], first, beside=beside),
        ]

    def _largest_values(self) -> Array:
        """Return the largest displacement and velocity of the motion, (R, 2) m and m/s."""
        largest = self.peaks
        if not self.native.largest()[0, 1]:
            # Only rounding moves grains. The velocity is then at least that of the displacement.
            largest[0, 1] = max(largest[0, 1], self._scene.highest_frequency * largest[0, 0])
        return largest

    def _measure_rounding(
        self,
        real: int,
        size: list[float],
        evaluations: float,
        distances: list[list[float]],
        truncation: float,
        flights: float,
    ) -> tuple[float, Array]:
        """Return the rounding error, and the amplified one at each sample, (T,).

        The distance from the twin measures the rounding error, including its amplification.
        """
        amplified = (self._differences[0, :, real] / size).max(-1)
        return self._round(real, size, evaluations, flights) + max(distances[0]), amplified


def _finite(distances: list[list[float]]) -> list[list[float]]:
    """Return distances with infinity in place of NaN."""
    return [[math.inf if d != d else d for d in pair] for pair in distances]


def place_looks(work_s: float, final: int, together: int) -> frozenset[int]:
    """Return the samples up to `final` at which a run of this expected time, s, is judged."""
    fraction = 1 / JUDGING.apart
    looks = []
    while fraction * work_s > JUDGING.begin_s:
        looks.append(int(fraction * final) // together * together)
        fraction /= JUDGING.apart
    return frozenset(look for look in looks if look > 0)
