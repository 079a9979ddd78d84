"""The Runge-Kutta method DOP853 on the same contact forces, compiled.

A chain that loses energy is moved in displacements and the reduced velocities w of `chain.damping`,
in which no force depends on a velocity: x' = w + d, w' = a, with the creep d = b - gamma x.
"""

from __future__ import annotations

import numpy as np

from .contact_forces import compiled_march, inlined
from .layout import PAD, RESOLUTION, Goal
from .openings import bound_nearness, shorten
from .right_hand_side import accelerate, ahead, impose, impose_velocity
from .sample_loop import end_of_step, sample_loop
from .window import look, rest_ahead, watch, widen

# of `state.pending`: the velocities of a damped chain are reduced ones, between its steps
REDUCED = 1.0


@inlined
def put(values, others):
    """Put others in the place of values: a slice that is assigned would be copied twice."""
    for n in range(values.size):
        values[n] = others[n]


@inlined
def add(sums, weight, values):
    """Add `weight` times the values to the sums."""
    for n in range(sums.size):
        sums[n] += weight * values[n]


@inlined
def add_both(sums, weight, values, other_weight, others):
    """Add weighted values and others to the sums, in one pass through memory."""
    for n in range(sums.size):
        sums[n] += weight * values[n] + other_weight * others[n]


@inlined
def fill_creep(chain, dissipation, y, force, creep):
    """Fill creep (W,) with the rates d at which contacts and drag move the bodies of the window.

    Parameters
    ----------
    dissipation : `layout.Dissipation`
    y, force : (W,) arrays
        Displacements, m, and the forces that `accelerate` has found there, N.
    """
    first = chain.state.first
    last = chain.state.last
    f = force[: last - first + 1]
    viscosity = dissipation.viscosity[chain.number, first - 1 : last]
    drag = dissipation.drag[chain.number, first:last]
    inverse_mass = chain.inverse_mass[first:last]
    grains = y[first:last]
    d = creep[first:last]
    for n in range(d.size):
        pressed = viscosity[n] * f[n] - viscosity[n + 1] * f[n + 1]
        d[n] = inverse_mass[n] * pressed - drag[n] * grains[n]


@inlined
def _complete(chain, dissipation, clock, now, force, creep, reduced):
    """Fill the creep and the reduced velocities (W,) of the window, and complete the velocities."""
    state = chain.state
    v = chain.v
    fill_creep(chain, dissipation, chain.x, force, creep)
    for n in range(state.first, state.last):
        # between two steps the chain has reduced ones
        if state.pending == REDUCED:
            reduced[n] = v[n]
            v[n] += creep[n]
        else:
            reduced[n] = v[n] - creep[n]
    impose_velocity(chain, v, PAD, now)
    look(chain, clock, state.steps, now, 1.0)


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step of the Runge-Kutta-Nystrom form."""
    (nodes, inner, weights, rates), openings, adaptive, dissipation = method
    force, z, slopes, reduced, creeps, nearest = work
    damped = dissipation.acts
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
    if damped:
        _complete(chain, dissipation, clock, now, force, creeps[0], reduced)
    h = span.step
    if adaptive:
        h = clock.step * shorten(chain, z, w, slopes[0], openings, nearest)
    done = end_of_step(chain, span, remaining, h)
    h = done - state.done
    grains = y[window]
    speeds = reduced[window] if damped else w[window]
    stage_grains = z[window]
    for stage in range(1, stages):
        for n in range(grains.size):
            stage_grains[n] = grains[n] + nodes[stage] * h * speeds[n]
        for earlier in range(stage):
            weight = inner[stage, earlier] * h * h
            if damped:
                along = rates[stage, earlier] * h
                add_both(
                    stage_grains, weight, slopes[earlier, window], along, creeps[earlier, window]
                )
            # many are 0
            elif weight != 0.0:
                add(stage_grains, weight, slopes[earlier, window])
        impose(chain, z, now + nodes[stage] * h, now + 0.5 * h)
        accelerate(chain, z, first, last, force, slopes[stage])
        if damped:
            fill_creep(chain, dissipation, z, force, creeps[stage])
    add(grains, h, speeds)
    for stage in range(stages):
        weight_x = weights[0, stage] * h * h
        weight_v = weights[1, stage] * h
        slope = slopes[stage, window]
        for n in range(grains.size):
            grains[n] += weight_x * slope[n]
            speeds[n] += weight_v * slope[n]
        if damped:
            add(grains, weight_v, creeps[stage, window])
    state.done = done
    impose(chain, y, span.begin + state.done, span.begin + state.done)
    watch(chain)
    if damped:
        put(w[window], reduced[window])
        rest_ahead(chain)
        state.pending = REDUCED
    else:
        look(chain, clock, state.steps + 1, span.begin + done, 1.0)
    return 1


@inlined
def _land(chain, method, work, clock, span, out):
    """Make the velocities of a damped chain of the reduced ones."""
    force, _, slopes, reduced, creeps, _ = work
    dissipation = method[3]
    if dissipation.acts:
        # a sample needs the forces where the step has ended
        accelerate(chain, chain.x, chain.state.first, chain.state.last, force, slopes[0])
        _complete(chain, dissipation, clock, span.end, force, creeps[0], reduced)
        chain.state.pending = 0.0


_march = sample_loop(_advance, False, _land)


@compiled_march()
def march(chains, method, clocks, fields, goal):
    """Advance as `sample_loop` says by DOP853.

    `method` is nodes c (12,), inner weights A^2 (12, 12), weights (2, 12) of a step in displacement
    and velocity, and inner weights A (12, 12); `layout.Shortening`; whether steps are shorter near
    openings; and `layout.Dissipation`.
    """
    width = chains.x.shape[1]
    stages = method[0][0].size
    slopes = np.zeros((stages, width))
    creeps = np.zeros((stages, width if method[3].acts else 0))
    nearest = bound_nearness(chains, clocks, method[1])
    work = np.zeros(width), np.zeros(width), slopes, np.zeros(width), creeps, nearest
    return _march(chains, method, work, clocks, fields, goal)


@compiled_march()
def march_by_step(chains, method, clocks, fields, goal, ends):
    """Advance the first chain of the goal as `march` does, and note when each step has ended.

    `ends` (Q,) are filled with seconds since the last landing, 0 at one; returns the steps made, Q
    at most.
    """
    state = chains.state[goal.begin]
    made = 0
    while made < ends.size and state.sample < goal.until:
        march(chains, method, clocks, fields, Goal(goal.begin, goal.begin + 1, goal.until, 1))
        ends[made] = state.done
        made += 1
    return made
