"""How a chain is stepped through time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..engines.base import Candidate


@dataclass(frozen=True)
class Pace:
    """Steps between the samples that are stopped at.

    Attributes
    ----------
    steps : int
        Steps from one stop to the next, if all are equal.
    stride : int
        Samples from one stop to the next.
    step : float
        Longest step, s.
    graded : bool
        Whether steps shorten where a contact is about to open or close.
    """

    steps: int
    stride: int
    step: float
    graded: bool

    @classmethod
    def of(cls, candidate: Candidate, ratio: int = 1) -> Pace:
        """Return the pace of a candidate, or of a companion whose steps are longer by this ratio."""
        common = math.gcd(candidate.steps_per_sample, ratio)
        return cls(candidate.steps_per_sample // common, ratio // common, candidate.step * ratio, candidate.graded)

    @property
    def halved(self) -> Pace:
        """The pace of a companion at half the step."""
        return Pace(2 * self.steps, self.stride, self.step / 2, self.graded)
