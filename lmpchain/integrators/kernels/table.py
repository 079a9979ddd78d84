"""How chains are laid out for the compiled loops, and where they move at first, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import NEWS
from .layout import PAD


@compiled_once(*NEWS, error_model="numpy")
def fill_table(
    table: Array, overlap: Array, force: Array, constant: Array, masses: Array, first: int, stop: int, compressed: bool
) -> Array:
    """Fill the table of R chains, zeros so far.

    Parameters
    ----------
    table : (R, 3, W) array
        See `layout.Chains`.
    overlap, force, constant : (R, N+1) arrays
        Of the contacts at rest.
    masses : (R, N) array
        kg.
    first, stop : int
        Of the grains, from 0, those whose motion is not prescribed.
    compressed : bool
        Whether the chains carry a force at rest.

    Returns
    -------
    (R,) array
        `layout.Chains.uncompressed`.
    """
    uncompressed = np.zeros(len(table))
    for real in range(len(table)):
        for n in range(overlap.shape[1]):
            length, strength = (overlap[real, n], force[real, n]) if compressed else (1.0, constant[real, n])
            if length > 0.0:
                table[real, 0, PAD - 1 + n], table[real, 1, PAD - 1 + n] = 1.0 / length, strength
        for n in range(first, stop):
            table[real, 2, PAD + n] = 1.0 / masses[real, n]
        if compressed and force[real, 0] == 0.0:
            uncompressed[real] = constant[real, 0]
    return uncompressed


@compiled_once(*NEWS, error_model="numpy")
def opening_weights(table: Array, uncompressed: Array, omega: Array, scale: Array) -> tuple[Array, Array]:
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
        changes, slow = omega[real] ** 2.5 * scale[real, 1] + 1e-300, math.sqrt(2.0) * (2.0 * omega[real]) ** 3
        for n in range(width):
            mobility = max(inverse_mass[n], inverse_mass[n + 1] if n + 1 < width else 0.0)
            pull = strength[n] + (uncompressed[real] if n == PAD - 1 else 0.0)
            weight[real, n] = min(pull * mobility / changes, 1e150) ** 2
            reach[real, n] = weight[real, n] ** (1 / 3) / slow
    return weight, reach


@compiled_once(*NEWS, error_model="numpy")
def windows(u: Array, v: Array, driven: int, acted: NDArray[np.int64], width: int) -> Array:
    """Return between which bodies each of R chains moves at first, in whole cache lines, (R, 2).

    Parameters
    ----------
    u, v : (R, N) arrays
        At t = 0.
    driven : int
        Number of grains, from the top, whose velocity does not count: they are put in place.
    acted : (R, 2) array
        First and last body that is acted on, the other way round if none is.
    width : int
        Of a row of bodies.
    """
    found = np.empty((len(u), 2))
    for real in range(len(u)):
        first, last = acted[real]
        if first > last:
            first, last = width, 0
        for n in range(u.shape[1]):
            if u[real, n] != 0.0 or (n >= driven and v[real, n] != 0.0):
                first, last = min(first, PAD + n), max(last, PAD + n)
        if first > last:
            first, last = PAD, PAD
        found[real, 0] = first // PAD * PAD
        found[real, 1] = min((last // PAD + 1) * PAD, width - PAD)
    return found
