"""Shifts of colliding solitary waves, by the integrable limits of a chain under a load.

A collision shifts each wave by some grains from the position that it would have without the other
wave. The shift depends on the decay rate kappa of the tail, which falls as ``exp(-kappa |x|)`` with
``sinh(kappa/2) = c kappa/2``. The laws are those of two solitons of Toda's chain, Theory of
Nonlinear Lattices (Springer, 1981), and of the Korteweg-de Vries equation. They are the limit of
small amplitudes for a chain of any exponent. Y. Shen et al., Phys. Rev. E 90, 022905 (2014),
compare both with granular chains.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from ..util.lazy import listed
from .domain import require

__dir__ = listed(__name__)

FASTEST = 1e6  # Largest Mach number for which a decay rate is searched.


def decay(speed: float) -> float:
    """Return the decay rate kappa per grain of a solitary wave's tail in a loaded chain.

    Parameters
    ----------
    speed : float
        Speed of the wave over the speed of sound, above 1.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If the speed is not above 1.

    Examples
    --------
    >>> round(decay(1.2), 6)
    2.129737
    """
    require(("speed", 1 < speed < FASTEST, f"must be above 1, that of sound (got {speed!r})"))
    # Solve sinh(z) = c z for z = kappa / 2, without cancellation near z = 0.
    furthest = 2.0 * (1 + np.log(speed)) + 4
    return 2 * brentq(lambda z: float(np.sinh(z) / z) - speed, 1e-9, furthest, xtol=1e-15)


def toda(speed: float, other: float, head_on: bool) -> float:
    """Return the shift, grains, of a solitary wave in its own direction by a collision (Toda).

    With the decay rates kappa of this wave and q of the other wave, the shift in a head-on
    collision is ``(1/kappa) ln [cosh((kappa + q)/4) / cosh((kappa - q)/4)]^2``. If both waves
    travel in the same direction, it is ``(1/kappa) ln [sinh((kappa + q)/4) / sinh(|kappa -
    q|/4)]^2`` for the faster wave, and has the opposite sign for the slower wave. The law is exact
    for Toda's chain.

    Parameters
    ----------
    speed : float
        Speed of this wave over the speed of sound.
    other : float
        Speed of the other wave over the speed of sound.
    head_on : bool
        Whether the waves travel in opposite directions.

    Returns
    -------
    float
        Shift, grains.

    Raises
    ------
    InputError
        If a speed is not above 1, or if waves in the same direction have equal speeds.

    Examples
    --------
    >>> f"{toda(1.2, 1.2, True):.6f} {toda(1.2, 1.05, False):.6f}"
    '0.454553 1.146892'
    """
    _check_overtaking(speed, other, head_on)
    kappa = decay(speed)
    q = decay(other)
    wave = np.cosh if head_on else np.sinh
    shift = 2 / kappa * np.log(wave((kappa + q) / 4) / wave(abs(kappa - q) / 4))
    return float(shift if head_on or kappa > q else -shift)


def kdv(speed: float, other: float) -> float:
    """Return the shift, grains, of one of two solitary waves of equal direction (KdV).

    The shift of the faster wave is ``(1/kappa) ln [(kappa + q) / (kappa - q)]^2`` with kappa^2 =
    24 (c - 1), and likewise q for the other wave. The shift of the slower wave has the opposite
    sign.

    Parameters
    ----------
    speed : float
        Speed of this wave over the speed of sound.
    other : float
        Speed of the other wave over the speed of sound.

    Returns
    -------
    float
        Shift, grains.

    Raises
    ------
    InputError
        If a speed is not above 1, or both are equal.

    Examples
    --------
    >>> f"{kdv(1.04, 1.01):.6f}"
    '2.242533'
    """
    _check_overtaking(speed, other, False)
    for value in (speed, other):
        require(("speed", 1 < value < np.inf, f"must be above 1, that of sound (got {value!r})"))
    kappa = np.sqrt(24 * (speed - 1))
    q = np.sqrt(24 * (other - 1))
    shift = 2 / kappa * np.log((kappa + q) / abs(kappa - q))
    return float(shift if kappa > q else -shift)


def _check_overtaking(speed: float, other: float, head_on: bool) -> None:
    """Raise `InputError` if waves of equal direction have equal speeds."""
    differ = head_on or speed != other
    require(("other", differ, "must differ from speed: equal waves never meet"))
