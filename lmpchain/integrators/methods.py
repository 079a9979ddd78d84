"""The ways to step through time: splittings, and two that are there to be compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..util.arrays import Array
from .splittings import SPLITTINGS


class Method(Protocol):
    """What is known of every method."""

    @property
    def name(self) -> str:
        """How it is asked for."""

    @property
    def order(self) -> int:
        """Order of convergence while no contact opens."""

    @property
    def evaluations(self) -> int:
        """Force evaluations a step."""

    @property
    def error_constant(self) -> float:
        """Relative error at ``omega h = 1`` of the paper's scene, where ``omega T`` is 60.

        Measured by analysis/calibration/error_constants.py.
        """

    @property
    def reference(self) -> str:
        """Where it comes from."""

    @property
    def stability_limit(self) -> float:
        """Largest omega h for which a harmonic oscillator stays bounded, or hardly grows."""

    def growth(self, reach: float) -> float:
        """Return by what factor a harmonic oscillator with omega h = reach grows a step, or shrinks."""


@dataclass(frozen=True)
class DormandPrince:
    """DOP853 for x'' = a(x): its coefficients are SciPy's."""

    name: str = "dop853"
    order: int = 8
    evaluations: int = 12
    error_constant: float = 1e-9
    reference: str = "Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.5"

    @cached_property
    def tables(self) -> tuple[Array, Array, Array]:
        """Nodes (12,), inner weights (12, 12) and the weights of step and errors (6, 12); see `march_dop853`."""
        from scipy.integrate import DOP853

        a, b = DOP853.A[:12, :12], DOP853.B
        outer = [row for e in (b, DOP853.E5[:12], DOP853.E3[:12]) for row in (e @ a, e)]
        return DOP853.C[:12], a @ a, np.array(outer)

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x stays bounded."""
        return _first(self.growth, 1e-12)

    def growth(self, reach: float) -> float:
        """Return by what factor x'' = -omega^2 x grows a step; it shrinks up to the limit."""
        from scipy.integrate import DOP853

        a, b = DOP853.A[:12, :12], DOP853.B
        return float(abs(1 + 1j * reach * b @ np.linalg.solve(np.eye(12) - 1j * reach * a, np.ones(12))))


@dataclass(frozen=True)
class Gear:
    """Gear's predictor-corrector for x'' = a(x) with five values a grain."""

    name: str = "gear4"
    order: int = 4
    evaluations: int = 1
    error_constant: float = 1e-3
    reference: str = "Gear, Numerical Initial Value Problems in Ordinary Differential Equations (1971), chapter 9"
    corrections: tuple[float, ...] = (19 / 120, 3 / 4, 1.0, 1 / 2, 1 / 12)

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x grows by less than a hundredth a step: it always grows."""
        return _first(self.growth, 1e-2)

    def growth(self, reach: float) -> float:
        """Return by what factor x'' = -omega^2 x grows a step: always."""
        predict = np.array([[1, 1, 1, 1, 1], [0, 1, 2, 3, 4], [0, 0, 1, 3, 6], [0, 0, 0, 1, 4], [0, 0, 0, 0, 1.0]])
        off = -0.5 * reach**2 * predict[0] - predict[2]
        return float(np.abs(np.linalg.eigvals(predict + np.outer(self.corrections, off))).max())


def _first(growth: Callable[[float], float], more: float) -> float:
    """Return the first omega h, in steps of a thousandth, at which an oscillator grows by `more` a step."""
    grid = np.arange(1, 10000) / 1000
    return float(next(y for y in grid if growth(y) > 1 + more))


_ALL: tuple[Method, ...] = (*SPLITTINGS.values(), DormandPrince(), Gear())
METHODS = {method.name: method for method in _ALL}
