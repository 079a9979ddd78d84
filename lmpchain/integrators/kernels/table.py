"""How chains are laid out for the compiled loops, and where they move at first, compiled."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import NEWS
from .layout import PAD, STATE

MOST = 1e300  # J, where nothing bounds the energy
_compiled = numba.njit(error_model="numpy")


@_compiled
def _rows(count: int, grains: int) -> Array:
    """Return (count, W) zeros of which every row begins at a cache line."""
    width = (2 * PAD + grains + PAD - 1) // PAD * PAD
    memory = np.zeros(count * width + PAD)
    skip = -(memory.ctypes.data // memory.itemsize) % PAD
    return memory[skip : skip + count * width].reshape((count, width))


@compiled_once(*NEWS, error_model="numpy")
def laid_out(
    overlap: Array,
    force: Array,
    constant: Array,
    stiffness: Array,
    masses: Array,
    strikes: Array,
    first: int,
    stop: int,
    compressed: bool,
) -> tuple[Array, ...]:
    """Lay R chains out.

    Parameters
    ----------
    overlap, force, constant, stiffness : (R, N+1) arrays
        Of the contacts at rest.
    masses : (R, N) array
        kg.
    strikes : (R, 4) array
        Highest frequency, rad/s, energy, J, and largest displacement and speed that the excitation imposes, m and m/s.
    first, stop : int
        Of the grains, from 0, those whose motion is not prescribed.
    compressed : bool
        Whether the chains carry a force at rest.

    Returns
    -------
    table, uncompressed, omega, scale : (R, 3, W), (R,), (R,) and (R, 2) arrays
        See `layout.Chains`.
    units, allowed : (R, 2) and (R,) arrays
        See `ChainBatch`.
    """
    batch, grains = masses.shape
    table, uncompressed, omega = (
        _rows(3 * batch, grains).reshape((batch, 3, -1)),
        np.zeros(batch),
        np.empty(batch),
    )
    scale, units, allowed = np.empty((batch, 2)), np.empty((batch, 2)), np.zeros(batch)
    for real in range(batch):
        for n in range(grains + 1):
            length, strength = (
                (overlap[real, n], force[real, n]) if compressed else (1.0, constant[real, n])
            )
            if length > 0.0:
                table[real, 0, PAD - 1 + n], table[real, 1, PAD - 1 + n] = 1.0 / length, strength
        weight = 0.0
        for n in range(grains):
            weight += masses[real, n]
            if first <= n < stop:
                table[real, 2, PAD + n] = 1.0 / masses[real, n]
        if compressed and force[real, 0] == 0.0:
            uncompressed[real] = constant[real, 0]
        fastest, energy, farthest, speed = strikes[real]
        speed = max(speed, farthest * fastest)
        omega[real], scale[real, 0], scale[real, 1] = fastest, speed / fastest, speed
        below = 1 if constant[0, 1] > 0.0 else 0
        length = overlap[real, below]
        unit = length * math.sqrt(stiffness[real, below] / masses[real, 0])
        units[real, 0], units[real, 1] = length, unit
        # half as much again may be rounded, and slow motion that nothing puts in
        allowed[real] = min(3.0 * energy + weight * (1e-3 * unit) ** 2, MOST)
    return table, uncompressed, omega, scale, units, allowed


@compiled_once(*NEWS, error_model="numpy")
def placed(
    u: Array,
    v: Array,
    copies: int,
    driven: int,
    acted: NDArray[np.int64],
    uncompressed: Array,
    compressed: bool,
    whole: int,
) -> tuple[Array, Array, NDArray[Any]]:
    """Put grains in their rows, and begin to watch them.

    Parameters
    ----------
    u, v : (C, R, N) arrays
        Displacement, m, and velocity, m/s, in R chains: of one copy for all, or of every one of C copies.
    copies : int
        How many there are to be.
    driven : int
        Number of grains, from the top, that are put where their motion says: their velocity is 0.
    acted : (R, 2) array
        First and last body that is acted on, the other way round if none is.
    uncompressed, compressed : (R,) array and bool
        See `laid_out`.
    whole : int
        Longest row, in bodies, that is computed as a whole from the beginning; else the window begins around what
        moves.

    Returns
    -------
    x, v : (copies R, W) arrays
        See `layout.Chains`.
    state : (copies R,) array of `layout.STATE`
        At sample 0.
    """
    given, batch, grains = u.shape
    x, w, state = (
        _rows(copies * batch, grains),
        _rows(copies * batch, grains),
        np.zeros(copies * batch, STATE),
    )
    width = x.shape[1]
    for row in range(len(x)):
        copy, real = row // batch % given, row % batch
        first, last = acted[real]
        if first > last:
            first, last = width, 0
        for n in range(grains):
            x[row, PAD + n] = u[copy, real, n]
            if n >= driven:
                w[row, PAD + n] = v[copy, real, n]
            if x[row, PAD + n] != 0.0 or w[row, PAD + n] != 0.0:
                first, last = min(first, PAD + n), max(last, PAD + n)
        if first > last:
            first, last = PAD, PAD
        if width <= whole:
            first, last = PAD, width - PAD - 1
        state[row].first = first // PAD * PAD
        state[row].last = min((last // PAD + 1) * PAD, width - PAD)
        # the smallest r / eps at rest: -1 where a contact is open
        state[row].least_strain = 0.0 if compressed and uncompressed[real] == 0.0 else -1.0
    return x, w, state


@compiled_once(*NEWS, error_model="numpy")
def opening_weights(
    table: Array, uncompressed: Array, omega: Array, scale: Array
) -> tuple[Array, Array]:
    """Return how much each contact changes the motion as it opens or closes.

    Parameters
    ----------
    table, uncompressed, omega, scale : arrays
        See `layout.Chains`.

    Returns
    -------
    weight, reach : (R, W) arrays
        The square of that, and how near to it no step is shorter; see `adaptive_splitting._may_matter`.
    """
    batch, _, width = table.shape
    weight, reach = np.zeros((batch, width)), np.zeros((batch, width))
    for real in range(batch):
        _, strength, inverse_mass = table[real]
        changes, slow = (
            omega[real] ** 2.5 * scale[real, 1] + 1e-300,
            math.sqrt(2.0) * (2.0 * omega[real]) ** 3,
        )
        for n in range(width):
            mobility = max(inverse_mass[n], inverse_mass[n + 1] if n + 1 < width else 0.0)
            pull = strength[n] + (uncompressed[real] if n == PAD - 1 else 0.0)
            weight[real, n] = min(pull * mobility / changes, 1e150) ** 2
            reach[real, n] = np.cbrt(weight[real, n]) / slow
    return weight, reach
