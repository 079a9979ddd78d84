"""Gear's predictor-corrector of order 4, the method of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..util.caching import cached_property
from .method import March, first_growth
from .steps import Steps

if TYPE_CHECKING:
    from .batch import ChainBatch


@dataclass(frozen=True)
class Gear:
    """Gear's predictor-corrector for x'' = a(x) with five values a grain."""

    name: str = "gear4"
    order: int = 4
    evaluations: int = 1
    spread: float = 1.0
    error_constant: float = 1e-3
    reference: str = (
        "Gear, Numerical Initial Value Problems in Ordinary Differential Equations (1971), "
        "chapter 9"
    )
    damping: tuple[bool, ...] = (False,)
    adaptive: bool = False
    interpolates: bool = False
    corrections: tuple[float, ...] = (19 / 120, 3 / 4, 1.0, 1 / 2, 1 / 12)

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x grows by less than a hundredth a step."""
        return first_growth(self.growth, 1e-2)

    def growth(self, reach: float) -> float:
        """Return by what factor x'' = -omega^2 x grows a step: always."""
        # Taylor's series of x, h x', h^2 x'' / 2 ...: binomial coefficients
        predict = np.array(
            [[1, 1, 1, 1, 1], [0, 1, 2, 3, 4], [0, 0, 1, 3, 6], [0, 0, 0, 1, 4], [0, 0, 0, 0, 1.0]]
        )
        off = -0.5 * reach**2 * predict[0] - predict[2]
        return float(np.abs(np.linalg.eigvals(predict + np.outer(self.corrections, off))).max())

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains by steps of these schedules."""
        from .kernels.gear import make_work, march

        return March(march, make_work, (np.array(self.corrections),), history=3)
