"""The contact law: Hertz's constants, and force, overlap, stiffness and energy of contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import Array, read_only
from ..util.cached import cached_property

# how far contacts give way: without stiffness at rest, which bounds nothing, in m/J^(1/2); and where none counts
LOOSE, STIFF = 1e100, 1e-300
FEW = 10**4  # grains of a chain, of which all contacts are known sooner than those of some parts


def hertz_constant(
    modulus: Array, curvature: Array, length: Array | float, exponent: float
) -> Array:
    """Return K = (4/3) E* sqrt(R*) length^(1.5 - delta) of neighbours in a row of B bodies.

    Parameters
    ----------
    modulus : (..., B) array
        E / (1 - nu^2) of each, Pa.
    curvature : (..., B) array
        1 / radius of each, 1/m; 0 for a plane.
    length : (..., B-1) array
        Mean diameter, m, which keeps the unit of a force for exponents other than Hertz's.
    exponent : float

    Returns
    -------
    (..., B-1) array
        N/m^delta.
    """
    together = 1 / (1 / modulus[..., :-1] + 1 / modulus[..., 1:])
    radius = 1 / (curvature[..., :-1] + curvature[..., 1:])
    return 4 / 3 * together * np.sqrt(radius) * length ** (1.5 - exponent)


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
    """All contacts of a chain of N grains, walls included.

    Contact n lies between grains n and n + 1; contact 0 between grain 1 and a wall above it, contact N between
    grain N and a wall below it. Where there is no wall the constant is 0, and so is everything else.

    Parameters
    ----------
    constant : (N+1,) array
        K_n, N/m^delta.
    force : (N+1,) array
        Force of each contact at rest, N.
    exponent : float
        delta.
    """

    constant: Array
    force: Array
    exponent: float

    @cached_property
    def exists(self) -> NDArray[np.bool_]:
        """Whether there are two bodies, (N+1,) bool."""
        return read_only(self.constant > 0)

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """Whether the contact is compressed at rest, (N+1,) bool."""
        return read_only(self.force > 0)

    @cached_property
    def overlap(self) -> Array:
        """Overlap eps_n at rest, (N+1,) m."""
        return read_only(
            (self.force / np.where(self.exists, self.constant, 1.0)) ** (1 / self.exponent)
        )

    @cached_property
    def stiffness(self) -> Array:
        """Linear stiffness delta K_n eps_n^(delta-1) at rest, (N+1,) N/m."""
        return read_only(self.stiffness_at(self.overlap))

    @cached_property
    def _as_row(self) -> Contacts:
        return _rows([self])

    def of(self, numbers: int | np.integer | slice | NDArray[np.intp]) -> Contacts:
        """Return these contacts alone."""
        return Contacts(self.constant[numbers], self.force[numbers], self.exponent)

    def above(self, grain: int) -> Contacts:
        """Return the contacts above a grain that is held from now on."""
        constant, force = (
            read_only(np.append(x[:grain], 0.0)) for x in (self.constant, self.force)
        )
        return Contacts(constant, force, self.exponent)

    def force_at(self, overlap: Array) -> Array:
        """Return the force K o^delta of contacts with the overlap o, 0 where they are open, (..., N+1) N."""
        return self.constant * np.maximum(overlap, 0.0) ** self.exponent

    def stiffness_at(self, overlap: Array) -> Array:
        """Return the stiffness delta K o^(delta-1) of contacts with the overlap o >= 0, (..., N+1) N/m."""
        return self.exponent * self.constant * overlap ** (self.exponent - 1)

    @staticmethod
    def closer(displacement: Array, wall: Array | None = None) -> Array:
        """Return how much every overlap exceeds that at rest, (..., N+1) m; the top wall is at (...) m."""
        u = np.asarray(displacement)
        closer = np.empty((*u.shape[:-1], u.shape[-1] + 1))
        closer[..., 0], closer[..., -1] = 0.0 if wall is None else wall, u[..., -1]
        closer[..., 0] -= u[..., 0]
        np.subtract(u[..., :-1], u[..., 1:], out=closer[..., 1:-1])
        return closer

    def force_change(self, r: Array) -> Array:
        """Return the change of force for a change r of the overlap, (..., N+1) N.

        The relative accuracy does not depend on the amplitude of the wave.
        """
        s = r / np.where(self.pressed, self.overlap, np.inf)
        held = np.where(s > -1, np.expm1(self.exponent * np.log1p(np.where(s > -1, s, 0.0))), -1.0)
        return np.where(self.pressed, self.force * held, self.force_at(r))

    def energy(self, r: Array) -> Array:
        """Return the contact energy above that at rest, (..., N+1) J, for a change r of the overlap.

        It is the integral of K [eps + r]^delta - K eps^delta over r, accurate in relative terms for the weakest waves.
        """
        if (
            np.ndim(r) == 2 and not (moves := r.any(axis=0)).all()
        ):  # most of a long chain rests; powers cost time
            held = np.zeros(r.shape)
            held[:, moves] = self.of(np.flatnonzero(moves)).energy(r[:, moves])
            return held
        power = self.exponent + 1
        loose = self.constant / power * np.maximum(r, 0.0) ** power
        s = r / np.where(self.pressed, self.overlap, 1.0)
        y = np.log1p(np.where(s > -1, s, 0.0))
        exact = np.where(s > -1, np.expm1(power * y), -1.0) / power - s
        # the two terms cancel for small s: sum the binomial series instead
        series = np.zeros_like(s)
        for k in range(11, 1, -1):
            series = (power - k + 1) / k * s * (1 + series)
        scaled = np.where(np.abs(s) < 0.02, s * series, exact)
        return np.where(self.pressed, self.force * self.overlap * scaled, loose)

    def collision_overlap(self, speed: Array, inverse_mass: Array) -> Array:
        """Return the largest overlap, m, of two bodies that meet alone at a speed, (N+1,) m/s.

        The sum of their inverse masses is (N+1,) 1/kg; where it is 0 nothing meets.
        """
        power, stiff = self.exponent + 1, inverse_mass * self.constant
        return (power / 2 * speed**2 / np.where(stiff > 0, stiff, np.inf)) ** (1 / power)

    def squeezed_by(self, force: float) -> float:
        """Return how much closer this force more brings the two bodies of one contact, m."""
        if self.pressed:
            return float(self.overlap * np.expm1(np.log1p(force / self.force) / self.exponent))
        return float((force / self.constant) ** (1 / self.exponent))

    @property
    def elastic_share(self) -> float:
        """Mean share of the energy that the contacts of an uncompressed chain hold (virial theorem)."""
        return 2 / (self.exponent + 3)

    def constant_for_stiffness(self, factor: Array) -> Array:
        """Return the factor on constants for a factor on stiffnesses at rest, under the same forces."""
        return factor**self.exponent

    def stiffness_for_force(self, factor: Array) -> Array:
        """Return by what factor stiffnesses at rest change if the forces at rest change by this one."""
        return factor ** (1 - 1 / self.exponent)

    def overlap_bound(self, energy: float | Array) -> Array:
        """Return an upper bound of each overlap for this energy above rest, (N+1,) m.

        The bound is rigorous: no contact can hold more than the whole conserved energy, and the energy of
        one is at least ``K r^(delta+1) / (delta+1)`` and at least ``k_n r^2 / 2``.
        """
        if np.equal(energy, np.inf).any():
            known = np.isfinite(energy)
            return np.where(
                known,
                self.overlap_bound(np.where(known, energy, 0.0)),
                np.where(self.exists, np.inf, 0.0),
            )
        return self.overlap + self._given_way(energy, *self._softness)

    def largest_strain(self, energy: float | Array) -> Array:
        """Return `Scene.largest_strain`, (...), for this energy above rest; (..., 1) J of many chains."""
        if not self._all_pressed:
            return np.full(self.constant.shape[:-1], np.inf)
        softer = 1.05  # a contact that opens
        if self._softest:
            return softer * self._given_way(energy, *self._softest, least=min)
        return softer * np.maximum.reduce(
            self._given_way(energy, *self._relative_softness), axis=-1
        )

    def _given_way(
        self, energy: Any, loose: Any, pressed: Any, least: Callable[..., Any] = np.minimum
    ) -> Any:
        """Return by how much contacts of these softnesses give way at most, (..., N+1)."""
        return least(energy ** (1 / (self.exponent + 1)) * loose, energy**0.5 * pressed)

    @cached_property
    def _all_pressed(self) -> bool:
        return bool((self.pressed == self.exists).all())

    @cached_property
    def _softness(self) -> tuple[Array, Array]:
        """How far contacts give way for 1 J, two bounds, (N+1,) each.

        The first goes as the energy to the power 1 / (delta + 1) and is 0 if there is no contact, the second as its
        root, and is `LOOSE` if the contact is not pressed.
        """
        power, shape = self.exponent + 1, self.constant.shape
        loose = np.divide(power, self.constant, out=np.zeros(shape), where=self.exists) ** (
            1 / power
        )
        return loose, np.sqrt(
            np.divide(2.0, self.stiffness, out=np.full(shape, LOOSE**2), where=self.pressed)
        )

    @cached_property
    def _relative_softness(self) -> tuple[Array, Array]:
        """The same over the overlap at rest; `STIFF` if it is not pressed."""
        rest = np.where(self.pressed, self.overlap, 1 / STIFF)
        loose, pressed = (np.maximum(softness / rest, STIFF) for softness in self._softness)
        return loose, pressed

    @cached_property
    def _softest(self) -> tuple[float, float] | None:
        """These two of the contact of one chain that gives way most whatever the energy is, if there is one."""
        loose, pressed = self._relative_softness
        n = loose.argmax()
        return (
            (float(loose[n]), float(pressed[n]))
            if loose.ndim == 1 and pressed[n] == pressed.max()
            else None
        )


def together(contacts: Sequence[Contacts]) -> Contacts:
    """Return the contacts of R chains of one length as those of all, (R, N+1), for compiled loops."""
    return contacts[0]._as_row if len(contacts) == 1 else _rows(contacts)


def _rows(contacts: Sequence[Contacts]) -> Contacts:
    names = "constant", "force", "overlap", "stiffness"
    rows = {name: np.array([getattr(each, name) for each in contacts]) for name in names}
    made = Contacts(rows["constant"], rows["force"], contacts[0].exponent)
    made.__dict__.update(rows)
    return made
