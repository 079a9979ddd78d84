"""The equation of motion in displacements, compiled.

Every form of the contact force minus its equilibrium value is ``strength f(r / length)``, where
``r = phi_n - phi_(n+1)`` is how much closer the two grains are than at rest.
"""

from __future__ import annotations

import math

import numba
import numpy as np

CORRECTED = 0  # delta = 3/2 without cancellation: relative accuracy at any amplitude
PLAIN = 1  # delta = 3/2 as y sqrt(y) - 1: faster, loses the digits of very weak waves
SPRING = 2  # delta = 1: linear until the contact opens
POWER = 3  # any delta without cancellation
VACUUM = 4  # any delta without compression: length 1 m, strength K
FORMS = ("corrected square root", "plain square root", "spring", "expm1-log1p power", "plain power")

# no contraction and no reordering: every blocking of the loops gives the same bits
STRICT = {"nnan", "ninf", "nsz"}
_compiled = numba.njit(error_model="numpy", fastmath=STRICT)


@_compiled
def _corrected(s):
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    u += 0.5 * ((s - 2.0 * u) - u * u)  # gives back the digits that 1 + s lost
    return u * (3.0 + u * (3.0 + u))


@_compiled
def _plain(s):
    y = 1.0 + s
    y = y if y > 0.0 else 0.0
    return y * math.sqrt(y) - 1.0


@_compiled
def _spring(s):
    return s if s > -1.0 else -1.0


@_compiled
def _power(s, delta):
    return math.expm1(delta * math.log1p(s)) if s > -1.0 else -1.0


@_compiled
def _vacuum(s, delta):
    return s**delta if s > 0.0 else 0.0


@_compiled
def _closer(x, inverse_length, n):
    return (x[n] - x[n + 1]) * inverse_length[n]


@_compiled
def contact_forces(force, x, inverse_length, strength, loose, form, delta):
    """Fill force (C,) with the force of every contact minus its equilibrium value, N.

    One loop a form: a branch inside the loop would keep it from being vectorised. `loose` is the constant of
    the first contact if that touches without pressing in a chain that is pressed otherwise, else 0.
    """
    if form == CORRECTED:
        for n in range(strength.size):
            force[n] = strength[n] * _corrected(_closer(x, inverse_length, n))
    elif form == PLAIN:
        for n in range(strength.size):
            force[n] = strength[n] * _plain(_closer(x, inverse_length, n))
    elif form == SPRING:
        for n in range(strength.size):
            force[n] = strength[n] * _spring(_closer(x, inverse_length, n))
    elif form == POWER:
        for n in range(strength.size):
            force[n] = strength[n] * _power(_closer(x, inverse_length, n), delta)
    else:
        for n in range(strength.size):
            force[n] = strength[n] * _vacuum(_closer(x, inverse_length, n), delta)
    if loose > 0.0:
        force[0] = loose * _vacuum(x[0] - x[1], delta)


@_compiled
def _kick_and_drift(x, w, force, inverse_mass, end, begin, drift):
    for n in range(x.size):  # from 0: indices that might be negative would keep the loop from being vectorised
        acceleration = inverse_mass[n] * (force[n] - force[n + 1])
        faster = w[n] + end * acceleration
        faster = faster + begin * acceleration
        w[n] = faster
        x[n] += drift * faster


@_compiled
def _watch(x, inverse_length, strength, seen):
    """Keep the smallest r / length, whose -1 is an opening, and the largest r of all contacts in seen (2,)."""
    lowest, closest = seen[0], seen[1]
    for n in range(strength.size):
        s = _closer(x, inverse_length, n)
        r = x[n] - x[n + 1] if strength[n] > 0.0 else 0.0
        lowest = s if s < lowest else lowest
        closest = r if r > closest else closest
    seen[0], seen[1] = lowest, closest


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=STRICT)
def advance(
    x, v, seen, inverse_length, strength, loose, inverse_mass, first, last, forms, delta, kicks, drifts, steps, driven
):
    """Advance every realisation by `steps` steps of a kick-drift splitting, in place.

    The bodies of a row are a wall (or nothing), N grains, and a wall (or nothing). The last kick of a step
    and the first of the next use one force but stay two additions, so that the result does not depend on how
    the steps are divided over calls.

    Parameters
    ----------
    x, v : (R, N+2) arrays, m and m/s
    seen : (R, 2) array, smallest r / length and largest r at the end of any step; of methods of several stages
    inverse_length, strength : (R, N+1) arrays, 1/m and N
    loose : (R,) array, N/m^delta; see `contact_forces`
    inverse_mass : (R, N+2) array, 1/kg
    first, last : bodies first ... last-1 move freely
    forms : (R,) array, the form of the force of each
    delta : its exponent
    kicks, drifts : (S+1,) and (S,) arrays, b_i h and a_i h, s
    driven : (R, steps S + 1) array, where body 1 is at each evaluation of the force, m; (R, 0) if it is free
    """
    stages = drifts.size
    force = np.zeros(strength.shape[1])
    for real in range(x.shape[0]):
        y, il, st, path = x[real], inverse_length[real], strength[real], driven[real]
        free, speed = y[first:last], v[real, first:last]
        mobility, pull = inverse_mass[real, first:last], force[first - 1 : last]
        for step in range(steps):
            end = kicks[stages] if step > 0 else 0.0
            for stage in range(stages):
                if path.size > 0:
                    y[1] = path[step * stages + stage]
                contact_forces(force, y, il, st, loose[real], forms[real], delta)
                _kick_and_drift(free, speed, pull, mobility, end, kicks[stage], drifts[stage])
                end = 0.0
            if stages > 1 or path.size > 0:
                _watch(y, il, st, seen[real])
        if path.size > 0:
            y[1] = path[steps * stages]
        contact_forces(force, y, il, st, loose[real], forms[real], delta)
        _kick_and_drift(free, speed, pull, mobility, kicks[stages], 0.0, 0.0)
