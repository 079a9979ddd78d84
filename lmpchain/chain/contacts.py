"""The contact law: Hertz's constants, and force, overlap, stiffness and energy of contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array, read_only
from ..util.caching import cached_property

# grains of a chain: up to here all contacts are known sooner than those of some parts
FEW_GRAINS = 10**4
# factor on the largest strain: a contact that opens is softer than at rest
OPENING_MARGIN = 1.05
# strain below which 11 terms of the energy's series have all digits
SERIES_BELOW = 0.02
Number = TypeVar("Number", float, Array)


def hertz_constant(modulus: Number, radius: Number, length: Number, exponent: float) -> Number:
    """Return Hertz's constant K = (4/3) E* sqrt(R*) dbar^(1.5 - delta) of contacts, N/m^delta.

    Parameters
    ----------
    modulus, radius : float or (...) arrays
        E*, Pa, and R*, m, of the pairs in contact, as `pair_value` gives them.
    length : float or (...) array
        Mean diameter, m: it keeps the unit of a force for exponents other than Hertz's.
    exponent : float
        delta.
    """
    return 4 / 3 * modulus * radius**0.5 * length ** (1.5 - exponent)


def pair_value(values: Array) -> Array:
    """Return 1 / (1/a + 1/b) of neighbours in a row of B bodies, (..., B-1): their E* or R*.

    A plane has an infinite radius.
    """
    return reduced(values[..., :-1], values[..., 1:])


def reduced(upper: Number, lower: Number) -> Number:
    """Return 1 / (1/a + 1/b) of two bodies, or of two arrays of them."""
    return 1 / (1 / upper + 1 / lower)


def pair_slopes(values: Array) -> tuple[Array, Array]:
    """Return d(log of `pair_value`) / d(log a), (..., B-1), of the upper body, and of the lower."""
    pair = pair_value(values)
    return pair / values[..., :-1], pair / values[..., 1:]


def free_approach(energy: Any, constant: Number, exponent: float) -> Number:
    """Return the overlap at which a contact without force at rest holds this energy, m.

    Its energy is ``K r^(delta+1) / (delta+1)``.
    """
    power = exponent + 1
    return (power * energy / constant) ** (1 / power)  # type: ignore[no-any-return]


def dynamical_matrix(stiffness: Array, masses: Array) -> tuple[Array, Array]:
    """Return `Chain.dynamical_matrix` of chains, (..., M) and (..., M-1) arrays.

    Parameters
    ----------
    stiffness : (..., N+1) array
        Of the contacts at rest, N/m.
    masses : (..., M) array
        Of the grains that move, kg.
    """
    moving = masses.shape[-1]
    diagonal = (stiffness[..., :-1] + stiffness[..., 1:])[..., :moving] / masses
    return diagonal, -stiffness[..., 1:moving] / np.sqrt(masses[..., :-1] * masses[..., 1:])


@dataclass(frozen=True, eq=False)
class Contacts:
    """All contacts of a chain of N grains, walls included, or of many such chains.

    Contact n lies between grains n and n + 1; contact 0 between grain 1 and a wall above it,
    contact N between grain N and a wall below it. Where there is no wall the constant is 0, and so
    is everything else.

    Attributes
    ----------
    exponent : float
        delta.
    constant : (..., N+1) array
        K_n, N/m^delta.
    force : (..., N+1) array
        Force of each contact at rest, N.
    overlap : (..., N+1) array
        Overlap eps_n at rest, m.
    stiffness : (..., N+1) array
        Linear stiffness delta K_n eps_n^(delta-1) at rest, N/m.
    """

    exponent: float
    constant: Array
    force: Array
    overlap: Array
    stiffness: Array

    @classmethod
    def at_rest(cls, constant: Array, force: Array, exponent: float) -> Contacts:
        """Return contacts with these constants, N/m^delta, that carry these forces at rest, N."""
        # where there is no wall, 0 / 0 would be no number
        overlap = (force / np.where(constant > 0, constant, 1.0)) ** (1 / exponent)
        stiffness = exponent * constant * overlap ** (exponent - 1)
        return cls(exponent, *map(read_only, (constant, force, overlap, stiffness)))

    @property
    def _arrays(self) -> tuple[Array, Array, Array, Array]:
        return self.constant, self.force, self.overlap, self.stiffness

    @cached_property
    def exists(self) -> NDArray[np.bool_]:
        """Whether there are two bodies, (..., N+1) bool."""
        return read_only(self.constant > 0)

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """Whether the contact is compressed at rest, (..., N+1) bool."""
        return read_only(self.force > 0)

    def of(self, numbers: int | np.integer | slice | NDArray[np.intp]) -> Contacts:
        """Return these contacts of one chain, or the contacts of these of many chains."""
        return Contacts(self.exponent, *(values[numbers] for values in self._arrays))

    def above(self, grain: int) -> Contacts:
        """Return the contacts above a grain that is held from now on."""
        # there is no wall below the grain that is held
        arrays = (read_only(np.append(values[:grain], 0.0)) for values in self._arrays)
        return Contacts(self.exponent, *arrays)

    def force_at(self, overlap: Array) -> Array:
        """Return the force K o^delta of contacts with the overlap o, 0 if open, (..., N+1) N."""
        return self.constant * np.maximum(overlap, 0.0) ** self.exponent

    def stiffness_at(self, overlap: Array) -> Array:
        """Return the stiffness delta K o^(delta-1) at the overlap o >= 0, (..., N+1) N/m."""
        return self.exponent * self.constant * overlap ** (self.exponent - 1)

    @staticmethod
    def closer(displacement: Array, wall: Array | None = None) -> Array:
        """Return by how much every overlap exceeds that at rest, (..., N+1) m.

        The top wall is at (...) m, by default where it is at rest.
        """
        u = np.asarray(displacement)
        # filled in place: numpy's diff of a row with two ends would copy long records twice
        closer = np.empty((*u.shape[:-1], u.shape[-1] + 1))
        closer[..., 0] = 0.0 if wall is None else wall
        closer[..., 0] -= u[..., 0]
        closer[..., -1] = u[..., -1]
        np.subtract(u[..., :-1], u[..., 1:], out=closer[..., 1:-1])
        return closer

    def force_change(self, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N.

        The relative accuracy does not depend on the amplitude of the wave.
        """
        # from s = -1 on the contact is open, and the force at rest is all that is lost
        s = r / np.where(self.pressed, self.overlap, np.inf)
        relative = np.expm1(self.exponent * np.log1p(np.where(s > -1, s, 0.0)))
        change = self.force * np.where(s > -1, relative, -1.0)
        return np.where(self.pressed, change, self.force_at(r))

    def energy(self, r: Array) -> Array:
        """Return the contact energy above that at rest for a change r of the overlap, (..., N+1) J.

        It is the integral of K [eps + r]^delta - K eps^delta over r, accurate in relative terms for
        the weakest waves.
        """
        # most of a long chain rests, and powers take most of the time
        if np.ndim(r) == 2 and not (moves := r.any(axis=0)).all():
            energy = np.zeros(r.shape)
            energy[:, moves] = self.of(np.flatnonzero(moves)).energy(r[:, moves])
            return energy
        power = self.exponent + 1
        loose = self.constant / power * np.maximum(r, 0.0) ** power
        s = r / np.where(self.pressed, self.overlap, 1.0)
        y = np.log1p(np.where(s > -1, s, 0.0))
        exact = np.where(s > -1, np.expm1(power * y), -1.0) / power - s
        # the two terms cancel for small s: sum the binomial series instead
        series = np.zeros_like(s)
        for k in range(11, 1, -1):
            series = (power - k + 1) / k * s * (1 + series)
        scaled = np.where(np.abs(s) < SERIES_BELOW, s * series, exact)
        return np.where(self.pressed, self.force * self.overlap * scaled, loose)

    def collision_overlap(self, speed: Array, inverse_mass: Array) -> Array:
        """Return the largest overlap, m, of two bodies that meet alone at a speed, (N+1,) m/s.

        The sum of their inverse masses is (N+1,) 1/kg; where it is 0 nothing meets.
        """
        meets = (inverse_mass > 0) & self.exists
        energy = speed**2 / (2 * np.where(meets, inverse_mass, np.inf))
        return free_approach(energy, np.where(meets, self.constant, 1.0), self.exponent)

    def squeezed_by(self, force: float) -> float:
        """Return by how much more one contact overlaps under this additional force, m."""
        if self.pressed:
            return float(self.overlap * np.expm1(np.log1p(force / self.force) / self.exponent))
        return float((force / self.constant) ** (1 / self.exponent))

    @property
    def elastic_share(self) -> float:
        """Mean share of the contacts in the energy of an uncompressed chain (virial theorem)."""
        return 2 / (self.exponent + 3)

    def constant_for_stiffness(self, factor: Array) -> Array:
        """Return the factor on constants for one on stiffnesses at rest, under the same forces."""
        return factor**self.exponent

    def stiffness_for_force(self, factor: Array) -> Array:
        """Return the factor on stiffnesses at rest for one on the forces at rest."""
        return factor ** (1 - 1 / self.exponent)

    def approach_bound(self, energy: float | Array) -> Array:
        """Return an upper bound on how far each overlap exceeds that at rest, (..., N+1) m.

        The bound is rigorous: no contact can hold more than the whole conserved energy above rest,
        (...) J, and the energy of one is at least ``K r^(delta+1) / (delta+1)`` and ``k r^2 / 2``.
        """
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            of_law = free_approach(energy, self.constant, self.exponent)
            of_stiffness = np.sqrt(2 * energy / self.stiffness)
        # without energy and stiffness the second is no number, which fmin passes over
        return np.where(self.exists, np.fmin(of_law, of_stiffness), 0.0)

    def overlap_bound(self, energy: float | Array) -> Array:
        """Return an upper bound of each overlap for this energy above rest, (..., N+1) m."""
        return self.overlap + self.approach_bound(energy)

    def largest_strain(self, energy: float | Array) -> Array:
        """Return `Scene.largest_strain`, (...), for this energy above rest, (...) or (..., 1) J."""
        # a loose contact has no strain; where there is none, neither moves
        strain = self.approach_bound(energy) / np.where(self.pressed, self.overlap, 1.0)
        bounded = (self.pressed == self.exists).all(-1)
        # of one chain a number, and no array of none
        return np.where(bounded, OPENING_MARGIN * strain.max(-1), np.inf)[()]


def together(contacts: Sequence[Contacts]) -> Contacts:
    """Return the contacts of R chains of one length as one, (R, N+1), for compiled loops."""
    rows = map(np.array, zip(*(chain._arrays for chain in contacts), strict=True))
    return Contacts(contacts[0].exponent, *rows)
