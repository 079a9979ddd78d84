"""The chain at rest: grains, walls, equilibrium, scales and band edge."""

from __future__ import annotations

from collections.abc import Iterator
from operator import index
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..util.arrays import Array, read_only
from ..util.cached import cached_property
from ..util.validation import NOT_GIVEN, Checked, OneOrMany, PositiveVector, Real, Vector, Whole
from . import walls
from .bounds import HARDEST, LEAST, Bounds, bounds
from .contacts import FEW, Contacts, dynamical_matrix, hertz_constant
from .impurities import Impurities, kinds, misfits, with_impurities
from .materials import GLASS, Material, OneMaterial, OneOrManyMaterials
from .picture import AtRest
from .plausible import HERTZ_OVERLAP, LARGEST_OVERLAP, least_squeezed, remarks, too_squeezed
from .recent import made_before


class Chain(AtRest, Checked):
    """A vertical column of grains that touch, numbered 1 to N from the top.

    Grain n obeys ``m_n z_n'' = K_(n-1) [o_(n-1)]^delta - K_n [o_n]^delta + m_n g`` (Eq. 1), [o] 0 below 0.

    Parameters
    ----------
    grains : int
        N; a single grain needs a wall.
    material : Material, name, or N of them
    diameter : float or (N,) array
        m.
    gravity : float
        m/s2; 0 for a horizontal chain.
    exponent : float
        delta, 1 (linear springs) to 3; 1.5 is Hertz.
    top_load : float
        Force that presses on grain 1 at rest, N: a constant one on a free top, or that of a wall.
    top, bottom : str
        top "free" or "wall"; bottom "fixed" (grain N is held), "wall" or "free" (only without gravity and load).
        Walls stand still; a wall at the top just touches grain 1 at rest unless there is a top load.
    masses : (N,) array, optional
        kg; instead of those that follow from material and diameter.
    contact_constants : (N-1,) array, optional
        K_n, N/m^delta; instead of ``(4/3) E* sqrt(R*) dbar^(1.5 - delta)``. The constant of a wall is then in the
        same proportion to that of the contact next to it as it would be without.
    impurity : list of Impurity, optional
        Grains that differ.
    top_material, bottom_material : Material or name, optional
        Of the walls; by default that of the grain which touches it, so that K_wall = sqrt(2) K.
    wall_constants : (top, bottom), optional
        N/m^delta, instead of those of the materials; 0 where there is no wall. One of ``2^delta K`` mirrors the chain.

    Raises
    ------
    InputError
        With every fault found.

    Examples
    --------
    >>> chain = Chain(grains=120, material=GLASS, diameter=1e-3)
    >>> f"{chain.length_scale:.5e} m"
    '6.94554e-10 m'
    >>> Chain(grains=20, material="steel", diameter=5e-3, top_load=10, top="wall", bottom="wall").movable
    20
    """

    grains: Annotated[Whole, Field(ge=1, le=10**8)]
    material: OneOrManyMaterials = GLASS
    diameter: OneOrMany
    gravity: Annotated[Real, Field(ge=0)] = 9.81
    exponent: Annotated[Real, Field(ge=1, le=3)] = 1.5
    top_load: Annotated[Real, Field(ge=0)] = 0.0
    top: Literal["free", "wall"] = "free"
    bottom: Literal["fixed", "wall", "free"] = "fixed"
    masses: PositiveVector = NOT_GIVEN
    contact_constants: PositiveVector = NOT_GIVEN
    impurity: Impurities = ()
    top_material: OneMaterial = NOT_GIVEN
    bottom_material: OneMaterial = NOT_GIVEN
    wall_constants: Vector = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        yield from (wrong := list(self._misfits()))
        if self.grains == 1 and (self.bottom == "fixed" or "wall" not in (self.top, self.bottom)):
            yield (
                "grains",
                'a single grain that is held, or touches nothing: use bottom = "wall", or more grains',
            )
        if self.bottom == "free" and (self.gravity > 0 or self.top_load > 0):
            yield (
                "bottom",
                'must be "fixed" or "wall" under gravity or a top load: a free chain would fall',
            )
        for key in (small := [key for key in LEAST if 0 < getattr(self, key) < LEAST[key]]):
            yield (
                key,
                f"must be 0, or at least {LEAST[key]:g} in SI units: below, squares of overlaps underflow",
            )
        if (
            wrong
            or small
            or ((known := self._leave_open().bounds) and known.squeezed <= LARGEST_OVERLAP)
        ):
            return
        weights = self.grains, self.top_load, self.gravity, self.exponent
        if self._alike and (least := least_squeezed(self._kinds, *weights)) > LARGEST_OVERLAP:
            yield "diameter", too_squeezed(f"a contact is compressed by at least {least:.2g}")
            return
        with np.errstate(all="ignore"):  # non-finite values are faults
            sound = (
                all((abs(part) < HARDEST).all() for part in self.dynamical_matrix())
                and (self.masses > 0).all()
            )
            relative = self.contacts.overlap / self.contact_lengths
        if not sound or np.isnan(relative).any():
            yield (
                "masses",
                "are too small or too large to compute with, or contacts too hard or too soft: use SI units",
            )
        elif relative.max() > LARGEST_OVERLAP:
            worst = int(relative.argmax())
            yield (
                "diameter",
                too_squeezed(f"contact {worst} is compressed by {relative[worst]:.2g}"),
            )

    def _remarks(self) -> Iterator[str]:
        plain = self.exponent != 1.5 or (self.bounds and self.bounds.squeezed <= HERTZ_OVERLAP)
        yield from remarks(
            self.diameter, 0.0 if plain else (self.contacts.overlap / self.contact_lengths).max()
        )

    def _misfits(self) -> Iterator[tuple[str, str]]:
        """Yield what does not fit together, so that no array can be filled in."""
        lengths = {
            "diameter": self.grains,
            "masses": self.grains,
            "contact_constants": self.grains - 1,
        }
        if isinstance(self.material, tuple) and len(self.material) != self.grains:
            yield (
                "material",
                f"must be one or {self.grains} (one a grain), not {len(self.material)}",
            )
        for key, length in lengths.items():
            if isinstance(value := getattr(self, key), np.ndarray) and len(value) != length:
                yield key, f"must have {length} entries for {self.grains} grains, not {len(value)}"
        yield from misfits(self.impurity, self.grains, self.contact_constants is not None)
        ends, made = (self.top, self.bottom), (self.top_material, self.bottom_material)
        yield from walls.misfits(ends, made, self.__dict__["wall_constants"])

    def _leave_open(self) -> Chain:
        """Leave masses and constants that were not given to be computed on first use."""
        for key in ("masses", "contact_constants", "wall_constants"):
            if self.__dict__[key] is None:
                del self.__dict__[key]
        if "masses" in self.__dict__ and self.impurity:
            self.__dict__["masses"] = read_only(with_impurities(self.masses, self.impurity, "mass"))
        return self

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Compute masses and constants from grains and walls on first use."""
            if name in ("masses", "contact_constants", "wall_constants") and self._twin:
                value = getattr(self._twin, name)
            elif name == "masses":
                alike = self.by_grain("density") * np.pi / 6 * self.diameters**3
                value = read_only(with_impurities(alike, self.impurity, "mass"))
            elif name == "contact_constants":
                value = self._hertz_constants[1:-1]
            elif name == "wall_constants":
                built = [self.top == "wall", self.bottom == "wall"]
                natural = (
                    walls.constants(self._hertz_constants, self.contact_constants)
                    if any(built)
                    else 0.0
                )
                value = read_only(np.multiply(built, natural))
            else:
                return super().__getattr__(name)
            self.__dict__[name] = value
            return value

    @property
    def _alike(self) -> bool:
        """Whether all grains are alike but for the impurities, so that no arrays are needed."""
        one = isinstance(self.diameter, float) and isinstance(self.material, Material)
        return one and not self.model_fields_set & {"masses", "contact_constants"}

    @cached_property
    def _twin(self) -> Chain | None:
        """A chain made before with the same fields, for its arrays; None, not itself, if there is none."""
        if (
            not self.bounds
            or self.impurity
            or self.top_material
            or self.bottom_material
            or self.grains > FEW
        ):
            return None
        kind, weights = self.material.elastic, (self.gravity, self.top_load, self.exponent)  # type: ignore[union-attr]
        first = made_before(
            (self.grains, *kind, self.diameter, *weights, self.top, self.bottom), self
        )
        return None if first is self else first

    @property
    def _kinds(self) -> Array:
        """Plane-strain modulus, diameter and mass of a common grain and of every impurity, (3, I+1)."""
        return kinds(self.material, self.diameter, self.impurity)

    @cached_property
    def bounds(self) -> Bounds | None:
        """Bounds on all grains and contacts; None where only arrays can tell."""
        if not self._alike or "wall_constants" in self.model_fields_set:
            return None
        built = [wall for wall in (self.top_material, self.bottom_material) if wall]
        kind, weights = (self.material, self.diameter), (self.top_load, self.gravity, self.exponent)
        return bounds(kind, self.grains, self.impurity, built, weights)  # type: ignore[arg-type]

    def by_grain(self, prop: str) -> Array:
        """Return a property of the material of every grain, (N,)."""
        values = np.empty(self.grains)
        alike = isinstance(self.material, Material)
        values[:] = (
            getattr(self.material, prop) if alike else [getattr(m, prop) for m in self.material]
        )
        for impurity in self.impurity:
            if impurity.material is not None:
                values[impurity.grain - 1] = getattr(impurity.material, prop)
        return values

    @cached_property
    def _hertz_constants(self) -> Array:
        """Hertz constants of all contacts, with a wall at either end, (N+1,) N/m^delta."""
        modulus, curvature = np.zeros((2, self.grains + 2))  # a wall is flat
        modulus[1:-1], curvature[1:-1] = self.by_grain("plane_strain_modulus"), 2 / self.diameters
        for at, here, wall in ((0, 1, self.top_material), (-1, -2, self.bottom_material)):
            modulus[at] = wall.plane_strain_modulus if wall else modulus[here]  # type: ignore[union-attr]
        length = 1.0 if self.exponent == 1.5 else self.contact_lengths
        return read_only(hertz_constant(modulus, curvature, length, self.exponent))

    @cached_property
    def contacts(self) -> Contacts:
        """All contacts, those with walls included."""
        if self._twin:
            return self._twin.contacts
        constants, force = np.empty((2, self.grains + 1))
        constants[[0, -1]], constants[1:-1] = self.wall_constants, self.contact_constants
        force[0], force[1:] = (
            self.top_load,
            self.top_load + self.gravity * self.masses.cumsum(dtype=np.longdouble),
        )
        return Contacts(
            read_only(constants), read_only(np.where(constants > 0, force, 0.0)), self.exponent
        )

    @cached_property
    def diameters(self) -> Array:
        """Diameter of every grain, (N,) m."""
        return read_only(
            with_impurities(np.full(self.grains, self.diameter), self.impurity, "diameter")
        )

    @cached_property
    def contact_lengths(self) -> Array:
        """Mean diameter of the two grains of every contact, at a wall that of the grain, (N+1,) m."""
        d = self.diameters
        return read_only(np.concatenate((d[:1], (d[:-1] + d[1:]) / 2, d[-1:])))

    @cached_property
    def depths(self) -> Array:
        """How far below grain 1 the centre of every grain rests, (N,) m."""
        return read_only(
            np.append(0.0, np.cumsum((self.contact_lengths - self.contacts.overlap)[1:-1]))
        )

    @property
    def equilibrium_force(self) -> Array:
        """Force that every contact between grains carries at rest, (N-1,) N."""
        return self.contacts.force[1:-1]

    @property
    def equilibrium_overlap(self) -> Array:
        """Overlap eps_n of every contact between grains at rest, (N-1,) m."""
        return self.contacts.overlap[1:-1]

    @property
    def linear_stiffness(self) -> Array:
        """Stiffness delta K_n eps_n^(delta-1) of every contact between grains at rest, (N-1,) N/m."""
        return self.contacts.stiffness[1:-1]

    @property
    def compressed(self) -> bool:
        """Whether contacts carry a force at rest; if not, the chain is a sonic vacuum."""
        return self.gravity > 0 or self.top_load > 0

    @property
    def movable(self) -> int:
        """Number of grains that move: N - 1 with a fixed bottom, N otherwise."""
        return self.grains - (self.bottom == "fixed")

    def part(self, first: int, last: int) -> Chain:
        """Return grains first ... last as a chain: the same motion until a wave reaches its ends.

        Grains above become a top load, and grain `last` is held unless the chain ends with it. Masses and constants are
        kept, and so are forces and overlaps if `first` is 1, else but for last bits. Many left out cost nothing.

        Raises
        ------
        InputError
            Unless there are such grains, two or more, or all there are.
        """
        if not 1 <= index(first) <= index(last) <= self.grains or (
            first == last and self.grains > 1
        ):
            raise InputError(
                [
                    (
                        "part",
                        f"must be two or more of grains 1 to {self.grains} (got {first} to {last})",
                    )
                ]
            )
        fields = self.given() | {"grains": int(last - first + 1)}
        for key, end in {
            "material": last,
            "diameter": last,
            "masses": last,
            "contact_constants": last - 1,
        }.items():
            if isinstance(fields.get(key), np.ndarray | tuple):
                fields[key] = fields[key][first - 1 : end]
        inside = [odd for odd in self.impurity if first <= odd.grain <= last]
        if self.impurity:
            fields["impurity"] = tuple(odd.replace(grain=odd.grain - first + 1) for odd in inside)
        if "wall_constants" in fields:
            fields["wall_constants"] = read_only(
                self.wall_constants * [first == 1, last == self.grains]
            )
        if first > 1:
            fields |= {"top": "free", "top_load": self._force_on(first)}
            fields.pop("top_material", None)
        if last < self.grains:
            fields["bottom"] = "fixed"
            fields.pop("bottom_material", None)
        made = Chain._unchecked(**fields)._leave_open()  # a part of a valid chain is valid
        if first == 1 and last < self.grains <= min(FEW, 8 * last):
            made.__dict__.update(contacts=self.contacts.above(last), masses=self.masses[:last])
        return made

    def _force_on(self, grain: int) -> float:
        """Return the force at rest on grain n > 1 from the grains above it, N."""
        if not self._alike:
            return float(self.contacts.force[grain - 1])
        mass = self._kinds[2].astype(np.longdouble)
        odd = [
            own - mass[0]
            for own, impurity in zip(mass[1:], self.impurity, strict=True)
            if impurity.grain < grain
        ]
        return float(self.top_load + self.gravity * ((grain - 1) * mass[0] + sum(odd)))

    def dynamical_matrix(self) -> tuple[Array, Array]:
        """Return the tridiagonal dynamical matrix D of the linearised chain, 1/s2.

        Its diagonal (M,) and off-diagonal (M-1,), with sqrt(m) phi'' = -D sqrt(m) phi.
        """
        return dynamical_matrix(self.contacts.stiffness, self.masses[: self.movable])

    @cached_property
    def band_edge(self) -> float:
        """Highest eigenfrequency of the linearised chain, rad/s (0 in the sonic vacuum)."""
        if self._twin:
            return self._twin.band_edge
        from .band_edge import band_edges

        return float(band_edges(*(elements[None] for elements in self.dynamical_matrix()))[0])

    @cached_property
    def load_over_mass(self) -> float:
        """Largest force at rest of the contact above a grain over the mass of the grain, m/s2."""
        return (
            self._twin.load_over_mass
            if self._twin
            else float((self.contacts.force[:-1] / self.masses).max())
        )

    @property
    def _first(self) -> int:
        """Number of the contact below grain 1, or of that above it if there is none below."""
        return int(self.contacts.exists[1])

    @property
    def length_scale(self) -> float:
        """Overlap eps_1 of the contact below grain 1 at rest, m."""
        return float(self.contacts.overlap[self._first])

    @property
    def time_scale(self) -> float:
        """Unit of the paper's tau, sqrt(m_1 / k_1), s (infinite in the sonic vacuum)."""
        k = float(self.contacts.stiffness[self._first])
        return float(np.sqrt(self.masses[0] / k)) if k > 0 else np.inf

    def excess_energy(
        self, displacement: Array, velocity: Array, wall: Array | None = None
    ) -> Array:
        """Energy (...) above that of the chain at rest: kinetic, contacts, load and weight, J.

        It is conserved by Eq. (1) and zero at rest; weak waves keep their relative accuracy.

        Parameters
        ----------
        displacement, velocity : (..., N) arrays
            m, positive downward; m/s.
        wall : (...) array, optional
            Displacement of the top wall, m; by default 0.
        """
        kinetic = 0.5 * (self.masses * velocity**2).sum(-1)
        if wall is None and not np.any(displacement):
            return kinetic
        return kinetic + self.contacts.energy(Contacts.closer(displacement, wall)).sum(-1)
