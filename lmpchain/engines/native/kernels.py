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
def contact_forces(force, x, inverse_length, strength, form, delta):
    """Fill force[1 ... N-1] with the force of every contact minus its equilibrium value, N.

    One loop a form: a branch inside the loop would keep it from being vectorised.
    """
    if form == CORRECTED:
        for n in range(strength.size):
            force[n + 1] = strength[n] * _corrected(_closer(x, inverse_length, n))
    elif form == PLAIN:
        for n in range(strength.size):
            force[n + 1] = strength[n] * _plain(_closer(x, inverse_length, n))
    elif form == SPRING:
        for n in range(strength.size):
            force[n + 1] = strength[n] * _spring(_closer(x, inverse_length, n))
    elif form == POWER:
        for n in range(strength.size):
            force[n + 1] = strength[n] * _power(_closer(x, inverse_length, n), delta)
    else:
        for n in range(strength.size):
            force[n + 1] = strength[n] * _vacuum(_closer(x, inverse_length, n), delta)


@_compiled
def _kick_and_drift(x, w, force, inverse_mass, movable, end, begin, drift):
    for n in range(movable):
        acceleration = inverse_mass[n] * (force[n] - force[n + 1])
        faster = w[n] + end * acceleration
        faster = faster + begin * acceleration
        w[n] = faster
        x[n] += drift * faster


@_compiled
def _lowest(x, inverse_length):
    lowest = 0.0
    for n in range(inverse_length.size):
        s = _closer(x, inverse_length, n)
        lowest = s if s < lowest else lowest
    return lowest


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=STRICT)
def advance(u, v, lowest, inverse_length, strength, inverse_mass, movable, form, delta, kicks, drifts, steps):
    """Advance every realisation by `steps` steps of a kick-drift splitting, in place.

    The last kick of a step and the first of the next use one force but stay two additions, so
    that the result does not depend on how the steps are divided over calls.

    Parameters
    ----------
    u, v : (R, N) arrays, m and m/s
    lowest : (R,) array, smallest r / length at the end of any step; kept for methods of several stages
    inverse_length, strength : (R, N-1) arrays, 1/m and N
    inverse_mass : (R, N) array, 1/kg
    movable : number of grains that move
    form, delta : the form of the force and its exponent
    kicks, drifts : (S+1,) and (S,) arrays, b_i h and a_i h, s
    """
    stages = drifts.size
    force = np.zeros(u.shape[1] + 1)  # nothing above grain 1 nor below a free last grain
    for real in range(u.shape[0]):
        x, w, im = u[real], v[real], inverse_mass[real]
        for step in range(steps):
            end = kicks[stages] if step > 0 else 0.0
            for stage in range(stages):
                contact_forces(force, x, inverse_length[real], strength[real], form, delta)
                _kick_and_drift(x, w, force, im, movable, end, kicks[stage], drifts[stage])
                end = 0.0
            if stages > 1:
                lowest[real] = min(lowest[real], _lowest(x, inverse_length[real]))
        contact_forces(force, x, inverse_length[real], strength[real], form, delta)
        _kick_and_drift(x, w, force, im, movable, kicks[stages], 0.0, 0.0)
