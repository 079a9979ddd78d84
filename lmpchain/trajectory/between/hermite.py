"""Motion between the samples by Hermite interpolation, compiled.

Between two samples, the velocity is interpolated by a polynomial of degree 6. It has the recorded
velocity v, the acceleration a and the jerk j at both ends, and its integral is the change of the
recorded displacement u. The quintic through v, a and j does not satisfy the condition on u, and the
difference between its integral and the change of u shows the error of both polynomials.

Polynomials are in Bernstein form, the sum of c_k B_k(s) with s = t / h from 0 to 1. The values are
between the smallest and the largest c_k, and the number of roots is at most the number of sign
changes of the c_k. The integral over s is the mean of the c_k. The coefficient c_3 of the velocity
therefore follows from the change of u, and the c_k of the displacement are cumulative sums.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ...util.arrays import Array
from .derivatives import INGREDIENT, compiled, joined

# Values to follow: |u|, |v|, or u with its sign.
DISPLACEMENT, VELOCITY, RAISED = range(3)
HALVINGS = 40  # Number of halvings of an interval; closer roots count as one or none.
# Smallest curvature, relative to the value, above the rounding errors of free flight.
FLAT = 1e-9
BINOMIALS = np.array([[math.comb(degree, k) for k in range(8)] for degree in range(8)], float)


class PathRows(NamedTuple):
    """Rows of the path of a body, (8, R).

    Attributes
    ----------
    displacement : int
        Row of the displacements at the R samples, m.
    velocity : int
        Row of the velocities at the samples, m/s.
    acceleration : int
        Row of the accelerations at the samples, m/s2.
    jerk : int
        Row of the jerks at the samples, m/s3.
    doubt : int
        Row of the error of the acceleration in the interval after each sample, m/s2.
    middle : int
        Row of the middle coefficient of the velocity in this interval, m/s.
    error : int
        Row of the error of the interpolated size in this interval.
    reach : int
        Row of an upper bound on the interpolated size in this interval; see `bound`.
    """

    displacement: int = 0
    velocity: int = 1
    acceleration: int = 2
    jerk: int = 3
    doubt: int = 4
    middle: int = 5
    error: int = 6
    reach: int = 7


class ScratchRows(NamedTuple):
    """Rows and columns of the work array for polynomials; see `scratch`.

    Attributes
    ----------
    value : int
        Row of the coefficients of a polynomial.
    slope : int
        Row of the coefficients of its first derivative.
    bend : int
        Row of the coefficients of its second derivative.
    steep : int
        Row of the coefficients of one more derivative.
    turns : int
        Row of the places at which the polynomial turns.
    places : int
        Row of the places of other roots.
    pieces : int
        First row of the pieces of a polynomial.
    begin : int
        Column of the start of each piece.
    width : int
        Column of the width of each piece.
    """

    value: int = 0
    slope: int = 1
    bend: int = 2
    steep: int = 3
    turns: int = 4
    places: int = 5
    pieces: int = 6
    begin: int = 8
    width: int = 9


U, V, A, J, DOUBT, MIDDLE, ERROR, REACH = PathRows()
C, D, BEND, STEEP, TURNS, PLACES, PIECES, BEGIN, WIDTH = ScratchRows()


class Shape(NamedTuple):
    """Errors of the interpolated velocity.

    The difference between the two polynomials has the shape 140 s^3 (1-s)^3, whose integral is 1.

    Attributes
    ----------
    safety : float
        Safety factor on this difference, measured by analysis/calibration/between_samples.py.
    height : float
        Largest value of the shape.
    slope : float
        Largest slope of the shape, over `height`.
    curvature : float
        Twice the largest curvature of the shape, over `height`. The factor of two is for kinks,
        where the curvature has a larger relative error than the value.
    push : float
        Error of the velocity in units of h times the error of the acceleration, if the errors of
        the acceleration at the two ends have opposite signs.
    """

    safety: float = 4.0
    height: float = 2.1875
    slope: float = 3.436
    curvature: float = 48.0
    push: float = 0.3125


SHAPE = Shape()


@joined
def larger(one, other):
    """Return the larger of two numbers, in one instruction."""
    return one if one > other else other


@joined
def size(y, kind):
    """Return the size of a value."""
    return y if kind == RAISED else abs(y)


# Without NaN and signed zeros the compiler vectorises the maximum.
@numba.njit(**INGREDIENT, fastmath={"nnan", "nsz"})
def highest(y, begin, end, kind):
    """Return the largest size of the values from `begin` to before `end`."""
    top = size(y[begin], kind)
    for i in range(begin + 1, end):
        top = larger(size(y[i], kind), top)
    return top


@joined
def _velocity(p, i, h):
    """Return the coefficients of the velocity from sample i to the next, except the middle one.

    c_0 = v_i, c_1 = v_i + h a_i / 6 and c_2 = v_i + h a_i / 3 + h^2 j_i / 30. The coefficients c_6,
    c_5 and c_4 follow in the same way from the other end, with -h in place of h. The middle one,
    c_3, follows from (c_0 + ... + c_6) / 7 = (u_{i+1} - u_i) / h.

    ======  ===========================================  ====
    symbol  meaning                                      name
    ======  ===========================================  ====
    u, v    displacement and velocity at the samples     p[U], p[V]
    a, j    acceleration and jerk at the samples         p[A], p[J]
    h       time between two samples                     h
    c_k     coefficients in Bernstein form               c1 ... c5
    ======  ===========================================  ====
    """
    c1 = p[V, i] + h * (1 / 6) * p[A, i]
    c2 = p[V, i] + h * (1 / 3) * p[A, i] + h * h * (1 / 30) * p[J, i]
    c4 = p[V, i + 1] - h * (1 / 3) * p[A, i + 1] + h * h * (1 / 30) * p[J, i + 1]
    c5 = p[V, i + 1] - h * (1 / 6) * p[A, i + 1]
    return c1, c2, c4, c5


@compiled
def bound(p, kind, h):
    """Compute middle coefficients, errors and bounds on sizes, in vectorised loops."""
    last = p.shape[1] - 1
    for i in range(last):
        c1, c2, c4, c5 = _velocity(p, i, h)
        # The mean of all seven coefficients is the displacement over h.
        others = p[V, i] + c1 + c2 + c4 + c5 + p[V, i + 1]
        p[MIDDLE, i] = (p[U, i + 1] - p[U, i]) * (7 / h) - others
    # The integral of the shape is 1, so the error of a displacement is h / height times as large.
    factor = 1.0 if kind == VELOCITY else h / SHAPE.height
    for i in range(last):
        # The middle coefficient of the quintic through v, a and j, raised by one degree.
        quintic = (p[V, i] + p[V, i + 1]) / 2 + h * (1 / 5) * (p[A, i] - p[A, i + 1])
        quintic += h * h * (1 / 40) * (p[J, i] + p[J, i + 1])
        missed = SHAPE.safety * SHAPE.height / 7 * abs(p[MIDDLE, i] - quintic)
        p[ERROR, i] = factor * (missed + SHAPE.push * h * p[DOUBT, i])
    before = p[ERROR, 0]
    # A misfit may vanish by chance, so the misfits of the neighbours are included.
    for i in range(last):
        here = p[ERROR, i]
        p[ERROR, i] = larger(larger(before, here), p[ERROR, min(i + 1, last - 1)])
        before = here
    if kind == VELOCITY:
        for i in range(last):
            c1, c2, c4, c5 = _velocity(p, i, h)
            inner = larger(larger(abs(c1), abs(c2)), larger(abs(c4), abs(c5)))
            ends = larger(abs(p[V, i]), abs(p[V, i + 1]))
            p[REACH, i] = larger(larger(inner, abs(p[MIDDLE, i])), ends)
        return
    w = h * (1 / 7)
    for i in range(last):
        c1, c2, c4, c5 = _velocity(p, i, h)
        # Each coefficient of the displacement adds one of the velocity; the last one is the end
        # value.
        d1 = p[U, i] + w * p[V, i]
        d2 = d1 + w * c1
        d3 = d2 + w * c2
        d4 = d3 + w * p[MIDDLE, i]
        d5 = d4 + w * c4
        d6 = d5 + w * c5
        inner = larger(larger(abs(d1), abs(d2)), larger(abs(d3), abs(d4)))
        ends = larger(abs(p[U, i]), abs(p[U, i + 1]))
        p[REACH, i] = larger(larger(inner, ends), larger(abs(d5), abs(d6)))


@compiled
def differentiate(c, count, out):
    """Compute the coefficients of the derivative of a polynomial with `count` coefficients."""
    for k in range(count - 1):
        out[k] = (count - 1) * (c[k + 1] - c[k])


@compiled
def fill_polynomial(p, kind, h, i, work):
    """Fill in a polynomial after sample i and its derivative; return its coefficient count."""
    c = work[C]
    c1, c2, c4, c5 = _velocity(p, i, h)
    c[0] = p[V, i]
    c[1] = c1
    c[2] = c2
    c[3] = p[MIDDLE, i]
    c[4] = c4
    c[5] = c5
    c[6] = p[V, i + 1]
    if kind == VELOCITY:
        differentiate(c, 7, work[D])
        return 7
    y = p[U, i]
    for k in range(7):
        speed = h * c[k]
        work[D, k] = speed
        c[k] = y
        y += speed * (1 / 7)
    c[7] = y
    return 8


@compiled
def value(c, count, s):
    """Return the value of a polynomial with `count` coefficients at a place."""
    degree = count - 1
    power = s
    y = c[0] * (1 - s)
    for k in range(1, degree):
        y = (y + BINOMIALS[degree, k] * power * c[k]) * (1 - s)
        power *= s
    return y + power * c[degree]


@compiled
def _changes(c, count):
    """Return the number of sign changes of the coefficients; 0 counts as positive."""
    changes = 0
    for k in range(1, count):
        changes += (c[k] < 0.0) != (c[k - 1] < 0.0)
    return changes


@compiled
def _root(c, count):
    """Return the root of a polynomial with one sign change of its coefficients; overwrite `c`."""
    degree = count - 1
    first = c[0]
    last = c[degree]
    if first == last:
        return 0.0
    # Powers of s are evaluated faster.
    for order in range(1, count):
        for k in range(degree, order - 1, -1):
            c[k] -= c[k - 1]
    for k in range(1, degree):
        c[k] *= BINOMIALS[degree, k]
    low = 0.0
    high = 1.0
    s = first / (first - last)
    for _ in range(60):
        y = c[degree]
        steep = 0.0
        for k in range(degree - 1, -1, -1):
            steep = steep * s + y
            y = y * s + c[k]
        if (y > 0.0) == (last > first):
            high = s
        else:
            low = s
        # Newton's step, or bisection if Newton's step leaves the bracket.
        following = s - y / steep if steep != 0.0 else low
        if not low < following < high:
            following = (low + high) / 2
        # Convergence is quadratic: the next change would be below 1e-16.
        if abs(following - s) < 1e-12:
            return following
        s = following
    return s


@compiled
def roots(c, count, places, work):
    """Fill in the places where a polynomial changes sign, in order; return their number."""
    for k in range(count):
        work[PIECES, k] = c[k]
    work[PIECES, BEGIN] = 0.0
    work[PIECES, WIDTH] = 1.0
    waiting = PIECES
    found = 0
    # Halve the polynomial until each piece has at most one root.
    while waiting >= PIECES:
        right = work[waiting]
        changes = _changes(right, count)
        small = right[WIDTH] < 2.0**-HALVINGS
        if changes > 1 and not small:
            right[WIDTH] /= 2
            left = work[waiting + 1]
            # De Casteljau's algorithm.
            for step in range(count):
                left[step] = right[0]
                for k in range(count - 1 - step):
                    right[k] = (right[k] + right[k + 1]) / 2
            # The left half goes on top of the stack, so that roots are found in order.
            left[BEGIN] = right[BEGIN]
            left[WIDTH] = right[WIDTH]
            right[BEGIN] += right[WIDTH]
            waiting += 1
            continue
        if changes % 2 == 1:
            places[found] = right[BEGIN] + right[WIDTH] * _root(right, count)
            found += 1
        waiting -= 1
    return found


def scratch() -> Array:
    """Return the work array of `follow`."""
    return np.zeros((PIECES + HALVINGS + 2, WIDTH + 1))
