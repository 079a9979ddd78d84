"""Contact models of a LAMMPS input in SI units, and the contact forces in a column.

The supported models are hooke, hertz and hertz/material of `pair_style granular` and
`fix wall/gran`, and the older styles gran/hooke, gran/hooke/history and gran/hertz/history.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..chain.contact_law import pair_value, reduced
from ..chain.formula import Formula, multiply, name, number, parse
from ..chain.law import Law
from ..chain.materials import Material, sphere_mass
from ..errors import InputError, either
from ..util.arrays import Array
from ..util.units import Units
from .lammps_input import LammpsInput
from .lammps_text import InputLine

# Number of coefficients after the name of a model.
NORMAL = {"hooke": 2, "hertz": 2, "hertz/material": 3}
TANGENTIAL = {
    "linear_nohistory": 2,
    "linear_history": 3,
    "linear_history_classic": 3,
    "mindlin": 3,
    "mindlin_classic": 3,
    "mindlin/force": 3,
    "mindlin_rescale": 3,
    "mindlin_rescale/force": 3,
}
TURNING = {"none": 0, "marshall": 0, "sds": 3}
OF_RESTITUTION = ("coeff_restitution", "tsuji")
KEYWORDS = ("tangential", "rolling", "twisting", "damping", "heat", "cutoff", "limit_damping")
PLANES = ("xplane", "yplane", "zplane")
COHESIVE = ("dmt", "jkr", "mdr")
OLD_STYLES = {
    "gran/hooke": "hooke",
    "gran/hooke/history": "hooke",
    "gran/hertz/history": "hertz",
}
OLD_WALLS = {"hooke": "hooke", "hooke/history": "hooke", "hertz/history": "hertz"}


ReadNumber = Callable[[str, InputLine], float]


class GrainForce(NamedTuple):
    """A contact model with its coefficients, in the units of the input.

    Attributes
    ----------
    line : InputLine
        The command that defines the model, for messages.
    model : str
        "hertz" for the force k sqrt(R o) o of an overlap o, with the reduced radius R, or "hooke"
        for the force k o.
    stiffness : float
        The coefficient k; NaN for a material, because k then depends on both grains.
    damping : float
        Coefficient of the damping force.
    damped_by : str
        Name of the damping model.
    elastic : (float, float) or None
        Young's modulus and Poisson's ratio of the model hertz/material; otherwise None.
    """

    line: InputLine
    model: str
    stiffness: float
    damping: float
    damped_by: str
    elastic: tuple[float, float] | None = None

    @property
    def damped(self) -> bool:
        """Whether the contact dissipates energy.

        The coefficient of coeff_restitution and tsuji is that of restitution. The polynomial of
        tsuji dissipates 3e-4 of the critical damping even at 1.
        """
        if self.damped_by in OF_RESTITUTION:
            return self.damping != 1.0 or self.damped_by == "tsuji"
        return self.damping != 0.0

    @property
    def normal(self) -> float:
        """The stiffness k between two grains of this model, which LAMMPS also uses at a wall."""
        if self.elastic is None:
            return self.stiffness
        modulus, ratio = self.elastic
        return 4 / 3 * modulus / (2 * (1 - ratio**2))

    def with_other(self, other: GrainForce) -> GrainForce:
        """Return the model that LAMMPS uses for two types without their own coefficients."""
        if (self.model, self.damped_by) != (other.model, other.damped_by) or (
            (self.elastic is None) != (other.elastic is None)
        ):
            raise self.line.refuse(
                "has another contact model than the other types: add a pair_coeff for the pair"
            )
        damping = math.sqrt(abs(self.damping * other.damping))
        if self.elastic and other.elastic:
            pair = (self.elastic, other.elastic)
            soft, hard = (modulus / (1 - ratio**2) for modulus, ratio in pair)
            stiffness = 4 / 3 * reduced(soft, hard)
        else:
            stiffness = math.sqrt(self.stiffness * other.stiffness)
        return GrainForce(self.line, self.model, stiffness, damping, self.damped_by)

    def constant(self, radius: float, units: Units) -> float:
        """Return the constant K of the force K o^delta at a reduced radius, m, in N/m^delta."""
        if self.model == "hooke":
            return self.normal * units.force / units.length
        return self.normal * units.pressure * math.sqrt(radius)

    def relaxation(self, mass: float, units: Units) -> float:
        """Return the relaxation time of viscoelastic damping at a reduced mass, kg, in s."""
        if not self.damped:
            return 0.0
        k = self.normal
        if self.model == "hertz" and self.damped_by == "viscoelastic":
            return self.damping * mass / units.mass / (1.5 * k) * units.time
        if self.model == "hooke" and self.damped_by == "mass_velocity":
            return self.damping * mass / units.mass / k * units.time
        if self.model == "hooke" and self.damped_by == "velocity":
            return self.damping / k * units.time
        cure = "viscoelastic for hertz, velocity or mass_velocity for hooke"
        if self.damped_by not in OF_RESTITUTION:
            cure += ", or a coefficient of 0"
        raise self.line.refuse(f"has an unsupported damping {self.damped_by}: use {cure}")


def read_model(
    line: InputLine, words: Sequence[str], number: ReadNumber
) -> tuple[GrainForce, list[str]]:
    """Return a model of `granular` from its words, and the words after it."""
    if not words:
        raise line.refuse("is too short: a contact model is missing")
    name = words[0]
    if name in COHESIVE:
        raise line.refuse(f"has cohesion ({name}), which a scene does not support: use hertz")
    if name not in NORMAL:
        raise line.refuse(f"has no known contact model: use {', '.join(NORMAL)}")
    values, rest = _take(line, words, NORMAL[name])
    first, eta, *ratio = (number(value, line) for value in values)
    damped_by = "viscoelastic"
    while rest and rest[0] in KEYWORDS:
        word = rest[0]
        if word == "damping":
            (damped_by,), rest = _take(line, rest, 1)
        elif word == "limit_damping":
            rest = _without_limit(line, eta, rest)
        else:
            rest = _skip(line, rest)
    if not first > 0:
        raise line.refuse(f"must have a stiffness above 0 (got {first:g})")
    if name == "hertz/material":
        elastic = (first, ratio[0])
        if not -1 < ratio[0] <= 0.5:
            raise line.refuse(f"must have a Poisson's ratio of at most 0.5 (got {ratio[0]:g})")
        return GrainForce(line, "hertz", math.nan, eta, damped_by, elastic), list(rest)
    return GrainForce(line, name, first, eta, damped_by), list(rest)


def read_old_model(
    line: InputLine, model: str, words: Sequence[str], number: ReadNumber
) -> tuple[GrainForce, list[str]]:
    """Return a model of gran/... from the words Kn Kt gamma_n ..., and the words after them."""
    values, rest = _take(line, ["", *words], 6)
    stiffness, damping = number(values[0], line), number(values[2], line)
    if not stiffness > 0:
        raise line.refuse(f"must have a stiffness above 0 (got {stiffness:g})")
    if rest[:1] == ["limit_damping"]:
        rest = _without_limit(line, damping, rest)
    damped_by = "viscoelastic" if model == "hertz" else "mass_velocity"
    return GrainForce(line, model, stiffness, damping, damped_by), rest


def read_wall(
    line: InputLine, words: Sequence[str], number: ReadNumber
) -> tuple[GrainForce, list[str]]:
    """Return the model of `fix wall/gran`, and its last words: plane type and two positions."""
    given = [word for word in words if word != "contacts"]
    style = given[0] if given else ""
    if style == "granular":
        model, rest = read_model(line, given[1:], number)
    elif style in OLD_WALLS:
        model, rest = read_old_model(line, OLD_WALLS[style], given[1:], number)
    else:
        raise line.refuse(f"has no known contact style: use granular, {', '.join(OLD_WALLS)}")
    if len(rest) != 3 or rest[0] not in PLANES:
        raise line.refuse(f"must end in {either(PLANES)} and two positions")
    return model, rest


def _skip(line: InputLine, words: list[str]) -> list[str]:
    """Return the words after a force that has no effect in a straight column."""
    word = words[0]
    kind = words[1] if len(words) > 1 else ""
    if word == "cutoff" or (word == "heat" and kind != "none"):
        raise line.refuse(f"has {word}, which a scene does not support: remove it")
    models = TANGENTIAL if word == "tangential" else TURNING
    if kind not in models:
        raise line.refuse(f"has {word} {kind}, which is not one of {', '.join(models)}")
    return _take(line, words[1:], models[kind])[1]


def _without_limit(line: InputLine, damping: float, words: list[str]) -> list[str]:
    """Return the words after limit_damping, which has no effect without damping."""
    if damping:
        raise line.refuse("has limit_damping, which a scene does not support: remove it")
    return words[1:]


def _take(line: InputLine, words: Sequence[str], count: int) -> tuple[list[str], list[str]]:
    """Return this number of words after the first one, and the rest."""
    if len(words) <= count:
        raise line.refuse("is too short")
    return list(words[1 : count + 1]), list(words[count + 1 :])


TOWER = re.compile(r"\^[^-+*/(,;]*\^")  # Matches x^y^z, which is ambiguous.
SAME_DENSITY = 1e-12  # Relative difference of densities of one material, caused by rounding.


@dataclass
class ColumnGrains:
    """The grains of a column in their order along its axis.

    Attributes
    ----------
    numbers : (N,) int array
        Atom numbers.
    types : (N,) int array
        Atom types.
    diameters : (N,) array
        Diameters, m.
    masses : (N,) array
        Masses, kg.
    frozen : (N,) bool array
        Mask of the grains of `fix freeze`, which LAMMPS treats as infinitely heavy.
    """

    numbers: np.ndarray
    types: np.ndarray
    diameters: Array
    masses: Array
    frozen: np.ndarray


class ColumnForces(NamedTuple):
    """Contacts of a column, with findings about them.

    Attributes
    ----------
    line : InputLine
        The command that defines the contacts.
    text : str
        Description of the contacts.
    fields : dict
        Fields of a chain that define its contacts.
    model : str
        Kind of contacts: "hertz", "hooke" or "bond".
    relaxations : (N-1,) array
        Relaxation times of viscoelastic damping, s.
    diameters : (N,) array
        Diameters, m. For bonds, the means of neighbouring diameters are the rest lengths.
    """

    line: InputLine
    text: str
    fields: dict[str, Any]
    model: str
    relaxations: Array
    diameters: Array


def span(values: Array) -> str:
    """Return one number, or the smallest and the largest, as text."""
    low, high = (f"{value:.6g}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"


def pair_forces(source: LammpsInput, grains: ColumnGrains) -> ColumnForces:
    """Return the contacts that the pair style of an input defines."""
    assert source.state.pair is not None
    line, words = source.state.pair
    pairs = list(pairwise(grains.types.tolist()))
    # A dictionary preserves the order of types, and so the order in messages.
    models = {pair: _pair_model(source, line, words, *pair) for pair in dict.fromkeys(pairs)}
    chosen = [models[pair] for pair in pairs]
    kinds = {model.model for model in chosen}
    if len(kinds) > 1:
        raise line.refuse("has both hertz and hooke contacts: a scene has one contact law")
    units = source.units
    radii = pair_value(grains.diameters / 2)
    heavy = pair_value(np.where(grains.frozen, math.inf, grains.masses))
    rows = list(zip(chosen, radii.tolist(), heavy.tolist(), strict=True))
    constants = np.array([model.constant(radius, units) for model, radius, _ in rows])
    relaxations = np.array([model.relaxation(mass, units) for model, _, mass in rows])
    hertz = kinds == {"hertz"}
    fields: dict[str, Any] = {"masses": grains.masses, "contact_constants": constants}
    if material := _one_material(source, chosen, grains):
        fields = {"material": material}
    if not hertz:
        fields["exponent"] = 1.0
    text = f"Hertz, {span(constants)} N/m^1.5" if hertz else f"springs, {span(constants)} N/m"
    return ColumnForces(line, text, fields, chosen[0].model, relaxations, grains.diameters)


def _pair_model(
    source: LammpsInput, line: InputLine, words: Sequence[str], first: int, second: int
) -> GrainForce:
    """Return the contact model of two types of grains."""
    style = words[0]
    read = source.text.number
    if style in OLD_STYLES:
        model, rest = read_old_model(line, OLD_STYLES[style], words[1:], read)
        where = line
    elif style != "granular":
        cure = f"granular, {', '.join(OLD_STYLES)}"
        raise line.refuse(f"is not a supported pair style: use {cure}")
    elif own := source.pair_lines(first, second):
        where = own[0]
        model, rest = read_model(*own, read)
    elif first == second or None in [source.pair_lines(kind, kind) for kind in (first, second)]:
        raise line.refuse(f"has no pair_coeff for types {first} and {second}")
    else:
        one, other = (_pair_model(source, line, words, kind, kind) for kind in (first, second))
        return one.with_other(other)
    if rest:
        raise where.refuse(f"has {rest[0]}, which is not understood")
    return model


def _one_material(
    source: LammpsInput, models: list[GrainForce], grains: ColumnGrains
) -> Material | None:
    """Return the common material of all grains if the input names one; None otherwise."""
    densities = grains.masses / sphere_mass(1.0, grains.diameters)
    first = models[0].elastic
    alike = np.ptp(densities) <= SAME_DENSITY * densities[0]
    if first is None or not alike or any(model.elastic != first for model in models):
        return None
    return Material(
        density=float(f"{densities[0]:.12g}"),
        youngs_modulus=first[0] * source.units.pressure,
        poissons_ratio=first[1],
    )


def bond_forces(source: LammpsInput, grains: ColumnGrains) -> ColumnForces:
    """Return the contacts that the bonds of an input define."""
    assert source.state.bond is not None
    line, (style, *_) = source.state.bond
    rows = list(_bond_rows(source, line, grains))
    if np.isnan(grains.masses).any() or (grains.masses <= 0).any():
        raise line.refuse("bonds grains without a mass: write `mass` or `set ... mass`")
    units = source.units
    read = source.text.number
    length_place = 1 if style == "harmonic" else 0
    lengths = units.length * np.array([read(words[length_place], at) for at, words in rows])
    fields: dict[str, Any] = {"masses": grains.masses}
    if style == "harmonic":
        # The energy is K (r - r0)^2.
        stiffness = 2 * np.array([read(words[0], at) for at, words in rows])
        constants = stiffness * units.force / units.length
        fields |= {"law": Law("k*o"), "contact_constants": constants}
        text = f"harmonic bonds, {span(constants)} N/m"
    else:
        formulas = {" ".join(words[1:]) for _, words in rows}
        if len(formulas) > 1:
            raise line.refuse("has several formulas: a scene has one contact law")
        fields["law"] = _lepton_law(rows[0][0], formulas.pop(), units.length, units.force)
        text = f"bonds, force {fields['law'].text}"
    diameters = _bond_diameters(line, lengths, grains.diameters)
    return ColumnForces(line, text, fields, "bond", np.zeros(len(rows)), diameters)


def _bond_rows(
    source: LammpsInput, line: InputLine, grains: ColumnGrains
) -> Iterator[tuple[InputLine, list[str]]]:
    """Yield the coefficients of the bond of every grain with the next one."""
    place = {int(n): k for k, n in enumerate(grains.numbers)}
    kinds: dict[int, int] = {}
    for bond in source.state.bonds:
        both = f"bonds atoms {bond.first} and {bond.second}"
        ends = sorted(place.get(n, -2) for n in (bond.first, bond.second))
        if ends[0] < 0 or ends[1] - ends[0] != 1:
            raise line.refuse(f"{both}, which are not neighbours")
        if ends[0] in kinds:
            raise line.refuse(f"{both} twice")
        kinds[ends[0]] = bond.kind
    for k, (first, second) in enumerate(pairwise(grains.numbers.tolist())):
        if k not in kinds:
            raise line.refuse(f"has no readable bond between atom {first} and atom {second}")
        row = source.state.bond_coefficients.get(kinds[k])
        if row is None or len(row[1]) < 2:
            raise line.refuse(f"has no readable bond_coeff for type {kinds[k]}")
        yield row


def _bond_diameters(line: InputLine, lengths: Array, diameters: Array) -> Array:
    """Return diameters of grains, (N,) m, whose means are the rest lengths of the bonds."""
    if not (lengths > 0).all():
        raise line.refuse("has a rest length that is not above 0")
    means = (diameters[:-1] + diameters[1:]) / 2
    if (np.abs(means - lengths) <= 1e-12 * lengths).all():
        return diameters
    if not np.ptp(lengths):
        return np.full(lengths.size + 1, lengths[0])
    # d_(n+1) = 2 L_n - d_n, so that d_n = s_n (d_1 - a_n) with alternating signs s_n.
    signs = (-1.0) ** np.arange(lengths.size + 1)
    sums = np.concatenate([[0.0], np.cumsum(2 * lengths * signs[:-1])])
    low = float(sums[signs > 0].max())
    high = float(sums[signs < 0].min())
    if not low < high:
        raise line.refuse("has rest lengths that are impossible in a row of touching grains")
    return np.asarray(signs * ((low + high) / 2 - sums))


def _lepton_law(line: InputLine, text: str, length: float, force: float) -> Law:
    """Return the contact law for an energy of `bond_style lepton`, a formula of r = -overlap.

    The returned law is the text that the parser prints from its syntax tree, never the given text.
    """
    if TOWER.search(text):
        raise line.refuse("has a power of a power: add brackets")
    energy, *definitions = (part.strip() for part in text.replace("^", "**").split(";"))
    named: dict[str, Formula] = {}
    try:
        # A definition may use the definitions after it.
        for definition in reversed([each for each in definitions if each]):
            key, _, value = definition.partition("=")
            named[key.strip()] = parse(value.strip()).substitute(named)
        formula = parse(energy).substitute(named)
        # The energy is a function of r in units of the input, the law one of o in m.
        found = formula.substitute({"r": multiply(number(-1 / length), name("o"))})
        law = multiply(number(length * force), found.derivative("o")).text
    except InputError as error:
        raise line.refuse(f"has a formula that is not understood: {error.faults[0][1]}") from None
    except ArithmeticError:
        raise line.refuse("has a formula that is not understood") from None
    if unknown := set(formula.names) - {"r"}:
        raise line.refuse(f"has a formula with {min(unknown)}, which is not defined")
    try:
        return Law(law)
    except InputError as error:
        raise line.refuse(f"does not define a contact law: {error.faults[0][1]}") from None
