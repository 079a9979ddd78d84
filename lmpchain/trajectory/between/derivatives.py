"""Acceleration and jerk of grains at the samples of their motion, compiled."""

from __future__ import annotations

import math

import numba
import numpy as np

from ...util.compilation import compiled_once

NEWS = "the measures", 20  # what is compiled, and about how long that takes, s
STILL, UNKNOWN = -1, -2  # columns of bodies that stand still, or were not recorded
# of the jump of the jerk times an interval, by which accelerations may be off where a contact opens or closes; with it
# and CURVED, values, slopes and curvatures are off by less than is said for all exponents from 1 to 3
KINK = 0.12
HIDDEN = 2.0  # and of the change of velocity in a collision between two samples, over the interval
compiled = numba.njit(error_model="numpy")
_total = numba.njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})


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
def _add_hertz(x, w, ux, vx, up, length, strength, pressed, share, h, a, j):
    """Add what a contact of exponent 3/2 gives to acceleration and jerk, (T,) each.

    Return at how many samples it is so near to opening, or open, that it may have done so in an interval beside.
    """
    near = 0
    for i in range(x.size):
        s = up * (ux[i] - x[i]) * length
        y = pressed + s
        near += y <= h * length * abs(vx[i] - w[i])
        y = y if y > 0.0 else 0.0
        root = math.sqrt(y)
        full = y * root
        closed = s * (3.0 + 3.0 * s + s * s) / (1.0 + full)  # no digit of a weak wave is lost
        change = closed if (pressed > 0.0) & (y > 0.0) else full - pressed
        a[i] += share * strength * change
        j[i] += share * strength * 1.5 * length * root * up * (vx[i] - w[i])
    return near


@compiled
def _visits(one, other, rise, climb):
    """Say whether tangents at both ends, where values have one sign, meet beyond zero."""
    if rise == climb:
        return False
    s = (other - climb - one) / (rise - climb)
    return 0.0 < s < 1.0 and (one + rise * s > 0.0) != (one > 0.0)


@compiled
def _kinks(x, w, ux, vx, up, length, strength, pressed, exponent, share, h, off):
    """Raise how far off the acceleration is, (T,), where a contact opens or closes between two samples."""
    before, rose = 0.0, 0.0  # overlap and its rate, in `length`
    for i in range(x.size):
        y, rise = pressed + up * (ux[i] - x[i]) * length, up * (vx[i] - w[i]) * length
        if i > 0 and ((y > 0.0) != (before > 0.0) or _visits(before, y, h * rose, h * rise)):
            _, rate = _pull(y - pressed, rise, 1.0, strength, pressed, exponent, False)
            _, other = _pull(before - pressed, rose, 1.0, strength, pressed, exponent, False)
            jump = KINK * h * abs(share * (rate - other))
            if y <= 0.0 and before <= 0.0:
                jump = HIDDEN * abs(rise - rose) / (length * h)
            off[i - 1], off[i] = max(off[i - 1], jump), max(off[i], jump)
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
def _largest(y):
    most = 0.0
    for value in y:
        most = max(most, abs(value))
    return most


@compiled
def _derivatives(u, v, grains, sides, contacts, inverse_mass, exponent, linear, h, known, error, out, quiet):
    """Fill out, (5, G, T), and quiet, (G,); see `derivatives`."""
    still = np.zeros(u.shape[0])
    columns_u, columns_v = np.ascontiguousarray(u.T), np.ascontiguousarray(v.T)
    for g in range(sides.shape[0]):
        own = sides[g, 1]
        x, w, a, j, off = out[0, g], out[1, g], out[2, g], out[3, g], out[4, g]
        x[:], w[:] = columns_u[own], columns_v[own]
        quiet[g] = _largest(w) <= error[1] and _largest(x) <= error[0]
        if quiet[g]:
            a[:], j[:], off[:] = 0.0, 0.0, 0.0
            continue
        if not known[g]:
            _differences(x, w, h, a, j, off)
            continue
        a[:], j[:], off[:] = 0.0, 0.0, 0.0
        for side in (0, 2):
            constant, strength, overlap = contacts[:, grains[g] + side // 2 - 1]
            pressed, length = 1.0, 1.0
            if strength > 0.0:
                length = 1.0 / overlap
            else:
                pressed, strength = 0.0, 0.0 if linear and exponent > 1.0 else constant
            if strength == 0.0:
                continue
            column, up = sides[g, side], 1.0 - side
            share = up * inverse_mass[grains[g] - 1]
            ux = still if column == STILL else columns_u[column]
            vx = still if column == STILL else columns_v[column]
            if exponent == 1.5 and not linear:
                near = _add_hertz(x, w, ux, vx, up, length, strength, pressed, share, h, a, j)
            else:
                near = 0 if linear else x.size
                for i in range(x.size):
                    r, closing = up * (ux[i] - x[i]), up * (vx[i] - w[i])
                    force, rate = _pull(r, closing, length, strength, pressed, exponent, linear)
                    a[i] += share * force
                    j[i] += share * rate
            if near > 0:
                _kinks(x, w, ux, vx, up, length, strength, pressed, exponent, share, h, off)


@_total
def _sizes(u, v):
    one = other = total = 0.0
    for i in range(u.size):
        one = max(one, abs(u[i]))
        other = max(other, abs(v[i]))
        total += u[i] + v[i]
    return one, other, total


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def largest(u, v):
    """Return the largest size of two (T, C) fields; no number if any of theirs is none."""
    one, other, total = _sizes(u.ravel(), v.ravel())
    return one + 0.0 * total, other + 0.0 * total


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def derivatives(u, v, grains, sides, contacts, inverse_mass, exponent, linear, h, known, error):
    """Return displacement, velocity, acceleration, jerk and error of acceleration, (5, G, T).

    Also which of them are quiet, (G,).

    Parameters
    ----------
    u, v : (T, C) arrays
        Displacement and velocity of what was recorded.
    grains : (G,) array
        Their numbers.
    sides : (G, 3) array
        Columns of the body above, the grain and the body below, or a mark.
    contacts : (3, N+1) array
        Constant, and force and overlap at rest, of all contacts of the chain.
    inverse_mass : (N,) array
        Of all grains; 0 of one that is held.
    exponent, linear, h : float, bool and float
        Of the force; whether it is linearised; time between two samples.
    known : (G,) array
        Whether these forces are all that act; if not, acceleration and jerk follow from the samples.
    error : (2,) array
        Displacement and velocity up to which a grain is quiet, so that nothing more is asked of it.
    """
    out, quiet = np.empty((5, sides.shape[0], u.shape[0])), np.zeros(sides.shape[0], dtype=np.bool_)
    _derivatives(u, v, grains, sides, contacts, inverse_mass, exponent, linear, h, known, error, out, quiet)
    return out, quiet
