"""Kick-drift splittings with an adaptive step size around contacts that open or close, compiled.

`openings` computes the factor by which steps near an opening are shorter.
"""

from __future__ import annotations

import numpy as np

from .compiling import compiled_march, fma, inlined, pasted
from .layout import PAD, RESOLUTION, Chains, Rows, Shortening, SplittingStages, make_rows
from .openings import shorten
from .right_hand_side import (
    accelerate,
    add_ground,
    ahead,
    hold,
    impose,
    impose_velocity,
    imposed,
    recall,
    sweep,
)
from .sample_loop import end_of_step, sample_loop
from .team import meet, share
from .window import DenseRates, fill_jerk, fill_samples, keep, look, passes, watch, widen


@inlined
def _finish_kick(chain, t, margin, rates):
    """Complete the last kick of the previous step, at time t.

    Forces and accelerations are stored in `rates`. The function returns the argument `beyond` of
    `fill_jerk`: the difference between the index of a body and the index of its force.
    """
    state = chain.state
    widen(chain, margin)
    meet(chain.team)
    first, last = share(chain)
    # Include one more grain on either side, because the distance of a contact from opening depends
    # on the accelerations of both of its grains.
    above = max(first - 1, state.first)
    below = min(last + 1, state.last)
    accelerate(chain, chain.x, above, below, rates.force, rates.pull)
    add_ground(chain, chain.x, t, above, below, rates.pull)
    speeds = chain.v[first:last]
    a = rates.pull[first:last]
    for n in range(speeds.size):
        speeds[n] = fma(state.pending, a[n], speeds[n])
    state.pending = 0.0
    meet(chain.team)
    return above - 1


@inlined
def _fill_passed(chain, rates, clock, out, beyond):
    """Fill the samples inside the previous step; return whether jerks (W,) were computed."""
    state = chain.state
    first, last = share(chain)
    if clock.dense == 0 or passes(chain, clock, state.step_begin, state.done) == 0:
        return False
    fill_jerk(chain, first, last, rates, beyond)
    fill_samples(chain, clock, first, last, rates, out)
    return True


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Complete the last kick of the previous step, and take one step."""
    (kicks, drifts, reach), openings = method
    rows, rates = work
    pull = rates.pull
    y = chain.x
    w = chain.v
    state = chain.state
    stages = drifts.size
    t = clock.begin + state.done
    if not landed:
        recall(chain, t)
        # Impose velocities before the forces are computed, like all imposed quantities.
        impose_velocity(chain, w, PAD, t)
    beyond = _finish_kick(chain, t, stages + 1, rates)
    filled = _fill_passed(chain, rates, clock, out, beyond)
    if landed:
        hold(chain, w)
        return 0
    watch(chain)
    look(chain, clock, state.steps, t, 1.0)
    first, last = share(chain)
    grains = y[first:last]
    speeds = w[first:last]
    remaining = min(
        clock.length - state.done,
        ahead(chain, t, clock.begin + clock.length, RESOLUTION * clock.step),
    )
    # Steps are equal up to the next landing or kink, unless an opening shortens them.
    h = clock.step * shorten(chain, y, w, pull, openings)
    done = end_of_step(chain, clock, remaining, h)
    h = done - state.done
    if clock.dense > 0:
        if passes(chain, clock, state.done, done) > 0:
            if not filled:
                fill_jerk(chain, first, last, rates, beyond)
            keep(chain, first, last, rates)
            # All threads must have read neighbouring grains before any grain moves.
            meet(chain.team)
        state.step_begin = state.done
    hold(chain, w)
    if chain.imposed.acts:
        for stage in range(stages - 1):
            rows.path[stage] = imposed(chain, t + reach[stage] * h)
    a = pull[first:last]
    for n in range(speeds.size):
        speeds[n] = fma(kicks[0] * h, a[n], speeds[n])
        grains[n] = fma(drifts[0] * h, speeds[n], grains[n])
    for stage in range(stages - 1):
        rows.kick[stage] = kicks[stage + 1] * h
        rows.drift[stage] = drifts[stage + 1] * h
        rows.time[stage] = t + reach[stage] * h
    sweep(chain, rows)
    # The last kick is completed at the next step, which computes the forces that it needs.
    state.done = done
    state.pending = kicks[stages] * h
    impose(chain, y, clock.begin + state.done, clock.begin + state.done)
    return 1


def make_work(
    chains: Chains, method: tuple[SplittingStages, Shortening]
) -> tuple[Rows, DenseRates]:
    """Allocate the scratch arrays of one thread."""
    rows = make_rows(method[0].drifts.size - 1, chains.batch.acts)
    return rows, DenseRates(*np.zeros((4, chains.x.shape[1])))


# `method` is (`layout.SplittingStages`, `layout.Shortening`).
march = compiled_march()(sample_loop(_advance, False))
