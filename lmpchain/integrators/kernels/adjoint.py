"""A kick-drift splitting with what its derivatives need, its adjoint, and its tangent, compiled.

The force of a contact less that at rest is ``f = F [c s + c p + s p]`` with ``s = r / length`` and
``p = (c + s)^(delta-1) - c``, nothing where c + s < 0; c is 1 where the contact is pressed at rest (F its force then,
the length its overlap) and 0 where it only touches (F = K, length 1 m). Derivatives with respect to r, and to the force
at rest and the constant K of a pressed contact, follow from p and f without cancellation, for waves of any strength:

    df/dr = delta F (c + p) / length,     df/dF = p at fixed K,     df/dK = (f - c F p) / K at fixed F.

For delta = 3/2, f itself is ``F p (3 c + p (3 c + p))``, so that p is all that the way back must know of a contact.
Chains lie in rows of W bodies as in `layout`; a contact has the index of the body below it. A row of the run is a kick
and a drift; the last kick of a step and the first of the next are one, but where grains are looked at between them.
"""

from __future__ import annotations

import math
from typing import Any

import numba
from numba import types

from ...util.compilation import compiled_once
from .contact_forces import _exp, _inline, _log
from .layout import BODY, FIRST, LAST, PAD
from .right_hand_side import sweep
from .window import widen

PLAIN, HERTZ, OTHER = range(3)  # delta = 3/2 in strong waves, or in any; any delta
NEWS = "gradients of the native engine", 30
BURST = 32  # rows between two updates of the window
TILE = 384  # bodies that stay in the nearest cache while the rows of a burst pass over them
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"nnan", "ninf", "nsz", "contract"}, "_nrt": False}
_loop = numba.njit(**_OPTIONS)


@_inline
def apart(typing: Any) -> Any:
    """Tell the compiler that no two arrays that a function takes overlap, or it checks that again and again."""

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
        """Kick and drift the bodies x (C+1,) but the last, as fast as v (C,), and keep p; return the last force."""
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


def _back(kept: bool) -> Any:
    """Make the loop of the way back, with forces that were kept or follow from p."""

    @_loop
    def back(x, v, stiff, strength, inverse_mass, kick, drift, before, c, power, force, sums_p, sums_f, sums_m):
        """Take adjoints of bodies v (C,) and x (C+1,), from the one above on, back through a drift and a kick.

        `before` and what is returned are w, the adjoint of the momentum gained, stiffness and force at either end.
        """
        apart()
        w_before, g_before, f_before = before
        for n in range(v.size):
            faster = v[n] + drift * x[n + 1]
            v[n] = faster
            w = kick * inverse_mass[n] * faster
            y = w - w_before  # the adjoint of the force
            p = power[n]
            f = force[n] if kept else strength[n] * p * (3.0 * c + p * (3.0 * c + p))
            g = stiff[n] * (c + p) * y
            sums_p[n] += y * p
            sums_f[n] += y * f
            sums_m[n] += w_before * (f_before - f)
            x[n] += g - g_before
            w_before, g_before, f_before = w, g, f
        return w_before, g_before, f_before

    return back


_back_hertz, _back_other = _back(False), _back(True)


@_loop
def _fill(course, look, q, kick, drift):
    """Fill kick and drift (Q,), s, of the rows from that of number q after a look on."""
    kicks, drifts, lengths, begun = course
    stages = drifts.size
    at, stage = begun[look] + q // stages, q % stages
    for row in range(kick.size):
        if at == begun[look + 1]:
            kick[row], drift[row] = kicks[stages] * lengths[at - 1], 0.0
            return
        kick[row], drift[row] = kicks[stage] * lengths[at], drifts[stage] * lengths[at]
        if stage == 0 and at > begun[look]:
            kick[row] += kicks[stages] * lengths[at - 1]
        stage += 1
        if stage == stages:
            at, stage = at + 1, 0


@_loop
def _rows(course, look):
    """Return how many rows there are from a look to the next."""
    return course[1].size * (course[3][look + 1] - course[3][look]) + 1


@_loop
def _tiles(first, last, rows):
    """Return the bodies of a tile and how many rows are done together."""
    whole = last - first <= 2 * TILE
    return (last - first if whole else TILE), (rows if whole else 1)


@_loop
def _forward(chain, course, room, path, look, q, count, seen):
    """Move a chain by `count` rows, from that of number q after a look on, as the native engine does."""
    columns, looks = seen
    done = 0
    while done < count:
        some = min(BURST, count - done, _rows(course, look) - q)
        kick, drift, carried = room[0, :some], room[1, :some], room[2, :some]
        _fill(course, look, q, kick, drift)
        widen(chain, some + 1)
        sweep(chain, kick, drift, carried, path[done : done + some])
        q, done = q + some, done + some
        if q == _rows(course, look):
            look, q = look + 1, 0
            for column in range(columns.size):
                looks[0, look, column] = chain.x[columns[column]]
                looks[1, look, column] = chain.v[columns[column]]


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def forward(chain, course, room, path, pieces, some, seen):
    """Move a chain through the pieces some[0] ... some[1] - 1 of its run by the loops of the native engine.

    `course` is kicks (S+1,) and drifts (S,) as parts of a step, the lengths (K,) of all steps, s, and how many are
    made before each look. `seen` is the indices (G,) of bodies and room for their x and v at all looks. `path` is what
    is imposed in each row, if anything is, and `room` is (5, BURST). `pieces` is their first rows (P+1,), the looks
    before these and the rows in between, and where states (P, 2, W) and windows (P, 2) are kept.
    """
    starts, looks, rows, states, windows = pieces
    for piece in range(some[0], some[1]):
        begin, count = starts[piece] - starts[some[0]], starts[piece + 1] - starts[piece]
        for n in range(chain.x.size):
            states[piece, 0, n], states[piece, 1, n] = chain.x[n], chain.v[n]
        _forward(chain, course, room, path[begin : begin + count], looks[piece], rows[piece], count, seen)
        windows[piece, 0], windows[piece, 1] = chain.state[FIRST], chain.state[LAST]


@_loop
def _touch(law, r, constant, less, row, tops):
    """Keep p and f of a first contact that only touches, and return f."""
    if r > 0.0:
        tops[0, row] = math.sqrt(r) if law <= HERTZ else r**less
    else:
        tops[0, row] = 0.0
    tops[1, row] = constant * r * tops[0, row]
    return tops[1, row]


@_loop
def _keep(law, less, chain, table, course, room, path, look, q, count, powers, forces, tops, bodies):
    """Move a chain by some rows as `forward` does, within its window, and keep p of all contacts.

    `table` is 1 / length, strength and delta strength / length of every contact, (3, W). `bodies` is x, v and the
    inverse masses, (3, W + PAD), each body one place further on, where what a contact moves begins a cache line.
    """
    x, v, im, il, st, c = bodies[0], bodies[1], bodies[2], table[0], table[1], chain.precompressed
    first, last = int(chain.state[FIRST]), int(chain.state[LAST]) + PAD
    body = int(chain.drive[BODY]) if path.size > 0 else 0
    done = 0
    while done < count:
        some = min(BURST, count - done, _rows(course, look) - q)
        kick, drift, carried = room[0, :some], room[1, :some], room[2, :some]
        _fill(course, look, q, kick, drift)
        tile, together = _tiles(first, last, some)
        for begin in range(first, last, tile):
            final = begin + 2 * tile > last
            end = last if final else begin + tile
            for row in range(some):
                a = begin if begin == first or together > 1 else begin - PAD * row
                b = end if final else end - PAD * row
                place = done + row
                above = carried[row]
                if begin == first:
                    above = 0.0
                    if body > 0:
                        x[body + 1] = path[place]
                if body < 0 and a <= 1 - body < b:
                    v[1 - body] += kick[row] * im[1 - body] * path[place]
                if begin == first and chain.uncompressed > 0.0 and first == PAD:
                    f0 = _touch(law, x[PAD] - x[PAD + 1], chain.uncompressed, less, place, tops)
                    v[PAD + 1] += kick[row] * im[PAD + 1] * f0
                some_x, some_v, m = x[a : b + 1], v[a:b], im[a:b]
                p = powers[place, a:b]
                if law == PLAIN:
                    carried[row] = _there_plain(some_x, some_v, il[a:b], st[a:b], m, kick[row], drift[row], above, c, p)
                elif law == HERTZ:
                    carried[row] = _there_hertz(some_x, some_v, il[a:b], st[a:b], m, kick[row], drift[row], above, c, p)
                else:
                    carried[row] = _there_other(
                        some_x, some_v, il[a:b], st[a:b], m, kick[row], drift[row], above, c, less,
                        p, forces[place, a:b],
                    )  # fmt: skip
            if final:
                break
        q, done = q + some, done + some
        if q == _rows(course, look):
            look, q = look + 1, 0


@_loop
def _backward(
    law, less, chain, table, course, room, path, look, q, count, powers, forces, tops, seen, adjoint, on_path
):
    """Take adjoints back by `count` rows, from that of number q after a look.

    `seen` has derivatives by what was seen. `adjoint` is (5, W + PAD): those of x and v, sums of y p and y f over all
    rows, y being the adjoint of the force of a contact, and what kicks do by the mass; the first and the last are one
    place further on. `on_path` gathers derivatives by what is imposed in each row.
    """
    columns, looks = seen
    st, stiff, im, c = table[1], table[2], chain.inverse_mass, chain.precompressed
    x, v, sums_p, sums_f, sums_m = adjoint[0], adjoint[1], adjoint[2], adjoint[3], adjoint[4]
    first, last = int(chain.state[FIRST]), int(chain.state[LAST]) + PAD
    body = int(chain.drive[BODY]) if path.size > 0 else 0
    done = count
    while done > 0:
        if q == 0:
            for column in range(columns.size):
                x[columns[column] + 1] += looks[0, look, column]
                v[columns[column]] += looks[1, look, column]
            look -= 1
            q = _rows(course, look)
        some = min(BURST, done, q)
        kick, drift, carried = room[0, :some], room[1, :some], room[2:5, :some]
        _fill(course, look, q - some, kick, drift)
        tile, together = _tiles(first, last, some)
        for begin in range(first, last, tile):
            final = begin + 2 * tile > last
            end = last if final else begin + tile
            for turn in range(some):
                row = some - 1 - turn
                place = done - some + row
                a = begin if begin == first or together > 1 else begin - PAD * turn
                b = end if final else end - PAD * turn
                before = carried[0, row], carried[1, row], carried[2, row]
                if begin == first:
                    before = 0.0, 0.0, 0.0
                if body < 0 and a <= -body < b:
                    w = kick[row] * im[-body] * (v[-body] + drift[row] * x[1 - body])
                    on_path[place] = w
                    sums_m[1 - body] += w * path[place]
                p = powers[place, a:b]
                if law <= HERTZ:
                    before = _back_hertz(
                        x[a : b + 1], v[a:b], stiff[a:b], st[a:b], im[a:b], kick[row], drift[row], before, c, p,
                        forces[0], sums_p[a:b], sums_f[a:b], sums_m[a:b],
                    )  # fmt: skip
                else:
                    before = _back_other(
                        x[a : b + 1], v[a:b], stiff[a:b], st[a:b], im[a:b], kick[row], drift[row], before, c, p,
                        forces[place, a:b], sums_p[a:b], sums_f[a:b], sums_m[a:b],
                    )  # fmt: skip
                carried[0, row], carried[1, row], carried[2, row] = before
                if begin == first and chain.uncompressed > 0.0 and first == PAD:
                    y, p0, f0 = kick[row] * im[PAD] * v[PAD], tops[0, place], tops[1, place]
                    g = (less + 1.0) * chain.uncompressed * p0 * y
                    x[PAD + 1] -= g
                    x[PAD] += g
                    sums_p[PAD] += y * p0
                    sums_f[PAD] += y * f0
                    sums_m[PAD + 1] += y * f0
                if begin == first and body > 0:
                    on_path[place] = x[body + 1]
                    x[body + 1] = 0.0
            if final:
                break
        q, done = q - some, done - some


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def backward(
    law, less, chain, table, course, room, path, pieces, some, kept, bodies, seen, adjoint, on_path, everywhere
):
    """Make the pieces some[0] ... some[1] - 1 of a run again, the last one first, and take adjoints back through them.

    `kept` is room for p and, if it does not follow from p, f of the contacts in a piece, and for those of a first one
    that only touches. The rest is as in `forward`, `_keep` and `_backward`; `everywhere` makes windows no narrower.
    """
    starts, looks, rows, states, windows = pieces
    powers, forces, tops = kept
    width = chain.x.size
    for piece in range(some[1] - 1, some[0] - 1, -1):
        begin, count = starts[piece] - starts[some[0]], starts[piece + 1] - starts[piece]
        for n in range(width):
            bodies[0, n + 1], bodies[1, n + 1] = states[piece, 0, n], states[piece, 1, n]
        chain.state[FIRST] = PAD if everywhere else windows[piece, 0]
        chain.state[LAST] = width - PAD if everywhere else windows[piece, 1]
        part = slice(begin, begin + count)
        _keep(
            law, less, chain, table, course, room, path[part], looks[piece], rows[piece], count,
            powers, forces, tops, bodies,
        )  # fmt: skip
        _backward(
            law, less, chain, table, course, room, path[part], looks[piece + 1], rows[piece + 1], count,
            powers, forces, tops, seen, adjoint, on_path[part],
        )  # fmt: skip


@_loop
def _evaluate(law, less, chain, table, row, first, last, tops, near):
    """Fill slope, p, f of the contacts, and what the constant does; `near` is as in `tangent`."""
    c, power, force, slope, soften = chain.precompressed, near[0], near[1], near[2], near[3]
    for n in range(first, last):
        s = (chain.x[n - 1] - chain.x[n]) * table[0, n]
        s = s if s > -c else -c
        p = _hertz(s, c) if law <= HERTZ else _other(s, c, less)
        power[n], slope[n] = p, table[2, n] * (c + p)
        force[n] = table[1, n] * (c * (s + p) + s * p)
    if chain.uncompressed > 0.0 and first == PAD:
        force[PAD] = _touch(law, chain.x[PAD - 1] - chain.x[PAD], chain.uncompressed, less, 0, tops)
        power[PAD] = tops[0, 0]
        slope[PAD] = (less + 1.0) * chain.uncompressed * power[PAD]
    for n in range(first, last):
        soften[n] = (force[n] - near[5, n] * power[n]) * near[4, n]


@_loop
def _move(x, v, inverse_mass, force, kick, drift):
    """Kick and drift bodies x and v (C-1,) by the forces (C,) between them."""
    apart()
    for n in range(v.size):
        faster = v[n] + kick * inverse_mass[n] * (force[n] - force[n + 1])
        v[n] = faster
        x[n] += drift * faster


@_loop
def _change(x, v, inverse_mass, slope, power, force, soften, by_force, by_constant, by_mass, kick, drift):
    """Kick and drift small changes of the bodies x (C+1,) but the last, as fast as v (C,)."""
    apart()
    above, f_above = 0.0, 0.0
    for n in range(v.size):
        below = slope[n] * (x[n] - x[n + 1]) + power[n] * by_force[n] + soften[n] * by_constant[n]
        faster = v[n] + kick * inverse_mass[n] * (above - below - (f_above - force[n]) * by_mass[n])
        v[n] = faster
        x[n] += drift * faster
        above, f_above = below, force[n]


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def tangent(law, less, chain, table, course, room, path, look, q, count, near, tops, change, dx, dv, seen):
    """Move a chain, and D small changes dx and dv (D, W) of it, by some rows as `forward` does.

    `near` is (6, W): room for four, the inverse of the constant of every contact and what it carries at rest. `change`
    has directions: relative masses, constants and forces at rest (D, W) each, and what is imposed (D, rows).
    """
    columns, looks = seen
    by_mass, by_constant, by_force, by_path = change
    im, first, last = chain.inverse_mass, PAD, chain.x.size
    body = int(chain.drive[BODY]) if path.size > 0 else 0
    done = 0
    while done < count:
        some = min(BURST, count - done, _rows(course, look) - q)
        kick, drift = room[0, :some], room[1, :some]
        _fill(course, look, q, kick, drift)
        for row in range(some):
            place = done + row
            if body > 0:
                chain.x[body] = path[place]
            _evaluate(law, less, chain, table, 0, first, last, tops, near)
            for d in range(dx.shape[0]):
                if body > 0:
                    dx[d, body] = by_path[d, place]
                elif body < 0:
                    dv[d, -body] += kick[row] * im[-body] * (by_path[d, place] - path[place] * by_mass[d, -body])
                _change(
                    dx[d, first - 1 : last], dv[d, first - 1 : last - 1], im[first - 1 : last - 1], near[2, first:last],
                    near[0, first:last], near[1, first:last], near[3, first:last], by_force[d, first:last],
                    by_constant[d, first:last], by_mass[d, first - 1 : last - 1], kick[row], drift[row],
                )  # fmt: skip
            if body < 0:
                chain.v[-body] += kick[row] * im[-body] * path[place]
            _move(
                chain.x[first : last - 1], chain.v[first : last - 1], im[first : last - 1], near[1, first:last],
                kick[row], drift[row],
            )  # fmt: skip
        q, done = q + some, done + some
        if q == _rows(course, look):
            look, q = look + 1, 0
            for column in range(columns.size):
                for d in range(dx.shape[0]):
                    looks[d, 0, look, column] = dx[d, columns[column]]
                    looks[d, 1, look, column] = dv[d, columns[column]]
