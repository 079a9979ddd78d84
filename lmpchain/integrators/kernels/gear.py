"""Gear's predictor-corrector, the method of the paper, on the same contact forces, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...util.arrays import Array
from .compiling import compiled, compiled_march, inlined, pasted
from .layout import PAD, RESOLUTION, Chains
from .right_hand_side import accelerate, add_ground, cut, hold, impose
from .sample_loop import sample_loop
from .window import look, watch, widen


@compiled
def _touch_alike(chain, y, z, first, last):
    """Return whether contacts of bodies first ... last-1 have the same state in y and z."""
    il = chain.links.inverse_length
    opening = -chain.links.precompressed
    for n in range(first - 1, last):
        shut_y = (y[n] - y[n + 1]) * il[n] > opening
        shut_z = (z[n] - z[n + 1]) * il[n] > opening
        if chain.links.strength[n] > 0.0 and shut_y != shut_z:
            return False
    # A wall that only touches grain 1.
    shut_y = y[PAD - 1] > y[PAD]
    shut_z = z[PAD - 1] > z[PAD]
    return not (first == PAD and chain.links.uncompressed > 0.0 and shut_y != shut_z)


@inlined
def _move(chain, z, begin, h, side):
    """Extrapolate the bodies by `side` steps h into z, with the motion or force imposed there."""
    y = chain.x
    accelerations = chain.history[0]
    state = chain.state
    z[state.first - 1] = y[state.first - 1]
    z[state.last] = y[state.last]
    for n in range(state.first, state.last):
        z[n] = y[n] + side * h * chain.v[n] + 0.5 * (side * h) * (side * h) * accelerations[n]
    impose(chain, z, begin + side * h, begin + RESOLUTION * h)


@compiled
def _begin(chain, work, now, h):
    """Compute the initial derivatives from finite differences one step before and after the start.

    If contacts open or close at the start, for example because an impulse separates touching
    grains, the motion before the start cannot be used. The accelerations half a step and one step
    after the start are used instead.
    """
    force, pull, z = work
    y = chain.x
    derivatives = chain.history
    state = chain.state
    first = state.first
    last = state.last
    state.step_size = h
    impose(chain, y, now, now + RESOLUTION * h)
    accelerate(chain, y, first, last, force, pull)
    add_ground(chain, y, now, first, last, pull)
    for n in range(first, last):
        derivatives[0, n] = pull[n]
    _move(chain, z, now, h, -1.0)
    smooth = _touch_alike(chain, y, z, first, last)
    for side in (1.0, -1.0 if smooth else 0.5):
        _move(chain, z, now, h, side)
        accelerate(chain, z, first, last, force, pull)
        add_ground(chain, z, now + side * h, first, last, pull)
        for n in range(first, last):
            # Differences use accelerations one step before and after, or one step and half a step
            # after.
            if side == 1.0:
                derivatives[1, n] = pull[n]
            elif smooth:
                ahead = derivatives[1, n]
                derivatives[1, n] = (ahead - pull[n]) * h * h / 12
                derivatives[2, n] = pull[n] + ahead - 2.0 * derivatives[0, n]
            else:
                slope = 4.0 * pull[n] - derivatives[1, n] - 3.0 * derivatives[0, n]
                bend = 4.0 * (derivatives[1, n] - 2.0 * pull[n] + derivatives[0, n])
                derivatives[1, n] = slope * h * h / 6
                derivatives[2, n] = bend
    # Derivatives of order 2 and 4 are scaled by h^k / k! here; order 3 has its factor already.
    for n in range(first, last):
        derivatives[2, n] = derivatives[2, n] * h * h / 24
        derivatives[0, n] *= 0.5 * h * h


@inlined
def _step(chain, corrections, work, now, then, h):
    """Take one step: predict by the Taylor series, evaluate the force once, correct."""
    force, pull, _ = work
    y = chain.x
    w = chain.v
    derivatives = chain.history
    state = chain.state
    first = state.first
    last = state.last
    # The history is scaled with the step size, so a step of another size restarts it.
    if state.step_size != h:
        _begin(chain, work, now, h)
    for n in range(first, last):
        a = derivatives[0, n]
        b = derivatives[1, n]
        c = derivatives[2, n]
        y[n] += h * w[n] + a + b + c
        w[n] += (2.0 * a + 3.0 * b + 4.0 * c) / h
        derivatives[0, n] = a + 3.0 * b + 6.0 * c
        derivatives[1, n] = b + 4.0 * c
    impose(chain, y, then, then)
    accelerate(chain, y, first, last, force, pull)
    add_ground(chain, y, then, first, last, pull)
    for n in range(first, last):
        off = 0.5 * h * h * pull[n] - derivatives[0, n]
        y[n] += corrections[0] * off
        w[n] += corrections[1] * off / h
        derivatives[0, n] += corrections[2] * off
        derivatives[1, n] += corrections[3] * off
        derivatives[2, n] += corrections[4] * off
    impose(chain, y, then, then)
    hold(chain, w)
    # The derivatives of a driven grain are imposed, too.
    if chain.inverse_mass[PAD] == 0.0:
        derivatives[0, PAD] = 0.0
        derivatives[1, PAD] = 0.0
        derivatives[2, PAD] = 0.0


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Take one step, or two if the imposed motion or force ends within it, with a restart there."""
    if landed:
        return 0
    (corrections,) = method
    state = chain.state
    h = clock.equal_step
    widen(chain, 4)
    now = clock.begin + state.done * h
    then = clock.begin + (state.done + 1) * h
    to_kink = cut(chain, now, h)
    kink = now + to_kink if to_kink > 0.0 else then
    for begin, end, length in (
        (now, kink, to_kink if to_kink > 0.0 else h),
        (kink, then, h - to_kink),
    ):
        if begin < end:
            _step(chain, corrections, work, begin, end, length)
        # The history restarts after the kink, also if both parts of the step have equal lengths.
        if to_kink > 0.0:
            state.step_size = 0.0
    watch(chain)
    look(chain, clock, state.steps + 1, then, 1.0)
    state.done += 1.0
    return 1


def make_work(chains: Chains, method: tuple[Any, ...]) -> tuple[Array, Array, Array]:
    """Allocate the scratch arrays of one thread: forces, accelerations, and shifted bodies."""
    force, pull, third = np.zeros((3, chains.x.shape[1]))
    return force, pull, third


# `method` contains the corrector coefficients (5,). `chains.history` contains the second, third and
# fourth derivatives of the displacements, times h^k / k!.
march = compiled_march()(sample_loop(_advance, True))
