"""The scene of a LAMMPS run: axis, contacts, ends, gravity, load, start and recording.

Gravity and load are inferred from the first frame if the run does not state them: the overlaps of
grains at rest determine the force of every contact, and these forces determine gravity and load.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..chain.materials import Material, one_material, sphere_mass
from ..errors import InputError, shown
from ..util.arrays import Array
from .acting import Drive
from .excitation import Impulse
from .initial import Profile
from .lammps_forces import ColumnGrains, bond_forces, pair_forces, read_wall, span
from .lammps_input import LammpsInput
from .lammps_state import CERTAIN, RunFix, RunGrains, fit_line, gravity_of, load_between, mean_load
from .lammps_text import InputLine

AXES = "xyz"
BESIDE = 1e-6  # Largest distance of a grain from the axis, in diameters.
SIDEWAYS = 1e-9  # Largest transverse speed, relative to the largest velocity.
SAME = 5e-6  # Relative difference of equal masses, one of which has six digits.
EQUAL = 1e-14  # Relative difference of equal numbers.
REST_DIFFERENCE = 1e-6  # Largest difference of an overlap from its value at rest, relative to it.
QUIET = 1e-6  # A grain is at rest below this fraction of the largest velocity.
FEWEST_CONTACTS = 3  # Smallest number of contacts at rest that determine gravity and load.
UNLIKE = 1e-2  # Relative scatter of forces above which a column is not at rest.
FAR_WALL = 0.1  # A wall whose gap exceeds this fraction of the grain's radius is ignored.
RESOLVED = 1e-2  # Largest relative rounding error with which forces are inferred.


class RunOptions(NamedTuple):
    """Information about a run from the user, in SI units.

    Attributes
    ----------
    material : Material, name or dict, optional
        Material of the grains.
    young : float, optional
        Young's modulus, Pa, in place of a material.
    poisson : float, optional
        Poisson's ratio, in place of a material.
    density : float, optional
        Density, kg/m3, in place of a material.
    diameter : float, optional
        Diameter of grains, m, if the run does not contain it.
    timestep : float, optional
        Time step of a dump, s, if the run does not contain it.
    duration : float, optional
        Duration of the scene, s, if the run does not contain it.
    samples : int, optional
        Number of recorded times of the scene.
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
    """The fields of a scene, and the findings about a run, one line each.

    Attributes
    ----------
    fields : dict
        Arguments of `Scene` by name.
    facts : list of (fact, text)
        Findings about the run: the name of each fact, and its description.
    units : str or None
        Unit style of the input file; None without one.
    """

    fields: dict[str, Any]
    facts: list[tuple[str, str]]
    units: str | None = None


@dataclass
class ColumnEnd:
    """One end of a column: free, fixed, or at a wall.

    Attributes
    ----------
    kind : str
        Kind of the end: "free", "held" or "wall".
    constant : float
        Contact constant of the wall, N/m^delta.
    overlap : float
        Overlap of the wall with its grain, m; NaN if unknown.
    line : InputLine or None
        The command that defines the wall; None without such a command.
    relaxation : float
        Relaxation time of the damping at the wall, s.
    model : str
        Contact model of the wall: "hertz" or "hooke".
    """

    kind: str = "free"
    constant: float = 0.0
    overlap: float = math.nan
    line: InputLine | None = None
    relaxation: float = 0.0
    model: str = ""


def infer_scene(
    grains: RunGrains, source: LammpsInput | None = None, options: RunOptions | None = None
) -> Understood:
    """Return the fields of a run's scene, and the findings about it.

    Parameters
    ----------
    grains : RunGrains
        The grains at the start of the scene.
    source : LammpsInput, optional
        The input file, which defines forces and fixes. Without an input file the material must be
        given, and gravity and load are inferred from the overlaps.
    options : RunOptions, optional
        Information from the user.

    Raises
    ------
    InputError
        If the grains are not one column that a scene can describe, or if information is missing.
    """
    options = options or RunOptions()
    for key in ("young", "density", "diameter", "timestep", "duration"):
        value = getattr(options, key)
        if value is not None and not 0 < value < math.inf:
            raise InputError.at(key, f"must be above 0 (got {shown(value)})")
    return RunColumn(grains, source, options).understood()


class RunColumn:
    """A column of grains, numbered along the axis until its top is identified."""

    def __init__(self, grains: RunGrains, source: LammpsInput | None, options: RunOptions):
        self.options = options
        self.source = source
        self.grains = replace(grains, diameters=grains.diameters.copy())
        self.facts: list[tuple[str, str]] = []
        if source and source.units_line:
            self._say("units", f"{source.units_name} ({_place(source.units_line)})")
        if len(grains.numbers) < 2:
            raise self._refuse(f"has {len(grains.numbers)} grain: a column has two or more")
        if not (np.isfinite(grains.positions).all() and np.isfinite(grains.velocities).all()):
            raise self._refuse("contains numbers that are not finite: the run broke down")
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

    @property
    def _has_commands(self) -> bool:
        """Whether an input contains the commands of the forces on the grains."""
        return self.source is not None and not self.source.data_only

    def _refuse(self, why: str) -> InputError:
        return InputError.at(self.grains.source, why)

    def _name(self, place: int) -> str:
        """Return the name of the grain at a place along the axis."""
        return f"atom {int(self.grains.numbers[self.order[place]])}"

    # Grains -------------------------------------------------------------------------------------

    def _complete(self) -> None:
        """Fill in diameters and masses that the run does not contain."""
        grains, options = self.grains, self.options
        self.material: Material | None = None
        if self._style("bond"):
            self._refuse_given("follows from the bonds", "material", "young", "poisson", "diameter")
            # The rest lengths of bonds determine the lengths of contacts.
            return
        missing = np.isnan(grains.diameters) | (grains.diameters <= 0)
        if missing.any():
            if options.diameter is None:
                raise InputError.at("diameter", "is not in the run: give --grain-diameter, in m")
            grains.diameters = np.where(missing, options.diameter, grains.diameters)
        else:
            self._refuse_given("is in the run", "diameter")
        self.material = self._material()
        volume = sphere_mass(1.0, grains.diameters)
        missing = np.isnan(grains.masses) | (grains.masses <= 0)
        if missing.any():
            if options.material is not None:
                self._refuse_given("follows from the material", "density")
            density = self.material.density if self.material else options.density
            if density is None:
                raise InputError.at("mass", "is not in the run: give --material or --density")
            grains.masses = np.where(missing, density * volume, grains.masses)
        elif self.material is None or options.material is not None:
            self._refuse_given("is in the run", "density")

    def _refuse_given(self, why: str, *keys: str) -> None:
        """Raise `InputError` for options whose values the run already contains."""
        given = [key for key in keys if getattr(self.options, key) is not None]
        if given:
            raise InputError([(key, f"{why}: leave it out") for key in given])

    def _material(self) -> Material | None:
        """Return the material named by the user; None if the input defines the contacts."""
        given = self.options
        if self._style("pair"):
            assert self.source is not None
            assert self.source.state.pair is not None
            line, _ = self.source.state.pair
            where = f"is in {line.file}, {_place(line)}"
            self._refuse_given(where, "material", "young", "poisson")
            return None
        if given.material is not None:
            if given.young is not None or given.poisson is not None:
                raise InputError.at("young", "follows from the material: give one of them")
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
        """Raise `InputError` unless all grains are and stay on one line along an axis."""
        grains = self.grains
        across = [axis for axis in range(3) if axis != self.axis]
        if np.ptp(grains.positions[:, self.axis]) == 0:
            raise self._refuse("has all grains at one place")
        # Bonded grains may have no diameters.
        spacing = np.ptp(grains.positions[:, self.axis]) / (len(grains.numbers) - 1)
        diameter = grains.diameters.min(where=grains.diameters > 0, initial=spacing)
        slack = max(BESIDE * diameter, grains.slack)
        beside = np.abs(grains.positions - np.median(grains.positions, axis=0))[:, across].max(1)
        if beside.max() > slack:
            worst = int(beside.argmax())
            raise self._refuse(
                f"atom {grains.numbers[worst]} is {beside[worst]:.3g} m beside the line of the "
                f"other grains along {AXES[self.axis]}: a scene is one straight column along x, y "
                "or z, so extract it from a packing, several columns or an inclined column"
            )
        speed = np.abs(grains.velocities)
        if speed[:, across].max() > SIDEWAYS * speed.max():
            worst = int(speed[:, across].max(1).argmax())
            raise self._refuse(
                f"atom {grains.numbers[worst]} moves sideways at {speed[worst, across].max():.3g} "
                f"m/s: grains of a scene move along {AXES[self.axis]} only, so friction cannot act"
            )

    # Commands of the input ----------------------------------------------------------------------

    def _style(self, of: str) -> str:
        """Return the pair or bond style of the input; empty without one."""
        if self.source is None:
            return ""
        found = self.source.state.pair if of == "pair" else self.source.state.bond
        return "" if found is None or found[1][0] in ("none", "zero") else found[1][0]

    def _fixes(self, *styles: str) -> Iterator[RunFix]:
        """Yield the fixes with certain styles."""
        if self.source:
            yield from (fix for fix in self.source.state.fixes.values() if fix.style in styles)

    def _among(self, fix: RunFix) -> np.ndarray:
        """Return a mask of the grains along the axis in the group of a fix, (N,) bool."""
        assert self.source is not None
        members = self.source.members(fix.group, fix.line)
        return np.isin(self.grains.numbers[self.order], list(members))

    def _number(self, fix: RunFix, place: int) -> float:
        assert self.source is not None
        return self.source.text.number(fix.words[place], fix.line)

    def _held(self) -> np.ndarray:
        """Return a mask of the fixed grains, (N,) bool along the axis."""
        held = np.zeros(len(self.order), dtype=bool)
        if self.source and self._has_commands:
            moving = np.zeros(len(self.order), dtype=int)
            for fix in self._fixes("nve", "nve/sphere"):
                moving += self._among(fix)
                if (moving > 1).any():
                    raise fix.line.refuse("moves grains that another fix moves: remove one of them")
            if not moving.any():
                fault = "has no fix nve or nve/sphere: nothing moves"
                raise InputError.at(str(self.source.path), fault)
            held = moving == 0
            for fix in self._fixes("freeze", "setforce"):
                if fix.style == "freeze" or self._stops(fix):
                    stopped = self._among(fix)
                    self._check_later(fix, stopped & (moving > 0))
                    held |= stopped
        elif self.grains.held is not None:
            held = self.grains.held[self.order]
        if (pushed := held & (self.v != 0)).any():
            raise self._refuse(f"{self._name(int(pushed.argmax()))} is held but has a velocity")
        inner = held[1:-1]
        if inner.any():
            raise self._refuse(
                f"{self._name(1 + int(inner.argmax()))} is held within the column: a scene can "
                "hold only the first and the last grain"
            )
        return held

    def _check_later(self, holding: RunFix, stopped: np.ndarray) -> None:
        """Raise `InputError` if a fix adds a force to grains after the fix that stops them."""
        fixes = list(self._fixes("freeze", "setforce", "gravity", "addforce", "wall/gran"))
        for fix in fixes[fixes.index(holding) + 1 :]:
            if fix.style not in ("freeze", "setforce") and (self._among(fix) & stopped).any():
                raise fix.line.refuse(
                    f"acts on grains after the {holding.style} of line {holding.line.number} "
                    "stopped them, so that they move: write it before that line"
                )

    def _stops(self, fix: RunFix) -> bool:
        """Return whether `fix setforce` removes the force along the axis."""
        if len(fix.words) != 3:
            raise fix.line.refuse("has options that are not read: give three numbers")
        values = [word if word == "NULL" else self._number(fix, n) for n, word in enumerate(fix[2])]
        if any(value not in ("NULL", 0.0) for value in values):
            raise fix.line.refuse("sets a force other than 0, which a scene does not support")
        return values[self.axis] != "NULL"

    def _gravity(self) -> float | None:
        """Return gravity along the axis, m/s2; None if it must be inferred."""
        if self.source is None or not self._has_commands:
            if self.grains.acting is None or "gravity" in self.grains.acting:
                return None
            self._say("gravity", "none (no fix gravity)")
            return 0.0
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

    def _ends(self) -> list[ColumnEnd]:
        """Return both ends along the axis."""
        ends = [ColumnEnd("held" if self.held[place] else "free") for place in (0, -1)]
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

    def _wall(self, fix: RunFix, ends: list[ColumnEnd]) -> None:
        """Read `fix wall/gran` as an end of the column."""
        assert self.source is not None
        model, rest = read_wall(fix.line, fix.words, self.source.text.number)
        axis = AXES.index(rest[0][0])
        radii = self.grains.diameters[self.order] / 2
        for side, word in enumerate(rest[1:]):
            if word == "NULL":
                continue
            plane = self.source.units.length * self.source.text.number(word, fix.line)
            # The first plane is below the grains along its axis, the second one above them.
            sign = 1.0 - 2.0 * side
            overlaps = radii - sign * (self.grains.positions[self.order, axis] - plane)
            if axis != self.axis and (overlaps > 0).any():
                raise fix.line.refuse(
                    f"touches the column from the side: remove it, or use {AXES[self.axis]}plane"
                )
            place = -side
            nearest = float(overlaps[place])
            if axis != self.axis or self.held[place] or not self._among(fix)[place]:
                continue
            if nearest < -FAR_WALL * radii[place]:
                self._say(f"wall at {word}", f"ignored: its nearest grain is {-nearest:.3g} m away")
                continue
            if ends[side].kind == "wall":
                raise fix.line.refuse("is a second wall at one end")
            constant = model.constant(float(radii[place]), self.source.units)
            mass = float(self.grains.masses[self.order[place]])
            relaxation = model.relaxation(mass, self.source.units)
            ends[side] = ColumnEnd("wall", constant, nearest, fix.line, relaxation, model.model)

    def _contacts(self) -> dict[str, Any]:
        """Return the fields of a chain that define its contacts, with grains along the axis."""
        bonded, paired = self._style("bond"), self._style("pair")
        source, grains, order = self.source, self.grains, self.order
        if source is None or not (bonded or paired):
            return self._materials()
        if bonded and paired and source.state.pair:
            raise source.state.pair[0].refuse("acts in addition to bonds: remove one of them")
        frozen = np.any([self._among(fix) for fix in self._fixes("freeze")], axis=0)
        ordered = ColumnGrains(
            numbers=grains.numbers[order],
            types=grains.types[order],
            diameters=grains.diameters[order],
            masses=grains.masses[order],
            frozen=np.broadcast_to(frozen, len(order)),
        )
        forces = (bond_forces if bonded else pair_forces)(source, ordered)
        for end in self.ends:
            if end.line and end.model != forces.model:
                raise end.line.refuse(
                    f"has {end.model} contacts, but the grains have {forces.model} contacts"
                )
        grains.diameters[order] = forces.diameters
        self._say("contacts", f"{forces.text} ({_place(forces.line)})")
        return forces.fields | self._damping(forces.relaxations, ordered.masses)

    def _damping(self, relaxations: Array, masses: Array) -> dict[str, Any]:
        """Return the damping of the contacts, and the drag of `fix viscous`, if any."""
        drag = np.zeros(len(masses))
        for fix in self._fixes("viscous"):
            assert self.source is not None
            if len(fix.words) != 1:
                raise fix.line.refuse("has options that are not read: give one number")
            gamma = self._number(fix, 0) * self.source.units.mass / self.source.units.time
            drag += self._among(fix) * gamma / masses
        for end, near in zip(self.ends, relaxations[[0, -1]], strict=True):
            if end.line and abs(end.relaxation - near) > SAME * near:
                cure = f"use the relaxation time of the contact beside it, {near:.6g} s"
                raise end.line.refuse(f"has the relaxation time {end.relaxation:.6g} s: {cure}")
        if not (relaxations.any() or drag.any()):
            return {}
        # Fixed grains have no drag.
        moving = drag[~self.held]
        drag = np.where(self.held, moving[0], drag)
        self._say("damping", f"contacts {span(relaxations)} s, drag {span(drag)} 1/s")
        return {
            "damping": {
                "viscoelastic": _one_or_many(relaxations),
                "drag": _one_or_many(drag),
            }
        }

    def _materials(self) -> dict[str, Any]:
        """Return the fields of grains made of the material named by the user."""
        if self.source and self.source.state.bonds:
            raise self._refuse("has bonds, whose style its input names: name the input, too")
        if self._has_commands:
            raise self._refuse("has neither pair_style nor bond_style: grains exert no forces")
        assert self.material is not None
        own = sphere_mass(self.material.density, self.grains.diameters)
        fields: dict[str, Any] = {"material": self.material}
        if np.abs(self.grains.masses / own - 1).max() > SAME:
            fields["masses"] = self.grains.masses[self.order]
        label = self.material.name or f"E = {self.material.youngs_modulus:g} Pa"
        self._say("contacts", f"Hertz, of {label} (given)")
        self._say("damping", "none is assumed: it cannot be inferred from positions")
        return fields

    # Orientation --------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Number the grains from the top, with positions and velocities positive downward."""
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
            up = 2 * struck >= len(self.v) or not self.v.any()
        # The coordinate increases along the axis; the top has the largest one if the axis points
        # up.
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
        """Return the slope of contact forces along the axis; 0 if they do not increase."""
        forces, errors, quiet = self._forces(self._trial())
        masses = np.cumsum(self.grains.masses[self.order])[:-1]
        if quiet.sum() < FEWEST_CONTACTS:
            return 0.0
        line = fit_line(masses[quiet], forces[quiet], errors[quiet])
        return math.copysign(gravity_of(line, masses[quiet], forces[quiet]), line.slope)

    # Gravity and load ---------------------------------------------------------------------------

    def _trial(self, **more: Any) -> Chain:
        """Return a chain of these grains and contacts without gravity and load."""
        d = self.grains.diameters[self.order]
        fields = {"gravity": 0.0, "bottom": "free", **self.contact_fields, **more}
        return Chain(grains=len(d), diameter=_one_or_many(d), **fields)

    def _overlaps(self) -> Array:
        """Return the overlaps of neighbours, (N-1,) m; negative for gaps."""
        d = self.grains.diameters[self.order]
        return np.asarray((d[:-1] + d[1:]) / 2 - np.abs(np.diff(self.z)))

    def _forces(self, chain: Chain) -> tuple[Array, Array, np.ndarray]:
        """Return contact forces, their rounding errors, N, and a mask of contacts at rest."""
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
        return forces, errors, still if still.sum() >= FEWEST_CONTACTS else np.ones_like(still)

    def _load(self, chain: Chain) -> tuple[float, float]:
        """Return the gravity (m/s2) and top load (N) from the input or from the overlaps."""
        forces, errors, quiet = self._forces(chain)
        weights = np.cumsum(chain.masses)[:-1]
        largest = float(np.abs(self._overlaps()).max())
        if self.grains.digits_lost and self.grains.slack > RESOLVED * largest:
            raise self._refuse(
                f"its positions are rounded to {self.grains.slack:.1g} m, too few digits for "
                f"overlaps of {largest:.1g} m: use dump_modify ... format float %.17g"
            )
        gravity = self.gravity
        if gravity is None:
            gravity = self._infer_gravity(weights[quiet], forces[quiet], errors[quiet])
        pushed = self._addforce()
        if pushed is not None:
            return gravity, pushed
        if self.ends[0].kind != "free":
            return gravity, self._closed_load(chain, gravity)
        if self._has_commands or self.grains.acting is not None:
            self._say("load", "none (no fix addforce on a grain)")
            return gravity, 0.0
        rest = forces[quiet] - gravity * weights[quiet]
        self._check_rest(rest, forces[quiet], errors[quiet])
        load = mean_load(rest, errors[quiet], float(np.abs(forces).max()))
        if load < 0:
            raise self._refuse(
                f"its contact forces are {-load:.3g} N smaller than the weight above them: the "
                "column is not at rest, or the material is wrong"
            )
        origin = f"from {quiet.sum()} overlaps, assumed to be at rest"
        as_force = f"{load:.9g} N ({origin}, as a constant force on grain 1)"
        self._say("load", as_force if load else f"none ({origin})")
        return gravity, load

    def _check_rest(self, rest: Array, forces: Array, errors: Array) -> None:
        """Raise `InputError` if forces minus weights, (C,) N, scatter too much for rest."""
        spread = np.abs(rest - np.median(rest))
        if (spread > CERTAIN * errors + UNLIKE * np.abs(forces).max()).any():
            raise self._refuse(
                "its first frame is not at rest, so its overlaps do not determine the load: begin "
                "the dump at the strike, or name the input file as well"
            )

    def _infer_gravity(self, weights: Array, forces: Array, errors: Array) -> float:
        """Return gravity from the increase of forces at rest from grain to grain, m/s2."""
        if weights.size < FEWEST_CONTACTS:
            self._say("gravity", "none (too few contacts at rest to infer it)")
            return 0.0
        line = fit_line(weights, forces, errors)
        gravity = gravity_of(line, weights, forces)
        if not gravity:
            self._say("gravity", "none (the overlaps do not increase downward)")
            return 0.0
        self._say(
            "gravity",
            f"{gravity:.6g} m/s2 (from overlaps, assumed to be at rest, which increase as under "
            f"{abs(line.slope):.6g} +- {line.error:.1g})",
        )
        return gravity

    def _closed_load(self, chain: Chain, gravity: float) -> float:
        """Return the load of a column between two fixed ends, whose distance determines it, N."""
        top, bottom = self.ends
        overlaps = self._overlaps()
        weights = gravity * np.cumsum(chain.masses)
        law = chain.law
        walls = [
            (end, weight)
            for end, weight in ((top, 0.0), (bottom, float(weights[-1])))
            if end.kind == "wall"
        ]
        total = float(overlaps.sum()) + sum(end.overlap for end, _ in walls)

        def excess(load: float) -> float:
            squeezed = law.overlap(load + weights[:-1], chain.contacts.constant[1:-1]).sum()
            for end, weight in walls:
                squeezed += law.overlap(np.array(load + weight), np.array(end.constant))
            return float(squeezed) - total

        slack = self.grains.slack * len(weights) + REST_DIFFERENCE * abs(total)
        loose = 0.0 if bottom.kind == "free" else excess(0.0)
        if loose > slack:
            raise self._refuse(
                f"its column is {loose:.3g} m shorter than the space between its ends: let the "
                "grain at the top move, or take out the wall there"
            )
        if loose >= -self.grains.slack:
            self._say("load", "none")
            return 0.0
        load = load_between(excess)
        if not math.isfinite(load):
            raise self._refuse("is compressed more than any load can compress it")
        self._say("load", f"{load:.9g} N (from the distance of the ends, which do not move)")
        return load

    def _addforce(self) -> float | None:
        """Return the constant force of `fix addforce` on grain 1, N; None without such a fix."""
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
            if self.ends[0].kind == "wall":
                raise fix.line.refuse(
                    "presses grain 1, which touches a wall: a scene has a load or a wall at the "
                    "top, so take out one of them"
                )
            total = (total or 0.0) + down * self.source.units.force
            if total < 0:
                raise fix.line.refuse("pulls grain 1 out of the column: a load must press it down")
            self._say("load", f"{total:.9g} N on grain 1 ({_place(fix.line)})")
        return total

    # The scene ----------------------------------------------------------------------------------

    def understood(self) -> Understood:
        """Return the fields of the scene, and the findings about the run."""
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
            raise self._refuse(f"does not define a valid chain: {key}: {why}") from None
        self._say_grains(chain)
        displacement = self._displacement(chain, self._overlaps())
        excitation = self._excitation(chain, displacement)
        recording = self._recording()
        if self.source and (indices := self.source.text.indices):
            given = ", ".join(f"{key} = {value}" for key, value in indices.items())
            self._say("variables", f"{given}, as in the file: -var may have set others")
        if self.source and self.source.ignored:
            self._say("not read", f"{', '.join(self.source.ignored)}: no effect on the motion")
        fields = {"chain": chain, "excitation": excitation, **recording}
        style = self.source.units_name if self.source else ""
        return Understood(fields, self.facts, style or None)

    def _end_fields(self, gravity: float, load: float) -> dict[str, Any]:
        """Return the fields of both ends of the chain."""
        top, bottom = self.ends
        if bottom.kind == "free" and (gravity or load):
            if self._has_commands:
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
        for place, end, grain in (("top", top, 1), ("bottom", bottom, len(self.order))):
            text = {"free": "free", "held": f"grain {grain} is held"}.get(end.kind, "")
            if end.line:
                text = f"a wall, {end.constant:.6g} N/m^delta ({_place(end.line)})"
            elif end.kind == "wall":
                text = f"a wall of the grains' material is assumed, because grain {grain} moves"
            self._say(place, text)
        return fields

    def _say_grains(self, chain: Chain) -> None:
        d, masses = chain.diameters, chain.masses
        self._say("grains", f"diameter {span(d)} m, mass {span(masses)} kg")

    def _displacement(self, chain: Chain, overlaps: Array) -> Array:
        """Return the initial displacements from rest, (N,) m, and add a finding on their size."""
        rest = chain.equilibrium_overlap
        off = overlaps - rest
        slack = self.grains.slack + REST_DIFFERENCE * rest
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
            wall_slack = self.grains.slack + REST_DIFFERENCE * float(chain.contacts.overlap[-1])
            below = 0.0 if abs(below) <= wall_slack else below
        if bottom.kind == "free":
            return np.concatenate([[0.0], -np.cumsum(off)])
        displacement = below + np.concatenate([np.cumsum(off[::-1])[::-1], [0.0]])
        if self.ends[0].kind == "held":
            # The displacement of a held grain is only the rounding error of the sum.
            displacement[0] = 0.0
        return displacement

    def _excitation(self, chain: Chain, displacement: Array) -> Any:
        """Return the excitation with the displacements and velocities of the first frame."""
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
        """Return the duration and the number of samples."""
        options, grains = self.options, self.grains
        duration = options.duration or grains.duration
        if grains.steps is not None:
            self._refuse_given("follows from the dump", "duration", "samples")
            duration = self._dumped_time(grains.steps[1] - grains.steps[0])
        else:
            self._refuse_given("is in the run", "timestep")
        if not (duration > 0 and math.isfinite(duration)):
            raise InputError.at("duration", "is not in the run: give --duration, in s")
        samples = (grains.samples or 101) if options.samples is None else options.samples
        self._say("recording", f"{samples} samples to {duration:.9g} s")
        return {"duration": duration, "samples": samples}

    def _dumped_time(self, steps: int) -> float:
        """Return the time between the first and the last frame of a dump, s."""
        known = self.grains.duration
        if not known > 0 and self._has_commands and self.source:
            known = self.source.step_s * steps
        if known > 0:
            self._refuse_given("is in the run", "timestep")
            return known
        if self.options.timestep is None:
            raise InputError.at(
                "timestep", f"is not in the dump: give --timestep, in s{self._likely_step()}"
            )
        return self.options.timestep * steps

    def _likely_step(self) -> str:
        step = self.grains.likely_step
        return f" (its velocities suggest {step:.3g})" if step else ""

    def _say(self, fact: str, text: str) -> None:
        """Add a finding about the run."""
        self.facts = [each for each in self.facts if each[0] != fact]
        self.facts.append((fact, text))


def _reverse(value: Any) -> Any:
    """Return an array in reverse, also inside a table; return other values unchanged."""
    if isinstance(value, dict):
        return {key: _reverse(item) for key, item in value.items()}
    return value[::-1] if isinstance(value, np.ndarray) else value


def _one_or_many(values: Array) -> Any:
    """Return one number if all are equal up to rounding, otherwise all numbers."""
    alike = np.ptp(values) <= EQUAL * np.abs(values).max()
    return float(values[0]) if alike else values


def _place(line: InputLine) -> str:
    return f"line {line.number}"
