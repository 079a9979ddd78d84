"""A scene in LAMMPS terms: grain types, pair coefficients, heights, box and drives.

A driven grain follows its path by `fix move variable`, a driven wall is a moving region, and an
external force is applied by `fix addforce`. With velocity Verlet, LAMMPS evaluates their formulas
in double precision at its own times, `step*dt`, with an error of 1e-16 (1 + omega t) relative to
the amplitude. For methods with several drifts, lmpchain sets the values at the times of the method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ...chain.chain import Chain
from ...chain.contact_law import pair_value
from ...chain.law import Law
from ...errors import InputError
from ...scene.base import Excitation
from ...scene.excitation import Impulse
from ...scene.scene import Scene
from ...scene.waveform import Waveform
from ...util.arrays import Array
from ...util.lazy import cached_property
from .viscosity import LammpsGround, LammpsViscosity

# Coefficients of the current cubic piece in powers of the time since its start.
PIECE = ("begin", "c0", "c1", "c2", "c3")
SINCE = "(v_now-v_begin)"
SINE = "v_amplitude*sin(v_omega*v_now)"
INSIDE = "sin(v_envelope*v_now)^2"
BEFORE = "*(v_now<v_end)"


def placeholders(excitation: Excitation, duration: float) -> dict[str, Any]:
    """Return the template values for an excitation that acts during the run."""
    wave = excitation.waveform
    force = excitation.wall is None and not excitation.driven
    return {
        "wave": wave,
        "wave_unit": "N" if force else "m",
        "frequency": wave.omega / (2 * math.pi) if wave else 0.0,
        "cycles": wave.omega / (2 * wave.envelope) if wave and wave.envelope else 0.0,
        "driven": excitation.driven,
        "pushed": excitation.acts_on if force else 0,
        "value": value(wave) if wave else "",
        "slope": slope(wave) if wave else "",
        "pieces": pieces(excitation, duration),
    }


def value(wave: Waveform) -> str:
    """Return the LAMMPS variable formula of a waveform, upward."""
    if wave.spline is not None:
        return f"-(v_c0+{SINCE}*(v_c1+{SINCE}*(v_c2+{SINCE}*v_c3)))"
    return f"-{SINE}" + (f"*{INSIDE}" if wave.envelope else "") + (BEFORE if wave.kinks else "")


def slope(wave: Waveform) -> str:
    """Return the LAMMPS variable formula of the time derivative of a waveform, upward."""
    if wave.spline is not None:
        return f"-(v_c1+{SINCE}*(2.0*v_c2+3.0*{SINCE}*v_c3))"
    plain = "-v_amplitude*v_omega*cos(v_omega*v_now)"
    if not wave.envelope:
        return plain + (BEFORE if wave.kinks else "")
    return f"({plain}*{INSIDE}-{SINE}*v_envelope*sin(2.0*v_envelope*v_now)){BEFORE}"


def pieces(excitation: Excitation, duration: float) -> list[tuple[float, list[str]]]:
    """Return the end time of each cubic piece of a spline, s, and the commands that apply it."""
    wave = excitation.waveform
    if wave is None or wave.spline is None:
        return []
    cubics = []
    for k, (begin, end) in enumerate(pairwise(wave.spline.x.tolist())):
        if begin < duration:
            values = (begin, *wave.spline.c[::-1, k].tolist())
            variables = zip(PIECE, values, strict=True)
            cubics.append((end, [f"variable {name} string {value!r}" for name, value in variables]))
    return cubics


PAIR_STYLES = ("granular", "gran/hertz/history")
MOST_TYPES = 128
NO_TANGENTIAL = "tangential linear_nohistory 0.0 0.0"


class Contact(NamedTuple):
    """Constants of a contact in LAMMPS: k_n of its force, and eta of its damping.

    With the reduced radius R and mass m, the force is k_n sqrt(R o) o + eta m sqrt(R o) o' in the
    model hertz with viscoelastic damping, and k_n o + eta o' in the model hooke with velocity
    damping.
    """

    stiffness: float
    damping: float

    def same(self, other: Contact) -> bool:
        """Return whether both contacts are equal up to rounding errors."""
        pairs = zip(self, other, strict=True)
        return all(abs(one - another) <= 1e-14 * one for one, another in pairs)


@dataclass(frozen=True)
class Wall:
    """A plane above or below a grain with the arguments of `fix wall/gran`."""

    name: str
    grain: int
    lo: str
    hi: str
    contact: str


@dataclass(frozen=True)
class LammpsColumn:
    """A scene in LAMMPS terms.

    Parameters
    ----------
    scene : Scene
    gauge : float
        Diameter of all grains in LAMMPS, m; 0 for their physical diameters. The force depends only
        on overlaps, and the rounding error of a height is proportional to the height. A gauge
        diameter of a few times the largest overlap therefore reduces the rounding error of the run.
    pair_style : str
        One of `PAIR_STYLES`.
    remarks : tuple of str
        Lines for the head of the deck.
    template, include : str
        Text of the user that replaces the deck; text of the user that is inserted in the deck.
    lagged : bool
        Whether damping may also use `fix nve`, as in decks of earlier versions.

    Raises
    ------
    InputError
        If grain types cannot express the contact constants.
    """

    scene: Scene
    gauge: float
    pair_style: str = "granular"
    remarks: tuple[str, ...] = ()
    template: str = ""
    include: str = ""
    lagged: bool = False

    @property
    def predicts(self) -> bool:
        """Whether forces use velocities that are predicted for the end of a step."""
        return self.chain.damped and not self.lagged

    @property
    def formula(self) -> Law | None:
        """The contact law if it is a formula; each contact is then a LEPTON bond."""
        law = self.chain.law
        return law if isinstance(law, Law) else None

    @cached_property
    def ground(self) -> LammpsGround | None:
        """The force from the ground, or None."""
        law = self.chain.ground
        return LammpsGround(law, not self.scene.initial()[0].any()) if law else None

    @cached_property
    def viscosity(self) -> LammpsViscosity | None:
        """The viscous forces of contacts by formula, or None."""
        if self.formula is None or not self.chain.contact_viscosity.any():
            return None
        return LammpsViscosity(self.chain, self.scene.excitation.wall is not None)

    @cached_property
    def own(self) -> dict[str, Array]:
        """The parameters that each grain has, (N,) each, by their names in LAMMPS."""
        parts = (part.own for part in (self.ground, self.viscosity) if part)
        return {key: values for own in parts for key, values in own.items()}

    @property
    def atoms(self) -> str:
        """Atom style of the data file."""
        return "hybrid" if self.predicts or self.formula else "sphere"

    @property
    def chain(self) -> Chain:
        """The chain of the scene."""
        return self.scene.chain

    @property
    def model(self) -> str:
        """Contact model of LAMMPS: hertz, which contains the effective radius, or hooke."""
        return "hooke" if self.chain.law.power == 1 else "hertz"

    @property
    def mobile(self) -> tuple[int, int]:
        """First and last grain that move by the equation of motion: neither driven nor held."""
        return 1 + self.scene.excitation.driven, self.chain.movable

    @property
    def load(self) -> float:
        """Constant force on the loaded grain, N; 0 if it is driven or a wall exerts the load."""
        imposed = self.chain.load_grain <= self.scene.excitation.driven
        return 0.0 if imposed else self.chain.constant_load

    @property
    def strike(self) -> Impulse | None:
        """Impulse of the scene, which a deck stores as a variable."""
        return self.scene.excitation if isinstance(self.scene.excitation, Impulse) else None

    @property
    def drag(self) -> float:
        """Rate gamma of the drag, 1/s.

        Raises
        ------
        InputError
            If the rate differs between the grains that move.
        """
        first, last = self.mobile
        drag = self.chain.drag[first - 1 : last]
        if drag.size and (drag != drag[0]).any():
            fault = "LAMMPS supports one number for all grains: use that, or the native engine"
            raise InputError.at("chain.damping.drag", fault)
        return float(drag[0]) if drag.size else 0.0

    @property
    def drag_on_all(self) -> float | None:
        """Drag m gamma of every moving grain, kg/s; None if their masses differ."""
        first, last = self.mobile
        masses = self.chain.masses[first - 1 : last]
        alike = np.ptp(masses) <= 1e-14 * masses.max()
        return self.drag * float(masses[0]) if alike else None

    @cached_property
    def diameters(self) -> Array:
        """Diameters, (N,) m."""
        return np.full(self.chain.grains, self.gauge) if self.gauge else self.chain.diameters

    @cached_property
    def densities(self) -> Array:
        """Densities, (N,) kg/m3, chosen so that every grain has its mass."""
        return self.chain.masses / (np.pi / 6 * self.diameters**3)

    @cached_property
    def heights(self) -> Array:
        """Heights at rest, (N,) m: cumulative sums in extended precision, rounded once."""
        # Sums of many diameters in double precision would lose digits of the overlaps.
        d = self.diameters.astype(np.longdouble)
        distances = (d[:-1] + d[1:]) / 2 - self.chain.equilibrium_overlap
        return np.append(0.0, -np.cumsum(distances)).astype(float)

    @cached_property
    def start(self) -> tuple[Array, Array]:
        """Heights and upward velocities at t = 0, (N,) m and m/s."""
        u, v = self.scene.initial()
        return self.heights - u, -v

    @cached_property
    def walls(self) -> list[Wall]:
        """The walls as planes at rest."""
        radius = self.diameters[[0, -1]] / 2
        gaps = radius - self.chain.contacts.overlap[[0, -1]]
        above, below = (self.heights[[0, -1]] + [1, -1] * gaps).tolist()
        top, bottom = self._wall_arguments(radius)
        walls = (
            Wall("top", 1, "NULL", repr(above), top),
            Wall("bottom", self.chain.grains, repr(below), "NULL", bottom),
        )
        exists = self.chain.wall_constants > 0
        return [wall for wall, there in zip(walls, exists, strict=True) if there]

    @cached_property
    def wall_viscosity(self) -> float:
        """Viscous force of a moving top wall per rate and, in hertz, root of the overlap, in SI.

        It is 0 if the wall is at rest or elastic, or if the law is a formula.
        """
        if self.scene.excitation.wall is None or not self.predicts or self.formula:
            return 0.0
        factor = 1.0 if self.model == "hooke" else 1.5
        return float(factor * self.chain.contact_viscosity[0] * self.chain.wall_constants[0])

    @property
    def wall_friction(self) -> str:
        """The viscous force of a moving top wall on grain 1, N upward, in variables of LAMMPS."""
        # A moving region has the velocity of half a step before, which lowers the order to 1.
        root = "" if self.model == "hooke" else "*sqrt(abs(v_top_o))"
        return f"-v_top_k{root}*(v_top_o>0)*(vz-v_wall_vz)"

    def _wall_arguments(self, radius: Array) -> list[str]:
        """Return the arguments for the contacts with the top and the bottom wall.

        For a law by formula, the arguments are the energy as a function of the distance r to the
        wall, and the range of the force, which is the height of the box.
        """
        constants = self.chain.wall_constants
        if self.formula is None:
            ends = self._contacts(constants, radius, self.chain.masses[[0, -1]], [0, -1])
            if self.wall_viscosity:
                ends[1][0] = 0.0
            return [self._arguments(Contact(*row)) for row in np.column_stack(ends).tolist()]
        height = self.box[3] - self.box[2]
        # A wall has the law parameters of the contact next to it.
        numbers = (0, max(self.chain.grains - 2, 0))
        rows = zip(constants.tolist(), radius.tolist(), numbers, strict=True)
        return [
            f"{self.formula.lepton(overlap=f'{r!r} - r', constant=k, contact=n)} {height!r}"
            for k, r, n in rows
        ]

    @property
    def _law_numbers(self) -> Array:
        """Constant and parameters of a law by formula, (C, 1 + P), for each contact."""
        assert self.formula
        constants = self.chain.contact_constants
        own = (np.broadcast_to(value, constants.shape) for value in self.formula.parameters)
        return np.column_stack([constants, *own])

    @property
    def parsed_letters(self) -> int:
        """Letters of all formulas, which LAMMPS parses anew at each force evaluation."""
        if self.formula is None:
            return 0
        formulas = len(np.unique(self._law_numbers, axis=0))
        walls = int(np.count_nonzero(self.chain.wall_constants))
        return (formulas + walls) * len(self.formula.lepton(constant=1 / 3))

    @cached_property
    def bonds(self) -> tuple[list[int], list[str]]:
        """Bond type of each contact for a law by formula, and the `bond_coeff` of each type.

        The energy is a function of r, the distance of two grains minus the distance at which they
        touch, so that the overlap is -r.
        """
        law = self.formula
        assert law
        d = self.diameters
        rows = np.column_stack([(d[:-1] + d[1:]) / 2, self._law_numbers])
        _, first, kinds = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        coefficients = [
            f"{float(rows[n, 0])!r} {law.lepton(constant=float(rows[n, 1]), contact=n)}"
            for n in first.tolist()
        ]
        return (kinds.ravel() + 1).tolist(), coefficients

    def _contacts(
        self, constants: Array, radius: Array, mass: Array, numbers: Sequence[int] | slice
    ) -> tuple[Array, Array]:
        """Return the stiffness and damping of contacts as in `Contact`, (C,) each.

        Parameters
        ----------
        constants, radius, mass : (C,) arrays
            Contact constant K, N/m^delta; reduced radius, m; reduced mass, kg.
        numbers : sequence of C int or slice
            Numbers of these contacts among all contacts of the chain.
        """
        viscosity = self.chain.contact_viscosity[numbers]
        if self.model == "hooke":
            return constants, viscosity * constants
        stiffness = constants / np.sqrt(radius)
        return stiffness, 1.5 * viscosity * stiffness / mass

    def _arguments(self, contact: Contact) -> str:
        """Return the arguments of the contact model of `pair_coeff` and `fix wall/gran`."""
        # A contact without damping gets a damping force of 0.
        model = "viscoelastic" if self.model == "hertz" and contact.damping else "velocity"
        return f"{contact.stiffness!r} {contact.damping!r} {NO_TANGENTIAL} damping {model}"

    @cached_property
    def skin(self) -> float:
        """Neighbour skin, m, which exceeds each initial gap."""
        z, _ = self.start
        gap = z[:-1] - z[1:] - (self.diameters[:-1] + self.diameters[1:]) / 2
        return float(0.3 * self.diameters.max() + gap.max(initial=0.0))

    @property
    def reach(self) -> float:
        """Distance within which ranks share grains that are bonded, m."""
        return float(self.diameters.max() + 2 * self.skin)

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Lower and upper bound in x and y, and in z, m."""
        z, _ = self.start
        # The box is as wide as a grain and its skin, because nothing moves sideways.
        side = float(self.diameters.max() + self.skin)
        # The box is as high as the column, so that the ranks share the column evenly. Grains may
        # leave the box, because neighbour lists are never rebuilt.
        return -side, side, float(z.min() - side), float(z.max() + side)

    @cached_property
    def types(self) -> list[int]:
        """Type of every grain, from 1."""
        if self.formula:
            return [1] * self.chain.grains
        return self._types_and_contacts[0]

    @property
    def type_count(self) -> int:
        """Number of grain types."""
        return max(self.types)

    @property
    def bare(self) -> bool:
        """Whether the deck contains no user commands."""
        return not (self.template or self.include)

    @cached_property
    def coefficients(self) -> list[str]:
        """Arguments of the pair_coeff commands."""
        unused = f"{self.type_count + 1} {self.type_count + 1} dpd 0.0 0.0"
        if self.formula:
            return ["* * none", unused]
        # With several pair styles, a coefficient names its style.
        style = f" {self.pair_style}" if self.predicts else ""
        pairs = self._types_and_contacts[1]
        contacts = {"* *": next(iter(pairs.values()), Contact(1.0, 0.0))}
        if len(pairs) > 1:
            contacts |= {f"{i} {j}": contact for (i, j), contact in pairs.items()}
        if self.pair_style == "granular":
            lines = [
                f"{types}{style} {self.model} {self._arguments(contact)}"
                for types, contact in contacts.items()
            ]
        else:
            lines = [f"* *{style}"]
        return [*lines, unused] if self.predicts else lines

    @property
    def style(self) -> str:
        """Arguments of the pair_style command."""
        if self.formula:
            return f"hybrid/overlay dpd 0.0 {self.skin!r} 1" if self.predicts else "none"
        style = self.pair_style
        if style != "granular":
            contact = self._types_and_contacts[1].get((1, 1), Contact(1.0, 0.0))
            style += f" {contact.stiffness!r} 0.0 {contact.damping!r} 0.0 0.0 0"
        return f"hybrid/overlay {style} dpd 0.0 {self.skin!r} 1" if self.predicts else style

    @cached_property
    def _types_and_contacts(self) -> tuple[list[int], dict[tuple[int, int], Contact]]:
        """Types of the grains, and the contact of each touching pair of types.

        A grain gets a type whose pair with the type of the grain above already has the right
        contact. Otherwise it gets the type with the most free pairs, or a new type. N different
        contacts then need about sqrt(2 N) types.
        """
        chain = self.chain
        d = self.diameters
        # Reduced radius of two spheres: d1 d2 / (2 (d1 + d2)).
        radius = d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2
        mass = pair_value(chain.masses)
        stiffness, damping = self._contacts(chain.contact_constants, radius, mass, slice(1, -1))
        # Each kind of contact below each type is searched once, also in long chains.
        distinct, kinds = np.unique(stiffness + 1j * damping, return_inverse=True)
        contacts = [Contact(value.real, value.imag) for value in distinct.tolist()]
        known: dict[tuple[int, int], int] = {}
        pairs: dict[tuple[int, int], Contact] = {}
        # For each type: the types that it touches, and the contacts with them.
        partners: dict[int, dict[int, Contact]] = {1: {}}
        types = [1]
        for kind in kinds.tolist():
            above = types[-1]
            below = known.get((above, kind))
            if below is None:
                contact = contacts[kind]
                below = known[above, kind] = _type_below(partners, above, contact)
                self._check_type(below, len(types))
                partners.setdefault(below, {})
                partners[above].setdefault(below, contact)
                partners[below].setdefault(above, contact)
                pairs.setdefault((min(above, below), max(above, below)), contact)
            types.append(below)
        return types, pairs

    def _check_type(self, grain_type: int, number: int) -> None:
        """Raise `InputError` if contact `number` needs more types than LAMMPS supports."""
        granular = self.pair_style == "granular"
        limit = MOST_TYPES if granular else 1
        if grain_type > limit:
            cure = "the native engine" if granular else "pair_style granular or the native engine"
            raise InputError.at(
                "contact_constants",
                f"contact {number} differs from those above it, and {limit} grain type(s) "
                f"cannot express it in pair_style {self.pair_style}; use {cure}",
            )


def _type_below(partners: dict[int, dict[int, Contact]], above: int, contact: Contact) -> int:
    """Return the type of a grain with this contact below a grain of type `above`."""
    for grain_type, value in partners[above].items():
        if value.same(contact):
            return grain_type
    free = (key for key in partners if key not in partners[above])
    return min(free, key=lambda key: len(partners[key]), default=len(partners) + 1)
