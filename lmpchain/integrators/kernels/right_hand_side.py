"""The right-hand side of Eq. (1), compiled: contact forces and what an excitation imposes.

What is imposed is the motion of grain 1: a method calls `impose` for every time at which it evaluates accelerations,
and `imposed` for every row of a `sweep`.
"""

from __future__ import annotations

import math

import numpy as np

from .contact_forces import compiled, contact_forces, inlined, kick_and_drift, touching
from .layout import FIRST, LAST, PAD

ROWS = 64  # evaluations of the force between two updates of the window, for long chains and for methods of one stage
TILE = 8192  # grains that stay in the cache while ROWS evaluations pass over them


@compiled
def _driven(chain, t, order):
    """Return displacement (order 0) or speed (order 1) of the driven grain: a sine or a cubic spline.

    `chain.drive` holds amplitude, frequency in rad/s and the number of knots, 0 for a sine.
    """
    drive, pieces = chain.drive, chain.pieces
    count = int(drive[2])
    if count == 0:
        return drive[0] * math.sin(drive[1] * t) if order == 0 else drive[0] * drive[1] * math.cos(drive[1] * t)
    piece = min(max(np.searchsorted(chain.knots[:count], t, "right") - 1, 0), count - 2)
    s = t - chain.knots[piece]
    a, b, c, d = pieces[0, piece], pieces[1, piece], pieces[2, piece], pieces[3, piece]
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@compiled
def ahead(chain, t, end, resolution):
    """Return the time to the next knot of the imposed motion before `end`, else infinity."""
    count, knots = int(chain.drive[2]), chain.knots
    if chain.imposed and count > 0:
        following = np.searchsorted(knots[:count], t + resolution, "right")
        if following < count and knots[following] < end - resolution:
            return knots[following] - t
    return 1e300


@inlined
def imposed(chain, t):
    """Return what is imposed at time t, for a row of `sweep`: the displacement of grain 1."""
    return _driven(chain, t, 0)


@inlined
def impose(chain, x, t):
    """Put grain 1 of a row x (W,) where it is at time t if it is driven."""
    if chain.imposed:
        x[PAD] = _driven(chain, t, 0)


@inlined
def impose_velocity(chain, v, grain_1, t):
    """Give grain 1 of v, at that index, its velocity at time t if it is driven."""
    if chain.imposed:
        v[grain_1] = _driven(chain, t, 1)


@inlined
def imposed_speed(chain, t):
    """Return how fast grain 1 is at time t if it is driven, else 0."""
    return abs(_driven(chain, t, 1)) if chain.imposed else 0.0


@inlined
def hold(chain, v):
    """Take the velocity of grain 1 out of v if it is driven: a drift must not move it."""
    if chain.imposed:
        v[PAD] = 0.0


@inlined
def accelerate(chain, y, first, last, force, pull):
    """Fill pull (W,) with accelerations of bodies first ... last-1 of y (W,); force (W,) is room for work."""
    near = slice(first - 1, last)
    f, im, a = force[: last - first + 1], chain.inverse_mass[first:last], pull[first:last]
    contact_forces(
        chain.form, f, y[first - 1 : last + 1], chain.inverse_length[near], chain.strength[near],
        chain.precompressed, chain.coefficients,
    )  # fmt: skip
    if first == PAD and chain.uncompressed > 0.0:
        f[0] += touching(y[PAD - 1] - y[PAD], chain.uncompressed, chain.coefficients)
    for n in range(a.size):
        a[n] = im[n] * (f[n] - f[n + 1])


@inlined
def sweep(chain, kicks, drifts, carried, path):
    """Kick and drift the window once a row; long chains in tiles that stay in the cache.

    Every row of a tile ends a cache line before the one above it, so that it needs nothing of the tile to come.
    """
    x, v, il, st, im = chain.x, chain.v, chain.inverse_length, chain.strength, chain.inverse_mass
    first, last = int(chain.state[FIRST]), int(chain.state[LAST])
    rows, tile = kicks.size, TILE if last - first > 2 * TILE else last - first
    for begin in range(first, last, tile):
        end = begin + tile if begin + 2 * tile <= last else last
        together = rows if tile == last - first else 1
        for row in range(0, rows, together):
            a, b = begin, end
            if together == 1:
                a = max(first, begin - PAD * row)
                b = end - PAD * row if end < last else last
            some = slice(row, row + together)
            kick_and_drift(
                chain.form, x[a - 1 : b + 1], v[a:b], il[a - 1 : b], st[a - 1 : b], im[a:b],
                kicks[some], drifts[some], carried[some],
                a == first, chain.uncompressed if a == PAD else 0.0, chain.precompressed, chain.coefficients,
                path[some],
            )  # fmt: skip
        if end == last:
            break
