"""The motion between samples by Hermite interpolation, compiled.

Between two samples the velocity is the polynomial of degree 6 that has the recorded velocity v, the
acceleration a and the jerk j at both ends, and carries the grain from one recorded displacement u to
the other. Without that last condition it is the quintic through v, a and j; by how much that misses
the recorded displacement shows how far off both may be.

Polynomials are in Bernstein form: the sum of c_k B_k(s), s = t / h from 0 to 1. They lie between the
least and the largest of the c_k and have at most as many roots as these change sign. The mean of the
c_k is the integral, so that c_3 follows from the way, and the c_k of the displacement are sums.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ...util.arrays import Array
from .derivatives import Series, compiled, joined

VELOCITY, DISPLACEMENT, RAISED = range(3)  # values of interest: |v|, |u|, or u with its sign
HALVINGS = 40  # of an interval: roots so close are one or none
BINOMIALS = np.array([[math.comb(degree, k) for k in range(8)] for degree in range(8)], float)
ROUNDING = 1e-9  # of a value: a curvature of less in an interval is rounding, as in free flight


class Shape(NamedTuple):
    """Errors of the interpolated velocity.

    The misfit of the quintic has the shape 140 s^3 (1-s)^3, whose integral is 1.

    Attributes
    ----------
    safety : float
        Factor on the misfit; analysis/calibration/between_samples.py measures that it suffices.
    height : float
        Largest value of the shape.
    slope, curvature : float
        Its largest slope, and twice its largest curvature (a kink bends more than it moves), over
        `height`.
    push : float
        Change of the velocity by an acceleration h^-1, of opposite sign at the two ends.
    """

    safety: float = 4.0
    height: float = 2.1875
    slope: float = 3.436
    curvature: float = 48.0
    push: float = 0.3125


SHAPE = Shape()


class Path(NamedTuple):
    """One body between its samples.

    Attributes
    ----------
    series : Series
    h : float
        Time between two samples, s.
    kind : int
        VELOCITY, DISPLACEMENT or RAISED.
    ceiling : (R-1,) or (0,) array
        Bounds on the speed between samples; below 0, or empty, where it follows from the samples.
    reach, error : (R-1,) arrays
        Upper bounds on the sizes of the polynomials, and errors of these.
    c, d : arrays
        To work in: Bernstein coefficients of a polynomial and of its derivative.
    places : (8,) array
        To work in: roots.
    """

    series: Series
    h: float
    kind: int
    ceiling: Array
    reach: Array
    error: Array
    c: Array
    d: Array
    places: Array


@joined
def size(y, kind):
    """Return the size of a value."""
    return y if kind == RAISED else abs(y)


@joined
def larger(one, other):
    """Return the larger of two numbers, in one instruction."""
    return one if one > other else other


@numba.njit(error_model="numpy", fastmath={"nnan", "nsz"})  # a maximum of several at a time
def highest(y, begin, end, kind):
    """Return the largest size of values from one place to before another."""
    most = size(y[begin], kind)
    for i in range(begin + 1, end):
        most = larger(size(y[i], kind), most)
    return most


@joined
def sampled(p):
    """Return the values at the samples, (R,)."""
    return p.series.v if p.kind == VELOCITY else p.series.u


@joined
def _velocity(s, i, h):
    """Return the coefficients of the velocity from sample i to the next."""
    c1 = s.v[i] + h * (1 / 6) * s.a[i]
    c2 = s.v[i] + h * (1 / 3) * s.a[i] + h * h * (1 / 30) * s.j[i]
    c4 = s.v[i + 1] - h * (1 / 3) * s.a[i + 1] + h * h * (1 / 30) * s.j[i + 1]
    c5 = s.v[i + 1] - h * (1 / 6) * s.a[i + 1]
    others = s.v[i] + c1 + c2 + c4 + c5 + s.v[i + 1]
    return c1, c2, (s.u[i + 1] - s.u[i]) * (7 / h) - others, c4, c5


@joined
def _largest(one, two, three, four):
    """Return the largest of four numbers."""
    return larger(larger(one, two), larger(three, four))


@compiled
def _fill_errors(series, h, error):
    """Fill in errors of the velocity behind each sample; loops so short become vectors."""
    v, a, j, doubt = series.v, series.a, series.j, series.doubt
    for i in range(error.size):
        _, _, c3, _, _ = _velocity(series, i, h)
        quintic = (v[i] + v[i + 1]) / 2 + h * (1 / 5) * (a[i] - a[i + 1])
        quintic += h * h * (1 / 40) * (j[i] + j[i + 1])
        error[i] = SHAPE.safety * SHAPE.height / 7 * abs(c3 - quintic)
    for i in range(error.size):
        error[i] += SHAPE.push * h * doubt[i]
    last = error.size - 1
    before = error[0]
    for i in range(error.size):  # a misfit may vanish by chance: its neighbours count, too
        own = error[i]
        error[i] = larger(larger(before, own), error[min(i + 1, last)])
        before = own


@compiled
def _bound_speeds(series, h, reach):
    """Fill in upper bounds on speeds behind each sample."""
    v = series.v
    for i in range(reach.size):
        c1, c2, c3, c4, c5 = _velocity(series, i, h)
        inner = _largest(abs(c1), abs(c2), abs(c3), larger(abs(c4), abs(c5)))
        reach[i] = larger(inner, larger(abs(v[i]), abs(v[i + 1])))


@compiled
def _bound_displacements(series, h, kind, reach):
    """Fill in upper bounds on sizes of displacements behind each sample."""
    u, v = series.u, series.v
    w = h * (1 / 7)
    for i in range(reach.size):
        c1, c2, c3, c4, c5 = _velocity(series, i, h)
        d1 = u[i] + w * v[i]
        d2 = d1 + w * c1
        d3 = d2 + w * c2
        d4 = d3 + w * c3
        d5 = d4 + w * c4
        d6 = d5 + w * c5
        top = larger(_largest(u[i], d1, d2, d3), _largest(d4, d5, d6, u[i + 1]))
        low = larger(_largest(-u[i], -d1, -d2, -d3), _largest(-d4, -d5, -d6, -u[i + 1]))
        reach[i] = larger(top, low if kind == DISPLACEMENT else top)


@joined
def path(series, kind, h, ceiling, bounds):
    """Return a body between its samples, a `Path`; `bounds` is (2, R-1)."""
    reach, error = bounds
    _fill_errors(series, h, error)
    if kind == VELOCITY:
        _bound_speeds(series, h, reach)
    else:
        _bound_displacements(series, h, kind, reach)
        for i in range(error.size):
            error[i] *= h / SHAPE.height
    degree = 6 if kind == VELOCITY else 7
    c = np.empty(degree + 1)
    return Path(series, h, kind, ceiling, reach, error, c, np.empty(degree), np.empty(8))


@joined
def turns_or_slows(p, i):
    """Return whether a polynomial may turn behind sample i, or rise slower and then faster."""
    s = p.series
    c1, c2, c3, c4, c5 = _velocity(s, i, p.h)
    one, other = s.v[i], s.v[i + 1]
    bent, straight = s.a[i], s.a[i + 1]
    if p.kind == VELOCITY:
        one, c1, c2, c3, c4, c5, other = (
            c1 - one,
            c2 - c1,
            c3 - c2,
            c4 - c3,
            c5 - c4,
            other - c5,
            one,
        )
        other = c5
        bent, straight = s.j[i], s.j[i + 1]
    top = larger(_largest(one, c1, c2, c3), _largest(c4, c5, other, other))
    low = larger(_largest(-one, -c1, -c2, -c3), _largest(-c4, -c5, -other, -other))
    if top >= low:
        return low > 0.0 or bent < 0.0 < straight
    return top > 0.0 or bent > 0.0 > straight


@joined
def polynomial(p, i):
    """Fill p.c and p.d with the polynomial from sample i to the next and its derivative."""
    s = p.series
    c1, c2, c3, c4, c5 = _velocity(s, i, p.h)
    v = p.c if p.kind == VELOCITY else p.d
    v[0], v[1], v[2], v[3], v[4], v[5], v[6] = s.v[i], c1, c2, c3, c4, c5, s.v[i + 1]
    if p.kind == VELOCITY:
        for k in range(6):
            p.d[k] = 6 * (v[k + 1] - v[k])
    else:
        p.c[0] = s.u[i]
        for k in range(7):
            v[k] *= p.h
            p.c[k + 1] = p.c[k] + v[k] * (1 / 7)


@compiled
def value(c, s):
    """Return a polynomial at a place."""
    degree = c.size - 1
    power = s
    y = c[0] * (1 - s)
    for k in range(1, degree):
        y = (y + BINOMIALS[degree, k] * power * c[k]) * (1 - s)
        power *= s
    return y + power * c[degree]


@compiled
def slope(c, s):
    """Return the derivative of a polynomial at a place."""
    degree = c.size - 2
    power = s
    y = (c[1] - c[0]) * (1 - s)
    for k in range(1, degree):
        y = (y + BINOMIALS[degree, k] * power * (c[k + 1] - c[k])) * (1 - s)
        power *= s
    return (degree + 1) * (y + power * (c[degree + 1] - c[degree]))


@joined
def sure_bend(p, s, top, error):
    """Return h^2 times the least curvature at a place, for value and error there; 0 if unsure."""
    least = abs(slope(p.d, s)) - SHAPE.curvature * error - ROUNDING * top
    return larger(least, 0.0)


@compiled
def _changes(c):
    """Return how often coefficients change sign; 0 counts as positive."""
    count = 0
    for k in range(1, c.size):
        count += (c[k] < 0.0) != (c[k - 1] < 0.0)
    return count


@compiled
def _root(c):
    """Return the only root of a polynomial whose coefficients change sign once."""
    degree = c.size - 1
    first, last = c[0], c[degree]
    if first == last:
        return 0.0
    # in powers of s, which are evaluated faster
    powers = c.copy()
    for order in range(1, degree + 1):
        for k in range(degree, order - 1, -1):
            powers[k] -= powers[k - 1]
    for k in range(1, degree):
        powers[k] *= BINOMIALS[degree, k]
    low, high = 0.0, 1.0
    s = first / (first - last)
    for _ in range(60):
        y, steep = powers[degree], 0.0
        for k in range(degree - 1, -1, -1):
            steep = steep * s + y
            y = y * s + powers[k]
        if (y > 0.0) == (last > first):
            high = s
        else:
            low = s
        following = s - y / steep if steep != 0.0 else low
        if not low < following < high:
            following = (low + high) / 2
        # it converges with the square: the next change would be below 1e-16
        if abs(following - s) < 1e-12:
            return following
        s = following
    return s


@compiled
def roots(c, places):
    """Fill in where a polynomial changes sign, in order; return how many places these are."""
    changes = _changes(c)
    if changes == 0:
        return 0
    if changes == 1:
        places[0] = _root(c)
        return 1
    # halve it until each piece has one root or none
    pieces = np.empty((HALVINGS + 2, c.size))
    begin = np.empty(HALVINGS + 2)
    width = np.empty(HALVINGS + 2)
    pieces[0] = c
    begin[0], width[0] = 0.0, 1.0
    waiting = 1
    count = 0
    while waiting > 0:
        waiting -= 1
        right = pieces[waiting]
        changes = _changes(right)
        small = width[waiting] < 2.0**-HALVINGS
        if changes == 1 or (small and changes % 2 == 1):
            places[count] = begin[waiting] + width[waiting] * _root(right)
            count += 1
        elif changes > 1 and not small:
            width[waiting] /= 2
            left = pieces[waiting + 1]
            for step in range(c.size):  # de Casteljau's algorithm
                left[step] = right[0]
                for k in range(c.size - 1 - step):
                    right[k] = (right[k] + right[k + 1]) / 2
            begin[waiting + 1], width[waiting + 1] = begin[waiting], width[waiting]
            begin[waiting] += width[waiting]
            waiting += 2
    return count
