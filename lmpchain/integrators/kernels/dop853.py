"""The Runge-Kutta method DOP853 on the same contact forces, compiled."""

from __future__ import annotations

import numpy as np

from .contact_forces import compiled_march, inlined
from .layout import PAD, RESOLUTION
from .openings import bound_nearness, shorten
from .right_hand_side import accelerate, ahead, impose, impose_velocity
from .sample_loop import end_of_step, sample_loop
from .window import look, watch, widen


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step of the Runge-Kutta-Nystrom form."""
    (nodes, inner, weights), openings, adaptive = method
    force, z, slopes, nearest = work
    y = chain.x
    w = chain.v
    state = chain.state
    stages = nodes.size
    widen(chain, stages + 2)
    first = state.first
    last = state.last
    window = slice(first, last)
    now = span.begin + state.done
    remaining = min(
        span.length - state.done,
        ahead(chain, now, span.begin + span.length, RESOLUTION * clock.step),
    )
    # the first stage is at the begin of the step: how near an opening is follows from its
    # accelerations
    for n in range(first - 1, last + 1):
        z[n] = y[n]
    # of what is imposed, by the law behind a corner on which the step may begin
    impose(chain, z, now, now + 0.5 * min(remaining, span.step))
    impose_velocity(chain, w, PAD, now)
    accelerate(chain, z, first, last, force, slopes[0])
    h = span.step
    if adaptive:
        h = clock.step * shorten(chain, z, w, slopes[0], openings, nearest)
    done = end_of_step(chain, span, remaining, h)
    h = done - state.done
    grains = y[window]
    speeds = w[window]
    stage_grains = z[window]
    for stage in range(1, stages):
        for n in range(grains.size):
            stage_grains[n] = grains[n] + nodes[stage] * h * speeds[n]
        for earlier in range(stage):
            weight = inner[stage, earlier] * h * h
            slope = slopes[earlier, window]
            # many are 0
            if weight != 0.0:
                for n in range(grains.size):
                    stage_grains[n] += weight * slope[n]
        impose(chain, z, now + nodes[stage] * h, now + 0.5 * h)
        accelerate(chain, z, first, last, force, slopes[stage])
    for n in range(grains.size):
        grains[n] += h * speeds[n]
    for stage in range(stages):
        weight_x = weights[0, stage] * h * h
        weight_v = weights[1, stage] * h
        slope = slopes[stage, window]
        for n in range(grains.size):
            grains[n] += weight_x * slope[n]
            speeds[n] += weight_v * slope[n]
    state.done = done
    impose(chain, y, span.begin + state.done, span.begin + state.done)
    watch(chain)
    look(chain, clock, state.steps + 1, span.begin + done, 1.0)
    return 1


_march = sample_loop(_advance, False)


@compiled_march()
def march(chains, method, clocks, fields, goal):
    """Advance as `sample_loop` says by DOP853.

    `method` is nodes c (12,), inner weights A^2 (12, 12) and weights (2, 12) of a step in
    displacement and velocity; `layout.Shortening`; and whether steps are shorter near openings.
    """
    width = chains.x.shape[1]
    slopes = np.zeros((method[0][0].size, width))
    nearest = bound_nearness(chains, clocks, method[1])
    work = np.zeros(width), np.zeros(width), slopes, nearest
    return _march(chains, method, work, clocks, fields, goal)
