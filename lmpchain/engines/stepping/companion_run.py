"""A run with companions: an answer beside native runs at other steps, which show its error.

An engine that rounds in another way than the native one also has a native twin at the same steps.
Twin and answer are the same map in exact arithmetic: what they differ by is round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...errors import RunFailed
from ...integrators.batch import ChainBatch
from ...integrators.kernels.reductions import NOT_A_NUMBER, SOUND, TOO_FAST, AuxiliaryRuns, compare
from ...integrators.kernels.table import ROUNDED
from ...integrators.method import Method
from ...integrators.stepper import NativeStepper, Stepper, room_for
from ...integrators.steps import Steps
from ...scene.scene import Scene
from ...trajectory.record import LARGEST_ERROR, Block, Cost
from ...util.arrays import EPSILON, SMALLEST, Array, as_slice, last_digit
from ...util.compilation import clock
from ..base import ErrorBudget, Proposal, Run
from .amplification import (
    GROWTH,
    amplify_rounding,
    could_grow,
    count_digits,
    grow_digit,
    repeat_rounding,
)
from .companions import OPENINGS, Companions
from .round_off import (
    drift,
    interpolation_loss,
    native_floor,
    plain_loss,
    reduced_loss,
    rounded_energy,
)

PIECE_S = 0.1  # longest stretch of work between two opportunities to stop
BLOCK_BYTES = 2**25  # of the samples that are compared at a time,
BLOCK_S = 0.5  # and how long they may take: what is stopped or killed loses no more


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


LOOKS = JudgingTimes()
TINY = 1e-300
# factor on the error of an energy: a single number may agree by chance where motions differ
SUMMED = 4.0
TOO_CLOSE = "a contact overlaps more than the total energy allows: the run is unstable"
WRONG = {
    TOO_FAST: "the kinetic energy exceeds the total energy: the run is unstable",
    NOT_A_NUMBER: "positions or velocities are no longer numbers",
}

MakeStepper = Callable[[Sequence[Steps], Mapping[str, Array]], Stepper]
Fill = Callable[[int, int], int]  # to a sample, by no more than so many steps; returns the steps


class LargestMotion(NamedTuple):
    """How much moves in a realisation, by which errors and round-off are measured.

    Attributes
    ----------
    displacement, velocity : float
        Largest values of any grain, m and m/s; 1 where nothing moves.
    lowest : float
        Smallest r / eps of any contact in any of the runs; -1 is an opening.
    evaluations : float
        Of the force, in the answer.
    """

    displacement: float
    velocity: float
    lowest: float
    evaluations: float


class Mover:
    """A stepper that moves in short calls, so that a run can be stopped between them.

    Attributes
    ----------
    stepper : Stepper
    seconds : float
        Time spent in it, s.
    """

    def __init__(self, stepper: Stepper, rate: float):
        self.stepper = stepper
        self.seconds = 0.0
        self._rate = rate

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


class CompanionRun(Run):
    """An answer at one step size, with companions at others that show its error.

    Parameters
    ----------
    make : callable
        Makes the stepper of the answer from its schedule and its kept state, with its companions if
        it is native.
    method : Method
    scenes : sequence of R scenes
        One, or a batch of like ones.
    proposal : Proposal
    state : mapping, optional
        What `state` returned.
    twin : bool
        Whether the answer is not native, so that a native twin at the same step measures its
        round-off.
    work_s : float
        Expected time of its steps, s, by which it is decided when it is judged on the way.
    """

    def __init__(
        self,
        make: MakeStepper,
        method: Method,
        scenes: Sequence[Scene],
        proposal: Proposal,
        state: Mapping[str, Array] | None,
        twin: bool,
        work_s: float = 0.0,
    ):
        began = clock()
        self.scene = scenes[0]
        self.method = method
        self.proposal = proposal
        self._scenes = scenes
        self._twin = twin
        self._companions = Companions(method, scenes, proposal.steps, twin)
        self.realisations = len(scenes)
        self._make_steppers(make, state)
        self._chains: ChainBatch = self.native.chains
        self._closest_allowed = self._bound_approach()
        self._lost: NDArray[np.bool_] | None = None  # realisations that companions have lost
        self._growth: dict[int, Array] = {}  # of a last digit, by realisation
        runs = len(self._companions.against)
        samples = self.scene.samples
        grains = self.scene.chain.grains
        self._together = math.lcm(self._companions.together, self._answer.stride)
        bytes_a_sample = 16 * (runs + 1) * self.realisations * grains
        self._longest_block = fit_block(BLOCK_BYTES // bytes_a_sample, samples, self._together)
        # a guess to begin with
        self._sample_s = proposal.cost_s * self.realisations / samples
        # with a twin, heights round by as much however little has moved, and the motion may grow
        # yet: a share of it says nothing of the end, and a native trial was judged before
        self._looks = frozenset() if twin else self._choose_looks(work_s)
        # the fields of the companions, with sample 0 in the first block
        self._fields = room_for(runs, self.realisations, self._longest_block + 1, grains)
        self._differences = np.zeros((runs, samples, self.realisations, 2))
        if self._chains.arrays.damped:
            schedules = 1 + len(self._companions.schedules)
            self.native.balance = np.zeros((schedules, self.realisations, samples, 2))
        self._peaks = np.zeros((self.realisations, 2))
        self._sample = -1
        if state is not None:
            self._restore(state)
        if twin:
            self._done_before = self._done
        self._compared_s = 0.0
        self._setup_s = clock() - began

    def _choose_looks(self, work_s: float) -> frozenset[int]:
        """Return samples where the run is judged that takes so long, s.

        The first one follows at once where it may turn out that the scene cannot be predicted.
        """
        samples = self.scene.samples
        looks = place_looks(work_s, samples - 1, self._together)
        evaluations = self.proposal.steps.total(samples - 1) * self._rounded_in_step
        chaotic = any(
            self._may_grow(real, evaluations, self._hopeless) for real in range(self.realisations)
        )
        return looks | {self._together} if chaotic and self._together < samples - 1 else looks

    def _make_steppers(self, make: MakeStepper, state: Mapping[str, Array] | None) -> None:
        """Make the stepper of the answer, and of the native runs beside it."""
        answer = self._companions.answer
        beside = self._companions.schedules
        if self._twin:
            chains = ChainBatch(self._scenes)
            start = restrict("native", state)
            self.native = NativeStepper(chains, self.method, answer, start, companions=beside)
            self._answer = make((answer,), restrict("answer", state))
            steppers = [self._answer, self.native]
            evaluations = self.proposal.steps.total(self.scene.intervals) * self.method.evaluations
            self._allowed = chains.arrays.allowed + 3 * rounded_energy(self.scene, evaluations)
        else:
            self._answer = make((answer, *beside), restrict("native", state))
            self.native = cast(NativeStepper, self._answer)
            steppers = [self._answer]
            self._allowed = self.native.chains.arrays.allowed
        work = self.realisations * self.scene.chain.grains * self.method.evaluations
        self._movers = [Mover(stepper, stepper.guessed_rate / work) for stepper in steppers]

    def _bound_approach(self) -> Array:
        """Return how much closer than at rest grains can come, (R,) m, unless a run is unstable."""
        # the energy of the weakest motions underflows
        energy = np.maximum(self._allowed, np.finfo(float).tiny)
        bound = self._chains.contacts.overlap_bound(energy[:, None]).max(1)
        if self._chains.arrays.acts:
            # no energy bounds what is driven; a million times its length no column survives
            lengths = [scene.chain.diameters.sum() for scene in self._scenes]
            bound = np.minimum(bound, 1e6 * min(lengths))
        return bound

    def _restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` returned; raises `ValueError` if it does not fit."""
        differences = state["differences"].copy()
        peaks = state["peaks"].copy()
        self._sample = int(state["sample"])
        begin = max(self._sample, 0)
        apart = any(mover.stepper.sample != begin for mover in self._movers)
        fits = differences.shape == self._differences.shape and peaks.shape == self._peaks.shape
        if apart or not fits:
            raise ValueError("the state that was kept does not fit")
        if self.native.balance.size:
            if state["balance"].shape != self.native.balance.shape:
                raise ValueError("the state that was kept does not fit")
            self.native.balance[:] = state["balance"]
        self._differences = differences
        self._peaks = peaks

    def blocks(self) -> Iterator[Block]:
        """Yield the answer; samples that a restored state already had are not repeated."""
        final = self.scene.intervals
        while self._sample < final:
            if self._sample in self._looks:
                self.judge(self)
            first = self._sample + 1
            until = self._end_of_block(final)
            spent_s = self._spent_s
            answer = room_for(self.realisations, until + 1 - first, self.scene.chain.grains)
            if first == 0:
                answer[0][:, 0], answer[1][:, 0] = self._chains.initial
            for mover, fill in zip(self._movers, self._fills(answer, first), strict=True):
                while not mover.move(fill, until):
                    # adaptive steps of broken runs would be ever shorter
                    self._leave_broken(first, until)
                    nothing = np.empty((self.realisations, 0, self.scene.count(self.scene.chain)))
                    yield Block(slice(first, first), nothing, nothing)
            yield self._keep(*answer, first, until + 1)
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
        return sum(mover.seconds for mover in self._movers) + self._compared_s

    def _fills(self, answer: tuple[Array, Array], first: int) -> list[Fill]:
        """Return the functions that move each stepper on and fill its fields."""
        if not self._twin:
            return [partial(self.native.fill, *answer, first, beside=self._fields)]
        displacement, velocity = self._fields
        beside = displacement[1:], velocity[1:]
        return [
            partial(self._answer.fill, *answer, first),
            partial(self.native.fill, displacement[0], velocity[0], first, beside=beside),
        ]

    def _leave_broken(self, first: int, until: int) -> None:
        """Leave native chains whose grains are too close; their error is infinite.

        Raise if it is the answer.
        """
        broken = ~(self.native.closest() <= self._closest_allowed)
        if not broken.any():
            return
        # row 0 is the answer, unless it is not native
        if not self._twin and broken[0].any():
            raise RunFailed(self._describe_breakdown(first, TOO_CLOSE))
        self.native.leave(broken, until)
        self._lost = broken[1 - self._twin :]

    def _keep(self, u: Array, v: Array, first: int, stop: int) -> Block:
        """Check samples `first` ... `stop` - 1, and keep their distances from the companions."""
        began = clock()
        companions = self._companions
        runs = AuxiliaryRuns(*self._fields, companions.against, companions.strides)
        verdict = compare(
            u, v, runs, first, self._chains.masses, self._allowed, self._differences, self._peaks
        )
        self._leave_broken(first, stop - 1)
        if verdict != SOUND:
            raise RunFailed(self._describe_breakdown(first, WRONG[verdict]))
        if self._lost is not None:
            self._differences.swapaxes(1, 2)[self._lost] = np.inf
        self._sample = stop - 1
        self._compared_s += clock() - began
        if self.scene.grains != "all":
            columns = as_slice(self.scene.recorded - 1)
            u = np.array(u[:, :, columns])
            v = np.array(v[:, :, columns])
        return Block(slice(first, stop), u, v)

    def _describe_breakdown(self, sample: int, cause: str) -> str:
        t = self.scene.time[sample]
        step = self.proposal.step
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
        """Largest approach of two grains beyond that at rest, (R,) m, in the native companions."""
        return self.native.closest().max(0)

    @property
    def progress(self) -> float:
        """Part done: of the samples; beside a twin, of the time that all takes at its speed."""
        if not self._twin:
            return self.native.progress
        done = self._done
        spent_s = [mover.seconds for mover in self._movers]
        moved = done - self._done_before
        # what has not begun counts for nothing: the twin takes a small part of the time
        lasts_s = np.divide(spent_s, moved, out=np.zeros(2), where=moved > 0)
        return float(lasts_s @ done / lasts_s.sum()) if lasts_s.any() else float(done.min())

    @property
    def _done(self) -> Array:
        """Part of the steps done by an answer that is not native, and by its twin, (2,)."""
        answer = float(self._answer.steps.max()) / self.proposal.steps.total(self.scene.intervals)
        return np.array([answer, self.native.progress])

    def errors(self) -> list[ErrorBudget]:
        """Return the estimate for every realisation; see `estimate` for the formula."""
        scale = self._scale()
        distances = self._differences.max(1) / scale  # (S, R, 2)
        distances[np.isnan(distances)] = np.inf
        lowest = self.native.watched["least_strain"].reshape(-1, self.realisations).min(0)
        evaluations = self.native.steps * self._rounded_in_step
        table = np.column_stack((scale, lowest, evaluations)).tolist()
        return [
            self._estimate(real, LargestMotion(*row), distances[:, real])
            for real, row in enumerate(table)
        ]

    @property
    def _rounded_in_step(self) -> float:
        """Evaluations of the force that are rounded in a step, by the weight that they have."""
        return max(self.method.evaluations, self.method.spread**2)

    def _scale(self) -> Array:
        """Return the largest displacement and velocity, (R, 2) m and m/s, to which errors refer."""
        scale = self.peaks
        if self._twin and not self.native.largest()[0, 1]:
            # only what rounding presses moves: its velocities are below those of its displacements
            scale[0, 1] = max(scale[0, 1], self.scene.highest_frequency * scale[0, 0])
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

    def _estimate(self, real: int, motion: LargestMotion, distances: Array) -> ErrorBudget:
        """Return the estimate for one realisation from the distances between its runs, (S, 2)."""
        scene = self._scenes[real]
        companions = self._companions
        opens = motion.lowest <= OPENINGS.near
        if scene.recorded[0] > scene.chain.movable:
            # grains that are held do not move, in any precision
            return ErrorBudget(0.0, 0.0, self.method.order)
        order = companions.order(opens, scene.excitation.smooth_until(scene.duration))
        truncation = companions.truncation(real, distances[self._twin :], order, opens)
        # grains in contact fly nowhere
        flights = self._free_flights(real, motion) if opens else 0.0
        roundoff = self._round(real, motion, flights)
        amplified = np.zeros(0)
        if self._twin:
            # the distance from the twin is measured round-off, amplification and all
            roundoff += float(distances[0].max())
            scale = motion.displacement, motion.velocity
            amplified = (self._differences[0, :, real] / scale).max(-1)
        elif self._may_amplify(real, motion, truncation + roundoff):
            began = clock()
            amplified = self._amplify(real, motion.evaluations)
            if amplified.max() > self._hopeless:
                amplified = amplify_rounding(scene, motion.evaluations)
            touching = self._round(real, motion, 0.0)
            bound = max(roundoff, float(amplified.max()))
            if self._shall_repeat(truncation, touching, bound, motion.evaluations):
                repeated = repeat_rounding(scene, self.method, self.proposal.steps)
                amplified = np.fmin(amplified, repeated)
                # to one side all of these drift alike; not so the companions, at other steps
                one_sided = EPSILON * drift(motion.evaluations, flights)
                least = touching + min(one_sided, float(distances[0].max()))
                roundoff = max(least, min(roundoff, float(repeated.max())))
            roundoff = max(roundoff, float(amplified.max()))
            self._compared_s += clock() - began
        return ErrorBudget(truncation, roundoff, order, amplified=amplified)

    def _shall_repeat(
        self, truncation: float, touching: float, bound: float, evaluations: float
    ) -> bool:
        """Say whether to measure the rounding error by runs that take several times as long.

        `touching` is the part of the rounding error that these runs cannot reduce, and `bound` is
        the estimate without them.
        """
        tolerance = self.proposal.tolerance
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

    @property
    def _hopeless(self) -> float:
        """Amplified rounding, relative, that is far beyond the tolerance, whatever the steps."""
        return GROWTH.pessimism * min(self.proposal.tolerance, LARGEST_ERROR)

    def energies(self, errors: Sequence[ErrorBudget]) -> list[dict[str, Array]]:
        """Return what damping has taken and what was put in, with their errors.

        Those of an answer that is not native are of its twin.
        """
        balance = self.native.balance
        if not balance.size:
            return []
        companions = self._companions
        lowest = self.native.watched["least_strain"].reshape(-1, self.realisations).min(0)
        differences = companions.compare_energies(balance)
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
            distances = differences[:, real] / scale
            distances[np.isnan(distances)] = np.inf
            opens = bool(lowest[real] <= OPENINGS.near)
            order = companions.order(opens, scene.excitation.smooth_until(scene.duration))
            truncation = SUMMED * companions.truncation(real, distances, order, opens)
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
        samples = self._sample + 1
        scale = self._scale()
        # of the nearest companion
        apart = self._differences[0]
        late = apart.max(0) / scale
        early = apart[: math.ceil(samples / LOOKS.window)].max(0) / scale
        field = late.argmax(1)[:, None]
        grown = np.take_along_axis(np.fmax(late, TINY) / np.fmax(early, TINY), field, 1)[:, 0]
        power = np.clip(np.log(grown) / math.log(LOOKS.window), 0.0, LOOKS.steepest)
        remaining = self.scene.intervals / self._sample
        budgets = []
        for real, error in enumerate(self.errors()):
            truncation = error.truncation * remaining ** float(power[real])
            order = error.order
            if self.proposal.steps.adaptive:
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
        recurs = self._companions.recurrent[real]
        return recurs and could_grow(self._scenes[real], evaluations) > size

    def _flights(self, real: int, motion: LargestMotion) -> float:
        """Return how far the fastest grain would come in the whole run, over all that it moves."""
        return motion.velocity * self._scenes[real].duration / motion.displacement

    def _free_flights(self, real: int, motion: LargestMotion) -> float:
        """Return the same where contacts open: none turns faster than the fastest motion."""
        radians = self._scenes[real].total_phase
        return max(min(self._flights(real, motion), radians), 1.0)

    def _round(self, real: int, motion: LargestMotion, flights: float) -> float:
        """Return the round-off that the scene does not amplify, with `flights` of free grains."""
        scene = self._scenes[real]
        radians = scene.total_phase
        # what moves at all moves by more than the smallest double
        path = max(motion.velocity * scene.duration, SMALLEST)
        digit = last_digit(min(motion.displacement, motion.velocity, path))
        roundoff = digit / EPSILON * native_floor(motion.evaluations, radians, flights)
        steps = max(motion.evaluations / self._rounded_in_step, 1.0)
        if self._chains.plain[real]:
            roundoff += self.method.spread * plain_loss(scene, steps) / motion.velocity
        if self.proposal.steps.stride > 1:
            roundoff += interpolation_loss(steps, self._flights(real, motion))
        if scene.chain.damped:
            # Row 0 is the answer, or its twin: companions may have broken down.
            closer = float(self.native.closest()[0, real])
            displacement = float(self.peaks[real, 0])
            roundoff += reduced_loss(scene, displacement, closer) / motion.velocity
        return roundoff

    def _may_amplify(self, real: int, motion: LargestMotion, estimate: float) -> bool:
        """Say whether amplified rounding can count."""
        # once, at the end: the runs that show it take a fraction of the time of the answer
        complete = self._sample == self.scene.intervals
        counts = min(estimate, self.proposal.tolerance)
        return complete and self._may_grow(real, motion.evaluations, counts)

    def cost(self) -> Cost:
        """Return the cost so far.

        Steps and evaluations are those of the realisation that took most.
        """
        steps = int(max(self._answer.steps.tolist()))
        # answer and companions are moved in one compiled call, which tells their shares
        share = 1.0 if self._twin else self.native.own_part
        integration_s = share * self._movers[0].seconds
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
        state = {
            "sample": np.array(self._sample),
            "differences": self._differences,
            "peaks": self.peaks,
        }
        if self.native.balance.size:
            state["balance"] = self.native.balance
        for mover in self._movers:
            name = "native" if mover.stepper is self.native else "answer"
            state |= {f"{name}.{key}": array for key, array in mover.stepper.state().items()}
        return state

    def close(self) -> None:
        """Release every stepper."""
        for mover in self._movers:
            mover.stepper.close()


def fit_block(fit: int, samples: int, together: int) -> int:
    """Return the samples of a block: all if they fit, or a multiple of `together`."""
    return samples - 1 if fit >= samples else max(1, fit // together) * together


def place_looks(work_s: float, final: int, together: int) -> frozenset[int]:
    """Return samples where a run that takes so long, s, is judged; `final` is the last one."""
    fraction = 1 / LOOKS.apart
    looks = []
    while fraction * work_s > LOOKS.begin_s:
        looks.append(int(fraction * final) // together * together)
        fraction /= LOOKS.apart
    return frozenset(look for look in looks if look > 0)


def restrict(stepper: str, state: Mapping[str, Array] | None) -> dict[str, Array]:
    """Return the state of one stepper, under the names that it knows."""
    prefix = f"{stepper}."
    arrays = (state or {}).items()
    return {key.removeprefix(prefix): array for key, array in arrays if key.startswith(prefix)}
