"""The continuum limit of the column, Eq. (27): modes, wave packets and responses.

Grain n is at the depth h = n - 1/2, and Eq. (27) is ``phi_tautau = (h^xi phi_h)_h``. As a function
of the travel time chi from the top it is the Euler-Poisson-Darboux equation
``phi_tautau = phi_chichi + (xi / eta) phi_chi / chi``; the light cone is tau = chi. The symbols
of the paper:

========= ==================== ==================================================================
symbol    variable             meaning
========= ==================== ==================================================================
h, tau    ``h``, ``tau``       depth in grains, and time in units of the first contact
lambda    ``lam``              frequency, complex where a packet is summed along a turned line
chi       ``travel``           travel time from the top, ``chi(h, delta)``
xi, eta   ``xi``, ``eta``      1 - 1/delta, and 1 + 1/delta, so that chi = (2/eta) h^(eta/2)
nu        ``nu``               1 / (1 + delta), the order of the Hankel function
========= ==================== ==================================================================
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gamma, hankel1e, hyp2f1, jv

from ..util.arrays import Array
from ..util.lazy import listed
from .domain import chi, depth, exponents, real, require
from .finite_volume import Field, solve
from .strike_response import impulse_amplitude, impulse_of_grain, impulse_response, peaked

__dir__ = listed(__name__)
__all__ = [
    "Field",
    "chi",
    "depth",
    "impulse_amplitude",
    "impulse_of_grain",
    "impulse_response",
    "mode",
    "packet",
    "packet_front",
    "peaked",
    "resonant_packet",
    "solve",
    "standing",
    "superpose",
]


Complex = NDArray[np.complex128]
NEARLY_ZERO = 1e-150


def mode(h: ArrayLike, lam: ArrayLike, delta: float = 1.5) -> Complex:
    """Return u_lambda(h) = h^(1/2delta) H_nu^(1)(lambda chi), Eq. (30), with its limit at h = 0.

    The Hankel function is of the first kind and of order nu ("of the first order" in the paper).
    With the time dependence exp(i lambda tau) this wave travels upward. The wave that a driven top
    emits downward is its complex conjugate.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    lam : array_like
        Frequencies lambda, above 0, or complex in the upper half plane.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    complex array

    Raises
    ------
    InputError
        If h < 0, lambda is 0 or outside its domain, or delta < 1.

    Examples
    --------
    >>> mode([0.0, 1e-12, 1.0], 1.0).round(3).tolist()
    [-0.866j, -0.866j, (0.7-0.175j)]
    """
    lam = np.asarray(lam)
    valid = (lam != 0) & (lam.imag >= 0) & ((lam.imag > 0) | (lam.real > 0))
    require(("lam", valid, "must be above 0, or in the upper half plane"))
    return _bare_mode(h, lam, delta) * np.exp(1j * lam * chi(h, delta))


def standing(h: ArrayLike, lam: ArrayLike, delta: float = 1.5) -> Array:
    """Return the standing mode h^(1/2delta) J_(-nu)(lambda chi), without flux at the free top.

    Its time dependence is cos(lambda tau).

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    lam : array_like
        Frequencies lambda, above 0.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If h < 0, lambda <= 0 or delta < 1.

    Examples
    --------
    >>> f"{standing(0.0, 1.0):.4f}"
    '0.8237'
    """
    _, eta, nu = exponents(delta)
    lam = real(lam, "lam")
    travel = chi(h, delta)
    require(("lam", lam > 0, "must be above 0"))
    argument = lam * travel
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = real(h, "h") ** (nu * eta / 2) * jv(-nu, argument)
    return np.where(argument > 0, inside, (lam / eta) ** -nu / gamma(1 - nu))


def superpose(
    A: Callable[[Complex], ArrayLike],
    h: ArrayLike,
    tau: ArrayLike,
    delta: float = 1.5,
    angle: float = np.pi / 2,
) -> Complex:
    """Return the integral of A(lambda) u_lambda(h) exp(i lambda tau) over lambda > 0, Eq. (31).

    For A = 1 the integral is Eq. (29). Along the real axis it converges only conditionally. It is
    computed along ``lambda = y exp(i angle)``, where it converges exponentially for every
    tau > -chi. A must be analytic between the two paths and grow less than exponentially; at 0 it
    may be as singular as lambda^(nu - 0.9). The relative error is about 1e-13.

    Parameters
    ----------
    A : callable
        Function A(lambda) of complex arrays.
    h : array_like
        Depths, 0 or more.
    tau : array_like
        Times, above -chi(h).
    delta : float
        Exponent of the contact force.
    angle : float
        Angle of the path, above 0 and at most pi/2. An A such as exp(-lambda^2), which grows along
        the imaginary axis, requires a smaller angle.

    Returns
    -------
    complex array

    Raises
    ------
    InputError
        If an argument is outside its domain.

    Examples
    --------
    >>> value = superpose(lambda lam: np.ones_like(lam), 2.0, 3.0)
    >>> abs(value.real - packet(2.0, 3.0)) < 1e-13
    np.True_
    """
    ahead = real(tau, "tau") + chi(h, delta)
    require(
        ("tau", ahead > 0, "must be above -chi"),
        ("angle", 0 < angle <= np.pi / 2, "must be above 0 and at most pi/2"),
    )
    # The substitution exp(t - exp(-t)) makes the trapezoidal rule converge doubly exponentially at
    # both ends.
    step = 1 / 32
    t = np.arange(-6.4, 4.6, step)
    rotation = np.exp(1j * angle)
    lam = rotation * np.exp(t - np.exp(-t)) / (np.sin(angle) * ahead[..., None])
    weight = step * (1 + np.exp(-t)) * lam * np.exp(1j * lam * ahead[..., None])
    return (np.asarray(A(lam)) * _bare_mode(real(h, "h")[..., None], lam, delta) * weight).sum(-1)


def packet(h: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return the real part of Eq. (29), Eq. (32) for A = 1, inside, outside and on the light cone.

    It is ``a [(tau + R)^nu - (tau - R)^nu] / R`` with R^2 = tau^2 - chi^2 and
    ``a = (eta/2)^nu / (2 sin(pi nu / 2))``; for Hertz contacts a = (5/6)^(2/5) / (2 sin(pi/5)). The
    printed constant, with -2 sin(pi/10), gives the imaginary part.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    tau : array_like
        Times, above -chi(h).
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If an argument is outside its domain.

    Examples
    --------
    >>> packet(2.0, chi(2.0)) == packet_front(2.0)
    np.True_
    """
    _, eta, nu = exponents(delta)
    tau, travel = np.broadcast_arrays(real(tau, "tau"), chi(h, delta))
    require(("tau", tau + travel > 0, "must be above -chi"))
    at_top = travel == 0
    travel = np.where(at_top, 1.0, travel)
    # The value is imaginary outside the light cone.
    angle = np.arccosh((tau / travel).astype(complex))
    amplitude = (eta / 2) ** nu / (2 * np.sin(np.pi * nu / 2))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(angle == 0, nu, (np.sinh(nu * angle) / np.sinh(angle)).real)
        return amplitude * np.where(at_top, (2 * tau) ** nu / tau, 2 * travel ** (nu - 1) * ratio)


def packet_front(h: ArrayLike, delta: float = 1.5) -> Array:
    """Return the limit of `packet` at the light cone tau = chi, Eq. (33): 2 nu a chi^(nu - 1).

    For Hertz contacts it varies as h^(-1/2).

    Parameters
    ----------
    h : array_like
        Depths, above 0.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If h is not positive or delta < 1.

    Examples
    --------
    >>> f"{packet_front(1.0) / packet_front(4.0):.6f}"
    '2.000000'
    """
    require(("h", real(h, "h") > 0, "must be above 0"))
    return packet(h, chi(h, delta), delta)


def resonant_packet(h: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return the real part of Eq. (31) for A = lambda^(-nu), which is Eq. (34) for all tau.

    For Hertz contacts A is lambda^(-2/5). The packet has no resonance: the two singular terms of
    Eq. (34) cancel at the light cone, where the packet is smooth. The printed constants of four
    digits leave a spurious peak there, and outside the cone the printed form is wrong.

    Parameters
    ----------
    h : array_like
        Depths, 0 or more.
    tau : array_like
        Times, above -chi(h).
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If an argument is outside its domain; at delta = 1 the integral diverges.

    Examples
    --------
    >>> f"{resonant_packet(2.0, chi(2.0)):.12f}"
    '0.886524713011'
    """
    _, eta, nu = exponents(delta)
    tau = real(tau, "tau")
    travel = chi(h, delta)
    ahead = tau + travel
    require(("tau", ahead > 0, "must be above -chi"), ("delta", delta > 1, "must be above 1"))
    constant = 2 / np.sqrt(np.pi) * np.cos(np.pi * nu) * (eta / 4) ** nu
    amplitude = constant * gamma(1 - 2 * nu) / gamma(1.5 - nu)
    series = hyp2f1(0.5 - nu, 1 - 2 * nu, 1.5 - nu, (tau - travel) / ahead)
    return amplitude * ahead ** (2 * nu - 1) * series


def _bare_mode(h: ArrayLike, lam: ArrayLike, delta: float) -> Complex:
    """Return u_lambda(h) exp(-i lambda chi)."""
    _, eta, nu = exponents(delta)
    lam = np.asarray(lam)
    argument = lam * chi(h, delta)
    with np.errstate(invalid="ignore"):
        inside = real(h, "h") ** (nu * eta / 2) * hankel1e(nu, argument)
    # The Hankel function overflows at tiny arguments, where the limit is exact.
    return np.where(
        np.abs(argument) < NEARLY_ZERO, -1j * gamma(nu) / np.pi * (lam / eta) ** -nu, inside
    )
