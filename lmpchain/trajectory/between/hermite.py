"""The motion between samples by Hermite interpolation, compiled.

Between two samples the velocity is the polynomial of degree 6 that has the recorded velocity v,
the acceleration a and the jerk j at both ends, and carries the grain from one recorded
displacement u to the other. Without that last condition it is the quintic through v, a and j; by
how much that misses the recorded displacement shows the error of both.

Polynomials are in Bernstein form: the sum of c_k B_k(s), s = t / h from 0 to 1. They lie between
the least and the largest of the c_k and have at most as many roots as these change sign. The mean
of the c_k is the integral, so that c_3 follows from the way, and the c_k of the displacement are
sums.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ...util.arrays import Array
from .derivatives import BodySeries, compiled, joined

# values of interest: |v|, |u|, or u with its sign
VELOCITY, DISPLACEMENT, RAISED = range(3)
HALVINGS = 40  # of an interval: roots so close are one or none
# least curvature, over the value, that is no rounding, as it is in free flight
FLAT = 1e-9
BINOMIALS = np.array([[math.comb(degree, k) for k in range(8)] for degree in range(8)], float)


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


class BodyPath(NamedTuple):
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

    series: BodySeries
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


# without NaN and signed zeros the compiler takes the maximum of several numbers at a time
@numba.njit(error_model="numpy", fastmath={"nnan", "nsz"})
def highest(y, begin, end, kind):
    """Return the largest size of values from one place to before another."""
    top = size(y[begin], kind)
    for i in range(begin + 1, end):
        top = larger(size(y[i], kind), top)
    return top


@joined
def sampled(p):
    """Return the values at the samples, (R,)."""
    return p.series.v if p.kind == VELOCITY else p.series.u


@joined
def _velocity(s, i, h):
    """Return the seven coefficients of the velocity from sample i to the next.

    c_0 = v_i, c_1 = v_i + h a_i / 6, c_2 = v_i + h a_i / 3 + h^2 j_i / 30, likewise from the other
    end; c_3 follows from (c_0 + ... + c_6) / 7 = (u_{i+1} - u_i) / h.

    ======  ===========================================  ====
    symbol  meaning                                      name
    ======  ===========================================  ====
    u, v    displacement and velocity at the samples     s.u, s.v
    a, j    acceleration and jerk there                  s.a, s.j
    h       time between two samples                     h
    c_k     coefficients in Bernstein form               c1 ... c5
    ======  ===========================================  ====
    """
    c1 = s.v[i] + h * (1 / 6) * s.a[i]
    c2 = s.v[i] + h * (1 / 3) * s.a[i] + h * h * (1 / 30) * s.j[i]
    c4 = s.v[i + 1] - h * (1 / 3) * s.a[i + 1] + h * h * (1 / 30) * s.j[i + 1]
    c5 = s.v[i + 1] - h * (1 / 6) * s.a[i + 1]
    # the mean of all seven is the way over h
    others = s.v[i] + c1 + c2 + c4 + c5 + s.v[i + 1]
    c3 = (s.u[i + 1] - s.u[i]) * (7 / h) - others
    return s.v[i], c1, c2, c3, c4, c5, s.v[i + 1]


@joined
def _largest(one, two, three, four):
    """Return the largest of four numbers."""
    return larger(larger(one, two), larger(three, four))


@compiled
def _fill_errors(series, h, error):
    """Fill in errors of the velocity behind each sample; loops so short become vectors."""
    v = series.v
    a = series.a
    j = series.j
    for i in range(error.size):
        c3 = _velocity(series, i, h)[3]
        # the middle coefficient of the quintic through v, a and j alone, raised by one degree
        quintic = (v[i] + v[i + 1]) / 2 + h * (1 / 5) * (a[i] - a[i + 1])
        quintic += h * h * (1 / 40) * (j[i] + j[i + 1])
        error[i] = SHAPE.safety * SHAPE.height / 7 * abs(c3 - quintic)
    for i in range(error.size):
        error[i] += SHAPE.push * h * series.doubt[i]
    last = error.size - 1
    before = error[0]
    # a misfit may vanish by chance: its neighbours count, too
    for i in range(error.size):
        here = error[i]
        error[i] = larger(larger(before, here), error[min(i + 1, last)])
        before = here


@compiled
def _bound_speeds(series, h, reach):
    """Fill in upper bounds on speeds behind each sample."""
    for i in range(reach.size):
        c0, c1, c2, c3, c4, c5, c6 = _velocity(series, i, h)
        inner = _largest(abs(c1), abs(c2), abs(c3), larger(abs(c4), abs(c5)))
        reach[i] = larger(inner, larger(abs(c0), abs(c6)))


@compiled
def _bound_displacements(series, h, kind, reach):
    """Fill in upper bounds on sizes of displacements behind each sample."""
    u = series.u
    w = h * (1 / 7)
    for i in range(reach.size):
        c0, c1, c2, c3, c4, c5, _ = _velocity(series, i, h)
        # each coefficient of the displacement adds one of the velocity; the last is u[i + 1]
        d1 = u[i] + w * c0
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
    """Return a body between its samples, a `BodyPath`; `bounds` is (2, R-1)."""
    reach, error = bounds
    _fill_errors(series, h, error)
    if kind == VELOCITY:
        _bound_speeds(series, h, reach)
    else:
        _bound_displacements(series, h, kind, reach)
        # the integral of the shape is 1: the displacement is off by h / height times as much
        for i in range(error.size):
            error[i] *= h / SHAPE.height
    degree = 6 if kind == VELOCITY else 7
    c = np.empty(degree + 1)
    return BodyPath(series, h, kind, ceiling, reach, error, c, np.empty(degree), np.empty(8))


@joined
def turns_or_slows(p, i):
    """Return whether a polynomial may turn behind sample i, or rise slower and then faster."""
    s = p.series
    c0, c1, c2, c3, c4, c5, c6 = _velocity(s, i, p.h)
    bends = s.a
    if p.kind == VELOCITY:
        # the six differences are the coefficients of its derivative; c0 repeats one of them
        c6 -= c5
        c5 -= c4
        c4 -= c3
        c3 -= c2
        c2 -= c1
        c1 -= c0
        c0 = c1
        bends = s.j
    top = larger(_largest(c0, c1, c2, c3), _largest(c4, c5, c6, c6))
    low = larger(_largest(-c0, -c1, -c2, -c3), _largest(-c4, -c5, -c6, -c6))
    # a derivative of one sign turns nowhere; it slows and then speeds up if its own slope says so
    if top >= low:
        return low > 0.0 or bends[i] < 0.0 < bends[i + 1]
    return top > 0.0 or bends[i] > 0.0 > bends[i + 1]


@joined
def polynomial(p, i):
    """Fill p.c and p.d with the polynomial from sample i to the next and its derivative."""
    v = p.c if p.kind == VELOCITY else p.d
    v[0], v[1], v[2], v[3], v[4], v[5], v[6] = _velocity(p.series, i, p.h)
    if p.kind == VELOCITY:
        for k in range(6):
            p.d[k] = 6 * (v[k + 1] - v[k])
    else:
        p.c[0] = p.series.u[i]
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
    return (c.size - 1) * value(c[1:] - c[:-1], s)


@joined
def sure_bend(p, s, top, error):
    """Return h^2 times the least curvature at a place, for value and error there; 0 if unsure."""
    return larger(abs(slope(p.d, s)) - SHAPE.curvature * error - FLAT * top, 0.0)


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
    first = c[0]
    last = c[degree]
    if first == last:
        return 0.0
    # in powers of s, which are evaluated faster
    powers = c.copy()
    for order in range(1, degree + 1):
        for k in range(degree, order - 1, -1):
            powers[k] -= powers[k - 1]
    for k in range(1, degree):
        powers[k] *= BINOMIALS[degree, k]
    low = 0.0
    high = 1.0
    s = first / (first - last)
    for _ in range(60):
        y = powers[degree]
        steep = 0.0
        for k in range(degree - 1, -1, -1):
            steep = steep * s + y
            y = y * s + powers[k]
        if (y > 0.0) == (last > first):
            high = s
        else:
            low = s
        # Newton's step, or bisection where that leaves the bracket
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
    begin[0] = 0.0
    width[0] = 1.0
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
            # de Casteljau's algorithm
            for step in range(c.size):
                left[step] = right[0]
                for k in range(c.size - 1 - step):
                    right[k] = (right[k] + right[k + 1]) / 2
            # the left half goes on top: it is taken first, so that roots come in order
            begin[waiting + 1] = begin[waiting]
            width[waiting + 1] = width[waiting]
            begin[waiting] += width[waiting]
            waiting += 2
    return count
