"""Chains moved forward through time by a kick-drift splitting with steps of one size, compiled."""

from __future__ import annotations

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, inlined
from .layout import PAD
from .right_hand_side import ROWS, TILE, cut, imposed, sweep
from .sample_loop import sample_loop
from .window import look, watch, widen


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take a burst of steps; the last kick of a step and the first of the next are one.

    A step in which what is imposed ends is made as two, so that the order is kept.
    """
    kicks, drifts = method
    kick, drift, carried, path, reach = work
    state, stages, h = chain.state, drifts.size, span.step
    full = state.first == PAD and state.last == chain.x.size - PAD
    wide = stages == 1 or full or state.last - state.first > TILE
    missing = (
        kicks[stages] * clock.step * chain.omega
    )  # of a speed, without the last kick of a step
    complete = 1.0 / (1.0 + 0.5 * missing * missing)
    burst = min(span.steps - int(state.done), max(1, ROWS // stages) if wide else 1)
    begun, rows, halved = span.begin + state.done * h, 0, burst
    for step in range(burst):
        first = (
            cut(chain, begun + step * h, h) if stages > 1 else 0.0
        )  # a corner leaves an order of 2 as it is
        halved = step if first > 0.0 else halved
        for part in range(2 if first > 0.0 else 1):
            whole = h if first == 0.0 else (first if part == 0 else h - first)
            for stage in range(stages):
                kick[rows + stage], drift[rows + stage] = (
                    kicks[stage] * whole,
                    drifts[stage] * whole,
                )
                if chain.imposed:
                    along = reach[stage - 1] if stage > 0 else 0.0
                    t = begun + (step + along) * h
                    if first > 0.0:
                        t = begun + step * h + (first if part > 0 else 0.0) + along * whole
                    path[rows + stage] = imposed(chain, t)
            kick[rows] += state.pending
            state.pending = kicks[stages] * whole
            rows += stages
    widen(chain, rows + 1)
    step, made = 0, state.steps
    while step < burst:
        end = min(burst, max(step + 1, state.next_look - made))
        some = slice((step + (step > halved)) * stages, (end + (end > halved)) * stages)
        sweep(chain, kick[some], drift[some], carried[some], path[some])
        look(chain, clock, made + end, begun + end * h, complete)
        step = end
    watch(chain)
    state.done += burst
    return burst


@inlined
def _land(chain, method, work, clock, span, out):
    """Complete the last kick, where a sample lies between it and the first of the next step."""
    kick, drift, carried, path, _ = work
    kick[0], drift[0] = chain.state.pending, 0.0
    if chain.imposed:
        path[0] = imposed(chain, span.end)
    sweep(chain, kick[:1], drift[:1], carried[:1], path[:1])
    chain.state.pending = 0.0


_march = sample_loop(_advance, True, _land)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clocks, fields, begin, end, until, max_steps):
    """Advance by a splitting; `method` is its kicks (S+1,) and drifts (S,) as fractions of a step."""
    rows = ROWS + 2 * method[1].size
    kick, drift, carried, path = (
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows if chains.imposed else 0),
    )
    work = kick, drift, carried, path, np.cumsum(method[1])
    return _march(chains, method, work, clocks, fields, begin, end, until, max_steps)
