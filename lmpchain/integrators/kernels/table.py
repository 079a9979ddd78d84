"""Memory layout of the chains for the compiled loops, and their initial windows, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .compiling import compiled_filler, inlined
from .layout import PAD, STATE, BatchArrays

UNBOUNDED = 1e300  # J, upper bound on the energy if no smaller one is known
# Assumed rounding error of a reduced velocity, relative to the largest imposed speed; an upper
# bound.
ROUNDED = 1e-6


def aligned_rows(kinds: int, count: int, grains: int) -> Array:
    """Return (kinds, count, W) zeros; every row begins at a cache line."""
    width = (2 * PAD + grains + PAD - 1) // PAD * PAD
    size = kinds * count * width
    memory = np.zeros(size + PAD)
    address, _ = memory.__array_interface__["data"]
    skip = -(address // memory.itemsize) % PAD
    return memory[skip : skip + size].reshape((kinds, count, width))


@compiled_filler()
def fill_batch(
    batch: BatchArrays,
    at_rest: tuple[Array, Array, Array, Array],
    masses: Array,
    strikes: Array,
    damping: tuple[Array, Array],
    free: tuple[int, int],
    opening_power: float,
) -> None:
    """Fill the arrays of a batch of R chains, without forms and excitations.

    Parameters
    ----------
    batch : BatchArrays
        Arrays to fill, which must contain zeros.
    at_rest : tuple of four (R, N+1) arrays
        Overlap, m, force, N, constant, N/m^delta, and stiffness, N/m, of all contacts at rest.
    masses : (R, N) array
        Masses of the grains, kg.
    strikes : (R, 4) array
        Highest frequency, rad/s; energy, J, largest displacement, m, and largest speed, m/s, of the
        excitation.
    damping : tuple of (R, N+1) and (R, N) arrays
        Viscosities of contacts, s, and drag on grains, 1/s; read only if the batch is damped.
    free : pair of int
        First grain, from 0, whose motion is not prescribed, and the grain after the last one.
    opening_power : float
        Exponent with which the force depends on the overlap when a contact opens.
    """
    for real in range(masses.shape[0]):
        _fill_contacts(batch, real, at_rest)
        _fill_scales(batch, real, at_rest, masses[real], strikes[real])
        first, stop = free
        for n in range(first, stop):
            batch.inverse_mass[real, PAD + n] = 1.0 / masses[real, n]
            # Damping does not act on grains that are held or driven.
            if batch.damped:
                batch.drag[real, PAD + n] = damping[1][real, n]
                batch.mass[real, PAD + n] = masses[real, n]
        if batch.damped:
            for n in range(damping[0].shape[1]):
                batch.viscosity[real, PAD - 1 + n] = damping[0][real, n]
        _fill_weights(batch, real, opening_power)


@inlined
def _fill_contacts(batch, real, at_rest):
    """Fill the lengths and strengths of the contacts of a chain, and their state at rest."""
    overlap, force, constant, stiffness = at_rest
    pressed = batch.precompressed > 0.0
    touching = constant[real, 0] if pressed and force[real, 0] == 0.0 else 0.0
    closed = pressed and touching == 0.0
    last = overlap.shape[1] - 1
    for n in range(last + 1):
        # The unit of force is the force at rest; in the sonic vacuum, K for an overlap of 1 m.
        length = overlap[real, n] if pressed else 1.0
        if length > 0.0:
            batch.inverse_length[real, PAD - 1 + n] = 1.0 / length
            batch.strength[real, PAD - 1 + n] = force[real, n] if pressed else constant[real, n]
        # The stiffness of a contact that only touches is 0.
        if n > 0 and stiffness[real, n] == 0.0 and constant[real, n] > 0.0:
            closed = False
    batch.uncompressed[real] = touching
    batch.least_strain[real] = 0.0 if closed else -1.0


@inlined
def _fill_scales(batch, real, at_rest, masses, strike):
    """Fill the scales of the motion of a chain, and the upper bound on its energy."""
    overlap, _, constant, stiffness = at_rest
    fastest, energy, farthest, speed = strike
    speed = max(speed, farthest * fastest)
    batch.omega[real] = fastest
    batch.scale[real, 0] = speed / fastest
    batch.scale[real, 1] = speed
    # A single grain touches either the wall above it or the wall below it.
    below = 1 if constant[0, 1] > 0.0 else 0
    # A contact that only touches defines no unit of length.
    if batch.precompressed > 0.0:
        while stiffness[real, below] == 0.0 and below < masses.size:
            below += 1
    length = overlap[real, below]
    unit = length * math.sqrt(stiffness[real, below] / masses[0])
    batch.units[real, 0] = length
    batch.units[real, 1] = unit
    total = 0.0
    for n in range(masses.size):
        total += masses[n]
    # The bound is 1.5 times the energy, plus slow motion by rounding errors.
    allowed = min(3.0 * energy + total * (1e-3 * unit) ** 2, UNBOUNDED)
    # Reduced velocities have rounding errors even if nothing moves.
    rounded = ROUNDED * speed if batch.damped else 0.0
    batch.allowed[real] = allowed + total * rounded**2


@inlined
def _fill_weights(batch, real, opening_power):
    """Fill the weight of each contact of a chain, its effect on the motion as it opens or closes.

    `opening_weight` is the square of this effect. `opening_reach` is used by
    `openings._may_shorten`.
    """
    omega = batch.omega[real]
    inverse_mass = batch.inverse_mass[real]
    # The step formula assumes a force proportional to t^(3/2). For another exponent the weight uses
    # the force at a typical overlap.
    power = opening_power - 1.5
    changes = omega**2.5 * batch.scale[real, 1] + 1e-300
    typical = batch.scale[real, 0] + 1e-300
    slow = math.sqrt(2.0) * (2.0 * omega) ** 3
    width = inverse_mass.size
    for n in range(width):
        below = inverse_mass[n + 1] if n + 1 < width else 0.0
        mobility = max(inverse_mass[n], below)
        touching = batch.uncompressed[real] if n == PAD - 1 else 0.0
        inverse_length = batch.inverse_length[real, n]
        strain = typical * (inverse_length if inverse_length > 0.0 else 1.0)
        pull = (batch.strength[real, n] + touching) * strain**power
        weight = min(pull * mobility / changes, 1e150) ** 2
        batch.opening_weight[real, 0, n] = weight
        batch.opening_reach[real, 0, n] = np.cbrt(weight) / slow


def place_bodies(
    u: Array,
    v: Array,
    copies: int,
    driven: int,
    batch: BatchArrays,
    longest: int,
) -> tuple[Array, Array, NDArray[Any]]:
    """Store grains in aligned rows, and initialise their windows.

    Parameters
    ----------
    u : (C, R, N) array
        Displacements in R chains, m, for each of C copies; C = 1 if all copies are equal.
    v : (C, R, N) array
        Velocities in R chains, m/s, for each of C copies.
    copies : int
        Number of copies of the batch.
    driven : int
        Number of driven grains at the top; their initial velocity is set to 0.
    batch : layout.BatchArrays
        Constant arrays of the R chains.
    longest : int
        Largest number of bodies in a row for which the window is the whole chain. In longer rows
        the first window is limited to the grains that move.

    Returns
    -------
    x : (copies R, W) array
        Displacements, m, in the layout of `layout.Chains`.
    v : (copies R, W) array
        Velocities, m/s.
    state : (copies R,) array of `layout.STATE`
        State of the chains at sample 0.
    """
    size, grains = u.shape[1:]
    x, w = aligned_rows(2, copies * size, grains)
    state = np.zeros(copies * size, STATE)
    _fill_places(x, w, state, u, v, driven, batch.reach, batch.least_strain, longest)
    return x, w, state


@compiled_filler()
def _fill_places(x, w, state, u, v, driven, reach, least_strain, longest):
    """Fill rows and state of bodies (see `place_bodies`)."""
    sources, batch, grains = u.shape
    width = x.shape[1]
    for row in range(len(x)):
        copy = row // batch % sources
        real = row % batch
        first, last = reach[real]
        if first > last:
            first = width
            last = 0
        # The window contains all grains that move or are displaced.
        for n in range(grains):
            x[row, PAD + n] = u[copy, real, n]
            if n >= driven:
                w[row, PAD + n] = v[copy, real, n]
            if x[row, PAD + n] != 0.0 or w[row, PAD + n] != 0.0:
                first = min(first, PAD + n)
                last = max(last, PAD + n)
        if first > last:
            first = PAD
            last = PAD
        # For short chains, following the wave costs more than computing all grains.
        if width <= longest:
            first = PAD
            last = width - PAD - 1
        state[row].first = first // PAD * PAD
        state[row].last = min((last // PAD + 1) * PAD, width - PAD)
        state[row].least_strain = least_strain[real]
