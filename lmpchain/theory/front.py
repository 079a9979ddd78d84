"""The front of the wave after a strike on grain 1 of a long linear column.

The impulse response of the continuum, Eq. (35), is infinite at the light cone. In a chain of
grains, dispersion spreads it over the width ``w = [h^(1 - 3 xi/2) / (8 (1 - 3 xi/2))]^(1/3)`` into
a fractional derivative of Airy's function. The formulas are limits for large n, for delta below 3.
For Hertz contacts the next order lowers them by a fraction of about 0.34 n^(-1/3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import airy, roots_jacobi

from ..util.arrays import Array
from ..util.lazy import listed
from .continuum import chi, impulse_amplitude
from .domain import exponents, real, require, whole

__dir__ = listed(__name__)


def decay(delta: float = 1.5) -> tuple[float, float]:
    """Return p and q of the decay: peak velocities as n^(-p), peak displacements as n^(-q).

    For Hertz contacts p is 4/15 and q is 1/10; the exponent 1/12 of Eq. (8) is valid for waves of a
    single frequency. For delta of 3 or more, both are xi/4.

    Parameters
    ----------
    delta : float
        Exponent of the contact force.

    Returns
    -------
    (float, float)
        The exponents p and q.

    Raises
    ------
    InputError
        If delta < 1.

    Examples
    --------
    >>> p, q = decay()
    >>> f"{15 * p:.12f} {10 * q:.12f}"
    '4.000000000000 1.000000000000'
    """
    xi, eta, _ = exponents(delta)
    # For delta >= 3, waves disperse at the top, not at the front.
    if delta >= 3:
        return xi / 4, xi / 4
    a = xi / (2 * eta)
    spread = 1 / 3 - xi / 2
    return a * eta / 2 + (1 + a) * spread, a * eta / 2 + a * spread


def displacement(n: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return phi_n near the front after unit dphi/dtau of grain 1.

    It is ``C (2 chi w)^(-a) G((tau - chi) / w)``, where G(s) is the integral of ``y^(-a) Ai(y -
    s)`` over y > 0, a = xi / (2 eta), and C is the constant of Eq. (35).

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    tau : array_like
        Times up to chi(n - 1/2) + 30 w; later `continuum.impulse_response` is as accurate.
        Broadcasts with n.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1, tau is too late, delta < 1 or delta >= 3.

    Examples
    --------
    >>> f"{displacement(1000, 381.0):.3f}"
    '0.421'
    """
    return _near(n, tau, delta, 0)


def velocity(n: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return dphi_n/dtau near the front: the derivative of `displacement`, same arguments.

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    tau : array_like
        Times up to chi(n - 1/2) + 30 w; broadcasts with n.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1, tau is too late, delta < 1 or delta >= 3.

    Examples
    --------
    >>> f"{velocity(1000, 381.0):.3f}"
    '0.147'
    """
    return _near(n, tau, delta, 1)


def peak_velocity(n: ArrayLike, delta: float = 1.5) -> Array:
    """Return the largest velocity of grain n relative to the velocity of the strike.

    For Hertz contacts it is 0.931768 n^(-4/15) to leading order.

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1, delta < 1 or delta >= 3.

    Examples
    --------
    >>> f"{peak_velocity(10**9) * 1e9 ** (4 / 15):.6f}"
    '0.931768'
    """
    return velocity(n, peak_time(n, delta), delta)


def peak_time(n: ArrayLike, delta: float = 1.5) -> Array:
    """Return the arrival time of the largest velocity at grain n, chi + s w, in units of tau.

    For Hertz contacts s = 0.908.

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1, delta < 1 or delta >= 3.

    Examples
    --------
    >>> f"{peak_time(4000):.1f}"
    '1206.9'
    """
    travel, width, a = _scales(n, delta)
    return travel + brentq(lambda s: _smooth(real(s, "s"), a, 2), 0.0, 2.0, xtol=1e-14) * width


def _near(n: ArrayLike, tau: ArrayLike, delta: float, derivative: int) -> Array:
    travel, width, a = _scales(n, delta)
    s = (real(tau, "tau") - travel) / width
    require(("tau", s <= 30, "must not be more than 30 widths of the front behind it"))
    height = impulse_amplitude(delta) * (2 * travel * width) ** -a * width**-derivative
    return height * _smooth(s, a, derivative)


def _scales(n: ArrayLike, delta: float) -> tuple[Array, Array, float]:
    """Return chi, w and a at grain n."""
    xi, eta, _ = exponents(delta)
    message = "must be below 3: from there on waves are dispersed at the top, not at the front"
    require(("delta", delta < 3, message))
    h = whole("n", n, 1) - 0.5
    power = 1 - 1.5 * xi
    return chi(h, delta), np.cbrt(h**power / (8 * power)), xi / (2 * eta)


def _smooth(s: Array, a: float, derivative: int) -> Array:
    """Return an s-derivative of the integral of y^(-a) Ai(y - s) over y > 0, by Gauss-Jacobi."""
    reach = np.maximum(s, 0.0) + 16
    # The Airy function decays beyond y = s; its oscillations before that determine the number of
    # nodes.
    x, weight = roots_jacobi(64 + int(reach.max() ** 1.5), 0.0, -a)
    y = reach[..., None] * (1 + x) / 2
    ai, slope, _, _ = airy(y - s[..., None])
    integrand = (ai, -slope, (y - s[..., None]) * ai)[derivative]
    return (reach / 2) ** (1 - a) * (integrand @ weight)
