"""Limits of plausible chains, and bounds on chains of equal grains with a few impurities."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..util.arrays import Array
from .contact_law import ContactLaw, Contacts
from .materials import Kinds, Material


@dataclass(frozen=True)
class ChainLimits:
    """Limits of a chain.

    Attributes
    ----------
    least_force : float
        Smallest nonzero top load, N, and gravity, m/s2; squares of overlaps underflow below it.
    stiffness_over_mass : float
        Largest entry of the dynamical matrix with a finite square, 1/s2.
    compression : float
        Largest ratio of overlap to diameter at rest or in the first collision; Hertz's law does not
        describe a contact beyond it.
    hertz_compression : float
        Ratio of overlap to diameter up to which Hertz's law is accurate. The contact is then a
        tenth as wide as the grain, but the theory assumes that it is far narrower (K. L. Johnson,
        Contact Mechanics, Cambridge 1985, section 4.2).
    usual_diameter : float
        Largest diameter of a grain that causes no remark, m.
    long_chain : int
        Smallest number of grains for which arrays are expensive.
    """

    least_force: float = 1e-100
    stiffness_over_mass: float = 1e150
    compression: float = 0.1
    hertz_compression: float = 0.01
    usual_diameter: float = 0.3
    long_chain: int = 10**6


LIMITS = ChainLimits()


def beyond_hertz(compression: float) -> str:
    """Return the remark on an overlap, relative to the diameter, beyond Hertz's law."""
    return (
        f"a contact is compressed by {compression:.2g} of the diameter; "
        f"Hertz's law holds up to about {LIMITS.hertz_compression:g}"
    )


def remarks(diameter: float | Array, compression: float) -> Iterator[str]:
    """Yield remarks on implausible diameters, m, and on a large ratio of overlap to diameter."""
    widest = diameter if isinstance(diameter, float) else diameter.max()
    if widest > LIMITS.usual_diameter:
        yield f"diameter: {widest:g} m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    if compression > LIMITS.hertz_compression:
        yield f"diameter: at rest {beyond_hertz(compression)}"


def least_compression(
    kinds: Kinds, grains: int, top_load: float, gravity: float, law: ContactLaw
) -> float:
    """Return a lower bound on the largest relative overlap of a long chain, without arrays.

    The bound is 0 for a chain with affordable arrays, and for a law with its own constant or with
    parameters of each contact.
    """
    separate = law.given_constant is not None or any(map(np.ndim, law.parameters))
    if grains < LIMITS.long_chain or separate:
        return 0.0
    # With I impurities, one of the 2 I + 1 lowest contacts is between two common grains, and at
    # most I grains above it are impurities.
    above = max(grains - 3 * len(kinds.masses), 0)
    # numpy floats are used, because Python floats raise an exception on overflow.
    diameter: Any = np.float64(kinds.diameters[0])
    mass: Any = np.float64(kinds.masses[0])
    with np.errstate(all="ignore"):
        constant = law.constant(kinds.moduli[0] / 2, diameter / 4, diameter)
        force = top_load + gravity * above * mass
        return float(Contacts.at_rest(constant, force, law).overlap / diameter)


def too_compressed(compression: str) -> str:
    """Return the message about a contact that is compressed too much."""
    than = f"of the diameter, more than {LIMITS.compression:g}"
    cure = "use fewer grains, less gravity or load, or a stiffer material"
    return f"{compression} {than}: {cure}"


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
