"""Kick-drift splittings with an adaptive step size around contacts that open or close, compiled.

A method of order p needs p derivatives of the force, which goes like t^delta where a contact opens or closes; steps
that shorten like the distance to that time to the power 9/14 keep the error of every step the same, and the order.
"""

from __future__ import annotations

import math

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, bits, fma, inlined, number
from .dense_output import fill_jerk, fill_samples, keep, passes
from .layout import PAD, RESOLUTION
from .right_hand_side import (
    accelerate,
    ahead,
    hold,
    impose,
    impose_velocity,
    imposed,
    imposed_rate,
    recall,
    sweep,
)
from .sample_loop import clock_of, end_of_step, sample_loop
from .team import largest, meet, mine
from .window import look, watch, widen

TILE = 16  # contacts that are looked at together


@inlined
def _score(gap, rate, bend, weight, omega, nearest):
    """Return the squared nearness of a contact to opening or closing, weighed by its effect on the motion.

    For a contact with the overlap `gap` and its two rates, the force behaves like t^(3/2) around the time at which the
    overlap is 0; of a quadratic through them the nearest root counts, also a complex one (a contact that all but
    opens). The local error of a step h there goes as (h / distance)^7 distance^(5/2).
    """
    inside = rate * rate - 2.0 * gap * bend
    size = inside if inside > 0.0 else -inside
    root, modulus = math.sqrt(size), math.sqrt(rate * rate + size)
    towards = abs(rate) if gap > 0.0 else rate  # behind a contact that has just opened lies nothing
    fast = towards + root if inside > 0.0 else modulus
    comes = gap if gap > inside else inside
    fast = fast if comes > 0.0 else 0.0
    near = fast / (2.0 * omega * (abs(gap) + 1e-300))
    near = near if near > 0.0 else 0.0
    near = near if near < nearest else nearest
    near2 = near * near
    near4 = near2 * near2
    return weight * (size * root) * (near4 * near4) * near


@inlined
def _may_matter(y, rates, bends, inverse_length, reach, close, precompressed):
    """Say whether any of these contacts may be near enough to opening or closing to shorten the step.

    That is so from a score of shortened^14 on. In `_score` fast^2 is at most q and `size` at most q / 2, so that no
    root and no quotient is needed: with reach = weight^(1/3) / (sqrt(2) (2 omega)^3) and close = shortened^(-14/3) no
    score is as large while q^2 reach close < |gap|^3.
    """
    most = -1  # as bits, see `window.watch`
    for n in range(inverse_length.size):
        il = inverse_length[n]
        gap = abs(precompressed + (y[n] - y[n + 1]) * il)
        rate, bend = (rates[n] - rates[n + 1]) * il, abs((bends[n] - bends[n + 1]) * il)
        q = 4.0 * (rate * rate + gap * bend)
        most = max(bits(q * q * (close * reach[n]) - gap * gap * gap), most)
    return most >= 0


@inlined
def _nearness(
    y,
    rates,
    bends,
    inverse_length,
    weight,
    reach,
    close,
    precompressed,
    uncompressed,
    omega,
    nearest,
):
    """Return the largest score of all contacts between the bodies y; 0 if none is near."""
    largest, size = 0, inverse_length.size
    for begin in range(0, size, TILE):
        end = min(begin + TILE, size)
        these, ends = slice(begin, end), slice(begin, end + 1)
        yt, rt, bt, il, wt = y[ends], rates[ends], bends[ends], inverse_length[these], weight[these]
        if not _may_matter(yt, rt, bt, il, reach[these], close, precompressed):
            continue
        for n in range(il.size):
            gap = precompressed + (yt[n] - yt[n + 1]) * il[n]
            rate, bend = (rt[n] - rt[n + 1]) * il[n], (bt[n] - bt[n + 1]) * il[n]
            largest = max(bits(_score(gap, rate, bend, wt[n], omega, nearest)), largest)
    most = number(largest)
    if uncompressed > 0.0:
        score = _score(
            y[0] - y[1], rates[0] - rates[1], bends[0] - bends[1], weight[0], omega, nearest
        )
        most = score if score > most else most
    return most


@inlined
def _finish_kick(chain, margin, force, pull):
    """Complete the kick of the step before with the acceleration (W,), which is left in pull.

    Returns what `fill_jerk` asks for of the forces, which are left in `force`.
    """
    state = chain.state
    widen(chain, margin)
    meet(chain.team)
    first, last = mine(chain)
    # one grain further on either side: how near contacts are to opening depends on it, too
    above = max(first - 1, state.first)
    accelerate(chain, chain.x, above, min(last + 1, state.last), force, pull)
    speeds, a = chain.v[first:last], pull[first:last]
    for n in range(speeds.size):
        speeds[n] = fma(state.pending, a[n], speeds[n])
    state.pending = 0.0
    meet(chain.team)
    return above - 1


@inlined
def _fill_passed(chain, work, clock, span, out, beyond):
    """Fill the samples that the step before has passed; return whether it took jerks (W,)."""
    force, pull, rate, jerk = work[5:9]
    state, (first, last) = chain.state, mine(chain)
    if clock.dense == 0 or passes(chain, clock, span, state.step_begin, state.done) == 0:
        return False
    changes = imposed_rate(
        chain, span.begin + state.done, span.begin + state.step_begin
    )  # as before a corner
    fill_jerk(chain, first, last, force, beyond, rate, jerk, changes)
    fill_samples(chain, clock, span, first, last, pull, jerk, out)
    return True


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step."""
    kicks, drifts, shortened, _, weight, near_enough = method
    kick, drift, carried, path, reach, force, pull, rate, jerk, close, nearest = work
    y, w, state, stages = chain.x, chain.v, chain.state, drifts.size
    t = span.begin + state.done
    recall(chain, t)
    impose_velocity(chain, w, PAD, t)  # before the forces, like all that is imposed
    beyond = _finish_kick(chain, stages + 1, force, pull)
    known = _fill_passed(chain, work, clock, span, out, beyond)
    watch(chain)
    look(chain, clock, state.steps, t, 1.0)
    first, last = mine(chain)
    bodies, near, grains, speeds = (
        slice(first - 1, last + 1),
        slice(first - 1, last),
        y[first:last],
        w[first:last],
    )
    left = min(
        span.length - state.done,
        ahead(chain, t, span.begin + span.length, RESOLUTION * clock.step),
    )
    nearness = _nearness(
        y[bodies], w[bodies], pull[bodies], chain.inverse_length[near], weight[chain.number, near],
        near_enough[chain.number, near], close, chain.precompressed, chain.uncompressed if first == PAD else 0.0,
        chain.omega, nearest[chain.schedule, chain.number],
    )  # fmt: skip
    nearness = largest(chain.team, nearness)
    h = clock.step * min(1.0, shortened * nearness ** (-1 / 14)) if nearness > 0.0 else clock.step
    done = end_of_step(chain, span, left, h)
    h = done - state.done
    if clock.dense > 0:
        if passes(chain, clock, span, state.done, done) > 0:
            if chain.imposed or not known:
                fill_jerk(chain, first, last, force, beyond, rate, jerk, imposed_rate(chain, t, t))
            keep(chain, first, last, pull, jerk)
            meet(chain.team)  # before the grains next to these move
        state.step_begin = state.done
    hold(chain, w)
    if chain.imposed:
        for stage in range(stages - 1):
            path[stage] = imposed(chain, t + reach[stage] * h)
    a = pull[first:last]
    for n in range(speeds.size):
        speeds[n] = fma(kicks[0] * h, a[n], speeds[n])
        grains[n] = fma(drifts[0] * h, speeds[n], grains[n])
    for stage in range(stages - 1):
        kick[stage], drift[stage] = kicks[stage + 1] * h, drifts[stage + 1] * h
    sweep(chain, kick, drift, carried, path)
    state.done = done
    state.pending = kicks[stages] * h
    impose(chain, y, span.begin + state.done, span.begin + state.done)
    return 1


@inlined
def _land(chain, method, work, clock, span, out):
    """Complete the last kick."""
    beyond = _finish_kick(chain, method[1].size + 1, work[5], work[6])
    _fill_passed(chain, work, clock, span, out, beyond)
    hold(chain, chain.v)


_march = sample_loop(_advance, False, _land)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clocks, fields, begin, end, until, max_steps):
    """Advance as `sample_loop` says by a splitting with an adaptive step size.

    Parameters
    ----------
    method : kicks (S+1,) and drifts (S,) as parts of a step; h' / h of the shortened steps; c, p and, of F schedules,
        b (F,) of the one that crosses an opening, omega h' = max(c (omega h)^p, b); of R chains and each contact the
        square of the acceleration that it gives over what changes the motion, and the reach of `_may_matter`, (R, W)
    """
    rows, width = method[1].size - 1, chains.x.shape[1]
    kick, drift, carried, path = (
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows if chains.imposed else 0),
    )
    shortened, (factor, power, least) = method[2:4]
    close, nearest = shortened ** (-14 / 3), np.empty((least.size, chains.omega.size))
    for schedule in range(least.size):
        for real in range(chains.omega.size):
            reach = clock_of(clocks, schedule).step * chains.omega[real]
            crosses = max(factor * reach**power, least[schedule])
            nearest[schedule, real] = (shortened * reach / crosses) ** (14 / 9)
    room, ahead_of = np.zeros((4, width)), np.cumsum(method[1])
    work = kick, drift, carried, path, ahead_of, room[0], room[1], room[2], room[3], close, nearest
    return _march(chains, method, work, clocks, fields, begin, end, until, max_steps)
