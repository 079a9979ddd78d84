"""Auxiliary runs: native runs with other steps, whose differences estimate the error of a run.

Auxiliary runs have steps 2h and 4h, because the rate at which differences shrink gives the error.
If steps 4h are too long, there is one run with 2h; if steps 2h are too long, there is one with h/2.
If contacts open again and again, or only touch at rest, errors scatter and two runs may agree by
chance. Then there is one more run, with about 1.5h.

The estimate of the largest relative error of an answer with steps h is

    e = max(2 d12 / (g - 1),  b)                                 truncation
        + max(eps (2 + w(n) + 1.5 omega T), w(n) A)      rounding, without or with amplification
        + 8 eps D x / v                                  rounding of reduced velocities

with b = 2 dn if there is an auxiliary run with 1.5 h, else b = d24 / (r2^p - r1^p). A single
auxiliary run, with 2 h or h / 2, shows no rate: then the truncation error is 2 d12, or
2 d12 / (r1^p - 1) with equal steps if no contact opens. If equal steps press contacts far beyond
their overlap at rest, the contacts were nearly open at first, and a part of the error falls only
as h^2. If this part is a share s of d12, the truncation error is at least
2 d12 ((1 - s) / (r1^p - 1) + s / (r1^2 - 1)).

========  ==========  =========================================================================
symbol    variable    meaning
========  ==========  =========================================================================
d12       fine        largest distance of the answer from an auxiliary run with steps r1 h = 2 h,
                      relative to the largest motion
d24       coarse      the same distance between the auxiliary runs with r1 h and r2 h = 4 h
dn        nearby      the same distance of the answer from the run with 1.5 h, if errors may
                      scatter; divided by 1.5^p - 1 if no contact opened
r1, r2    ratios      steps of the auxiliary runs over h
p         order       trusted order of convergence, see `AuxiliarySteps.truncation`
g         gain        observed ratio of the errors with steps r1 h and h,
                      (d24 / d12)^(ln r1 / ln(r2 / r1)), at most r1^p, and at least 1.5 for steps
                      of twice the length. If kinks of a force end steps, g^(ln r / ln r1) replaces
                      it, where r (`least_ratio`) is the smallest ratio of steps between two kinks
s         share       (r1^p - g) / (r1^p - r1^2), at most 1
eps       EPSILON     unit in the last place (ulp) of 1
n         evaluations number of evaluations of the force
w(n)      rounding    rounding error of n evaluations in ulps: sqrt(n), or
                      max(sqrt(n k), n / (8 k)) if contacts open, see `rounding`
k         flights     path of the fastest grain in free flight, over the largest displacement
omega T   radians     phase of the fastest motion in the duration
A         amplified   amplification of one ulp by the scene, see `rounding`
D         rates       largest damping rate of a grain, 1/s; 0 without damping
x, v      size        largest displacement, m, and largest velocity, m/s, of the answer
========  ==========  =========================================================================

The product w(n) A may be far above the amplified rounding error. If it decides whether the
tolerance is met, or exceeds the truncation error of a given step, runs with the steps of the
answer measure the error instead. Their initial values differ by one ulp, and the estimate is twice
the largest distance of their solutions from the answer.

`ErrorEstimate` limits the estimate of a trajectory to 2. Step control uses e without a limit.

Sources: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4; for
the observed rate, Roache, Annu. Rev. Fluid Mech. 29, 123 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...integrators.steps import MANY_STEPS, Method, Steps
from ...scene.excitation import Displacement, Impulse
from ...scene.scene import Scene
from ...util.arrays import Array


@dataclass(frozen=True)
class OpeningOrder:
    """Effect of contact openings on the order of a method.

    The values are measured by analysis/calibration/richardson_estimate.py.

    Attributes
    ----------
    near : float
        Strain r / eps, the change of an overlap over the overlap at rest, below which the force of
        the contact is not a smooth function of time. The contact opens at -1.
    order : float
        Largest trusted order if contacts open and steps shorten near openings.
    coarse_order : float
        Largest trusted order if contacts open and steps near openings are coarse.
    equal_order : float
        Largest trusted order if contacts open and all steps are equal.
    scattered_order : float
        Order assumed for differences of runs with equal steps if contacts open. The errors depend
        on the time within a step at which a contact opens, and two runs may agree by chance.
    far : float
        Largest strain above which a contact counts as nearly open at first, with equal steps.
    kinked_below : float
        Onset exponent of a force law, as a function of the overlap, below which the force has a
        kink at an opening.
    returning : float
        Phase of the fastest motion for each grain, rad, after which waves return to contacts that
        have opened, so that errors scatter.
    nearby : float
        Ratio of the step of the auxiliary run for scattered errors to the step of the answer, for
        a force without a kink at an opening.
    nearby_kinked : float
        Ratio of the step of this auxiliary run to the step of the answer, for a force with a kink
        at an opening.
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
        """Return whether a force with this onset exponent has a kink where a contact opens."""
        return onset < self.kinked_below

    def trusted_order(self, steps: Steps) -> float:
        """Return the largest trusted order if contacts open, or nearly so."""
        if not steps.adaptive:
            return self.equal_order
        return self.coarse_order if steps.coarse_openings else self.order


OPENINGS = OpeningOrder()
STRIKES = (Impulse, Displacement)  # Strikes of a single grain.
LONGER = (2.0, 4.0)  # Ratios of the steps of auxiliary runs to those of the answer.
# Auxiliary runs land on every sample if the motion decays between samples by this exponent.
DIES = 0.25
FEWEST_STEPS = 8  # With fewer steps, the longer steps of two auxiliary runs may be equal.


class AuxiliarySteps:
    """Steps of the auxiliary runs for R similar scenes, their comparison, and truncation errors.

    Parameters
    ----------
    method : Method
        Integration method of all runs.
    scenes : sequence of R scenes
        Scenes that are computed together.
    steps : Steps
        Steps of the answer.
    twins : int
        Number of further runs with the steps of the answer.

    Attributes
    ----------
    answer : Steps
        Steps of the answer.
    schedules : tuple of Steps
        Steps of the auxiliary runs.
    ratios : tuple of float
        Ratios of the mean steps of the auxiliary runs to those of the answer.
    against : (S,) array of int
        Number of the run with which each of the S twins and auxiliary runs is compared: 0 for the
        answer, 1 to S for the twins and auxiliary runs.
    strides : (S,) array of int
        Number of samples from one comparison of each of the S runs to the next.
    together : int
        Number of samples after which all runs land on the same sample again.
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
        self._least_ratio = [self._ratio_between_kinks(scene) for scene in scenes]

    def order(self, opens: bool, smooth_excitation: bool) -> float:
        """Return the trusted order of the method, which is lower if contacts open or nearly so."""
        # Adaptive steps end on the kinks of an excitation; equal steps pass over them.
        regular = not opens and (self.answer.adaptive or smooth_excitation)
        return self._method.order if regular else self._order_at_openings

    def compare_energies(self, balance: Array) -> Array:
        """Return the largest differences between energies of the runs, (S, R, 2) J.

        `balance`, (S + 1, R, T, 2) J, has the energies of the answer or of its twin first, and then
        the energies of the S auxiliary runs.
        """
        against = [*range(len(self.schedules) - self._nearby), *[0] * self._nearby]
        final = balance.shape[2] - 1
        differences = []
        for run, (schedule, other) in enumerate(zip(self.schedules, against, strict=True), 1):
            # Compare where both runs have landed.
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
            Number of the realisation, from 0.
        distances : sequence of S pairs
            Largest distance in displacements and in velocities of each auxiliary run from the run
            that `against` names, relative to the largest motion.
        order : float
            Trusted order of convergence.
        opens : bool
            Whether a contact opens or nearly opens.
        """
        proper = len(self.schedules) - self._nearby
        # Errors scatter if contacts open; otherwise this distance also converges with the order.
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

    def _ratio_between_kinks(self, scene: Scene) -> float:
        """Return the smallest step ratio of the first auxiliary run and the main run.

        All runs end steps on kinks of the forcing. Between two kinks each run makes a whole number
        of steps, so that the ratio of the steps differs from the nominal ratio.
        """
        if not scene.kinks or not self.answer.adaptive:
            return self.ratios[0]
        times = np.array([0.0, *scene.kinks, scene.duration])
        # A piece that is shorter than a step of an auxiliary run is the last one, with few steps.
        long = np.diff(times) >= LONGER[-1] * self.answer.step
        pieces = times[:-1][long], times[1:][long]
        steps = self.schedules[0].longest_between(*pieces) / self.answer.longest_between(*pieces)
        return float(steps.min(initial=self.ratios[0]))

    def _orders(self, real: int, order: float, opens: bool) -> tuple[float, float]:
        """Return the orders of the error and of its slowest part, used for the extrapolation.

        A method of order 2 does not lose order at openings.
        """
        if self.answer.adaptive or self._method.order <= OPENINGS.equal_order:
            return order, order
        if opens:
            return OPENINGS.scattered_order, OPENINGS.scattered_order
        return order, min(order, OPENINGS.equal_order) if self._far[real] else order


@lru_cache(maxsize=256)  # Similar scenes have equal auxiliary runs.
def _arrange(
    answer: Steps, longer: tuple[float, ...], nearby: bool, twins: int, final: int
) -> tuple[tuple[Steps, ...], tuple[float, ...], NDArray[np.int64], NDArray[np.int64], int]:
    """Return `schedules`, `ratios`, `against`, `strides` and `together` of `AuxiliarySteps`.

    The steps of the auxiliary runs are longer than those of the answer by the factors `longer`, or
    half as long if `longer` is empty.
    """
    schedules = tuple(answer.longer(ratio) for ratio in longer) or (answer.halved,)
    ratios = tuple(answer.total(final) / schedule.total(final) for schedule in schedules)
    runs = (*[answer] * twins, *schedules)
    # Each run is compared with the run of the next shorter steps, and a nearby run with the answer.
    against = np.array([*range(len(runs) - nearby), *[0] * nearby])
    strides = np.array([schedule.filled for schedule in runs])
    together = math.lcm(4, *(schedule.stride for schedule in runs))
    return schedules, ratios, against, strides, together


def longer_steps(method: Method, scene: Scene, answer: Steps) -> list[float]:
    """Return the step ratios of auxiliary run and main run: 2 and 4, 2 alone, or an empty list.

    The list is empty if longer steps are unstable or too few. If damping ends the motion within a
    few samples, only these samples show the error, and auxiliary runs must land on every sample.
    Then a ratio of 3 is allowed, but the list is empty if there is only one stable ratio or if the
    forcing has kinks.
    """
    if answer.total(scene.intervals) < FEWEST_STEPS:
        return []
    reach = answer.step * scene.chain.fastest_rate
    steps = answer.per_landing
    dies = scene.sampling_decay > DIES
    if steps < MANY_STEPS and dies:
        ratios = [ratio for ratio in (2.0, 3.0, 4.0) if steps % ratio == 0][:2]
    else:
        ratios = list(LONGER)
    stable = [ratio for ratio in ratios if ratio * reach <= method.stability_limit]
    # A single auxiliary run may be right by chance if motions decay within a step or two. If kinks
    # end steps, all runs may have the same last step before a sample.
    seen = len(stable) > 1 and not scene.kinks
    return stable if seen or not dies else []


def recurs(scene: Scene) -> bool:
    """Return whether contacts may open so often, by reflections or forcing, that errors scatter.

    If the force law has a kink at openings, a single opening makes errors scatter. Contacts that
    touch at rest without a load open and close from the beginning.
    """
    # A forcing, or a strike of many grains, opens contacts again without a reflection.
    crossed = 1
    if isinstance(scene.excitation, STRIKES):
        above = scene.excitation.grain - 1
        below = scene.chain.grains - scene.excitation.grain
        # A wave that starts at one end crosses the whole chain.
        crossed = min(above, below) or scene.chain.grains
    returns = scene.total_phase > OPENINGS.returning * crossed
    chain = scene.chain
    # The bounds on strains need arrays of all contacts, so they are evaluated last.
    recurs = returns or OPENINGS.kinks(chain.law.onset) or not chain.linearisable
    recurs = recurs or chain.ground is not None
    return recurs and min(scene.largest_strain, scene.linear_strain) > -OPENINGS.near


@dataclass(frozen=True)
class Trust:
    """Trust in the differences between runs.

    The values are measured by analysis/calibration/richardson_estimate.py.

    Attributes
    ----------
    safety : float
        Factor on the extrapolated error, and on the distance from an auxiliary run with 1.5 h.
    least_gain : float
        Smallest assumed ratio of the errors with steps 2h and h. Differences that shrink by a
        smaller factor show no order of convergence.
    settled : float
        Largest difference for which a single auxiliary run shows the error with the full order.
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
    """Return the truncation error of a run by Richardson extrapolation at the observed rate.

    Parameters
    ----------
    distances : sequence of one or two float
        Relative distances d12 and d24 of the module docstring, or d12 alone.
    ratios : sequence of one or two float
        Ratios of the steps of the auxiliary runs to the steps of the answer; below 1 for shorter
        steps.
    order : float
        Trusted order of convergence.
    nearby : float
        Distance dn; 0 without an auxiliary run with 1.5 h.
    settled : bool
        Whether the force is a smooth function of time, so that the order is certain.
    slow_order : float
        Lowest order of convergence of any part of the error.
    least_ratio : float
        Smallest ratio r of the steps of the first auxiliary run and of the answer between two
        kinks of the forcing; 0 if it is ratios[0].

    Returns
    -------
    float
        Estimated error relative to the largest motion; infinite if an auxiliary run broke down.
    """
    fine = distances[0]
    if not math.isfinite(fine):
        # An auxiliary run that broke down gives no convergence rate.
        return math.inf
    if len(distances) == 1:
        # The distance bounds the error with the longer steps, and one run shows no order.
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
    # The run with 1.5 h confirms the rate. Without it, the coarse difference is another bound.
    bound = TRUST.safety * nearby if nearby > 0 else coarse / (second**order - first**order)
    return max(extrapolated, bound)


def observe_gain(fine: float, coarse: float, first: float, second: float, order: float) -> float:
    """Return the observed factor by which the error grows with steps `first` times as long."""
    doublings = math.log2(second / first)
    # Two differences that are both rounding must not give a rate above the order or below 1.
    rate = math.log2(max(coarse, 1e-300) / max(fine, 1e-300)) / doublings
    rate = min(max(rate, math.log2(TRUST.least_gain)), order)
    return first**rate
