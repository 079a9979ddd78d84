"""The Runge-Kutta method DOP853 on the same contact forces, compiled.

A dissipative chain is advanced in displacements x and the reduced velocities w of `chain.damping`,
because no force then depends on a velocity: x' = w + d and w' = a, with the creep d = b - gamma x.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .compiling import apart, compiled, compiled_march, inlined, pasted, summed
from .layout import PAD, RESOLUTION, Chains
from .openings import shorten
from .right_hand_side import (
    accelerate,
    add_ground,
    ahead,
    course,
    forced,
    impose,
    impose_velocity,
)
from .sample_loop import end_of_step, sample_loop
from .window import look, rest_ahead, watch, widen

# Value of `state.pending` between the steps of a damped chain, when `v` contains reduced
# velocities.
REDUCED = 1.0


@inlined
def put(values, others):
    """Copy others into values; assigning to a slice would copy twice."""
    for n in range(values.size):
        values[n] = others[n]


class Weighted(NamedTuple):
    """Weights and numbers of rows, (R,), of which the first ones are summed."""

    weights: Array
    rows: NDArray[np.int64]


@inlined
def note(weighted, count, weight, row):
    """Append a weighted row to a sum of `count` rows, unless its weight is 0.

    The function returns the new number of rows.
    """
    weighted.weights[count] = weight
    weighted.rows[count] = row
    # Many weights are 0.
    return count + 1 if weight != 0.0 else count


@compiled
def _drift(out, x, reach, speeds):
    """Fill out with x advanced at constant speeds for a time `reach`."""
    apart()
    for n in range(out.size):
        out[n] = x[n] + reach * speeds[n]


@compiled
def _add_four(sums, weights, a, b, c, d):
    """Add four weighted arrays to the sums, with the rounding of four separate passes."""
    apart()
    for n in range(sums.size):
        total = sums[n] + weights[0] * a[n]
        total += weights[1] * b[n]
        total += weights[2] * c[n]
        sums[n] = total + weights[3] * d[n]


@compiled
def _add_one(sums, weight, values):
    """Add weighted values to the sums."""
    apart()
    for n in range(sums.size):
        sums[n] += weight * values[n]


@inlined
def add_rows(sums, weighted, count, rows, window):
    """Add the first `count` weighted rows, restricted to a window, to the sums."""
    weights, numbers = weighted
    for n in range(0, count - 3, 4):
        _add_four(
            sums,
            (weights[n], weights[n + 1], weights[n + 2], weights[n + 3]),
            rows[numbers[n], window],
            rows[numbers[n + 1], window],
            rows[numbers[n + 2], window],
            rows[numbers[n + 3], window],
        )
    for n in range(count // 4 * 4, count):
        _add_one(sums, weights[n], rows[numbers[n], window])


@compiled
def _fill_creep(creep, inverse_mass, force, viscosity, drag, x):
    """Compute creep (B,) of bodies x between contacts with forces and viscosities (B+1,)."""
    apart()
    for n in range(creep.size):
        pressed = viscosity[n] * force[n] - viscosity[n + 1] * force[n + 1]
        creep[n] = inverse_mass[n] * pressed - drag[n] * x[n]


@inlined
def fill_creep(chain, y, force, creep):
    """Compute creep (W,): the rates d at which viscous contacts and drag move bodies of the window.

    Parameters
    ----------
    y : (W,) array
        Displacements, m.
    force : (W,) array
        Forces of the contacts at these displacements, N, as `accelerate` stores them.
    creep : (W,) array
        Filled with the creep d, m/s.
    """
    first = chain.state.first
    last = chain.state.last
    bodies = slice(first, last)
    _fill_creep(
        creep[bodies],
        chain.inverse_mass[bodies],
        force[: last - first + 1],
        chain.viscosity[first - 1 : last],
        chain.drag[bodies],
        y[bodies],
    )


@inlined
def _complete(chain, clock, now, force, creep, reduced):
    """Compute the creep and the reduced velocities (W,) of the window, and the velocities."""
    state = chain.state
    v = chain.v
    fill_creep(chain, chain.x, force, creep)
    for n in range(state.first, state.last):
        # Between two steps `v` contains reduced velocities.
        if state.pending == REDUCED:
            reduced[n] = v[n]
            v[n] += creep[n]
        else:
            reduced[n] = v[n] - creep[n]
    impose_velocity(chain, v, PAD, now)
    look(chain, clock, state.steps, now, 1.0)


@inlined
def _weigh(weigh, twice, once, h, lag, creeps):
    """Collect the weighted rows that move bodies over a step h; return their number.

    `twice` and `once` are the weights (S,) of the accelerations times h^2 and of the rates times h.
    If `creeps` is 0, the creep is `lag` times the acceleration, and the weight of the acceleration
    includes it. Otherwise the rows of the creep begin at number `creeps`.
    """
    count = 0
    for stage in range(twice.size):
        along = once[stage] * h
        count = note(weigh, count, twice[stage] * h * h + lag * along, stage)
        if creeps > 0:
            count = note(weigh, count, along, creeps + stage)
    return count


@summed
def _sum_products(mass, weights, a, b, c, d, e, f, g, h):
    """Return the sum over bodies of m times the weighted products a e, b f, c g and d h."""
    total = 0.0
    for n in range(mass.size):
        products = weights[0] * (a[n] * e[n]) + weights[1] * (b[n] * f[n])
        products += weights[2] * (c[n] * g[n]) + weights[3] * (d[n] * h[n])
        total += mass[n] * products
    return total


@inlined
def _sum_losses(mass, weighted, count, slopes, creeps, lag, window):
    """Return the weighted sum over the stages of a step of sum m w' d, over `window`, J.

    The rows of the creep d begin at the row `creeps` of the slopes w'. If `creeps` is 0, the creep
    is `lag` times the slopes.
    """
    weights, rows = weighted
    total = 0.0
    # Eight of the twelve stages have a weight.
    for n in range(0, count, 4):
        total += _sum_products(
            mass,
            (weights[n], weights[n + 1], weights[n + 2], weights[n + 3]),
            slopes[rows[n], window],
            slopes[rows[n + 1], window],
            slopes[rows[n + 2], window],
            slopes[rows[n + 3], window],
            slopes[creeps + rows[n], window],
            slopes[creeps + rows[n + 1], window],
            slopes[creeps + rows[n + 2], window],
            slopes[creeps + rows[n + 3], window],
        )
    return total if creeps > 0 else lag * total


@summed
def _sum_surplus(mass, creep, reduced):
    """Return the kinetic energy of velocities w + d less the kinetic energy of w, J."""
    total = 0.0
    for n in range(mass.size):
        total += mass[n] * (creep[n] * (reduced[n] + 0.5 * creep[n]))
    return total


@inlined
def _surplus(chain, creep, reduced):
    """Return `_sum_surplus` of the window."""
    window = slice(chain.state.first, chain.state.last)
    return _sum_surplus(chain.mass[window], creep[window], reduced[window])


@inlined
def _drives(chain):
    """Return whether grain 1 or the top wall is driven."""
    return chain.imposed.acts and chain.imposed.wave.body > 0


@inlined
def _press(chain, force):
    """Return the elastic force of its contacts on the driven body, N, and the sum of A F, N s."""
    viscosity = chain.viscosity
    # Contact 0 is above grain 1 and below the wall.
    if chain.imposed.wave.body == PAD:
        elastic = force[1] - force[0]
        return elastic, viscosity[PAD] * force[1] - viscosity[PAD - 1] * force[0]
    return force[0], viscosity[PAD - 1] * force[0]


@inlined
def _note_stage(chain, acted, work, rates, weight, stage, t, inside, h):
    """Add the work at a stage of a step h, with the weight of the stage, if `acted`.

    The power of viscous forces on the driven body is v d(A F)/dt. Integration by parts replaces it
    by -A F dv/dt, which requires no time derivative of a force; `_note_begin` adds the boundary
    terms.
    """
    force, z, reduced, slopes, _ = work
    state = chain.state
    stages = rates.shape[0]
    if acted and _drives(chain):
        elastic, viscous = _press(chain, force)
        taken = -weight * h * viscous * course(chain, t, 2, inside)
        state.lost += taken
        state.work += taken + weight * h * elastic * course(chain, t, 1, inside)
    pushed = forced(chain)
    if acted and pushed > 0:
        speed = reduced[pushed] + slopes[stages + stage, pushed]
        for row in range(stage):
            speed += rates[stage, row] * h * slopes[row, pushed]
        state.work += weight * h * z[0] * speed


@inlined
def _note_begin(chain, clock, creep, reduced, force, now, inside):
    """Add the boundary terms of the integrals by parts at the start of a step."""
    state = chain.state
    begins = state.pending != REDUCED
    if begins:
        state.lost += _surplus(chain, creep, reduced)
    if _drives(chain):
        _, viscous = _press(chain, force)
        taken = -viscous * course(chain, now, 1, inside)
        if not begins:
            # The speed of the driven body may jump at the end of a step.
            taken += viscous * course(chain, now, 1, now - 0.25 * RESOLUTION * clock.step)
        state.lost += taken
        state.work += taken


@inlined
def _land(chain, work, clock, stages, balanced):
    """Convert the reduced velocities of a damped chain to velocities at a sample."""
    force, _, reduced, slopes, _ = work
    state = chain.state
    if chain.damped:
        # The conversion needs the forces at the end of the step.
        accelerate(chain, chain.x, state.first, state.last, force, slopes[0])
        add_ground(chain, chain.x, clock.end, state.first, state.last, slopes[0])
        _complete(chain, clock, clock.end, force, slopes[stages], reduced)
        state.pending = 0.0
        if balanced:
            state.lost -= _surplus(chain, slopes[stages], reduced)
            if _drives(chain):
                _, viscous = _press(chain, force)
                before = clock.end - 0.25 * RESOLUTION * clock.step
                taken = viscous * course(chain, clock.end, 1, before)
                state.lost += taken
                state.work += taken


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Take one step of the Runge-Kutta-Nystrom form.

    With the velocities v = w + d, viscous contacts and drag dissipate the power - sum m v d'. After
    integration by parts, the dissipated energy is the integral of sum m w' d, minus the change of
    sum m (v^2 - w^2)/2. The integrand requires no velocities at the stages, and is as smooth as the
    forces.
    """
    (nodes, inner, weights, rates), openings, adaptive = method
    force, z, reduced, slopes, weigh = work
    damped = chain.damped
    lag = chain.viscosity[PAD] if damped and chain.alike else 0.0
    y = chain.x
    w = chain.v
    state = chain.state
    stages = nodes.size
    # With uniform damping the creep is proportional to the slopes, so it needs no separate rows.
    creeps = stages if damped and not chain.alike else 0
    balanced = damped & (out.balance.shape[0] > 0)
    acted = balanced & chain.imposed.acts
    if landed:
        _land(chain, work, clock, stages, balanced)
        return 0
    widen(chain, stages + 2)
    first = state.first
    last = state.last
    window = slice(first, last)
    now = clock.begin + state.done
    remaining = min(
        clock.length - state.done,
        ahead(chain, now, clock.begin + clock.length, RESOLUTION * clock.step),
    )
    # The first stage is at the start of the step; its accelerations also determine the distance to
    # an opening.
    put(z[first - 1 : last + 1], y[first - 1 : last + 1])
    # If the step begins at a kink of the imposed motion or force, `inside` selects the branch
    # after the kink.
    inside = now + 0.5 * min(remaining, clock.equal_step)
    impose(chain, z, now, inside)
    impose_velocity(chain, w, PAD, now)
    accelerate(chain, z, first, last, force, slopes[0])
    add_ground(chain, z, now, first, last, slopes[0])
    if damped:
        _complete(chain, clock, now, force, slopes[stages], reduced)
        if balanced:
            _note_begin(chain, clock, slopes[stages], reduced, force, now, inside)
    h = clock.equal_step
    if adaptive:
        h = clock.step * shorten(chain, z, w, slopes[0], openings)
    done = end_of_step(chain, clock, remaining, h)
    h = done - state.done
    inside = now + 0.5 * h
    _note_stage(chain, acted, work, rates, weights[1, 0], 0, now, inside, h)
    grains = y[window]
    speeds = reduced[window] if damped else w[window]
    stage_grains = z[window]
    for stage in range(1, stages):
        _drift(stage_grains, grains, nodes[stage] * h, speeds)
        count = _weigh(weigh, inner[stage, :stage], rates[stage, :stage], h, lag, creeps)
        add_rows(stage_grains, weigh, count, slopes, window)
        impose(chain, z, now + nodes[stage] * h, now + 0.5 * h)
        accelerate(chain, z, first, last, force, slopes[stage])
        add_ground(chain, z, now + nodes[stage] * h, first, last, slopes[stage])
        if creeps > 0:
            fill_creep(chain, z, force, slopes[stages + stage])
        t = now + nodes[stage] * h
        _note_stage(chain, acted, work, rates, weights[1, stage], stage, t, inside, h)
    _add_one(grains, h, speeds)
    count = _weigh(weigh, weights[0], weights[1], h, lag, creeps)
    add_rows(grains, weigh, count, slopes, window)
    count = 0
    for stage in range(stages):
        count = note(weigh, count, weights[1, stage] * h, stage)
    add_rows(speeds, weigh, count, slopes, window)
    if balanced:
        mass = chain.mass[window]
        state.lost += _sum_losses(mass, weigh, count, slopes, creeps, lag, window)
    state.done = done
    impose(chain, y, clock.begin + state.done, clock.begin + state.done)
    watch(chain)
    if damped:
        put(w[window], reduced[window])
        rest_ahead(chain)
        state.pending = REDUCED
    else:
        look(chain, clock, state.steps + 1, clock.begin + done, 1.0)
    return 1


class Work(NamedTuple):
    """Scratch arrays of one thread.

    Attributes
    ----------
    force : (W,) array
        Forces of the contacts at a stage, N.
    z : (W,) array
        Displacements at a stage, m.
    reduced : (W,) array
        Reduced velocities, m/s.
    slopes : (S, W) or (2 S, W) array
        Accelerations at all stages and, for a damped chain, the creep at all stages.
    weigh : Weighted
        Weights of rows in a sum.
    """

    force: Array
    z: Array
    reduced: Array
    slopes: Array
    weigh: Weighted


def make_work(chains: Chains, method: tuple[Any, ...]) -> Work:
    """Allocate the scratch arrays of one thread."""
    width = chains.x.shape[1]
    stages = method[0][0].size
    weigh = Weighted(np.zeros(2 * stages), np.zeros(2 * stages, np.int64))
    force, z, reduced = np.zeros((3, width))
    slopes = np.zeros((2 * stages if chains.batch.damped else stages, width))
    return Work(force, z, reduced, slopes, weigh)


# `method` contains nodes c (12,), inner weights A^2 (12, 12), weights (2, 12) of a step in
# displacement and velocity, and inner weights A (12, 12); `layout.Shortening`; and whether steps
# are shorter near openings.
march = compiled_march()(sample_loop(_advance, False))


@compiled_march()
def march_by_step(chains, method, work, clocks, fields, real, until, noted):
    """Advance one chain as `march` does, and record its steps in `noted` (`layout.Noted`).

    The function stops when `noted` is full, and returns the number of steps.
    """
    state = chains.state[real]
    made = 0
    while made < noted.ends.size and state.sample < until:
        if made % noted.every == 0:
            checkpoint = made // noted.every
            put(noted.states[checkpoint, 0], chains.x[real])
            put(noted.states[checkpoint, 1], chains.v[real])
            noted.windows[checkpoint, 0] = state.first
            noted.windows[checkpoint, 1] = state.last
        march(chains, method, work, clocks, fields, real, real + 1, until, 1)
        noted.ends[made] = state.done
        made += 1
    return made
