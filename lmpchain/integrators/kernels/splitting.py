"""Chains moved forward through time by a kick-drift splitting with steps of one size, compiled."""

from __future__ import annotations

from .compiling import compiled_march, inlined, pasted
from .layout import PAD, Chains, Rows, SplittingStages, make_rows
from .right_hand_side import ROWS, TILE, cut, imposed, slice_rows, sweep
from .sample_loop import sample_loop
from .window import LOOKS, look, watch, widen


@inlined
def _fill_step(chain, method, rows, row, origin, before, h):
    """Fill the rows of a step, from `row` on; it begins `before` steps h after `origin`.

    The last kick is still due then: it and the first of the next step are one.
    """
    kicks, drifts, reach = method
    for stage in range(drifts.size):
        rows.kick[row + stage] = kicks[stage] * h
        rows.drift[row + stage] = drifts[stage] * h
        if chain.imposed.acts:
            along = reach[stage - 1] if stage > 0 else 0.0
            rows.path[row + stage] = imposed(chain, origin + (before + along) * h)
    rows.kick[row] += chain.state.pending
    chain.state.pending = kicks[drifts.size] * h


@inlined
def _burst(chain, clock, stages):
    """Return the number of steps between two updates of the window."""
    state = chain.state
    # rows of a burst are swept together, which pays where the window need not grow, or is long
    full = state.first == PAD and state.last == chain.x.size - PAD
    wide = stages == 1 or full or state.last - state.first > TILE
    steps = max(1, ROWS // stages) if wide else 1
    if chain.imposed.acts:
        # it may press grains together at any time, and contacts are watched after each burst
        steps = min(steps, max(1, int(LOOKS.radians / (clock.equal_step * chain.omega))))
    return min(clock.steps - int(state.done), steps)


@inlined
def _land(chain, work, clock):
    """Complete the last kick, where a sample lies between it and the first of the next step."""
    rows = slice_rows(work, slice(0, 1))
    rows.kick[0] = chain.state.pending
    rows.drift[0] = 0.0
    if chain.imposed.acts:
        rows.path[0] = imposed(chain, clock.end)
    sweep(chain, rows)
    chain.state.pending = 0.0


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Take a burst of steps; the last kick of a step and the first of the next are one.

    A step in which what is imposed ends is made as two, so that the order is kept.
    """
    if landed:
        _land(chain, work, clock)
        return 0
    kicks, drifts, _ = method
    state = chain.state
    stages = drifts.size
    h = clock.equal_step
    # of a speed, without the last kick
    missing = kicks[stages] * clock.step * chain.omega
    complete = 1.0 / (1.0 + 0.5 * missing * missing)
    burst = _burst(chain, clock, stages)
    # counted from the landing, so that times do not depend on how steps are shared out over bursts
    made = state.done
    filled = 0
    halved = burst
    for step in range(burst):
        begin = clock.begin + (made + step) * h
        # a corner leaves an order of 2 as it is
        corner = cut(chain, begin, h) if stages > 1 else 0.0
        if corner > 0.0:
            halved = step
            _fill_step(chain, method, work, filled, begin, 0.0, corner)
            filled += stages
            _fill_step(chain, method, work, filled, begin + corner, 0.0, h - corner)
        else:
            _fill_step(chain, method, work, filled, clock.begin, made + step, h)
        filled += stages
    widen(chain, filled + 1)
    step = 0
    steps_before = state.steps
    while step < burst:
        # up to the next look; the step with a corner has rows for two
        end = min(burst, max(step + 1, state.next_look - steps_before))
        until_look = slice((step + (step > halved)) * stages, (end + (end > halved)) * stages)
        sweep(chain, slice_rows(work, until_look))
        look(chain, clock, steps_before + end, clock.begin + (made + end) * h, complete)
        step = end
    watch(chain)
    state.done += burst
    return burst


def make_work(chains: Chains, method: SplittingStages) -> Rows:
    """Return what a thread works in."""
    return make_rows(ROWS + 2 * method.drifts.size, chains.batch.acts)


# `method` is `layout.Stages`
march = compiled_march()(sample_loop(_advance, True))
