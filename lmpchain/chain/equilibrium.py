"""Equilibrium of chains: all that follows from their grains, of one chain or of many at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array, read_only
from .contact_law import ContactLaw
from .contacts import Contacts, dynamical_matrix, pair_value
from .plausible import LIMITS


class Grains(NamedTuple):
    """Grains and walls of chains of N grains, which determine everything at rest.

    Arrays are (..., N), or as said; NaN stands for a value that follows from the others.

    Attributes
    ----------
    diameters, densities, moduli : arrays
        m, kg/m3, and plane-strain moduli E / (1 - nu^2), Pa.
    masses : array
        kg; NaN where the mass is that of a sphere of the grain's density.
    contact_constants : (..., N-1) array
        Of the contacts between grains, N/m^delta; NaN where Hertz's law gives it.
    walls : two of bool
        Whether there is a wall at the top, and at the bottom.
    wall_moduli : two of float
        Pa; NaN where it is that of the grain which touches the wall.
    wall_constants : two of float
        N/m^delta; NaN where it follows from the wall's material.
    top_load, gravity : float
        N and m/s2.
    law : ContactLaw
    load_grain : int
        The grain, from 1, that the load acts on.
    """

    diameters: Array
    densities: Array
    moduli: Array
    masses: Array
    contact_constants: Array
    walls: Sequence[bool]
    wall_moduli: Sequence[float]
    wall_constants: Sequence[float] | Array
    top_load: float
    gravity: float
    law: ContactLaw
    load_grain: int = 1


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Chains of N grains at rest.

    Attributes
    ----------
    contacts : Contacts
        With their forces, overlaps and stiffnesses at rest.
    contact_lengths : (..., N+1) array
        Mean diameter of the two grains of every contact, at a wall that of the grain, m.
    diameters, masses : (..., N) arrays
        m and kg.
    """

    contacts: Contacts
    contact_lengths: Array
    diameters: Array
    masses: Array

    @property
    def compression(self) -> Array:
        """Overlap at rest over the mean diameter, (..., N+1)."""
        return self.contacts.overlap / self.contact_lengths

    def dynamical_matrix(self, movable: int) -> tuple[Array, Array]:
        """Return `Chain.dynamical_matrix` of chains of which so many grains move."""
        return dynamical_matrix(self.contacts.stiffness, self.masses[..., :movable])

    def computable(self, movable: int) -> NDArray[np.bool_]:
        """Return whether masses and stiffnesses are numbers that can be computed with, (...)."""
        diagonal, coupling = self.dynamical_matrix(movable)
        sound = (self.masses > 0).all(-1) & ~np.isnan(self.compression).any(-1)
        for elements in (diagonal, coupling):
            sound &= (abs(elements) < LIMITS.stiffness_over_mass).all(-1)
        return np.asarray(sound)

    def row(self, number: int) -> Equilibrium:
        """Return one of many chains."""
        return Equilibrium(
            self.contacts.of(number),
            self.contact_lengths[number],
            self.diameters[number],
            self.masses[number],
        )

    def above(self, grain: int) -> Equilibrium:
        """Return grains 1 ... `grain` as a chain whose last grain is held."""
        lengths = np.append(self.contact_lengths[:grain], self.diameters[grain - 1])
        contacts = self.contacts.above(grain)
        return Equilibrium(
            contacts, read_only(lengths), self.diameters[:grain], self.masses[:grain]
        )


def derive_chain(grains: Grains) -> Equilibrium:
    """Return chains at rest: masses, contact constants, forces, overlaps and stiffnesses."""
    diameters = grains.diameters
    sphere = grains.densities * np.pi / 6 * diameters**3
    masses = np.where(np.isnan(grains.masses), sphere, grains.masses)
    between = (diameters[..., :-1] + diameters[..., 1:]) / 2
    lengths = _with_ends(between, diameters[..., 0], diameters[..., -1])
    constants = _contact_constants(grains, lengths)
    # in long doubles: the rounding of the weight of many grains would show in the stiffnesses
    weight = grains.gravity * masses.cumsum(-1, dtype=np.longdouble)
    force = force_at_rest(weight, grains.top_load, grains.load_grain).astype(float)
    force = np.where(constants > 0, force, 0.0)
    contacts = Contacts.at_rest(constants, force, grains.law)
    return Equilibrium(contacts, *map(read_only, (lengths, diameters, masses)))


def force_at_rest(weight: NDArray[Any], top_load: float, load_grain: int) -> NDArray[Any]:
    """Return what every contact would carry at rest, (..., N+1) N, if there is one.

    Parameters
    ----------
    weight : (..., N) array
        Of every grain and all above it, N.
    top_load : float
        N.
    load_grain : int
        The grain that it acts on, from 1.
    """
    force = np.zeros((*weight.shape[:-1], weight.shape[-1] + 1), weight.dtype)
    force[..., 1:] = weight
    # a wall above grain 1 presses with a load on that
    force[..., load_grain if load_grain > 1 else 0 :] += top_load
    return force


def _contact_constants(grains: Grains, lengths: Array) -> Array:
    """Return the constants of all contacts, (..., N+1) N/m^delta, 0 where there is no wall."""
    outer = (grains.moduli[..., 0], grains.moduli[..., -1])
    planes = [
        of_grain if math.isnan(wall) else wall
        for wall, of_grain in zip(grains.wall_moduli, outer, strict=True)
    ]
    modulus = pair_value(_with_ends(grains.moduli, *planes))
    radius = pair_value(_with_ends(grains.diameters / 2, math.inf, math.inf))
    # Hertz's constants, which given ones replace
    natural = grains.law.constant(modulus, radius, lengths)
    fixed = grains.contact_constants
    between = np.where(np.isnan(fixed), natural[..., 1:-1], fixed)
    ends: list[Any] = []
    for wall, constant, end in zip(grains.walls, grains.wall_constants, (0, -1), strict=True):
        if wall and math.isnan(constant):
            constant = natural[..., end]
            # in the proportion of Hertz's law to the next contact, which may be given
            if between.shape[-1]:
                constant = constant * (between[..., end] / natural[..., 1:-1][..., end])
        ends.append(constant if wall else 0.0)
    return _with_ends(between, *ends)


def _with_ends(values: Array, first: float | Array, last: float | Array) -> Array:
    """Return a row of values (..., B) between one more at either end, (...)."""
    row = np.empty((*values.shape[:-1], values.shape[-1] + 2))
    row[..., 0] = first
    row[..., 1:-1] = values
    row[..., -1] = last
    return row
