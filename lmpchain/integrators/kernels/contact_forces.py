"""Compiled contact force: its forms, and the loops for each form.

Every form computes the force of a contact minus its force at rest, ``strength f(r / length)``. The
approach ``r = phi_n - phi_(n+1)`` is the change of the overlap since rest, m. In a compressed chain
the length is the overlap at rest, the strength is the force at rest, N, and `precompressed` is 1.
In a chain without compression, the length is 1 m, the strength is K, and `precompressed` is 0.
`coefficients` contains the first seven coefficients of the binomial series of (1 + s)^delta - 1,
and delta. A law that is given by a formula reads column `n` of `given` instead: the overlap at
rest, K, the parameters of the law, and numbers from which it computes the force at rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
from numba import types

from .compiling import (
    STRICT,
    address_of,
    caller,
    compiled,
    compiled_filler,
    compiled_formula,
    exponential,
    fma,
    inlined,
    logarithm,
    select,
)
from .layout import Links, Rows

# Indices are unsigned, because signed indices are checked for counting from the end, which prevents
# vectorisation.
unsigned = np.uint64


@compiled
def _corrected(r, inverse_length, strength, precompressed, coefficients, given, n):
    """Return the force for delta = 3/2 by one square root, accurate at any amplitude."""
    s = r * inverse_length
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    # One step of Newton's method restores the digits that 1 + s has lost.
    u = fma(0.5, fma(-u, u, fma(-2.0, u, s)), u)
    return (strength * u) * fma(u, 3.0 + u, 3.0)


@compiled
def _polynomial(r, inverse_length, strength, precompressed, coefficients, given, n):
    """Return the force for any delta and small |s| by seven binomial terms; no contact may open."""
    s = r * inverse_length
    p = fma(s, fma(s, fma(s, coefficients[6], coefficients[5]), coefficients[4]), coefficients[3])
    return (strength * s) * fma(
        s, fma(s, fma(s, p, coefficients[2]), coefficients[1]), coefficients[0]
    )


@compiled
def _spring(r, inverse_length, strength, precompressed, coefficients, given, n):
    """Return the force for delta = 1: linear until the contact opens."""
    s = r * inverse_length
    return strength * (s if s > -precompressed else -precompressed)


@compiled
def _growth(s, exponent):
    """Return (1 + s)^exponent - 1 without cancellation; -1 for s < -1."""
    # An open contact is computed as one at rest, and the result is discarded, because a branch
    # would prevent vectorisation.
    inside = select(s > -1.0, s, 0.0)
    y = 1.0 + inside
    change = exponential(exponent * logarithm(y, inside - (y - 1.0)), 1.0)
    return select(s > -1.0, change, -1.0)


@compiled
def _power(r, inverse_length, strength, precompressed, coefficients, given, n):
    """Return the force for any delta without cancellation."""
    return strength * _growth(r * inverse_length, coefficients[7])


@compiled
def _uncompressed_power(r, inverse_length, strength, precompressed, coefficients, given, n):
    """Return the force for any delta in a chain without forces at rest."""
    # The logarithm of 0 must be avoided, and the force of such a small overlap is negligible.
    y = select(r > 1e-90, r, 1.0)
    power = exponential(coefficients[7] * logarithm(y, 0.0), 0.0)
    return select(r > 1e-90, strength * power, 0.0)


def _roots(quarters: int) -> Callable[..., Any]:
    """Return the force for delta = quarters / 4, y^delta - precompressed, by square roots only."""
    factors = quarters // 4
    half = quarters % 4 // 2
    quarter = quarters % 2

    @compiled
    def force(r, inverse_length, strength, precompressed, coefficients, given, n):
        y = fma(r, inverse_length, precompressed)
        y = y if y > 0.0 else 0.0
        product = strength
        for _ in range(factors):
            product = product * y
        root = math.sqrt(y) if half + quarter > 0 else 1.0
        fraction = root if half > 0 else 1.0
        if quarter > 0:
            fraction = fraction * math.sqrt(root)
        return fma(product, fraction, -(strength * precompressed))

    return force


@compiled
def _power_stiffness(r, change, inverse_length, strength, precompressed, coefficients, given, n):
    """Stiffness for any delta, computed from the change of the force."""
    y = r * inverse_length + precompressed
    # The force is K y^delta.
    secant = (change + strength * precompressed) / (y if y > 0.0 else 1.0)
    return coefficients[7] * secant * inverse_length if y > 0.0 else 0.0


@compiled
def touching(r, uncompressed, coefficients):
    """Return the force of a first contact that only touches in a compressed chain."""
    return uncompressed * r ** coefficients[7] if r > 0.0 else 0.0


@compiled
def touching_stiffness(r, force, coefficients):
    """Return the derivative of `touching`."""
    return coefficients[7] * force / r if r > 0.0 else 0.0


_ROW = types.float64[::1]
_LINKS = types.NamedTuple(
    [
        *(_ROW, _ROW, types.float64, types.int64, types.int64[::1], types.float64, _ROW),
        *(types.float64[:, ::1], types.int64),
    ],
    Links,
)
_ROWS = types.NamedUniTuple(_ROW, len(Rows._fields), Rows)
# Signatures of the loops of a form.
FORCES = types.void(_ROW, _ROW, _LINKS)
STIFFNESSES = types.void(_ROW, _ROW, _ROW, _LINKS)
_SAMPLES = types.float64[:]
SERIES = types.void(*(_SAMPLES, _SAMPLES, types.float64[:, ::1], types.int64, _SAMPLES, _SAMPLES))
_GIVEN = types.float64[:, ::1]
GROUND = types.void(_ROW, _ROW, _ROW, _GIVEN, types.int64, types.float64, types.float64)
SWEEP = types.void(_ROW, _ROW, _ROW, _LINKS, _ROWS, types.boolean, types.int64, types.boolean)


def _loops(kind: str, force: Callable[..., Any], stiffness: Callable[..., Any]) -> tuple[Any, ...]:
    """Create the loops over contacts that Eq. (1) needs, for one form of the force.

    The loops are compiled when a scene first needs the form, separately from the marches. The
    marches call the loops at the memory addresses that `addresses` returns.
    """
    kept = compiled_filler(fastmath=STRICT, kind=kind)

    @kept
    def forces(out, x, links):
        """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
        il = links.inverse_length
        st = links.strength
        pressed = links.precompressed
        given = links.parameters
        first = links.first
        for n in range(out.size):
            out[n] = force(
                x[n] - x[n + 1],
                il[n],
                st[n],
                pressed,
                links.coefficients,
                given,
                unsigned(first + n),
            )

    @kept
    def stiffnesses(out, change, x, links):
        """Fill out (C,) with the stiffness of every contact, N/m, given the change of its force."""
        il = links.inverse_length
        st = links.strength
        pressed = links.precompressed
        given = links.parameters
        first = links.first
        for n in range(out.size):
            r = x[n] - x[n + 1]
            out[n] = stiffness(
                r, change[n], il[n], st[n], pressed, links.coefficients, given, unsigned(first + n)
            )

    @kept
    def sweep_rows(x, v, inverse_mass, links, rows, top, body, forced):
        """Kick and drift all grains once per row in a single pass that computes each force once.

        The displacements x (G+2,) include one more body at either end than the velocities v (G,).
        Contact n = 0 ... G connects the bodies x[n] and x[n+1]. If `top` is true, the force on the
        first grain from above is the force of contact 0. Otherwise it is read from `rows.carried`.
        The force from below on the last grain is stored there for the next part of the chain.
        `rows.path` contains imposed values: forces on the body x[body] if `forced` is true,
        otherwise its displacements, which are used only if `top` is true.
        """
        il = links.inverse_length
        st = links.strength
        pressed = links.precompressed
        coefficients = links.coefficients
        given = links.parameters
        first = links.first
        for row in range(rows.kick.size):
            kick = rows.kick[row]
            drift = rows.drift[row]
            # The pushed body may be in a different tile.
            if rows.path.size > 0:
                if forced:
                    if 1 <= body <= v.size:
                        push = kick * inverse_mass[body - 1]
                        v[body - 1] = fma(push, rows.path[row], v[body - 1])
                elif top:
                    x[body] = rows.path[row]
            above = rows.carried[row]
            if top:
                above = 0.0
                if st[0] > 0.0:
                    above = force(
                        x[0] - x[1], il[0], st[0], pressed, coefficients, given, unsigned(first)
                    )
                if links.uncompressed > 0.0:
                    above += touching(x[0] - x[1], links.uncompressed, coefficients)
            # A kick uses the forces at one time: a grain moves after both of its contacts are
            # computed.
            for n in range(v.size):
                closer = x[n + 1] - x[n + 2]
                contact = unsigned(first + n + 1)
                below = force(closer, il[n + 1], st[n + 1], pressed, coefficients, given, contact)
                faster = fma(kick, inverse_mass[n] * (above - below), v[n])
                v[n] = faster
                x[n + 1] = fma(drift, faster, x[n + 1])
                above = below
            rows.carried[row] = above

    return forces, sweep_rows, stiffnesses


class Form(IntEnum):
    """Forms of the contact force; numbers 5 to 8 belong to the forms of ROOTS."""

    CORRECTED = 0
    POLYNOMIAL = 1
    SPRING = 2
    POWER = 3
    UNCOMPRESSED_POWER = 4

    FORMULAS = 9


ROOTS = range(5, 9)  # Forms of delta = quarters / 4.
# These forms subtract two forces, and lose digits below an ulp of the force at rest.
PLAIN = tuple(ROOTS)
FORMS: dict[int, tuple[str, Callable[..., Any]]] = {
    Form.CORRECTED: ("corrected square root", _corrected),
    Form.POLYNOMIAL: ("polynomial", _polynomial),
    Form.SPRING: ("spring", _spring),
    Form.POWER: ("vectorised power", _power),
    Form.UNCOMPRESSED_POWER: ("vectorised power", _uncompressed_power),
} | {form: ("plain square roots", _roots(form)) for form in ROOTS}
LOOPS = {
    form: _loops(str(int(form)), force, _power_stiffness) for form, (_, force) in FORMS.items()
}


# Functions that formulas of laws may call.
FUNCTIONS = {
    "maximum": compiled_formula(lambda a, b: select(a > b, a, b)),
    "minimum": compiled_formula(lambda a, b: select(a < b, a, b)),
    "absolute": abs,
    "select": select,
    "growth": _growth,
    "__name__": __name__,
} | {key: getattr(math, key) for key in ("sqrt", "exp", "log", "sin", "cos", "tanh")}
FUNCTIONS |= {"expm1": math.expm1, "log1p": math.log1p}


def _identity(*functions: Callable[..., Any]) -> str:
    """Return a hash of the code of formulas, by which their loops are cached."""
    codes = [function.__code__ for function in functions]
    content = [(code.co_code, code.co_consts, code.co_names) for code in codes]
    return sha256(repr(content).encode()).hexdigest()


@cache
def _loops_of(kernel: Any) -> tuple[Any, ...]:
    """Create the loops of a law by formula, and its loop over samples (see `change_in_time`)."""
    arguments = "r, given, n", FUNCTIONS, kernel.codes
    change_of = kernel.force_change.function(*arguments)
    stiffness_of = kernel.stiffness.function(*arguments)
    force_at = compiled_formula(change_of)
    stiffness_at = compiled_formula(stiffness_of)
    kind = _identity(change_of, stiffness_of)

    @compiled
    def force(r, inverse_length, strength, precompressed, coefficients, given, n):
        return force_at(r, given, n)

    @compiled
    def stiffness(r, change, inverse_length, strength, precompressed, coefficients, given, n):
        return stiffness_at(r, given, n)

    @compiled_filler(kind=kind)
    def series(r, closing, given, n, change, rate):
        for i in range(r.size):
            change[i] = force_at(r[i], given, n)
            rate[i] = stiffness_at(r[i], given, n) * closing[i]

    return *_loops(kind, force, stiffness), series


@cache
def addresses(form: int, law: Any = None) -> tuple[int, ...]:
    """Return the memory addresses of the compiled loops of a form.

    The loops of a law that is given by a formula depend on the `Law`, and include a loop over
    samples.
    """
    loops = LOOPS[form] if law is None else _loops_of(law.kernel)
    signatures = FORCES, SWEEP, STIFFNESSES, SERIES
    return tuple(address_of(*pair) for pair in zip(loops, signatures, strict=False))


@cache
def _ground_loop_of(kernel: Any) -> Any:
    """Create the loop over bodies for the force of a ground law."""
    force_of = kernel.force.function("u, t, given, n", FUNCTIONS, kernel.codes)
    force_at = compiled_formula(force_of)

    @compiled_filler(kind=_identity(force_of))
    def pull_back(pull, x, inverse_mass, given, first, t, length):
        for n in range(pull.size):
            pull[n] -= length * inverse_mass[n] * force_at(x[n], t, given, first + n)

    return pull_back


def address_of_ground(kernel: Any) -> int:
    """Return the memory address of the compiled loop of a ground force."""
    return address_of(_ground_loop_of(kernel), GROUND)


_call_ground = caller(GROUND)
_call_forces = caller(FORCES)
_call_sweep = caller(SWEEP)
_call_stiffnesses = caller(STIFFNESSES)
_call_series = caller(SERIES)


@inlined
def contact_forces(links, out, x):
    """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
    _call_forces(links.loops[0], (out, x, links))


@inlined
def kick_and_drift(links, x, v, inverse_mass, rows, top, body, forced):
    """Kick and drift all grains once per row (see `sweep_rows`)."""
    _call_sweep(links.loops[1], (x, v, inverse_mass, links, rows, top, body, forced))


@inlined
def pull_to_rest(address, pull, x, inverse_mass, given, first, t, length):
    """Subtract the ground's accelerations at time t, for bodies x (B,), from accelerations (B,).

    For a kick, `pull` contains velocities, and `length` is the length of the kick, s; for
    accelerations, `length` is 1. `first` is the column of the first body in `given`, see
    `BatchArrays.ground_parameters`.
    """
    _call_ground(address, (pull, x, inverse_mass, given, first, t, length))


@inlined
def contact_stiffnesses(links, out, change, x):
    """Fill out (C,) with the stiffness of every contact between the bodies x (C+1,), N/m.

    `change` (C,) contains the results of `contact_forces` for these bodies, N.
    """
    _call_stiffnesses(links.loops[2], (out, change, x, links))


@inlined
def change_in_time(address, r, closing, given, n, change, rate):
    """Fill the changes of the force of one contact, N, and their rates, N/s, at (R,) samples.

    The law must be given by a formula. The changes `r` of the overlap since rest, m, and their
    rates `closing`, m/s, are (R,) arrays. `n` is the column of the contact in `given`, see
    `Links.parameters`.
    """
    _call_series(address, (r, closing, given, n, change, rate))
