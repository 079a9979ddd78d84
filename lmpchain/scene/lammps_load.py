"""Gravity and load of a column from the forces of its contacts at rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..util.arrays import Array

CERTAIN = 3.0  # Number of standard errors above which a value is certain.
GRAVITIES = (9.81, 9.80665, 9.8)  # Usual values of gravity in inputs, m/s2.
NEAR = 1e-5  # Relative difference from a usual gravity, caused by residual motion.
# Forces over the largest one below which gravity and load are taken to be 0.
LEAST_WEIGHT = 1e-7
LEAST_LOAD = 1e-9
HARDEST = 1e30  # Stiffness limit, N.
BISECTIONS = 2000


class Line(NamedTuple):
    """A straight line through points, with the standard error of its slope."""

    slope: float
    error: float


def fit_line(x: Array, y: Array, errors: Array) -> Line:
    """Return the line with the best fit to at least two points with these errors."""
    share = (errors.min() / errors) ** 2
    mean_x = float((share * x).sum() / share.sum())
    mean_y = float((share * y).sum() / share.sum())
    spread = float((share * (x - mean_x) ** 2).sum())
    if not spread > 0:
        return Line(0.0, math.inf)
    slope = float((share * (x - mean_x) * (y - mean_y)).sum()) / spread
    rest = y - mean_y - slope * (x - mean_x)
    scatter = float((share * rest**2).sum()) / max(1, x.size - 2)
    return Line(slope, math.sqrt(max(scatter, float(errors.min()) ** 2) / spread))


def gravity_of(line: Line, weights: Array, forces: Array) -> float:
    """Return gravity from the increase of forces with the mass above, m/s2; 0 if uncertain.

    A usual value such as 9.81 is returned if it differs by less than the error.
    """
    size = abs(line.slope)
    share = size * float(weights.max() - weights.min()) / max(float(forces.max()), 1e-300)
    if size <= CERTAIN * line.error or share < LEAST_WEIGHT:
        return 0.0
    usual = (g for g in GRAVITIES if abs(size - g) <= CERTAIN * line.error + NEAR * g)
    return next(usual, size)


def mean_load(rest: Array, errors: Array, largest: float) -> float:
    """Return the mean of forces minus weights, N; 0 if it is uncertain or negligible."""
    share = 1 / errors**2
    load = float((share * rest).sum() / share.sum())
    spread = float((share * (rest - load) ** 2).sum()) / max(1, rest.size - 1)
    error = math.sqrt(max(1.0, spread) / float(share.sum()))
    return 0.0 if abs(load) <= max(CERTAIN * error, LEAST_LOAD * largest) else load


def load_between(excess: Callable[[float], float]) -> float:
    """Return the load at which an increasing excess of overlaps is 0; infinite without a root.

    The excess must be below 0 at zero load.
    """
    low, high = 0.0, 1.0
    while excess(high) < 0:
        high *= 4
        if high > HARDEST:
            return math.inf
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return high
