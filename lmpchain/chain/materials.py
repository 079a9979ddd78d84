"""Elastic materials, by name or by their elastic constants, and grains of other materials."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import did_you_mean, shown
from ..util.validation import NOT_GIVEN, Checked, Positive, Real, Whole, each

# Smaller values are implausible; they are probably given in GPa or g/cm3.
LEAST_MODULUS = 1e6  # Pa
LEAST_DENSITY = 100.0  # kg/m3


class Material(Checked):
    """An elastic material.

    Parameters
    ----------
    density : float
        Density, kg/m3.
    youngs_modulus : float
        Young's modulus, Pa.
    poissons_ratio : float
        Poisson's ratio, between -1 and 0.5.
    name, source : str
        Name in scene files; source of the values.
    """

    density: Positive
    youngs_modulus: Positive
    poissons_ratio: Annotated[Real, Field(gt=-1, le=0.5)]
    name: str = ""
    source: str = ""

    def _remarks(self) -> Iterator[str]:
        if self.youngs_modulus < LEAST_MODULUS:
            soft = f"{self.youngs_modulus:g} Pa is softer than rubber"
            yield f"youngs_modulus: {soft}; moduli are in pascals (62 GPa is 62e9)"
        if self.density < LEAST_DENSITY:
            light = f"{self.density:g} kg/m3 is lighter than foam"
            yield f"density: {light}; densities are in kg/m3 (2.4 g/cm3 is 2400)"

    def __repr__(self) -> str:
        return f"Material({self.name!r})" if self.name else super().__repr__()

    __str__ = __repr__

    @property
    def sound_speed(self) -> float:
        """Speed of sound in a thin bar, sqrt(E / rho), m/s.

        Examples
        --------
        >>> round(GLASS.sound_speed)
        5055
        """
        return math.sqrt(self.youngs_modulus / self.density)

    @property
    def elastic(self) -> tuple[float, float, float]:
        """Density, Young's modulus and Poisson's ratio: all properties that a chain depends on."""
        return self.density, self.youngs_modulus, self.poissons_ratio

    @property
    def plane_strain_modulus(self) -> float:
        """Plane-strain modulus E / (1 - nu^2), Pa."""
        return self.youngs_modulus / (1 - self.poissons_ratio**2)


def _material(name: str, density: float, youngs: float, poisson: float, source: str) -> Material:
    return Material(
        density=density, youngs_modulus=youngs, poissons_ratio=poisson, name=name, source=source
    )


GLASS = _material("glass", 2426.0, 62e9, 0.2, "Gerasymov and Spivak, caption of Fig. 5")
STEEL = _material(
    "steel",
    8000.0,
    193e9,
    0.3,
    "AISI 316, data sheet for annealed bar; nu as usual for 300-series steels",
)
PTFE = _material(
    "ptfe",
    2200.0,
    1.46e9,
    0.46,
    "as usual in work on granular chains; data sheets give 0.4 to 2.3 GPa",
)
BRASS = _material(
    "brass",
    8500.0,
    103e9,
    0.34,
    "textbook values for 80/20 brass (15e6 psi, 0.34) and the usual density",
)
TUNGSTEN_CARBIDE = _material(
    "tungsten_carbide",
    14900.0,
    625e9,
    0.21,
    "from the sound speeds of calibration spheres, 6853 and 4171 m/s (Foote 1990)",
)
# The properties of a manufactured ball differ from its data sheet by a few per cent, more in E than
# in density.
ALUMINIUM = _material(
    "aluminium",
    2700.0,
    68.9e9,
    0.33,
    "6061-T6: density of the ASM tables, 10.0e6 psi and 0.33 of Multimedia Engineering Mechanics",
)
STEEL_302 = _material(
    "steel_302",
    7860.0,
    193e9,
    0.30,
    "AISI 302, annealed: density of the ASM tables, 28e6 psi and 0.30 of Multimedia Engineering "
    "Mechanics",
)
STEEL_440C = _material(
    "steel_440c",
    7650.0,
    200e9,
    0.28,
    "AISI 440C of bearing balls: density and E of the sheet of quest4alloys, nu of makeitfrom.com",
)
BRONZE = _material(
    "bronze",
    8860.0,
    110e9,
    0.34,
    "phosphor bronze C51000: density and E of the data sheet of Olin Brass, nu of makeitfrom.com",
)
# Polymers creep, and are stiffer in an impact of microseconds than on a testing machine.
POM = _material(
    "pom",
    1410.0,
    3.0e9,
    0.35,
    "acetal homopolymer (Delrin): Engineering Plastics Handbook, table 5.5; nu of DuPont's guide",
)
NYLON = _material(
    "nylon",
    1140.0,
    2.7e9,
    0.40,
    "nylon 6/6, extruded, dry (half of E if moist): density and 390e3 psi of engineersedge.com, nu "
    "of Multimedia Engineering Mechanics",
)
SODA_LIME_GLASS = _material(
    "soda_lime_glass",
    2500.0,
    72e9,
    0.23,
    "float glass, technical bulletin ATS-129 of Pilkington (2013)",
)
# Hertz's law holds for rubber at small strains only. Y. Tatara, J. Eng. Mater. Technol. 113, 285
# (1991), finds that forces exceed it in large compression. A chain warns if an overlap exceeds 1 %
# of the diameter.
RUBBER = _material(
    "rubber",
    1100.0,
    2.8e6,
    0.48,
    "average of rubbers: 0.4e3 psi and 0.48 of textbook tables, density between 960 and 1280 "
    "(Gere); for small strains only",
)
MATERIALS = {
    material.name: material
    for material in (
        GLASS,
        SODA_LIME_GLASS,
        STEEL,
        STEEL_302,
        STEEL_440C,
        ALUMINIUM,
        BRASS,
        BRONZE,
        TUNGSTEN_CARBIDE,
        PTFE,
        POM,
        NYLON,
        RUBBER,
    )
}
# Other names of materials, in lower case without spaces and punctuation.
SYNONYMS = {
    "aluminum": "aluminium",
    "al": "aluminium",
    "al6061": "aluminium",
    "6061": "aluminium",
    "stainlesssteel": "steel",
    "316": "steel",
    "steel316": "steel",
    "aisi316": "steel",
    "302": "steel_302",
    "aisi302": "steel_302",
    "440c": "steel_440c",
    "aisi440c": "steel_440c",
    "bearingsteel": "steel_440c",
    "phosphorbronze": "bronze",
    "teflon": "ptfe",
    "delrin": "pom",
    "acetal": "pom",
    "polyoxymethylene": "pom",
    "nylon66": "nylon",
    "pa66": "nylon",
    "polyamide": "nylon",
    "sodalime": "soda_lime_glass",
    "floatglass": "soda_lime_glass",
    "wc": "tungsten_carbide",
}


def sphere_mass(density: Any, diameter: Any) -> Any:
    """Return the mass of spheres of this density, kg/m3, and diameter, m: (...) kg."""
    return density * np.pi / 6 * diameter**3


def _letters(name: str) -> str:
    """Return a name in lower case, without spaces and punctuation."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


_BY_LETTERS = {_letters(name): name for name in MATERIALS} | SYNONYMS


def named(name: object) -> Material | None:
    """Return the material of this name, ignoring case, spaces and punctuation; None if unknown.

    Examples
    --------
    >>> named("Soda-lime glass"), named("aluminum"), named("Delrin"), named("440C")
    (Material('soda_lime_glass'), Material('aluminium'), Material('pom'), Material('steel_440c'))
    >>> named("wood") is None
    True
    """
    known = _BY_LETTERS.get(_letters(name)) if isinstance(name, str) else None
    return MATERIALS[known] if known else None


# Scene files contain names and tables; Python may also pass materials.
def one_material(value: Any) -> Material:
    """Return a material, given itself, by its name or as a table."""
    if isinstance(value, Material):
        return value
    if isinstance(value, dict):
        return Material(**value)
    if material := named(value):
        return material
    raise ValueError(
        f"no material is called {shown(value)}{did_you_mean(value, [*MATERIALS, *SYNONYMS])}; "
        f"use {', '.join(MATERIALS)}, or a table of its constants"
    )


def _one_or_many_materials(value: Any) -> Material | tuple[Material, ...]:
    if isinstance(value, list | tuple):
        return tuple(one_material(item) for item in value)
    return one_material(value)


OneOrManyMaterials = Annotated[
    Material | str | dict | Sequence[Material | str | dict], BeforeValidator(_one_or_many_materials)
]
OneMaterial = Annotated[Material | str | dict, BeforeValidator(one_material)]


class Impurity(Checked):
    """A grain that differs from the others in diameter, material or mass.

    Parameters
    ----------
    grain : int
        Number of the grain, from 1 at the top.
    diameter : float, optional
        Diameter, m; by default the diameter of the other grains.
    material : Material or name, optional
        Material; by default the material of the other grains.
    mass : float, optional
        Mass, kg; by default it follows from diameter and material.
    """

    grain: Annotated[Whole, Field(ge=1)]
    diameter: Positive = NOT_GIVEN
    material: OneMaterial = NOT_GIVEN
    mass: Positive = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.diameter is None and self.material is None and self.mass is None:
            yield (
                "diameter",
                "give a diameter, a material or a mass that differs from the other grains",
            )


def _impurities(value: Any) -> tuple[Impurity, ...]:
    if not isinstance(value, list | tuple) or not all(
        isinstance(item, Impurity | dict) for item in value
    ):
        raise ValueError("must be a list of impurities, [[chain.impurity]] in a scene file")
    return each(value, lambda item: item if isinstance(item, Impurity) else Impurity(**item))


Impurities = Annotated[tuple[Impurity, ...], BeforeValidator(_impurities)]


def misfits(
    impurities: Sequence[Impurity], grains: int, constants_given: bool
) -> Iterator[tuple[str, str]]:
    """Yield the faults of impurities in a chain of this length."""
    for place, impurity in enumerate(impurities):
        if impurity.grain > grains:
            yield (
                f"impurity.{place}.grain",
                f"there is no grain {impurity.grain}: the chain has {grains}",
            )
        elif impurity.grain in [other.grain for other in impurities[:place]]:
            yield (
                f"impurity.{place}.grain",
                f"repeats grain {impurity.grain}: give each impurity once",
            )
        # A contact constant would have to change with the impurity, but the constants are given.
        elif constants_given and (impurity.diameter or impurity.material):
            yield (
                f"impurity.{place}",
                "may only have its own mass if contact_constants are given, because an impurity "
                "does not change these constants: leave out its diameter and material",
            )


def with_impurities(
    values: Any,
    impurities: Sequence[Impurity],
    own: Callable[[Impurity], float | None],
    grains: int,
) -> Any:
    """Return values (..., N) with the values of impurities, or one value if all are equal."""
    if not impurities:
        return values
    changed = np.array(np.broadcast_to(values, (*np.shape(values)[:-1], grains)), dtype=float)
    for impurity in impurities:
        if (value := own(impurity)) is not None:
            changed[..., impurity.grain - 1] = value
    return changed


class Kinds(NamedTuple):
    """The kinds of grains of a chain: the common grain and every impurity.

    Attributes
    ----------
    materials : list of Material
        Material of each kind.
    diameters, masses : list of float
        Diameter of each kind, m; mass of each kind, kg.
    """

    materials: list[Material]
    diameters: list[float]
    masses: list[float]

    @property
    def moduli(self) -> list[float]:
        """Plane-strain modulus E / (1 - nu^2) of every kind, Pa."""
        return [material.plane_strain_modulus for material in self.materials]


def kinds(material: Material, diameter: float, impurities: Sequence[Any]) -> Kinds:
    """Return the kinds of grains of a chain with this common grain."""
    materials = [material, *(impurity.material or material for impurity in impurities)]
    diameters = [diameter, *(impurity.diameter or diameter for impurity in impurities)]
    own_masses = [None, *(impurity.mass for impurity in impurities)]
    # A power of a Python float raises an exception on overflow, but a numpy float becomes infinite.
    with np.errstate(over="ignore"):
        masses = [
            mass or float(sphere_mass(kind.density, np.float64(width)))
            for kind, width, mass in zip(materials, diameters, own_masses, strict=True)
        ]
    return Kinds(materials, diameters, masses)
