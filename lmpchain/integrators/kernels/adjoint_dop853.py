"""A run of a damped chain by DOP853, its adjoint, and its tangent, compiled.

Chains are advanced in displacements x and reduced velocities w, see `dop853`. The displacements at
stage i of a step h are

    z_i = x + c_i h w + sum over j < i of (h^2 (A^2)_ij a_j + h A_ij d_j),

with accelerations a_j and creep d_j at z_j, and the state at the end of a step is a similar sum.
Derivatives are propagated back through these sums one by one. Forces of contacts and their
derivatives are as in `adjoint`; a contact has the index of the body below it. At observations and
at t = 0, the creep of the first stage of a step converts between velocities and reduced velocities.
Therefore one more first stage is evaluated after the last step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .adjoint import ImposedPath
from .adjoint_rows import Way, hertz_power, power, touch
from .compiling import apart
from .dop853 import Weighted, add_rows, note
from .layout import PAD
from .sample_loop import chain_of, compiled_gradient, loop
from .window import rest_ahead


class Tableau(NamedTuple):
    """Coefficients of DOP853 (see `dop853.march`).

    Attributes
    ----------
    nodes : (S,) array
        Times of the stages, as fractions of a step.
    inner : (S, S) array
        Square of the matrix A: weights of the accelerations in the displacements at the stages.
    weights : (2, S) array
        Weights of the accelerations in the displacement and in the velocity at the end of a step.
    rates : (S, S) array
        Matrix A: weights of the rates in the states at the stages.
    """

    nodes: Array
    inner: Array
    weights: Array
    rates: Array


class StepsAndLooks(NamedTuple):
    """Steps of a run, and the observations between them.

    Attributes
    ----------
    lengths : (K,) array
        Lengths of the steps, s.
    look : (K+1,) array
        Number of the observation at the start of each step, and at the end of the last step;
        negative if grains are not observed there.
    """

    lengths: Array
    look: NDArray[np.int64]


class Dop853Pieces(NamedTuple):
    """Pieces of a run between checkpoints.

    Attributes
    ----------
    starts : (P+1,) array
        Number of the first step of each piece.
    states : (P+1, 2, W) array
        Displacements and reduced velocities at the start of each piece. If grains are observed
        there, the velocities are complete.
    windows : (P, 2) array
        First body of the window, and the body after its last one, at the end of each piece.
    """

    starts: NDArray[np.int64]
    states: Array
    windows: NDArray[np.int64]


class Damped(NamedTuple):
    """Bodies and contacts of a damped chain, (W,) arrays.

    Attributes
    ----------
    inverse_mass : (W,) array
        Inverse mass of each body, 1/kg; 0 for a body that is held or driven.
    drag : (W,) array
        Drag gamma of each body, 1/s.
    inverse_length : (W,) array
        1 / length of the contact above each body, 1/m, see `adjoint`.
    strength : (W,) array
        Strength F of the contact above each body, N.
    stiffness : (W,) array
        delta F / length of the contact above each body, N/m.
    viscosity : (W,) array
        Viscosity A of the contact above each body, s.
    """

    inverse_mass: Array
    drag: Array
    inverse_length: Array
    strength: Array
    stiffness: Array
    viscosity: Array


class DampedSystem(NamedTuple):
    """Equation of motion of a damped chain, and the method that integrates it.

    Attributes
    ----------
    law : AdjointForce
        Parameters of the contact force.
    damped : Damped
        Bodies and contacts.
    tableau : Tableau
        Coefficients of the method.
    creeps : bool
        Whether creep is stored in arrays of its own; otherwise it is `lag` times the acceleration.
    lag : float
        Ratio of creep to acceleration, s.
    """

    law: Any
    damped: Damped
    tableau: Tableau
    creeps: bool
    lag: float


class StageStates(NamedTuple):
    """Displacements at the stages of one or several steps, (S, W), and p and f of contacts.

    The derivatives of a contact that touches without a force at rest are computed by the formula
    for compressed contacts. The stored p of such a contact is therefore reduced by 1.

    Attributes
    ----------
    x : (S, W) array
        Displacements of the bodies, m.
    powers : (S, W) array
        Relative change p of every contact, see `adjoint`.
    forces : (S, W) array
        Force f of every contact minus its force at rest, N.
    """

    x: Array
    powers: Array
    forces: Array


class StageRates(NamedTuple):
    """Accelerations and creep at the stages of a step, or their derivatives, (S, W).

    Attributes
    ----------
    slopes : (S, W) array
        Accelerations, m/s2.
    creeps : (S, W) array
        Creep, m/s, as defined in `dop853`.
    rows : (2 S, W) array
        Array that contains the accelerations and, below, the creep.
    """

    slopes: Array
    creeps: Array
    rows: Array


def rates_of(rows: Array) -> StageRates:
    """Return views of the rows (2 S, W) as accelerations and creep."""
    stages = len(rows) // 2
    return StageRates(rows[:stages], rows[stages:], rows)


class AdjointSums(NamedTuple):
    """Derivatives of an objective, (W,) arrays, and scratch arrays.

    Attributes
    ----------
    x : (W,) array
        Derivatives with respect to displacements.
    w : (W,) array
        Derivatives with respect to reduced velocities.
    power : (W,) array
        Sum over all stages of y p for each contact, where y is the derivative with respect to the
        force of the contact.
    force : (W,) array
        Sum over all stages of y f for each contact.
    viscosity : (W,) array
        Derivatives with respect to the viscosity of each contact.
    mass : (W,) array
        Derivatives with respect to the mass of each body, times minus the mass.
    drag : (W,) array
        Derivatives with respect to the drag of each body, times -1.
    stages : (S, W) array
        Derivatives with respect to the displacements at the stages.
    pull : (W,) array
        Derivatives with respect to the accelerations of a stage, over the mass.
    creep : (W,) array
        Derivatives with respect to the creep of a stage.
    pressed : (W,) array
        Derivatives with respect to the creep of a stage, over the mass.
    bend : (W,) array
        Derivatives with respect to the approach of the two bodies of each contact.
    """

    x: Array
    w: Array
    power: Array
    force: Array
    viscosity: Array
    mass: Array
    drag: Array
    stages: Array
    pull: Array
    creep: Array
    pressed: Array
    bend: Array


class Change(NamedTuple):
    """D small changes of bodies and of the parameters of the motion, (D, W) arrays.

    Attributes
    ----------
    x : (D, W) array
        Changes of displacements, m; overwritten.
    w : (D, W) array
        Changes of reduced velocities, m/s, and of complete velocities at t = 0; overwritten.
    mass : (D, W) array
        Relative changes of masses.
    constant : (D, W) array
        Changes of the constants of contacts, N/m^delta.
    force : (D, W) array
        Changes of the forces of contacts at rest, N.
    viscosity : (D, W) array
        Changes of the viscosities of contacts, s.
    drag : (D, W) array
        Changes of the drag of bodies, 1/s.
    path : (D, rows) array
        Changes of the imposed displacement, m, or force, N, in each row.
    inverse_constant : (W,) array
        1 / constant of each contact.
    at_rest : (W,) array
        Force of each contact at rest, N.
    """

    x: Array
    w: Array
    mass: Array
    constant: Array
    force: Array
    viscosity: Array
    drag: Array
    path: Array
    inverse_constant: Array
    at_rest: Array


class Dop853Memory(NamedTuple):
    """Scratch arrays: stages of some steps, rates, weights, and sums of the reverse pass.

    Attributes
    ----------
    stages : StageStates
        States at the stages of some steps.
    rates : StageRates
        Rates at the stages of a step.
    weigh : Weighted
        Weights of rows in a sum.
    others : AdjointSums or StageRates
        Sums of the reverse pass; for the tangent, rates of the small changes.
    """

    stages: StageStates
    rates: StageRates
    weigh: Weighted
    others: Any


@loop
def _evaluate(law, inverse_length, strength, x, p, f):
    """Fill p and f (C,) of the contacts between bodies x (C+1,)."""
    apart()
    c = law.pressed
    for n in range(p.size):
        s = (x[n] - x[n + 1]) * inverse_length[n]
        # An open contact is treated as one that has just closed.
        s = s if s > -c else -c
        p[n] = hertz_power(s, c) if law.way == Way.HERTZ else power(s, c, law.less)
        f[n] = strength[n] * (c * (s + p[n]) + s * p[n])


@loop
def _fill_rates(inverse_mass, viscosity, drag, x, f, slope, creep):
    """Fill slope and creep (B,) of bodies x (B,) from the forces f (B+1,) around them."""
    apart()
    for n in range(x.size):
        slope[n] = inverse_mass[n] * (f[n] - f[n + 1])
        pressed = viscosity[n] * f[n] - viscosity[n + 1] * f[n + 1]
        creep[n] = inverse_mass[n] * pressed - drag[n] * x[n]


@loop
def _add(sums, weight, values, other_weight, others):
    """Add the weighted sum of two arrays to `sums`."""
    apart()
    for n in range(sums.size):
        sums[n] += weight * values[n] + other_weight * others[n]


@loop
def _add_four_to_both(sums, other_sums, weights, other_weights, a, b, c, d):
    """Add four arrays, each weighted in two ways, to two sums, in one pass through memory."""
    apart()
    for n in range(sums.size):
        total = sums[n] + weights[0] * a[n] + weights[1] * b[n]
        sums[n] = total + weights[2] * c[n] + weights[3] * d[n]
        total = other_sums[n] + other_weights[0] * a[n] + other_weights[1] * b[n]
        other_sums[n] = total + other_weights[2] * c[n] + other_weights[3] * d[n]


@loop
def _add_rows_to_both(sums, other_sums, weighted, count, rows, window):
    """Add the first `count` weighted rows, restricted to a window, to two sums.

    The second half of the weights belongs to the second sum; see `dop853.add_rows`.
    """
    weights, numbers = weighted
    half = weights.size // 2
    for n in range(0, count - 3, 4):
        m = half + n
        _add_four_to_both(
            sums,
            other_sums,
            (weights[n], weights[n + 1], weights[n + 2], weights[n + 3]),
            (weights[m], weights[m + 1], weights[m + 2], weights[m + 3]),
            rows[numbers[n], window],
            rows[numbers[n + 1], window],
            rows[numbers[n + 2], window],
            rows[numbers[n + 3], window],
        )
    for n in range(count // 4 * 4, count):
        _add_to_both(sums, other_sums, weights[n], weights[half + n], rows[numbers[n], window])


@loop
def _add_to_both(sums, other_sums, weight, other_weight, values):
    """Add the values, weighted in two ways, to two sums."""
    apart()
    for n in range(values.size):
        sums[n] += weight * values[n]
        other_sums[n] += other_weight * values[n]


@loop
def _drift(out, x, reach, w):
    """Fill out with x + reach w."""
    for n in range(out.size):
        out[n] = x[n] + reach * w[n]


@loop
def _stages_of(stages, step):
    """Return the stages of one step."""
    return StageStates(stages.x[step], stages.powers[step], stages.forces[step])


@loop
def _path_of(path, index, count):
    """Return the imposed values in the stages of a step; an empty path if nothing is imposed."""
    rows = slice(index, index + count)
    return ImposedPath(path.body, path.imposed[rows], path.derivative[rows])


@loop
def _fill_stage(chain, system, path, stages, stage, rates):
    """Compute forces and rates of a stage from its displacements in the window."""
    law = system.law
    damped = system.damped
    first = chain.state.first
    last = chain.state.last
    bodies = slice(first, last)
    contacts = slice(first, last + 1)
    z = stages.x[stage]
    p = stages.powers[stage]
    f = stages.forces[stage]
    # Bodies outside of the window are at rest.
    z[first - 1] = chain.x[first - 1]
    z[last] = chain.x[last]
    if path.body > 0:
        z[path.body] = path.imposed[stage]
    _evaluate(
        law,
        damped.inverse_length[contacts],
        damped.strength[contacts],
        z[first - 1 : last + 1],
        p[contacts],
        f[contacts],
    )
    if law.touching > 0.0 and first == PAD:
        bare, touching = touch(z[PAD - 1] - z[PAD], law.touching, law.less)
        p[PAD] = bare - law.pressed
        f[PAD] = touching
    _fill_rates(
        damped.inverse_mass[bodies],
        damped.viscosity[contacts],
        damped.drag[bodies],
        z[bodies],
        f[contacts],
        rates.slopes[stage, bodies],
        rates.creeps[stage, bodies],
    )
    if path.body < 0:
        body = -path.body
        rates.slopes[stage, body] += damped.inverse_mass[body] * path.imposed[stage]


@loop
def _begin_step(chain, system, path, stages, rates, unreduced):
    """Compute the first stage of a step; if `unreduced`, reduce the velocities afterwards."""
    bodies = slice(chain.state.first, chain.state.last)
    w = chain.v[bodies]
    _drift(stages.x[0, bodies], chain.x[bodies], 0.0, w)
    _fill_stage(chain, system, path, stages, 0, rates)
    if unreduced:
        _drift(w, w, -1.0, rates.creeps[0, bodies])


@loop
def _end_step(chain, system, h, path, stages, memory):
    """Compute the other stages of a step, and advance the bodies to its end."""
    rates = memory.rates
    weigh = memory.weigh
    tableau = system.tableau
    bodies = slice(chain.state.first, chain.state.last)
    x = chain.x[bodies]
    w = chain.v[bodies]
    count = tableau.nodes.size
    for stage in range(1, count):
        z = stages.x[stage, bodies]
        _drift(z, x, tableau.nodes[stage] * h, w)
        terms = 0
        for earlier in range(stage):
            along = tableau.rates[stage, earlier] * h
            weight = tableau.inner[stage, earlier] * h * h + system.lag * along
            terms = note(weigh, terms, weight, earlier)
            if system.creeps:
                terms = note(weigh, terms, along, count + earlier)
        add_rows(z, weigh, terms, rates.rows, bodies)
        _fill_stage(chain, system, path, stages, stage, rates)
    _drift(x, x, h, w)
    terms = 0
    for stage in range(count):
        along = tableau.weights[1, stage] * h
        terms = note(weigh, terms, tableau.weights[0, stage] * h * h + system.lag * along, stage)
        if system.creeps:
            terms = note(weigh, terms, along, count + stage)
    add_rows(x, weigh, terms, rates.rows, bodies)
    terms = 0
    for stage in range(count):
        terms = note(weigh, terms, tableau.weights[1, stage] * h, stage)
    add_rows(w, weigh, terms, rates.rows, bodies)


@loop
def _back_contacts(law, stiffness, viscosity, p, f, adjoints, sums):
    """Propagate adjoints of bodies (C+1,) back through the contacts (C,) between them.

    `adjoints` contains the arrays `pull`, `pressed` and `bend` of `AdjointSums`; `bend` is the
    result. `sums` contains the arrays `power`, `force` and `viscosity`, to which terms are added.
    """
    apart()
    pull, pressed, bend = adjoints
    by_power, by_force, by_viscosity = sums
    for n in range(p.size):
        viscous = pressed[n + 1] - pressed[n]
        y = (pull[n + 1] - pull[n]) + viscosity[n] * viscous
        by_power[n] += y * p[n]
        by_force[n] += y * f[n]
        by_viscosity[n] += viscous * f[n]
        bend[n] = stiffness[n] * (law.pressed + p[n]) * y


@loop
def _back_bodies(drag, viscosity, x, f, adjoints, sums):
    """Propagate adjoints back to bodies x (B,), between the contacts with forces f (B+1,).

    `adjoints` contains the arrays `pull`, `creep`, `pressed` and `bend` of `AdjointSums`, and the
    result, the derivatives with respect to x. `sums` contains the arrays `mass` and `drag`, to
    which terms are added.
    """
    apart()
    pull, creep, pressed, bend, by_x = adjoints
    by_mass, by_drag = sums
    for n in range(x.size):
        viscous = viscosity[n] * f[n] - viscosity[n + 1] * f[n + 1]
        by_mass[n] += pull[n] * (f[n] - f[n + 1]) + pressed[n] * viscous
        by_drag[n] += creep[n] * x[n]
        by_x[n] = bend[n + 1] - bend[n] - drag[n] * creep[n]


@loop
def _back_stage(window, system, path, stages, stage, sums):
    """Propagate adjoints back through a stage.

    On entry, `sums.pull` and `sums.creep` are the derivatives with respect to the accelerations and
    the creep of the stage. Here `sums.pull` is divided by the masses.
    """
    law = system.law
    damped = system.damped
    first, last = window
    bodies = slice(first, last)
    contacts = slice(first, last + 1)
    around = slice(first - 1, last + 1)
    f = stages.forces[stage]
    by_x = sums.stages[stage]
    for n in range(first, last):
        sums.pull[n] *= damped.inverse_mass[n]
        sums.pressed[n] = sums.creep[n] * damped.inverse_mass[n]
    # Bodies outside of the window do not move.
    for n in (first - 1, last):
        sums.pull[n] = 0.0
        sums.pressed[n] = 0.0
    _back_contacts(
        law,
        damped.stiffness[contacts],
        damped.viscosity[contacts],
        stages.powers[stage, contacts],
        f[contacts],
        (sums.pull[around], sums.pressed[around], sums.bend[contacts]),
        (sums.power[contacts], sums.force[contacts], sums.viscosity[contacts]),
    )
    _back_bodies(
        damped.drag[bodies],
        damped.viscosity[contacts],
        stages.x[stage, bodies],
        f[contacts],
        (
            sums.pull[bodies],
            sums.creep[bodies],
            sums.pressed[bodies],
            sums.bend[contacts],
            by_x[bodies],
        ),
        (sums.mass[bodies], sums.drag[bodies]),
    )
    by_x[first - 1] = sums.bend[first]
    by_x[last] = -sums.bend[last]
    body = path.body
    if body < 0:
        weight = sums.pull[-body]
        path.derivative[stage] += weight
        sums.mass[-body] += weight * path.imposed[stage]
    elif body > 0:
        path.derivative[stage] += by_x[body]
        by_x[body] = 0.0


@loop
def _weigh(pull, creep, x, w, weight_x, weight_w):
    """Compute the adjoints of the rates of a stage from the adjoints at the end of the step."""
    apart()
    for n in range(pull.size):
        pull[n] = weight_x * x[n] + weight_w * w[n]
        creep[n] = weight_w * x[n]


@loop
def _back_step(window, system, h, path, stages, memory):
    """Propagate adjoints back through a step."""
    sums = memory.others
    weigh = memory.weigh
    tableau = system.tableau
    first, last = window
    bodies = slice(first, last)
    around = slice(first - 1, last + 1)
    count = tableau.nodes.size
    pull = sums.pull[bodies]
    creep = sums.creep[bodies]
    for stage in range(count - 1, -1, -1):
        weight_x = tableau.weights[0, stage] * h * h
        weight_w = tableau.weights[1, stage] * h
        _weigh(pull, creep, sums.x[bodies], sums.w[bodies], weight_x, weight_w)
        terms = 0
        for later in range(stage + 1, count):
            weigh.weights[terms] = tableau.inner[later, stage] * h * h
            weigh.weights[count + terms] = tableau.rates[later, stage] * h
            weigh.rows[terms] = later
            # Many terms have two zero weights and are skipped.
            terms += weigh.weights[terms] != 0.0 or weigh.weights[count + terms] != 0.0
        _add_rows_to_both(pull, creep, weigh, terms, sums.stages, bodies)
        _back_stage(window, system, path, stages, stage, sums)
    x = sums.x[around]
    w = sums.w[around]
    _drift(w, w, h, x)
    for stage in range(count):
        weigh.weights[stage] = 1.0
        weigh.weights[count + stage] = tableau.nodes[stage] * h
        weigh.rows[stage] = stage
    _add_rows_to_both(x, w, weigh, count, sums.stages, around)


@loop
def _back_creep(window, system, path, stages, sums):
    """Propagate `sums.creep`, adjoints of the creep in the first stage, back to the bodies."""
    first, last = window
    around = slice(first - 1, last + 1)
    for n in range(first, last):
        sums.pull[n] = 0.0
    # Creep does not depend on an external force.
    moved = ImposedPath(max(path.body, 0), path.imposed, path.derivative)
    _back_stage(window, system, moved, stages, 0, sums)
    _drift(sums.x[around], sums.x[around], 1.0, sums.stages[0, around])


@loop
def _back_look(window, system, path, stages, sums, looks, look):
    """Add the derivatives with respect to observed values to the adjoint."""
    first, last = window
    for n in range(first, last):
        sums.creep[n] = 0.0
    for n in range(looks.bodies.size):
        body = looks.bodies[n]
        sums.x[body] += looks.values[0, look, n]
        sums.w[body] += looks.values[1, look, n]
        if first <= body < last:
            sums.creep[body] += looks.values[1, look, n]
    _back_creep(window, system, path, stages, sums)


@compiled_gradient()
def backward(chains, system, steps, pieces, numbers, path, looks, memory):
    """Propagate adjoints back through some pieces of a run, the last piece first.

    A piece is recomputed from its start. `path` contains the imposed values at each stage of the
    pieces numbers[0] ... numbers[1]-1, and at the stage after the last step. `looks` contains the
    derivatives with respect to the observed values.
    """
    chain = chain_of(chains, 0, 0)
    rates = memory.rates
    sums = memory.others
    count = system.tableau.nodes.size
    begin = pieces.starts[numbers[0]]
    final = steps.lengths.size
    for piece in range(numbers[1] - 1, numbers[0] - 1, -1):
        start = pieces.starts[piece]
        stop = pieces.starts[piece + 1]
        window = pieces.windows[piece, 0], pieces.windows[piece, 1]
        chain.state.first = window[0]
        chain.state.last = window[1]
        _drift(chain.x, pieces.states[piece, 0], 0.0, pieces.states[piece, 1])
        _drift(chain.v, pieces.states[piece, 1], 0.0, pieces.states[piece, 0])
        for step in range(start, stop):
            of_step = _path_of(path, (step - begin) * count, count)
            stages = _stages_of(memory.stages, step - start)
            # Velocities are complete if the piece begins at an observation, where the march may
            # have stopped.
            complete = step == start and steps.look[step] >= 0
            _begin_step(chain, system, of_step, stages, rates, complete)
            _end_step(chain, system, steps.lengths[step], of_step, stages, memory)
            rest_ahead(chain)
        if stop == final:
            of_step = _path_of(path, (stop - begin) * count, count)
            stages = _stages_of(memory.stages, stop - start)
            _begin_step(chain, system, of_step, stages, rates, False)
            _back_look(window, system, of_step, stages, sums, looks, steps.look[stop])
        for step in range(stop - 1, start - 1, -1):
            of_step = _path_of(path, (step - begin) * count, count)
            stages = _stages_of(memory.stages, step - start)
            _back_step(window, system, steps.lengths[step], of_step, stages, memory)
            # The observation at t = 0 shows the initial state itself, without a stage.
            if steps.look[step] > 0:
                _back_look(window, system, of_step, stages, sums, looks, steps.look[step])
            elif step == 0:
                for n in range(window[0], window[1]):
                    sums.creep[n] = -sums.w[n]
                _back_creep(window, system, of_step, stages, sums)


@loop
def _change_forces(system, z, p, f, of_contacts, changes):
    """Compute changes (C,) of the forces of contacts between bodies (C+1,) with the changes z.

    `of_contacts` contains the stiffness, the inverse constant and the force at rest of the
    contacts, and the changes of the constant and of the force at rest.
    """
    apart()
    c = system.law.pressed
    stiffness, inverse_constant, at_rest, by_constant, by_force = of_contacts
    for n in range(p.size):
        # See `adjoint`: df/dK = (f - c F p) / K.
        soften = (f[n] - at_rest[n] * p[n]) * inverse_constant[n]
        slope = stiffness[n] * (c + p[n])
        changes[n] = slope * (z[n] - z[n + 1]) + p[n] * by_force[n] + soften * by_constant[n]


@loop
def _change_rates(x, z, f, changes, of_bodies, of_contacts, rates):
    """Compute changes of slope and creep (B,) for changes z of bodies x, and `changes` of forces f.

    `of_bodies` contains the inverse mass and the drag of the bodies, the relative change of the
    mass and the change of the drag. `of_contacts` contains the viscosity of the contacts and its
    change.
    """
    apart()
    inverse_mass, drag, by_mass, by_drag = of_bodies
    viscosity, by_viscosity = of_contacts
    slope, creep = rates
    for n in range(x.size):
        pull = changes[n] - changes[n + 1] - (f[n] - f[n + 1]) * by_mass[n]
        slope[n] = inverse_mass[n] * pull
        pressed = viscosity[n] * f[n] - viscosity[n + 1] * f[n + 1]
        above = viscosity[n] * changes[n] + by_viscosity[n] * f[n]
        below = viscosity[n + 1] * changes[n + 1] + by_viscosity[n + 1] * f[n + 1]
        moved = inverse_mass[n] * (above - below - pressed * by_mass[n])
        creep[n] = moved - drag[n] * z[n] - by_drag[n] * x[n]


@loop
def _change_stage(system, path, stages, stage, d, change, rates):
    """Compute changes of the rates of a stage, in direction d, from the changes of its bodies.

    The last row of `rates.slopes` contains the changes of the bodies; the last row of
    `rates.creeps` is scratch space for the changes of the forces.
    """
    damped = system.damped
    z = rates.slopes[-1]
    forces = rates.creeps[-1]
    body = path.body
    if body > 0:
        z[body] = change.path[d, stage]
    bodies = slice(PAD, z.size - PAD)
    contacts = slice(PAD, z.size - PAD + 1)
    f = stages.forces[stage, contacts]
    _change_forces(
        system,
        z[PAD - 1 : z.size - PAD + 1],
        stages.powers[stage, contacts],
        f,
        (
            damped.stiffness[contacts],
            change.inverse_constant[contacts],
            change.at_rest[contacts],
            change.constant[d, contacts],
            change.force[d, contacts],
        ),
        forces[contacts],
    )
    _change_rates(
        stages.x[stage, bodies],
        z[bodies],
        f,
        forces[contacts],
        (
            damped.inverse_mass[bodies],
            damped.drag[bodies],
            change.mass[d, bodies],
            change.drag[d, bodies],
        ),
        (damped.viscosity[contacts], change.viscosity[d, contacts]),
        (rates.slopes[stage, bodies], rates.creeps[stage, bodies]),
    )
    if body < 0:
        # A force on a body accelerates it less if its mass grows.
        push = change.path[d, stage] - path.imposed[stage] * change.mass[d, -body]
        rates.slopes[stage, -body] += damped.inverse_mass[-body] * push


@loop
def _change_step(system, h, path, stages, d, change, rates):
    """Advance small changes in direction d through the other stages of a step to its end."""
    tableau = system.tableau
    count = tableau.nodes.size
    x = change.x[d]
    w = change.w[d]
    z = rates.slopes[-1]
    for stage in range(1, count):
        _drift(z, x, tableau.nodes[stage] * h, w)
        for earlier in range(stage):
            _add(
                z,
                tableau.inner[stage, earlier] * h * h,
                rates.slopes[earlier],
                tableau.rates[stage, earlier] * h,
                rates.creeps[earlier],
            )
        _change_stage(system, path, stages, stage, d, change, rates)
    _drift(x, x, h, w)
    for stage in range(count):
        slope = rates.slopes[stage]
        weight = tableau.weights[1, stage] * h
        _add(x, tableau.weights[0, stage] * h * h, slope, weight, rates.creeps[stage])
        _drift(w, w, weight, slope)


@loop
def _change_path(change, index, count):
    """Return the changes, with the imposed values restricted to the stages of a step."""
    rows = slice(index, index + count)
    return Change(
        x=change.x,
        w=change.w,
        mass=change.mass,
        constant=change.constant,
        force=change.force,
        viscosity=change.viscosity,
        drag=change.drag,
        path=change.path[:, rows],
        inverse_constant=change.inverse_constant,
        at_rest=change.at_rest,
    )


@compiled_gradient()
def tangent(chains, system, steps, span, path, looks, memory, change):
    """Advance a chain, and small changes of it, by the steps span[0] ... span[1]-1 of its run.

    All grains of the chain are advanced. The changes of the observed values are stored in `looks`;
    the other arguments are as in `backward`.
    """
    chain = chain_of(chains, 0, 0)
    rates = memory.others
    stages = _stages_of(memory.stages, 0)
    count = system.tableau.nodes.size
    final = steps.lengths.size
    for step in range(span[0], span[1] + (span[1] == final)):
        index = (step - span[0]) * count
        of_step = _path_of(path, index, count)
        changes = _change_path(change, index, count)
        look = steps.look[step]
        _begin_step(chain, system, of_step, stages, memory.rates, step == 0)
        if step < final:
            _end_step(chain, system, steps.lengths[step], of_step, stages, memory)
        for d in range(change.x.shape[0]):
            w = change.w[d]
            _drift(rates.slopes[-1], change.x[d], 0.0, w)
            _change_stage(system, of_step, stages, 0, d, changes, rates)
            creep = rates.creeps[0]
            if step == 0:
                _drift(w, w, -1.0, creep)
            if look >= 0:
                for n in range(looks.bodies.size):
                    body = looks.bodies[n]
                    looks.values[d, 0, look, n] = rates.slopes[-1, body]
                    looks.values[d, 1, look, n] = w[body] + creep[body]
            if step < final:
                _change_step(system, steps.lengths[step], of_step, stages, d, changes, rates)
