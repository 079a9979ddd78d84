"""Few unlike grains that all move, for comparisons with plain NumPy."""

from typing import Any

import numpy as np
from helpers.example_chains import random_column

from lmpchain import Chain, Profile, Scene


def unlike(grains: int, **options: Any) -> Chain:
    """Return grains of random diameters under gravity and a load."""
    return random_column(grains, 2, 0.3, 2e-3, **{"gravity": 30.0, "top_load": 0.02} | options)


def flying(
    chain: Chain, seed: int, sizes: tuple[float, float], radians: float, samples: int
) -> Scene:
    """Return a scene whose displacements and velocities have these sizes at random.

    The units are the largest overlap at rest, and its product with the highest frequency.
    """
    scale = chain.contacts.overlap.max() or 1e-7
    stiff = chain.contacts.stiffness_at(np.full(chain.grains + 1, scale))
    edge = chain.band_edge or float(np.sqrt(stiff.max() / chain.masses.min()))
    speeds = np.random.default_rng(seed).uniform(-1, 1, (2, chain.grains))
    u, v = speeds * [[sizes[0] * scale], [sizes[1] * scale * edge]]
    u[chain.movable :] = v[chain.movable :] = 0
    profile = Profile(displacement=u, velocity=v)
    return Scene(chain=chain, excitation=profile, duration=radians / edge, samples=samples)
