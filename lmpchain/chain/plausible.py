"""What is allowed but hardly meant: grains of metres, overlaps beyond Hertz's law."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..util.arrays import Array
from .contacts import Contacts

# overlap over diameter: the contact is then a tenth as wide as the grain, and Hertz's theory takes it to be far
# narrower (K. L. Johnson, Contact Mechanics, Cambridge 1985, section 4.2)
HERTZ_OVERLAP = 0.01
LARGEST_DIAMETER = 0.3  # m
LARGEST_OVERLAP = 0.1  # of the diameter: beyond it the Hertz law no longer describes a contact
LONG = 10**6  # grains from which on arrays are a burden


def beyond_hertz(relative: float) -> str:
    """Say that a contact is squeezed to so much of the diameter, beyond what Hertz's law holds for."""
    return f"a contact is squeezed to {relative:.2g} of the diameter; Hertz's law holds to about {HERTZ_OVERLAP:g}"


def remarks(diameter: float | Array, relative: float) -> Iterator[str]:
    """Yield what is hardly meant of these diameters, m, and this overlap at rest over the diameter."""
    widest = diameter if isinstance(diameter, float) else diameter.max()
    if widest > LARGEST_DIAMETER:
        yield f"diameter: {widest:g} m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    if relative > HERTZ_OVERLAP:
        yield f"diameter: at rest {beyond_hertz(relative)}"


def least_squeezed(
    kinds: Array, grains: int, load: float, gravity: float, exponent: float
) -> float:
    """Return to what part of the diameter a contact of a long chain is squeezed at least, without arrays.

    Its grains are of these kinds (3, I+1), alike but for I impurities; 0 for a chain whose arrays are no burden. Of the
    2 I + 1 lowest contacts one is between two common grains.
    """
    if grains < LONG:
        return 0.0
    modulus, d, mass = kinds[:, 0]
    above = max(grains - 3 * kinds.shape[1], 0)
    constant = 2 / 3 * modulus * np.sqrt(d / 4) * d ** (1.5 - exponent)
    with np.errstate(all="ignore"):
        return float(Contacts(constant, load + gravity * above * mass, exponent).overlap / d)


def too_squeezed(how: str) -> str:
    """Return the fault of a contact that is compressed too much."""
    than = f"of the diameter, more than {LARGEST_OVERLAP:g}"
    return f"{how} {than}: use fewer grains, less gravity or load, or a stiffer material"
