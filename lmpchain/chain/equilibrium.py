"""Equilibrium of one chain or many chains: forces, overlaps and stiffnesses at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array, read_only
from .bounds import LIMITS
from .contact_law import Contacts, dynamical_matrix, reduced
from .materials import sphere_mass, with_impurities

# Values of the top contact, of the contacts between grains, and of the bottom contact.
Ends = tuple[float | Array, float | Array, float | Array]


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Chains of N grains at rest.

    Attributes
    ----------
    contacts : Contacts
        Contacts with their forces, overlaps and stiffnesses at rest.
    contact_lengths : (..., N+1) array
        Mean diameter of the two grains of every contact, or the grain's diameter at a wall, m.
    diameters, masses : (..., N) arrays
        Diameter of each grain, m; mass of each grain, kg.
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
        """Return `Chain.dynamical_matrix` of these chains with this number of moving grains."""
        return dynamical_matrix(self.contacts.stiffness, self.masses[..., :movable])

    def computable(self, movable: int) -> NDArray[np.bool_]:
        """Return whether masses and stiffnesses are within the floating-point range, (...)."""
        diagonal, coupling = self.dynamical_matrix(movable)
        sound = (self.masses > 0).all(-1) & ~np.isnan(self.compression).any(-1)
        for elements in (diagonal, coupling):
            sound &= (abs(elements) < LIMITS.stiffness_over_mass).all(-1)
        return np.asarray(sound)

    def row(self, number: int) -> Equilibrium:
        """Return the equilibrium of one of many chains."""
        return Equilibrium(
            self.contacts.of(number),
            self.contact_lengths[number],
            self.diameters[number],
            self.masses[number],
        )

    def above(self, grain: int) -> Equilibrium:
        """Return grains 1 ... `grain` as a chain whose last grain is fixed."""
        lengths = np.append(self.contact_lengths[:grain], self.diameters[grain - 1])
        contacts = self.contacts.above(grain)
        return Equilibrium(
            contacts, read_only(lengths), self.diameters[:grain], self.masses[:grain]
        )


def derive_chain(chain: Any, drawn: Mapping[str, Array] | None = None) -> Equilibrium:
    """Return the equilibrium of a chain, or of R chains with R drawn values of some properties.

    A value that all grains share stays in a (1,) array until rows of grains are filled, so that a
    chain of equal grains costs little time.

    Parameters
    ----------
    chain : Chain
        The annotation is `Any`, because the module of `Chain` imports this module.
    drawn : mapping of (R, N) or (R, N-1) arrays, optional
        Values that replace fields of the chain: "diameter", "masses", "contact_constants",
        "material.density", "material.youngs_modulus" or "material.poissons_ratio". Impurities keep
        their own values.
    """
    drawn = drawn or {}
    grains = chain.grains
    rows = next(iter(drawn.values())).shape[:-1] if drawn else ()
    # An array is used in any case: a power of a Python float raises on overflow and rounds
    # differently.
    diameter = np.array(drawn.get("diameter", chain.diameter), ndmin=1)
    diameter = with_impurities(diameter, chain.impurity, attrgetter("diameter"), grains)
    density, youngs, poisson = (
        chain.of_material(name, drawn.get(f"material.{name}"))
        for name in ("density", "youngs_modulus", "poissons_ratio")
    )
    mass = drawn.get("masses", chain.given_masses)
    mass = sphere_mass(density, diameter) if mass is None else mass
    mass = with_impurities(mass, chain.impurity, attrgetter("mass"), grains)
    upper, lower = _neighbours(diameter)
    lengths = (_end(diameter, 0), (upper + lower) / 2, _end(diameter, -1))
    given = drawn.get("contact_constants", chain.given_contact_constants)
    if given is None:
        given = chain.law.given_constant
    modulus = youngs / (1 - poisson * poisson)
    constants = _contact_constants(chain, modulus, diameter, lengths, given)
    masses = _spread((*rows, grains), mass)
    # Long doubles are used because rounding of the weight of many grains would affect the
    # stiffnesses.
    weight = chain.gravity * masses.cumsum(-1, dtype=np.longdouble)
    force = force_at_rest(weight, chain.top_load, chain.load_grain).astype(float)
    # A missing wall carries no force.
    if chain.top != "wall":
        force[..., 0] = 0.0
    if chain.bottom != "wall":
        force[..., -1] = 0.0
    shape = (*rows, grains + 1)
    return Equilibrium(
        Contacts.at_rest(_fill(shape, constants), force, chain.law.with_walls(grains)),
        read_only(_fill(shape, lengths)),
        read_only(_spread(masses.shape, diameter)),
        read_only(masses),
    )


def force_at_rest(weight: NDArray[Any], top_load: float, load_grain: int) -> NDArray[Any]:
    """Return the force on every contact at rest, (..., N+1) N, as if both walls existed.

    Parameters
    ----------
    weight : (..., N) array
        Weight of every grain together with all grains above it, N.
    top_load : float
        Top load, N.
    load_grain : int
        Number of the grain that the top load acts on, from 1.
    """
    force = np.zeros((*weight.shape[:-1], weight.shape[-1] + 1), weight.dtype)
    force[..., 1:] = weight
    # A wall above grain 1 transmits a load on grain 1.
    force[..., load_grain if load_grain > 1 else 0 :] += top_load
    return force


def _contact_constants(
    chain: Any, modulus: Array, diameter: Array, lengths: Ends, given: Array | None
) -> Ends:
    """Return the constants of the top contact, the contacts between grains, and the bottom contact.

    The unit is N/m^delta; the constant of a missing wall is 0.

    Parameters
    ----------
    chain : Chain
    modulus, diameter : (..., N) or (1,) arrays
        Plane-strain moduli, Pa; diameters, m.
    lengths : Ends
        Mean diameters of the same contacts, m.
    given : (..., N-1) array, optional
        Constants of the contacts between grains; by default they follow from the contact law.
    """
    natural = chain.law.constant(
        reduced(*_neighbours(modulus)), reduced(*_neighbours(diameter / 2)), lengths[1]
    )
    between = natural if given is None else given
    ends: list[float | Array] = []
    for end, kind, wall in (
        (0, chain.top, chain.top_material),
        (-1, chain.bottom, chain.bottom_material),
    ):
        if kind != "wall":
            ends.append(0.0)
        elif chain.given_wall_constants is not None:
            ends.append(chain.given_wall_constants[end])
        elif chain.law.given_constant is not None:
            # A law with its own constant applies it at walls as well.
            ends.append(_end(between, end))
        else:
            of_grain = _end(modulus, end)
            plane: Any = wall.plane_strain_modulus if wall else of_grain
            radius = reduced(_end(diameter, end) / 2, np.array(math.inf))
            pair = reduced(of_grain, plane)
            constant = chain.law.constant(pair, radius, lengths[end])
            # The ratio of the constants of a wall and of the next contact follows from Hertz's law.
            if given is not None and chain.grains > 1:
                constant = constant * _end(given / natural, end)
            ends.append(constant)
    return ends[0], between, ends[1]


def _neighbours(values: Array) -> tuple[Array, Array]:
    """Return the values (..., N) of the upper and the lower grain of every contact between grains.

    A value that all grains share is returned for both.
    """
    return (values, values) if values.size == 1 else (values[..., :-1], values[..., 1:])


def _end(values: Array, end: int) -> Array:
    """Return the value of the first (end 0) or last (end -1) grain, (..., 1), or the common one."""
    if values.size == 1:
        return values
    return values[..., :1] if end == 0 else values[..., -1:]


def _spread(shape: tuple[int, ...], values: Array) -> Array:
    """Return an array of this shape with these values, or with one common value, in each row."""
    row = np.empty(shape)
    row[...] = values
    return row


def _fill(shape: tuple[int, ...], values: Ends) -> Array:
    """Return rows (..., B) with given first, middle (one or B - 2) and last values."""
    row = np.empty(shape)
    row[..., :1], row[..., 1:-1], row[..., -1:] = values
    return row
