"""Velocity Verlet for a dissipative chain, as implemented in LAMMPS, compiled.

Forces that depend on velocities use a velocity that is predicted from the last acceleration.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...util.arrays import Array
from .compiling import compiled_march, inlined, pasted
from .layout import PAD, Chains
from .right_hand_side import accelerate, add_ground, forced, hold, impose, impose_velocity
from .sample_loop import sample_loop
from .window import fill_rates, look, watch, widen


@inlined
def _accelerate(chain, work, t):
    """Compute accelerations from the current bodies and velocities, in `chain.history[0]`."""
    force, pull, rate = work
    first = chain.state.first
    last = chain.state.last
    v = chain.v
    a = chain.history[0]
    impose(chain, chain.x, t, t)
    impose_velocity(chain, v, PAD, t)
    accelerate(chain, chain.x, first, last, force, pull)
    add_ground(chain, chain.x, t, first, last, pull)
    fill_rates(chain, first, last, force, rate, first - 1)
    viscosity = chain.viscosity
    for n in range(first, last):
        pressed = viscosity[n - 1] * rate[n - 1] - viscosity[n] * rate[n]
        a[n] = pull[n] + chain.inverse_mass[n] * pressed - chain.drag[n] * v[n]


@inlined
def _note(chain, work, h):
    """Add the dissipated energy and the work of a step h, by the trapezoidal rule."""
    force, _, rate = work
    state = chain.state
    first = state.first
    v = chain.v
    viscosity = chain.viscosity
    drag = chain.drag
    mass = chain.mass
    lost = 0.0
    for n in range(first - 1, state.last):
        lost += viscosity[n] * rate[n] * (v[n] - v[n + 1]) + mass[n] * drag[n] * v[n] * v[n]
    given = 0.0
    body = chain.imposed.wave.body if chain.imposed.acts else 0
    if body > 0:
        pressed = force[body - first + 1] + viscosity[body] * rate[body]
        if body == PAD:
            pressed -= force[0] + viscosity[PAD - 1] * rate[PAD - 1]
        given = pressed * v[body]
    pushed = forced(chain)
    if pushed > 0:
        given = chain.x[0] * v[pushed]
    state.lost += 0.5 * h * (state.loss_rate + lost)
    state.work += 0.5 * h * (state.work_rate + given)
    state.loss_rate = lost
    state.work_rate = given


@pasted
def _advance(chain, method, work, clock, out, landed):
    """Take one step: half a kick, a drift, the forces at predicted velocities, half a kick."""
    if landed:
        return 0
    lead = method[0]
    balanced = out.balance.shape[0] > 0
    state = chain.state
    x = chain.x
    v = chain.v
    h = clock.equal_step
    then = clock.begin + (state.done + 1) * h
    widen(chain, 2)
    a = chain.history[0]
    middle = chain.history[1]
    # At later steps the accelerations are known from the end of the previous step.
    if state.steps == 0:
        _accelerate(chain, work, clock.begin)
        if balanced:
            _note(chain, work, 0.0)
    hold(chain, v)
    for n in range(state.first, state.last):
        middle[n] = v[n] + 0.5 * h * a[n]
        x[n] += h * middle[n]
        v[n] += lead * h * a[n]
    _accelerate(chain, work, then)
    for n in range(state.first, state.last):
        v[n] = middle[n] + 0.5 * h * a[n]
    impose_velocity(chain, v, PAD, then)
    if balanced:
        _note(chain, work, h)
    watch(chain)
    look(chain, clock, state.steps + 1, then, 1.0)
    state.done += 1.0
    return 1


def make_work(chains: Chains, method: tuple[Any, ...]) -> tuple[Array, Array, Array]:
    """Allocate the scratch arrays of one thread: forces, accelerations, and force rates."""
    force, pull, third = np.zeros((3, chains.x.shape[1]))
    return force, pull, third


# `method` contains the time, in steps, by which the velocity in the forces is predicted ahead.
# `chains.history` contains the accelerations, and the velocities in the middle of a step.
march = compiled_march()(sample_loop(_advance, True))
