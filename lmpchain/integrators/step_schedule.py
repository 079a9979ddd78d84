"""The step size of a run, and where its steps land on samples."""

from __future__ import annotations

import math
from typing import NamedTuple

# steps between two samples from which on companions land on each, too; analysis/calibration/richardson_estimate.py
EVERY, EVERY_STRETCHED = 32, 128


class StepSchedule(NamedTuple):
    """Step schedule between two recorded samples on which the run lands.

    Attributes
    ----------
    steps : int
        Steps from one landing to the next, if all are equal.
    stride : int
        Samples from one landing to the next.
    dense : int
        Every how manieth sample between landings is interpolated; 0 where they are left out.
    step : float
        Largest step size, s.
    adaptive : bool
        Whether the step size adapts, shorter where a contact is about to open or close.
    ratio : float
        Step over that of the answer.
    coarse_openings : bool
        Whether adaptive steps near openings are longer than what keeps the order of the method there asks for.
    """

    steps: int
    stride: int
    step: float
    adaptive: bool
    ratio: float = 1.0
    coarse_openings: bool = False
    dense: int = 0

    def longer(self, ratio: float, stretched: bool = False) -> StepSchedule:
        """Return the schedule of a companion of this one, with steps longer by this ratio.

        If this lands on every so manieth sample only, between which it interpolates, so does a companion, which is only
        compared, but not all of them. Else, where a sample more or less matters little, it lands on every one: a
        collision may be seen in a single one.
        `stretched` says that steps may grow until samples cut them: the time between landings is then longer, too.
        """
        fewer = math.ceil(self.steps / ratio)
        same = self._replace(steps=fewer, step=self.step * self.steps / fewer, ratio=ratio)
        if self.stride > 1:
            some = next(n for n in (4, 2, 1) if n == 1 or ratio * self.stride >= n * self.steps)
            return same._replace(dense=some)
        if self.steps >= (EVERY_STRETCHED if stretched else EVERY):
            return same
        stride, parts = ratio.as_integer_ratio()
        common = 1 if stretched else math.gcd(parts * self.steps, stride)
        return same._replace(
            steps=parts * self.steps // common, stride=stride // common, step=self.step * ratio
        )

    def total(self, samples: int) -> int:
        """Return the steps from sample 0 to the sample of this number, if all are equal."""
        whole, rest = divmod(samples, self.stride)
        return whole * self.steps - (-self.steps * rest // self.stride)

    @property
    def halved(self) -> StepSchedule:
        """The schedule of a companion at half the step."""
        return self._replace(steps=2 * self.steps, step=self.step / 2, ratio=self.ratio / 2)
