"""Auxiliary runs: native runs at other steps, whose distances show the error of an answer.

Auxiliary runs have steps 2h and 4h, because the rate at which differences shrink gives the error.
If 4h is too long, there is one at 2h; if that is too long, one at h/2. If contacts open again and
again, or only touch at rest, errors scatter and two runs may agree by chance. Then there is one
more run, at about 1.5h.

The estimate of the largest relative error of an answer at steps h is

    e = max(2 d12 / (g - 1),  b)                                 truncation
        + max(eps (2 + w(n) + 1.5 omega T), w(n) A)      round-off, as it is or amplified
        + 8 eps D x / v                                  and of reduced velocities

with b = 2 dn where an auxiliary run is at 1.5 h, else b = d24 / (r2^p - r1^p). One such run alone,
at 2 h or h / 2, shows no rate: there the truncation error is 2 d12, or 2 d12 / (r1^p - 1) where
nothing opens and steps are equal. Where equal steps press contacts to far beyond their overlap at
rest, these began as good as open: a part of the error falls with h^2 alone, and with the share s of
d12 that follows from the gain, e is at least 2 d12 ((1 - s) / (r1^p - 1) + s / (r1^2 - 1)).

========  ==========  =========================================================================
symbol    variable    meaning
========  ==========  =========================================================================
d12       fine        distance of the answer from an auxiliary run at steps r1 h = 2 h, over the
                      largest motion
d24       coarse      distance of that run from one at steps r2 h = 4 h
dn        nearby      distance of the answer from one at 1.5 h, which runs where errors may scatter;
                      over 1.5^p - 1 if no contact opened
r1, r2    ratios      steps of the auxiliary runs over h
p         order       order that is trusted, see `AuxiliarySteps.truncation`
g         gain        error at steps r1 h over that at h, as observed:
                      (d24 / d12)^(ln r1 / ln(r2 / r1)), at most r1^p, and at least 1.5 for steps
                      of twice the length; g^(ln r / ln r1) where corners of a force cut steps, and
                      r, `least_ratio`, is the smallest ratio of steps between two corners
s         share       (r1^p - g) / (r1^p - r1^2), the part of d12 that falls with h^2, at most 1
eps       EPSILON     unit of the last place of 1
n, w(n)   rounding    evaluations of the force, and the last digits that they lose, sqrt(n), or
                      max(sqrt(n k), n / (8 k)) where contacts open, see `rounding`
k         flights     how far the fastest grain would fly, over the largest displacement
omega T   radians     phase of the fastest motion in the duration
A         amplified   what the scene makes of one last digit, see `rounding`; near the
                      tolerance, or with a given step if they exceed the truncation error, it and
                      the rounding of free flights are 2 times the distance of runs with the
                      steps of the answer that begin a last digit apart
========  ==========  =========================================================================

The estimate of a trajectory is e or 2, see `ErrorEstimate`. Step control uses e, however large.

Sources: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4; the
observed rate is that of Roache, Annu. Rev. Fluid Mech. 29, 123 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...integrators.method import Method
from ...integrators.steps import MANY_STEPS, Steps
from ...scene.excitation import Displacement, Impulse
from ...scene.scene import Scene
from ...util.arrays import Array


@dataclass(frozen=True)
class OpeningOrder:
    """Effect of openings of contacts on the order of a method.

    Measured by analysis/calibration/richardson_estimate.py.

    Attributes
    ----------
    near : float
        r / eps below which the force of a contact is no longer a smooth function of time; -1 is an
        opening.
    order : float
        That is trusted at most after steps that shorten near openings.
    coarse_order : float
        The same where these steps are coarse.
    equal_order : float
        The same after equal steps, which fall on openings as they come.
    scattered_order : float
        By which differences of these are divided: errors scatter with where in a step a contact
        opens, from the first one on, and two runs may agree by chance.
    far : float
        Strain from which a contact that is pressed by equal steps began as good as open.
    kinked_below : float
        Power of the overlap, with which a force sets in, below which it has a kink at an opening.
    returning : float
        Phase of the fastest motion, in radians a grain, after which waves come back to contacts
        that opened: errors scatter from there on.
    nearby, nearby_kinked : float
        Step of the auxiliary run where errors scatter, over that of the answer, and that for
        forces with kinks.
    """

    near: float = -0.5
    order: float = 6.0
    coarse_order: float = 4.0
    equal_order: float = 2.0
    scattered_order: float = 1.0
    far: float = 10.0
    kinked_below: float = 1.25
    returning: float = 10.0
    nearby: float = 1.5
    nearby_kinked: float = 1.75

    def kinks(self, onset: float) -> bool:
        """Say whether a force that sets in with this power has a kink at an opening."""
        return onset < self.kinked_below

    def trusted_order(self, steps: Steps) -> float:
        """Return the highest order that is trusted where contacts open, or nearly so."""
        if not steps.adaptive:
            return self.equal_order
        return self.coarse_order if steps.coarse_openings else self.order


OPENINGS = OpeningOrder()
STRIKES = (Impulse, Displacement)  # of one grain
LONGER = (2.0, 4.0)  # steps of auxiliary runs over those of the answer
DIVIDING = (2.0, 3.0, 4.0)  # the same where each is to land on every sample
# exponent of the decay between two samples from which on auxiliary runs land on each
DIES = 0.25
FEWEST_STEPS = 8  # of a run whose auxiliary runs have longer steps: of fewer, two may have the same


class AuxiliarySteps:
    """The steps of the auxiliary runs of an answer to a scene, or to R like ones.

    They say how these runs are compared, and what truncation error their distances show.

    Parameters
    ----------
    method : Method
    scenes : sequence of R scenes
    steps : Steps
        Those of the answer.
    twins : int
        Runs beside the answer that have its steps.

    Attributes
    ----------
    answer : Steps
        Those of the answer.
    schedules : tuple of Steps
        Those of the auxiliary runs.
    ratios : tuple of float
        Mean steps of the auxiliary runs over those of the answer.
    against, strides : (S,) arrays
        With which run each of the S beside the answer is compared (0: the answer, from 1: one of
        these), and every how many samples.
    together : int
        After so many samples all of these stop.
    recurrent : list of R bool
        Whether contacts may open again and again, so that errors scatter.
    """

    def __init__(self, method: Method, scenes: Sequence[Scene], steps: Steps, twins: int = 0):
        self._method = method
        self.answer = steps
        self._order_at_openings = min(method.order, OPENINGS.trusted_order(steps))
        longer = longer_steps(method, scenes[0], steps)
        self.recurrent = [recurs(scene) for scene in scenes]
        self._far = [scene.largest_strain > OPENINGS.far for scene in scenes]
        self._nearby = len(longer) == 2 and steps.adaptive and any(self.recurrent)
        if self._nearby:
            kinks = OPENINGS.kinks(scenes[0].chain.law.onset)
            longer.append(OPENINGS.nearby_kinked if kinks else OPENINGS.nearby)
        arrangement = _arrange(steps, tuple(longer), self._nearby, twins, scenes[0].intervals)
        self.schedules, self.ratios, self.against, self.strides, self.together = arrangement
        self._least_ratio = [self._ratio_between_corners(scene) for scene in scenes]

    def order(self, opens: bool, smooth_excitation: bool) -> float:
        """Return the order of the method that is trusted; less where contacts open or nearly so."""
        # adaptive steps end on the knots of an excitation, equal ones pass over them
        regular = not opens and (self.answer.adaptive or smooth_excitation)
        return self._method.order if regular else self._order_at_openings

    def compare_energies(self, balance: Array) -> Array:
        """Return the largest differences between energies of the runs, (S, R, 2) J.

        `balance` has those of the answer or its twin, then of the auxiliary runs, (S + 1, R, T, 2).
        """
        against = [*range(len(self.schedules) - self._nearby), *[0] * self._nearby]
        final = balance.shape[2] - 1
        differences = []
        for run, (schedule, other) in enumerate(zip(self.schedules, against, strict=True), 1):
            # where both have landed
            samples = np.append(np.arange(0, final, schedule.filled), final)
            apart = np.abs(balance[run][:, samples] - balance[other][:, samples])
            differences.append(apart.max(1))
        return np.array(differences)

    def truncation(
        self, real: int, distances: Sequence[Sequence[float]], order: float, opens: bool
    ) -> float:
        """Return the truncation error of a realisation from the distances between its runs.

        Parameters
        ----------
        real : int
            Its number, from 0.
        distances : sequence of S pairs
            Largest distances in displacements and velocities, relative to the motion, as in
            `against`.
        order : float
            That is trusted.
        opens : bool
            Whether contacts open or nearly so.
        """
        proper = len(self.schedules) - self._nearby
        # errors scatter where contacts open; elsewhere this distance, too, has the order
        gain = 1.0 if opens else self.ratios[-1] ** order - 1
        order, slow_order = self._orders(real, order, opens)
        settled = not self.answer.adaptive and slow_order == self._method.order
        return max(
            estimate_truncation(
                field[:proper],
                self.ratios[:proper],
                order,
                nearby=sum(field[proper:]) / gain if self.recurrent[real] else 0.0,
                settled=settled,
                slow_order=slow_order,
                least_ratio=self._least_ratio[real],
            )
            for field in zip(*distances, strict=True)
        )

    def _ratio_between_corners(self, scene: Scene) -> float:
        """Return the smallest ratio of steps of the first auxiliary run between corners of a force.

        All runs end steps on corners, so that between these the ratio is that of two whole numbers.
        """
        if not scene.corners or not self.answer.adaptive:
            return self.ratios[0]
        times = np.array([0.0, *scene.corners, scene.duration])
        # A piece that is shorter than a step of an auxiliary run is the last one, with few steps.
        long = np.diff(times) >= LONGER[-1] * self.answer.step
        pieces = times[:-1][long], times[1:][long]
        steps = self.schedules[0].longest_between(*pieces) / self.answer.longest_between(*pieces)
        return float(steps.min(initial=self.ratios[0]))

    def _orders(self, real: int, order: float, opens: bool) -> tuple[float, float]:
        """Return by which orders differences are divided: of the error, and of its slowest part.

        The error of a method of order 2 is its own: that of openings is smaller.
        """
        if self.answer.adaptive or self._method.order <= OPENINGS.equal_order:
            return order, order
        if opens:
            return OPENINGS.scattered_order, OPENINGS.scattered_order
        return order, min(order, OPENINGS.equal_order) if self._far[real] else order


@lru_cache(maxsize=256)  # like scenes have like auxiliary runs
def _arrange(
    answer: Steps, longer: tuple[float, ...], nearby: bool, twins: int, final: int
) -> tuple[tuple[Steps, ...], tuple[float, ...], NDArray[np.int64], NDArray[np.int64], int]:
    """Return steps and ratios of auxiliary runs, `against`, `strides` and `together` of them.

    Their steps are longer by these ratios, or half as long if there are none.
    """
    schedules = tuple(answer.longer(ratio) for ratio in longer) or (answer.halved,)
    ratios = tuple(answer.total(final) / schedule.total(final) for schedule in schedules)
    runs = (*[answer] * twins, *schedules)
    # each is compared with the one of the next shorter steps, but the nearby one with the answer
    against = np.array([*range(len(runs) - nearby), *[0] * nearby])
    strides = np.array([schedule.filled for schedule in runs])
    together = math.lcm(4, *(schedule.stride for schedule in runs))
    return schedules, ratios, against, strides, together


def longer_steps(method: Method, scene: Scene, answer: Steps) -> list[float]:
    """Return how many times as long the steps of auxiliary runs are: 2 and 4, 2 alone, or none.

    None where these are unstable or too few. Where damping ends a motion within a few samples its
    error is there in the first of them alone, and auxiliary runs must land on each: then 3 serves,
    too, but there must be two, and no corners of a force.
    """
    if answer.total(scene.intervals) < FEWEST_STEPS:
        return []
    reach = answer.step * scene.chain.fastest_rate
    steps = answer.per_landing
    dies = scene.sampling_decay > DIES
    if steps < MANY_STEPS and dies:
        ratios = [ratio for ratio in DIVIDING if steps % ratio == 0][:2]
    else:
        ratios = list(LONGER)
    stable = [ratio for ratio in ratios if ratio * reach <= method.stability_limit]
    # One auxiliary run at longer steps may be right by chance where motions die within a step or
    # two, and where corners end steps, all of them may pass the last one before a sample alike.
    seen = len(stable) > 1 and not scene.corners
    return stable if seen or not dies else []


def recurs(scene: Scene) -> bool:
    """Say whether contacts may open so often that errors scatter, by reflections or a drive.

    Where the force has a kink at an opening, once is enough. Contacts that only touch at rest open
    and close from the beginning.
    """
    crossed = 1  # what acts all along, or on many grains, opens contacts again without a reflection
    if isinstance(scene.excitation, STRIKES):
        above = scene.excitation.grain - 1
        below = scene.chain.grains - scene.excitation.grain
        # a wave that runs from one end has the whole chain before it
        crossed = min(above, below) or scene.chain.grains
    returns = scene.total_phase > OPENINGS.returning * crossed
    chain = scene.chain
    # The bounds on strains take arrays of all contacts: they are asked for last.
    recurs = returns or OPENINGS.kinks(chain.law.onset) or not chain.linearisable
    return recurs and min(scene.largest_strain, scene.linear_strain) > -OPENINGS.near


@dataclass(frozen=True)
class Trust:
    """Trust in the differences between runs.

    Measured by analysis/calibration/richardson_estimate.py.

    Attributes
    ----------
    safety : float
        Factor on the extrapolated error, and on the distance from an auxiliary run at 1.5 h.
    least_gain : float
        Of steps of twice the length: differences that shrink by less show no order at all.
    settled : float
        Difference up to which two runs alone show the error: phases that are far off lose the
        order.
    """

    safety: float = 2.0
    least_gain: float = 1.5
    settled: float = 0.01


TRUST = Trust()


def estimate_truncation(
    distances: Sequence[float],
    ratios: Sequence[float],
    order: float,
    nearby: float = 0.0,
    settled: bool = False,
    slow_order: float = math.inf,
    least_ratio: float = 0.0,
) -> float:
    """Return the truncation error of an answer by Richardson's extrapolation at the observed rate.

    Parameters
    ----------
    distances : sequence of one or two float
        Relative distances d12 and d24, d12 alone where there is one run.
    ratios : sequence of as many float
        Steps of these runs over that of the answer; below 1 for one at shorter steps.
    order : float
        That is trusted.
    nearby : float
        dn; 0 where there is no auxiliary run at 1.5 h.
    settled : bool
        Whether the force is a smooth function of time, so that the order is sure.
    slow_order : float
        Lowest order that a part of the error may have.
    least_ratio : float
        Ratio r of steps that the first auxiliary run has at least everywhere; 0: ratios[0].
    """
    fine = distances[0]
    if not math.isfinite(fine):
        # no rate follows from an auxiliary run that broke down
        return math.inf
    if len(distances) == 1:
        # the distance alone bounds the error at the longer steps, and no rate is seen; a run
        # at shorter ones shows no order either
        gain = max(ratios[0] ** order, 2.0) if settled and fine <= TRUST.settled else 2.0
        return TRUST.safety * fine / (gain - 1)
    coarse = distances[1]
    first, second = ratios
    gain = observe_gain(fine, coarse, first, second, order)
    if 1 < least_ratio < first:
        gain **= math.log(least_ratio) / math.log(first)
    extrapolated = TRUST.safety * fine / (gain - 1)
    if slow_order < order and first > 1:
        steep = first**order
        flat = first**slow_order
        share = min((steep - gain) / (steep - flat), 1.0)
        mean = (1 - share) / (steep - 1) + share / (flat - 1)
        extrapolated = max(extrapolated, TRUST.safety * fine * mean)
    # one more run confirms the rate; without it, the coarse difference alone is a bound, too
    bound = TRUST.safety * nearby if nearby > 0 else coarse / (second**order - first**order)
    return max(extrapolated, bound)


def observe_gain(fine: float, coarse: float, first: float, second: float, order: float) -> float:
    """Return the factor by which the error grows at steps `first` times as long, as observed."""
    doublings = math.log2(second / first)
    # from two differences that are both round-off, no rate above the order follows, nor one below 1
    rate = math.log2(max(coarse, 1e-300) / max(fine, 1e-300)) / doublings
    rate = min(max(rate, math.log2(TRUST.least_gain)), order)
    return first**rate
