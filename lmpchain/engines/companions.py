"""Steps of the companions of an answer, and what their differences say of its truncation error.

They run at about 2h and 4h, at up to 4h and 8h where no contact comes near to opening, at 3h and 6h in uniform
columns that are struck on their top: the rate at which their differences shrink gives the truncation error. Where 4h
is unstable there is one at 2h, or at 1.5h, and where that is unstable, too, or the run has too few steps, one at h/2;
of one alone the order is trusted where nothing opens, else what the answer differs by counts as if there were none.
Where contacts open again and again, errors scatter, and two may agree by chance: there runs one more, at about 1.5h
(1.75h and from the first opening on for springs, whose force has a kink there).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..integrators.methods import Method
from ..integrators.step_schedule import StepSchedule
from ..scene.scene import Scene
from .base import Candidate
from .richardson import extrapolate
from .round_off import native_floor

# analysis/calibration/richardson_estimate.py measures these
FEWEST = 8  # steps of a run from which on companions have longer steps; of these there are then no two alike
CLOSE_TO_OPENING = (
    -0.5
)  # r / eps below which a contact's force is no longer a smooth function of time
SAFE_STRAIN = (
    0.3  # strain below which no contact comes near to opening: the order of a method is sure there,
)
# and the first of two companions may have steps so many times as long, if round-off is so far below the tolerance; and
# in columns that are struck on their top, for so many radians a grain before the wave is back
FAR, FLOOR, FAR_IN_COLUMNS, NOT_BACK = (4, 3), 0.1, (3,), 4.0
# order trusted after adaptive steps through openings: short ones keep it; not coarse ones, nor those of a method that
# follows its own error
ORDER_AT_OPENINGS, ORDER_WHERE_COARSE = 6, 4
# radians a grain from which on waves come back to where contacts opened; the step of one more companion then, and the
# part of what it differs by that the error is at least
COMES_BACK, NEARBY, LEAST_PART = 10.0, 1.5, 0.7
# the same for exponents below that, whose force has a kink at an opening: errors scatter from the first one on
KINKED_BELOW, ORDER_AT_KINKS, NEARBY_AT_KINKS = 1.25, 3, 1.75


class Companions:
    """The companions of an answer to a scene, or to R like ones.

    Parameters
    ----------
    method : Method
    scenes : sequence of R scenes
    candidate : Candidate
    twin : bool
        Whether a twin at the same steps runs beside the answer, too.

    Attributes
    ----------
    own : StepSchedule
        That of the answer.
    schedules : tuple of StepSchedule
        Those of the companions proper.
    against, strides : (S,) arrays
        With which of the answer, 0, and all S that run beside it, from 1, each of these is compared, and every how many
        samples: with the one of the next shorter steps, or the answer if it is `nearby`.
    together : int
        After so many samples all of these stop.
    scatters : list of R bool
        Whether errors may scatter.
    nearby : bool
        Whether the last companion is one more for these.
    kinks : bool
        Whether the force has kinks where contacts open.
    """

    def __init__(
        self, method: Method, scenes: Sequence[Scene], candidate: Candidate, twin: bool = False
    ):
        first, adaptive = scenes[0], candidate.adaptive
        self._order, self._adaptive, self.kinks = (
            method.order,
            adaptive,
            first.chain.exponent < KINKED_BELOW,
        )
        self._stretched = adaptive and method.adaptive == "error"  # samples cut some of its steps
        self._coarse = self._stretched or candidate.coarse_openings
        longer = longer_steps(method, scenes, candidate)
        self._finer = not longer
        far = bool(longer) and longer[0] > NEARBY
        self.scatters = [far and adaptive and _scatters(scene, self.kinks) for scene in scenes]
        self.nearby = any(self.scatters)
        if self.nearby:
            longer.append(NEARBY_AT_KINKS if self.kinks else NEARBY)
        how = self._stretched, self.nearby, twin, first.samples - 1
        self.own = candidate.schedule()
        self.schedules, self._ratios, self.against, self.strides, self.together = _arranged(
            self.own, tuple(longer), *how
        )

    def truncation(
        self, real: int, steps: Sequence[Sequence[float]], opens: bool, smooth: bool
    ) -> float:
        """Return the truncation error of a realisation from the differences between its runs.

        Parameters
        ----------
        real : int
            Its number, from 0.
        steps : S pairs
            Largest differences of displacements and velocities, relative to the motion, between steps h, 2h (and 4h),
            or h and h/2; the last one `nearby`.
        opens, smooth : bool
            Whether contacts come near to opening, and whether the method keeps an order there.
        """
        if self._finer:
            return 2 * max(steps[0])
        trusted = self._order - self._stretched
        if opens:
            falls_to = ORDER_WHERE_COARSE if self._coarse else ORDER_AT_OPENINGS
            falls_to = ORDER_AT_KINKS if self.kinks else falls_to
            trusted = min(self._order, falls_to) if self._adaptive else self._order
        fine, coarse = steps[0], steps[1] if len(steps) - self.nearby > 1 else (None, None)
        again = opens and self.scatters[real]
        how = self._ratios[:2], smooth and not opens, again
        displaced = extrapolate(trusted, smooth, coarse[0], fine[0], *how)
        found = max(displaced, extrapolate(trusted, smooth, coarse[1], fine[1], *how))
        return max(found, LEAST_PART * max(steps[-1])) if again else found


@lru_cache(maxsize=256)  # like scenes have like companions
def _arranged(
    own: StepSchedule,
    longer: tuple[float, ...],
    stretched: bool,
    nearby: bool,
    twin: bool,
    final: int,
) -> tuple[tuple[StepSchedule, ...], tuple[float, ...], NDArray[np.int64], NDArray[np.int64], int]:
    """Return schedules, mean steps over those of the answer, `against`, `strides` and `together`.

    Steps are so many times as long, or half as long if no longer ones are given.
    """
    schedules = tuple(own.longer(ratio, stretched) for ratio in longer) or (own.halved,)
    ratios = tuple(own.total(final) / schedule.total(final) for schedule in schedules)
    beside = (*[own] * twin, *schedules)
    against = np.array([*range(len(beside) - nearby), *[0] * nearby])
    strides = np.array([schedule.dense or schedule.stride for schedule in beside])
    return (
        schedules,
        ratios,
        against,
        strides,
        math.lcm(4, *(schedule.stride for schedule in beside)),
    )


def longer_steps(method: Method, scenes: Sequence[Scene], candidate: Candidate) -> list[float]:
    """Return how many times as long the steps of companions may be.

    None where all are unstable, too few, or would be cut by the knots of a drive like those of the answer; one and a
    half times where twice is, but for springs that open, whose errors scatter.
    """
    steps = candidate.steps(scenes[0].samples)
    if steps < FEWEST:
        return []
    reach = candidate.step * max(scene.chain.band_edge for scene in scenes)
    knots = (
        min(scene.excitation.knot_spacing for scene in scenes) if candidate.adaptive else math.inf
    )
    limit = min(method.stability_limit / reach if reach > 0 else math.inf, knots / candidate.step)
    kinks = scenes[0].chain.exponent < KINKED_BELOW
    far: tuple[int, ...] = ()
    if candidate.adaptive and all(struck_from_above(scene) for scene in scenes):
        far = FAR_IN_COLUMNS
    elif not candidate.adaptive and all(
        _sure(scene, steps * method.evaluations, candidate) for scene in scenes
    ):
        far = FAR
    for ratio in far:
        if 2 * ratio <= limit and steps >= FEWEST * ratio:
            return [ratio, 2 * ratio]
    longer: list[float] = [ratio for ratio in (2, 4) if ratio <= limit]
    # knots may cut steps of one and a half times the length like those of the answer
    if not longer and limit >= NEARBY and not kinks and knots == math.inf:
        return [NEARBY]
    return longer


def struck_from_above(scene: Scene) -> bool:
    """Say whether a free top is struck downward, and no wave is back before the end."""
    chain, strike = scene.chain, scene.excitation
    if chain.bounds is None or chain.impurity:  # where grains differ, some is reflected
        return False
    downward = strike.strikes_top and strike.strike_velocity > 0 and chain.top == "free"
    soon = scene.highest_frequency * scene.duration <= NOT_BACK * chain.grains
    return downward and soon and chain.exponent >= KINKED_BELOW


def _sure(scene: Scene, evaluations: int, candidate: Candidate) -> bool:
    """Whether the order of the method is sure, and round-off, which far runs do not show, is small."""
    smooth = scene.largest_strain <= SAFE_STRAIN and scene.excitation.smooth
    return (
        smooth
        and native_floor(evaluations, scene.highest_frequency * scene.duration)
        < FLOOR * candidate.solver_error
    )


def _scatters(scene: Scene, kinks: bool) -> bool:
    """Whether contacts may open again and again, by reflections or a drive; or once, at a kink."""
    crossed = 1 if scene.excitation.does_work else scene.chain.grains
    again = kinks or scene.highest_frequency * scene.duration > COMES_BACK * crossed
    return again and min(scene.largest_strain, scene.linear_strain) > -CLOSE_TO_OPENING
