"""A kick-drift splitting with what its derivatives need, its adjoint, and its tangent, compiled.

The force of contact n less that at rest is ``f = F [c s + c p + s p]`` with ``s = r / length`` and
``p = (c + s)^(delta-1) - c``, nothing where c + s < 0; c is 1 where the contact is pressed at rest (F its force then,
the length its overlap) and 0 where it only touches (F = K, length 1 m). Derivatives with respect to r, and to the force
at rest and the constant K of a pressed contact, follow from p and f without cancellation, for waves of any strength:

    df/dr = delta F (c + p) / length,     df/dF = p at fixed K,     df/dK = (f - c F p) / K at fixed F.

Rows (R,) of a leg are kicks and drifts in s: a kick, then a drift. Bodies x (N+2,) have a wall, or nothing, at either
end; contacts are n = 0 ... N. A driven grain 1 is where `path` (legs, R) says.
"""

from __future__ import annotations

import math
from typing import Any

import numba

from ...util.compilation import compiled_once
from .contact_forces import _exp, _log

HERTZ, OTHER = range(2)  # delta = 3/2, by a square root, or any
NEWS = "gradients of the native engine", 20
# each loop writes few enough arrays that the compiler can check that they do not overlap, and use vectors
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"nnan", "ninf", "nsz", "contract"}, "_nrt": False}
_loop = numba.njit(**_OPTIONS)


@_loop
def _hertz(x, inverse_length, strength, pressed, less, power, force):
    """Fill power and force (C,) of contacts between the bodies x (C+1,) for delta = 3/2."""
    for n in range(power.size):
        s = (x[n] - x[n + 1]) * inverse_length[n]
        s = s if s > -pressed else -pressed
        p = math.sqrt(pressed + s) - pressed
        p += 0.5 * pressed * ((s - 2.0 * p) - p * p)  # gives back the digits that 1 + s lost
        power[n] = p
        force[n] = strength[n] * (pressed * (s + p) + s * p)


@_loop
def _other(x, inverse_length, strength, pressed, less, power, force):
    """Fill power and force (C,) of contacts between the bodies x (C+1,); `less` is delta - 1."""
    for n in range(power.size):
        s = (x[n] - x[n + 1]) * inverse_length[n]
        shut = pressed + s > 1e-90
        inside = s if shut else 1.0 - pressed
        y = pressed + inside
        p = _exp(less * _log(y, inside - (y - pressed)), pressed)
        p = p if shut else -pressed
        s = s if shut else -pressed
        power[n] = p
        force[n] = strength[n] * (pressed * (s + p) + s * p)


@_loop
def _contacts(law, x, table, pressed, less, power, force):
    """Fill power and force (N+1,) of all contacts; contact 0 may only touch in a pressed chain."""
    inverse_length, strength = table[0], table[1]
    if law == HERTZ:
        _hertz(x[:2], inverse_length[:1], strength[:1], pressed[0], less, power[:1], force[:1])
        _hertz(x[1:], inverse_length[1:], strength[1:], pressed[1], less, power[1:], force[1:])
    else:
        _other(x[:2], inverse_length[:1], strength[:1], pressed[0], less, power[:1], force[:1])
        _other(x[1:], inverse_length[1:], strength[1:], pressed[1], less, power[1:], force[1:])


@_loop
def _move(x, v, inverse_mass, force, kick, drift):
    """Kick and drift the grains x and v (N,) by the forces (N+1,) between them."""
    for n in range(v.size):
        faster = v[n] + kick * inverse_mass[n] * (force[n] - force[n + 1])
        v[n] = faster
        x[n] += drift * faster


@_loop
def _drift_back(x, v, w, inverse_mass, kick, drift):
    """Take the adjoints x and v (N,) back through a drift; w (N,) is what the kick before makes of them."""
    for n in range(v.size):
        faster = v[n] + drift * x[n]
        v[n] = faster
        w[n] = kick * inverse_mass[n] * faster


@_loop
def _kick_back(x, w, stiff, power):
    """Take the adjoint x (N,) back through a kick of w (N+2,)."""
    rest, slope = stiff[0], stiff[1]
    above = (rest[0] + slope[0] * power[0]) * (w[1] - w[0])
    for n in range(x.size):
        below = (rest[n + 1] + slope[n + 1] * power[n + 1]) * (w[n + 2] - w[n + 1])
        x[n] += below - above
        above = below


@_loop
def _by_contact(by_power, by_force, w, power, force):
    for n in range(by_power.size):
        y = w[n + 1] - w[n]  # the adjoint of the force
        by_power[n] += y * power[n]
        by_force[n] += y * force[n]


@_loop
def _by_grain(by_mass, w, force):
    for n in range(by_mass.size):
        by_mass[n] += w[n] * (force[n] - force[n + 1])


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def forward(law, x, v, table, inverse_mass, pressed, less, kicks, drifts, path, legs, powers, forces, seen):
    """Move x and v by some legs, and keep p and f of every row if there is room.

    `seen` is (columns (G,), legs a look, the first leg, looks), with room for x and v of some grains, (2, looks, G).
    """
    columns, every, begun, looks = seen
    keep = powers.shape[0] > 1
    for leg in range(legs):
        for row in range(kicks.size):
            if path.size > 0:
                x[1] = path[leg, row]
            place = leg * kicks.size + row if keep else 0
            _contacts(law, x, table, pressed, less, powers[place], forces[place])
            _move(x[1:-1], v, inverse_mass, forces[place], kicks[row], drifts[row])
        if (begun + leg + 1) % every == 0:
            look = (begun + leg + 1) // every
            for column in range(columns.size):
                looks[0, look, column] = x[columns[column] + 1]
                looks[1, look, column] = v[columns[column]]


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def backward(x, v, w, stiff, inverse_mass, kicks, drifts, on_path, legs, powers, forces, seen, sums):
    """Take the adjoints x and v (N,) of displacement and velocity back through some legs.

    w (N+2,) is room for work, 0 at its ends; `stiff` is delta F c / length and delta F / length of every contact, and
    `seen` as in `forward`, with derivatives by what was seen. `sums` gathers (N+1,) of y p and y f, where y is the
    adjoint of the force of a contact, and (N,) of what a kick does by the mass.
    """
    columns, every, begun, looks = seen
    by_power, by_force, by_mass = sums
    for leg in range(legs - 1, -1, -1):
        if (begun + leg + 1) % every == 0:
            look = (begun + leg + 1) // every
            for column in range(columns.size):
                x[columns[column]] += looks[0, look, column]
                v[columns[column]] += looks[1, look, column]
        for row in range(kicks.size - 1, -1, -1):
            power, force = powers[leg * kicks.size + row], forces[leg * kicks.size + row]
            _drift_back(x, v, w[1:-1], inverse_mass, kicks[row], drifts[row])
            _kick_back(x, w, stiff, power)
            _by_contact(by_power, by_force, w, power, force)
            _by_grain(by_mass, w[1:-1], force)
            if on_path.size > 0:
                on_path[leg, row] = x[0]
                x[0] = 0.0


@_loop
def _force_change(df, dx, slope, power, by_force, soften, by_constant):
    for n in range(df.size):
        df[n] = slope[n] * (dx[n] - dx[n + 1]) + power[n] * by_force[n] + soften[n] * by_constant[n]


@_loop
def _move_change(dx, dv, inverse_mass, df, force, by_mass, kick, drift):
    for n in range(dv.size):
        faster = dv[n] + kick * inverse_mass[n] * (df[n] - df[n + 1] - (force[n] - force[n + 1]) * by_mass[n])
        dv[n] = faster
        dx[n] += drift * faster


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def tangent(law, x, v, work, table, inverse_mass, pressed, less, kicks, drifts, path, legs, change, dx, dv, seen):
    """Move x and v, and D small changes dx (D, N+2) and dv (D, N) of them, by some legs.

    `work` is (5, N+1). `change` is delta F c / length and delta F / length of every contact (2, N+1), its constant and
    what it carries at rest (N+1,), and directions: relative masses (D, N), constants and forces at rest (D, N+1), path
    (D, legs, R).
    """
    columns, every, begun, looks = seen
    stiff, constant, carried, by_mass, by_constant, by_force, by_path = change
    power, force, slope, soften, df = work[0], work[1], work[2], work[3], work[4]
    for leg in range(legs):
        for row in range(kicks.size):
            if path.size > 0:
                x[1] = path[leg, row]
            _contacts(law, x, table, pressed, less, power, force)
            for n in range(force.size):
                slope[n] = stiff[0, n] + stiff[1, n] * power[n]
                soften[n] = (force[n] - carried[n] * power[n]) / constant[n] if constant[n] > 0.0 else 0.0
            for d in range(dx.shape[0]):
                if path.size > 0:
                    dx[d, 1] = by_path[d, leg, row]
                _force_change(df, dx[d], slope, power, by_force[d], soften, by_constant[d])
                _move_change(dx[d, 1:-1], dv[d], inverse_mass, df, force, by_mass[d], kicks[row], drifts[row])
            _move(x[1:-1], v, inverse_mass, force, kicks[row], drifts[row])
        if (begun + leg + 1) % every == 0:
            look = (begun + leg + 1) // every
            for column in range(columns.size):
                for d in range(dx.shape[0]):
                    looks[d, 0, look, column] = dx[d, columns[column] + 1]
                    looks[d, 1, look, column] = dv[d, columns[column]]
