"""Gear's predictor-corrector, the method of the paper, on the same contact forces, compiled."""

from __future__ import annotations

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, compiled, inlined
from .layout import PAD, RESOLUTION
from .right_hand_side import accelerate, cut, hold, impose
from .sample_loop import sample_loop
from .window import look, watch, widen


@compiled
def _touch_alike(chain, y, z, first, last):
    """Return whether the contacts around bodies first ... last-1 are open in y where they are in z."""
    il, least = chain.inverse_length, -chain.precompressed
    for n in range(first - 1, last):
        shut = (y[n] - y[n + 1]) * il[n] > least, (z[n] - z[n + 1]) * il[n] > least
        if chain.strength[n] > 0.0 and shut[0] != shut[1]:
            return False
    above = y[PAD - 1] > y[PAD], z[PAD - 1] > z[PAD]
    return not (first == PAD and chain.uncompressed > 0.0 and above[0] != above[1])


@inlined
def _move(chain, y, z, first, last, now, side, h, inside, accelerations):
    """Put in z where the bodies of y, and what is imposed, are `side` steps h from now."""
    z[first - 1], z[last] = y[first - 1], y[last]
    for n in range(first, last):
        z[n] = y[n] + side * h * chain.v[n] + 0.5 * (side * h) * (side * h) * accelerations[n]
    impose(chain, z, now + side * h, inside)


@compiled
def _begin(chain, work, now, h):
    """Find the derivatives at the start by the law that holds now, from a step before to a step after.

    Where contacts have just opened or closed, as a strike parts grains that touch, the step before is no part of the
    motion: half a step after stands for it.
    """
    force, pull, z = work
    y, more, state = chain.x, chain.history, chain.state
    first, last = state.first, state.last
    state.step_size = h
    inside = now + RESOLUTION * h
    impose(chain, y, now, inside)
    accelerate(chain, y, first, last, force, pull)
    for n in range(first, last):
        more[0, n] = pull[n]
    _move(chain, y, z, first, last, now, -1.0, h, inside, more[0])
    smooth = _touch_alike(chain, y, z, first, last)
    for side in (1.0, -1.0 if smooth else 0.5):
        _move(chain, y, z, first, last, now, side, h, inside, more[0])
        accelerate(chain, z, first, last, force, pull)
        for n in range(first, last):
            if side == 1.0:
                more[1, n] = pull[n]
            elif smooth:
                more[1, n], more[2, n] = (
                    (more[1, n] - pull[n]) * h * h / 12,
                    pull[n] + more[1, n] - 2.0 * more[0, n],
                )
            else:
                slope = 4.0 * pull[n] - more[1, n] - 3.0 * more[0, n]
                bend = 4.0 * (more[1, n] - 2.0 * pull[n] + more[0, n])
                more[1, n], more[2, n] = slope * h * h / 6, bend
    for n in range(first, last):
        more[2, n] = more[2, n] * h * h / 24
        more[0, n] *= 0.5 * h * h


@inlined
def _step(chain, corrections, work, now, then, h):
    """Take one step: predict by the Taylor series, evaluate the force once, correct."""
    force, pull, _ = work
    y, w, more, state = chain.x, chain.v, chain.history, chain.state
    first, last = state.first, state.last
    if state.step_size != h:
        _begin(chain, work, now, h)
    for n in range(first, last):
        a, b, c = more[0, n], more[1, n], more[2, n]
        y[n] += h * w[n] + a + b + c
        w[n] += (2.0 * a + 3.0 * b + 4.0 * c) / h
        more[0, n], more[1, n] = a + 3.0 * b + 6.0 * c, b + 4.0 * c
    impose(chain, y, then, then)
    accelerate(chain, y, first, last, force, pull)
    for n in range(first, last):
        off = 0.5 * h * h * pull[n] - more[0, n]
        y[n] += corrections[0] * off
        w[n] += corrections[1] * off / h
        more[0, n] += corrections[2] * off
        more[1, n] += corrections[3] * off
        more[2, n] += corrections[4] * off
    impose(chain, y, then, then)
    hold(chain, w)
    if chain.inverse_mass[PAD] == 0.0:  # its derivatives are imposed, too
        more[0, PAD], more[1, PAD], more[2, PAD] = 0.0, 0.0, 0.0


@inlined
def _advance(chain, method, work, clock, span, out):
    """Take one step, or two where what is imposed ends within it, and begin anew there."""
    (corrections,) = method
    state, h = chain.state, span.step
    widen(chain, 4)
    now, then = span.begin + state.done * h, span.begin + (state.done + 1) * h
    first = cut(chain, now, h)
    corner = now + first if first > 0.0 else then
    for begin, end, length in (
        (now, corner, first if first > 0.0 else h),
        (corner, then, h - first),
    ):
        if begin < end:
            _step(chain, corrections, work, begin, end, length)
    if first > 0.0:
        state.step_size = 0.0
    watch(chain)
    look(chain, clock, state.steps + 1, then, 1.0)
    state.done += 1.0
    return 1


_march = sample_loop(_advance, True)


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(chains, method, clocks, fields, begin, end, until, max_steps):
    """Advance as `sample_loop` says by Gear's method of five values.

    `method` is its coefficients (5,). `chains.history`
    holds the second, third and fourth derivatives of the displacements, times h^k / k!.
    """
    width = chains.x.shape[1]
    force, pull, moved = np.zeros(width), np.zeros(width), np.zeros(width)
    work = force, pull, moved
    return _march(chains, method, work, clocks, fields, begin, end, until, max_steps)
