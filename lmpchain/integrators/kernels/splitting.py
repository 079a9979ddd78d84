"""Kick-drift splittings with steps of one size, compiled."""

from __future__ import annotations

from .compiling import compiled_march, inlined, pasted
from .layout import PAD, Chains, Rows, SplittingStages, make_rows
from .right_hand_side import ROWS, TILE, cut, impose, imposed, slice_rows, sweep
from .sample_loop import sample_loop
from .window import LOOKS, look, watch, widen


@inlined
def _fill_step(chain, method, rows, row, origin, before, h):
    """Fill the rows of a step, from `row` on; the step begins `before` steps h after `origin`.

    The last kick of the previous step is merged into the first kick of this step.
    """
    kicks, drifts, reach = method
    for stage in range(drifts.size):
        rows.kick[row + stage] = kicks[stage] * h
        rows.drift[row + stage] = drifts[stage] * h
        along = reach[stage - 1] if stage > 0 else 0.0
        rows.time[row + stage] = origin + (before + along) * h
        if chain.imposed.acts:
            rows.path[row + stage] = imposed(chain, rows.time[row + stage])
    rows.kick[row] += chain.state.pending
    chain.state.pending = kicks[drifts.size] * h


@inlined
def _burst(chain, clock, stages):
    """Return the number of steps between two updates of the window."""
    state = chain.state
    # The rows of a burst are swept together, which is cheaper if the window is long or cannot grow.
    full = state.first == PAD and state.last == chain.x.size - PAD
    wide = stages == 1 or full or state.last - state.first > TILE
    steps = max(1, ROWS // stages) if wide else 1
    if chain.imposed.acts:
        # A forced scene may compress grains at any time, so contacts are checked more often.
        steps = min(steps, max(1, int(LOOKS.radians / (clock.equal_step * chain.omega))))
    return min(clock.steps - int(state.done), steps)


@inlined
def _land(chain, work, clock):
    """Complete the last kick before a sample."""
    rows = slice_rows(work, slice(0, 1))
    rows.kick[0] = chain.state.pending
    rows.drift[0] = 0.0
    rows.time[0] = clock.end
    if chain.imposed.acts:
        rows.path[0] = imposed(chain, clock.end)
    sweep(chain, rows)
    chain.state.pending = 0.0


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Take a burst of steps; the last kick of a step and the first kick of the next form one row.

    If the imposed motion or force ends within a step, the step is divided there, because the order
    would be lower otherwise.
    """
    if landed:
        _land(chain, work, clock)
        return 0
    kicks, drifts, _ = method
    state = chain.state
    stages = drifts.size
    h = clock.equal_step
    # Phase of the last kick, rad, which is missing in an observed speed.
    missing = kicks[stages] * clock.step * chain.omega
    complete = 1.0 / (1.0 + 0.5 * missing * missing)
    burst = _burst(chain, clock, stages)
    # Steps are counted from the landing, so that times do not depend on the division into bursts.
    made = state.done
    filled = 0
    halved = burst
    for step in range(burst):
        begin = clock.begin + (made + step) * h
        # A kink does not reduce the order of a method of order 2.
        kink = cut(chain, begin, h) if stages > 1 else 0.0
        if kink > 0.0:
            halved = step
            _fill_step(chain, method, work, filled, begin, 0.0, kink)
            filled += stages
            _fill_step(chain, method, work, filled, begin + kink, 0.0, h - kink)
        else:
            _fill_step(chain, method, work, filled, clock.begin, made + step, h)
        filled += stages
    widen(chain, filled + 1)
    step = 0
    steps_before = state.steps
    while step < burst:
        # Sweep up to the next observation; a step with a kink has twice as many rows.
        end = min(burst, max(step + 1, state.next_look - steps_before))
        until_look = slice((step + (step > halved)) * stages, (end + (end > halved)) * stages)
        sweep(chain, slice_rows(work, until_look))
        look(chain, clock, steps_before + end, clock.begin + (made + end) * h, complete)
        step = end
    state.done += burst
    # Rows impose the motion at their kicks, so a driven body lags behind the other bodies.
    now = clock.begin + state.done * h
    impose(chain, chain.x, now, now)
    watch(chain)
    return burst


def make_work(chains: Chains, method: SplittingStages) -> Rows:
    """Allocate the scratch arrays of one thread."""
    return make_rows(ROWS + 2 * method.drifts.size, chains.batch.acts)


# `method` is a `layout.SplittingStages`.
march = compiled_march()(sample_loop(_advance, True))
