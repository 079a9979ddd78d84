"""One row, a kick and a drift, of a run and of its adjoint: the inner loops of `adjoint`, compiled.

The force of a contact and its derivatives are as explained there.
"""

from __future__ import annotations

import math
from typing import Any

import numba
from numba import types

from .contact_forces import _exp, _inline, _log

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"nnan", "ninf", "nsz", "contract"}, "_nrt": False}
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


def _there_by_root(exact: bool) -> Any:
    """Make the loop that kicks and drifts for delta = 3/2, with the digits of weak waves or without."""

    @_loop
    def there(x, v, inverse_length, strength, inverse_mass, kick, drift, above, c, power):
        """Kick and drift the bodies x (C+1,) but the last, as fast as v (C,), and keep p."""
        apart()
        for n in range(v.size):
            s = (x[n] - x[n + 1]) * inverse_length[n]
            s = s if s > -c else -c
            p = _hertz(s, c) if exact else math.sqrt(c + s) - c
            power[n] = p
            below = strength[n] * p * (3.0 * c + p * (3.0 * c + p))
            faster = v[n] + kick * inverse_mass[n] * (above - below)
            v[n] = faster
            x[n] += drift * faster
            above = below
        return above

    return there


_there_plain, _there_hertz = _there_by_root(False), _there_by_root(True)


@_loop
def _there_other(x, v, inverse_length, strength, inverse_mass, kick, drift, above, c, less, power, force):
    """Do the same for any delta, and keep f, too."""
    apart()
    for n in range(v.size):
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


def _back(undone: bool, kept: bool = False) -> Any:
    """Make the loop of the way back, with p found by undoing rows or kept, and f kept or following from p."""

    @_loop
    def back(
        x, v, adjoint_x, pull, stiff, strength, inverse_length, inverse_mass, kick, drift, before, c, power, force,
        sums_p, sums_f, sums_m,
    ):  # fmt: skip
        """Take adjoints of bodies back through a kick and the drift before it, and undo both.

        Contacts are (C,); v, adjoint_x and inverse masses those of the bodies above them, x and pull (C+1,), the
        adjoint of v over the mass, also of the one below. `before` and what is returned are x, f, pull and stiffness at
        either end.
        """
        apart()
        x_before, f_before, pull_before, g_before = before
        for n in range(adjoint_x.size):
            x_here, pull_here = x[n + 1] if undone else x_before, pull[n + 1]
            if undone:
                s = (x_before - x_here) * inverse_length[n]
                s = s if s > -c else -c
                root = math.sqrt(c + s)
                p = root - c
                f = strength[n] * (c + s) * root - strength[n] * c
            else:
                p = power[n]
                root = c + p
                f = force[n] if kept else strength[n] * p * (3.0 * c + p * (3.0 * c + p))
            push = kick * (f_before - f)
            if undone:
                slower = v[n] - inverse_mass[n] * push
                v[n] = slower
                x[n] = x_before - drift * slower
            y = kick * (pull_here - pull_before)  # the adjoint of the force
            g = stiff[n] * root * y
            sums_p[n] += y * p
            sums_f[n] += y * f
            sums_m[n] += pull_before * push
            by_x = adjoint_x[n] + (g - g_before)
            adjoint_x[n] = by_x
            pull[n] = pull_before + drift * inverse_mass[n] * by_x
            x_before, f_before, pull_before, g_before = x_here, f, pull_here, g
        return x_before, f_before, pull_before, g_before

    return back


_back_undone, _back_hertz, _back_other = _back(True), _back(False), _back(False, kept=True)
