"""Limits on chains: floating-point range, validity of Hertz's law, and plausible values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..util.arrays import Array
from .contact_law import ContactLaw
from .contacts import Contacts
from .impurities import Kinds


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

    The bound is 0 for a chain with affordable arrays.
    """
    if grains < LIMITS.long_chain:
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
