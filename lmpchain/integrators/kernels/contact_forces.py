"""The force of a contact, compiled: its forms, and the two loops that are made of each.

Every form gives the force minus what the contact carries at rest, ``strength f(r / length)``, where
``r = phi_n - phi_(n+1)`` is how much closer the two bodies are than at rest. `precompressed` is the overlap at rest
over the length: 1, or 0 where nothing is pressed (length 1 m, strength K). `coefficients` are the first seven of the
binomial series of (1 + s)^delta - 1, and delta.
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
NEWS = (
    "the native engine",
    20,
)  # what is compiled when it runs for the first time, and about how long that takes, s
_inline: Any = intrinsic  # to a type checker it takes the arguments of the compiled function

# without numba's runtime: such functions make no arrays and count no references, which would take half of the time
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": STRICT, "_nrt": False}
compiled = numba.njit(**_OPTIONS)
inlined = numba.njit(**_OPTIONS, inline="always")


@_inline
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""
    return types.float64(
        types.float64, types.float64, types.float64
    ), lambda _c, builder, _s, args: builder.fma(*args)


@_inline
def bits(typing: Any, x: Any) -> Any:
    """Return the bits of a number as a whole number."""
    return types.int64(types.float64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.IntType(64)
    )


@_inline
def number(typing: Any, n: Any) -> Any:
    """Return the number with these bits."""
    return types.float64(types.int64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.DoubleType()
    )


MANTISSA, ONE = (1 << 52) - 1, 1023 << 52
SHIFT = float(3 << 51)  # adding it rounds to a whole number, which the last bits then hold
SHIFT_BITS = int(np.float64(SHIFT).view(np.int64))
EXPONENT = float((1 << 52) + 1023)
EXPONENT_BITS = int(np.float64(1 << 52).view(np.int64))
LN2_HIGH, LN2_LOW = (
    0.6931471803691238,
    1.9082149292705877e-10,
)  # their sum is ln 2 to 33 more digits


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
    """Return exp(t) - less, less being 0 or 1, for |t| < 700, by powers of two and a Taylor series."""
    whole = fma(t, 1.4426950408889634, SHIFT)
    scale = number((bits(whole) - SHIFT_BITS + 1023) << 52)
    whole -= SHIFT
    r = fma(-whole, LN2_LOW, fma(-whole, LN2_HIGH, t))
    p = fma(
        r,
        fma(
            r,
            fma(r, fma(r, fma(r, 1 / 6227020800, 1 / 479001600), 1 / 39916800), 1 / 3628800),
            1 / 362880,
        ),
        1 / 40320,
    )
    p = fma(r, fma(r, fma(r, fma(r, fma(r, p, 1 / 5040), 1 / 720), 1 / 120), 1 / 24), 1 / 6)
    p = fma(r * r, fma(r, p, 0.5), r)
    return fma(scale, p, scale - less)


@compiled
def _corrected(r, inverse_length, strength, precompressed, coefficients):
    """delta = 3/2 without cancellation: relative accuracy at any amplitude for one square root."""
    s = r * inverse_length
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    u = fma(0.5, fma(-u, u, fma(-2.0, u, s)), u)  # gives back the digits that 1 + s lost
    return (strength * u) * fma(u, 3.0 + u, 3.0)


@compiled
def _polynomial(r, inverse_length, strength, precompressed, coefficients):
    """Any delta while |s| is small enough for seven terms of the binomial series; no contact may open."""
    s = r * inverse_length
    p = fma(s, fma(s, fma(s, coefficients[6], coefficients[5]), coefficients[4]), coefficients[3])
    return (strength * s) * fma(
        s, fma(s, fma(s, p, coefficients[2]), coefficients[1]), coefficients[0]
    )


@compiled
def _spring(r, inverse_length, strength, precompressed, coefficients):
    """delta = 1: linear until the contact opens."""
    s = r * inverse_length
    return strength * (s if s > -precompressed else -precompressed)


@compiled
def _power(r, inverse_length, strength, precompressed, coefficients):
    """Any delta without cancellation."""
    s = r * inverse_length
    inside = s if s > -1.0 else 0.0
    y = 1.0 + inside
    held = _exp(coefficients[7] * _log(y, inside - (y - 1.0)), 1.0)
    return strength * (held if s > -1.0 else -1.0)


@compiled
def _uncompressed_power(r, inverse_length, strength, precompressed, coefficients):
    """Any delta where nothing is pressed."""
    y = r if r > 1e-90 else 1.0
    held = _exp(coefficients[7] * _log(y, 0.0), 0.0)
    return strength * held if r > 1e-90 else 0.0


def _roots(quarters: int) -> Callable[..., Any]:
    """Return the force for delta = quarters / 4 as y^delta - precompressed, by square roots alone."""
    whole, half, quarter = quarters // 4, quarters % 4 // 2, quarters % 2

    @compiled
    def force(r, inverse_length, strength, precompressed, coefficients):
        y = fma(r, inverse_length, precompressed)
        y = y if y > 0.0 else 0.0
        held = strength
        for _ in range(whole):
            held = held * y
        root = math.sqrt(y) if half + quarter > 0 else 1.0
        rest = root if half > 0 else 1.0
        if quarter > 0:
            rest = rest * math.sqrt(root)
        return fma(held, rest, -(strength * precompressed))

    return force


@compiled
def touching(r, uncompressed, coefficients):
    """Return the force of a first contact that only touches, in a chain that is pressed otherwise."""
    return uncompressed * r ** coefficients[7] if r > 0.0 else 0.0


def _loops(force: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Make the two loops over contacts that are all there is to Eq. (1), for one form of the force."""

    @compiled
    def forces(out, x, inverse_length, strength, precompressed, coefficients):
        """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
        for n in range(out.size):
            out[n] = force(
                x[n] - x[n + 1], inverse_length[n], strength[n], precompressed, coefficients
            )

    @compiled
    def rows(
        x, v, inverse_length, strength, inverse_mass, kicks, drifts, carried,
        top, uncompressed, precompressed, coefficients, path, place, forced,
    ):  # fmt: skip
        """Kick and drift all grains once a row, in place and in one pass: each contact's force is found once.

        x (G+2,) has a body more at either end than v (G,); contacts n = 0 ... G lie between x[n] and x[n+1]. The force
        on the first grain from above is that of contact 0 if it is the `top`, else the one in `carried` (rows,), where
        the force below the last grain is left for the part of the chain that follows. `path` (rows,), if it has any,
        is where the body x[place] of the `top` is, or a force on it if it is `forced` and among those that move.
        """
        for row in range(kicks.size):
            kick, drift = kicks[row], drifts[row]
            if path.size > 0:
                if forced:
                    if 1 <= place <= v.size:
                        v[place - 1] = fma(kick * inverse_mass[place - 1], path[row], v[place - 1])
                elif top:
                    x[place] = path[row]
            above = carried[row]
            if top:
                above = 0.0
                if strength[0] > 0.0:
                    above = force(
                        x[0] - x[1], inverse_length[0], strength[0], precompressed, coefficients
                    )
                if uncompressed > 0.0:
                    above += touching(x[0] - x[1], uncompressed, coefficients)
            for n in range(v.size):
                below = force(
                    x[n + 1] - x[n + 2],
                    inverse_length[n + 1],
                    strength[n + 1],
                    precompressed,
                    coefficients,
                )
                faster = fma(kick, inverse_mass[n] * (above - below), v[n])
                v[n] = faster
                x[n + 1] = fma(drift, faster, x[n + 1])
                above = below
            carried[row] = above

    return forces, rows


CORRECTED, POLYNOMIAL, SPRING, POWER, UNCOMPRESSED_POWER = range(5)
ROOTS = (5, 6, 7, 8)  # forms of delta = quarters / 4
FORMS: dict[int, tuple[str, Callable[..., Any]]] = {
    CORRECTED: ("corrected square root", _corrected),
    POLYNOMIAL: ("polynomial", _polynomial),
    SPRING: ("spring", _spring),
    POWER: ("vectorised power", _power),
    UNCOMPRESSED_POWER: ("vectorised power", _uncompressed_power),
} | {form: ("plain square roots", _roots(form)) for form in ROOTS}
LOOPS = {form: _loops(force) for form, (_, force) in FORMS.items()}


def _by_form(loops: dict[int, Callable[..., None]]) -> Callable[..., None]:
    """Make the function of a form, and of what its loop takes, that runs the loop of that form."""
    *others, (_, last) = loops.items()

    @inlined
    def choose(form, arguments):
        last(*arguments)

    for one, loop in others:
        choose = _either(one, loop, choose)

    @compiled
    def run(form, *arguments):
        choose(form, arguments)

    return run


def _either(
    one: int, loop: Callable[..., None], choose: Callable[..., None]
) -> Callable[..., None]:
    """Make the function that runs a loop if the form is its own, and else looks further."""

    @inlined
    def either(form, arguments):
        if form == one:
            loop(*arguments)
        else:
            choose(form, arguments)

    return either


contact_forces = _by_form({form: forces for form, (forces, _) in LOOPS.items()})
kick_and_drift = _by_form({form: rows for form, (_, rows) in LOOPS.items()})
