"""The step size of a run, and where its steps land on samples."""

from __future__ import annotations

import math
from functools import lru_cache
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

    @classmethod
    @lru_cache(maxsize=256)  # like scenes have like schedules
    def of(
        cls,
        steps_per_landing: int,
        step: float,
        adaptive: bool,
        ratio: float = 1,
        stretched: bool = False,
        coarse_openings: bool = False,
        landing: int = 1,
    ) -> StepSchedule:
        """Return the schedule with so many steps between two samples, or one with steps longer by this ratio.

        If it lands on every so manieth sample only, those between are interpolated; of a companion, which is only
        compared, not all. Else, where a sample more or less matters little, it lands on every one: a collision may be
        seen in a single one.
        `stretched` says that steps may grow until samples cut them: the time between landings is then longer, too.
        """
        how = adaptive, ratio, coarse_openings
        if landing > 1:
            fewer = math.ceil(steps_per_landing / ratio)
            some = next(n for n in (4, 2, 1) if n == 1 or ratio * landing >= n * steps_per_landing) if ratio > 1 else 1
            return cls(fewer, landing, step * steps_per_landing / fewer, *how, dense=some)
        if steps_per_landing >= (EVERY_STRETCHED if stretched else EVERY):
            fewer = math.ceil(steps_per_landing / ratio)
            return cls(fewer, 1, step * steps_per_landing / fewer, *how)
        stride, parts = ratio.as_integer_ratio()
        common = 1 if stretched else math.gcd(parts * steps_per_landing, stride)
        return cls(parts * steps_per_landing // common, stride // common, step * ratio, *how)

    def total(self, samples: int) -> int:
        """Return the steps from sample 0 to the sample of this number, if all are equal."""
        whole, rest = divmod(samples, self.stride)
        return whole * self.steps - (-self.steps * rest // self.stride)

    @property
    def halved(self) -> StepSchedule:
        """The schedule of a companion at half the step."""
        return self._replace(steps=2 * self.steps, step=self.step / 2, ratio=self.ratio / 2)
