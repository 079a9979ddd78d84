"""Chains moved forward through time by a kick-drift splitting with steps of one size, compiled."""

from __future__ import annotations

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, inlined
from .layout import DONE, FIRST, LAST, PAD, PENDING, STEPS
from .right_hand_side import ROWS, TILE, imposed, sweep
from .sample_loop import sample_loop
from .window import look, watch, widen

SETTLED = 64  # steps after which pieces between two looks for the largest motion are twice as long


@inlined
def _advance(chain, method, work, clock, span):
    """Take a burst of steps; the last kick of a step and the first of the next are one."""
    kicks, drifts, every, complete = method
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
            if chain.imposed:
                t = begun + (step + (reach[stage - 1] if stage > 0 else 0.0)) * h
                path[row] = imposed(chain, t)
        kick[step * stages] += state[PENDING]
        state[PENDING] = kicks[stages] * h
    piece = every * (1 + int(state[STEPS]) // SETTLED)  # later, what is new is rare
    for step in range(0, burst, piece):
        end = min(burst, step + piece)
        some = slice(step * stages, end * stages)
        sweep(chain, kick[some], drift[some], carried[some], path[some])
        look(chain, begun + end * h, complete)
    watch(chain)
    state[DONE] += burst
    return burst


@inlined
def _land(chain, method, work, span):
    """Complete the last kick, where a sample lies between it and the first of the next step."""
    kick, drift, carried, path, _ = work
    kick[0], drift[0] = chain.state[PENDING], 0.0
    if chain.imposed:
        path[0] = imposed(chain, span.end)
    sweep(chain, kick[:1], drift[:1], carried[:1], path[:1])
    chain.state[PENDING] = 0.0


_march = sample_loop(_advance, True, _land)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clock, u_out, v_out, offset, until, max_steps):
    """Advance by a splitting.

    `method` is its kicks (S+1,) and drifts (S,) as fractions of a step, the steps from one look to the next, and what
    `look` takes.
    """
    rows = ROWS + method[1].size
    kick, drift, carried, path = np.zeros(rows), np.zeros(rows), np.zeros(rows), np.zeros(rows if chains.imposed else 0)
    work = kick, drift, carried, path, np.cumsum(method[1])
    return _march(chains, method, work, clock, u_out, v_out, offset, until, max_steps)
