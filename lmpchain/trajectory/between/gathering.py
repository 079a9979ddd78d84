"""Largest values and wave fronts, gathered interval by interval as a run goes on, compiled.

An interval is looked at once the sample behind the next one is known: with four samples around it, as in `hermite`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .derivatives import KINK, _pull
from .hermite import (
    BUMP,
    PARTS,
    RAISED,
    STEEPEST,
    VELOCITY,
    compiled,
    larger,
    path,
    polynomial,
    size,
    sure_bend,
    turns,
    value,
)

NEWS = "what gathers", 8
AROUND = 4  # samples around an interval
# of the second differences at both ends of an interval: above what a value may exceed those at its ends by, an eighth
SLACK = 0.25
EVEN = 8.0  # times the middle of three differences is at least the sum of the others where nothing turns; 26 for cubics
BEST, LOW, HIGH = range(
    3
)  # rows of `tops`: the largest value at any time, and between what it lies
# of the largest value so far of a grain: when, that, how far off, slope of that error, curvature (0 if that is unsure),
# least value since, and until when it is of that size within its error
WHEN, TOP, OFF, TILT, BEND, SINCE, UNTIL = range(7)
ROWS = UNTIL + 1
FELL = 1e-12  # of a largest value, by which a later value must be less before it is a maximum and no rounding


class Forces(NamedTuple):
    """What acts on N grains: contacts, and what is imposed at R samples.

    Attributes
    ----------
    contacts : (3, N+1) array
        1 / length, strength and 1 if pressed at rest (else 0) of every contact.
    inverse_mass : (N,) array
        1/kg; 0 of what is held.
    exponent, linear : float and bool
        Of the force, and whether it is linearised.
    wall : (4, R) array
        Displacement, velocity, acceleration and jerk of the top wall.
    given : (3, R) array
        Acceleration and jerk of a grain from outside; how far off that, or of the wall, may be behind each sample.
    pushed : int
        Which grain, from 0, or -1.
    driven : bool
        Whether that is all that it moves by.
    """

    contacts: Array
    inverse_mass: Array
    exponent: float
    linear: bool
    wall: Array
    given: Array
    pushed: int
    driven: bool


@compiled
def _motion(u, v, first, count, n, h, forces, out):
    """Fill out, (5, AROUND), with the motion of a body, counted from 0, or -1 of the top wall.

    That is displacement, velocity, acceleration, jerk and how far off the acceleration is.
    """
    x, w, a, j, off = out[0], out[1], out[2], out[3], out[4]
    last = u.shape[1] - 1
    off[:] = 0.0
    before, rates = np.zeros(2, np.bool_), np.zeros(2)
    for i in range(count):
        row = first + i
        a[i], j[i] = 0.0, 0.0
        if n > last:
            x[i], w[i] = 0.0, 0.0
            continue
        if n < 0:
            x[i], w[i], a[i], j[i] = forces.wall[:, row]
            if i + 1 < count:
                off[i], off[i + 1] = max(off[i], forces.given[2, row]), forces.given[2, row]
            continue
        x[i], w[i] = u[row, n], v[row, n]
        if n == forces.pushed:
            a[i], j[i] = forces.given[0, row], forces.given[1, row]
            if i + 1 < count:
                off[i], off[i + 1] = max(off[i], forces.given[2, row]), forces.given[2, row]
            if forces.driven:
                continue
        for side in range(2):
            length, strength, pressed = forces.contacts[:, n + side]
            share = (1 - 2 * side) * forces.inverse_mass[n]
            if strength == 0.0 or share == 0.0:
                continue
            other = n - 1 + 2 * side
            ux = forces.wall[0, row] if other < 0 else (0.0 if other > last else u[row, other])
            vx = forces.wall[1, row] if other < 0 else (0.0 if other > last else v[row, other])
            r, closing = (1 - 2 * side) * (ux - x[i]), (1 - 2 * side) * (vx - w[i])
            force, rate = _pull(
                r, closing, length, strength, pressed, forces.exponent, forces.linear
            )
            a[i] += share * force
            j[i] += share * rate
            closed = pressed + r * length > 0.0
            if (
                i > 0 and closed != before[side] and not forces.linear
            ):  # the jerk jumps in between, or nearly so
                jump = KINK * h * abs(share * (rate - rates[side]))
                off[i - 1], off[i] = max(off[i - 1], jump), max(off[i], jump)
            before[side], rates[side] = closed, rate


@compiled
def _near(f, k, first, last, low, marks):
    """Raise what values reach at least to sample k + 1; mark where they may turn above that; count these.

    Rows of f, (R, N), are known from first to last. Four samples that go one way, and evenly, have no turn between.
    """
    one, other = f[k], f[k + 1]
    before, after = f[larger(k - 1, first)], f[k + 2 if k + 2 < last else last]
    count = 0
    for n in range(marks.size):
        x, y = one[n], other[n]
        here, there, on = x - before[n], y - x, after[n] - y
        top = larger(abs(x), abs(y))
        turning = (
            (here * there <= 0.0) | (there * on <= 0.0) | (EVEN * abs(there) <= abs(here + on))
        )
        near = turning & (top + SLACK * (abs(there - here) + abs(on - there)) > low[n])
        low[n] = larger(low[n], abs(y))
        marks[n] = near
        count += near
    return count


@compiled
def _raise(p, i, tops, n):
    """Let the largest value of n know of the interval i."""
    ends = larger(size(value(p.c, 0.0), p.kind), size(value(p.c, 1.0), p.kind))
    top = ends
    for k in range(turns(p)):
        top = larger(top, size(value(p.c, p.places[k]), p.kind))
    tops[BEST, n] = larger(tops[BEST, n], top)
    tops[LOW, n] = larger(tops[LOW, n], larger(ends, top - p.error[i]))
    tops[HIGH, n] = larger(tops[HIGH, n], top + p.error[i])


@compiled
def _rise(p, i, t, record, n, log, logged):
    """Let the front of grain n know of the interval i from time t on; return how many maxima are logged."""
    h, begins = p.h, abs(value(p.c, 0.0))
    count = turns(p)
    for k in range(count + 1):  # the end counts where a turn falls on it
        s = p.places[k] if k < count else 1.0
        now = abs(value(p.c, s))
        if now < record[TOP, n]:
            record[SINCE, n] = min(record[SINCE, n], now)
            continue
        if record[SINCE, n] < (1.0 - FELL) * record[TOP, n]:
            log[logged, 0] = n
            for m in range(record.shape[0]):
                log[logged, 1 + m] = record[m, n]
            logged += 1
        bend = 0.0
        if k < count:
            bend = larger(sure_bend(p, s, now, p.error[i]), 0.0) / h**2
        if bend == 0.0 and now > 0.0:  # in free flight, maybe: the maximum is where that began
            same = (
                record[SINCE, n] >= (1.0 - FELL) * record[TOP, n]
                and begins <= (1.0 + FELL) * record[TOP, n]
            )
            if same and now <= begins + p.error[i]:
                continue
            s = 0.0 if begins >= (1.0 - FELL) * now else s
        record[WHEN, n], record[TOP, n], record[OFF, n] = t + s * h, now, p.error[i]
        record[TILT, n], record[BEND, n], record[SINCE, n] = (
            STEEPEST / BUMP * p.error[i] / h,
            bend,
            now,
        )
        record[UNTIL, n] = record[WHEN, n]
    return logged


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def gather(
    u, v, base, begin, end, final, h, forces, far, fast, record, log, logged, numbers, closest
):
    """Take in the intervals begin ... end - 1, and return how many of them and how many maxima are logged.

    It stops early where `log` may overflow.

    Parameters
    ----------
    u, v : (R, N) arrays
        Samples from the one of number `base` on: at least from the one before `begin` to the one after `end`, if there
        are such.
    base, begin, end, final : int
        Numbers of samples, the last of all of them `final`.
    h : float
        s from one to the next.
    forces : Forces
    far, fast : (3, N) or (3, 0) arrays
        See BEST ... HIGH: of displacements and speeds, if they are asked for. LOW begins with those at t = 0.
    record : (7, N) or (7, 0) array
        See WHEN ... UNTIL: of speeds, if the front is asked for; with `fast`.
    log : (L, 8) array
        Maxima that others have followed: grain, and what `record` said of them.
    logged : int
        How many these are.
    numbers : (C,) array
        Contacts, whose
    closest : (3, C) array
        approach beyond that at rest is gathered as `far` is.
    """
    motion, beside = np.zeros((5, 1, AROUND)), np.zeros((5, AROUND))
    reach, error = np.empty(AROUND - 1), np.empty(AROUND - 1)
    c, d, places, nothing = np.zeros(8), np.zeros(8), np.zeros(PARTS), np.zeros((1, 0))
    marks = np.zeros(u.shape[1], np.bool_)
    for k in range(begin, end):
        first, last = max(k - 1, 0) - base, min(k + 2, final) - base
        count, i = last - first + 1, k - base - first
        part = motion[:, :, :count]
        for kind in range(2):  # VELOCITY, DISPLACEMENT
            tops, f = (fast, v) if kind == VELOCITY else (far, u)
            fronts = kind == VELOCITY and record.shape[1] > 0
            some = _near(f, k - base, first, last, tops[LOW], marks) if tops.shape[1] else 0
            if fronts and logged + (PARTS + 1) * some > log.shape[0]:
                return k - begin, logged
            for n in range(marks.size if some else 0):
                if marks[n]:
                    _motion(u, v, first, count, n, h, forces, part[:, 0])
                    p = path(
                        part,
                        0,
                        h,
                        kind,
                        nothing,
                        reach[: count - 1],
                        error[: count - 1],
                        c,
                        d,
                        places,
                    )
                    polynomial(p, i)
                    _raise(p, i, tops, n)
                    if fronts:
                        logged = _rise(p, i, k * h, record, n, log, logged)
            if fronts:
                row, least = v[k + 1 - base], record[SINCE]
                for n in range(marks.size):
                    least[n] = abs(row[n]) if abs(row[n]) < least[n] else least[n]
                    if least[n] >= record[TOP, n] - 2.0 * record[OFF, n]:
                        record[UNTIL, n] = (k + 1) * h
        for m in range(numbers.size):
            _motion(u, v, first, count, numbers[m] - 1, h, forces, part[:, 0])
            _motion(u, v, first, count, numbers[m], h, forces, beside[:, :count])
            for q in range(5):
                for r in range(count):
                    part[q, 0, r] += beside[q, r] if q == 4 else -beside[q, r]
            p = path(
                part, 0, h, RAISED, nothing, reach[: count - 1], error[: count - 1], c, d, places
            )
            polynomial(p, i)
            _raise(p, i, closest, m)
    return end - begin, logged
