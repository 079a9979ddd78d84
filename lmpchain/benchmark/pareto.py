"""Points of cost and error that lead, and the cost of an error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

# Errors below this multiple of the error of the reference are not accurate enough.
KNOWN = 10.0


def time_to(error: float, points: Iterable[tuple[float, float]]) -> float:
    """Return the time to reach an error, s, from points (seconds, error); NaN if none does.

    Between two points it is interpolated as a power law.

    Examples
    --------
    >>> round(time_to(1e-4, [(1.0, 1e-2), (4.0, 1e-6)]), 9)
    2.0
    """
    before = None
    for seconds, reached in sorted(points):
        if reached <= error:
            if before is None:
                return seconds
            share = math.log(before[1] / error) / math.log(before[1] / reached)
            return float(before[0] * (seconds / before[0]) ** share)
        before = seconds, reached
    return math.nan


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the Pareto front of points (cost, error), cheapest first.

    Examples
    --------
    >>> front([(2.0, 0.1), (1.0, 0.5), (3.0, 0.2)])
    [1, 0]
    """
    smallest = math.inf
    indices = []
    for index in sorted(range(len(points)), key=points.__getitem__):
        if points[index][1] < smallest:
            smallest = points[index][1]
            indices.append(index)
    return indices
