"""The motion between samples by Hermite interpolation, compiled.

Between two samples the velocity is the polynomial of degree 6 that has the recorded velocity v, the acceleration a and
the jerk j at both ends, and carries the grain from one recorded displacement u to the other. Without that last
condition it is the quintic through v, a and j; by how much the way that this one goes misses the recorded one shows how
far off both may be.
"""

from __future__ import annotations

from typing import NamedTuple

import numba

from ...util.arrays import Array

VELOCITY, DISPLACEMENT, RAISED = range(3)  # what is looked at: |v|, |u|, or u with its sign
# factor on the misfit of the way; analysis/calibration/between_samples.py measures that it suffices
SAFETY = 4.0
BUMP = 2.1875  # largest value of 140 s^3 (1-s)^3, the shape of the misfit
SWING = (
    0.3125  # by which an acceleration at both ends changes the velocity between them, in intervals
)
STEEPEST = 7.52  # and of its slope
CURVED = 105.0  # and, twice, of its curvature: a kink bends more than it moves
FLAT = 1e-9  # of a value: what bends it by less in an interval is rounding, as in free flight, or no matter
PARTS = 4  # of an interval, in which roots are looked for
inlined = numba.njit(inline="always", error_model="numpy")
compiled = numba.njit(error_model="numpy")
reduced = numba.njit(
    error_model="numpy", fastmath={"nnan", "nsz"}
)  # a maximum of several at a time


class Path(NamedTuple):
    """One grain between its samples: what is known at these, and what is looked at.

    Attributes
    ----------
    u, v, a, j : (T,) arrays
        Displacement, velocity, acceleration and jerk.
    h : float
        Time between two samples.
    kind : int
        VELOCITY, DISPLACEMENT or RAISED.
    ceiling : (T-1,) or (0,) array
        Bounds on the speed between samples; below 0 where, or empty if, it follows from the samples.
    reach, error : (T-1,) arrays
        Quick bounds on what is looked at between samples, and how far off the polynomials may be.
    c, d, places : (8,) arrays
        To work in: coefficients in powers of s = t / h, those of the derivative, and where it vanishes.
    """

    u: Array
    v: Array
    a: Array
    j: Array
    h: float
    kind: int
    ceiling: Array
    reach: Array
    error: Array
    c: Array
    d: Array
    places: Array


@inlined
def size(y, kind):
    """Return how large a value counts."""
    return y if kind == RAISED else abs(y)


@inlined
def larger(one, other):
    """Return the larger of two numbers, in one instruction."""
    return one if one > other else other


@reduced
def highest(y, kind):
    """Return the largest size of values."""
    most = size(y[0], kind)
    for i in range(1, y.size):
        most = larger(size(y[i], kind), most)
    return most


@inlined
def sampled(p):
    """Return what is looked at at the samples, (T,)."""
    return p.v if p.kind == VELOCITY else p.u


@inlined
def misfit(u, v, a, j, i, h):
    """Return by how much the quintic through v, a and j misses the way from sample i to the next, over h."""
    way = (
        (v[i] + v[i + 1]) / 2
        + h * (1 / 10) * (a[i] - a[i + 1])
        + h * h * (1 / 120) * (j[i] + j[i + 1])
    )
    return (u[i + 1] - u[i]) * (1 / h) - way


@compiled
def path(motion, g, h, kind, ceiling, reach, error, c, d, places):
    """Return a grain between its samples."""
    u, v, a, j, off = motion[0, g], motion[1, g], motion[2, g], motion[3, g], motion[4, g]
    last = reach.size - 1
    for i in range(reach.size):  # short loops, for the compiler makes vectors of these
        reach[i] = abs(misfit(u, v, a, j, i, h))
    for i in range(reach.size):
        error[i] = SAFETY * BUMP * reach[i] + SWING * h * larger(off[i], off[i + 1])
    for i in range(reach.size):
        speed = larger(abs(v[i]), abs(v[i + 1])) + SWING * h * larger(abs(a[i]), abs(a[i + 1]))
        reach[i] = speed + 0.035 * h * h * larger(abs(j[i]), abs(j[i + 1])) + BUMP * reach[i]
    before = error[0]
    for i in range(reach.size):  # a misfit may vanish by chance: its neighbours count, too
        own = error[i]
        error[i] = max(before, own, error[min(i + 1, last)])
        before = own
    if kind != VELOCITY:
        for i in range(reach.size):
            reach[i] = max(size(u[i], kind), size(u[i + 1], kind)) + h * reach[i] / 2
            error[i] *= h / BUMP
    limits = ceiling[g] if ceiling.size else ceiling[0]
    return Path(u, v, a, j, h, kind, limits, reach, error, c, d, places)


@compiled
def polynomial(p, i):
    """Fill p.c with the polynomial of what is looked at from sample i to the next."""
    v, a, j, h, c = p.v, p.a, p.j, p.h, p.c
    missed = misfit(p.u, v, a, j, i, h)
    m0, m1, w0, w1 = h * a[i], h * a[i + 1], h * h * j[i], h * h * j[i + 1]
    d = v[i + 1] - v[i]
    c[0], c[1], c[2] = v[i], m0, w0 / 2
    c[3] = 10 * d - 6 * m0 - 4 * m1 - 1.5 * w0 + 0.5 * w1 + 140 * missed
    c[4] = -15 * d + 8 * m0 + 7 * m1 + 1.5 * w0 - w1 - 420 * missed
    c[5] = 6 * d - 3 * m0 - 3 * m1 - 0.5 * w0 + 0.5 * w1 + 420 * missed
    c[6], c[7] = -140 * missed, 0.0
    if p.kind != VELOCITY:
        for k in range(7, 0, -1):
            c[k] = h * c[k - 1] / k
        c[0] = p.u[i]


@compiled
def value(c, s):
    """Return the polynomial at a place."""
    y = c[7]
    for k in range(6, -1, -1):
        y = y * s + c[k]
    return y


@compiled
def slope(c, s):
    """Return the derivative of the polynomial at a place."""
    y = 7 * c[7]
    for k in range(6, 0, -1):
        y = y * s + k * c[k]
    return y


@compiled
def derive(p):
    """Fill p.d with the derivative of the polynomial."""
    for k in range(7):
        p.d[k] = (k + 1) * p.c[k + 1]


@compiled
def sure_bend(p, s, top, error):
    """Return h^2 times the least curvature at a place, given value and error there; below 0 if unsure."""
    derive(p)
    return abs(slope(p.d, s)) - CURVED / BUMP * error - FLAT * top


@compiled
def root(c, level, low, high):
    """Return where the polynomial is at a level, between two places on either side of it."""
    first, last = value(c, low) - level, value(c, high) - level
    rising = last > 0.0
    s = low + (high - low) * first / (first - last)
    for _ in range(60):
        y = value(c, s) - level
        if (y > 0.0) == rising:
            high = s
        else:
            low = s
        steep = slope(c, s)
        following = s - y / steep if steep != 0.0 else low
        if not low < following < high:
            following = (low + high) / 2
        if (
            abs(following - s) < 1e-12
        ):  # it converges with the square: the next would be below 1e-16
            return following
        s = following
    return s


@compiled
def turns(p):
    """Fill p.places with those where the polynomial turns, in order; return how many."""
    d, count = p.d, 0
    derive(p)
    before = d[0]
    for part in range(1, PARTS + 1):
        s = part / PARTS
        now = value(d, s)
        if before * now < 0.0:
            p.places[count] = root(d, 0.0, s - 1 / PARTS, s)
            count += 1
        if now != 0.0:
            before = now
    return count
