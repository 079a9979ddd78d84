"""Bands of linear waves around every grain of a chain whose grains differ."""

from __future__ import annotations

import numpy as np

from ..chain.chain import Chain
from ..util.arrays import Array
from .bands import extensions, repeating


def local_bands(chain: Chain) -> Array:
    """Return the edges of the bands around every grain, (N, B, 2) rad/s.

    They are those of the cell that repeats around it. Where no cell repeats it is a uniform chain
    of such grains with the contact below, for the last grain that above. All are 0 in a sonic
    vacuum. A single grain has its frequency between the walls.
    """
    if chain.grains == 1:
        return np.full((1, 1, 2), np.sqrt(chain.contacts.stiffness.sum() / chain.masses[0]))
    number = np.arange(chain.grains)
    period = repeating(chain)
    start = np.minimum(number, chain.grains - 1 - period)[:, None] + np.arange(period)
    m = chain.masses[start if period > 1 else number[:, None]]
    k = chain.linear_stiffness[start]
    # Bands have their edges at the wavenumbers 0 and pi.
    b = extensions(m, k, np.array([1.0, -1.0]))
    edges = np.sort(np.linalg.svd(b, compute_uv=False), axis=2)
    return np.sort(edges.transpose(0, 2, 1), axis=2)
