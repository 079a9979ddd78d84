"""Bounds on a chain of equal grains with a few impurities, computed without its arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from .contact_law import ContactLaw
from .impurities import Kinds
from .materials import Material
from .plausible import LIMITS

# Factor on bounds, because rounding errors would exceed the exact bounds of a uniform chain.
ROUNDING = 1 + 1e-9


class Bounds(NamedTuple):
    """Bounds on all grains of a chain and on all of its contacts.

    Attributes
    ----------
    softest, hardest : float
        Smallest and largest contact constant, N/m^delta.
    lightest, heaviest : float
        Smallest and largest mass, kg.
    narrowest : float
        Smallest diameter, m.
    slowest : float
        Smallest speed of sound in a grain, m/s.
    overlap : float
        Upper bound on the overlap at rest, m.
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
        """Upper bound on overlap over diameter at rest."""
        return self.overlap / self.narrowest

    def struck(self, speed: float) -> float:
        """Return an upper bound on overlaps at rest and in the first collision at this speed, m."""
        # The kinetic energy of one grain that hits a resting grain; the contact stores at most half
        # of it.
        energy = self.heaviest * speed * speed / 2
        collision = self.law.approach(energy, self.softest)
        return max(self.overlap, collision) * ROUNDING

    def frequency(self, overlap: float) -> float:
        """Return an upper bound on the frequency of two grains with this overlap, rad/s."""
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
    """Return the bounds of a chain; None if numbers overflow or underflow.

    Parameters
    ----------
    kinds : Kinds
        The common grain and the impurities.
    grains : int
    walls : sequence of Material
        Wall materials that differ from the grains.
    top_load, gravity : float
        Top load, N; gravity, m/s2.
    law : ContactLaw
    """
    moduli = [*kinds.moduli, *(wall.plane_strain_modulus for wall in walls)]
    narrowest = min(kinds.diameters)
    widest = max(kinds.diameters)
    # A power of mean diameters has its extremes at the smallest or largest diameter.
    lengths = {narrowest, widest}
    try:
        softest = min([law.constant(min(moduli) / 2, narrowest / 4, d) for d in lengths])
        # The stiffest contact is with a wall, which has an infinite radius.
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
        # The comparison is false if a value is NaN.
        computable = extremes.frequency(extremes.overlap) ** 2 < LIMITS.stiffness_over_mass
        return extremes if computable else None
    # Python floats raise an exception on overflow and on division by 0.
    except ArithmeticError:
        return None
