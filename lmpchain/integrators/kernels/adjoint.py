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

from ...util.compilation import compiled_once
from .adjoint_rows import (
    _OPTIONS,
    _back_exact,
    _back_hertz,
    _back_other,
    _back_plain,
    _back_series,
    _back_short_series,
    _back_vacuum,
    _loop,
    _there_hertz,
    _there_other,
    _there_plain,
    _there_vacuum,
    at,
)
from .layout import BODY, PAD
from .right_hand_side import sweep
from .window import watch, widen

# where all contacts are pressed at rest: delta = 3/2 in strong and in any waves, any delta in weak waves and in the
# weakest; elsewhere, delta = 3/2 where nothing is pressed, in strong and in any waves, and any delta
UNDONE_PLAIN, UNDONE_EXACT, UNDONE_SERIES, UNDONE_SHORT, VACUUM, PLAIN, HERTZ, OTHER = range(8)
NEWS = "gradients of the native engine", 30
BURST = (
    32  # rows between two updates of the window, but on the way forth as many as there is room for
)
TILE = 384  # bodies that stay in the nearest cache while the rows of a burst pass over them


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
def _drift(course, look, q):
    """Return the drift, s, of the row before that of number q after a look; before a look there is none."""
    _, drifts, lengths, begun = course
    return (
        drifts[(q - 1) % drifts.size] * lengths[begun[look] + (q - 1) // drifts.size]
        if q > 0
        else 0.0
    )


@_loop
def _rows(course, look):
    """Return how many rows there are from a look to the next."""
    return course[1].size * (course[3][look + 1] - course[3][look]) + 1


@_loop
def _contacts(chain):
    """Return where the contacts of the window begin and end, those with what is held at its end left out."""
    first, last = chain.state.first, chain.state.last
    return first, last + PAD if chain.inverse_mass[last - 1] > 0.0 else last


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
        some = min(room.shape[1], count - done, _rows(course, look) - q)
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
    """Move a chain through some pieces of its run by the loops of the native engine.

    `course` is kicks (S+1,) and drifts (S,) as parts of a step, the lengths (K,) of all steps, s, and how many are
    made before each look. `seen` is the indices (G,) of bodies and room for their x and v at all looks. `path` is what
    is imposed in each row, if anything is, and `room` is (5, BURST) or longer. `pieces` is their first rows (P+1,), the
    looks before these and the rows in between, and where states (P+1, 2, W) and windows (P, 2) are kept.
    """
    starts, looks, rows, states, windows = pieces
    watch(chain)
    for piece in range(some[0], some[1]):
        begin, count = starts[piece] - starts[some[0]], starts[piece + 1] - starts[piece]
        _forward(
            chain, course, room, path[begin : begin + count], looks[piece], rows[piece], count, seen
        )
        kept_x, kept_v = states[piece + 1, 0], states[piece + 1, 1]
        for n in range(chain.x.size):
            kept_x[n] = chain.x[n]
        for n in range(chain.v.size):
            kept_v[n] = chain.v[n]
        windows[piece, 0], windows[piece, 1] = chain.state.first, chain.state.last
        watch(chain)


@_loop
def _touch(r, constant, less, row, tops):
    """Keep p and f of a first contact that only touches, and return f."""
    if r > 0.0:
        tops[0, row] = math.sqrt(r) if less == 0.5 else r**less
    else:
        tops[0, row] = 0.0
    tops[1, row] = constant * r * tops[0, row]
    return tops[1, row]


@_loop
def _keep(
    law, less, chain, table, course, room, path, look, q, count, powers, forces, tops, bodies
):
    """Move a chain by some rows as `forward` does, within its window, and keep p of all contacts.

    `table` is 1 / length, strength and delta strength / length of every contact, (3, W). `bodies` is x, v and the
    inverse masses, (3, W + PAD), each body one place further on, where what a contact moves begins a cache line.
    """
    x, v, im, il, st, c = bodies[0], bodies[1], bodies[2], table[0], table[1], chain.precompressed
    first, last = _contacts(chain)
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
                    f0 = _touch(x[PAD] - x[PAD + 1], chain.uncompressed, less, place, tops)
                    v[PAD + 1] += kick[row] * im[PAD + 1] * f0
                p = at(powers[place], a)
                moved = at(x, a), at(v, a), at(il, a), at(st, a), at(im, a)
                arguments = b - a, *moved, kick[row], drift[row], above, c
                if law == VACUUM:
                    carried[row] = _there_vacuum(*arguments, p)
                elif law == PLAIN:
                    carried[row] = _there_plain(*arguments, p)
                elif law == HERTZ:
                    carried[row] = _there_hertz(*arguments, p)
                else:
                    carried[row] = _there_other(*arguments, less, p, at(forces[place], a))
            if final:
                break
        q, done = q + some, done + some
        if q == _rows(course, look):
            look, q = look + 1, 0


@_loop
def _backward(
    law,
    less,
    chain,
    table,
    course,
    room,
    path,
    look,
    q,
    count,
    powers,
    forces,
    tops,
    bodies,
    seen,
    adjoint,
    on_path,
):
    """Take adjoints back by `count` rows, from that of number q after a look.

    A row is the drift before a kick, and the kick, here. `bodies` is as in `_keep`, but with momenta where rows are
    undone. `adjoint` is (5, W + PAD): that of x, that of v over the mass, sums over all rows of y p, times the
    stiffness (not in VACUUM), and of y f, y being the adjoint of the force of a contact, and what kicks do by the mass;
    all but those two sums are one place further on. `seen` has derivatives by what was seen, `on_path` gathers those by
    what is imposed in each row.
    """
    columns, looks = seen
    il, st, stiff, im, c = table[0], table[1], table[2], bodies[2], chain.precompressed
    x, momentum = bodies[0], bodies[1]
    adjoint_x, pull, sums_p, sums_f, sums_m = (
        adjoint[0],
        adjoint[1],
        adjoint[2],
        adjoint[3],
        adjoint[4],
    )
    first, last = _contacts(chain)
    body = int(chain.drive[BODY]) if path.size > 0 else 0
    touches = chain.uncompressed > 0.0 and first == PAD
    done = count
    while done > 0:
        if q == 0:
            for column in range(columns.size):
                here = columns[column] + 1
                adjoint_x[here] += looks[0, look, column]
                pull[here] += im[here] * looks[1, look, column]
            look -= 1
            q = _rows(course, look)
        some = min(BURST, done, q)
        each = 1 if body != 0 or touches else some  # rows between which nothing else is done
        kick, drift, fs, gs, before = room[0], room[1], room[2], room[3], room[4]
        _fill(course, look, q - some, kick[:some], drift[:some])
        before[0] = _drift(course, look, q - some)
        for row in range(1, some):
            before[row] = drift[row - 1]
        tile, together = _tiles(first, last, some)
        for begin in range(first, last, tile):
            final = begin + 2 * tile > last
            end = last if final else begin + tile
            sooner, shorter = 0 if begin == first or together > 1 else PAD, 0 if final else PAD
            for turn in range(0, some, each):
                row = some - 1 - turn
                place = done - some + row
                a, b = begin - sooner * turn, end - shorter * turn
                if body < 0 and a <= 1 - body < b:
                    w = kick[row] * pull[1 - body]
                    on_path[place] = w
                    sums_m[1 - body] += w * path[place]
                    momentum[1 - body] -= kick[row] * path[place]
                if begin == first and body > 0:
                    x[body + 1] = path[place]
                if begin == first and touches:
                    y, p0, f0 = kick[row] * pull[PAD + 1], tops[0, place], tops[1, place]
                    g = (less + 1.0) * chain.uncompressed * p0 * y
                    adjoint_x[PAD + 1] -= g
                    adjoint_x[PAD] += g
                    sums_p[PAD] += y * p0
                    sums_f[PAD] += y * f0
                    sums_m[PAD + 1] += y * f0
                span = row, each, a, b, sooner, shorter, begin == first
                kept = place * powers.shape[1] if law > UNDONE_SHORT else 0
                arguments = (
                    span, at(x, 0), at(momentum, 0), at(adjoint_x, 0), at(pull, 0), at(stiff, 0), at(st, 0), at(il, 0),
                    at(im, 0), at(kick, 0), at(before, 0), at(fs, 0), at(gs, 0), c, chain.coefficients,
                    at(powers[0], 0), at(forces[0], 0), kept, powers.shape[1], at(sums_p, 0), at(sums_f, 0),
                    at(sums_m, 0),
                )  # fmt: skip
                if law == UNDONE_PLAIN:
                    _back_plain(*arguments)
                elif law == UNDONE_EXACT:
                    _back_exact(*arguments)
                elif law == UNDONE_SERIES:
                    _back_series(*arguments)
                elif law == UNDONE_SHORT:
                    _back_short_series(*arguments)
                elif law == VACUUM:
                    _back_vacuum(*arguments)
                elif law <= HERTZ:
                    _back_hertz(*arguments)
                else:
                    _back_other(*arguments)
                if begin == first and body > 0:
                    on_path[place] = adjoint_x[body + 1]
                    adjoint_x[body + 1] = 0.0
            if final:
                break
        q, done = q - some, done - some


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def backward(
    law,
    less,
    chain,
    table,
    course,
    room,
    path,
    pieces,
    some,
    kept,
    bodies,
    seen,
    adjoint,
    on_path,
    everywhere,
):
    """Take adjoints back through some pieces of a run, the last one first.

    A piece is undone from its end, or made once more from its begin: `kept` is room for p and, if it does not follow
    from p, f of the contacts in it, and for those of a first one that only touches. The rest is as in `forward`,
    `_keep` and `_backward`; `everywhere` makes windows no narrower.
    """
    starts, looks, rows, states, windows = pieces
    powers, forces, tops = kept
    width = chain.x.size
    for piece in range(some[1] - 1, some[0] - 1, -1):
        begin, count = starts[piece] - starts[some[0]], starts[piece + 1] - starts[piece]
        known, drift = piece, 0.0
        if law <= UNDONE_SHORT:
            known, drift = piece + 1, _drift(course, looks[piece + 1], rows[piece + 1])
        x, v, im, kept_x, kept_v = (
            bodies[0],
            bodies[1],
            bodies[2],
            states[known, 0],
            states[known, 1],
        )
        for n in range(width):
            v[n + 1] = kept_v[n]
            if law <= UNDONE_SHORT:
                v[n + 1] = kept_v[n] / im[n + 1] if im[n + 1] > 0.0 else 0.0
        for n in range(width):
            x[n + 1] = kept_x[n] - drift * kept_v[n]
        chain.state.first = PAD if everywhere else windows[piece, 0]
        chain.state.last = width - PAD if everywhere else windows[piece, 1]
        part = slice(begin, begin + count)
        if law > UNDONE_SHORT:
            _keep(
                law, less, chain, table, course, room, path[part], looks[piece], rows[piece], count,
                powers, forces, tops, bodies,
            )  # fmt: skip
        _backward(
            law, less, chain, table, course, room, path[part], looks[piece + 1], rows[piece + 1], count,
            powers, forces, tops, bodies, seen, adjoint, on_path[part],
        )  # fmt: skip
