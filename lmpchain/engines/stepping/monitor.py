"""A monitor of a run: it estimates the error of an answer from auxiliary runs at other steps.

An engine that rounds in another way than the native one also has a native twin, a run at the same
steps. Twin and answer are the same map in exact arithmetic: their distance is round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...errors import RunFailed
from ...integrators.kernels.reductions import NOT_A_NUMBER, SOUND, TOO_FAST, compare
from ...integrators.kernels.table import ROUNDED
from ...integrators.method import Method
from ...integrators.stepper import NativeStepper, Stepper, room_for
from ...scene.scene import Scene
from ...trajectory.record import LARGEST_ERROR
from ...util.arrays import EPSILON, SMALLEST, Array, last_digit
from ...util.caching import cached_property
from ...util.compilation import clock
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
    """When a run is judged on the way; analysis/lost_attempts.py.

    Attributes
    ----------
    begin_s : float
        Expected time of its steps before the first look, s.
    apart : float
        Time of a look over that of the one before.
    window : float
        Time of a look over that since which the growth of errors is taken.
    steepest : float
        Power of time with which they grow at most.
    """

    begin_s: float = 0.01
    apart: float = 1.1
    window: float = 1.25
    steepest: float = 12.0


JUDGING = JudgingTimes()
# factor on the error of an energy: a single number may agree by chance where motions differ
SUMMED = 4.0
TOO_CLOSE = "a contact overlaps more than the total energy allows: the run is unstable"
WRONG = {
    TOO_FAST: "the kinetic energy exceeds the total energy: the run is unstable",
    NOT_A_NUMBER: "positions or velocities are no longer numbers",
}
UNFIT = "the state that was kept does not fit"

Fill = Callable[[int, int], int]  # to a sample, by no more than so many steps; returns the steps


class Monitor:
    """Estimates of the error of native answers, from auxiliary runs in the same compiled call.

    Parameters
    ----------
    native : NativeStepper
        Of the answer, or of its twin, and of the auxiliary runs.
    auxiliary : AuxiliarySteps
    method : Method
    scenes : sequence of R scenes
    proposal : Proposal

    Attributes
    ----------
    initial : two (R, N) arrays
        Displacements and velocities at t = 0, m and m/s.
    runs : int
        Runs beside the answer.
    together : int
        After so many samples all runs stop.
    sample : int
        Last sample that was compared.
    seconds : float
        Time spent, s.
    """

    # Runs beside the answer that have its steps.
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
        # evaluations of the force that are rounded in a step, by the weight that they have
        self._rounded_in_step = max(method.evaluations, method.spread**2)
        # amplified rounding, relative, that is far beyond the tolerance, whatever the steps
        self._hopeless = GROWTH.pessimism * min(proposal.tolerance, LARGEST_ERROR)
        self.initial = self._chains.initial
        self._allowed = self._allow_energy()
        self._sure_approach = self._bound_sure_approach()
        self._lost: NDArray[np.bool_] | None = None  # realisations that auxiliary runs have lost
        self._growth: dict[int, Array] = {}  # of a last digit, by realisation
        size = len(scenes)
        samples = self._scene.samples
        self._differences = np.zeros((self.runs, samples, size, 2))
        self._peaks = np.zeros((size, 2))
        if self._chains.arrays.damped:
            native.balance = np.zeros((1 + len(auxiliary.schedules), size, samples, 2))

    def make_room(self, samples: int) -> None:
        """Make room for the samples of a block, of the runs beside the answer."""
        grains = self._scene.chain.grains
        self._fields = room_for(self.runs, len(self._scenes), samples, grains)

    def _allow_energy(self) -> Array:
        """Return what twice the kinetic energy cannot exceed, (R,) J."""
        return self._chains.arrays.allowed

    def _bound_sure_approach(self) -> float:
        """Return an approach beyond that at rest, m, up to which every run is certainly stable."""
        if self._chains.arrays.acts:
            return 0.0
        return min([float(scene.approach_bounds.max()) for scene in self._scenes])

    @cached_property
    def _closest_allowed(self) -> Array:
        """Largest approach of two grains beyond that at rest, (R,) m, in a stable run."""
        # The energy of the weakest motions underflows.
        energy = np.maximum(self._allowed, np.finfo(float).tiny)
        bound = self._chains.contacts.overlap_bound(energy[:, None]).max(1)
        if self._chains.arrays.acts:
            # No energy bounds a driven motion. An approach of a million lengths of the column is
            # certainly unstable.
            lengths = [scene.chain.diameters.sum() for scene in self._scenes]
            bound = np.minimum(bound, 1e6 * min(lengths))
        return bound

    def choose_looks(self, work_s: float, together: int) -> frozenset[int]:
        """Return samples where a run that takes so long, s, is judged; multiples of `together`.

        The first one follows at once where it may turn out that the scene cannot be predicted.
        """
        intervals = self._scene.intervals
        looks = place_looks(work_s, intervals, together)
        evaluations = self._proposal.steps.total(intervals) * self._rounded_in_step
        chaotic = any(
            self._may_grow(real, evaluations, self._hopeless) for real in range(len(self._scenes))
        )
        return looks | {together} if chaotic and together < intervals else looks

    def fills(self, answer: Stepper, u: Array, v: Array, first: int) -> list[Fill]:
        """Return the functions that move each stepper on, and fill u and v from a sample on."""
        return [partial(self.native.fill, u, v, first, beside=self._fields)]

    def leave_broken(self, first: int, until: int) -> None:
        """Leave native chains whose grains are too close; their error is infinite.

        Raise if it is the answer.
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
        """Check samples `first` ... `until`, and store their distances from the auxiliary runs."""
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
        """Largest displacement and speed so far, (R, 2) m and m/s."""
        return np.maximum(self._peaks, self.native.largest())

    @property
    def closest(self) -> Array:
        """Largest approach of two grains beyond that at rest, (R,) m, in the native runs."""
        return self.native.closest().max(0)

    @property
    def lowest(self) -> Array:
        """Smallest r / eps of any contact, (R,), in the native runs; -1 is an opening."""
        return self.native.watched["least_strain"].reshape(-1, len(self._scenes)).min(0)

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation; see `auxiliary_runs` for the formula."""
        scale = self._scale()
        # A copy with the samples last is reduced three times as fast.
        largest = np.maximum.reduce(self._differences.swapaxes(1, 3).copy(), 3)  # (S, 2, R)
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
        """Return the largest displacement and velocity, (R, 2) m and m/s, to which errors refer."""
        scale = self._largest_values()
        if self._chains.arrays.damped:
            # If nothing moves, the velocities are the rounding errors of reduced velocities.
            closest = self.native.closest()[0].tolist()
            largest = scale[:, 0].tolist()
            lost = [*map(reduced_loss, self._scenes, largest, closest)]
            floor = np.where(scale[:, 1] <= lost, ROUNDED * self._chains.arrays.scale[:, 1], 0.0)
            scale[:, 1] = np.maximum(scale[:, 1], floor)
        # where nothing is set in motion, units take its place
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

        `size` is its largest displacement and velocity, m and m/s, and `opens` says whether a
        contact opened or nearly so.
        """
        scene = self._scenes[real]
        if scene.recorded[0] > scene.chain.movable:
            # grains that are held do not move, in any precision
            return ErrorBudget(0.0, 0.0, self._method.order)
        order = self._auxiliary.order(opens, scene.excitation.smooth_until(scene.duration))
        truncation = self._auxiliary.truncation(real, distances[self.twins :], order, opens)
        # grains in contact fly nowhere
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
        """Return the round-off of a realisation, and amplified at each sample, (T,) or empty."""
        scene = self._scenes[real]
        roundoff = self._round(real, size, evaluations, flights)
        # Once, at the end: runs that show amplification take a fraction of the time of the answer.
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
            # to one side all of these drift alike; not so the auxiliary runs, at other steps
            one_sided = EPSILON * drift(evaluations, flights)
            least = touching + min(one_sided, max(distances[0]))
            roundoff = max(least, min(roundoff, float(repeated.max())))
        self.seconds += clock() - began
        return max(roundoff, float(amplified.max())), amplified

    def _shall_repeat(
        self, truncation: float, touching: float, bound: float, evaluations: float
    ) -> bool:
        """Say whether to measure the rounding error by runs that take several times as long.

        `touching` is the part of the rounding error that these runs cannot reduce, and `bound` is
        the estimate without them.
        """
        tolerance = self._proposal.tolerance
        if tolerance == math.inf:
            # rounding is measured if it may be the larger part of the error, but not if a single
            # digit grows as large as the motion
            return max(truncation, 2 * touching) < bound < count_digits(evaluations)
        # Not if the tolerance is met without, nor if shorter steps follow anyway: a bound of more
        # than half the truncation error would end them, see `step_control`.
        decides = max(truncation / 2, tolerance - truncation) < bound < self._hopeless
        return decides and touching < tolerance / 2

    def _amplify(self, real: int, evaluations: float) -> Array:
        """Return the amplified rounding at each sample, (T,), followed until it is hopeless."""
        if real not in self._growth:
            self._growth[real] = grow_digit(self._scenes[real], self._hopeless)
        return count_digits(evaluations) * self._growth[real]

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return what damping has taken and what was put in, with their errors.

        Those of an answer that is not native are of its twin.
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
                # what is driven takes a force for its own inertia, too
                speed = wave.at(scene.time, 1)
                work += chain.masses[0] / 2 * (speed**2 - speed[0] ** 2)
            put_in = float(chain.excess_energy(*scene.excitation.initial(chain)))
            scale = max(put_in, np.abs(lost).max(), np.abs(work).max()) or 1.0
            distances = _finite((differences[:, real] / scale).tolist())
            opens = bool(lowest[real] <= OPENINGS.near)
            order = self._auxiliary.order(opens, scene.excitation.smooth_until(scene.duration))
            truncation = SUMMED * self._auxiliary.truncation(real, distances, order, opens)
            # by Cauchy and Schwarz, with the lightest grain as the fastest
            spread = math.sqrt(chain.masses.sum() / chain.masses[: chain.movable].min())
            error = np.array(scale * (truncation + 2 * spread * budget.roundoff))
            energies = {"dissipated": lost, "dissipated_error": error}
            if scene.excitation.does_work:
                energies |= {"drive": work, "drive_error": error}
            results.append(energies)
        return results

    def outlook(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation that is expected at the end.

        Truncation errors grow on, as a power of time, as they did of late. Rounding that is
        amplified counts where it is far beyond the tolerance.
        """
        samples = self.sample + 1
        scale = self._scale()
        # of the nearest auxiliary run
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
                # what grows fast behind openings falls no faster than where steps are coarse there
                order = min(order, OPENINGS.coarse_order)
            error = error._replace(truncation=truncation, order=order)
            budgets.append(self._foresee_chaos(real, error, remaining))
        return budgets

    def _foresee_chaos(self, real: int, error: ErrorBudget, remaining: float) -> ErrorBudget:
        """Return an estimate with amplified rounding, where no step can make up for that."""
        evaluations = float(self.native.steps[real]) * self._rounded_in_step * remaining
        if not self._may_grow(real, evaluations, self._hopeless):
            return error
        amplified = self._amplify(real, evaluations)
        largest = float(amplified.max())
        if largest < self._hopeless:
            return error
        return error._replace(roundoff=max(error.roundoff, largest), amplified=amplified)

    def _may_grow(self, real: int, evaluations: float, size: float) -> bool:
        """Say whether rounding could be amplified beyond a size, relative to the motion.

        Contacts may open, waves must return to them, and there must be time for it to grow.
        """
        # where none opens after all, forces are no less nonlinear
        recurs = self._auxiliary.recurrent[real]
        return recurs and could_grow(self._scenes[real], evaluations) > size

    def _round(self, real: int, size: list[float], evaluations: float, flights: float) -> float:
        """Return the round-off that the scene does not amplify, with `flights` of free grains."""
        scene = self._scenes[real]
        displacement, velocity = size
        radians = scene.total_phase
        # what moves at all moves by more than the smallest double
        path = max(velocity * scene.duration, SMALLEST)
        digit = last_digit(min(displacement, velocity, path))
        roundoff = digit / EPSILON * native_floor(evaluations, radians, flights)
        steps = max(evaluations / self._rounded_in_step, 1.0)
        if self._chains.plain[real]:
            roundoff += self._method.spread * plain_loss(scene, steps) / velocity
        if self._proposal.steps.stride > 1:
            roundoff += interpolation_loss(steps, flown(scene, *size))
        if scene.chain.damped:
            # Row 0 is the answer, or its twin: auxiliary runs may have broken down.
            closer = float(self.native.closest()[0, real])
            farthest = float(self.peaks[real, 0])
            roundoff += reduced_loss(scene, farthest, closer) / velocity
        return roundoff

    def state(self) -> dict[str, Array]:
        """Return what the estimates rest on, besides the state of the native stepper."""
        state = {"differences": self._differences, "peaks": self.peaks}
        return state | ({"balance": self.native.balance} if self.native.balance.size else {})

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` returned; raises `ValueError` if it does not fit."""
        pairs = [(self._differences, state["differences"]), (self._peaks, state["peaks"])]
        if self.native.balance.size:
            pairs.append((self.native.balance, state["balance"]))
        if any(own.shape != stored.shape for own, stored in pairs):
            raise ValueError(UNFIT)
        for own, stored in pairs:
            own[:] = stored
        self.sample = int(state["sample"])


class TwinMonitor(Monitor):
    """Estimates of the error of answers that are not native, whose twin measures round-off."""

    twins = 1

    def _allow_energy(self) -> Array:
        """Return what twice the kinetic energy cannot exceed, (R,) J, with heights rounded."""
        steps = self._proposal.steps.total(self._scene.intervals)
        rounded = rounded_energy(self._scene, steps * self._method.evaluations)
        return super()._allow_energy() + 3 * rounded

    def choose_looks(self, work_s: float, together: int) -> frozenset[int]:
        """Return no samples: the run is not judged on the way.

        Heights round by as much however little has moved, and the motion may grow yet: a share of
        it says nothing of the end, and a native trial was judged before.
        """
        return frozenset()

    def fills(self, answer: Stepper, u: Array, v: Array, first: int) -> list[Fill]:
        """Return the functions that move each stepper on, and fill u and v from a sample on."""
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
            # Only grains that rounding presses move. Their velocities are below those of their
            # displacements.
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
        """Return the round-off of a realisation, and amplified at each sample, (T,).

        The distance from the twin is measured round-off, amplification and all.
        """
        amplified = (self._differences[0, :, real] / size).max(-1)
        return self._round(real, size, evaluations, flights) + max(distances[0]), amplified


def _finite(distances: list[list[float]]) -> list[list[float]]:
    """Return distances; an infinite one where runs are apart by what is no number."""
    return [[math.inf if d != d else d for d in pair] for pair in distances]


def place_looks(work_s: float, final: int, together: int) -> frozenset[int]:
    """Return samples where a run that takes so long, s, is judged; `final` is the last one."""
    fraction = 1 / JUDGING.apart
    looks = []
    while fraction * work_s > JUDGING.begin_s:
        looks.append(int(fraction * final) // together * together)
        fraction /= JUDGING.apart
    return frozenset(look for look in looks if look > 0)
