"""The tangent of a run by a kick-drift splitting, compiled; see `adjoint`."""

from __future__ import annotations

from typing import NamedTuple

from ...util.arrays import Array
from .adjoint import BURST
from .adjoint_rows import Bodies, hertz_power, power, touch
from .compiling import apart
from .course import compiled_gradient, count_rows, fill_rows, loop
from .layout import PAD


class ForceResponse(NamedTuple):
    """How the force of every contact answers to small changes, (W,) arrays.

    Attributes
    ----------
    power, force, slope : arrays
        p, f, and the derivative of f by r.
    soften : array
        What the constant does to f.
    inverse_constant, at_rest : arrays
        1 / constant, and what the contact carries at rest, N.
    """

    power: Array
    force: Array
    slope: Array
    soften: Array
    inverse_constant: Array
    at_rest: Array


class Directions(NamedTuple):
    """D directions: small changes of bodies, and of what the motion depends on.

    Attributes
    ----------
    x, v : (D, W) arrays
        Of displacements, m, and velocities, m/s; overwritten.
    mass, constant, force : (D, W) arrays
        Relative of masses; of constants, and of forces at rest, N.
    path : (D, rows) array
        Of what is imposed.
    """

    x: Array
    v: Array
    mass: Array
    constant: Array
    force: Array
    path: Array


@loop
def _evaluate(x, law, above, response):
    """Fill slope, p, f of the contacts, and what the constant does."""
    c = law.pressed
    last = x.size
    for n in range(PAD, last):
        s = (x[n - 1] - x[n]) * above.inverse_length[n]
        # an open contact is one that is just closed: p = -c, and no slope
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
    # df/dK = (f - c F p) / K, see `adjoint`
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
    """Kick and drift small changes of the bodies x (C+1,) but the last, as fast as v (C,)."""
    apart()
    x, v, inverse_mass = bodies
    power, force, slope, soften = response
    by_mass, by_constant, by_force = change
    # the first body has no contact above it
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
    """Kick and drift small changes of bodies with these inverse masses by a row."""
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
        # a body that is driven is where its path is; a push gives way as the mass grows
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
    """Move bodies (W,), and small changes of them, by some rows as `forward` does.

    `memory` is `Above`, room for a `ForceResponse`, and (2, BURST). `looks` takes changes of what
    is seen.
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
            # deviations before bodies: both take the forces that the row begins with
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
