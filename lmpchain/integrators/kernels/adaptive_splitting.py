"""Kick-drift splittings with an adaptive step size around contacts that open or close, compiled.

A method of order p needs p derivatives of the force, which goes like t^delta where a contact opens
or closes; steps that shorten like the distance to that time to the power 9/14 keep the error of
every step the same, and the order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, bits, fma, inlined, number
from .dense_output import Rates, fill_jerk, fill_samples, keep, passes
from .layout import PAD, RESOLUTION, Rows
from .right_hand_side import (
    accelerate,
    ahead,
    hold,
    impose,
    impose_velocity,
    imposed,
    imposed_rate,
    recall,
    slice_links,
    sweep,
)
from .sample_loop import end_of_step, sample_loop
from .team import largest, meet, share
from .window import look, watch, widen

GROUP = 16  # contacts that are looked at together


class Near(NamedTuple):
    """Contacts of a chain, of which the one nearest to opening or closing shortens the step.

    Attributes
    ----------
    weight, reach : (W,) arrays
        See `layout.Openings`.
    close : float
        See `_may_matter`.
    omega : float
        Highest frequency, rad/s.
    nearest : float
        No step is shorter than where the inverse of the distance, over 2 omega, is this.
    """

    weight: Array
    reach: Array
    close: float
    omega: float
    nearest: float


@inlined
def _score(gap, rate, bend, weight, omega, nearest):
    """Return the squared nearness of a contact to opening or closing, weighed by its effect.

    For a contact with the overlap `gap` and its two rates, the force behaves like t^(3/2) around
    the time at which the overlap is 0; of a quadratic through them the nearest root counts, also a
    complex one (a contact that all but opens). The local error of a step h there goes as (h /
    distance)^7 distance^(5/2).
    """
    inside = rate * rate - 2.0 * gap * bend
    size = inside if inside > 0.0 else -inside
    root = math.sqrt(size)
    modulus = math.sqrt(rate * rate + size)
    towards = abs(rate) if gap > 0.0 else rate  # behind a contact that has just opened lies nothing
    fast = towards + root if inside > 0.0 else modulus
    comes = gap if gap > inside else inside
    fast = fast if comes > 0.0 else 0.0
    # 1e-300: an overlap of nothing gives the nearest, not no number
    near = fast / (2.0 * omega * (abs(gap) + 1e-300))
    near = near if near > 0.0 else 0.0
    near = near if near < nearest else nearest
    near2 = near * near
    near4 = near2 * near2
    return weight * (size * root) * (near4 * near4) * near


@inlined
def _may_matter(y, rates, bends, links, reach, close):
    """Say whether any of these contacts may be near enough to an opening to shorten the step.

    That is so from a score of shortened^14 on. In `_score` fast^2 is at most q and `size` at most q
    / 2, so that no root and no quotient is needed: with reach = weight^(1/3) / (sqrt(2) (2
    omega)^3) and close = shortened^(-14/3) no score is as large while q^2 reach close < |gap|^3.
    """
    largest = -1  # as bits, see `window.watch`
    for n in range(reach.size):
        il = links.inverse_length[n]
        gap = abs(links.precompressed + (y[n] - y[n + 1]) * il)
        rate = (rates[n] - rates[n + 1]) * il
        bend = abs((bends[n] - bends[n + 1]) * il)
        q = 4.0 * (rate * rate + gap * bend)
        largest = max(bits(q * q * (close * reach[n]) - gap * gap * gap), largest)
    return largest >= 0


@inlined
def _nearness(y, rates, bends, links, near):
    """Return the largest score of all contacts between the bodies y; 0 if none is near."""
    largest = 0
    size = near.weight.size
    for begin in range(0, size, GROUP):
        end = min(begin + GROUP, size)
        contacts = slice(begin, end)
        ends = slice(begin, end + 1)
        yt = y[ends]
        rt = rates[ends]
        bt = bends[ends]
        il = links.inverse_length[contacts]
        wt = near.weight[contacts]
        if not _may_matter(
            yt, rt, bt, slice_links(links, contacts, 0.0), near.reach[contacts], near.close
        ):
            continue
        for n in range(il.size):
            gap = links.precompressed + (yt[n] - yt[n + 1]) * il[n]
            rate = (rt[n] - rt[n + 1]) * il[n]
            bend = (bt[n] - bt[n + 1]) * il[n]
            largest = max(bits(_score(gap, rate, bend, wt[n], near.omega, near.nearest)), largest)
    most = number(largest)
    if links.uncompressed > 0.0:
        gap = y[0] - y[1]
        rate = rates[0] - rates[1]
        bend = bends[0] - bends[1]
        score = _score(gap, rate, bend, near.weight[0], near.omega, near.nearest)
        most = score if score > most else most
    return most


@inlined
def _finish_kick(chain, margin, rates):
    """Complete the kick of the step before; forces and accelerations are left in `rates`.

    Returns what `fill_jerk` asks for of the forces.
    """
    state = chain.state
    widen(chain, margin)
    meet(chain.team)
    first, last = share(chain)
    # one grain further on either side: how near contacts are to opening depends on it, too
    above = max(first - 1, state.first)
    accelerate(chain, chain.x, above, min(last + 1, state.last), rates.force, rates.pull)
    speeds = chain.v[first:last]
    a = rates.pull[first:last]
    for n in range(speeds.size):
        speeds[n] = fma(state.pending, a[n], speeds[n])
    state.pending = 0.0
    meet(chain.team)
    return above - 1


@inlined
def _fill_passed(chain, rates, clock, span, out, beyond):
    """Fill the samples that the step before has passed; return whether it took jerks (W,)."""
    state = chain.state
    first, last = share(chain)
    if clock.dense == 0 or passes(chain, clock, span, state.step_begin, state.done) == 0:
        return False
    # of what is imposed, by the law before a corner on which the step may have ended
    changes = imposed_rate(chain, span.begin + state.done, span.begin + state.step_begin)
    fill_jerk(chain, first, last, rates, beyond, changes)
    fill_samples(chain, clock, span, first, last, rates, out)
    return True


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step."""
    (kicks, drifts), openings = method
    rows, reach, rates, close, nearest = work
    pull = rates.pull
    y = chain.x
    w = chain.v
    state = chain.state
    stages = drifts.size
    t = span.begin + state.done
    recall(chain, t)
    impose_velocity(chain, w, PAD, t)  # before the forces, like all that is imposed
    beyond = _finish_kick(chain, stages + 1, rates)
    filled = _fill_passed(chain, rates, clock, span, out, beyond)
    watch(chain)
    look(chain, clock, state.steps, t, 1.0)
    first, last = share(chain)
    bodies = slice(first - 1, last + 1)
    near = slice(first - 1, last)
    grains = y[first:last]
    speeds = w[first:last]
    remaining = min(
        span.length - state.done,
        ahead(chain, t, span.begin + span.length, RESOLUTION * clock.step),
    )
    touches = chain.links.uncompressed if first == PAD else 0.0
    links = slice_links(chain.links, near, touches)
    contacts = Near(
        weight=openings.weight[chain.number, near],
        reach=openings.reach[chain.number, near],
        close=close,
        omega=chain.omega,
        nearest=nearest[chain.schedule, chain.number],
    )
    nearness = _nearness(y[bodies], w[bodies], pull[bodies], links, contacts)
    nearness = largest(chain.team, nearness)
    h = clock.step
    # the score goes as the 14th power of how much shorter the step must be for the same error
    if nearness > 0.0:
        h *= min(1.0, openings.shortened * nearness ** (-1 / 14))
    done = end_of_step(chain, span, remaining, h)
    h = done - state.done
    if clock.dense > 0:
        if passes(chain, clock, span, state.done, done) > 0:
            if chain.imposed.acts or not filled:
                fill_jerk(chain, first, last, rates, beyond, imposed_rate(chain, t, t))
            keep(chain, first, last, rates)
            meet(chain.team)  # before the grains next to these move
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
    sweep(chain, rows)
    state.done = done
    state.pending = kicks[stages] * h
    impose(chain, y, span.begin + state.done, span.begin + state.done)
    return 1


@inlined
def _land(chain, method, work, clock, span, out):
    """Complete the last kick."""
    rates = work[2]
    beyond = _finish_kick(chain, method[0].drifts.size + 1, rates)
    _fill_passed(chain, rates, clock, span, out, beyond)
    hold(chain, chain.v)


_march = sample_loop(_advance, False, _land)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clocks, fields, goal):
    """Advance as `sample_loop` says by a splitting with an adaptive step size.

    `method` is `layout.Stages` and `layout.Openings`.
    """
    stages, openings = method
    size = stages.drifts.size - 1
    room = np.zeros((4, size))
    path = room[3, : size if chains.imposed.acts else 0]
    rows = Rows(kick=room[0], drift=room[1], carried=room[2], path=path)
    close = openings.shortened ** (-14 / 3)
    nearest = np.empty((openings.least.size, chains.omega.size))
    for schedule in range(openings.least.size):
        for real in range(chains.omega.size):
            reach = clocks[schedule].step * chains.omega[real]
            crosses = max(openings.factor * reach**openings.power, openings.least[schedule])
            nearest[schedule, real] = (openings.shortened * reach / crosses) ** (14 / 9)
    bodies = np.zeros((4, chains.x.shape[1]))
    rates = Rates(force=bodies[0], pull=bodies[1], rate=bodies[2], jerk=bodies[3])
    work = rows, np.cumsum(stages.drifts), rates, close, nearest
    return _march(chains, method, work, clocks, fields, goal)
