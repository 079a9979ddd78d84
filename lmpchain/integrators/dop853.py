"""The Runge-Kutta method DOP853 of Dormand and Prince, order 8, without its error estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..util.arrays import Array
from ..util.lazy import cached_property
from .method import March, first_growth
from .steps import Steps, shorten_steps

if TYPE_CHECKING:
    from .batch import ChainBatch


@dataclass(frozen=True)
class DormandPrince:
    """DOP853 for x'' = a(x), with the coefficients of SciPy."""

    name: str = "dop853"
    order: int = 8
    evaluations: int = 12
    error_constant: float = 1e-9
    reference: str = (
        "Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.5"
    )
    damping: tuple[bool, ...] = (False, True)
    adaptive: bool = True
    interpolates: bool = False

    @cached_property
    def tables(self) -> tuple[Array, Array, Array, Array]:
        """Nodes, inner weights squared, weights, and inner weights; see `kernels.dop853`."""
        from scipy.integrate import DOP853

        # The product a @ a integrates twice, from accelerations to displacements.
        a = DOP853.A[:12, :12]
        b = DOP853.B
        return DOP853.C[:12], a @ a, np.array([b @ a, b]), np.array(a)

    @cached_property
    def spread(self) -> float:
        """Root of the sum of squared weights, some of which are large."""
        return float(np.linalg.norm(self.tables[2][1]))

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x stays bounded."""
        return first_growth(self.growth, 1e-12)

    def growth(self, reach: float) -> float:
        """Return the growth factor of x'' = -omega^2 x in a step; below 1 up to the limit."""
        from scipy.integrate import DOP853

        # The stability function at i omega h.
        a = DOP853.A[:12, :12]
        slopes = np.linalg.solve(np.eye(12) - 1j * reach * a, np.ones(12))
        return float(abs(1 + 1j * reach * DOP853.B @ slopes))

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains with these step schedules."""
        from .kernels.dop853 import make_work, march, march_by_step

        openings = shorten_steps(self.order, batch, schedules)
        method = self.tables, openings, schedules[0].adaptive
        return March(march, make_work, method, by_step=march_by_step)
