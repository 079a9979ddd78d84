"""What is allowed but hardly meant: grains of metres, overlaps beyond Hertz's law."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..util.arrays import Array

# overlap over diameter: the contact is then a tenth as wide as the grain, and Hertz's theory takes it to be far
# narrower (K. L. Johnson, Contact Mechanics, Cambridge 1985, section 4.2)
HERTZ_OVERLAP = 0.01
LARGEST_DIAMETER = 0.3  # m


def beyond_hertz(relative: float) -> str:
    """Say that a contact is squeezed to so much of the diameter, beyond what Hertz's law holds for."""
    return f"a contact is squeezed to {relative:.2g} of the diameter; Hertz's law holds to about {HERTZ_OVERLAP:g}"


def remarks(diameter: float | Array, relative: float) -> Iterator[str]:
    """Yield what is hardly meant of these diameters, m, and this overlap at rest over the diameter."""
    widest = np.max(diameter)
    if widest > LARGEST_DIAMETER:
        yield f"diameter: {widest:g} m is wide for a grain; diameters are in metres (1 mm is 1e-3)"
    if relative > HERTZ_OVERLAP:
        yield f"diameter: at rest {beyond_hertz(relative)}"
