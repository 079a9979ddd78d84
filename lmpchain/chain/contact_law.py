"""The contact law: contact force as a function of overlap, and derived functions.

========  ============  ==================================================
symbol    variable      meaning
========  ============  ==================================================
o         overlap       of two bodies, m; below 0 there is a gap
K         constant      of a contact; its unit is N/m^delta for a power
F, k      force, ...    force, N, and stiffness dF/do, N/m
r         r             change of the overlap since rest, m
delta     exponent      of a power law, K o^delta; 1.5 is Hertz's
========  ============  ==================================================
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..util.arrays import Array, read_only
from ..util.lazy import cached_property

# A formula is a function of overlap and constant, numbers or arrays, and of a sequence of
# parameters.
Formula = Callable[[Any, Any, Any], Any]
# Below this strain, 11 terms of the energy's series are accurate to rounding.
SERIES_BELOW = 0.02


class RestingContacts(Protocol):
    """The part of `Contacts` that a law reads: arrays (..., N+1) at rest, and existing contacts."""

    @property
    def constant(self) -> Array: ...  # noqa: D102
    @property
    def force(self) -> Array: ...  # noqa: D102
    @property
    def overlap(self) -> Array: ...  # noqa: D102
    @property
    def stiffness(self) -> Array: ...  # noqa: D102
    @property
    def exists(self) -> NDArray[np.bool_]: ...  # noqa: D102
    @property
    def pressed(self) -> NDArray[np.bool_]: ...  # noqa: D102
    @property
    def length(self) -> Array: ...  # noqa: D102


@dataclass(frozen=True)
class ContactLaw(ABC):
    """Contact force as a function of the overlap: `PowerForce`, or a `Law` of a user.

    The formulas are functions of (o, K, p) that accept arrays; p are the `parameters`.

    Parameters
    ----------
    force_formula, stiffness_formula, curvature_formula : functions
        Force, N; its first derivative with respect to the overlap, N/m; its second derivative,
        N/m2.
    onset : float
        Power of the overlap with which the force of a closing contact begins to grow.
    parameters : tuple of numbers, or of (..., N+1) arrays, optional
        Parameters of all contacts or of each contact.
    name : str, optional
        Name of the law in messages.
    """

    force_formula: Formula
    stiffness_formula: Formula
    curvature_formula: Formula
    onset: float
    parameters: tuple[Any, ...] = ()
    name: str = "a law given by formulas"

    @property
    def power(self) -> float | None:
        """The exponent of a power law; None for any other law."""
        return None

    def power_of(self, what: str) -> float:
        """Return the exponent of a power law, which `what` requires, or raise `InputError`."""
        if self.power is None:
            fault = f"must be a power of the overlap for {what} (got {self.name})"
            raise InputError.at("chain.law", f"{fault}: give an exponent instead")
        return self.power

    def constant(self, modulus: Any, radius: Any, length: Any) -> Any:
        """Return the constant K of contacts of spheres, Hertz's (4/3) E* sqrt(R*), N/m^1.5.

        Parameters
        ----------
        modulus, radius : float or (...) arrays
            Effective modulus E* of each pair, Pa; effective radius R*, m (see `pair_value`).
        length : float or (...) array
            Mean diameter of each pair, m; used by powers other than Hertz's.
        """
        return 4 / 3 * modulus * radius**0.5

    @property
    def given_constant(self) -> Array | None:
        """The constants of contacts given by the law itself, N/m^delta; None if it gives none."""
        return None

    def kinks(self, constant: Any) -> Array:
        """Return the overlaps at which the force is not smooth, m, (K, ...) of (...) constants."""
        return np.zeros((1, *np.shape(constant)))

    def kept_at_rest(self, overlap: Any, constant: Any) -> list[Any]:
        """Return additional values at rest that the compiled force reads."""
        return []

    @property
    def bonds(self) -> bool:
        """Whether contacts are stiff at rest without any load, because they also pull."""
        return False

    @property
    def grows(self) -> bool:
        """Whether the force decreases at no overlap."""
        return True

    def with_walls(self, grains: int) -> ContactLaw:
        """Return the law with parameters of all contacts of a chain, walls included."""
        return self

    def with_constants(self, constant: Array) -> ContactLaw:
        """Return the law of contacts with these constants, (..., N+1); 0 for missing walls."""
        return self

    def of(self, numbers: Any, dimensions: int = 1) -> ContactLaw:
        """Return the law of a selection of contacts or, of many chains, of chains.

        Parameters
        ----------
        numbers : index
            Index of the first axis of arrays.
        dimensions : int
            Dimensions of the arrays of contacts: 1 for those of a chain, (N+1,), and 2 for those of
            many chains. Parameters of fewer dimensions are common to the selection.
        """
        return self

    @property
    def form(self) -> Any:
        """A key that is equal for laws that differ only in parameter values."""
        return self

    def joined(self, laws: Sequence[ContactLaw]) -> ContactLaw:
        """Return the common law of many chains, given their laws of one `form`."""
        return self

    def pressed(self, contacts: RestingContacts) -> NDArray[np.bool_]:
        """Return whether a contact is stiff at rest, so that weak motions are linear, (..., N+1).

        A contact without load only touches.
        """
        return contacts.force > 0

    def length(self, contacts: RestingContacts) -> Array:
        """Return the change of overlap at which a wave is no longer weak, (..., N+1) m.

        It is the overlap at rest: the contact opens if its overlap decreases by this length.
        """
        return contacts.overlap

    def hardening(self, contacts: RestingContacts, strain: float) -> float:
        """Return the largest relative change of the mean stiffness at a strain; 0 for a power law.

        The factors of the model error of linear theory were measured for power laws, and include
        this change.
        """
        return 0.0

    def force(self, overlap: Any, constant: Any) -> Any:
        """Return the force at an overlap, 0 if the contact is open, N."""
        return self.force_formula(overlap, constant, self.parameters)

    def stiffness(self, overlap: Any, constant: Any) -> Any:
        """Return the stiffness at an overlap o >= 0, N/m."""
        return self.stiffness_formula(overlap, constant, self.parameters)

    def curvature(self, overlap: Any, constant: Any) -> Any:
        """Return the derivative of the stiffness at an overlap o > 0, N/m2."""
        return self.curvature_formula(overlap, constant, self.parameters)

    @abstractmethod
    def largest_stiffness(self, overlap: Any, constant: Any) -> Any:
        """Return the largest stiffness at any overlap up to this value, N/m."""

    @abstractmethod
    def overlap(self, force: Any, constant: Any) -> Any:
        """Return the overlap at which a contact has this force, m."""

    @abstractmethod
    def approach(self, energy: Any, constant: Any) -> Any:
        """Return the overlap at which a contact without load at rest stores this energy, m."""

    @abstractmethod
    def approach_bound(self, contacts: RestingContacts, energy: Any) -> Any:
        """Return an upper bound on the overlap change at this energy above rest, (..., N+1) m."""

    def bend(self, contacts: RestingContacts) -> Any:
        """Return k'(eps) l / k(eps) at rest, where l is `length`; for a power law, delta - 1."""
        overlap = np.where(contacts.pressed, contacts.overlap, 1.0)
        length = np.where(contacts.pressed, self.length(contacts), 0.0)
        stiffness = np.where(contacts.pressed, contacts.stiffness, 1.0)
        return length * self.curvature(overlap, contacts.constant) / stiffness

    @abstractmethod
    def force_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N.

        The relative accuracy does not depend on the amplitude of the wave.
        """

    @abstractmethod
    def energy_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the contact energy above that at rest for a change r of the overlap, (..., N+1) J.

        It is the integral of F(eps + r) - F(eps) over r. Its relative accuracy does not depend on
        the amplitude of the wave.
        """

    @abstractmethod
    def squeezed_by(self, contacts: RestingContacts, force: Any) -> Any:
        """Return the increase of overlaps under an additional force, m."""

    @property
    def elastic_share(self) -> float:
        """Mean fraction of an uncompressed chain's energy in its contacts (virial theorem).

        For laws other than powers it is the fraction in weak motions.
        """
        return 2 / (self.onset + 3)

    def __repr__(self) -> str:
        return self.name


class PowerForce(ContactLaw):
    """The power law: force K o^delta of a closed contact.

    Parameters
    ----------
    exponent : float
        Exponent delta, 1 (linear springs) or more; 1.5 is Hertz's law.
    """

    def __init__(self, exponent: float):
        super().__init__(
            _power,
            _power_stiffness,
            _power_curvature,
            onset=exponent,
            parameters=(exponent,),
            name=f"exponent {exponent:g}",
        )

    @property
    def power(self) -> float:
        """The exponent delta."""
        return self.onset

    def constant(self, modulus: Any, radius: Any, length: Any) -> Any:
        """Return Hertz's constant K = (4/3) E* sqrt(R*) dbar^(1.5 - delta), N/m^delta."""
        return 4 / 3 * modulus * radius**0.5 * length ** (1.5 - self.onset)

    def largest_stiffness(self, overlap: Any, constant: Any) -> Any:
        """Return the stiffness at this overlap, N/m, which is the largest stiffness up to it."""
        return self.stiffness(overlap, constant)

    def overlap(self, force: Any, constant: Any) -> Any:
        """Return the overlap at which a contact has this force, m."""
        return (force / constant) ** (1 / self.onset)

    def approach(self, energy: Any, constant: Any) -> Any:
        """Return the overlap at which a contact without force at rest stores this energy, m.

        At the overlap r the contact stores the energy ``K r^(delta+1) / (delta+1)``.
        """
        power = self.onset + 1
        return (power * energy / constant) ** (1 / power)

    def approach_bound(self, contacts: RestingContacts, energy: Any) -> Any:
        """Return an upper bound on the increase of overlaps from rest, m.

        A contact stores at least ``K r^(delta+1) / (delta+1)``, and at least ``k r^2 / 2``.
        """
        of_law = self.approach(energy, contacts.constant)
        # Without energy and stiffness the second bound is NaN, which fmin ignores.
        return np.fmin(of_law, np.sqrt(2 * energy / contacts.stiffness))

    def bend(self, contacts: RestingContacts) -> float:
        """Return delta - 1 (see `ContactLaw.bend`)."""
        return self.onset - 1

    def force_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N."""
        s = r / np.where(contacts.pressed, contacts.overlap, np.inf)
        change = contacts.force * _growth(s, self.onset)
        return np.where(contacts.pressed, change, self.force(r, contacts.constant))

    def energy_change(self, contacts: RestingContacts, r: Array) -> Array:
        """Return the contact energy above that at rest for a change r of the overlap, (..., N+1) J.

        It is the integral of K [eps + r]^delta - K eps^delta over r.
        """
        power = self.onset + 1
        loose = contacts.constant / power * np.maximum(r, 0.0) ** power
        s = r / np.where(contacts.pressed, contacts.overlap, np.inf)
        exact = _growth(s, power) / power - s
        # The two terms cancel for small s, so the binomial series is summed instead.
        series = np.zeros_like(s)
        for k in range(11, 1, -1):
            series = (power - k + 1) / k * s * (1 + series)
        scaled = np.where(np.abs(s) < SERIES_BELOW, s * series, exact)
        return np.where(contacts.pressed, contacts.force * contacts.overlap * scaled, loose)

    def squeezed_by(self, contacts: RestingContacts, force: Any) -> Any:
        """Return the increase of the overlap of a contact under an additional force, m."""
        if contacts.pressed:
            return contacts.overlap * np.expm1(np.log1p(force / contacts.force) / self.onset)
        return self.overlap(force, contacts.constant)


def _growth(strain: Array, power: float) -> Array:
    """Return (1 + s)^p - 1 without cancellation; -1 below s = -1, where the contact is open."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.expm1(power * np.log1p(np.maximum(strain, -1.0))))


def _power(overlap: Any, constant: Any, exponent: Any) -> Any:
    return constant * np.maximum(overlap, 0.0) ** exponent[0]


def _power_stiffness(overlap: Any, constant: Any, exponent: Any) -> Any:
    return exponent[0] * constant * overlap ** (exponent[0] - 1)


def _power_curvature(overlap: Any, constant: Any, exponent: Any) -> Any:
    return (exponent[0] - 1) * exponent[0] * constant * overlap ** (exponent[0] - 2)


@cache
def power_law(exponent: float) -> PowerForce:
    """Return the power law with this exponent; the cache serves chains of equal exponents."""
    return PowerForce(exponent)


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
        law = law.with_constants(constant)
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
        law = self.law.of(numbers, self.constant.ndim)
        return Contacts(law, *(values[numbers] for values in self.arrays))

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
        # Most contacts of a struck chain do not close.
        meets = np.flatnonzero((inverse_mass > 0) & self.exists & (speed != 0))
        closing = self.of(meets)
        energy = speed[meets] ** 2 / (2 * inverse_mass[meets])
        overlap = np.zeros(speed.shape)
        overlap[meets] = closing.law.approach(energy, closing.constant)
        return overlap

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
