"""What is seen of a motion, a value with its derivatives by that, and the force of a contact."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array


class Seen(NamedTuple):
    """What is seen of a motion.

    Attributes
    ----------
    scene : Scene
    time : (T,) array
        s.
    grains : (G,) array
        Numbers from 1.
    displacement, velocity : (T, G) arrays
        m and m/s, positive downward.
    """

    scene: Scene
    time: Array
    grains: np.ndarray
    displacement: Array
    velocity: Array

    def slopes(self, value: float) -> Slopes:
        """Return a value whose derivatives are all 0 so far, to be filled in."""
        chain = self.scene.chain
        contacts = np.zeros((2, chain.grains + 1))
        return Slopes(value, np.zeros(self.displacement.shape), np.zeros(self.velocity.shape),
                      np.zeros(chain.grains), *contacts)  # fmt: skip

    def column(self, grain: int) -> int:
        """Return the column of a grain."""
        return int(np.flatnonzero(self.grains == grain)[0])


class Slopes(NamedTuple):
    """A value and its derivatives.

    Attributes
    ----------
    value : float
    displacement, velocity : (T, G) arrays
        With respect to what was seen.
    masses, constants, forces : (N,), (N+1,) and (N+1,) arrays
        With respect to masses, constants and forces at rest of all contacts, where the objective itself has them.
    """

    value: float
    displacement: Array
    velocity: Array
    masses: Array
    constants: Array
    forces: Array


def contact_force(seen: Seen, contact: int) -> tuple[Array, Array, Array, Array, list[int]]:
    """Return the force of a contact, (T,) N, its derivatives by r, F and K, and the grains it joins."""
    chain = seen.scene.chain
    law = chain.contacts.of(contact)
    ends = [grain for grain in (contact, contact + 1) if 1 <= grain <= chain.grains]
    closer = np.zeros(seen.time.size)
    for grain in ends:
        closer += seen.displacement[:, seen.column(grain)] * (1 if grain == contact else -1)
    overlap = np.maximum(law.overlap + closer, 0.0)
    stiffness = law.stiffness_at(overlap) * (overlap > 0)
    by_force, by_constant = np.zeros(closer.shape), overlap**law.exponent
    if law.force > 0:  # eps = (F / K)^(1/delta)
        by_force = stiffness * law.overlap / (law.exponent * law.force)
        by_constant = by_constant - stiffness * law.overlap / (law.exponent * law.constant)
    return law.force_at(overlap), stiffness, by_force, by_constant, ends


def quadrature(size: int) -> Array:
    """Return the weights (size,) of the trapezoidal rule with Gregory's corrections of order 6."""
    weight = np.ones(size)
    weight[[0, -1]] = 0.5
    for k, gregory in enumerate((1 / 12, 1 / 24, 19 / 720, 3 / 160, 863 / 60480), 1):
        if 2 * k < size:
            part = [gregory * (-1) ** j * math.comb(k, j) for j in range(k + 1)]
            weight[: k + 1] -= part
            weight[-k - 1 :] -= part[::-1]
    return weight
