"""The scene of a run of LAMMPS: axis, contacts, ends, gravity, load, start and recording.

What the run does not say follows from its first frame: the overlaps of grains at rest give the
force of every contact, and these forces give gravity and load.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..chain.contacts import pair_value
from ..chain.formula import multiply, name, number, parse
from ..chain.law import Law
from ..chain.materials import Material, one_material, sphere_mass
from ..errors import InputError
from ..util.arrays import Array
from .acting import Drive
from .excitation import Impulse
from .lammps_contacts import (
    OLD_STYLES,
    OLD_WALLS,
    GrainForce,
    InputLine,
    read_model,
    read_old_model,
)
from .lammps_input import Fix, LammpsInput, RunGrains
from .profile import Profile

AXES = "xyz"
BESIDE = 1e-6  # of a diameter: how far from the axis a grain may be
SIDEWAYS = 1e-9  # of the largest velocity: how fast it may move sideways
SAME = 5e-6  # relative difference of masses of which one has six digits
AT_REST = 1e-6  # of an overlap, by which it may differ from that at rest
QUIET = 1e-6  # of the largest velocity, below which a grain is at rest
CERTAIN = 3.0  # standard errors
RESOLVED = 1e-2  # of the largest overlap: rounding from which forces cannot be inferred
GRAVITIES = (9.81, 9.80665, 9.8)  # m/s2, the values that inputs have
STANDING = "it is taken to be at rest"


class RunOptions(NamedTuple):
    """What the user says of a run, in SI units.

    Attributes
    ----------
    material : Material, name or dict, optional
    young, poisson, density : float, optional
        Pa, 1 and kg/m3, in place of a material.
    diameter : float, optional
        m, if the run does not say.
    timestep, duration : float, optional
        s, if the run does not say.
    samples : int, optional
    """

    material: Any = None
    young: float | None = None
    poisson: float | None = None
    density: float | None = None
    diameter: float | None = None
    timestep: float | None = None
    duration: float | None = None
    samples: int | None = None


class Understood(NamedTuple):
    """The fields of a scene, and what was understood, one line a fact.

    Attributes
    ----------
    fields : dict
    facts : list of (fact, text)
    units : str or None
        Unit style of the input file.
    """

    fields: dict[str, Any]
    facts: list[tuple[str, str]]
    units: str | None = None


@dataclass
class _End:
    """One end of a column: free, held, or before a wall.

    Attributes
    ----------
    kind : str
        "free", "held" or "wall".
    constant : float
        Of the wall, N/m^delta.
    overlap : float
        Of the wall with its grain, m; NaN if the wall is not known.
    line : InputLine or None
    relaxation : float
        Of the damping of the wall, s.
    """

    kind: str = "free"
    constant: float = 0.0
    overlap: float = math.nan
    line: InputLine | None = None
    relaxation: float = 0.0


def infer_scene(
    grains: RunGrains, source: LammpsInput | None = None, options: RunOptions | None = None
) -> Understood:
    """Return the fields of the scene of a run, and what was understood.

    Parameters
    ----------
    grains : RunGrains
        At the begin of the scene.
    source : LammpsInput, optional
        The input file, which has forces and fixes; without it the material must be given, and
        gravity and load follow from the overlaps.
    options : RunOptions, optional

    Raises
    ------
    InputError
        If it is not one column that a scene can describe, or something is missing.
    """
    return _Column(grains, source, options or RunOptions()).understood()


class _Column:
    """A column of grains, numbered along the axis until the top is known."""

    def __init__(self, grains: RunGrains, source: LammpsInput | None, options: RunOptions):
        self.options = options
        self.source = source
        self.grains = grains
        self.facts: list[tuple[str, str]] = []
        if source and source.units_line:
            self._say("units", f"{source.units_name} ({_place(source.units_line)})")
        if len(grains.numbers) < 2:
            raise self._refuse(f"has {len(grains.numbers)} grain: a column has two or more")
        if not (np.isfinite(grains.positions).all() and np.isfinite(grains.velocities).all()):
            raise self._refuse("holds numbers that are not finite: the run broke down")
        self.axis = int(np.argmax(np.ptp(grains.positions, axis=0)))
        self.order = np.argsort(grains.positions[:, self.axis], kind="stable")
        self._complete()
        self._check_straight()
        self.z = grains.positions[self.order, self.axis]
        self.v = grains.velocities[self.order, self.axis]
        self.held = self._held()
        self.gravity = self._gravity()
        self.ends = self._ends()
        self.contact_fields = self._contacts()
        self._turn()

    def _refuse(self, why: str) -> InputError:
        return InputError.at(self.grains.source, why)

    def _name(self, place: int) -> str:
        """Return the name of the grain at a place along the axis."""
        return f"atom {int(self.grains.numbers[self.order[place]])}"

    # Grains -------------------------------------------------------------------------------------

    def _complete(self) -> None:
        """Fill in diameters and masses that the run does not say."""
        grains, options = self.grains, self.options
        self.material: Material | None = None
        if self._style("bond"):
            # The rest lengths of bonds say how long contacts are.
            return
        missing = np.isnan(grains.diameters) | (grains.diameters <= 0)
        if missing.any():
            if options.diameter is None:
                raise InputError.at("diameter", "is not in the run: give --diameter, in m")
            grains.diameters = np.where(missing, options.diameter, grains.diameters)
        elif options.diameter is not None:
            raise InputError.at("diameter", "is in the run: leave --diameter out")
        self.material = self._material()
        volume = sphere_mass(1.0, grains.diameters)
        missing = np.isnan(grains.masses) | (grains.masses <= 0)
        if missing.any():
            density = self.material.density if self.material else options.density
            if density is None:
                raise InputError.at("mass", "is not in the run: give --material or --density")
            grains.masses = np.where(missing, density * volume, grains.masses)

    def _material(self) -> Material | None:
        """Return the material that the user names; None if the input has the contacts."""
        given = self.options
        if self._style("pair"):
            assert self.source is not None
            assert self.source.state.pair is not None
            if given.material is not None or given.young is not None or given.poisson is not None:
                line, _ = self.source.state.pair
                raise InputError.at(
                    "material", f"is in {line.file}, line {line.number}: leave --material out"
                )
            return None
        if given.material is not None:
            if given.young is not None or given.poisson is not None:
                raise InputError.at("young", "is that of the material: give one of them")
            try:
                return one_material(given.material)
            except ValueError as error:
                raise InputError.at("material", str(error)) from None
        if given.young is None or given.poisson is None:
            raise InputError.at(
                "material",
                "is not in the run: give --material NAME, or --young in Pa and --poisson, or the "
                "input file beside the dump",
            )
        density = given.density
        if density is None:
            known = self.grains.masses / sphere_mass(1.0, self.grains.diameters)
            density = float(known[0])
            if not density > 0:
                raise InputError.at("density", "is not in the run: give --density, in kg/m3")
        return Material(density=density, youngs_modulus=given.young, poissons_ratio=given.poisson)

    def _check_straight(self) -> None:
        """Raise `InputError` unless all grains are on one line along an axis, and stay there."""
        grains = self.grains
        across = [axis for axis in range(3) if axis != self.axis]
        if np.ptp(grains.positions[:, self.axis]) == 0:
            raise self._refuse("has all grains at one place")
        # Bonded grains may have no diameters.
        spacing = np.ptp(grains.positions[:, self.axis]) / len(grains.numbers)
        diameter = grains.diameters.min(where=grains.diameters > 0, initial=spacing)
        slack = max(BESIDE * diameter, grains.slack)
        beside = np.abs(grains.positions - np.median(grains.positions, axis=0))[:, across].max(1)
        if beside.max() > slack:
            worst = int(beside.argmax())
            raise self._refuse(
                f"atom {grains.numbers[worst]} is {beside[worst]:.3g} m beside the line of the "
                f"others along {AXES[self.axis]}: a scene is one straight column along x, y or z, "
                "so cut it out of a packing, several columns or an inclined column"
            )
        speed = np.abs(grains.velocities)
        if speed[:, across].max() > SIDEWAYS * speed.max():
            worst = int(speed[:, across].max(1).argmax())
            raise self._refuse(
                f"atom {grains.numbers[worst]} moves sideways at {speed[worst, across].max():.3g} "
                f"m/s: grains of a scene move along {AXES[self.axis]} only, so friction cannot act"
            )

    # What the input says ------------------------------------------------------------------------

    def _style(self, of: str) -> str:
        """Return the style of pairs or bonds of the input; empty if none acts."""
        if self.source is None:
            return ""
        found = self.source.state.pair if of == "pair" else self.source.state.bond
        return "" if found is None or found[1][0] in ("none", "zero") else found[1][0]

    def _fixes(self, *styles: str) -> Iterator[Fix]:
        """Yield the fixes of some styles."""
        if self.source:
            yield from (fix for fix in self.source.state.fixes.values() if fix.style in styles)

    def _among(self, fix: Fix) -> np.ndarray:
        """Return which grains along the axis are in the group of a fix, (N,) bool."""
        return np.isin(self.grains.numbers[self.order], list(fix.members))

    def _number(self, fix: Fix, place: int) -> float:
        if place >= len(fix.words):
            raise fix.line.refuse("is too short")
        assert self.source is not None
        return self.source.number(fix.words[place], fix.line)

    def _held(self) -> np.ndarray:
        """Return the grains that do not move, (N,) bool along the axis."""
        held = np.zeros(len(self.order), dtype=bool)
        if self.source and not self.source.data_only:
            moving = held.copy()
            for fix in self._fixes("nve", "nve/sphere"):
                moving |= self._among(fix)
            if not moving.any():
                raise InputError.at(
                    str(self.source.path), "has no fix nve or nve/sphere: nothing moves"
                )
            held = ~moving
            for fix in self._fixes("freeze"):
                held |= self._among(fix)
            for fix in self._fixes("setforce"):
                held |= self._among(fix) & self._stops(fix)
        elif self.grains.held is not None:
            held = self.grains.held[self.order]
        if (self.v[held] != 0).any():
            raise self._refuse(f"{self._name(int(held.argmax()))} is held but has a velocity")
        inner = held[1:-1]
        if inner.any():
            raise self._refuse(
                f"{self._name(1 + int(inner.argmax()))} is held within the column: a scene holds "
                "grains at its ends only, one at each"
            )
        return held

    def _stops(self, fix: Fix) -> bool:
        """Return whether `fix setforce` takes the force along the axis."""
        if len(fix.words) != 3:
            raise fix.line.refuse("has options that are not read: give three numbers")
        values = [word if word == "NULL" else self._number(fix, n) for n, word in enumerate(fix[2])]
        if any(value not in ("NULL", 0.0) for value in values):
            raise fix.line.refuse("sets a force other than 0, which no scene has")
        return values[self.axis] != "NULL"

    def _gravity(self) -> float | None:
        """Return gravity along the axis, m/s2; None if it must be inferred."""
        if self.source is None or self.source.data_only:
            return None
        units = self.source.units
        total = 0.0
        for fix in self._fixes("gravity"):
            words = fix.words
            if words[1:2] != ["vector"] or len(words) != 5:
                raise fix.line.refuse("must be `gravity` with a magnitude and vector x y z")
            direction = np.array([self._number(fix, place) for place in (2, 3, 4)])
            length = np.linalg.norm(direction)
            if not length or abs(abs(direction[self.axis]) / length - 1) > 1e-12:
                raise fix.line.refuse(f"must be along the column, {AXES[self.axis]}")
            if not (self._among(fix) | self.held).all():
                raise fix.line.refuse("must act on all grains that move")
            size = self._number(fix, 0) * units.length / units.time**2
            total += size * math.copysign(1.0, direction[self.axis])
            self._say("gravity", f"{abs(total):.6g} m/s2 ({_place(fix.line)})")
        if not total:
            self._say("gravity", "none (no fix gravity)")
        return total

    def _ends(self) -> list[_End]:
        """Return both ends along the axis."""
        ends = [_End("held" if self.held[place] else "free") for place in (0, -1)]
        for fix in self._fixes("wall/gran"):
            self._wall(fix, ends)
        period = self.grains.period[self.axis]
        if not math.isfinite(period) and not math.isinf(period):
            raise self._refuse(
                f"has a periodic boundary along the column, {AXES[self.axis]}, in a box that is "
                "not read: write boundary f, or a region block with numbers"
            )
        d = self.grains.diameters[self.order[[0, -1]]]
        if math.isfinite(period) and period - np.ptp(self.z) <= d.mean() + self.grains.slack:
            raise self._refuse(
                f"has end grains that touch through the periodic boundary {AXES[self.axis]}: a "
                "scene has ends, so open the boundary (f)"
            )
        return ends

    def _wall(self, fix: Fix, ends: list[_End]) -> None:
        """Read `fix wall/gran` as an end of the column."""
        assert self.source is not None
        words = [word for word in fix.words if word != "contacts"]
        read = self.source.number
        style = words[0] if words else ""
        if style == "granular":
            model, rest = read_model(fix.line, words[1:], read)
        elif style in OLD_WALLS:
            model, rest = read_old_model(fix.line, OLD_WALLS[style], words[1:], read)
        else:
            raise fix.line.refuse(f"has no contact style granular, {', '.join(OLD_WALLS)}")
        if len(rest) != 3 or rest[0] not in ("xplane", "yplane", "zplane"):
            raise fix.line.refuse("must end in xplane, yplane or zplane and two places")
        axis = AXES.index(rest[0][0])
        units = self.source.units
        for side, word in enumerate(rest[1:]):
            if word == "NULL":
                continue
            plane = units.length * read(word, fix.line)
            place = (0, -1)[side]
            sign = (1.0, -1.0)[side]
            distances = sign * (self.grains.positions[self.order, axis] - plane)
            radii = self.grains.diameters[self.order] / 2
            if axis != self.axis:
                if (distances < radii).any():
                    raise fix.line.refuse(
                        f"touches the column from the side: only walls along {AXES[self.axis]} act"
                    )
                continue
            if not self._among(fix)[place]:
                continue
            if self.held[place]:
                continue
            if ends[side].kind == "wall":
                raise fix.line.refuse("is a second wall at one end")
            mass = float(self.grains.masses[self.order[place]])
            ends[side] = _End(
                "wall",
                model.constant(float(radii[place]), units),
                float(radii[place] - distances[place]),
                fix.line,
                model.relaxation(mass, units),
            )
            self.wall_model = model.model

    def _contacts(self) -> dict[str, Any]:
        """Return the fields of a chain that give its contacts, grains along the axis."""
        source = self.source
        if source and self._style("bond"):
            return self._bonds(source)
        if source and self._style("pair"):
            return self._pairs(source)
        if source and source.state.bonds:
            raise InputError.at(str(source.path), "has bonds of a style that its input names")
        if source and not source.data_only:
            raise InputError.at(str(source.path), "has neither pair_style nor bond_style")
        return self._materials()

    def _materials(self) -> dict[str, Any]:
        """Return the fields of grains of the material that the user names."""
        assert self.material is not None
        own = sphere_mass(self.material.density, self.grains.diameters)
        fields: dict[str, Any] = {"material": self.material}
        if np.abs(self.grains.masses / own - 1).max() > SAME:
            fields["masses"] = self.grains.masses[self.order]
        label = self.material.name or f"E = {self.material.youngs_modulus:g} Pa"
        self._say("contacts", f"Hertz, of {label} (given)")
        self._say("damping", "none is assumed: positions do not tell it")
        return fields

    def _pairs(self, source: LammpsInput) -> dict[str, Any]:
        """Return the fields of the contacts of a pair style."""
        assert source.state.pair is not None
        line, words = source.state.pair
        kinds = self.grains.types[self.order]
        models: dict[tuple[int, int], GrainForce] = {}
        pairs = list(pairwise(kinds.tolist()))
        for pair in pairs:
            if pair not in models:
                models[pair] = self._pair_model(source, line, words, *pair)
        chosen = [models[pair] for pair in pairs]
        kind = {model.model for model in chosen}
        if len(kind) > 1 or (hasattr(self, "wall_model") and self.wall_model not in kind):
            raise line.refuse("has contacts of hertz and of hooke: a scene has one law")
        d = self.grains.diameters[self.order]
        masses = self.grains.masses[self.order]
        # LAMMPS takes frozen grains as infinitely heavy.
        frozen = np.zeros(len(d), dtype=bool)
        for fix in self._fixes("freeze"):
            frozen |= self._among(fix)
        reduced_masses = pair_value(np.where(frozen, math.inf, masses))
        radii = pair_value(d / 2)
        constants = np.array(
            [m.constant(float(r), source.units) for m, r in zip(chosen, radii, strict=True)]
        )
        relaxations = np.array(
            [
                m.relaxation(float(x), source.units)
                for m, x in zip(chosen, reduced_masses, strict=True)
            ]
        )
        exponent = 1.5 if kind == {"hertz"} else 1.0
        law = "Hertz" if exponent == 1.5 else "linear springs (hooke)"
        self._say("contacts", f"{law}, {_span(constants)} N/m^{exponent:g} ({_place(line)})")
        fields: dict[str, Any] = {"masses": masses, "contact_constants": constants}
        if exponent != 1.5:
            fields["exponent"] = exponent
        if material := self._one_material(chosen, masses, d):
            fields = {"material": material}
        self._damp(fields, relaxations, masses)
        return fields

    def _pair_model(
        self, source: LammpsInput, line: InputLine, words: list[str], first: int, second: int
    ) -> GrainForce:
        """Return the contact model of two types of grains."""
        style = words[0]
        if style in OLD_STYLES:
            model, rest = read_old_model(line, OLD_STYLES[style], words[1:], source.number)
            if rest:
                raise line.refuse(f"has {rest[0]}, which is not understood")
            return model
        if style != "granular":
            cure = f"granular, {', '.join(OLD_STYLES)}"
            raise line.refuse(f"is a force that is not understood: use {cure}")
        own = source.pair_lines(first, second)
        if own is not None:
            model, rest = read_model(own[0], own[1], source.number)
            if rest:
                raise own[0].refuse(f"has {rest[0]}, which is not understood")
            return model
        alone = [source.pair_lines(kind, kind) for kind in (first, second)]
        if None in alone:
            raise line.refuse(f"has no pair_coeff of types {first} and {second}")
        one, other = (self._pair_model(source, line, words, k, k) for k in (first, second))
        return one.with_other(other)

    def _one_material(
        self, models: list[GrainForce], masses: Array, diameters: Array
    ) -> Material | None:
        """Return the material of all grains, if the input names one."""
        densities = masses / sphere_mass(1.0, diameters)
        elastic = {model.elastic for model in models}
        first = models[0].elastic
        if len(elastic) > 1 or first is None or np.ptp(densities) > 1e-12 * densities[0]:
            return None
        assert self.source is not None
        return Material(
            density=float(f"{densities[0]:.12g}"),
            youngs_modulus=first[0] * self.source.units.pressure,
            poissons_ratio=first[1],
        )

    def _damp(self, fields: dict[str, Any], relaxations: Array, masses: Array) -> None:
        """Add the damping of the contacts, and drag by `fix viscous`."""
        alike = np.ptp(relaxations) <= 1e-9 * relaxations.max()
        drag = np.zeros(len(masses))
        for fix in self._fixes("viscous"):
            assert self.source is not None
            if len(fix.words) != 1:
                raise fix.line.refuse("has options that are not read: give one number")
            gamma = self._number(fix, 0) * self.source.units.mass / self.source.units.time
            drag += self._among(fix) * gamma / masses
        for end, near in zip(self.ends, relaxations[[0, -1]], strict=True):
            if end.kind == "wall" and abs(end.relaxation - near) > 1e-6 * max(near, 1e-300):
                assert end.line is not None
                cure = "with the relaxation time of the contact beside it"
                raise end.line.refuse(f"is damped otherwise than a scene has it, {cure}")
        if relaxations.any() or drag.any():
            fields["damping"] = {
                "viscoelastic": float(relaxations[0]) if alike else relaxations,
                "drag": float(drag[0]) if not np.ptp(drag[~self.held]) else drag,
            }
            if not np.ptp(drag[~self.held]):
                fields["damping"]["drag"] = float(drag[~self.held][0])
            self._say("damping", f"contacts {_span(relaxations)} s, drag {_span(drag)} 1/s")

    def _bonds(self, source: LammpsInput) -> dict[str, Any]:
        """Return the fields of a chain of bonds."""
        assert source.state.bond is not None
        line, (style, *_) = source.state.bond
        if self._style("pair") and source.state.pair:
            raise source.state.pair[0].refuse("acts beside bonds: a scene has one of them")
        place = {int(n): k for k, n in enumerate(self.grains.numbers[self.order])}
        kinds: dict[int, int] = {}
        for bond in source.state.bonds:
            ends = sorted(place.get(n, -9) for n in (bond.first, bond.second))
            if ends[0] < 0 or ends[1] - ends[0] != 1:
                raise line.refuse(
                    f"bonds atoms {bond.first} and {bond.second}, which are not neighbours"
                )
            if ends[0] in kinds:
                raise line.refuse(f"bonds atoms {bond.first} and {bond.second} twice")
            kinds[ends[0]] = bond.kind
        for k in range(len(self.order) - 1):
            if k not in kinds:
                raise line.refuse(
                    f"has no bond of {self._name(k)} and {self._name(k + 1)} in the input or its "
                    "data file"
                )
        rows = [source.state.bond_coefficients.get(kinds[k]) for k in range(len(kinds))]
        if None in rows:
            raise line.refuse(f"has no bond_coeff of type {kinds[rows.index(None)]}")
        units = source.units
        found = [row for row in rows if row is not None]
        if any(len(words) < 2 for _, words in found):
            raise line.refuse("has a bond_coeff that is too short")
        place_of_length = 1 if style == "harmonic" else 0
        lengths = [source.number(words[place_of_length], at) for at, words in found]
        self._bond_diameters(line, units.length * np.array(lengths))
        masses = self.grains.masses[self.order]
        if np.isnan(masses).any() or (masses <= 0).any():
            raise self._refuse("has grains without a mass: write `mass` or `set ... mass`")
        fields: dict[str, Any] = {"masses": masses}
        if style == "harmonic":
            stiffness = [2 * source.number(words[0], at) for at, words in found]
            constants = np.array(stiffness) * units.force / units.length
            fields |= {"law": Law("k*o"), "contact_constants": constants}
            self._say("contacts", f"harmonic bonds, {_span(constants)} N/m ({_place(line)})")
        else:
            formulas = {" ".join(words[1:]) for _, words in found}
            if len(formulas) > 1:
                raise line.refuse("has several formulas: a scene has one law")
            at, words = found[0]
            law = _lepton_law(at, " ".join(words[1:]), units.length, units.force)
            fields["law"] = law
            self._say("contacts", f"bonds, force {law.text} ({_place(at)})")
        self._damp(fields, np.zeros(len(kinds)), masses)
        return fields

    def _bond_diameters(self, line: InputLine, lengths: Array) -> None:
        """Give the grains diameters whose means are the rest lengths of the bonds, m."""
        d = self.grains.diameters[self.order]
        if not (np.abs((d[:-1] + d[1:]) / 2 - lengths) <= 1e-12 * lengths).all():
            # d_(n+1) = 2 L_n - d_n: the first diameter is free within bounds.
            alternating = np.concatenate(
                [[0.0], np.cumsum(2 * lengths * (-1.0) ** np.arange(lengths.size))]
            )
            signs = (-1.0) ** np.arange(lengths.size + 1)
            low = float((alternating[signs > 0]).max())
            high = float((alternating[signs < 0]).min())
            if not low < high:
                raise line.refuse("has rest lengths that no row of touching grains has")
            first = lengths[0] if low < lengths[0] < high else (low + high) / 2
            d = signs * (first - alternating)
            if not np.ptp(lengths):
                d = np.full(lengths.size + 1, lengths[0])
        self.grains.diameters[self.order] = d

    # Orientation --------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Number the grains from the top, and let positions and velocities point down."""
        self.z = self.grains.positions[self.order, self.axis]
        stiff = [end.kind != "free" for end in self.ends]
        if self.gravity:
            up = self.gravity < 0
        elif self.gravity is None and (slope := self._force_slope()):
            up = slope < 0
        elif stiff[0] != stiff[1]:
            up = stiff[0]
        else:
            struck = int(np.abs(self.v).argmax())
            up = struck > len(self.v) // 2 or not self.v.any()
        # Along the axis the coordinate grows; the top has the largest one if the axis points up.
        if up:
            self.order = self.order[::-1]
            self.held = self.held[::-1]
            self.ends = self.ends[::-1]
            self.contact_fields = {key: _reverse(x) for key, x in self.contact_fields.items()}
        sign = -1.0 if up else 1.0
        self.z = sign * self.grains.positions[self.order, self.axis]
        self.v = sign * self.grains.velocities[self.order, self.axis] + 0.0
        if self.gravity is not None:
            self.gravity = sign * self.gravity + 0.0
        self.up = up
        count = len(self.order)
        axis = AXES[self.axis]
        numbers = self.grains.numbers[self.order[[0, -1]]]
        points = "up" if up else "down"
        self.facts.insert(
            int(bool(self.facts) and self.facts[0][0] == "units"),
            (
                "column",
                f"{count} grains along {axis}, which points {points}: grain 1 is atom "
                f"{numbers[0]}, grain {count} atom {numbers[1]}",
            ),
        )

    def _force_slope(self) -> float:
        """Return how the forces of contacts grow along the axis, or 0 if they do not."""
        forces, errors, quiet = self._forces(self._trial())
        masses = np.cumsum(self.grains.masses[self.order])[:-1]
        if quiet.sum() < 3:
            return 0.0
        slope, _, error = _fit(masses[quiet], forces[quiet], errors[quiet])
        return slope if abs(slope) > CERTAIN * error else 0.0

    # Gravity and load ---------------------------------------------------------------------------

    def _trial(self, **more: Any) -> Chain:
        """Return a chain of these grains and contacts without weight and load."""
        d = self.grains.diameters[self.order]
        fields = {"gravity": 0.0, "bottom": "free", **self.contact_fields, **more}
        return Chain(grains=len(d), diameter=_one_or_many(d), **fields)

    def _overlaps(self) -> Array:
        """Return the overlaps of neighbours, (N-1,) m; below 0 a gap."""
        d = self.grains.diameters[self.order]
        return np.asarray((d[:-1] + d[1:]) / 2 - np.abs(np.diff(self.z)))

    def _forces(self, chain: Chain) -> tuple[Array, Array, np.ndarray]:
        """Return forces of the contacts, their errors by rounding, N, and which are at rest."""
        overlaps = self._overlaps()
        slack = self.grains.slack
        constants = chain.contacts.constant[1:-1]
        law = chain.law
        forces = np.asarray(law.force(overlaps, constants), dtype=float)
        ends = [law.force(overlaps + side * slack, constants) for side in (-1.0, 1.0)]
        errors = np.maximum(np.abs(ends[1] - ends[0]) / 2, 1e-12 * np.abs(forces).max() + 1e-300)
        quiet = np.abs(self.v) <= QUIET * np.abs(self.v).max()
        still = quiet[:-1] & quiet[1:]
        # A struck grain has not moved yet in the first frame.
        return forces, errors, still if still.sum() > 2 else np.ones_like(still)

    def _load(self, chain: Chain) -> tuple[float, float]:
        """Return gravity, m/s2, and the load on top, N, as the input says or the overlaps do."""
        forces, errors, quiet = self._forces(chain)
        weights = np.cumsum(chain.masses)[:-1]
        largest = float(np.abs(self._overlaps()).max())
        if self.grains.digits_lost and self.grains.slack > RESOLVED * largest:
            raise self._refuse(
                f"its positions are written to {self.grains.slack:.1g} m, too few digits for "
                f"overlaps of {largest:.1g} m: dump_modify ... format float %.17g"
            )
        gravity = self.gravity
        if gravity is None:
            gravity = self._infer_gravity(weights[quiet], forces[quiet], errors[quiet])
        top = self.ends[0].kind
        pushed = self._addforce()
        if pushed is not None:
            return gravity, pushed
        if top == "free" and self.source is not None and not self.source.data_only:
            self._say("load", "none (no fix addforce on a grain)")
            return gravity, 0.0
        if top != "free":
            return gravity, self._closed_load(chain, gravity)
        share = 1 / errors[quiet] ** 2
        rest = forces[quiet] - gravity * weights[quiet]
        load = float((share * rest).sum() / share.sum())
        spread = math.sqrt(float((share * (rest - load) ** 2).sum()) / max(1, rest.size - 1))
        error = max(1.0, spread) / math.sqrt(float(share.sum()))
        if abs(load) <= CERTAIN * error or abs(load) < 1e-9 * np.abs(forces).max():
            load = 0.0
        if load < 0:
            raise self._refuse(
                f"its grains press each other by {-load:.3g} N less than they weigh: the column is "
                "not at rest, or the material is another one"
            )
        if load:
            origin = f"from {quiet.sum()} overlaps at rest, as a constant force on grain 1"
            self._say("load", f"{load:.9g} N ({origin})")
        else:
            self._say("load", f"none (from {quiet.sum()} overlaps at rest)")
        return gravity, load

    def _infer_gravity(self, weights: Array, forces: Array, errors: Array) -> float:
        """Return gravity from how the forces at rest grow from grain to grain, m/s2."""
        if weights.size < 3:
            self._say("gravity", "none (too few contacts at rest to infer it)")
            return 0.0
        slope, _, error = _fit(weights, forces, errors)
        if abs(slope) <= CERTAIN * error or abs(slope) * np.ptp(weights) < 1e-7 * forces.max():
            self._say("gravity", "none (the overlaps at rest do not grow downward)")
            return 0.0
        nearest = [g for g in GRAVITIES if abs(slope - g) <= CERTAIN * error + 1e-5 * g]
        gravity = nearest[0] if nearest else abs(slope)
        self._say(
            "gravity",
            f"{gravity:.6g} m/s2 (inferred: the overlaps grow downward as under "
            f"{abs(slope):.6g} +- {error:.1g})",
        )
        return gravity

    def _closed_load(self, chain: Chain, gravity: float) -> float:
        """Return the load of a column between two immovable ends, N: their distance fixes it."""
        known = self._overlaps()
        constants = chain.contacts.constant[1:-1]
        weights = gravity * np.cumsum(chain.masses)[:-1]
        law = chain.law
        walls = [end for end in self.ends if end.kind == "wall" and math.isfinite(end.overlap)]
        wall_weights = [
            0.0 if end is self.ends[0] else gravity * chain.masses.sum() for end in walls
        ]
        total = float(known.sum()) + sum(end.overlap for end in walls)

        def excess(load: float) -> float:
            squeezed = float(np.sum(law.overlap(load + weights, constants)))
            for end, weight in zip(walls, wall_weights, strict=True):
                squeezed += float(law.overlap(np.array(load + weight), np.array(end.constant)))
            return squeezed - total

        slack = self.grains.slack * (len(known) + 1)
        if self.ends[1].kind == "free" or excess(0.0) >= -1e-9 * abs(total) - slack * 0:
            if self.ends[1].kind != "free" and excess(0.0) > slack + AT_REST * abs(total):
                raise self._refuse(
                    f"its column is {excess(0.0):.3g} m shorter than the space between its ends: "
                    "take out the wall or the held grain at the top, or press the column together"
                )
            self._say("load", "none")
            return 0.0
        high = 1.0
        while excess(high) < 0:
            high *= 4
            if high > 1e30:
                raise self._refuse("is pressed together by more than any load")
        low = 0.0
        for _ in range(2000):
            middle = (low + high) / 2
            if middle in (low, high):
                break
            low, high = (middle, high) if excess(middle) < 0 else (low, middle)
        self._say("load", f"{high:.9g} N (by the distance of the ends, which do not move)")
        return high

    def _addforce(self) -> float | None:
        """Return the constant force on grain 1 by `fix addforce`, N; None if there is none."""
        total = None
        for fix in self._fixes("addforce"):
            assert self.source is not None
            if len(fix.words) != 3:
                raise fix.line.refuse("has options that are not read: give three numbers")
            force = np.array([self._number(fix, place) for place in range(3)])
            across = [axis for axis in range(3) if axis != self.axis]
            members = self._among(fix) & ~self.held
            if not members.any():
                continue
            if force[across].any() or members.sum() != 1 or not members[0]:
                raise fix.line.refuse(
                    "must press grain 1 alone, along the column: other forces are written as "
                    '[excitation] kind = "force"'
                )
            down = (-1.0 if self.up else 1.0) * float(force[self.axis])
            total = (total or 0.0) + down * self.source.units.force
            if total < 0:
                raise fix.line.refuse("pulls grain 1 out of the column: a load presses")
            self._say("load", f"{total:.9g} N on grain 1 ({_place(fix.line)})")
        return total

    # The scene ----------------------------------------------------------------------------------

    def understood(self) -> Understood:
        """Return the fields of the scene, and what was understood."""
        count = len(self.order)
        d = self.grains.diameters[self.order]
        trial = self._trial()
        gravity, load = self._load(trial)
        fields: dict[str, Any] = {
            "grains": count,
            "diameter": _one_or_many(d),
            "gravity": gravity,
            **self.contact_fields,
        }
        if load:
            fields["top_load"] = load
        fields |= self._end_fields(gravity, load)
        try:
            chain = Chain(**fields)
        except InputError as error:
            key, why = error.faults[0]
            raise self._refuse(f"makes no chain: {key}: {why}") from None
        self._say_grains(chain)
        displacement = self._displacement(chain, self._overlaps())
        excitation = self._excitation(chain, displacement)
        recording = self._recording()
        if self.source and self.source.ignored:
            self._say("not read", f"{', '.join(self.source.ignored)}: they change no motion")
        fields = {"chain": chain, "excitation": excitation, **recording}
        style = self.source.units_name if self.source else ""
        return Understood(fields, self.facts, style or None)

    def _end_fields(self, gravity: float, load: float) -> dict[str, Any]:
        """Return the fields of both ends of the chain."""
        top, bottom = self.ends
        if bottom.kind == "free" and (gravity or load):
            if self.source is not None and not self.source.data_only:
                raise self._refuse("has no wall and no held grain at its bottom: it would fall")
            bottom.kind = "wall"
            bottom.constant = 0.0
        walls = [end.kind == "wall" for end in (top, bottom)]
        fields: dict[str, Any] = {
            "top": "wall" if walls[0] else "free",
            "bottom": {"held": "fixed"}.get(bottom.kind, bottom.kind),
        }
        if any(wall and end.constant for wall, end in zip(walls, self.ends, strict=True)):
            fields["wall_constants"] = [top.constant, bottom.constant]
        for place, end, known in (("top", top, ""), ("bottom", bottom, "")):
            grain = 1 if place == "top" else len(self.order)
            text = {"free": "free", "held": f"grain {grain} is held"}.get(end.kind, known)
            if end.kind == "wall" and end.line:
                text = f"a wall, {end.constant:.6g} N/m^delta ({_place(end.line)})"
            elif end.kind == "wall":
                text = "a wall of the grains' material (grain moves, and something carries it)"
            self._say(place, text)
        return fields

    def _say_grains(self, chain: Chain) -> None:
        d, masses = chain.diameters, chain.masses
        self._say("grains", f"diameter {_span(d)} m, mass {_span(masses)} kg")

    def _displacement(self, chain: Chain, overlaps: Array) -> Array:
        """Return the displacements from rest at the begin, (N,) m, and say how far it is."""
        rest = chain.equilibrium_overlap
        off = overlaps - rest
        slack = self.grains.slack + AT_REST * rest
        resting = np.abs(off) <= slack
        forces = chain.law.force(overlaps, chain.contacts.constant[1:-1])
        residual = float(np.abs(forces - chain.contacts.force[1:-1]).max())
        largest = float(np.abs(chain.contacts.force).max())
        share = f", {residual / largest:.1g} of the largest" if largest else ""
        self._say(
            "equilibrium",
            f"forces of the first frame differ from those at rest by at most {residual:.2g} N"
            + share,
        )
        off = np.where(resting, 0.0, off)
        below = 0.0
        bottom = self.ends[1]
        if bottom.kind == "wall" and math.isfinite(bottom.overlap):
            below = bottom.overlap - float(chain.contacts.overlap[-1])
            wall_slack = self.grains.slack + AT_REST * float(chain.contacts.overlap[-1])
            below = 0.0 if abs(below) <= wall_slack else below
        if bottom.kind == "free":
            return np.concatenate([[0.0], -np.cumsum(off)])
        return below + np.concatenate([np.cumsum(off[::-1])[::-1], [0.0]])

    def _excitation(self, chain: Chain, displacement: Array) -> Any:
        """Return the excitation that gives displacements and velocities of the first frame."""
        moving = np.flatnonzero(self.v)
        grain = int(moving[0]) + 1 if moving.size else 1
        velocity = float(self.v[grain - 1])
        if displacement.any():
            size = np.abs(displacement).max()
            speeds = f"velocities up to {np.abs(self.v).max():.6g} m/s"
            self._say("start", f"displacements from rest up to {size:.3g} m, {speeds}")
        elif len(moving) > 1:
            speeds = f"up to {np.abs(self.v).max():.6g} m/s"
            self._say("start", f"velocities of {len(moving)} grains, {speeds}")
        elif not moving.size:
            self._say("start", "nothing moves: change [excitation]")
        else:
            self._say("start", f"grain {grain} moves at {velocity:.9g} m/s, positive downward")
        start = Profile(displacement=displacement, velocity=self.v)
        if not displacement.any():
            start = Profile(velocity=self.v)
        if self.ends[0].kind == "held":
            self._say("hold", "grain 1 does not move: a drive of amplitude 0")
            return Drive(amplitude=0.0, frequency=1.0, start=start)
        if displacement.any() or len(moving) > 1:
            return start
        return Impulse(velocity=velocity, grain=grain)

    def _recording(self) -> dict[str, Any]:
        """Return duration and samples."""
        options, grains = self.options, self.grains
        duration = grains.duration
        if options.timestep is not None and grains.steps is not None:
            duration = options.timestep * (grains.steps[1] - grains.steps[0])
        if not duration > 0 and self.source and grains.steps is not None:
            duration = self.source.step_s * (grains.steps[1] - grains.steps[0])
        if options.duration is not None:
            if grains.steps is not None:
                raise InputError.at("duration", "is that of the dump: leave --duration out")
            duration = options.duration
        if not (duration > 0 and math.isfinite(duration)):
            if grains.steps is not None:
                raise InputError.at(
                    "timestep", f"is not in the dump: give --timestep, in s{self._likely_step()}"
                )
            raise InputError.at("duration", "is not in the run: give --duration, in s")
        samples = options.samples or grains.samples or 101
        self._say("recording", f"{samples} samples to {duration:.9g} s")
        return {"duration": duration, "samples": samples}

    def _likely_step(self) -> str:
        step = self.grains.likely_step
        return f" (its velocities suggest {step:.3g})" if step else ""

    def _say(self, fact: str, text: str) -> None:
        """Note a fact that was understood."""
        self.facts = [each for each in self.facts if each[0] != fact]
        self.facts.append((fact, text))


def _lepton_law(line: InputLine, text: str, length: float, force: float) -> Law:
    """Return the contact law of an energy of `bond_style lepton`, a formula of r = -overlap.

    Only the formula that the parser prints from its own syntax tree is used.
    """
    energy, *definitions = (part.strip() for part in text.replace("^", "**").split(";"))
    try:
        named: Mapping[str, Any] = {}
        for definition in reversed([each for each in definitions if each]):
            key, equals, value = (part.strip() for part in definition.partition("="))
            if not equals:
                raise ValueError
            named = {**named, key: parse(value).substitute(named)}
        formula = parse(energy).substitute(named)
        if unknown := set(formula.names) - {"r"}:
            raise line.refuse(f"has a formula with {min(unknown)}, which is not given")
        # The energy is one of r in the units of the input, the law one of o in m.
        overlap = multiply(number(-1 / length), name("o"))
        found = formula.substitute({"r": overlap})
        slope = multiply(number(length * force), found.derivative("o"))
        return Law(slope.text)
    except InputError as error:
        if error.faults[0][0] == line.file:
            raise
        raise line.refuse(f"has a formula that is not understood: {error.faults[0][1]}") from None
    except (ValueError, KeyError, ArithmeticError):
        raise line.refuse("has a formula that is not understood") from None


def _fit(x: Array, y: Array, errors: Array) -> tuple[float, float, float]:
    """Return slope, intercept and error of the slope of a weighted straight line."""
    share = 1 / errors**2
    share = share / share.max()
    mean_x = float((share * x).sum() / share.sum())
    mean_y = float((share * y).sum() / share.sum())
    spread = float((share * (x - mean_x) ** 2).sum())
    if not spread > 0:
        return 0.0, mean_y, math.inf
    slope = float((share * (x - mean_x) * (y - mean_y)).sum()) / spread
    rest = y - mean_y - slope * (x - mean_x)
    scatter = float((share * rest**2).sum()) / max(1, x.size - 2)
    error = math.sqrt(max(scatter, errors.min() ** 2) / spread)
    return slope, mean_y - slope * mean_x, error


def _reverse(value: Any) -> Any:
    """Return an array in reverse, also within a table, and other values as they are."""
    if isinstance(value, dict):
        return {key: _reverse(item) for key, item in value.items()}
    return value[::-1] if isinstance(value, np.ndarray) else value


def _one_or_many(values: Array) -> Any:
    """Return one number if all agree, else all of them."""
    return float(values[0]) if not np.ptp(values) else values


def _span(values: Array) -> str:
    """Return one number, or the smallest and the largest."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.6g}" if f"{low:.6g}" == f"{high:.6g}" else f"{low:.6g} to {high:.6g}"


def _place(line: InputLine) -> str:
    return f"line {line.number}"
