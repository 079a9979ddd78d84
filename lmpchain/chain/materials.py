"""Elastic materials, by name or by their elastic constants."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ..errors import shown
from ..util.suggestions import did_you_mean
from ..util.validation import Checked, Positive, Real

# of grains that may be meant; what is below is given in GPa or g/cm3 as a rule
LEAST_MODULUS = 1e6  # Pa
LEAST_DENSITY = 100.0  # kg/m3


class Material(Checked):
    """An elastic material.

    Parameters
    ----------
    density : float
        kg/m3.
    youngs_modulus : float
        Pa.
    poissons_ratio : float
        Between -1 and 0.5.
    name, source : str
        What it is called in scene files, and where the numbers come from.
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
        """Density, Young's modulus and Poisson's ratio: all that a chain takes of it."""
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
MATERIALS = {m.name: m for m in (GLASS, STEEL, PTFE, BRASS, TUNGSTEN_CARBIDE)}


# a scene file has names and tables, Python may have materials
def one_material(value: Any) -> Material:
    """Return a material, or the one of this name or of this table."""
    if isinstance(value, Material):
        return value
    if isinstance(value, dict):
        return Material(**value)
    if isinstance(value, str) and value in MATERIALS:
        return MATERIALS[value]
    raise ValueError(
        f"no material is called {shown(value)}{did_you_mean(value, MATERIALS)}; "
        f"use {', '.join(MATERIALS)}, or give density, youngs_modulus and poissons_ratio"
    )


def _one_or_many_materials(value: Any) -> Material | tuple[Material, ...]:
    if isinstance(value, list | tuple):
        return tuple(one_material(item) for item in value)
    return one_material(value)


OneOrManyMaterials = Annotated[
    Material | str | dict | Sequence[Material | str | dict], BeforeValidator(_one_or_many_materials)
]
OneMaterial = Annotated[Material | str | dict, BeforeValidator(one_material)]
