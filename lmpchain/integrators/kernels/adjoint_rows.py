"""One row, a kick and a drift, of a run and of its adjoint: the inner loops of `adjoint`, compiled.

The force of a contact and its derivatives are as explained there.
"""

from __future__ import annotations

import math
from typing import Any

import numba
from numba import types

from .contact_forces import _exp, _inline, _log

_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"nnan", "ninf", "nsz", "contract"},
    "_nrt": False,
}
_loop = numba.njit(**_OPTIONS)


@_inline
def apart(typing: Any) -> Any:
    """Tell the compiler that no two arrays that a function takes overlap."""

    def mark(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        for arg in builder.function.args[2:]:
            if arg.type.is_pointer:
                arg.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), mark


@_inline
def at(typing: Any, array: Any, n: Any) -> Any:
    """Return where number n of an array lies, which takes less time to pass on than a slice."""

    def place(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.gep(
            context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]]
        )

    return types.CPointer(array.dtype)(array, types.intp), place


@_loop
def _hertz(s, c):
    """Return p for delta = 3/2, with the digits that 1 + s loses."""
    p = math.sqrt(c + s) - c
    return p + 0.5 * c * ((s - 2.0 * p) - p * p)


@_loop
def _other(s, c, less):
    """Return p for any delta; `less` is delta - 1."""
    shut = c + s > 1e-90
    inside = s if shut else 1.0 - c
    y = c + inside
    p = _exp(less * _log(y, inside - (y - c)), c)
    return p if shut else -c


def _there_by_root(exact: bool, vacuum: bool = False) -> Any:
    """Make the loop of kick and drift for delta = 3/2: with the digits of weak waves, or c = 0."""

    @_loop
    def there(count, x, v, inverse_length, strength, inverse_mass, kick, drift, above, c, power):
        """Kick and drift C = `count` bodies x (C+1,), as fast as v (C,), and keep p."""
        apart()
        for n in range(count):
            s = x[n] - x[n + 1]
            if vacuum:
                s = s if s > 0.0 else 0.0
                p = math.sqrt(s)
                below = strength[n] * s * p
            else:
                s *= inverse_length[n]
                s = s if s > -c else -c
                p = _hertz(s, c) if exact else math.sqrt(c + s) - c
                below = strength[n] * p * (3.0 * c + p * (3.0 * c + p))
            power[n] = p
            faster = v[n] + kick * inverse_mass[n] * (above - below)
            v[n] = faster
            x[n] += drift * faster
            above = below
        return above

    return there


_there_plain, _there_hertz = _there_by_root(False), _there_by_root(True)
_there_vacuum = _there_by_root(False, True)


@_loop
def _there_other(
    count, x, v, inverse_length, strength, inverse_mass, kick, drift, above, c, less, power, force
):
    """Do the same for any delta, and keep f, too."""
    apart()
    for n in range(count):
        s = (x[n] - x[n + 1]) * inverse_length[n]
        s = s if s > -c else -c
        p = _other(s, c, less)
        power[n] = p
        below = strength[n] * (c * (s + p) + s * p)
        force[n] = below
        faster = v[n] + kick * inverse_mass[n] * (above - below)
        v[n] = faster
        x[n] += drift * faster
        above = below
    return above


# how p and f are found on the way back
PLAINLY, EXACTLY, BY_SERIES, BY_SHORT_SERIES, KEPT_VACUUM, KEPT, BOTH_KEPT = range(7)


def _back(how: int) -> Any:
    """Make the loop of the way back, with p found by undoing rows or kept, and f kept or following from p."""
    undone = how <= BY_SHORT_SERIES

    @_loop
    def back(
        span, x, momentum, adjoint_x, pull, stiff, strength, inverse_length, inverse_mass, kicks, drifts, fs, gs, c,
        terms, powers, forces, kept, width, sums_p, sums_f, sums_m,
    ):  # fmt: skip
        """Take adjoints of bodies back through some rows, each a kick and the drift before it, and undo these.

        A contact has the place of the body above it in x, momenta, adjoint_x, pull, the adjoint of v over the mass, and
        inverse masses. `span` is the last row and how many, from which contact to which it goes, by how many places
        each row before begins and ends earlier, and whether it begins at the top. `kicks`, `drifts` before them and, at
        the begin and then the end of a span, the impulse of f and what its adjoint does to x are by row; what is kept
        is (rows, width) from `kept` on. `terms` are those of a polynomial, p over s.
        """
        apart()
        last, rows, first, stop, sooner, shorter, top = span
        t0, t1, t2, t3 = terms[0], terms[1], terms[2], terms[3]
        t4, t5 = (terms[4], terms[5]) if how == BY_SERIES else (0.0, 0.0)
        for row in range(last, last - rows, -1):
            kick, drift, f_before, g_before = kicks[row], drifts[row], fs[row], gs[row]
            if top:  # nothing moves what is outside
                pull[first], f_before, g_before = 0.0, 0.0, 0.0
            for n in range(first, stop):
                closer = pull[n + 1] - pull[n]
                impulse = kick * strength[n]
                if how != KEPT_VACUUM:
                    at_rest = stiff[n] * (kick * closer)
                if undone:
                    s = (x[n] - x[n + 1]) * inverse_length[n]
                    if how == BY_SHORT_SERIES:
                        p = s * (t0 + s * (t1 + s * (t2 + s * t3)))
                    elif how == BY_SERIES:
                        square = s * s
                        p = s * ((t0 + s * t1) + square * ((t2 + s * t3) + square * (t4 + s * t5)))
                    else:
                        s = s if s > -1.0 else -1.0
                    linear = impulse * s
                    if how == PLAINLY:
                        root = math.sqrt(1.0 + s)
                        p = root - 1.0
                        f = (impulse + linear) * root - impulse
                    else:
                        if how == EXACTLY:
                            p = _hertz(s, 1.0)
                        f = linear + (impulse + linear) * p
                    push = f_before - f
                    slower = momentum[n] - push
                    momentum[n] = slower
                    x[n] -= drift * inverse_mass[n] * slower
                else:
                    p = powers[kept + n]
                    if how == BOTH_KEPT:
                        f = kick * forces[kept + n]
                    elif how == KEPT:
                        f = impulse * p * (3.0 * c + p * (3.0 * c + p))
                    else:
                        weight = impulse * p
                        f = weight * (p * p)
                    push = f_before - f
                if (
                    how == KEPT_VACUUM
                ):  # there, no force at rest asks for a sum over p, and lengths are 1 m
                    g = (1.5 * closer) * weight
                else:
                    sums_p[n] += at_rest * p
                    weight = at_rest if undone else c * at_rest
                    g = at_rest * root if how == PLAINLY else weight + at_rest * p
                sums_f[n] += closer * f
                sums_m[n] += pull[n] * push
                by_x = (adjoint_x[n] + g) - g_before
                adjoint_x[n] = by_x
                pull[n] += drift * inverse_mass[n] * by_x
                f_before, g_before = f, g
            fs[row], gs[row] = f_before, g_before
            first, stop, kept = first - sooner, stop - shorter, kept - width

    return back


_back_plain, _back_exact = _back(PLAINLY), _back(EXACTLY)
_back_series, _back_short_series = _back(BY_SERIES), _back(BY_SHORT_SERIES)
_back_vacuum, _back_hertz, _back_other = _back(KEPT_VACUUM), _back(KEPT), _back(BOTH_KEPT)
