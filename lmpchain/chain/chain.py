"""The chain at rest: grains, walls, equilibrium, scales and band edge."""

from __future__ import annotations

from collections.abc import Iterator
from operator import index
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..util.arrays import Array, read_only
from ..util.lazy import cached_property
from ..util.tables import counted
from ..util.validation import (
    NOT_GIVEN,
    Checked,
    OneOrMany,
    PositiveVector,
    Real,
    Vector,
    Whole,
    make_unchecked,
    with_derived,
)
from . import ground
from .bounds import LIMITS, Bounds, bounds, least_compression, remarks, too_compressed
from .contact_law import FEW_GRAINS, ContactLaw, Contacts, power_law
from .damping import NO_DAMPING, OneDamping
from .equilibrium import Equilibrium, derive_chain
from .law import Law, OneLaw
from .materials import (
    GLASS,
    Impurities,
    Impurity,
    Kinds,
    Material,
    OneMaterial,
    OneOrManyMaterials,
    kinds,
    misfits,
    with_impurities,
)
from .picture import ChainPicture


class Chain(ChainPicture, Checked):
    """A vertical column of grains that touch, numbered 1 to N from the top.

    Grain n obeys ``m_n z_n'' = K_(n-1) [o_(n-1)]^delta - K_n [o_n]^delta + m_n g`` (Eq. 1), with
    [o] = 0 for o < 0. A law given by a formula replaces the powers.

    Parameters
    ----------
    grains : int
        Number of grains N; a single grain needs a wall.
    material : Material, name, or N of them
        Material of all grains, or one for each grain.
    diameter : float or (N,) array
        Diameter of all grains or of each grain, m.
    gravity : float
        Acceleration of gravity, m/s2; 0 for a horizontal chain.
    exponent : float
        Exponent delta of the contact force, from 1 (linear springs) to 3; 1.5 is Hertz's law.
    law : Law, or dict, optional
        Contact force as a formula, instead of an exponent. A dict is the table of a scene file.
    ground : Law, or dict, optional
        Force ``F(u, t)`` that pulls every grain back, as a function of its displacement u from
        rest, m, and the time t, s: ``m phi'' = ... - F(phi, t)``.
    top_load : float
        Force that presses on grain 1 at rest, N. It is constant at a free top; at a wall, the wall
        exerts it.
    load_grain : int
        Number of the grain that the top load acts on, from 1 to the last grain that moves. The
        grains above it carry only their weight: without gravity they only touch, and grain 1 is a
        striker. If it is not 1, a top wall exerts no force at rest, and the load is constant.
    top, bottom : str
        Kind of the top end, "free" or "wall"; kind of the bottom end, "fixed" (grain N is held),
        "wall", or "free" (only without gravity and load). Walls stand still. A top wall without a
        top load just touches grain 1 at rest.
    masses : (N,) array, optional
        Masses of the grains, kg; by default they follow from material and diameter.
    contact_constants : (N-1,) array, optional
        Contact constants K_n, N/m^delta; by default ``(4/3) E* sqrt(R*) dbar^(1.5 - delta)``. The
        constant of a wall is scaled by the same factor as that of the adjacent contact.
    impurity : list of Impurity, optional
        Grains that differ from the others.
    top_material, bottom_material : Material or name, optional
        Materials of the walls; by default a wall has the material of the grain that touches it, so
        that K_wall = sqrt(2) K.
    wall_constants : (top, bottom), optional
        Contact constants of the walls, N/m^delta, 0 without a wall; by default they follow from the
        materials. A wall with the constant ``2^delta K`` acts as a mirror of the chain.
    damping : Damping or dict, optional
        Viscosity of the contacts, s, and drag on the grains, 1/s. By default there is no damping,
        and energy is conserved.

    Raises
    ------
    InputError
        With all faults found.

    Examples
    --------
    >>> chain = Chain(grains=120, material=GLASS, diameter=1e-3)
    >>> f"{chain.length_scale:.5e} m"
    '6.94554e-10 m'
    >>> Chain(grains=20, material="steel", diameter=5e-3, top_load=10, top="wall").movable
    19
    """

    elsewhere: ClassVar[dict[str, str]] = {
        "cell": "use lmpchain.patterns.repeated, or a scene file",
        "taper": "use lmpchain.patterns.tapered or repeated, or a scene file",
    }

    grains: Annotated[Whole, Field(ge=1, le=10**8)]
    material: OneOrManyMaterials = GLASS
    diameter: OneOrMany
    gravity: Annotated[Real, Field(ge=0)] = 9.81
    given_exponent: Annotated[Real, Field(ge=1, le=3)] = Field(1.5, alias="exponent")
    given_law: OneLaw = Field(NOT_GIVEN, alias="law")
    given_ground: OneLaw = Field(NOT_GIVEN, alias="ground")
    top_load: Annotated[Real, Field(ge=0)] = 0.0
    load_grain: Annotated[Whole, Field(ge=1)] = 1
    top: Literal["free", "wall"] = "free"
    bottom: Literal["fixed", "wall", "free"] = "fixed"
    given_masses: PositiveVector = Field(NOT_GIVEN, alias="masses")
    given_contact_constants: PositiveVector = Field(NOT_GIVEN, alias="contact_constants")
    impurity: Impurities = ()
    top_material: OneMaterial = NOT_GIVEN
    bottom_material: OneMaterial = NOT_GIVEN
    given_wall_constants: Vector = Field(NOT_GIVEN, alias="wall_constants")
    damping: OneDamping = NO_DAMPING

    def _faults(self) -> Iterator[tuple[str, str]]:
        faults = [*self._misfits(), *self._falls(), *self._tiny_forces()]
        yield from faults
        # Arrays can be derived only if the numbers fit together.
        if not faults:
            yield from self._extremes()

    def _falls(self) -> Iterator[tuple[str, str]]:
        """Yield faults of chains in which a grain would fall or has no contact."""
        if self.grains == 1 and (self.bottom == "fixed" or "wall" not in (self.top, self.bottom)):
            cure = 'use bottom = "wall", or more grains'
            yield "grains", f"a single grain must move and touch a wall: {cure}"
        if self.bottom == "free" and (self.gravity > 0 or self.top_load > 0):
            cure = "a free chain would fall"
            yield "bottom", f'must be "fixed" or "wall" under gravity or a top load: {cure}'
        if self.load_grain > self.movable:
            held = ", and the last one is held" if self.bottom == "fixed" else ""
            cure = f"at most {self.movable} of {counted(self.grains, 'grain')}{held}"
            yield "load_grain", f"must be a grain that the load can press, {cure}"

    def _tiny_forces(self) -> Iterator[tuple[str, str]]:
        """Yield forces that are so small that their squares underflow."""
        for key in ("gravity", "top_load"):
            if 0 < getattr(self, key) < LIMITS.least_force:
                bound = f"must be 0, or at least {LIMITS.least_force:g} in SI units"
                yield key, f"{bound}, because squares of smaller overlaps underflow"

    def _extremes(self) -> Iterator[tuple[str, str]]:
        """Yield properties outside the floating-point range, and extreme compressions."""
        if self.bounds and self.bounds.compression <= LIMITS.compression:
            return
        # This check comes before gigabytes of arrays are derived for an impossible column.
        if self._kinds:
            # This bound ignores a load that acts below grain 1.
            load = self.top_load if self.load_grain == 1 else 0.0
            weights = (load, self.gravity, self.law)
            bound = least_compression(self._kinds, self.grains, *weights)
            if bound > LIMITS.compression:
                contact = f"a contact is compressed by at least {bound:.2g}"
                yield "diameter", too_compressed(contact)
                return
        # Numbers that overflow are reported as faults below.
        with np.errstate(all="ignore"):
            computable = self.equilibrium.computable(self.movable)
            compression = self.equilibrium.compression
        if isinstance(self.law, Law) and np.isinf(self.contacts.stiffness).any():
            cure = "press the contacts by gravity or a load"
            yield "law", f"is infinitely stiff where contacts only touch: {cure}"
        elif not computable:
            cure = "or contacts are too hard or too soft: use SI units"
            yield "masses", f"are too small or too large to compute with, {cure}"
        elif compression.max() > LIMITS.compression:
            worst = int(compression.argmax())
            contact = f"contact {worst} is compressed by {compression[worst]:.2g}"
            yield "diameter", too_compressed(contact)

    def _remarks(self) -> Iterator[str]:
        # Bounds are cheap; arrays are derived only if the bounds do not decide.
        compression = 0.0
        if self.law.power == 1.5 and not (
            self.bounds and self.bounds.compression <= LIMITS.hertz_compression
        ):
            compression = float(self.equilibrium.compression.max())
        yield from remarks(self.diameter, compression)

    def _misfits(self) -> Iterator[tuple[str, str]]:
        """Yield arguments whose lengths or kinds contradict each other."""
        lengths = {
            "diameter": (self.diameter, self.grains),
            "masses": (self.given_masses, self.grains),
            "contact_constants": (self.given_contact_constants, self.grains - 1),
        }
        if isinstance(self.material, tuple) and len(self.material) != self.grains:
            number = f"not {len(self.material)}"
            yield "material", f"must be one or {self.grains} (one per grain), {number}"
        for key, (value, length) in lengths.items():
            if isinstance(value, np.ndarray) and len(value) != length:
                yield key, f"must have {length} entries for {self.grains} grains, not {len(value)}"
        if self.given_law and "given_exponent" in self.model_fields_set:
            yield "law", "takes the place of an exponent: give one of them"
        yield from self._misfits_of_law()
        if self.given_ground is not None:
            yield from ground.misfits(self.given_ground, self.grains)
        yield from misfits(self.impurity, self.grains, self.given_contact_constants is not None)
        yield from self.damping.misfits(self.grains)
        yield from self._misfits_of_walls()

    def _misfits_of_law(self) -> Iterator[tuple[str, str]]:
        """Yield parameters of a law that do not fit the contacts."""
        law = self.given_law
        if not isinstance(law, Law):
            return
        if law.of_ground:
            yield "law.force", "depends on u or t: a contact law may only depend on the overlap o"
        if law.onset == 0:
            yield "law.force", "has a jump: replace it by a ramp of finite width"
        if "k" in law.given and self.given_contact_constants is not None:
            yield "contact_constants", "are also given by law.k: give one of them"
        for key, value in law.given.items():
            if isinstance(value, tuple) and len(value) != self.grains - 1:
                count = f"one number, or {self.grains - 1} for {self.grains} grains"
                yield f"law.{key}", f"must be {count}, not {len(value)}"

    def _misfits_of_walls(self) -> Iterator[tuple[str, str]]:
        """Yield materials and constants of walls that do not fit the ends of the chain."""
        ends = (self.top, self.bottom)
        materials = (self.top_material, self.bottom_material)
        constants = self.given_wall_constants
        for name, end, material in zip(("top", "bottom"), ends, materials, strict=True):
            if material is not None and end != "wall":
                yield (
                    f"{name}_material",
                    f'describes a wall, but there is none unless {name} = "wall"',
                )
        if constants is None:
            return
        if len(constants) != 2 or any(
            k < 0 or (k > 0) != (end == "wall") for k, end in zip(constants, ends, strict=True)
        ):
            fault = 'above 0 if the end is "wall", otherwise 0'
            yield "wall_constants", f"must be two numbers, for top and bottom: {fault}"
        elif any(material is not None for material in materials):
            fault = "replace the materials of the walls: leave one of them out"
            yield "wall_constants", fault

    @cached_property
    def _kinds(self) -> Kinds | None:
        """The few kinds of grains of a chain without listed grains; None if grains are listed."""
        if (
            isinstance(self.diameter, float)
            and isinstance(self.material, Material)
            and self.given_masses is None
            and self.given_contact_constants is None
        ):
            return kinds(self.material, self.diameter, self.impurity)
        return None

    @cached_property
    def bounds(self) -> Bounds | None:
        """Bounds on all grains and contacts; None if they would require arrays."""
        if self._kinds is None or self.given_wall_constants is not None:
            return None
        # For other laws, only arrays show how the force grows with the constant.
        if self.law.power is None:
            return None
        planes: list[Any] = [wall for wall in (self.top_material, self.bottom_material) if wall]
        weights = (self.top_load, self.gravity, self.law)
        return bounds(self._kinds, self.grains, planes, *weights)

    def by_grain(self, prop: str) -> Array:
        """Return a property of the material of every grain, (N,)."""
        return np.full(self.grains, self.of_material(prop))

    def of_material(self, prop: str, drawn: Array | None = None) -> Array:
        """Return a property of the grains' materials, (..., N), or (1,) if all grains share it.

        Drawn values, (..., N), replace the values of all grains except impurities.
        """
        values: Any = drawn
        if drawn is None and isinstance(self.material, Material):
            values = np.array([getattr(self.material, prop)])
        elif drawn is None:
            values = np.array([getattr(material, prop) for material in self.material])

        def own(impurity: Impurity) -> float | None:
            return None if impurity.material is None else getattr(impurity.material, prop)

        return with_impurities(values, self.impurity, own, self.grains)

    @cached_property
    def law(self) -> ContactLaw:
        """The force of a contact as a function of its overlap."""
        law = self.given_law or power_law(self.given_exponent)
        # Power laws have a faster and more accurate implementation.
        return power_law(law.as_exponent) if isinstance(law, Law) and law.as_exponent else law

    @property
    def contact_law(self) -> ContactLaw:
        """The law with the parameters and constants of all contacts, walls included."""
        # The contacts of a power law are not derived for this.
        return self.contacts.law if isinstance(self.law, Law) else self.law

    @property
    def strongest_when_closest(self) -> bool:
        """Whether the force of every contact is largest when its grains are closest."""
        return self.damping.longest_time == 0 and self.contact_law.grows

    @property
    def ground(self) -> Law | None:
        """The force from the ground on every grain, or None."""
        return self.given_ground  # type: ignore[return-value]

    @cached_property
    def ground_stiffness(self) -> Array:
        """Stiffness of the ground under every grain at rest, at t = 0, (N,) N/m."""
        stiffness = self.ground.stiffness(0.0, 0.0) if self.ground else 0.0
        return read_only(np.array(np.broadcast_to(stiffness, self.grains), float))

    @property
    def ground_in_time(self) -> bool:
        """Whether the force from the ground depends on the time."""
        return self.ground is not None and "t" in self.ground.formula.names

    def refuse_ground_without_modes(self, what: str) -> None:
        """Raise `InputError` if the force from the ground bends at rest or depends on the time."""
        if self.ground is not None and (self.ground.kinks(0.0) == 0).any():
            cure = "use a native run"
            raise InputError.at("chain.ground", f"{what} does not support a kink at rest: {cure}")
        self.refuse_moving_ground(what)

    def refuse_moving_ground(self, what: str) -> None:
        """Raise `InputError` if the force from the ground depends on the time."""
        if self.ground_in_time:
            cure = "leave t out of its formula"
            raise InputError.at(
                "chain.ground", f"{what} does not support a stiffness that changes in time: {cure}"
            )

    def refuse_ground(self, what: str) -> None:
        """Raise `InputError` if the ground exerts a force, which `what` does not support."""
        if self.ground is not None:
            cure = "leave it out, as chain.replace(ground=None) does"
            raise InputError.at(
                "chain.ground", f"{what} does not support a force from the ground: {cure}"
            )

    @property
    def exponent(self) -> float:
        """The exponent delta of a power law; raises `InputError` for other laws."""
        return self.law.power_of("an exponent")

    def _compared(self) -> list[str]:
        # The law already contains the exponent.
        return [key for key in self.arguments if key != "exponent"]

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Masses, diameters and contacts of the chain at rest."""
        return derive_chain(self)

    @property
    def contacts(self) -> Contacts:
        """All contacts of the chain, including those with walls."""
        return self.equilibrium.contacts

    @property
    def masses(self) -> Array:
        """Mass of every grain, (N,) kg."""
        return self.equilibrium.masses

    @property
    def diameters(self) -> Array:
        """Diameter of every grain, (N,) m."""
        return self.equilibrium.diameters

    @property
    def contact_lengths(self) -> Array:
        """Mean diameter of the two grains of each contact, (N+1,) m; at walls, of one grain."""
        return self.equilibrium.contact_lengths

    @property
    def contact_constants(self) -> Array:
        """Constant K_n of every contact between grains, (N-1,) N/m^delta."""
        return self.contacts.constant[1:-1]

    @cached_property
    def wall_constants(self) -> Array:
        """Constants of the contacts with top and bottom wall, (2,) N/m^delta, 0 without a wall."""
        return read_only(self.contacts.constant[[0, -1]])

    @cached_property
    def depths(self) -> Array:
        """Depth of every grain's centre below the centre of grain 1 at rest, (N,) m."""
        # Distances between centres: mean diameters minus overlaps, without the walls.
        distances = (self.contact_lengths - self.contacts.overlap)[1:-1]
        return read_only(np.append(0.0, np.cumsum(distances)))

    @property
    def equilibrium_force(self) -> Array:
        """Force of every contact between grains at rest, (N-1,) N."""
        return self.contacts.force[1:-1]

    @property
    def equilibrium_overlap(self) -> Array:
        """Overlap eps_n of every contact between grains at rest, (N-1,) m."""
        return self.contacts.overlap[1:-1]

    @property
    def linear_stiffness(self) -> Array:
        """Stiffness between grains at rest, (N-1,) N/m; delta K_n eps_n^(delta-1) for a power."""
        return self.contacts.stiffness[1:-1]

    @cached_property
    def compressed(self) -> bool:
        """Whether contacts are stiff at rest, by a force or a bond; False in a sonic vacuum."""
        return self.gravity > 0 or self.top_load > 0 or self.contact_law.bonds

    @cached_property
    def loose_grains(self) -> int:
        """Number of grains above the load that only touch, without weight; 0 if there are none."""
        if self.contact_law.bonds:
            return 0
        return self.load_grain - 1 if self.top_load > 0 and self.gravity == 0 else 0

    @property
    def linearisable(self) -> bool:
        """Whether every moving grain is pressed at rest, so that weak waves are linear."""
        return self.compressed and not self.loose_grains

    def refuse_loose(self, what: str) -> None:
        """Raise `InputError` if grains only touch, because `what` is a linear theory."""
        if self.loose_grains:
            raise InputError.at("chain.load_grain", f"{what} is linear, and {self.loose}")

    @property
    def loose(self) -> str:
        """The reason why grains that only touch have no linear motion, and the remedy."""
        if self.loose_grains == 1:
            return "grain 1 only touches grain 2: let the load act on grain 1"
        last = self.loose_grains
        return f"grains 1 to {last} only touch: let the load act on grain 1"

    @property
    def wall_load(self) -> float:
        """Force of the top wall on grain 1 at rest, N; 0 without a wall or without a load."""
        return self.top_load if self.top == "wall" and self.load_grain == 1 else 0.0

    @property
    def constant_load(self) -> float:
        """Constant force on the loaded grain, N; 0 if a wall exerts the load instead."""
        return self.top_load - self.wall_load

    @cached_property
    def damped(self) -> bool:
        """Whether contacts or a drag dissipate energy."""
        return self.damping.acts

    @property
    def conservative(self) -> bool:
        """Whether only contacts and weight accelerate the grains, without damping or a ground."""
        return not self.damped and self.ground is None

    def refuse_damping(self, what: str) -> None:
        """Raise `InputError` if the chain has damping, which `what` does not support."""
        if self.damped:
            cure = "leave it out, as chain.replace(damping=None) does"
            raise InputError.at("chain.damping", f"{what} does not support damping: {cure}")

    @cached_property
    def contact_viscosity(self) -> Array:
        """Relaxation time A of every contact, walls included, (N+1,) s; 0 without damping."""
        return self.damping.times(self.grains)

    @cached_property
    def drag(self) -> Array:
        """Drag rate gamma of every grain, (N,) 1/s; 0 without damping."""
        return self.damping.rates(self.grains)

    @cached_property
    def movable(self) -> int:
        """Number of grains that move: N - 1 with a fixed bottom, N otherwise."""
        return self.grains - (self.bottom == "fixed")

    @property
    def held_weight(self) -> float:
        """Weight of grain N if the bottom is fixed, N; 0 otherwise."""
        return float(self.masses[-1] * self.gravity) if self.bottom == "fixed" else 0.0

    def part(self, first: int, last: int) -> Chain:
        """Return grains first ... last as a chain that moves equally until a wave reaches its ends.

        The weight of the grains above becomes a load on grain `first`. Grain `last` is held unless
        it is the last grain of the chain. Masses and contact constants do not change. Forces and
        overlaps at rest do not change if `first` is 1; otherwise they differ by rounding errors.

        Raises
        ------
        InputError
            If there are no such grains, if the part is a single grain of a longer chain, or if the
            part would have two loads.
        """
        self._check_part(first, last)
        fields = self.given() | {"grains": int(last - first + 1)}
        for key in ("material", "diameter", "masses", "contact_constants"):
            if isinstance(fields.get(key), np.ndarray | tuple):
                end = last - (key == "contact_constants")
                fields[key] = fields[key][first - 1 : end]
        if isinstance(self.given_law, Law):
            fields["law"] = self.given_law.part(first, last)
        if self.ground is not None:
            fields["ground"] = self.ground.part(first, last)
        if self.impurity:
            fields["impurity"] = tuple(
                impurity.replace(grain=impurity.grain - first + 1)
                for impurity in self.impurity
                if first <= impurity.grain <= last
            )
        # A wall that is not in the part has no constant.
        if "wall_constants" in fields:
            outer = [first == 1, last == self.grains]
            fields["wall_constants"] = read_only(self.wall_constants * outer)
        if self.damped:
            fields["damping"] = self.damping.part(first, last)
        if first > 1:
            fields["top"] = "free"
            fields.pop("top_material", None)
        fields |= self._load_of(first, last)
        if last < self.grains:
            fields["bottom"] = "fixed"
            fields.pop("bottom_material", None)
        # A part of a valid chain is valid.
        piece = make_unchecked(Chain, **fields)
        # The contacts of the whole chain are reused, because a second derivation would take as long
        # as a short run.
        if first == 1 and last < self.grains <= min(FEW_GRAINS, 8 * last):
            return with_derived(piece, equilibrium=self.equilibrium.above(last))
        return piece

    def _check_part(self, first: int, last: int) -> None:
        """Raise `InputError` unless these grains can form a chain."""
        if not 1 <= index(first) <= index(last) <= self.grains or (
            first == last and self.grains > 1
        ):
            grains = f"two or more of grains 1 to {self.grains} (got {first} to {last})"
            raise InputError.at("part", f"must be {grains}")
        if first != self.first_of_part(first):
            cure = f"begin with grain 1, or with grain {self.load_grain} or a later one"
            fault = "would have two loads, the weight of the grains above it and the top load"
            raise InputError.at("part", f"{fault}: {cure}")

    def first_of_part(self, grain: int) -> int:
        """Return the first grain of the smallest allowed part that contains this grain.

        Under gravity, a part that begins between grain 1 and the loaded grain would have two loads:
        the weight of the grains above it and the top load.
        """
        two_loads = self.gravity > 0 and self.top_load > 0 and grain < self.load_grain
        return 1 if two_loads else grain

    def _load_of(self, first: int, last: int) -> dict[str, Any]:
        """Return the load of the chain that `part` returns, and the loaded grain."""
        loaded = self.load_grain - first + 1
        # The weight of the grains above acts as a constant load.
        if first > 1 and (loaded <= 1 or self.top_load == 0):
            return {"top_load": self._force_on(first), "load_grain": 1}
        moves = self.load_grain <= last - (last < self.grains)
        if not moves:
            return {"top_load": 0.0, "load_grain": 1}
        return {"load_grain": loaded} if loaded != self.load_grain else {}

    def _force_on(self, grain: int) -> float:
        """Return the force at rest on grain n > 1 from the grains above it, and the load on it."""
        if self._kinds is None:
            load = self.top_load if grain == self.load_grain else 0.0
            return float(self.contacts.force[grain - 1]) + load
        # Long doubles, like the weights in `derive_chain`.
        common, *impure = np.array(self._kinds.masses, dtype=np.longdouble)
        excess = [
            mass - common
            for mass, impurity in zip(impure, self.impurity, strict=True)
            if impurity.grain < grain
        ]
        return float(self.top_load + self.gravity * ((grain - 1) * common + sum(excess)))

    def dynamical_matrix(self) -> tuple[Array, Array]:
        """Return the tridiagonal dynamical matrix D of the linearised chain, 1/s2, at t = 0.

        The result is the diagonal (M,) and the off-diagonal (M-1,) of D. The equation of motion is
        sqrt(m) phi'' = -D sqrt(m) phi.
        """
        diagonal, coupling = self.equilibrium.dynamical_matrix(self.movable)
        if self.ground is not None:
            diagonal = diagonal + (self.ground_stiffness / self.masses)[: self.movable]
        return diagonal, coupling

    @cached_property
    def band_edge(self) -> float:
        """Highest eigenfrequency of the linearised chain, rad/s (0 in the sonic vacuum)."""
        from .band_edge import band_edges

        return float(band_edges(*(elements[None] for elements in self.dynamical_matrix()))[0])

    @property
    def fastest_rate(self) -> float:
        """The band edge or the decay rate that damping makes of it, whichever is faster, 1/s."""
        return self.damping.fastest_rate(self.band_edge)

    @cached_property
    def load_over_mass(self) -> float:
        """Largest ratio of the force at rest above a grain to the mass of the grain, m/s2."""
        return float((self.contacts.force[:-1] / self.masses).max())

    @property
    def _first(self) -> int:
        """Number of the contact below grain 1, or above grain 1 if that is the only grain.

        If the grains above the load only touch, it is the contact below the loaded grain.
        """
        return self.loose_grains + int(self.contacts.exists[self.loose_grains + 1])

    @property
    def length_scale(self) -> float:
        """Overlap eps_1 at rest below grain 1, or below the load if upper grains only touch, m."""
        return float(self.contacts.length[self._first])

    @property
    def time_scale(self) -> float:
        """Unit of time of the paper, sqrt(m_1 / k_1), s; infinite in the sonic vacuum."""
        k = float(self.contacts.stiffness[self._first])
        return float(np.sqrt(self.masses[self.loose_grains] / k)) if k > 0 else np.inf

    def excess_energy(
        self, displacement: Array, velocity: Array, wall: Array | None = None
    ) -> Array:
        """Return the energy above rest, (...) J: kinetic, contacts, ground, load, weight.

        Eq. (1) conserves this energy, and it is zero at rest. Its relative accuracy does not depend
        on the amplitude of the wave.

        Parameters
        ----------
        displacement, velocity : (..., N) arrays
            Displacement, m, positive downward; velocity, m/s.
        wall : (...) array, optional
            Displacement of the top wall, m; by default 0.
        """
        self.refuse_moving_ground("the energy above rest")
        kinetic = 0.5 * (self.masses * velocity**2).sum(-1)
        # If all grains are at rest positions, as before a strike, contacts have no excess energy.
        if wall is None and not np.any(displacement):
            return kinetic
        contacts = self.contacts.energy(Contacts.closer(displacement, wall)).sum(-1)
        if self.ground is None:
            return kinetic + contacts
        return kinetic + contacts + ground.energy(self.ground, np.asarray(displacement)).sum(-1)
