"""Bounds on a chain whose grains are alike but for a few: plain numbers, known sooner than its arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from .impurities import Impurity
from .materials import Material

LEAST = {"gravity": 1e-100, "top_load": 1e-100}  # m/s2 and N, if not 0
HARDEST = 1e150  # 1/s2, of a stiffness over a mass: squares are finite
ROUNDING = 1 + 1e-9  # of bounds, which may be reached


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
    def squeezed(self) -> float:
        """Overlap over diameter at rest, at most."""
        return self.overlap / self.narrowest

    def struck(self, speed: float) -> float:
        """Return a bound on all overlaps at rest and in the first collision of a grain with this speed, m."""
        power = self.exponent + 1
        collision = (power / 2 * speed * speed * self.heaviest / self.softest) ** (1 / power)
        return max(self.overlap, collision) * ROUNDING

    def frequency(self, overlap: float) -> float:
        """Return a bound on the frequency of two grains that are pressed together so far, rad/s."""
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
    try:
        odd: Any = [
            (each.material or kind[0], each.diameter or kind[1], each.mass) for each in impurities
        ]
        materials, widths, _ = zip(*(every := ((*kind, None), *odd)), strict=True)
        masses = [
            mass or material.density * math.pi / 6 * width**3 for material, width, mass in every
        ]
        moduli = [each.plane_strain_modulus for each in (*materials, *walls)]
        lengths = [width ** (1.5 - exponent) for width in widths]
        softest = 2 / 3 * min(moduli) * math.sqrt(min(widths) / 4) * min(lengths)
        hardest = 2 / 3 * max(moduli) * math.sqrt(max(widths) / 2) * max(lengths)
        overlap = ((load + gravity * (grains * masses[0] + sum(masses[1:]))) / softest) ** (
            1 / exponent
        )
        slowest = min(each.sound_speed for each in materials)
        found = Bounds(
            softest, hardest, min(masses), max(masses), min(widths), slowest, overlap, exponent
        )
        return found if found.frequency(overlap) ** 2 < HARDEST else None
    except ArithmeticError:
        return None
