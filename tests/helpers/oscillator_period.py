"""The period of a grain between two contacts, by quadrature."""

from itertools import pairwise

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(100)


def oscillator_period(
    amplitude: float,
    constant: float,
    overlap: float,
    mass: float,
    delta: float = 1.5,
    closing: float = 1.0,
) -> float:
    """Return the period of a grain with this amplitude between two equal contacts, which may open.

    A displacement x changes the overlaps by plus and minus `closing` x: 1 between fixed neighbours,
    2 between neighbours that move in the opposite direction.
    """
    power = delta + 1

    def potential(x: np.ndarray | float) -> np.ndarray:
        overlaps = np.maximum(overlap + closing * np.multiply.outer([1.0, -1.0], x), 0.0)
        return constant / (closing * power) * (overlaps**power).sum(0)

    opens = overlap / (closing * amplitude)
    ends = [0.0, *([np.arcsin(opens)] if opens < 1 else []), np.pi / 2]
    quarter = 0.0
    for begin, end in pairwise(ends):
        angle = (begin + end + (end - begin) * NODES) / 2
        x = amplitude * np.sin(angle)
        speed = np.sqrt(2 * (potential(amplitude) - potential(x)) / mass)
        quarter += (end - begin) / 2 * WEIGHTS @ (amplitude * np.cos(angle) / speed)
    return float(4 * quarter)
