"""The contacts of chains: forces, overlaps, stiffnesses and energies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array, read_only
from ..util.lazy import cached_property
from .contact_law import ContactLaw

# Up to this number of grains, deriving all contacts takes less time than deriving parts.
FEW_GRAINS = 10**4
# Safety factor on the largest strain, because a contact that opens is softer than at rest.
OPENING_MARGIN = 1.05


def pair_value(values: Array) -> Array:
    """Return 1 / (1/a + 1/b) of neighbours in a row of B bodies, (..., B-1), for E* and R*.

    A plane has an infinite radius.
    """
    return reduced(values[..., :-1], values[..., 1:])


Number = TypeVar("Number", float, Array)


def reduced(upper: Number, lower: Number) -> Number:
    """Return 1 / (1/a + 1/b) of two bodies, or of two arrays of them."""
    return 1 / (1 / upper + 1 / lower)


def pair_slopes(values: Array) -> tuple[Array, Array]:
    """Return d(log of `pair_value`) / d(log a), (..., B-1), by upper and by lower body."""
    pair = pair_value(values)
    return pair / values[..., :-1], pair / values[..., 1:]


def dynamical_matrix(stiffness: Array, masses: Array) -> tuple[Array, Array]:
    """Return `Chain.dynamical_matrix` of chains, (..., M) and (..., M-1) arrays.

    Parameters
    ----------
    stiffness : (..., N+1) array
        Stiffness of each contact at rest, N/m.
    masses : (..., M) array
        Masses of the grains that move, kg.
    """
    moving = masses.shape[-1]
    diagonal = (stiffness[..., :-1] + stiffness[..., 1:])[..., :moving] / masses
    return diagonal, -stiffness[..., 1:moving] / np.sqrt(masses[..., :-1] * masses[..., 1:])


@dataclass(frozen=True, eq=False)
class Contacts:
    """All contacts of a chain of N grains, walls included, or of many such chains.

    Contact n is between grains n and n + 1, contact 0 between grain 1 and a wall above it, and
    contact N between grain N and a wall below it. All values of the contact with a missing wall
    are 0.

    Attributes
    ----------
    law : ContactLaw
    constant : (..., N+1) array
        Constant K_n of each contact, N/m^delta.
    force : (..., N+1) array
        Force of each contact at rest, N.
    overlap : (..., N+1) array
        Overlap eps_n at rest, m.
    stiffness : (..., N+1) array
        Linear stiffness at rest, N/m; for a power law, delta K_n eps_n^(delta-1).
    """

    law: ContactLaw
    constant: Array
    force: Array
    overlap: Array
    stiffness: Array

    @classmethod
    def at_rest(cls, constant: Array, force: Array, law: ContactLaw) -> Contacts:
        """Return contacts with these constants, N/m^delta, and these forces at rest, N."""
        # Without a wall the constant is 0, and 0 / 0 would be NaN.
        overlap = law.overlap(force, np.where(constant > 0, constant, 1.0))
        if law.bonds:
            overlap = np.where(constant > 0, overlap, 0.0)
        stiffness = law.stiffness(overlap, constant)
        return cls(law, *map(read_only, (constant, force, overlap, stiffness)))

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """The constant, force (N), overlap (m) and stiffness (N/m) at rest, (..., N+1) each."""
        return self.constant, self.force, self.overlap, self.stiffness

    @cached_property
    def exists(self) -> NDArray[np.bool_]:
        """Whether a contact has two bodies, (..., N+1) bool; there may be no wall."""
        return read_only(self.constant > 0)

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """Whether the contact is compressed, or bonded, at rest, (..., N+1) bool."""
        return read_only(self.law.pressed(self))

    @cached_property
    def length(self) -> Array:
        """Return `ContactLaw.length` of the contacts, (..., N+1) m."""
        return self.law.length(self)

    @cached_property
    def bend(self) -> Array:
        """Return `ContactLaw.bend` of the contacts at rest, (..., N+1); 0 without a force."""
        return np.where(self.pressed, self.law.bend(self), 0.0)

    def of(self, numbers: int | np.integer | slice | NDArray[np.intp] | None) -> Contacts:
        """Return a selection of these contacts, or of these chains."""
        # The first axis of the arrays of many chains numbers the chains.
        return Contacts(self.law.of(numbers), *(values[numbers] for values in self.arrays))

    def above(self, grain: int) -> Contacts:
        """Return the contacts above a grain that is from now on fixed."""
        # There is no wall below the fixed grain.
        arrays = (read_only(np.append(values[:grain], 0.0)) for values in self.arrays)
        return Contacts(self.law.of(slice(grain + 1)), *arrays)

    def force_at(self, overlap: Array) -> Array:
        """Return the force of contacts with this overlap, 0 if open, (..., N+1) N."""
        return self.law.force(overlap, self.constant)  # type: ignore[no-any-return]

    def stiffness_at(self, overlap: Array) -> Array:
        """Return the stiffness at an overlap o >= 0, (..., N+1) N/m."""
        return self.law.stiffness(overlap, self.constant)  # type: ignore[no-any-return]

    def stiffness_bound(self, overlap: Array) -> Array:
        """Return the largest stiffness at any overlap up to this one, (..., N+1) N/m."""
        return self.law.largest_stiffness(overlap, self.constant)  # type: ignore[no-any-return]

    @staticmethod
    def closer(displacement: Array, wall: Array | None = None, base: Array | None = None) -> Array:
        """Return the increase of every overlap from rest, (..., N+1) m.

        `wall` and `base` are the displacements of the top and the bottom wall, (...) m; by default
        0.
        """
        u = np.asarray(displacement)
        # The array is filled in place, because numpy's diff with two ends would copy long records
        # twice.
        closer = np.empty((*u.shape[:-1], u.shape[-1] + 1))
        closer[..., 0] = 0.0 if wall is None else wall
        closer[..., 0] -= u[..., 0]
        closer[..., -1] = u[..., -1]
        if base is not None:
            closer[..., -1] -= base
        np.subtract(u[..., :-1], u[..., 1:], out=closer[..., 1:-1])
        return closer

    def force_change(self, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N.

        The relative accuracy does not depend on the amplitude of the wave.
        """
        return self.law.force_change(self, r)

    def energy(self, r: Array) -> Array:
        """Return the contact energy above that at rest for a change r of the overlap, (..., N+1) J.

        Its relative accuracy does not depend on the amplitude of the wave.
        """
        # Most of a long chain rests, and the powers are the most expensive part.
        if np.ndim(r) == 2 and not (moves := r.any(axis=0)).all():
            energy = np.zeros(r.shape)
            energy[:, moves] = self.of(np.flatnonzero(moves)).energy(r[:, moves])
            return energy
        return self.law.energy_change(self, r)

    def collision_overlap(self, speed: Array, inverse_mass: Array) -> Array:
        """Return the largest overlap, m, in a collision of two bodies at a speed, (N+1,) m/s.

        `inverse_mass` is the sum of the inverse masses of both bodies, (N+1,) 1/kg. If it is 0, the
        bodies do not collide, and the overlap is 0.
        """
        meets = (inverse_mass > 0) & self.exists
        energy = speed**2 / (2 * np.where(meets, inverse_mass, np.inf))
        constant = np.where(meets, self.constant, 1.0)
        return np.where(meets, self.law.approach(energy, constant), 0.0)

    def squeezed_by(self, force: float) -> float:
        """Return the increase of the overlap of a contact under an additional force, m."""
        return float(self.law.squeezed_by(self, force))

    def approach_bound(self, energy: float | Array) -> Array:
        """Return an upper bound on the increase of each overlap from rest, (..., N+1) m.

        The bound is rigorous, because no contact can store more than the conserved energy of the
        whole chain above rest, (...) J.
        """
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return np.where(self.exists, self.law.approach_bound(self, energy), 0.0)

    def overlap_bound(self, energy: float | Array) -> Array:
        """Return an upper bound on each overlap for this energy above rest, (..., N+1) m."""
        return self.overlap + self.approach_bound(energy)

    def strain_bound(self, approach: Array) -> Array:
        """Return a bound on strains from bounds on approaches, (..., N+1) m; see `Scene`."""
        # A loose contact has no strain. A missing contact has no approach.
        strain = approach / np.where(self.pressed, self.length, 1.0)
        bounded = (self.pressed == self.exists).all(-1)
        # The result for one chain is a number, not an array of dimension 0.
        return np.where(bounded, OPENING_MARGIN * strain.max(-1), np.inf)[()]


def together(contacts: Sequence[Contacts]) -> Contacts:
    """Return the contacts of R chains of equal length as arrays (R, N+1), for compiled loops."""
    if len(contacts) == 1:
        # These are views of the arrays of this chain.
        return contacts[0].of(np.newaxis)
    rows = map(np.array, zip(*(chain.arrays for chain in contacts), strict=True))
    # The arrays are read-only like those of one chain, because numba compiles again for writable
    # arrays.
    law = contacts[0].law.joined([chain.law for chain in contacts])
    return Contacts(law, *map(read_only, rows))
