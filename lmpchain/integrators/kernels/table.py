"""How chains are laid out for the compiled loops, and where they move at first, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from .compiling import compiled_filler, inlined
from .layout import PAD, STATE, BatchArrays

UNBOUNDED = 1e300  # J, where nothing bounds the energy
# of the largest speed that is imposed: more than the rounding of a velocity
ROUNDED = 1e-6


def aligned_rows(kinds: int, count: int, grains: int) -> Array:
    """Return (kinds, count, W) zeros of which every row begins at a cache line."""
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
    """Fill the arrays of a batch of R chains but those that forms and excitations give.

    Parameters
    ----------
    batch : BatchArrays
        Rows are zeros.
    at_rest : tuple of four (R, N+1) arrays
        Overlap, m, force, N, constant, N/m^delta, and stiffness, N/m, of all contacts.
    masses : (R, N) array
        kg.
    strikes : (R, 4) array
        Highest frequency, rad/s, energy, J, and largest displacement and speed that the excitation
        imposes, m and m/s.
    damping : tuple of (R, N+1) and (R, N) arrays
        Viscosities of contacts, s, and drag on grains, 1/s; read if the batch is damped.
    free : pair of int
        First of the grains, from 0, whose motion is not prescribed, and the one behind the last.
    opening_power : float
        The force of a contact that opens goes as the overlap to this power.
    """
    for real in range(masses.shape[0]):
        _fill_contacts(batch, real, at_rest)
        _fill_scales(batch, real, at_rest, masses[real], strikes[real])
        first, stop = free
        for n in range(first, stop):
            batch.inverse_mass[real, PAD + n] = 1.0 / masses[real, n]
            # what is held or driven moves as it is told
            if batch.damped:
                batch.drag[real, PAD + n] = damping[1][real, n]
                batch.mass[real, PAD + n] = masses[real, n]
        if batch.damped:
            for n in range(damping[0].shape[1]):
                batch.viscosity[real, PAD - 1 + n] = damping[0][real, n]
        _fill_weights(batch, real, opening_power)


@inlined
def _fill_contacts(batch, real, at_rest):
    """Fill the lengths and strengths of the contacts of a chain, and what they are at rest."""
    overlap, force, constant, stiffness = at_rest
    pressed = batch.precompressed > 0.0
    touching = constant[real, 0] if pressed and force[real, 0] == 0.0 else 0.0
    closed = pressed and touching == 0.0
    last = overlap.shape[1] - 1
    for n in range(last + 1):
        # the force of a contact in units of that at rest; if nothing is pressed, of K and 1 m
        length = overlap[real, n] if pressed else 1.0
        if length > 0.0:
            batch.inverse_length[real, PAD - 1 + n] = 1.0 / length
            batch.strength[real, PAD - 1 + n] = force[real, n] if pressed else constant[real, n]
        # stiffnesses are 0 where contacts only touch
        if 0 < n < last and stiffness[real, n] == 0.0:
            closed = False
    batch.uncompressed[real] = touching
    batch.least_strain[real] = 0.0 if closed else -1.0


@inlined
def _fill_scales(batch, real, at_rest, masses, strike):
    """Fill the scales of the motion of a chain, and the bound on its energy."""
    overlap, _, constant, stiffness = at_rest
    fastest, energy, farthest, speed = strike
    speed = max(speed, farthest * fastest)
    batch.omega[real] = fastest
    batch.scale[real, 0] = speed / fastest
    batch.scale[real, 1] = speed
    # a single grain has a contact with the wall above it, or one with that below
    below = 1 if constant[0, 1] > 0.0 else 0
    # a contact that only touches has no unit
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
    # half as much again may be rounded, and slow motion that nothing puts in
    allowed = min(3.0 * energy + total * (1e-3 * unit) ** 2, UNBOUNDED)
    # reduced velocities leave their rounding, also where nothing moves
    rounded = ROUNDED * speed if batch.damped else 0.0
    batch.allowed[real] = allowed + total * rounded**2


@inlined
def _fill_weights(batch, real, opening_power):
    """Fill the effect of each contact of a chain on the motion as it opens or closes.

    That is the square of the effect, and how near to it no step is shorter; see
    `openings._may_matter`.
    """
    omega = batch.omega[real]
    inverse_mass = batch.inverse_mass[real]
    # steps are those for a force that goes as t^(3/2): of one that goes as t^delta, the size of
    # the force at a typical overlap counts
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
        batch.opening_weight[real, n] = weight
        batch.opening_reach[real, n] = np.cbrt(weight) / slow


def place_bodies(
    u: Array,
    v: Array,
    copies: int,
    driven: int,
    batch: BatchArrays,
    longest: int,
) -> tuple[Array, Array, NDArray[Any]]:
    """Put grains in their rows, and begin to watch them.

    Parameters
    ----------
    u, v : (C, R, N) arrays
        Displacement, m, and velocity, m/s, in R chains: of one copy for all, or of every one of C
        copies.
    copies : int
        How many there are to be.
    driven : int
        Number of grains, from the top, that are put where their motion says: their velocity is 0.
    batch : layout.BatchArrays
    longest : int
        Longest row, in bodies, that is computed as a whole from the beginning; else the window
        begins around what moves.

    Returns
    -------
    x, v : (copies R, W) arrays
        See `layout.Chains`.
    state : (copies R,) array of `layout.STATE`
        At sample 0.
    """
    size, grains = u.shape[1:]
    x, w = aligned_rows(2, copies * size, grains)
    state = np.zeros(copies * size, STATE)
    _fill_places(x, w, state, u, v, driven, batch.reach, batch.least_strain, longest)
    return x, w, state


@compiled_filler()
def _fill_places(x, w, state, u, v, driven, reach, least_strain, longest):
    """Fill rows and state of bodies, see `place_bodies`."""
    sources, batch, grains = u.shape
    width = x.shape[1]
    for row in range(len(x)):
        copy = row // batch % sources
        real = row % batch
        first, last = reach[real]
        if first > last:
            first = width
            last = 0
        # whatever moves or is out of place belongs to the window
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
        # to follow the wave costs more than so few grains
        if width <= longest:
            first = PAD
            last = width - PAD - 1
        state[row].first = first // PAD * PAD
        state[row].last = min((last // PAD + 1) * PAD, width - PAD)
        state[row].least_strain = least_strain[real]
