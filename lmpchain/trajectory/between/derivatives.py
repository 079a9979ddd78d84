"""Acceleration and jerk of grains at the samples of their motion, compiled."""

from __future__ import annotations

import math

import numba
import numpy as np

from ...util.arrays import MAGNITUDE
from ...util.compilation import compiled_once

NEWS = "the measures", 20  # what is compiled, and about how long that takes, s
STILL, UNKNOWN = -1, -2  # columns of bodies that stand still, or were not recorded
# of the jump of the jerk times an interval, by which accelerations may be off where a contact opens or closes; with it
# and CURVED, errors of values, slopes and curvatures are bounds for all exponents: tests/trajectory/test_between.py
KINK = 0.12
HIDDEN = 2.0  # and of the change of velocity in a collision between two samples, over the interval
SIDE_BY_SIDE = 8  # columns that are read together: a cache line
compiled = numba.njit(error_model="numpy")


@compiled
def _pull(r, rate, length, strength, pressed, exponent, linear):
    """Return the change of a contact's force and its rate, for a change r of the overlap."""
    s = r * length
    if linear:
        return strength * exponent * s, strength * exponent * length * rate
    y = max(pressed + s, 0.0)
    if y == 0.0:
        return -strength * pressed, 0.0
    change = math.expm1(exponent * math.log1p(s)) if pressed > 0.0 else y**exponent
    return strength * change, strength * exponent * y ** (exponent - 1.0) * length * rate


@compiled
def _at_rest(r, closing):
    """Return how many samples go by before a contact feels anything."""
    count = 0
    while count < r.size and r[count] == 0.0 and closing[count] == 0.0:
        count += 1
    return count


@compiled
def _hertz(r, closing, length, strength, pressed, h, force, rate):
    """Fill in what `_pull` returns for exponent 3/2, (T,) each.

    Return at how many samples it is so near to opening, or open, that it may have done so in an interval beside.
    """
    near = 0
    for i in range(r.size):
        s = r[i] * length
        y = pressed + s
        near += y <= h * length * abs(closing[i])
        y = y if y > 0.0 else 0.0
        root = math.sqrt(y)
        full = y * root
        closed = s * (3.0 + 3.0 * s + s * s) / (1.0 + full)  # no digit of a weak wave is lost
        change = closed if (pressed > 0.0) & (y > 0.0) else full - pressed
        force[i] = strength * change
        rate[i] = strength * 1.5 * length * root * closing[i]
    return near


@compiled
def _visits(one, other, rise, climb):
    """Say whether tangents at both ends, where values have one sign, meet beyond zero."""
    if rise == climb:
        return False
    s = (other - climb - one) / (rise - climb)
    return 0.0 < s < 1.0 and (one + rise * s > 0.0) != (one > 0.0)


@compiled
def _kinks(r, closing, length, pressed, rate, mass, h, unsure):
    """Raise how far off a force is, (T,), where a contact opens or closes between two samples."""
    before, rose = 0.0, 0.0  # overlap and its rate, in `length`
    for i in range(r.size):
        y, rise = pressed + r[i] * length, closing[i] * length
        changed = (y > 0.0) != (before > 0.0)
        if i > 0 and (changed or _visits(before, y, h * rose, h * rise)):
            jump = KINK * h * abs(rate[i] - rate[i - 1])
            turned = (y > 0.0 and rise < 0.0) or (
                before > 0.0 and rose > 0.0
            )  # it was closer in between
            if turned if changed else y <= 0.0:
                jump = max(jump, HIDDEN * mass * abs(closing[i] - closing[i - 1]) / h)
            unsure[i - 1], unsure[i] = max(unsure[i - 1], jump), max(unsure[i], jump)
        before, rose = y, rise


@compiled
def _quintic(u, v, h, k, s):
    """Return a and j at k + s of the quintic through the samples k - 1, k and k + 1."""
    above, below = u[k + 1] - u[k], u[k - 1] - u[k]
    # u - u[k] = v[k] h t + c2 t^2 + ... + c5 t^5, t from -1 to 1
    even, odd = (above + below) / 2, (above - below) / 2 - h * v[k]
    steep, bent = h * (v[k + 1] - v[k - 1]) / 4, h * ((v[k + 1] + v[k - 1]) / 2 - v[k])
    c2, c4 = 2 * even - steep, steep - even
    c3, c5 = (5 * odd - bent) / 2, (bent - 3 * odd) / 2
    a = (2 * c2 + 6 * c3 * s + 12 * c4 * s**2 + 20 * c5 * s**3) / h**2
    return a, (6 * c3 + 24 * c4 * s + 60 * c5 * s**2) / h**3


@compiled
def _differences(u, v, h, a, j, off):
    """Fill a, j and how far off a is, (T,) each, from the quintics through three samples."""
    last = u.size - 1
    if last < 3:
        a[:], j[:], off[:] = 0.0, 0.0, math.inf
        return
    for i in range(last + 1):
        k = min(max(i, 1), last - 1)
        a[i], j[i] = _quintic(u, v, h, k, float(i - k))
        before, after = max(k - 1, 1), min(k + 1, last - 1)
        one, _ = _quintic(u, v, h, before, float(i - before))
        other, _ = _quintic(u, v, h, after, float(i - after))
        off[i] = max(abs(one - a[i]), abs(other - a[i]))


@compiled
def _transposed(field, columns, out):
    """Fill out, (G, T), with these columns of a field, (T, C); some at a time, for the sake of the cache."""
    for first in range(0, columns.size, SIDE_BY_SIDE):
        some = columns[first : first + SIDE_BY_SIDE]
        for i in range(field.shape[0]):
            for g in range(some.size):
                out[first + g, i] = field[i, some[g]]


@compiled
def _derivatives(grains, sides, contacts, inverse_mass, exponent, linear, h, known, quiet, out):
    """Fill out, (5, G, T), whose first two are given; see `derivatives`."""
    still = np.zeros(out.shape[2])
    r, closing, force, rate, unsure = np.empty((5, out.shape[2]))
    there, near = -1, 0  # of the contact that these are of, which the next grain shares
    for g in range(sides.shape[0]):
        x, w, a, j, off = out[0, g], out[1, g], out[2, g], out[3, g], out[4, g]
        if quiet[g]:
            a[:], j[:], off[:] = 0.0, 0.0, 0.0
            continue
        if not known[g]:
            _differences(x, w, h, a, j, off)
            continue
        a[:], j[:], off[:] = 0.0, 0.0, 0.0
        for side in (0, 2):
            contact, column, up = grains[g] + side // 2 - 1, sides[g, side], 1.0 - side
            constant, strength, overlap = contacts[:, contact]
            if strength == 0.0 and (constant == 0.0 or (linear and exponent > 1.0)):
                continue
            if contact != there:
                ux = still if column == STILL else out[0, column]
                vx = still if column == STILL else out[1, column]
                for i in range(r.size):
                    r[i], closing[i] = up * (ux[i] - x[i]), up * (vx[i] - w[i])
                length, pressed = (1.0 / overlap, 1.0) if strength > 0.0 else (1.0, 0.0)
                strength = strength if strength > 0.0 else constant
                if exponent == 1.5 and not linear:
                    rests = _at_rest(r, closing) if pressed > 0.0 else 0
                    force[:rests], rate[:rests] = 0.0, 0.0
                    felt = r[rests:], closing[rests:]
                    near = _hertz(*felt, length, strength, pressed, h, force[rests:], rate[rests:])
                else:
                    near = 0 if linear else r.size
                    for i in range(r.size):
                        force[i], rate[i] = _pull(
                            r[i], closing[i], length, strength, pressed, exponent, linear
                        )
                there = contact
                if near > 0:
                    above = inverse_mass[contact - 1] if contact > 0 else 0.0
                    below = inverse_mass[contact] if contact < inverse_mass.size else 0.0
                    unsure[:] = 0.0
                    _kinks(r, closing, length, pressed, rate, 1.0 / (above + below), h, unsure)
            share = up * inverse_mass[grains[g] - 1]
            for i in range(r.size):
                a[i] += share * force[i]
                j[i] += share * rate[i]
            if near > 0:
                for i in range(r.size):
                    off[i] = max(off[i], abs(share) * unsure[i])


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def largest(u, v):
    """Return the largest sizes in two (T, C) fields; NaN where any is no number.

    Returns
    -------
    sizes, moves : (2, C) array, (C,) bool
        In each column, and whether that is not 0 in both.
    most : pair of float
        In each field.
    """
    out, moves = np.zeros((2, u.shape[1]), dtype=np.int64), np.zeros(u.shape[1], dtype=np.bool_)
    # the bits of what is no number are above all others; many are done at a time
    for k, field in enumerate((u.view(np.int64), v.view(np.int64))):
        for i in range(field.shape[0]):
            for n in range(field.shape[1]):
                size = field[i, n] & MAGNITUDE
                out[k, n] = size if size > out[k, n] else out[k, n]
    most = np.zeros(2, dtype=np.int64)
    for n in range(moves.size):
        moves[n] = out[0, n] | out[1, n] != 0
        most[0], most[1] = max(most[0], out[0, n]), max(most[1], out[1, n])
    farthest, fastest = most.view(np.float64)
    return out.view(np.float64), moves, (farthest, fastest)


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def derivatives(
    u, v, columns, sizes, errors, grains, sides, contacts, inverse_mass, exponent, linear, h, known
):
    """Return the motion of G grains with accelerations and jerks, and which of them are quiet.

    Parameters
    ----------
    u, v : (T, C) arrays
        Displacement and velocity of what was recorded.
    columns : (G,) array
        Which of these are of the G grains.
    sizes : (2, C) array
        Largest displacement and speed in each column.
    errors : pair of float
        Up to which nothing more is asked of a grain: it is quiet.
    grains : (G,) array
        Their numbers.
    sides : (G, 3) array
        Place among the G grains of the body above, the grain and the body below, or a mark.
    contacts : (3, N+1) array
        Constant, and force and overlap at rest, of all contacts of the chain.
    inverse_mass : (N,) array
        Of all grains; 0 of one that is held.
    exponent, linear, h : float, bool and float
        Of the force; whether it is linearised; time between two samples.
    known : (C,) array
        Whether these forces are all that act; if not, acceleration and jerk follow from the samples.

    Returns
    -------
    motion : (5, G, T) array
        Displacement, velocity, acceleration, jerk, and error of the acceleration.
    quiet : (G,) bool
    """
    out, quiet = np.empty((5, columns.size, u.shape[0])), np.empty(columns.size, dtype=np.bool_)
    _transposed(u, columns, out[0])
    _transposed(v, columns, out[1])
    for g in range(columns.size):
        quiet[g] = sizes[0, columns[g]] <= errors[0] and sizes[1, columns[g]] <= errors[1]
    _derivatives(
        grains, sides, contacts, inverse_mass, exponent, linear, h, known[columns], quiet, out
    )
    return out, quiet
