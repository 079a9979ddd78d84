"""The Runge-Kutta method DOP853 of Dormand and Prince, order 8, with an embedded error estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..util.arrays import Array
from .method import March, first_growth
from .step_schedule import StepSchedule

if TYPE_CHECKING:
    from .batch import ChainBatch

# analysis/calibration/adaptive_steps.py
STEP_ERROR = 1e-9  # allowed error of an adaptive step with omega h = 1, over the scale of the motion; goes as h^order
STEP_ERROR_MIN = (
    2e-18  # least that is asked for: the estimate of less is round-off, and steps would never end
)
LONGER, FEWEST = (
    4.0,
    8,
)  # most of an adaptive step over that of the schedule; least steps of a run, if that has as many


@dataclass(frozen=True)
class DormandPrince:
    """DOP853 for x'' = a(x): its coefficients are SciPy's."""

    name: str = "dop853"
    order: int = 8
    evaluations: int = 12
    error_constant: float = 1e-9
    reference: str = (
        "Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.5"
    )
    adaptive: bool = True
    interpolates: bool = False

    @cached_property
    def tables(self) -> tuple[Array, Array, Array]:
        """Nodes (12,), inner weights (12, 12), weights of step and errors (6, 12); see `kernels.dop853`."""
        from scipy.integrate import DOP853

        a, b = DOP853.A[:12, :12], DOP853.B
        outer = [row for e in (b, DOP853.E5[:12], DOP853.E3[:12]) for row in (e @ a, e)]
        return DOP853.C[:12], a @ a, np.array(outer)

    @cached_property
    def spread(self) -> float:
        """Root of the sum of its squared weights, some of which are large."""
        return float(np.linalg.norm(self.tables[2][1]))

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x stays bounded."""
        return first_growth(self.growth, 1e-12)

    def growth(self, reach: float) -> float:
        """Return by what factor x'' = -omega^2 x grows a step; it shrinks up to the limit."""
        from scipy.integrate import DOP853

        a, b = DOP853.A[:12, :12], DOP853.B
        return float(
            abs(1 + 1j * reach * b @ np.linalg.solve(np.eye(12) - 1j * reach * a, np.ones(12)))
        )

    def march(self, batch: ChainBatch, schedules: Sequence[StepSchedule]) -> March:
        """Return what moves a batch of chains by steps of these schedules."""
        from .kernels.dop853 import march

        allowed, most = np.zeros(len(schedules)), np.ones(len(schedules))
        for index, schedule in enumerate(schedules):
            if schedule.adaptive:
                reach = schedule.step / schedule.ratio * batch.omega.max()
                allowed[index] = (
                    max(STEP_ERROR_MIN, STEP_ERROR * reach**self.order) * schedule.ratio**self.order
                )
            if not batch.imposed.knots.size:  # which would cut all alike
                total = schedule.ratio * schedule.total(batch.scenes[0].samples - 1)
                most[index] = min(LONGER, max(1.0, total / FEWEST))
        return March(march, (*self.tables, allowed, most))
