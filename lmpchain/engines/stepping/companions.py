"""Companions of an answer: native runs at other steps, whose distances show its truncation error.

They run at 2h and 4h, for the rate at which differences shrink gives the error; where 4h is too
long there is one at 2h, and where that is, one at h/2. Where contacts open again and again errors
scatter, and two runs may agree by chance: there runs one more, at about 1.5h. So it does where
contacts only touch at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...integrators.method import Method
from ...integrators.steps import MANY_STEPS, Steps
from ...scene.excitation import Displacement, Impulse
from ...scene.scene import Scene
from ...util.arrays import Array
from .estimate import estimate_truncation


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
        Step of the companion that runs where errors scatter, over that of the answer, and that for
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
LONGER = (2.0, 4.0)  # steps of companions over those of the answer
DIVIDING = (2.0, 3.0, 4.0)  # the same where each is to land on every sample
# exponent of the decay between two samples from which on companions land on each
DIES = 0.25
FEWEST_STEPS = 8  # of a run whose companions have longer steps: of fewer, two may have the same


class Companions:
    """The companions of an answer to a scene, or to R like ones.

    Parameters
    ----------
    method : Method
    scenes : sequence of R scenes
    steps : Steps
        Those of the answer.
    twin : bool
        Whether a twin at the same steps runs beside the answer, too.

    Attributes
    ----------
    answer : Steps
        Those of the answer.
    schedules : tuple of Steps
        Those of the companions.
    ratios : tuple of float
        Mean steps of the companions over those of the answer.
    against, strides : (S,) arrays
        With which run each of the S beside the answer is compared (0: the answer, from 1: one of
        these), and every how many samples.
    together : int
        After so many samples all of these stop.
    recurrent : list of R bool
        Whether contacts may open again and again, so that errors scatter.
    """

    def __init__(self, method: Method, scenes: Sequence[Scene], steps: Steps, twin: bool = False):
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
        arrangement = _arrange(self.answer, tuple(longer), self._nearby, twin, scenes[0].intervals)
        self.schedules, self.ratios, self.against, self.strides, self.together = arrangement
        self._least_ratio = [self._ratio_between_corners(scene) for scene in scenes]

    def order(self, opens: bool, smooth_excitation: bool) -> float:
        """Return the order of the method that is trusted; less where contacts open or nearly so."""
        # adaptive steps end on the knots of an excitation, equal ones pass over them
        regular = not opens and (self.answer.adaptive or smooth_excitation)
        return self._method.order if regular else self._order_at_openings

    def compare_energies(self, balance: Array) -> Array:
        """Return the largest differences between energies of the runs, (S, R, 2) J.

        `balance` has those of the answer, or of its twin, and of the companions, (S + 1, R, T, 2).
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

    def truncation(self, real: int, distances: Array, order: float, opens: bool) -> float:
        """Return the truncation error of a realisation from the distances between its runs.

        Parameters
        ----------
        real : int
            Its number, from 0.
        distances : (S, 2) array
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
            for field in distances.T.tolist()
        )

    def _ratio_between_corners(self, scene: Scene) -> float:
        """Return the smallest ratio of steps of the first companion between corners of a force.

        All runs end steps on corners, so that between these the ratio is that of two whole numbers.
        """
        if not scene.corners or not self.answer.adaptive:
            return self.ratios[0]
        times = np.array([0.0, *scene.corners, scene.duration])
        # A piece that is shorter than a step of a companion is the last one, and has few steps.
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


class Arrangement(NamedTuple):
    """Schedules of companions and how they are compared; the fields are those of `Companions`."""

    schedules: tuple[Steps, ...]
    ratios: tuple[float, ...]
    against: NDArray[np.int64]
    strides: NDArray[np.int64]
    together: int


@lru_cache(maxsize=256)  # like scenes have like companions
def _arrange(
    answer: Steps, longer: tuple[float, ...], nearby: bool, twin: bool, final: int
) -> Arrangement:
    """Arrange companions at steps longer by these ratios, or at half the step if there are none."""
    schedules = tuple(answer.longer(ratio) for ratio in longer) or (answer.halved,)
    ratios = tuple(answer.total(final) / schedule.total(final) for schedule in schedules)
    runs = (*[answer] * twin, *schedules)
    # each is compared with the one of the next shorter steps, but the nearby one with the answer
    against = np.array([*range(len(runs) - nearby), *[0] * nearby])
    strides = np.array([schedule.filled for schedule in runs])
    together = math.lcm(4, *(schedule.stride for schedule in runs))
    return Arrangement(schedules, ratios, against, strides, together)


def longer_steps(method: Method, scene: Scene, answer: Steps) -> list[float]:
    """Return how many times as long the steps of companions are: 2 and 4, 2 alone, or none.

    None where these are unstable or too few. Where damping ends a motion within a few samples its
    error is there in the first of them alone, and companions must land on each: then 3 serves, too,
    but there must be two, and no corners of a force.
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
    # One companion at longer steps may be right by chance where motions die within a step or two,
    # and where corners end steps, all of them may pass the last one before a sample alike.
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
