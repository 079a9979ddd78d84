"""Forcing of a scene and its load, evaluated independently of the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

Array = NDArray[np.floating[Any]]


def below_load(chain: Any) -> NDArray[np.bool_]:
    """Return a mask (N+1,) of the contacts that carry the load, including the wall."""
    return np.arange(chain.grains + 1) >= (chain.load_grain if chain.load_grain > 1 else 0)


class Curve:
    """The curve through points and its continuation on both sides, in the precision `kind`.

    The slopes at the points are SciPy's; from point to point there is the cubic with these slopes,
    or a straight line.
    """

    def __init__(self, given: Any, values: Array, kind: type[np.floating[Any]]):
        times = given.times
        straight = given.interpolation == "linear"
        slopes = 0 * np.asarray(values, dtype=kind)
        if given.interpolation == "pchip":
            slopes = PchipInterpolator(times, np.asarray(values, dtype=float))(times, 1)
        elif given.interpolation == "spline":
            # The curve is linear in the values, which may have more digits than a double.
            slopes = CubicSpline(times, np.eye(len(times)))(times, 1) @ np.asarray(values, kind)
        knots, y, slope = (np.asarray(a, dtype=kind) for a in (times, values, slopes))
        length = np.diff(knots)
        mean = np.diff(y) / length
        bend = (3 * mean - 2 * slope[:-1] - slope[1:]) / length
        twist = (slope[:-1] + slope[1:] - 2 * mean) / length**2
        rates = (mean, 0 * mean, 0 * mean) if straight else (slope[:-1], bend, twist)
        pieces = (y[:-1], *rates)
        # A force decreases to 0 in the last interval's length, and a drive holds still.
        fall = -y[-1] / length[-1] if given.kind == "force" else kind(0)
        rest = y[-1] if given.kind == "drive" else kind(0)
        behind = np.array([[y[-1], fall, 0, 0], [rest, 0, 0, 0]], dtype=kind).T
        self.pieces = np.append(np.array(pieces), behind, axis=1)
        # The last point belongs to the curve even if its time is rounded up.
        begins = np.append(knots[:-1], knots[-1] * (1 + kind(4 * 2.0**-52)))
        self.knots = np.append(begins, begins[-1] + length[-1] * np.arange(1, 3))
        if knots[0] > 0:
            begin = max(knots[0] - length[0], kind(0))
            rise = [[0, y[0] / (knots[0] - begin), 0, 0]]
            before = [*([[0, 0, 0, 0]] if begin > 0 else []), *rise]
            self.pieces = np.append(np.array(before, dtype=kind).T, self.pieces, axis=1)
            self.knots = np.append(([kind(0)] if begin > 0 else []) + [begin], self.knots)

    def __call__(self, t: np.floating[Any]) -> tuple[np.floating[Any], np.floating[Any]]:
        """Return the displacement (m) and velocity (m/s)."""
        piece = min(
            max(int(np.searchsorted(self.knots, t, side="right")) - 1, 0), self.knots.size - 2
        )
        s = t - self.knots[piece]
        y, slope, bend, twist = self.pieces[:, piece]
        return y + s * (slope + s * (bend + s * twist)), slope + s * (2 * bend + 3 * s * twist)
