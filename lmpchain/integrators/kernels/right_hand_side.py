"""The right-hand side of Eq. (1), compiled: contact forces and what an excitation imposes.

What is imposed is the motion of grain 1 or of the top wall, or a force on a grain, which x[0] holds, where no body is:
a method calls `impose` for every time at which it evaluates accelerations, and `imposed` for every row of a `sweep`.
"""

from __future__ import annotations

import math

import numpy as np

from .contact_forces import compiled, contact_forces, inlined, kick_and_drift, touching
from .layout import AMPLITUDE, BODY, EDGE, END, ENVELOPE, KNOTS, OMEGA, PAD, RESOLUTION
from .team import meet, mine

ROWS = 64  # evaluations of the force between two updates of the window, for long chains and for methods of one stage
TILE = 8192  # grains that stay in the cache while ROWS evaluations pass over them


@compiled
def _course(chain, t, order, inside):
    """Return what is imposed at time t, or its rate (order 1), by the law of time `inside`.

    It is a sine, also one with an envelope, or a cubic spline.
    """
    drive, pieces = chain.drive, chain.pieces
    count = int(drive[KNOTS])
    if count == 0:
        size, omega, envelope = drive[AMPLITUDE], drive[OMEGA], drive[ENVELOPE]
        if inside >= drive[END]:
            return 0.0
        if envelope == 0.0:
            return size * math.sin(omega * t) if order == 0 else size * omega * math.cos(omega * t)
        part = math.sin(envelope * t)
        if order == 0:
            return size * math.sin(omega * t) * (part * part)
        slope = 2.0 * envelope * math.cos(envelope * t) * math.sin(omega * t)
        return size * part * (omega * math.cos(omega * t) * part + slope)
    piece = min(max(np.searchsorted(chain.knots[:count], t, "right") - 1, 0), count - 2)
    s = t - chain.knots[piece]
    a, b, c, d = pieces[0, piece], pieces[1, piece], pieces[2, piece], pieces[3, piece]
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@compiled
def ahead(chain, t, end, resolution):
    """Return the time to the next corner of what is imposed before `end`, else infinity."""
    count, knots, corner = int(chain.drive[KNOTS]), chain.knots, chain.drive[END]
    if chain.imposed and count > 0:
        following = np.searchsorted(knots[:count], t + resolution, "right")
        if following < count and knots[following] < end - resolution:
            return knots[following] - t
    elif chain.imposed and t + resolution < corner < end - resolution:
        return corner - t
    return 1e300


@inlined
def cut(chain, t, h):
    """Return the time to where a sine ends within a step h, 0 if it does not, or for a spline."""
    if chain.imposed and chain.drive[KNOTS] == 0.0:
        left = chain.drive[END] - t
        return left if RESOLUTION * h < left < (1.0 - RESOLUTION) * h else 0.0
    return 0.0


@inlined
def forced(chain):
    """Return the body that is pushed, 0 if there is none."""
    return int(-chain.drive[BODY]) if chain.imposed and chain.drive[BODY] < 0.0 else 0


@inlined
def imposed(chain, t):
    """Return what is imposed at time t, for a row of `sweep`: a displacement, or a force."""
    return _course(chain, t, 0, t)


@inlined
def impose(chain, x, t, inside):
    """Put what is driven where it is at time t in x (W,), or note the force, by the law of `inside`."""
    if chain.imposed and chain.team.part == 0:
        x[max(int(chain.drive[BODY]), 0)] = _course(chain, t, 0, inside)


@inlined
def recall(chain, t):
    """Put what is imposed at time t back where no grain holds it: a wall, or a force."""
    if chain.imposed and chain.drive[BODY] < PAD:
        impose(chain, chain.x, t, t)


@inlined
def impose_velocity(chain, v, grain_1, t):
    """Give what is driven its velocity at time t, if v, with grain 1 at that index, has a place."""
    if chain.imposed and chain.team.part == 0 and int(chain.drive[BODY]) + grain_1 >= PAD:
        v[int(chain.drive[BODY]) + grain_1 - PAD] = _course(chain, t, 1, t)


@inlined
def imposed_rate(chain, t, inside):
    """Return how fast what is imposed changes at time t, by the law of `inside`; 0 if nothing is."""
    return _course(chain, t, 1, inside) if chain.imposed else 0.0


@inlined
def place(chain, t, u_row, v_row):
    """Put grain 1, if it is driven, into a row of samples (N,) where it is at time t."""
    if chain.imposed and chain.team.part == 0 and chain.drive[BODY] == PAD:
        u_row[0], v_row[0] = _course(chain, t, 0, t), _course(chain, t, 1, t)


@inlined
def imposed_speed(chain, t):
    """Return how fast grain 1 is at time t if it is driven, else 0."""
    return abs(_course(chain, t, 1, t)) if chain.imposed and chain.drive[BODY] == PAD else 0.0


@inlined
def hold(chain, v):
    """Take the velocity of grain 1 out of v if it is driven: a drift must not move it."""
    if chain.imposed and chain.team.part == 0 and chain.drive[BODY] == PAD:
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
    pushed = forced(chain)
    if first <= pushed < last:
        pull[pushed] += chain.inverse_mass[pushed] * y[0]


@inlined
def _rows(chain, a, b, some, kicks, drifts, carried, path):
    """Kick and drift the grains a ... b-1 once for each of some rows."""
    il, st, im, pushed = chain.inverse_length, chain.strength, chain.inverse_mass, forced(chain)
    top = a == chain.state.first  # none of the window is above
    body = pushed if pushed > 0 else int(chain.drive[BODY])
    kick_and_drift(
        chain.form, chain.x[a - 1 : b + 1], chain.v[a:b], il[a - 1 : b], st[a - 1 : b], im[a:b],
        kicks[some], drifts[some], carried[some],
        top, chain.uncompressed if top and a == PAD else 0.0, chain.precompressed, chain.coefficients,
        path[some], body - (a - 1), pushed > 0,
    )  # fmt: skip


@compiled
def _lean(chain, a, row, carried):
    """Leave to the thread above where grain a is before a row, and find the force on it from above."""
    team, x = chain.team, chain.x
    team.board[team.part, EDGE + row] = x[a]
    contact_forces(
        chain.form, carried[row : row + 1], x[a - 1 : a + 1], chain.inverse_length[a - 1 : a],
        chain.strength[a - 1 : a], chain.precompressed, chain.coefficients,
    )  # fmt: skip


@compiled
def _close(chain, end, kicks, drifts, carried, path):
    """Kick and drift what this thread and the one below have left out around the border between them."""
    x, edges = chain.x, chain.team.board[chain.team.part + 1, EDGE:]
    for row in range(kicks.size):
        b = end + PAD * (row + 1)
        now, x[b] = x[b], edges[row]
        _rows(chain, end - PAD * row, b, slice(row, row + 1), kicks, drifts, carried, path)
        x[b] = now


@inlined
def sweep(chain, kicks, drifts, carried, path):
    """Kick and drift the window once a row; long chains in tiles that stay in the cache.

    Every row of a tile ends a cache line before the one above it, so that it needs nothing of the tile to come. Of a
    chain that threads share, the rows of each begin a line after the one above, too, the first a line into its part, so
    that it needs nothing of what others do meanwhile; what is left out between them follows.
    """
    first, last = chain.state.first, chain.state.last
    begins, ends = mine(chain)
    meet(chain.team)
    rows, tile = kicks.size, TILE if ends - begins > 2 * TILE else max(1, ends - begins)
    together = rows if tile == last - first else 1
    for begin in range(begins, ends, tile):
        end = begin + tile if begin + 2 * tile <= ends else ends
        for row in range(0, rows, together):
            a, b = begin, end
            if together == 1:
                b = end - PAD * row if end < last else last
                if begin > begins:
                    a = begin - PAD * row
                elif begin > first:
                    a = begin + PAD * (row + 1)
                    _lean(chain, a, row, carried)
            _rows(chain, a, b, slice(row, row + together), kicks, drifts, carried, path)
        if end == ends:
            break
    meet(chain.team)
    if begins < ends < last:
        _close(chain, ends, kicks, drifts, carried, path)
    meet(chain.team)
