"""The Runge-Kutta method DOP853 on the same contact forces, compiled."""

from __future__ import annotations

import math

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, inlined
from .layout import RESOLUTION
from .right_hand_side import accelerate, ahead, impose
from .sample_loop import end_of_step, sample_loop
from .window import look, watch, widen


@inlined
def _error(chain, weights, slopes, h):
    """Return the embedded estimate of the error of a step, over the scale of the motion."""
    error = 0.0
    for n in range(chain.state.first, chain.state.last):
        x5, v5, x3, v3 = 0.0, 0.0, 0.0, 0.0
        for stage in range(slopes.shape[0]):
            slope = slopes[stage, n]
            x5 += weights[2, stage] * slope
            v5 += weights[3, stage] * slope
            x3 += weights[4, stage] * slope
            v3 += weights[5, stage] * slope
        x5, x3 = abs(x5) * h * h / chain.scale[0], abs(x3) * h * h / chain.scale[0]
        v5, v3 = abs(v5) * h / chain.scale[1], abs(v3) * h / chain.scale[1]
        # the error of order 5, made smaller where that of order 3 says that it is an overestimate
        ex = x5 * x5 / math.sqrt(x5 * x5 + 0.01 * x3 * x3) if x5 > 0.0 else 0.0
        ev = v5 * v5 / math.sqrt(v5 * v5 + 0.01 * v3 * v3) if v5 > 0.0 else 0.0
        error = max(error, ex, ev)
    return error


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step of the Runge-Kutta-Nystrom form, or none if its error is too large."""
    nodes, inner, weights, errors, longest = method
    allowed, most = errors[chain.schedule], longest[chain.schedule]
    force, z, slopes = work
    y, w, state, stages = chain.x, chain.v, chain.state, nodes.size
    widen(chain, stages + 2)
    first, last = state.first, state.last
    here = slice(first, last)
    now = span.begin + state.done
    left = min(
        span.length - state.done,
        ahead(chain, now, span.begin + span.length, RESOLUTION * clock.step),
    )
    h = span.step if allowed == 0.0 else (state.step_size if state.step_size > 0.0 else clock.step)
    done = end_of_step(chain, span, left, h)
    h = done - state.done
    grains, speeds, stage_grains = y[here], w[here], z[here]
    for n in range(first - 1, last + 1):
        z[n] = y[n]
    for stage in range(stages):
        for n in range(grains.size):
            stage_grains[n] = grains[n] + nodes[stage] * h * speeds[n]
        for earlier in range(stage):
            part, slope = inner[stage, earlier] * h * h, slopes[earlier, here]
            if part != 0.0:
                for n in range(grains.size):
                    stage_grains[n] += part * slope[n]
        impose(chain, z, now + nodes[stage] * h, now + 0.5 * h)
        accelerate(chain, z, first, last, force, slopes[stage])
    if allowed > 0.0:
        error = _error(chain, weights, slopes, h)
        factor = 0.9 * (allowed / error) ** 0.125 if error > 0.0 else 4.0
        state.step_size = min(most * clock.step, h * min(4.0, max(0.2, factor)))
        if error > allowed and h > 1e-9 * clock.step:
            return 1
    for stage in range(stages):
        wx, wv, slope = weights[0, stage] * h * h, weights[1, stage] * h, slopes[stage, here]
        if stage == 0:
            for n in range(grains.size):
                grains[n] += h * speeds[n]
        for n in range(grains.size):
            grains[n] += wx * slope[n]
            speeds[n] += wv * slope[n]
    state.done = done
    impose(chain, y, span.begin + state.done, span.begin + state.done)
    watch(chain)
    look(chain, clock, state.steps + 1, span.begin + done, 1.0)
    return 1


_march = sample_loop(_advance, False)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clocks, fields, goal):
    """Advance as `sample_loop` says by DOP853.

    Parameters
    ----------
    method : nodes c (12,) and inner weights A^2 (12, 12); weights (6, 12) for displacement and velocity, of the step,
        of the error of order 5 and of that of order 3; of F schedules the largest error of a step, 0 for steps of one
        size, and the longest step over that of the schedule, (F,)
    """
    width = chains.x.shape[1]
    force, stage, accelerations = (
        np.zeros(width),
        np.zeros(width),
        np.zeros((method[0].size, width)),
    )
    work = force, stage, accelerations
    return _march(chains, method, work, clocks, fields, goal)
