"""Response of the continuum to a strike on the top, Eq. (35), in causal form and as printed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import beta, betainc

from ..util.arrays import Array
from .domain import chi, exponents, finite, real, require, whole


def impulse_amplitude(delta: float = 1.5) -> float:
    """Return C = eta (2/eta)^(2/eta) / B(1/eta, 1 - xi/(2 eta)) of `impulse_response`.

    Parameters
    ----------
    delta : float
        Exponent of the contact force.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If delta < 1.

    Examples
    --------
    >>> f"{impulse_amplitude():.12f}"
    '1.155137236597'
    """
    xi, eta, _ = exponents(delta)
    return float(eta * (2 / eta) ** (2 / eta) / beta(1 / eta, 1 - xi / (2 * eta)))


def impulse_response(h: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return the response to unit dphi/dtau of grain 1: C (tau^2 - chi^2)^(-xi/2eta), causal.

    This is Eq. (35) with its amplitude, and with the value 0 outside the light cone. For Hertz
    contacts it is C (tau^2 - chi^2)^(-1/10). It is infinite on the cone (for delta = 1, a step of
    height 1). The front of a chain of grains is finite, see `lmpchain.theory.front`.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    tau : array_like
        Times, any real numbers.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If h < 0, tau is not finite or delta < 1.

    Examples
    --------
    >>> impulse_response([0.0, 100.0], 50.0).round(6).tolist()
    [0.52825, 0.0]
    """
    inside = peaked(h, tau, 0.0, impulse_amplitude(delta), 0.0, delta)
    return np.where(finite(tau, "tau") >= chi(h, delta), inside, 0.0)


def impulse_of_grain(n: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> tuple[Array, Array]:
    """Return phi and dphi/dtau of `impulse_response`, averaged over grain n, n - 1 < h < n.

    The average of phi is the difference of ``tau I((chi/tau)^2)`` between both ends of the grain,
    where ``I`` is the regularised incomplete beta function with the parameters 1/eta and
    1 - xi/(2 eta). It is finite on the light cone, too, and the total momentum is 1 at all times.

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    tau : array_like
        Times, 0 or more.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    phi : array
        Mean displacement of the grain.
    speed : array
        Mean velocity dphi/dtau of the grain.

    Raises
    ------
    InputError
        If n is not whole or below 1, tau < 0 or delta < 1.

    Examples
    --------
    >>> phi, speed = impulse_of_grain(np.arange(1, 200), 50.0)
    >>> float(phi.sum().round(12)), float(speed.sum().round(12))
    (50.0, 1.0)
    """
    xi, eta, _ = exponents(delta)
    n = whole("n", n, 1)
    tau = real(tau, "tau")
    require(("tau", tau >= 0, "must be 0 or more"))
    # Parameters of the incomplete beta function.
    order = 1 / eta
    complement = 1 - xi / (2 * eta)

    def below(h: Array) -> tuple[Array, Array]:
        """Return the integrals of both over depths above h."""
        travel, time = np.broadcast_arrays(chi(h, delta), tau)
        x = np.divide(travel, time, out=np.where(travel > 0, np.inf, 0.0), where=time > 0)
        # The slope is infinite on the light cone.
        inside = np.minimum(x, np.nextafter(1.0, 0.0))
        share = np.where(x < 1, betainc(order, complement, inside**2), 1.0)
        slope = (
            2
            * inside ** (2 * order)
            * (1 - inside**2) ** (complement - 1)
            / beta(order, complement)
        )
        return tau * share, share - np.where(x < 1, slope, 0.0)

    phi, speed = below(real(n, "n"))
    phi_above, speed_above = below(real(n, "n") - 1)
    return phi - phi_above, speed - speed_above


def peaked(
    h: ArrayLike, tau: ArrayLike, c1: float, c2: float, c3: float, delta: float = 1.5
) -> Array:
    """Return Eq. (35), c1 + c2 ``|(tau + c3)^2 - chi^2|^(-xi/2eta)``.

    It solves Eq. (27) on each side of the light cone.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    tau : array_like
        Times, any real numbers.
    c1 : float
        Constant term.
    c2 : float
        Amplitude of the power.
    c3 : float
        Shift of the time.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If h < 0 or delta < 1.

    Examples
    --------
    >>> peaked(4.0, 2.0, 1.0, 0.0, 0.5).tolist()
    1.0
    """
    xi, eta, _ = exponents(delta)
    shifted = real(tau, "tau") + c3
    travel = chi(h, delta)
    # The two factors avoid cancellation near the light cone.
    with np.errstate(divide="ignore"):
        return c1 + c2 * abs((shifted - travel) * (shifted + travel)) ** (-xi / (2 * eta))
