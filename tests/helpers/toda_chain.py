"""A Toda chain compressed by a piston, integrated independently, and its exact dispersive shock.

Contacts carry exp(r) - 1 for a rise r of their overlap, masses are 1: so is the speed of sound in
the chain at rest, in grains per unit of time. Exact edges: B. L. Holian, H. Flaschka and D. W.
McLaughlin, Physical Review A 24, 2595 (1981); A. M. Bloch and Y. Kodama, SIAM Journal on Applied
Mathematics 52, 909 (1992).
"""

from typing import NamedTuple

import numpy as np

THIRD = 2 ** (1 / 3)
# Three leapfrog steps of order 2 make a step of order 4.
YOSHIDA = 1 / (2 - THIRD), -THIRD / (2 - THIRD), 1 / (2 - THIRD)


class TodaShock(NamedTuple):
    """Edges of the shock ahead of a piston.

    Attributes
    ----------
    leading, trailing : float
        Speeds, grains per unit of time.
    height, plateau : float
        Rise of the overlap in the leading soliton, and behind the shock.
    width : float
        kappa of the leading soliton, ``exp(r) - 1 = sinh(kappa)^2 sech(kappa (n - c t))^2``.
    """

    leading: float
    trailing: float
    height: float
    plateau: float
    width: float


def exact(piston: float) -> TodaShock:
    """Return the shock ahead of a piston of this speed, below 2.

    The invariant of the waves that run back, v - 2 (exp(r/2) - 1), stays 0 behind; the soliton on
    the edge of the spectrum has cosh(kappa) = 2 exp(r/2) - 1.
    """
    ratio = 1 + piston / 2
    kappa = float(np.arccosh(2 * ratio - 1))
    leading = float(np.sinh(kappa) / kappa)
    plateau = float(2 * np.log(ratio))
    return TodaShock(leading, 2 - ratio, float(2 * np.log(np.cosh(kappa))), plateau, kappa)


def integrate(piston: float, grains: int, duration: float, samples: int, step: float = 0.05):
    """Return times (T,), displacements and velocities (T, N); the last grain is at a wall."""
    interval = duration / (samples - 1)
    inner = int(np.ceil(interval / step))
    x = np.zeros((samples, grains))
    v = np.zeros((samples, grains))
    place = np.zeros(grains)
    speed = np.zeros(grains)
    for sample in range(1, samples):
        time = (sample - 1) * interval
        for weight in YOSHIDA * inner:
            length = weight * interval / inner
            place = place + length / 2 * speed
            time += length / 2
            overlap = -np.diff(place, prepend=piston * time, append=0.0)
            speed = speed - length * np.diff(np.expm1(overlap))
            place = place + length / 2 * speed
            time += length / 2
        x[sample] = place
        v[sample] = speed
    return np.linspace(0.0, duration, samples), x, v
