"""A motion at the times of an objective, a value with its derivatives, and contact forces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array


class Seen(NamedTuple):
    """The motion of some grains at the times of an objective.

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
        """Return a value with derivatives of 0, to be filled in."""
        chain = self.scene.chain
        contacts = np.zeros((3, chain.grains + 1))
        motion = (np.zeros(self.displacement.shape), np.zeros(self.velocity.shape))
        return Slopes(value, *motion, np.zeros(chain.grains), *contacts)

    def column(self, grain: int) -> int:
        """Return the column of a grain."""
        return int(np.flatnonzero(self.grains == grain)[0])


class Slopes(NamedTuple):
    """A value and its derivatives.

    Attributes
    ----------
    value : float
    displacement, velocity : (T, G) arrays
        By the motion in view.
    masses, constants, forces, viscosity : (N,) and (N+1,) arrays
        By masses, and by constants, forces at rest and viscosities of all contacts, where the
        objective itself has them.
    """

    value: float
    displacement: Array
    velocity: Array
    masses: Array
    constants: Array
    forces: Array
    viscosity: Array


class ContactForce(NamedTuple):
    """The force of a contact, its viscous part included, and its derivatives.

    Attributes
    ----------
    value : (T,) array
        N.
    by_closer, by_closing : (T,) arrays
        By the approach of the two bodies, m, and its rate, m/s.
    by_force, by_constant, by_viscosity : (T,) arrays
        By the force at rest, N, the constant, N/m^delta, and the viscosity, s.
    grains : list of int
        One or two that it joins.
    """

    value: Array
    by_closer: Array
    by_closing: Array
    by_force: Array
    by_constant: Array
    by_viscosity: Array
    grains: list[int]


def contact_force(view: Seen, contact: int) -> ContactForce:
    """Return the force of a contact and its derivatives."""
    chain = view.scene.chain
    law = chain.contacts.of(contact)
    delta = chain.law.power_of("the derivative of a contact force")
    grains = [grain for grain in (contact, contact + 1) if 1 <= grain <= chain.grains]
    viscosity = chain.contact_viscosity[contact]
    closer = np.zeros(view.time.size)
    closing = np.zeros(view.time.size)
    for grain in grains:
        sign = 1 if grain == contact else -1
        closer += view.displacement[:, view.column(grain)] * sign
        closing += view.velocity[:, view.column(grain)] * sign
    overlap = np.maximum(law.overlap + closer, 0.0)
    stiffness = law.stiffness_at(overlap) * (overlap > 0)
    viscous = viscosity * stiffness * closing
    # The viscous force grows with the overlap, because its stiffness does.
    growth = np.zeros(closer.shape)
    if viscosity > 0:
        np.divide((delta - 1) * viscous, overlap, out=growth, where=overlap > 0)
    by_closer = stiffness + growth
    by_force = np.zeros(closer.shape)
    by_constant = overlap**delta + viscous / law.constant
    if law.force > 0:
        # the overlap at rest is (F / K)^(1/delta)
        by_force = by_closer * law.overlap / (delta * law.force)
        by_constant = by_constant - by_closer * law.overlap / (delta * law.constant)
    return ContactForce(
        value=law.force_at(overlap) + viscous,
        by_closer=by_closer,
        by_closing=viscosity * stiffness,
        by_force=by_force,
        by_constant=by_constant,
        by_viscosity=stiffness * closing,
        grains=grains,
    )


def quadrature(size: int) -> Array:
    """Return the weights (size,) of the trapezoidal rule with Gregory's corrections of order 6."""
    weight = np.ones(size)
    weight[[0, -1]] = 0.5
    # backward differences at either end, as far as they do not overlap
    for k, gregory in enumerate((1 / 12, 1 / 24, 19 / 720, 3 / 160, 863 / 60480), 1):
        if 2 * k < size:
            # the k-th difference has alternating binomial coefficients
            change = [gregory * (-1) ** j * math.comb(k, j) for j in range(k + 1)]
            weight[: k + 1] -= change
            weight[-k - 1 :] -= change[::-1]
    return weight
