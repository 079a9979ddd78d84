"""What a chain may be but is hardly meant to be: grains of metres, overlaps where Hertz's law holds only roughly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .chain import Chain

# overlap over diameter: the contact is then a tenth as wide as the grain, and Hertz's theory takes it to be far
# narrower (K. L. Johnson, Contact Mechanics, Cambridge 1985, section 4.2)
HERTZ_OVERLAP = 0.01
LARGEST_DIAMETER = 0.3  # m


def beyond_hertz(relative: float) -> str:
    """Say that a contact is squeezed to so much of the diameter, beyond what Hertz's law holds for."""
    return f"a contact is squeezed to {relative:.2g} of the diameter; Hertz's law holds to about {HERTZ_OVERLAP:g}"


def remarks(chain: Chain) -> Iterator[str]:
    """Yield what is hardly meant."""
    widest = np.max(chain.diameter)
    if widest > LARGEST_DIAMETER:
        yield f"diameter: {widest:g} m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    if chain.exponent == 1.5 and not chain.plainly_below(HERTZ_OVERLAP):
        relative = float((chain.contacts.overlap / chain.contact_lengths).max())
        if relative > HERTZ_OVERLAP:
            yield f"diameter: at rest {beyond_hertz(relative)}"
