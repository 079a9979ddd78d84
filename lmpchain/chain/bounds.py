"""Bounds on a chain of grains that are alike but for a few, known before its arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from .contact_law import ContactLaw
from .impurities import Kinds
from .materials import Material
from .plausible import LIMITS

# factor on bounds: where all grains are alike they are reached, and rounding would pass them
ROUNDING = 1 + 1e-9


class Bounds(NamedTuple):
    """Bounds on all grains of a chain and on all of its contacts.

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
    law : ContactLaw
    """

    softest: float
    hardest: float
    lightest: float
    heaviest: float
    narrowest: float
    slowest: float
    overlap: float
    law: ContactLaw

    @property
    def compression(self) -> float:
        """Overlap over diameter at rest, at most."""
        return self.overlap / self.narrowest

    def struck(self, speed: float) -> float:
        """Return a bound on overlaps at rest and in the first collision at this speed, m."""
        # of one grain that meets another at rest; what they share is half of it at most
        energy = self.heaviest * speed * speed / 2
        collision = self.law.approach(energy, self.softest)
        return max(self.overlap, collision) * ROUNDING

    def frequency(self, overlap: float) -> float:
        """Return a bound on the frequency of two grains with this overlap, rad/s."""
        stiffness = self.law.stiffness(overlap, self.hardest)
        return math.sqrt(2 * stiffness / self.lightest) * ROUNDING


def bounds(
    kinds: Kinds,
    grains: int,
    walls: Sequence[Material],
    top_load: float,
    gravity: float,
    law: ContactLaw,
) -> Bounds | None:
    """Return the bounds of a chain; None if numbers are too large or too small to say.

    Parameters
    ----------
    kinds : Kinds
        The common grain and the impurities.
    grains : int
    walls : sequence of Material
        Those that differ from the grains.
    top_load, gravity : float
        N and m/s2.
    law : ContactLaw
    """
    moduli = [*kinds.moduli, *(wall.plane_strain_modulus for wall in walls)]
    narrowest = min(kinds.diameters)
    widest = max(kinds.diameters)
    # a power of mean diameters has its extremes at the ends
    lengths = {narrowest, widest}
    try:
        softest = min([law.constant(min(moduli) / 2, narrowest / 4, d) for d in lengths])
        # at a wall, whose radius is infinite
        hardest = max([law.constant(max(moduli) / 2, widest / 2, d) for d in lengths])
        weight = gravity * (grains * kinds.masses[0] + sum(kinds.masses[1:]))
        extremes = Bounds(
            softest,
            hardest,
            lightest=min(kinds.masses),
            heaviest=max(kinds.masses),
            narrowest=narrowest,
            slowest=min(material.sound_speed for material in kinds.materials),
            overlap=law.overlap(top_load + weight, softest),
            law=law,
        )
        # written so that what is no number has no bounds either
        computable = extremes.frequency(extremes.overlap) ** 2 < LIMITS.stiffness_over_mass
        return extremes if computable else None
    # Python's own floats raise where they overflow or are divided by 0
    except ArithmeticError:
        return None
