"""Approximations of long or weak solitary waves: Nesterenko, Sen, Coste, Korteweg and de Vries."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..util.arrays import Array
from .domain import real, require
from .soliton_series import long_wave_speed


def nesterenko_speed(velocity: ArrayLike, delta: float = 1.5) -> Array:
    """Return the speed of Nesterenko's long-wave soliton in the sonic vacuum.

    The speed is ``(2 / (delta + 1))^(1/(delta+1)) v^((delta-1)/(delta+1))``; V. F. Nesterenko, J.
    Appl. Mech. Tech. Phys. 24, 733 (1983). The solitary wave of the lattice is 0.78 % slower for
    Hertz contacts.

    Parameters
    ----------
    velocity : array_like
        Largest velocity v of a grain.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a velocity is not finite.

    Examples
    --------
    >>> from lmpchain.theory.soliton import solve
    >>> f"{nesterenko_speed(1.0) / solve(velocity=1.0).speed - 1:.4f}"
    '0.0079'
    """
    return (2 / (delta + 1)) ** (1 / (delta + 1)) * real(velocity, "velocity") ** (
        (delta - 1) / (delta + 1)
    )


def nesterenko_overlap(x: ArrayLike, speed: float, delta: float = 1.5) -> Array:
    """Return the overlap of Nesterenko's long-wave soliton in the sonic vacuum.

    The overlap is ``[(delta+1) c^2 / 2]^(1/(delta-1)) cos^(2/(delta-1))(q x)`` for
    ``|q x| < pi/2``, and 0 elsewhere, with ``q = (delta - 1) [6 / (delta (delta + 1))]^(1/2)``. For
    Hertz contacts q is sqrt(10)/5, and the power of the cosine is 4.

    Parameters
    ----------
    x : array_like
        Distance from the peak, in grains.
    speed : float
        Speed c, grains per unit of time.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If x is not finite.
    """
    q = (delta - 1) * np.sqrt(6 / (delta * (delta + 1)))
    angle = q * real(x, "x")
    height = ((delta + 1) / 2 * speed**2) ** (1 / (delta - 1))
    return height * ((np.abs(angle) < np.pi / 2) * np.cos(angle)) ** (2 / (delta - 1))


def sen_displacement(x: ArrayLike) -> Array:
    """Return the relative displacement, as fitted for Hertz's law in the sonic vacuum.

    The displacement over its value far behind the wave is ``(1 - tanh(f(x)/2))/2`` with
    ``f = 2.39536 x + 0.268529 x^3 + 0.0061347 x^5``; S. Sen et al., Phys. Rep. 462, 21 (2008).

    Parameters
    ----------
    x : array_like
        Distance from the peak, in grains.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If x is not finite.

    Examples
    --------
    >>> from lmpchain.theory.soliton import solve
    >>> wave = solve(velocity=1.0)
    >>> x = np.linspace(-2, 2, 9)
    >>> exact = wave.displacement(x) / wave.displacement(-9.0)
    >>> bool(np.abs(exact - sen_displacement(x)).max() < 1e-3)
    True
    """
    x = real(x, "x")
    return (1 - np.tanh((2.39536 * x + 0.268529 * x**3 + 0.0061347 * x**5) / 2)) / 2


def coste_speed(force: ArrayLike, delta: float = 1.5) -> Array:
    """Return the long-wave speed under a load, relative to the speed of sound.

    For Hertz contacts it is ``(f^(2/3) - 1)^(-1) {(4/15) [3 + 2 f^(5/3) - 5 f^(2/3)]}^(1/2)`` with
    the largest force over the static force f; C. Coste, E. Falcon and S. Fauve, Phys. Rev. E 56,
    6104 (1997). Waves of the lattice are faster, by 0.05 % at 1.05 times the speed of sound, and by
    1.2 % for strong waves.

    Parameters
    ----------
    force : array_like
        Largest force over the static force, above 1.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a force is not above 1.

    Examples
    --------
    >>> f"{coste_speed(2.12584727):.6f}"
    '1.049464'
    """
    f = real(force, "force")
    require(("force", f > 1, "must be above 1, the value at rest"))
    return long_wave_speed(np.expm1(np.log(f) / delta), delta)


def kdv_overlap(x: ArrayLike, speed: float, delta: float = 1.5) -> Array:
    """Return the overlap of the Korteweg-de Vries soliton, the limit of weak waves under a load.

    The overlap is ``6 e / (delta - 1) sech^2((6 e)^(1/2) x)`` with e = speed - 1.

    Parameters
    ----------
    x : array_like
        Distance from the peak, in grains.
    speed : float
        Speed over the speed of sound.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If x is not finite.
    """
    e = speed - 1
    return 6 * e / (delta - 1) / np.cosh(np.sqrt(6 * e) * real(x, "x")) ** 2
