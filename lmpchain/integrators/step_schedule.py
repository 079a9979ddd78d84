"""The step size of a run, and where its steps land on samples."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class StepSchedule:
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
        Whether the step size adapts, shorter where a contact is about to open or close.
    ratio : float
        Step over that of the answer.
    """

    steps: int
    stride: int
    step: float
    adaptive: bool
    ratio: float = 1.0

    @classmethod
    def of(
        cls, steps_per_sample: int, step: float, adaptive: bool, ratio: int = 1, stretched: bool = False
    ) -> StepSchedule:
        """Return the schedule with so many steps between two samples, or one with steps longer by this ratio.

        `stretched` says that steps may grow until samples cut them: the time between landings is then longer, too.
        """
        common = 1 if stretched else math.gcd(steps_per_sample, ratio)
        return cls(steps_per_sample // common, ratio // common, step * ratio, adaptive, ratio)

    def total(self, samples: int) -> int:
        """Return the steps from sample 0 to the sample of this number, if all are equal."""
        whole, rest = divmod(samples, self.stride)
        return whole * self.steps - (-self.steps * rest // self.stride)

    @property
    def halved(self) -> StepSchedule:
        """The schedule of a companion at half the step."""
        return StepSchedule(2 * self.steps, self.stride, self.step / 2, self.adaptive, self.ratio / 2)
