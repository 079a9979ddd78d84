"""Contact forces in a column from the pair style or the bonds of a LAMMPS input."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..chain.contacts import pair_value
from ..chain.formula import Formula, multiply, name, number, parse
from ..chain.law import Law
from ..chain.materials import Material, sphere_mass
from ..errors import InputError
from ..util.arrays import Array
from .lammps_contacts import OLD_STYLES, GrainForce, read_model, read_old_model
from .lammps_input import LammpsInput
from .lammps_text import InputLine

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
