"""Grains of a chain that differ from the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import InputError
from ..util.arrays import Array
from ..util.validation import NOT_GIVEN, Checked, Positive, Whole
from .materials import OneMaterial


class Impurity(Checked):
    """A grain that differs from the others in diameter, material or mass.

    Parameters
    ----------
    grain : int
        Its number, from 1 at the top.
    diameter : float, optional
        m.
    material : Material or name, optional
    mass : float, optional
        kg; instead of the one that follows from diameter and material.
    """

    grain: Annotated[Whole, Field(ge=1)]
    diameter: Positive = NOT_GIVEN
    material: OneMaterial = NOT_GIVEN
    mass: Positive = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.diameter is None and self.material is None and self.mass is None:
            yield (
                "diameter",
                "give a diameter, a material or a mass, or it would be a grain like the others",
            )


def _impurities(value: Any) -> tuple[Impurity, ...]:
    if not isinstance(value, list | tuple) or not all(
        isinstance(item, Impurity | dict) for item in value
    ):
        raise ValueError("must be a list of impurities, [[chain.impurity]] in a scene file")
    made, faults = [], []
    for place, item in enumerate(value):
        try:
            made.append(item if isinstance(item, Impurity) else Impurity(**item))
        except InputError as error:
            faults += error.under(str(place))
    if faults:
        raise InputError(faults)
    return tuple(made)


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
            yield f"impurity.{place}.grain", f"names grain {impurity.grain} a second time"
        elif constants_given and (impurity.diameter or impurity.material):
            yield (
                f"impurity.{place}",
                "may only have a mass of its own where contact_constants are given: they would not follow",
            )


def with_impurities(values: Array, impurities: Sequence[Impurity], key: str) -> Array:
    """Return a copy of the values (..., N) with those that impurities have of their own."""
    changed = np.array(values, dtype=float)
    for impurity in impurities:
        if (value := getattr(impurity, key)) is not None:
            changed[..., impurity.grain - 1] = value
    return changed


def kinds(material: Any, diameter: Any, impurities: Sequence[Impurity]) -> Array:
    """Return modulus, diameter and mass of a common grain and every impurity, (3, I+1)."""
    columns = []
    for impurity in (None, *impurities):
        kind = getattr(impurity, "material", None) or material
        width = getattr(impurity, "diameter", None) or diameter
        mass = getattr(impurity, "mass", None)
        with np.errstate(over="ignore"):  # a Python float would raise
            sphere = kind.density * np.pi / 6 * np.float64(width) ** 3
        columns.append((kind.plane_strain_modulus, width, mass or sphere))
    return np.array(columns).T
