"""A kick-drift splitting with what its derivatives need, its adjoint, and its tangent, compiled.

The force of a contact less that at rest is ``f = F [c s + c p + s p]`` with ``s = r / length`` and
``p = (c + s)^(delta-1) - c``, nothing where c + s < 0; c is 1 where the contact is pressed at rest
(F its force then, the length its overlap) and 0 where it only touches (F = K, length 1 m).
Derivatives with respect to r, and to the force at rest and the constant K of a pressed contact,
follow from p and f without cancellation, for waves of any strength:

    df/dr = delta F (c + p) / length,   df/dF = p at fixed K,   df/dK = (f - c F p) / K at fixed F.

For delta = 3/2, f itself is ``F p (3 c + p (3 c + p))``, so that p is all that the way back must
know of a contact. Chains lie in rows of W bodies as in `layout`; a contact has the index of the
body below it. A row of the run is a kick and a drift; the last kick of a step and the first of the
next are one, but where grains are looked at between them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .adjoint_rows import (
    Above,
    Adjoint,
    AdjointSpan,
    BackRows,
    Bodies,
    KeptRows,
    Way,
    at,
    back_rows,
    keep_row,
    touch,
)
from .course import Stretch, compiled_gradient, count_rows, drift_before, fill_rows, loop
from .layout import PAD, Rows
from .right_hand_side import sweep
from .sample_loop import chain_of
from .window import watch, widen

# rows between two updates of the window, but on the way forth as many as there is room for
BURST = 32
# bodies that stay in the nearest cache while the rows of a burst pass over them
INNER_TILE = 384


class Pieces(NamedTuple):
    """Pieces of a run between checkpoints.

    Attributes
    ----------
    starts : (P+1,) array
        Their first rows.
    looks, rows : (P+1,) arrays
        The looks before these, and the rows in between.
    states : (P+1, 2, W) array
        Displacements and velocities there.
    windows : (P, 2) array
        First body of the window and the one behind its last at the end of each piece.
    """

    starts: NDArray[np.int64]
    looks: NDArray[np.int64]
    rows: NDArray[np.int64]
    states: Array
    windows: NDArray[np.int64]


class ImposedPath(NamedTuple):
    """The imposed motion or force in each row, and derivatives with respect to it.

    `body` is the one that is driven, or less than 0 the one that is pushed; 0 if none is.
    """

    body: int
    imposed: Array
    derivative: Array


class Memory(NamedTuple):
    """Arrays for the way back.

    Attributes
    ----------
    bodies, adjoint : Bodies and Adjoint of (W + PAD,) arrays
        Each body one place further on, where what a contact moves begins a cache line, but not the
        sums over contacts.
    above : Above of (W,) arrays
    powers, forces : (rows, W) arrays
        p and f of contacts that are kept.
    tops : (2, rows) array
        Those of a first contact that only touches.
    room : (5, BURST) array, or longer
    """

    bodies: Bodies
    adjoint: Adjoint
    above: Above
    powers: Array
    forces: Array
    tops: Array
    room: Array


class Tile(NamedTuple):
    """Contacts that stay in the cache while rows pass over them.

    Attributes
    ----------
    begin, end : int
        From the first to the one behind the last, in the first row that is done.
    sooner, shorter : int
        By how many places they begin and end earlier with every row that is done.
    top, final : bool
        Whether there is no tile above, or none below.
    touches : bool
        Whether the first contact is one that only touches.
    """

    begin: int
    end: int
    sooner: int
    shorter: int
    top: bool
    final: bool
    touches: bool


@loop
def _tile(first, last, number, touching):
    """Return the tile of this number of the contacts first ... last-1."""
    # every row of a tile lies a cache line above the one before, so that it needs nothing of the
    # tile below; the last tile takes what would be too short for one
    single = last - first <= 2 * INNER_TILE
    begin = first + number * INNER_TILE
    top = number == 0
    touches = top and first == PAD and touching > 0.0
    final = single or begin + 2 * INNER_TILE > last
    end = last if final else begin + INNER_TILE
    return Tile(begin, end, 0 if top else PAD, 0 if final else PAD, top, final, touches)


@loop
def _forward(chain, steps, room, path, stretch, looks):
    """Move a chain by some rows as the native engine does."""
    look, row, count = stretch
    done = 0
    while done < count:
        burst = min(room.shape[1], count - done, count_rows(steps, look) - row)
        imposed = path[done : done + burst]
        rows = Rows(
            kick=room[0, :burst], drift=room[1, :burst], carried=room[2, :burst], path=imposed
        )
        fill_rows(steps, look, row, rows.kick, rows.drift)
        # each row reaches one grain further
        widen(chain, burst + 1)
        sweep(chain, rows)
        row += burst
        done += burst
        if row == count_rows(steps, look):
            look += 1
            row = 0
            for n in range(looks.bodies.size):
                looks.values[0, look, n] = chain.x[looks.bodies[n]]
                looks.values[1, look, n] = chain.v[looks.bodies[n]]


@compiled_gradient()
def forward(chains, steps, room, path, pieces, numbers, looks):
    """Move the chain of a batch of one through the pieces numbers[0] ... numbers[1]-1 of its run.

    The loops are those of the native engine. `path` is what is imposed in each row, if anything is,
    and `room` is (5, BURST) or longer.
    """
    chain = chain_of(chains, 0, 0)
    starts = pieces.starts
    watch(chain)
    for piece in range(numbers[0], numbers[1]):
        begin = starts[piece] - starts[numbers[0]]
        count = starts[piece + 1] - starts[piece]
        stretch = Stretch(pieces.looks[piece], pieces.rows[piece], count)
        _forward(chain, steps, room, path[begin : begin + count], stretch, looks)
        x = pieces.states[piece + 1, 0]
        v = pieces.states[piece + 1, 1]
        for n in range(chain.x.size):
            x[n] = chain.x[n]
        for n in range(chain.v.size):
            v[n] = chain.v[n]
        pieces.windows[piece, 0] = chain.state.first
        pieces.windows[piece, 1] = chain.state.last
        watch(chain)


@loop
def _keep_top(law, memory, kick, index):
    """Kick grain 1 by a contact with the top wall that only touches, and keep p and f of it."""
    x, v, inverse_mass = memory.bodies
    p, f = touch(x[PAD] - x[PAD + 1], law.touching, law.less)
    memory.tops[0, index] = p
    memory.tops[1, index] = f
    v[PAD + 1] += kick * inverse_mass[PAD + 1] * f


@loop
def _keep_tile(law, path, memory, tile, row, index):
    """Move the bodies of a tile by a row, and keep p of their contacts in the row `index`."""
    x, v, im = memory.bodies
    il, st, stiff = memory.above
    kick = memory.room[0, row]
    drift = memory.room[1, row]
    carried = memory.room[2]
    a = tile.begin - tile.sooner * row
    b = tile.end - tile.shorter * row
    body = path.body
    imposed = path.imposed
    if tile.top and body > 0:
        x[body + 1] = imposed[index]
    if body < 0 and a <= 1 - body < b:
        v[1 - body] += kick * im[1 - body] * imposed[index]
    if tile.touches:
        _keep_top(law, memory, kick, index)
    carried[row] = keep_row(
        law.way,
        b - a,
        Bodies(at(x, a), at(v, a), at(im, a)),
        Above(at(il, a), at(st, a), at(stiff, a)),
        kick,
        drift,
        0.0 if tile.top else carried[row],
        law,
        _kept_rows(memory, index * memory.powers.shape[1] + a),
    )


@loop
def _keep(law, steps, stretch, path, memory, contacts):
    """Move a chain by some rows within its window, and keep p of all contacts."""
    first, last = contacts
    look, row, count = stretch
    done = 0
    while done < count:
        burst = min(BURST, count - done, count_rows(steps, look) - row)
        fill_rows(steps, look, row, memory.room[0, :burst], memory.room[1, :burst])
        for number in range((last - first) // INNER_TILE + 1):
            tile = _tile(first, last, number, law.touching)
            for turn in range(burst):
                _keep_tile(law, path, memory, tile, turn, done + turn)
            if tile.final:
                break
        row += burst
        done += burst
        if row == count_rows(steps, look):
            look += 1
            row = 0


@loop
def _kept_rows(memory, begin):
    """Return p and f that are kept, from a place on."""
    width = memory.powers.shape[1]
    return KeptRows(at(memory.powers[0], 0), at(memory.forces[0], 0), begin, width)


@loop
def _take_looks(looks, look, bodies, adjoint):
    """Take in the derivatives by what was seen at a look."""
    for n in range(looks.bodies.size):
        body = looks.bodies[n] + 1
        adjoint.x[body] += looks.values[0, look, n]
        adjoint.pull[body] += bodies.inverse_mass[body] * looks.values[1, look, n]


@loop
def _back_push(body, kick, index, path, memory):
    """Take adjoints back through the kick by which a body is pushed."""
    weight = kick * memory.adjoint.pull[body]
    path.derivative[index] = weight
    memory.adjoint.mass[body] += weight * path.imposed[index]
    memory.bodies.v[body] -= kick * path.imposed[index]


@loop
def _back_top(law, kick, index, memory):
    """Take adjoints back through the kick by a contact with the top wall that only touches."""
    adjoint = memory.adjoint
    p = memory.tops[0, index]
    f = memory.tops[1, index]
    y = kick * adjoint.pull[PAD + 1]
    g = (law.less + 1.0) * law.touching * p * y
    adjoint.x[PAD + 1] -= g
    adjoint.x[PAD] += g
    adjoint.power[PAD] += y * p
    adjoint.force[PAD] += y * f
    adjoint.mass[PAD + 1] += y * f


@loop
def _fill_back(steps, look, row, room, burst):
    """Return kicks and the drifts before them of some rows, with room for their borders."""
    kick = room[0]
    drift = room[1]
    before = room[4]
    fill_rows(steps, look, row, kick[:burst], drift[:burst])
    before[0] = drift_before(steps, look, row)
    for n in range(1, burst):
        before[n] = drift[n - 1]
    return BackRows(at(kick, 0), at(before, 0), at(room[2], 0), at(room[3], 0))


@loop
def _back_tile(law, path, memory, rows, tile, span):
    """Take adjoints back through the contacts of a tile in some rows.

    `span` is the last of these rows, and how many.

    Where something is imposed, or the first contact only touches, rows are done one by one.
    """
    x, momentum, im = memory.bodies
    il, st, stiff = memory.above
    adjoint = memory.adjoint
    width = memory.powers.shape[1] if law.way > Way.UNDONE_SHORT else 0
    body = path.body
    last, burst = span
    # a call for all rows costs less, but leaves no moment at which to add a push
    single = body != 0 or tile.touches
    for turn in range(0, burst, 1 if single else burst):
        row = burst - 1 - turn
        index = last - turn
        a = tile.begin - tile.sooner * turn
        b = tile.end - tile.shorter * turn
        if body < 0 and a <= 1 - body < b:
            _back_push(1 - body, rows.kicks[row], index, path, memory)
        if tile.top and body > 0:
            x[body + 1] = path.imposed[index]
        if tile.touches:
            _back_top(law, rows.kicks[row], index, memory)
        back_rows(
            law.way,
            AdjointSpan(row, 1 if single else burst, a, b, tile.sooner, tile.shorter, tile.top),
            rows,
            Bodies(at(x, 0), at(momentum, 0), at(im, 0)),
            Above(at(il, 0), at(st, 0), at(stiff, 0)),
            Adjoint(
                at(adjoint.x, 0),
                at(adjoint.pull, 0),
                at(adjoint.power, 0),
                at(adjoint.force, 0),
                at(adjoint.mass, 0),
            ),
            law,
            _kept_rows(memory, index * width),
        )
        if tile.top and body > 0:
            path.derivative[index] = adjoint.x[body + 1]
            adjoint.x[body + 1] = 0.0


@loop
def _backward(law, steps, stretch, looks, path, memory, contacts):
    """Take adjoints back by some rows, from that of a number after a look.

    A row is the drift before a kick, and the kick, here.
    """
    first, last = contacts
    look, row, done = stretch
    while done > 0:
        if row == 0:
            _take_looks(looks, look, memory.bodies, memory.adjoint)
            look -= 1
            row = count_rows(steps, look)
        burst = min(BURST, done, row)
        rows = _fill_back(steps, look, row - burst, memory.room, burst)
        for number in range((last - first) // INNER_TILE + 1):
            tile = _tile(first, last, number, law.touching)
            _back_tile(law, path, memory, rows, tile, (done - 1, burst))
            if tile.final:
                break
        row -= burst
        done -= burst


@compiled_gradient()
def backward(law, steps, pieces, numbers, looks, path, memory):
    """Take adjoints back through some pieces of a run, the last one first.

    A piece is undone from its end, or made once more from its begin. `looks` has derivatives by
    what was seen; the rest is as in `forward`.
    """
    x, v, im = memory.bodies
    width = pieces.states.shape[2]
    starts = pieces.starts
    undone = law.way <= Way.UNDONE_SHORT
    for piece in range(numbers[1] - 1, numbers[0] - 1, -1):
        begin = starts[piece] - starts[numbers[0]]
        count = starts[piece + 1] - starts[piece]
        state_x = pieces.states[piece + undone, 0]
        state_v = pieces.states[piece + undone, 1]
        back = Stretch(pieces.looks[piece + 1], pieces.rows[piece + 1], count)
        drift = drift_before(steps, back.look, back.row) if undone else 0.0
        for n in range(width):
            v[n + 1] = state_v[n]
            # momenta, of which a row that is undone takes its impulses back as they are
            if undone:
                v[n + 1] = state_v[n] / im[n + 1] if im[n + 1] > 0.0 else 0.0
        # a row begins with a drift on the way back: the one before the checkpoint is undone first
        for n in range(width):
            x[n + 1] = state_x[n] - drift * state_v[n]
        first = pieces.windows[piece, 0]
        last = pieces.windows[piece, 1]
        # the contact below the last body is one of them, unless that is held
        contacts = first, last + PAD if im[last] > 0.0 else last
        rows = slice(begin, begin + count)
        of_piece = ImposedPath(path.body, path.imposed[rows], path.derivative[rows])
        if not undone:
            forth = Stretch(pieces.looks[piece], pieces.rows[piece], count)
            _keep(law, steps, forth, of_piece, memory, contacts)
        _backward(law, steps, back, looks, of_piece, memory, contacts)
