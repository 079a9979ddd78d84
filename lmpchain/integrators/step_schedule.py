"""The steps of a run, and where they land on samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array

# steps between two samples from which on companions land on each, too: there a landing changes
# their steps by little, and few samples may miss a collision;
# analysis/calibration/richardson_estimate.py
MANY_STEPS = 32


class StepSchedule(NamedTuple):
    """Step schedule between two recorded samples on which the run lands.

    Attributes
    ----------
    steps : int
        Steps from one landing to the next, if all are equal.
    stride : int
        Samples from one landing to the next.
    step : float
        Largest step size, s.
    adaptive : bool
        Whether the step size adapts, shorter where a contact is about to open or has just closed.
    ratio : float
        Step over that of the answer.
    coarse_openings : bool
        Whether steps near openings are longer than what keeps the order of the method there asks
        for.
    dense : int
        Every `dense`-th sample between two landings is interpolated; 0: none.
    """

    steps: int
    stride: int
    step: float
    adaptive: bool
    ratio: float = 1.0
    coarse_openings: bool = False
    dense: int = 0

    def longer(self, ratio: float) -> StepSchedule:
        """Return the schedule of a companion of this one, with steps longer by this ratio.

        If the answer interpolates samples, the companion interpolates every 4th, 2nd or each of
        them, as they are only compared. Otherwise, with many steps a sample, it lands on every
        sample, for a collision may show in one sample only; with few, its landings are as much
        further apart.
        """
        steps = math.ceil(self.steps / ratio)
        companion = self._replace(steps=steps, step=self.step * self.steps / steps, ratio=ratio)
        # of a step there is to be one sample at least, where it interpolates
        if self.stride > 1:
            dense = next(n for n in (4, 2, 1) if n == 1 or ratio * self.stride >= n * self.steps)
            return companion._replace(dense=dense)
        if self.steps >= MANY_STEPS:
            return companion
        # in lowest terms: landings as close as whole numbers of longer steps allow
        numerator, denominator = ratio.as_integer_ratio()
        common = math.gcd(denominator * self.steps, numerator)
        return companion._replace(
            steps=denominator * self.steps // common,
            stride=numerator // common,
            step=self.step * ratio,
        )

    @property
    def filled(self) -> int:
        """Samples from one that the run fills, by landing or interpolation, to the next."""
        return self.dense or self.stride

    def total(self, samples: int) -> int:
        """Return the steps from sample 0 to the sample of this number, if all are equal."""
        landings, remaining = divmod(samples, self.stride)
        return landings * self.steps - (-self.steps * remaining // self.stride)

    def longest_between(self, begin: Array, end: Array) -> Array:
        """Return the longest step between two corners, (C,) s, on which steps end as on landings.

        The steps between a corner and a landing are equal, and as few as their length allows.
        """
        landing = self.steps * self.step
        first = np.minimum(np.ceil(begin / landing) * landing, end)
        last = np.maximum(np.floor(end / landing) * landing, first)
        lengths = np.array([first - begin, last - first, end - last])
        return (lengths / np.maximum(np.ceil(lengths / self.step - 1e-9), 1)).max(0)

    @property
    def halved(self) -> StepSchedule:
        """The schedule of a companion at half the step."""
        return self._replace(steps=2 * self.steps, step=self.step / 2, ratio=self.ratio / 2)
