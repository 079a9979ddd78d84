"""Chains moved forward through time by a kick-drift splitting with steps of one size, compiled."""

from __future__ import annotations

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, inlined, kick_and_drift
from .drive import place
from .layout import DONE, FIRST, LAST, PAD, PENDING
from .sample_loop import sample_loop
from .window import watch, widen

ROWS = 64  # evaluations of the force between two looks at the window, for long chains and for methods of one stage
TILE = 8192  # grains that stay in the cache while ROWS evaluations pass over them


@inlined
def sweep(chain, kicks, drifts, carried, path):
    """Kick and drift the window once a row; long chains in tiles, each moved ahead by all rows while it is cached.

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


@inlined
def _advance(chain, method, work, clock, span):
    """Take a burst of steps; the last kick of a step and the first of the next are one."""
    kicks, drifts = method
    kick, drift, carried, path, reach = work
    state, stages, h = chain.state, drifts.size, span.step
    full = state[FIRST] == PAD and state[LAST] == chain.x.size - PAD
    wide = stages == 1 or full or state[LAST] - state[FIRST] > TILE
    burst = min(span.steps - int(state[DONE]), max(1, ROWS // stages) if wide else 1)
    rows = burst * stages
    widen(chain, rows + 1)
    begun = span.begin + state[DONE] * h
    for step in range(burst):
        for stage in range(stages):
            row = step * stages + stage
            kick[row], drift[row] = kicks[stage] * h, drifts[stage] * h
            if chain.driven:
                t = begun + (step + (reach[stage - 1] if stage > 0 else 0.0)) * h
                path[row] = place(chain, t, 0)
        kick[step * stages] += state[PENDING]
        state[PENDING] = kicks[stages] * h
    sweep(chain, kick[:rows], drift[:rows], carried[:rows], path[:rows])
    watch(chain)
    state[DONE] += burst
    return burst


@inlined
def _land(chain, method, work, span):
    """Complete the last kick, where a sample lies between it and the first of the next step."""
    kick, drift, carried, path, _ = work
    kick[0], drift[0] = chain.state[PENDING], 0.0
    if chain.driven:
        path[0] = place(chain, span.end, 0)
    sweep(chain, kick[:1], drift[:1], carried[:1], path[:1])
    chain.state[PENDING] = 0.0


_march = sample_loop(_advance, True, _land)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clock, u_out, v_out, offset, until, max_steps):
    """Advance as `sample_loop` says by a splitting; `method` is its kicks (S+1,) and drifts (S,) as parts of a step."""
    rows = ROWS + method[1].size
    kick, drift, carried, path = np.zeros(rows), np.zeros(rows), np.zeros(rows), np.zeros(rows if chains.driven else 0)
    work = kick, drift, carried, path, np.cumsum(method[1])
    return _march(chains, method, work, clock, u_out, v_out, offset, until, max_steps)
