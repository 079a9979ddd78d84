"""The tangent of a run by a kick-drift splitting, compiled; see `adjoint`."""

from __future__ import annotations

from typing import NamedTuple

from ...util.arrays import Array
from .adjoint import BURST
from .adjoint_rows import Bodies, hertz_power, power, touch
from .compiling import apart
from .layout import PAD
from .sample_loop import compiled_gradient, count_rows, fill_rows, loop


class ForceResponse(NamedTuple):
    """Contact forces and their derivatives, (W,) arrays.

    Attributes
    ----------
    power : (W,) array
        The number p of `adjoint` for every contact.
    force : (W,) array
        Force f of every contact minus its force at rest, N.
    slope : (W,) array
        Derivative of f with respect to the approach r, N/m.
    soften : (W,) array
        Derivative of f with respect to the constant K.
    inverse_constant : (W,) array
        1 / K.
    at_rest : (W,) array
        Force of every contact at rest, N.
    """

    power: Array
    force: Array
    slope: Array
    soften: Array
    inverse_constant: Array
    at_rest: Array


class Directions(NamedTuple):
    """Small changes of bodies and of the parameters of the motion, in D directions.

    Attributes
    ----------
    x : (D, W) array
        Changes of displacements, m; overwritten.
    v : (D, W) array
        Changes of velocities, m/s; overwritten.
    mass : (D, W) array
        Relative changes of masses.
    constant : (D, W) array
        Changes of the constants of contacts, N/m^delta.
    force : (D, W) array
        Changes of the forces of contacts at rest, N.
    path : (D, rows) array
        Changes of the imposed displacement, m, or force, N, in each row.
    """

    x: Array
    v: Array
    mass: Array
    constant: Array
    force: Array
    path: Array


@loop
def _evaluate(x, law, above, response):
    """Compute p, f, the slope of f, and df/dK of all contacts, where K is the constant."""
    c = law.pressed
    last = x.size
    for n in range(PAD, last):
        s = (x[n - 1] - x[n]) * above.inverse_length[n]
        # An open contact is treated as one that has just closed: p = -c, and the slope is 0.
        s = s if s > -c else -c
        p = hertz_power(s, c) if law.less == 0.5 else power(s, c, law.less)
        response.power[n] = p
        response.slope[n] = above.stiffness[n] * (c + p)
        response.force[n] = above.strength[n] * (c * (s + p) + s * p)
    if law.touching > 0.0:
        p, f = touch(x[PAD - 1] - x[PAD], law.touching, law.less)
        response.power[PAD] = p
        response.force[PAD] = f
        response.slope[PAD] = (law.less + 1.0) * law.touching * p
    # See `adjoint`: df/dK = (f - c F p) / K.
    for n in range(PAD, last):
        off = response.force[n] - response.at_rest[n] * response.power[n]
        response.soften[n] = off * response.inverse_constant[n]


@loop
def _move(bodies, force, kick, drift):
    """Kick and drift bodies (C-1,) by the forces (C,) between them."""
    apart()
    x, v, inverse_mass = bodies
    for n in range(v.size):
        faster = v[n] + kick * inverse_mass[n] * (force[n] - force[n + 1])
        v[n] = faster
        x[n] += drift * faster


@loop
def _change(bodies, response, change, kick, drift):
    """Kick and drift small changes of velocities v (C,) and of all bodies x (C+1,) but the last."""
    apart()
    x, v, inverse_mass = bodies
    power, force, slope, soften = response
    by_mass, by_constant, by_force = change
    # The first body has no contact above it.
    above = 0.0
    f_above = 0.0
    for n in range(v.size):
        below = slope[n] * (x[n] - x[n + 1]) + power[n] * by_force[n] + soften[n] * by_constant[n]
        faster = v[n] + kick * inverse_mass[n] * (above - below - (f_above - force[n]) * by_mass[n])
        v[n] = faster
        x[n] += drift * faster
        above = below
        f_above = force[n]


@loop
def _change_row(im, response, change, path, index, kick, drift):
    """Kick and drift small changes of bodies with inverse masses `im` by one row."""
    first = PAD
    last = im.size
    body = path.body
    contacts = slice(first, last)
    bodies = slice(first - 1, last - 1)
    of_contacts = (
        response.power[contacts],
        response.force[contacts],
        response.slope[contacts],
        response.soften[contacts],
    )
    for d in range(change.x.shape[0]):
        # A driven body follows its path; a force accelerates a body less if its mass grows.
        if body > 0:
            change.x[d, body] = change.path[d, index]
        elif body < 0:
            push = change.path[d, index] - path.imposed[index] * change.mass[d, -body]
            change.v[d, -body] += kick * im[-body] * push
        moved = Bodies(change.x[d, first - 1 : last], change.v[d, bodies], im[bodies])
        causes = change.mass[d, bodies], change.constant[d, contacts], change.force[d, contacts]
        _change(moved, of_contacts, causes, kick, drift)


@compiled_gradient()
def tangent(bodies, law, steps, stretch, path, memory, change, looks):
    """Advance bodies (W,), and small changes of them, by some rows as `forward` does.

    `memory` contains an `Above`, scratch space for a `ForceResponse`, and a (2, BURST) array. The
    changes of the observed values are stored in `looks`.
    """
    x, v, im = bodies
    above, response, room = memory
    look, row, count = stretch
    body = path.body
    inside = slice(PAD, x.size - 1)
    moved = Bodies(x[inside], v[inside], im[inside])
    done = 0
    while done < count:
        burst = min(BURST, count - done, count_rows(steps, look) - row)
        kick = room[0, :burst]
        drift = room[1, :burst]
        fill_rows(steps, look, row, kick, drift)
        for n in range(burst):
            index = done + n
            if body > 0:
                x[body] = path.imposed[index]
            _evaluate(x, law, above, response)
            # Changes are advanced before bodies, because both need the forces at the start of the
            # row.
            _change_row(im, response, change, path, index, kick[n], drift[n])
            if body < 0:
                v[-body] += kick[n] * im[-body] * path.imposed[index]
            _move(moved, response.force[PAD : x.size], kick[n], drift[n])
        row += burst
        done += burst
        if row == count_rows(steps, look):
            look += 1
            row = 0
            for n in range(looks.bodies.size):
                for d in range(change.x.shape[0]):
                    looks.values[d, 0, look, n] = change.x[d, looks.bodies[n]]
                    looks.values[d, 1, look, n] = change.v[d, looks.bodies[n]]
