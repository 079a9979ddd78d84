"""Bounds on a chain of grains that are alike but for a few, known before its arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from .contacts import free_approach, hertz_constant
from .impurities import Impurity
from .materials import Material
from .plausible import LIMITS

ROUNDING = 1 + 1e-9  # on bounds: where all grains are alike they are reached


class Bounds(NamedTuple):
    """Bounds on the grains of a chain and on all of its contacts.

    Attributes
    ----------
    softest, hardest : float
        Constants of contacts, N/m^delta.
    lightest, heaviest : float
        Masses, kg.
    narrowest : float
        Diameter, m.
    slowest : float
        Speed of sound in a grain, m/s.
    overlap : float
        At rest at most, m.
    exponent : float
        delta.
    """

    softest: float
    hardest: float
    lightest: float
    heaviest: float
    narrowest: float
    slowest: float
    overlap: float
    exponent: float

    @property
    def compression(self) -> float:
        """Overlap over diameter at rest, at most."""
        return self.overlap / self.narrowest

    def struck(self, speed: float) -> float:
        """Return a bound on overlaps at rest and in the first collision at this speed, m."""
        energy = self.heaviest * speed * speed / 2  # of two grains it is half of that at most
        collision = free_approach(energy, self.softest, self.exponent)
        return max(self.overlap, collision) * ROUNDING

    def frequency(self, overlap: float) -> float:
        """Return a bound on the frequency of two grains with this overlap, rad/s."""
        stiffness = self.exponent * self.hardest * overlap ** (self.exponent - 1)
        return math.sqrt(2 * stiffness / self.lightest) * ROUNDING


def bounds(
    kind: tuple[Material, float],
    grains: int,
    impurities: Sequence[Impurity],
    walls: Sequence[Material],
    weights: tuple[float, float, float],
) -> Bounds | None:
    """Return the bounds of a chain; None if numbers are too large or too small to say.

    Parameters
    ----------
    kind : tuple
        Material and diameter of the grains that are alike, m.
    grains : int
    impurities : sequence of Impurity
    walls : sequence of Material
        Those that differ from the grains.
    weights : tuple
        Top load, N, gravity, m/s2, and exponent.
    """
    load, gravity, exponent = weights
    odd: list[Any] = [(i.material or kind[0], i.diameter or kind[1], i.mass) for i in impurities]
    materials, diameters, given = zip(*((*kind, None), *odd), strict=True)
    try:
        masses = [
            mass or material.density * math.pi / 6 * diameter**3
            for material, diameter, mass in zip(materials, diameters, given, strict=True)
        ]
        moduli = [material.plane_strain_modulus for material in (*materials, *walls)]
        lengths = [min(diameters), max(diameters)]  # a power of them has its extremes at the ends
        softest = min(
            hertz_constant(min(moduli) / 2, min(diameters) / 4, length, exponent)
            for length in lengths
        )
        hardest = max(  # at a wall, whose radius is infinite
            hertz_constant(max(moduli) / 2, max(diameters) / 2, length, exponent)
            for length in lengths
        )
        weight = gravity * (grains * masses[0] + sum(masses[1:]))
        overlap = ((load + weight) / softest) ** (1 / exponent)
        extremes = Bounds(
            softest,
            hardest,
            min(masses),
            max(masses),
            min(diameters),
            min(material.sound_speed for material in materials),
            overlap,
            exponent,
        )
        return extremes if extremes.frequency(overlap) ** 2 < LIMITS.stiffness_over_mass else None
    except ArithmeticError:
        return None
