"""A kick-drift splitting that records values for its derivatives, and its adjoint, compiled.

The force of a contact minus its force at rest is ``f = F [c s + c p + s p]`` with
``s = r / length`` and ``p = (c + s)^(delta-1) - c``; r is the approach of the two bodies from rest,
and an open contact (c + s < 0) exerts no force. For a contact that is compressed at rest, c is 1, F
is its force at rest, and the length is its overlap. For a contact that touches without a force, c
is 0, F = K, and the length is 1 m. Derivatives of f with respect to r, to the force at rest and to
the constant K of a compressed contact follow from p and f without cancellation, for waves of any
strength:

    df/dr = delta F (c + p) / length,   df/dF = p at fixed K,   df/dK = (f - c F p) / K at fixed F.

For delta = 3/2, f is ``F p (3 c + p (3 c + p))``, so that the reverse pass needs only p of each
contact. Chains are stored in rows of W bodies as in `layout`, and a contact has the index of the
body below it. A row of the run is a kick and a drift. The last kick of a step and the first kick
of the next step form one row, unless grains are observed between them.
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
from .layout import PAD, Rows
from .right_hand_side import sweep
from .sample_loop import (
    Stretch,
    chain_of,
    compiled_gradient,
    count_rows,
    drift_before,
    fill_rows,
    loop,
)
from .window import watch, widen

# Largest number of rows between two updates of the window; the forward pass uses longer bursts.
BURST = 32
# Number of bodies that fit into the innermost cache while the rows of a burst pass over them.
INNER_TILE = 384


class Pieces(NamedTuple):
    """Pieces of a run between checkpoints.

    Attributes
    ----------
    starts : (P+1,) array
        Number of the first row of each piece.
    looks : (P+1,) array
        Number of the last observation before each piece.
    rows : (P+1,) array
        Number of rows from this observation to the start of each piece.
    states : (P+1, 2, W) array
        Displacements and velocities at the start of each piece.
    windows : (P, 2) array
        First body of the window, and the body after its last one, at the end of each piece.
    """

    starts: NDArray[np.int64]
    looks: NDArray[np.int64]
    rows: NDArray[np.int64]
    states: Array
    windows: NDArray[np.int64]


class ImposedPath(NamedTuple):
    """The imposed motion or force in each row, and derivatives with respect to it.

    Attributes
    ----------
    body : int
        Index of the driven body; minus the index of the body on which a force acts; 0 if nothing is
        imposed.
    imposed : (rows,) array
        Imposed displacement, m, or force, N, in each row.
    derivative : (rows,) array
        Derivative of the objective with respect to each imposed value; filled by the reverse pass.
    """

    body: int
    imposed: Array
    derivative: Array


class Memory(NamedTuple):
    """Scratch arrays of the reverse pass.

    Attributes
    ----------
    bodies : Bodies of (W + PAD,) arrays
        State of the bodies, shifted by one place, so that the body below a contact begins a cache
        line.
    adjoint : Adjoint of (W + PAD,) arrays
        Derivatives by the state of the bodies, shifted by one place, and sums over contacts, which
        are not shifted.
    above : Above of (W,) arrays
        Properties of the contact above each body.
    powers : (rows, W) array
        Stored p of contacts.
    forces : (rows, W) array
        Stored f of contacts.
    tops : (2, rows) array
        p and f of a top wall that touches grain 1 without a force at rest.
    room : (5, BURST) array, or longer
        Kicks, drifts and values at the border of a tile, for each row of a burst.
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
    begin : int
        First contact in the first processed row.
    end : int
        Contact after the last one in the first processed row.
    sooner : int
        Number of places by which the start moves up with every processed row.
    shorter : int
        Number of places by which the end moves up with every processed row.
    top : bool
        Whether the tile is the uppermost one.
    final : bool
        Whether the tile is the lowest one.
    touches : bool
        Whether the first contact of the tile is a top wall that touches grain 1 without a force at
        rest.
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
    """Return tile `number` of the contacts first ... last-1."""
    # Every row of a tile is one cache line above the previous row, so that the tile does not depend
    # on the tile below. The last tile also contains a remainder that is too short for a tile of its
    # own.
    single = last - first <= 2 * INNER_TILE
    begin = first + number * INNER_TILE
    top = number == 0
    touches = top and first == PAD and touching > 0.0
    final = single or begin + 2 * INNER_TILE > last
    end = last if final else begin + INNER_TILE
    return Tile(begin, end, 0 if top else PAD, 0 if final else PAD, top, final, touches)


@loop
def _forward(chain, steps, room, path, stretch, looks):
    """Advance a chain by some rows with the loops of the native engine."""
    look, row, count = stretch
    done = 0
    while done < count:
        burst = min(room.shape[1], count - done, count_rows(steps, look) - row)
        imposed = path[done : done + burst]
        # Nothing reads the times of kicks, because gradients refuse a ground.
        rows = Rows(
            kick=room[0, :burst],
            drift=room[1, :burst],
            carried=room[2, :burst],
            path=imposed,
            time=room[2, :burst],
        )
        fill_rows(steps, look, row, rows.kick, rows.drift)
        # Each row extends the motion by one grain.
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
    """Advance the chain of a batch of one through pieces numbers[0] ... numbers[1]-1 of its run.

    The function calls the loops of the native engine. `path` is the imposed motion or force in each
    row, or empty. `room` is scratch space, (5, BURST) or longer.
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
    """Kick grain 1 by a top wall that only touches, and store the p and f of this contact."""
    x, v, inverse_mass = memory.bodies
    p, f = touch(x[PAD] - x[PAD + 1], law.touching, law.less)
    memory.tops[0, index] = p
    memory.tops[1, index] = f
    v[PAD + 1] += kick * inverse_mass[PAD + 1] * f


@loop
def _keep_tile(law, path, memory, tile, row, index):
    """Advance the bodies of a tile by one row, and store p of their contacts in row `index`."""
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
    """Advance a chain by some rows within its window, and store p of all contacts."""
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
    """Return the stored p and f from the place `begin` on."""
    width = memory.powers.shape[1]
    return KeptRows(at(memory.powers[0], 0), at(memory.forces[0], 0), begin, width)


@loop
def _take_looks(looks, look, bodies, adjoint):
    """Add the derivatives with respect to observed values to the adjoint."""
    for n in range(looks.bodies.size):
        body = looks.bodies[n] + 1
        adjoint.x[body] += looks.values[0, look, n]
        adjoint.pull[body] += bodies.inverse_mass[body] * looks.values[1, look, n]


@loop
def _back_push(body, kick, index, path, memory):
    """Propagate adjoints back through the kick by an external force on a body."""
    weight = kick * memory.adjoint.pull[body]
    path.derivative[index] = weight
    memory.adjoint.mass[body] += weight * path.imposed[index]
    memory.bodies.v[body] -= kick * path.imposed[index]


@loop
def _back_top(law, kick, index, memory):
    """Propagate adjoints back through the kick by a top wall that only touches grain 1."""
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
    """Return kicks and the preceding drifts of some rows, with scratch arrays for tile borders."""
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
    """Propagate adjoints back through the contacts of a tile in some rows.

    `span` contains the number of the last row and the number of rows. Rows are processed one by one
    if a motion or a force is imposed, or if a top wall touches grain 1 without a force at rest.
    """
    x, momentum, im = memory.bodies
    il, st, stiff = memory.above
    adjoint = memory.adjoint
    width = memory.powers.shape[1] if law.way > Way.UNDONE_SHORT else 0
    body = path.body
    last, burst = span
    # One call for all rows is cheaper, but does not allow a push between two rows.
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
    """Propagate adjoints back through some rows, the last one first.

    `stretch.row` is the number of rows from the last observation to the end of the last row. In the
    reverse pass a row consists of a kick and the drift before it.
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
    """Propagate adjoints back through some pieces of a run, the last piece first.

    A piece is either undone from its end, or recomputed from its start. `looks` contains the
    derivatives with respect to the observed values, `path` is an `ImposedPath`, and the other
    arguments are as in `forward`.
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
            # Rows are undone in momenta, because impulses are then subtracted without a factor.
            if undone:
                v[n + 1] = state_v[n] / im[n + 1] if im[n + 1] > 0.0 else 0.0
        # In the reverse pass a row begins with a drift, so the drift before the checkpoint is
        # undone here.
        for n in range(width):
            x[n + 1] = state_x[n] - drift * state_v[n]
        first = pieces.windows[piece, 0]
        last = pieces.windows[piece, 1]
        # The contact below the last body of the window is included, unless that body is held.
        contacts = first, last + PAD if im[last] > 0.0 else last
        rows = slice(begin, begin + count)
        of_piece = ImposedPath(path.body, path.imposed[rows], path.derivative[rows])
        if not undone:
            forth = Stretch(pieces.looks[piece], pieces.rows[piece], count)
            _keep(law, steps, forth, of_piece, memory, contacts)
        _backward(law, steps, back, looks, of_piece, memory, contacts)
