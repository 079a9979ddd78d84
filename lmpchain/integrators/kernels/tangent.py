"""The map of a kick-drift splitting and its tangent, which describes small deviations, compiled.

The native engine advances a chain by the same map. The tangent is the exact derivative of the
computed map, and it is symplectic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .compiling import STRICT, fma, inlined
from .contact_forces import contact_forces, contact_stiffnesses, touching, touching_stiffness
from .layout import PAD
from .right_hand_side import slice_links
from .sample_loop import links_of


class BodyRow(NamedTuple):
    """A row of W displacements, m, and velocities, m/s, with grain 1 at the index PAD."""

    x: Array
    v: Array


class Deviations(NamedTuple):
    """C small deviations of the state of N grains.

    Attributes
    ----------
    x : (N, C) array
        Deviations of displacements, contiguous.
    v : (N, C) array
        Deviations of velocities, contiguous.
    stretch : (C,) array
        Relative change of all step lengths in each deviation: 1 for the derivative by the logarithm
        of the duration, else 0.
    """

    x: Array
    v: Array
    stretch: Array


class TangentSteps(NamedTuple):
    """Kicks (S+1,) and drifts (S,), fractions of a step, and lengths (K,) of steps, s."""

    kicks: Array
    drifts: Array
    lengths: Array


class Held(NamedTuple):
    """A body without inverse mass: its index, and its displacement at every kick, m.

    `path` has the shape (K S + 1,) for K steps of S stages. It is empty if no body is driven.
    """

    body: int
    path: Array


class ContactResponse(NamedTuple):
    """Force, N, and stiffness, N/m, of all contacts, (N+1,) arrays."""

    force: Array
    stiffness: Array


@inlined
def evaluate(links, x, lost, response):
    """Compute the force and stiffness of all contacts; `lost` is the rounding error of x."""
    force, stiffness = response
    first = PAD - 1
    last = PAD - 1 + force.size
    contacts = slice_links(links, slice(first, last), 0.0)
    contact_forces(contacts, force, x[first : last + 1])
    contact_stiffnesses(contacts, stiffness, force, x[first : last + 1])
    if links.uncompressed > 0.0:
        r = x[first] - x[PAD]
        force[0] += touching(r, links.uncompressed, links.coefficients)
        stiffness[0] += touching_stiffness(r, force[0], links.coefficients)
    # Correct the force to first order by the rounding error of the displacement.
    for n in range(force.size):
        force[n] += stiffness[n] * (lost[first + n] - lost[PAD + n])


@inlined
def add_exactly(row, lost, n, change):
    """Add a change to an element of a row, and store the rounding error for the next addition."""
    # The rounding error is exact for any two numbers, if the compiler does not reorder operations.
    old = row[n]
    change += lost[n]
    new = old + change
    added = new - old
    row[n] = new
    lost[n] = (old - (new - added)) + (change - added)


@inlined
def _kick(inverse_mass, kick, motion, lost, deviations, response):
    """Kick the grains, and every deviation by the linearised force."""
    dx, dv, stretch = deviations
    force, stiffness = response
    grains, columns = dx.shape
    for n in range(grains):
        push = kick * inverse_mass[PAD + n]
        # This grain is held or driven.
        if push == 0.0:
            continue
        change = push * (force[n] - force[n + 1])
        add_exactly(motion.v, lost.v, PAD + n, change)
        above = push * stiffness[n]
        below = push * stiffness[n + 1]
        x = dx[n]
        faster = dv[n]
        up = dx[max(n - 1, 0)]
        down = dx[min(n + 1, grains - 1)]
        upper = above if n > 0 else 0.0
        lower = below if n < grains - 1 else 0.0
        for c in range(columns):
            middle = fma(-(above + below), x[c], change * stretch[c])
            faster[c] += fma(upper, up[c], fma(lower, down[c], middle))


@inlined
def _drift(drift, motion, lost, deviations):
    """Drift the grains and every deviation."""
    dx, dv, stretch = deviations
    for n in range(dx.shape[0]):
        change = drift * motion.v[PAD + n]
        add_exactly(motion.x, lost.x, PAD + n, change)
        x = dx[n]
        faster = dv[n]
        for c in range(x.size):
            x[c] += fma(drift, faster[c], change * stretch[c])


@compiled_once("the tangent map", 20, nogil=True, error_model="numpy", fastmath=STRICT)
def march(batch, inverse_mass, motion, deviations, steps, held, states):
    """Advance a chain of N grains, and deviations of its state, by a splitting with given steps.

    Parameters
    ----------
    batch : BatchArrays
        Arrays of a batch that contains only this chain.
    inverse_mass : (W,) array
        Inverse mass of every body, 1/kg; 0 for a body that is held or driven.
    motion : BodyRow
        Displacements, m, and velocities, m/s, at the start; overwritten with those at the end.
    deviations : Deviations
        Deviations of the initial state; overwritten with those of the final state.
    steps : TangentSteps
        Coefficients of the splitting, and lengths of the steps.
    held : Held
        Driven body and its displacements.
    states : (2, K+1, N) array
        Filled with displacements, m, and velocities, m/s, before the first and after every step.

    Notes
    -----
    Sums over steps are compensated for rounding errors, because a grain that flies far between
    short contacts would lose four digits otherwise.
    """
    links = links_of(batch, 0)
    x, v = motion
    grains = deviations.x.shape[0]
    stages = steps.drifts.size
    response = ContactResponse(np.zeros(grains + 1), np.zeros(grains + 1))
    lost = BodyRow(np.zeros(x.size), np.zeros(x.size))
    if held.path.size > 0:
        x[held.body] = held.path[0]
    evaluate(links, x, lost.x, response)
    states[0, 0] = x[PAD : PAD + grains]
    states[1, 0] = v[PAD : PAD + grains]
    for k in range(steps.lengths.size):
        h = steps.lengths[k]
        _kick(inverse_mass, steps.kicks[0] * h, motion, lost, deviations, response)
        for stage in range(stages):
            _drift(steps.drifts[stage] * h, motion, lost, deviations)
            if held.path.size > 0:
                x[held.body] = held.path[k * stages + stage + 1]
            evaluate(links, x, lost.x, response)
            kick = steps.kicks[stage + 1] * h
            _kick(inverse_mass, kick, motion, lost, deviations, response)
        states[0, k + 1] = x[PAD : PAD + grains]
        states[1, k + 1] = v[PAD : PAD + grains]
