"""Largest overlaps of a scene, and the error of Hertz's law there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..scene.scene import Scene
from ..util.arrays import Array, numbers


def deepest(scene: Scene) -> float:
    """Return a bound on any overlap over the diameter; infinite if a drive does work.

    No contact can hold more than the energy of the strike, `Contacts.overlap_bound`. `Scene`
    refuses strikes that squeeze a contact to more than a tenth at once; lighter grains below, or a
    floor, may be squeezed further.
    """
    reached = scene.reached
    return float((reached.overlap_bounds / reached.chain.contact_lengths).max())


def hertz_excess(strain: ArrayLike) -> Array:
    """Return the relative excess of Hertz's force of spheres at an overlap of strain x diameter.

    From their shape alone, spheres in place of paraboloids: ``o = 2 a artanh(a/R)`` and
    ``F = 2 E* [(a^2 + R^2) artanh(a/R) - a R]``, some ``strain / 10``; I. N. Sneddon, Int. J. Eng.
    Sci. 3, 47 (1965). That they are no half-spaces and yield comes on top.
    """
    strain = numbers(strain, "strain")
    # x = a / R by Newton's method
    x = np.sqrt(strain)
    for _ in range(20):
        x = x - (x * np.arctanh(x) - strain) / (np.arctanh(x) + x / (1 - x * x))
    # the difference cancels where x is small: its series
    series = 4 / 3 * x**3 * (1 + 2 / 5 * x**2)
    force = np.where(x > 1e-2, (1 + x * x) * np.arctanh(x) - x, series)
    return 1 - force / (4 / 3 * strain**1.5)
