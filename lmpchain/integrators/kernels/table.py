"""How chains are laid out for the compiled loops, and where they move at first, compiled."""

from __future__ import annotations

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
