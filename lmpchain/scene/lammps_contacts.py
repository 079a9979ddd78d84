"""Contact models of LAMMPS as an input file names them, with their constants in SI units.

The supported models are hooke, hertz and hertz/material of `pair_style granular` and
`fix wall/gran`, and the older styles gran/hooke, gran/hooke/history and gran/hertz/history.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..chain.contacts import reduced
from ..util.lammps_units import Units
from ..util.suggestions import either
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
        """Whether the contact dissipates energy."""
        lossless = 1.0 if self.damped_by == "coeff_restitution" else 0.0
        return self.damping != lossless

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
        cure = "viscoelastic for hertz, velocity or mass_velocity for hooke, or a coefficient of 0"
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
