"""Limits of a chain: where numbers, Hertz's law or what is meant end."""

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
        Smallest top load, N, and gravity, m/s2, besides 0: below, squares of overlaps underflow.
    stiffness_over_mass : float
        Largest entry of the dynamical matrix, 1/s2: its square is finite.
    compression : float
        Largest overlap over diameter at rest or in the first collision: beyond it Hertz's law no
        longer describes a contact.
    hertz_compression : float
        Overlap over diameter up to which Hertz's law is good. The contact is then a tenth as wide
        as the grain, and the theory takes it to be far narrower (K. L. Johnson, Contact Mechanics,
        Cambridge 1985, section 4.2).
    usual_diameter : float
        Largest diameter of a grain that is not remarked on, m.
    long_chain : int
        Grains from which on arrays are a burden.
    """

    least_force: float = 1e-100
    stiffness_over_mass: float = 1e150
    compression: float = 0.1
    hertz_compression: float = 0.01
    usual_diameter: float = 0.3
    long_chain: int = 10**6


LIMITS = ChainLimits()


def beyond_hertz(compression: float) -> str:
    """Return the remark on a contact compressed to this part of the diameter, beyond Hertz."""
    return (
        f"a contact is squeezed to {compression:.2g} of the diameter; "
        f"Hertz's law holds to about {LIMITS.hertz_compression:g}"
    )


def remarks(diameter: float | Array, compression: float) -> Iterator[str]:
    """Yield what is hardly meant of these diameters, m, and of this overlap over diameter."""
    widest = diameter if isinstance(diameter, float) else diameter.max()
    if widest > LIMITS.usual_diameter:
        yield f"diameter: {widest:g} m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    if compression > LIMITS.hertz_compression:
        yield f"diameter: at rest {beyond_hertz(compression)}"


def least_compression(
    kinds: Kinds, grains: int, top_load: float, gravity: float, law: ContactLaw
) -> float:
    """Return a lower bound on the largest overlap over diameter of a long chain, without arrays.

    0 for a chain whose arrays are no burden.
    """
    if grains < LIMITS.long_chain:
        return 0.0
    # of the 2 I + 1 lowest contacts one is between two common grains, and of the grains above it
    # no more than I are impurities
    above = max(grains - 3 * len(kinds.masses), 0)
    # numpy's numbers: a Python float raises where it overflows
    diameter: Any = np.float64(kinds.diameters[0])
    mass: Any = np.float64(kinds.masses[0])
    with np.errstate(all="ignore"):
        constant = law.constant(kinds.moduli[0] / 2, diameter / 4, diameter)
        force = top_load + gravity * above * mass
        return float(Contacts.at_rest(constant, force, law).overlap / diameter)


def too_compressed(compression: str) -> str:
    """Return the fault of a contact that is compressed too much."""
    than = f"of the diameter, more than {LIMITS.compression:g}"
    cure = "use fewer grains, less gravity or load, or a stiffer material"
    return f"{compression} {than}: {cure}"
