"""The map of a kick-drift splitting and its tangent, compiled: how deviations of a state grow.

The map is that of the native engine, so its tangent is exact for the steps taken, and symplectic.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import STRICT, compiled, contact_forces, fma, inlined, touching
from .layout import PAD


class Links(NamedTuple):
    """One chain of a batch for `march`: rows of W bodies, see `layout.Chains`.

    Attributes
    ----------
    inverse_length, strength, inverse_mass : (W,) arrays
        1 / length and strength of the contact below each body, and its inverse mass.
    uncompressed, form, precompressed, coefficients : numbers, and (8,) array
        See `layout.Chains`.
    """

    inverse_length: Array
    strength: Array
    inverse_mass: Array
    uncompressed: float
    form: int
    precompressed: float
    coefficients: Array


@compiled
def _stiffness(overlap, strength, delta):
    """Return the derivative of the force by the overlap in units of the length."""
    if overlap <= 0.0:
        return 0.0
    return strength * delta * (math.sqrt(overlap) if delta == 1.5 else overlap ** (delta - 1.0))


@inlined
def _evaluate(links, x, shorter, grains, force, stiffness):
    """Fill force and stiffness (N+1,) of all contacts."""
    first, last = PAD - 1, PAD + grains
    il, st = links.inverse_length[first:last], links.strength[first:last]
    contact_forces(
        links.form, force, x[first : last + 1], il, st, links.precompressed, links.coefficients
    )
    delta = links.coefficients[7]
    for n in range(grains + 1):
        overlap = (x[first + n] - x[PAD + n]) * il[n] + links.precompressed
        stiffness[n] = _stiffness(overlap, st[n], delta) * il[n]
    if links.uncompressed > 0.0:
        r = x[first] - x[PAD]
        force[0] += touching(r, links.uncompressed, links.coefficients)
        stiffness[0] += _stiffness(r, links.uncompressed, delta)
    for n in range(grains + 1):
        force[n] += stiffness[n] * (shorter[first + n] - shorter[PAD + n])


@inlined
def _add(row, lost, n, change):
    """Add a change to an element of a row, and keep what rounding takes off it for the next change."""
    old, change = row[n], change + lost[n]
    new = old + change
    added = new - old
    row[n], lost[n] = new, (old - (new - added)) + (change - added)


@inlined
def _kick(links, kick, v, slower, dx, dv, stretch, force, stiffness):
    """Kick the grains, and every deviation by what the stiffness makes of it."""
    grains, columns = dx.shape
    for n in range(grains):
        push = kick * links.inverse_mass[PAD + n]
        if push == 0.0:
            continue
        whole = push * (force[n] - force[n + 1])
        _add(v, slower, PAD + n, whole)
        above, below = push * stiffness[n], push * stiffness[n + 1]
        here, faster = dx[n], dv[n]
        up, down = dx[max(n - 1, 0)], dx[min(n + 1, grains - 1)]
        upper = above if n > 0 else 0.0
        lower = below if n < grains - 1 else 0.0
        for c in range(columns):
            faster[c] += fma(
                upper,
                up[c],
                fma(lower, down[c], fma(-(above + below), here[c], whole * stretch[c])),
            )


@compiled_once("the tangent map", 20, nogil=True, error_model="numpy", fastmath=STRICT)
def march(links, x, v, dx, dv, stretch, kicks, drifts, steps, body, path, xs, vs):
    """Advance a chain of N grains, and C deviations of its state, by a splitting with given steps.

    Parameters
    ----------
    links : Links
    x, v : (W,) arrays
        Row of displacements and velocities, grain 1 at the index PAD; overwritten.
    dx, dv : (N, C) arrays
        Deviations of displacements and velocities, contiguous; overwritten.
    stretch : (C,) array
        By how much, in relative terms, a deviation stretches all steps: 1 for the derivative by log(time).
    kicks, drifts : (S+1,) and (S,) arrays
        Fractions of a step.
    steps : (K,) array
        Their lengths, s.
    body, path : int and (K S + 1,) array
        Index and displacements, at every evaluation of the force, of a body without inverse mass that is moved; empty
        if none is.
    xs, vs : (K+1, N) arrays
        Filled with the states between the steps.

    Notes
    -----
    Sums are compensated: a grain that flies far between short contacts would lose four digits to rounding.
    """
    grains, stages = dx.shape[0], drifts.size
    force, stiffness = np.zeros(grains + 1), np.zeros(grains + 1)
    shorter, slower = np.zeros(x.size), np.zeros(x.size)
    for k in range(steps.size + 1):
        if k == 0 and path.size > 0:
            x[body] = path[0]
        if k == 0:
            _evaluate(links, x, shorter, grains, force, stiffness)
        xs[k], vs[k] = x[PAD : PAD + grains], v[PAD : PAD + grains]
        if k == steps.size:
            break
        h = steps[k]
        _kick(links, kicks[0] * h, v, slower, dx, dv, stretch, force, stiffness)
        for stage in range(stages):
            drift = drifts[stage] * h
            for n in range(grains):
                whole = drift * v[PAD + n]
                _add(x, shorter, PAD + n, whole)
                here, faster = dx[n], dv[n]
                for c in range(here.size):
                    here[c] += fma(drift, faster[c], whole * stretch[c])
            if path.size > 0:
                x[body] = path[k * stages + stage + 1]
            _evaluate(links, x, shorter, grains, force, stiffness)
            _kick(links, kicks[stage + 1] * h, v, slower, dx, dv, stretch, force, stiffness)
