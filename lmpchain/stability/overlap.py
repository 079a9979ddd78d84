"""Largest overlaps of a scene, and the error of Hertz's law at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..scene.scene import Scene
from ..util.arrays import Array, numbers


def deepest(scene: Scene) -> float:
    """Return an upper bound on overlap over diameter; infinite if the scene is forced.

    The bound holds because no contact can store more than the energy of the strike, see
    `Contacts.overlap_bound`. `Scene` rejects strikes whose first collision causes an overlap above
    a tenth of the diameter, but lighter grains or a wall further down may have larger overlaps
    later.
    """
    reached = scene.reached
    return float((reached.overlap_bounds / reached.chain.contact_lengths).max())


def hertz_excess(strain: ArrayLike) -> Array:
    """Return the relative excess of Hertz's force over the force of spheres, at overlap / diameter.

    The excess is due to the shape alone, because Hertz's theory replaces spheres by paraboloids.
    Spheres of radius R with the contact radius a have ``o = 2 a artanh(a/R)`` and
    ``F = 2 E* [(a^2 + R^2) artanh(a/R) - a R]``; I. N. Sneddon, Int. J. Eng. Sci. 3, 47 (1965). The
    excess is about ``strain / 10``. Deviations from half-spaces and yielding are not included.
    """
    strain = numbers(strain, "strain")
    # Newton's method for x = a / R.
    x = np.sqrt(strain)
    for _ in range(20):
        x = x - (x * np.arctanh(x) - strain) / (np.arctanh(x) + x / (1 - x * x))
    # The difference cancels for small x, where the series is used.
    series = 4 / 3 * x**3 * (1 + 2 / 5 * x**2)
    force = np.where(x > 1e-2, (1 + x * x) * np.arctanh(x) - x, series)
    return 1 - force / (4 / 3 * strain**1.5)
