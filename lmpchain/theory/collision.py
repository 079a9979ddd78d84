"""Shifts of colliding solitary waves, by the integrable limits of a chain under a load.

A wave whose tail falls as ``exp(-kappa |x|)``, ``sinh(kappa/2) = c kappa/2``, goes on where
it would have been without the other one, shifted by grains. The laws are those of two solitons
of Toda's chain, Theory of Nonlinear Lattices (Springer, 1981), and of Korteweg and de Vries's
equation; a chain of any exponent follows them as amplitudes fall. Y. Shen et al., Phys. Rev. E
90, 022905 (2014), compare both with granular chains.
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
        Over that of sound, above 1.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If it is not above 1.

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

    ``(1/kappa) ln [cosh((kappa + q)/4) / cosh((kappa - q)/4)]^2`` head-on, with q of the other one,
    and ``(1/kappa) ln [sinh((kappa + q)/4) / sinh(|kappa - q|/4)]^2`` of the faster of two that go
    one way; of the slower one with a minus. It is that of Toda's chain exactly.

    Parameters
    ----------
    speed, other : float
        Of this wave and of the other one, both over that of sound.
    head_on : bool
        Whether they go against each other.

    Returns
    -------
    float
        Grains.

    Raises
    ------
    InputError
        If a speed is not above 1, or both are equal where one overtakes the other.

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

    ``(1/kappa) ln [(kappa + q) / (kappa - q)]^2`` with kappa^2 = 24 (c - 1), q of the other one; of
    the slower one with a minus.

    Parameters
    ----------
    speed, other : float
        Of this wave and of the other one, both over that of sound.

    Returns
    -------
    float
        Grains.

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
        require(("speed", value > 1, f"must be above 1, that of sound (got {value!r})"))
    kappa = np.sqrt(24 * (speed - 1))
    q = np.sqrt(24 * (other - 1))
    shift = 2 / kappa * np.log((kappa + q) / abs(kappa - q))
    return float(shift if kappa > q else -shift)


def _check_overtaking(speed: float, other: float, head_on: bool) -> None:
    """Raise `InputError` if waves of equal direction have equal speeds."""
    differ = head_on or speed != other
    require(("other", differ, "must differ from speed: equal waves never meet"))
