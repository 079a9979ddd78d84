"""Crests and passages of a wave, interpolated between the samples of any signals.

Signals are the velocities of grains, overlaps, forces, powers or correlations. The largest motion
of grains and their fronts, with bounds from the equation of motion, are computed by
`measure.motion` and, during a run, by `trajectory.accumulator`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly, make_interp_spline
from scipy.optimize import brentq

from ..util.arrays import Array
from ..util.lazy import listed

__dir__ = listed(__name__)

HALF = 4  # Number of samples on either side of a crest for the polynomial.
SPLINE_SAMPLES = 6  # Number of samples on either side of a maximum for the spline.
NEAR = 0.25  # Largest relative deviation of the next crest in time and height.


class Crests(NamedTuple):
    """Maxima over time of the velocity of grains in one direction, grain by grain.

    Attributes
    ----------
    grain : (P,) array
        Column of each maximum, in ascending order; maxima of one column are in the order of time.
    time : (P,) array
        Times of the maxima, s.
    height : (P,) array
        Velocities at the maxima, m/s.
    time_error, height_error : (P,) arrays
        Changes of time and height when only every second sample is used, s and m/s.
    """

    grain: NDArray[np.intp]
    time: Array
    height: Array
    time_error: Array
    height_error: Array

    def first(self, grain: int, begin: float, end: float) -> int | None:
        """Return the number of the highest crest between two times, or None."""
        first, last = np.searchsorted(self.grain, [grain, grain + 1])
        time = self.time[first:last]
        inside = first + np.flatnonzero((time >= begin) & (time <= end))
        return int(inside[self.height[inside].argmax()]) if inside.size else None

    def follow(self, crest: int, pace: float, way: int) -> NDArray[np.intp]:
        """Return the numbers of all crests of one wave, given one of them.

        Parameters
        ----------
        crest : int
            Number of the given crest.
        pace : float
            Travel time from grain to grain, s; negative if the wave travels to lower columns.
        way : +1 or -1
            Whether to follow the wave to higher (+1) or lower (-1) columns.
        """
        followed = [crest]
        while True:
            last = followed[-1]
            begin, end = np.searchsorted(self.grain, self.grain[last] + np.array([way, way + 1]))
            late = np.abs(self.time[begin:end] - self.time[last] - way * pace)
            height = self.height[last]
            near = (late < NEAR * abs(pace)) & (
                np.abs(self.height[begin:end] - height) < NEAR * height
            )
            if not near.any():
                return np.array(followed, dtype=np.intp)
            candidates = np.flatnonzero(near)
            followed.append(int(begin + candidates[late[candidates].argmin()]))


def find(time: Array, velocity: Array, least: float) -> Crests:
    """Return the crests of the motion of all grains above a height.

    Parameters
    ----------
    time : (T,) array
        Times in equal steps, s.
    velocity : (T, G) array
        Velocities, m/s, positive in the direction of interest.
    least : float
        Smallest height of a crest, m/s.

    Returns
    -------
    Crests
    """
    far = 2 * HALF
    inner = velocity[far:-far]
    tops = (inner >= velocity[far - 1 : -far - 1]) & (
        inner > velocity[far + 1 : len(time) - far + 1]
    )
    sample, grain = np.nonzero(tops & (inner > least))
    order = np.lexsort((sample, grain))
    sample = sample[order] + far
    grain = grain[order]
    step = time[1] - time[0]
    where, height = _summits(velocity, sample, grain, 1)
    rough_where, rough_height = _summits(velocity, sample, grain, 2)
    return Crests(
        grain,
        time[sample] + step * where,
        height,
        step * np.abs(where - rough_where),
        np.abs(height - rough_height),
    )


def _summits(
    velocity: Array, sample: NDArray[np.intp], grain: NDArray[np.intp], stride: int
) -> tuple[Array, Array]:
    """Return positions, relative to these samples, and heights of maxima of local polynomials."""
    nodes = np.arange(-HALF, HALF + 1)
    values = velocity[sample[:, None] + stride * nodes, grain[:, None]]
    powers = np.arange(nodes.size)
    terms = values @ np.linalg.inv(np.vander(nodes, increasing=True).astype(float)).T
    slopes = terms[:, 1:] * powers[1:]
    bends = slopes[:, 1:] * powers[1:-1]
    x = np.zeros(sample.size)
    for _ in range(6):
        curve = (bends * x[:, None] ** powers[:-2]).sum(1)
        slope = (slopes * x[:, None] ** powers[:-1]).sum(1)
        # Stay within one sample. A curve that is not concave has no maximum.
        x = np.clip(x - np.divide(slope, curve, out=np.zeros_like(x), where=curve < 0), -1, 1)
    return stride * x, (terms * x[:, None] ** powers).sum(1)


def local_maxima(values: Array) -> NDArray[np.intp]:
    """Return the numbers of local maxima of values (T,)."""
    inner = values[1:-1]
    return 1 + np.flatnonzero((inner >= values[:-2]) & (inner > values[2:]))


def first_crests(time: Array, signals: Array) -> tuple[Array, Array]:
    """Return the time and height of the first maximum above half of the largest value.

    Parameters
    ----------
    time : (T,) array
        Times, s.
    signals : (T, C) array
        Signals in any unit.

    Returns
    -------
    two (C,) arrays
        Times, s, and heights in the unit of the signals; NaN for a signal without a maximum.
    """
    crests = np.full((2, signals.shape[1]), np.nan)
    for n, signal in enumerate(signals.T):
        tops = local_maxima(signal)
        high = tops[signal[tops] > signal.max() / 2]
        if high.size:
            crests[:, n] = summit(time, signal, int(high[0]), 1)
    return crests[0], crests[1]


def first_passages(time: Array, signals: Array) -> Array:
    """Return the times at which signals first become positive, by cubic splines, (C,) s.

    Parameters
    ----------
    time : (T,) array
        Times in equal steps, s.
    signals : (T, C) array
        Signals in any unit, negative in the first sample and positive later.
    """
    # The spline is a function of the sample number, for which it is well conditioned.
    samples = np.arange(time.size)
    after = (signals > 0).argmax(0)
    places = [
        brentq(CubicSpline(samples, signal), k - 1, k)
        for signal, k in zip(signals.T, after, strict=True)
    ]
    return np.array(places) * (time[1] - time[0])


def summit(time: Array, values: Array, top: int, stride: int) -> tuple[float, float]:
    """Return the time and height of the maximum near a sample by a quintic spline.

    The spline interpolates every `stride`-th sample around the sample `top`.

    Parameters
    ----------
    time : (T,) array
        Times, s.
    values : (T,) array
        Values in any unit.
    top : int
        Number of the sample near the maximum.
    stride : int
        Distance between the samples that are used.

    Returns
    -------
    (float, float)
        Time, s, and height in the unit of the values.
    """
    near = np.arange(top - SPLINE_SAMPLES * stride, top + SPLINE_SAMPLES * stride + 1, stride)
    near = near[(near >= 0) & (near < len(values))]
    # Time is in sampling intervals from the sample, so that the spline is well conditioned.
    unit = time[top + 1] - time[top]
    spline = make_interp_spline(
        (time[near] - time[top]) / unit, values[near], k=min(5, len(near) - 1)
    )
    roots = PPoly.from_spline(spline.derivative()).roots(extrapolate=False)
    # The sample itself is used if rounding errors leave no root of the slope.
    inside = np.append(roots[np.abs(roots) <= stride], 0.0)
    best = inside[np.argmax(spline(inside))]
    return float(time[top] + best * unit), float(spline(best))
