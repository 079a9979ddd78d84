"""The right-hand side of Eq. (1), compiled: contact forces and the imposed motion or force.

An excitation imposes the motion of grain 1, the motion of the top wall, or a force on a grain. An
imposed force is stored in x[0], an empty place of the row. A method calls `impose` at every time at
which it evaluates accelerations, and `imposed` for every row of a `sweep`.
"""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np
from numba import types

from .compiling import STRICT, address_of, apart, caller, compiled, compiled_filler, inlined, pasted
from .contact_forces import contact_forces, kick_and_drift, pull_to_rest, touching
from .layout import PAD, RESOLUTION, WAVE, Links, Rows
from .team import meet, share

_WAVE = numba.from_dtype(WAVE)
_KNOTS = types.float64[::1]
_PIECES = types.float64[:, ::1]
_COURSE = types.float64(_WAVE, _KNOTS, _PIECES, types.float64, types.int64, types.float64)
_KINK = types.float64(_WAVE, _KNOTS, types.float64, types.float64, types.float64)
_kept = compiled_filler(fastmath=STRICT)


@_kept
def _course(wave, knots, pieces, t, order, inside):
    """Return the imposed motion or force at time t, or its derivative of some order.

    If t is a kink, the branch on the side of the time `inside` is evaluated. The motion or force is
    a sine, with or without an envelope, or a cubic spline.
    """
    if wave.knots == 0:
        size = wave.amplitude
        omega = wave.omega
        envelope = wave.envelope
        if inside >= wave.end:
            return 0.0
        if envelope == 0.0:
            if order == 2:
                return -size * omega * omega * math.sin(omega * t)
            return size * math.sin(omega * t) if order == 0 else size * omega * math.cos(omega * t)
        window = math.sin(envelope * t)
        if order == 0:
            return size * math.sin(omega * t) * (window * window)
        if order == 2:
            # The first and second derivatives of the squared window.
            first = envelope * math.sin(2.0 * envelope * t)
            second = 2.0 * envelope * envelope * math.cos(2.0 * envelope * t)
            bend = (second - omega * omega * window * window) * math.sin(omega * t)
            return size * (bend + 2.0 * omega * first * math.cos(omega * t))
        slope = 2.0 * envelope * math.cos(envelope * t) * math.sin(omega * t)
        return size * window * (omega * math.cos(omega * t) * window + slope)
    knots = knots[: wave.knots]
    # The derivative may jump at a knot, so `inside` selects the piece.
    at = t if order == 0 else inside
    piece = min(max(np.searchsorted(knots, at, "right") - 1, 0), knots.size - 2)
    s = t - knots[piece]
    a = pieces[0, piece]
    b = pieces[1, piece]
    c = pieces[2, piece]
    d = pieces[3, piece]
    if order == 2:
        return 6 * a * s + 2 * b
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@_kept
def _kink(wave, knots, t, end, resolution):
    """Return the time to the next kink before `end`, or 1e300 without one."""
    if wave.knots > 0:
        knots = knots[: wave.knots]
        following = np.searchsorted(knots, t + resolution, "right")
        if following < knots.size and knots[following] < end - resolution:
            return knots[following] - t
    elif t + resolution < wave.end < end - resolution:
        return wave.end - t
    # The compiler flags assume finite numbers, so infinity is not allowed.
    return 1e300


@cache
def addresses() -> tuple[int, ...]:
    """Return the memory addresses of the compiled functions `_course` and `_kink`."""
    return address_of(_course, _COURSE), address_of(_kink, _KINK)


call_course = caller(_COURSE)
call_kink = caller(_KINK)


# Number of force evaluations between two updates of the window, for long chains and for methods
# with one stage.
ROWS = 64
TILE = 8192  # Number of grains that stay in the cache during ROWS evaluations.


@inlined
def course(chain, t, order, inside):
    """Return the imposed motion or force at time t, or its derivative of some order.

    If t is a kink, the branch on the side of the time `inside` is evaluated. A motion or force must
    be imposed.
    """
    imposed = chain.imposed
    given = imposed.wave, imposed.knots, imposed.pieces, t, order, inside
    return call_course(imposed.laws[0], given)


@inlined
def ahead(chain, t, end, resolution):
    """Return the time to the next kink of the forcing before `end`, else 1e300."""
    imposed = chain.imposed
    if imposed.acts:
        return call_kink(imposed.laws[1], (imposed.wave, imposed.knots, t, end, resolution))
    # The compiler flags assume finite numbers, so infinity is not allowed.
    return 1e300


@inlined
def cut(chain, t, h):
    """Return the time to the end of a sine within a step h, 0 if it does not end there."""
    if chain.imposed.acts and chain.imposed.wave.knots == 0:
        remaining = chain.imposed.wave.end - t
        return remaining if RESOLUTION * h < remaining < (1.0 - RESOLUTION) * h else 0.0
    return 0.0


@inlined
def forced(chain):
    """Return the index of the body on which a force acts, or 0 without a force."""
    return max(-chain.imposed.wave.body, 0) if chain.imposed.acts else 0


@inlined
def imposed(chain, t):
    """Return the imposed displacement or force at time t, for a row of `sweep`."""
    return course(chain, t, 0, t)


@inlined
def impose(chain, x, t, inside):
    """Store the imposed displacement or force at time t in x (W,); `inside` selects the branch."""
    if chain.imposed.acts and chain.team.part == 0:
        x[max(chain.imposed.wave.body, 0)] = course(chain, t, 0, inside)


@inlined
def recall(chain, t):
    """Restore the imposed displacement of the wall, or the force, at time t in the chain."""
    if chain.imposed.acts and chain.imposed.wave.body < PAD:
        impose(chain, chain.x, t, t)


@inlined
def impose_velocity(chain, v, grain_1, t):
    """Store the velocity of the driven body at time t in v, if v contains this body.

    Grain 1 has the index `grain_1` in v.
    """
    if chain.imposed.acts and chain.team.part == 0 and chain.imposed.wave.body + grain_1 >= PAD:
        v[chain.imposed.wave.body + grain_1 - PAD] = course(chain, t, 1, t)


@inlined
def imposed_speed(chain, t):
    """Return the speed of grain 1 at time t if it is driven, else 0."""
    return (
        abs(course(chain, t, 1, t))
        if chain.imposed.acts and chain.imposed.wave.body == PAD
        else 0.0
    )


@inlined
def hold(chain, v):
    """Set the velocity of a driven grain 1 to 0, so that a drift does not move it."""
    if chain.imposed.acts and chain.team.part == 0 and chain.imposed.wave.body == PAD:
        v[PAD] = 0.0


@pasted
def slice_links(links, contacts, uncompressed):
    """Return some of the contacts; `uncompressed` is the constant of a touching first contact."""
    return Links(
        inverse_length=links.inverse_length[contacts],
        strength=links.strength[contacts],
        uncompressed=uncompressed,
        form=links.form,
        loops=links.loops,
        precompressed=links.precompressed,
        coefficients=links.coefficients,
        parameters=links.parameters,
        first=links.first + contacts.start,
    )


@pasted
def slice_rows(rows, numbers):
    """Return some of the rows of a sweep."""
    return Rows(
        kick=rows.kick[numbers],
        drift=rows.drift[numbers],
        carried=rows.carried[numbers],
        path=rows.path[numbers],
        time=rows.time[numbers],
    )


@compiled
def _fill_pull(pull, inverse_mass, force):
    """Compute accelerations (B,) of bodies between contacts with these forces (B+1,)."""
    apart()
    for n in range(pull.size):
        pull[n] = inverse_mass[n] * (force[n] - force[n + 1])


@inlined
def accelerate(chain, y, first, last, force, pull):
    """Compute accelerations (W,) of bodies first ... last-1 of y (W,), and their forces (W,)."""
    near = slice(first - 1, last)
    # The compiler vectorises loops over slices, because their bounds are known.
    f = force[: last - first + 1]
    links = chain.links
    contact_forces(slice_links(links, near, 0.0), f, y[first - 1 : last + 1])
    if first == PAD and links.uncompressed > 0.0:
        f[0] += touching(y[PAD - 1] - y[PAD], links.uncompressed, links.coefficients)
    _fill_pull(pull[first:last], chain.inverse_mass[first:last], f)
    pushed = forced(chain)
    if first <= pushed < last:
        pull[pushed] += chain.inverse_mass[pushed] * y[0]


@inlined
def add_ground(chain, y, t, first, last, pull):
    """Add the ground's accelerations at time t to the bodies first to last - 1 of y."""
    _pull_bodies(chain.ground, chain, y, t, first, last, pull, 1.0)


@inlined
def _pull_bodies(ground, chain, y, t, first, last, pull, length):
    """Add accelerations, times a `length`, of bodies first ... last-1 of y to `pull` (W,).

    If there is no ground, `ground` is None, and the code below is not compiled.
    """
    if ground is not None:
        bodies = slice(first, last)
        inverse_mass = chain.inverse_mass[bodies]
        given = chain.ground_parameters
        pull_to_rest(ground, pull[bodies], y[bodies], inverse_mass, given, first, t, length)


@inlined
def _sweep_contacts(chain, a, b, rows):
    """Kick the grains a ... b-1 by their contacts, and drift them, once for each row."""
    pushed = forced(chain)
    # No body of the window is above these grains.
    top = a == chain.state.first
    touches = chain.links.uncompressed if top and a == PAD else 0.0
    body = pushed if pushed > 0 else chain.imposed.wave.body
    kick_and_drift(
        slice_links(chain.links, slice(a - 1, b), touches),
        chain.x[a - 1 : b + 1],
        chain.v[a:b],
        chain.inverse_mass[a:b],
        rows,
        top,
        body - (a - 1),
        pushed > 0,
    )


@inlined
def _sweep_by(ground, chain, a, b, rows):
    """Kick and drift grains; a ground, if it is not None, kicks before the contacts of a row."""
    if ground is None:
        _sweep_contacts(chain, a, b, rows)
    else:
        for row in range(rows.kick.size):
            _pull_bodies(ground, chain, chain.x, rows.time[row], a, b, chain.v, rows.kick[row])
            _sweep_contacts(chain, a, b, slice_rows(rows, slice(row, row + 1)))


@inlined
def _sweep_rows(chain, a, b, rows):
    """Kick and drift the grains a ... b-1 once for each row."""
    _sweep_by(chain.ground, chain, a, b, rows)


@compiled
def _publish_edge(chain, a, row, carried):
    """Publish grain a to the thread above before a row, and compute the force on it from above."""
    team = chain.team
    x = chain.x
    team.edges[team.part, row] = x[a]
    links = slice_links(chain.links, slice(a - 1, a), 0.0)
    contact_forces(links, carried[row : row + 1], x[a - 1 : a + 1])


@compiled
def _sweep_border(chain, end, rows):
    """Kick and drift the grains around the border between this thread and the one below."""
    x = chain.x
    edges = chain.team.edges[chain.team.part + 1]
    for row in range(rows.kick.size):
        # The grain below has already advanced further; its position in this row is restored
        # temporarily.
        b = end + PAD * (row + 1)
        now = x[b]
        x[b] = edges[row]
        _sweep_rows(chain, end - PAD * row, b, slice_rows(rows, slice(row, row + 1)))
        x[b] = now


@inlined
def sweep(chain, rows):
    """Kick and drift the window once for each row; long chains in tiles that fit the cache.

    Every row of a tile ends one cache line above the previous row, so that it does not depend on
    the next tile. If threads share a chain, every row of a thread also begins one cache line below
    the previous row, so that it does not depend on other threads. Grains that are omitted at the
    borders between threads are processed at the end.
    """
    first = chain.state.first
    last = chain.state.last
    begins, ends = share(chain)
    meet(chain.team)
    tile = TILE if ends - begins > 2 * TILE else max(1, ends - begins)
    # Adaptive Verlet has no rows between its first stage and its last one.
    together = max(1, rows.kick.size) if tile == last - first else 1
    for begin in range(begins, ends, tile):
        end = begin + tile if begin + 2 * tile <= ends else ends
        for row in range(0, rows.kick.size, together):
            a = begin
            b = end
            if together == 1:
                b = end - PAD * row if end < last else last
                if begin > begins:
                    a = begin - PAD * row
                elif begin > first:
                    a = begin + PAD * (row + 1)
                    _publish_edge(chain, a, row, rows.carried)
            _sweep_rows(chain, a, b, slice_rows(rows, slice(row, row + together)))
        if end == ends:
            break
    meet(chain.team)
    if begins < ends < last:
        _sweep_border(chain, ends, rows)
    meet(chain.team)
