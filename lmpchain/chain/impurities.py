"""Impurities: grains of a chain that differ from the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from ..util.validation import NOT_GIVEN, Checked, Positive, Whole, each
from .materials import Material, OneMaterial, sphere_mass


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
