"""The force of a contact, compiled: its forms, and the two loops that are made of each.

Every form gives the force minus what the contact carries at rest, ``strength f(r / length)``, where
``r = phi_n - phi_(n+1)`` is how much closer the two bodies are than at rest. `base` is the overlap at rest over the
length: 1, or 0 where nothing is pressed (length 1 m, strength K).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# no reordering and no contraction but the explicit fma: every blocking of the loops gives the same bits
STRICT = {"nnan", "ninf", "nsz"}
NEWS = "the native engine", 20  # what is compiled when it runs for the first time, and about how long that takes, s
_inline: Any = intrinsic  # to a type checker it takes the arguments of the compiled function
compiled = numba.njit(error_model="numpy", fastmath=STRICT)


@_inline
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""
    return types.float64(types.float64, types.float64, types.float64), lambda _c, builder, _s, args: builder.fma(*args)


@_inline
def bits(typing: Any, x: Any) -> Any:
    """Return the bits of a number as a whole number."""
    return types.int64(types.float64), lambda _c, builder, _s, args: builder.bitcast(args[0], ir.IntType(64))


@_inline
def number(typing: Any, n: Any) -> Any:
    """Return the number with these bits."""
    return types.float64(types.int64), lambda _c, builder, _s, args: builder.bitcast(args[0], ir.DoubleType())


MANTISSA, ONE = (1 << 52) - 1, 1023 << 52
SHIFT = float(3 << 51)  # adding it rounds to a whole number, which the last bits then hold
SHIFT_BITS = int(np.float64(SHIFT).view(np.int64))
EXPONENT = float((1 << 52) + 1023)
EXPONENT_BITS = int(np.float64(1 << 52).view(np.int64))
LN2_HIGH, LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10  # their sum is ln 2 to 33 more digits


@compiled
def _log(y, rest):
    """Return log(y + rest) of y > 0 and a tiny rest, by the series of artanh; no branch, no table."""
    held = bits(y)
    power = number(EXPONENT_BITS | (held >> 52)) - EXPONENT
    m = number((held & MANTISSA) | ONE)
    high = m > 1.4142135623730951
    m = 0.5 * m if high else m
    power = power + 1.0 if high else power
    f = (m - 1.0) / (m + 1.0)
    q = f * f
    p = fma(q, fma(q, fma(q, fma(q, 2 / 21, 2 / 19), 2 / 17), 2 / 15), 2 / 13)
    p = q * fma(q, fma(q, fma(q, fma(q, fma(q, p, 2 / 11), 2 / 9), 2 / 7), 2 / 5), 2 / 3)
    return fma(power, LN2_HIGH, fma(power, LN2_LOW, fma(f, p, rest / y)) + 2.0 * f)


@compiled
def _exp(t, less):
    """Return exp(t) - less, less being 0 or 1, for |t| < 700: powers of two times a Taylor series around 0."""
    whole = fma(t, 1.4426950408889634, SHIFT)
    scale = number((bits(whole) - SHIFT_BITS + 1023) << 52)
    whole -= SHIFT
    r = fma(-whole, LN2_LOW, fma(-whole, LN2_HIGH, t))
    p = fma(
        r,
        fma(r, fma(r, fma(r, fma(r, 1 / 6227020800, 1 / 479001600), 1 / 39916800), 1 / 3628800), 1 / 362880),
        1 / 40320,
    )
    p = fma(r, fma(r, fma(r, fma(r, fma(r, p, 1 / 5040), 1 / 720), 1 / 120), 1 / 24), 1 / 6)
    p = fma(r * r, fma(r, p, 0.5), r)
    return fma(scale, p, scale - less)


@compiled
def _corrected(r, inverse_length, strength, base, shape):
    """delta = 3/2 without cancellation: relative accuracy at any amplitude for one square root."""
    s = r * inverse_length
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    u = fma(0.5, fma(-u, u, fma(-2.0, u, s)), u)  # gives back the digits that 1 + s lost
    return (strength * u) * fma(u, 3.0 + u, 3.0)


@compiled
def _polynomial(r, inverse_length, strength, base, shape):
    """Any delta while |s| is small enough for seven terms of the binomial series; no contact may open."""
    s = r * inverse_length
    p = fma(s, fma(s, fma(s, shape[6], shape[5]), shape[4]), shape[3])
    return (strength * s) * fma(s, fma(s, fma(s, p, shape[2]), shape[1]), shape[0])


@compiled
def _spring(r, inverse_length, strength, base, shape):
    """delta = 1: linear until the contact opens."""
    s = r * inverse_length
    return strength * (s if s > -base else -base)


@compiled
def _power(r, inverse_length, strength, base, shape):
    """Any delta without cancellation."""
    s = r * inverse_length
    inside = s if s > -1.0 else 0.0
    y = 1.0 + inside
    held = _exp(shape[7] * _log(y, inside - (y - 1.0)), 1.0)
    return strength * (held if s > -1.0 else -1.0)


@compiled
def _loose_power(r, inverse_length, strength, base, shape):
    """Any delta where nothing is pressed."""
    y = r if r > 1e-90 else 1.0
    held = _exp(shape[7] * _log(y, 0.0), 0.0)
    return strength * held if r > 1e-90 else 0.0


def _roots(quarters: int) -> Callable[..., Any]:
    """Return the force for delta = quarters / 4 as y^delta - base, by square roots alone."""
    whole, half, quarter = quarters // 4, quarters % 4 // 2, quarters % 2

    @compiled
    def force(r, inverse_length, strength, base, shape):
        y = fma(r, inverse_length, base)
        y = y if y > 0.0 else 0.0
        held = strength
        for _ in range(whole):
            held = held * y
        root = math.sqrt(y) if half + quarter > 0 else 1.0
        rest = root if half > 0 else 1.0
        if quarter > 0:
            rest = rest * math.sqrt(root)
        return fma(held, rest, -(strength * base))

    return force


def _loops(force: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Make the two loops over contacts that are all there is to Eq. (1), for one form of the force."""

    @compiled
    def forces(out, x, inverse_length, strength, base, shape):
        """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
        for n in range(out.size):
            out[n] = force(x[n] - x[n + 1], inverse_length[n], strength[n], base, shape)

    @compiled
    def rows(x, v, inverse_length, strength, inverse_mass, kicks, drifts, carried, top, loose, base, shape, path):
        """Kick and drift all grains once a row, in place and in one pass: each contact's force is found once.

        x (G+2,) has a body more at either end than v (G,); contacts n = 0 ... G lie between x[n] and x[n+1]. The force
        on the first grain from above is that of contact 0 if it is the `top`, else the one in `carried` (rows,), where
        the force below the last grain is left for the part of the chain that follows.
        """
        for row in range(kicks.size):
            kick, drift = kicks[row], drifts[row]
            if path.size > 0 and top:
                x[1] = path[row]
            above = carried[row]
            if top:
                above = 0.0
                if strength[0] > 0.0:
                    above = force(x[0] - x[1], inverse_length[0], strength[0], base, shape)
                if loose > 0.0 and x[0] > x[1]:
                    above += loose * (x[0] - x[1]) ** shape[7]
            for n in range(v.size):
                below = force(x[n + 1] - x[n + 2], inverse_length[n + 1], strength[n + 1], base, shape)
                faster = fma(kick, inverse_mass[n] * (above - below), v[n])
                v[n] = faster
                x[n + 1] = fma(drift, faster, x[n + 1])
                above = below
            carried[row] = above

    return forces, rows


CORRECTED, POLYNOMIAL, SPRING, POWER, LOOSE_POWER = range(5)
ROOTS = (5, 6, 7, 8)  # forms of delta = quarters / 4
FORMS = {
    CORRECTED: "corrected square root",
    POLYNOMIAL: "polynomial",
    SPRING: "spring",
    POWER: "vectorised power",
    LOOSE_POWER: "vectorised power",
} | dict.fromkeys(ROOTS, "plain square roots")

_forces_corrected, _rows_corrected = _loops(_corrected)
_forces_polynomial, _rows_polynomial = _loops(_polynomial)
_forces_spring, _rows_spring = _loops(_spring)
_forces_power, _rows_power = _loops(_power)
_forces_loose, _rows_loose = _loops(_loose_power)
_forces_5, _rows_5 = _loops(_roots(5))
_forces_6, _rows_6 = _loops(_roots(6))
_forces_7, _rows_7 = _loops(_roots(7))
_forces_8, _rows_8 = _loops(_roots(8))


@compiled
def contact_forces(form, out, x, il, st, base, shape):
    """Fill out with the force of every contact, in the given form; see `_loops`."""
    if form == CORRECTED:
        _forces_corrected(out, x, il, st, base, shape)
    elif form == 6:
        _forces_6(out, x, il, st, base, shape)
    elif form == POLYNOMIAL:
        _forces_polynomial(out, x, il, st, base, shape)
    elif form == SPRING:
        _forces_spring(out, x, il, st, base, shape)
    elif form == POWER:
        _forces_power(out, x, il, st, base, shape)
    elif form == LOOSE_POWER:
        _forces_loose(out, x, il, st, base, shape)
    elif form == 5:
        _forces_5(out, x, il, st, base, shape)
    elif form == 7:
        _forces_7(out, x, il, st, base, shape)
    else:
        _forces_8(out, x, il, st, base, shape)


@compiled
def kick_and_drift(form, x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path):
    """Kick and drift, in the given form; see `_loops`."""
    if form == CORRECTED:
        _rows_corrected(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == 6:
        _rows_6(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == POLYNOMIAL:
        _rows_polynomial(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == SPRING:
        _rows_spring(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == POWER:
        _rows_power(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == LOOSE_POWER:
        _rows_loose(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == 5:
        _rows_5(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    elif form == 7:
        _rows_7(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
    else:
        _rows_8(x, v, il, st, im, kicks, drifts, carried, top, loose, base, shape, path)
