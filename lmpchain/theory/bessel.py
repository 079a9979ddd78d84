"""Bessel-function solutions of the uniform chain (Eqs. 5-8, 11, 13) and any chain (Eqs. 19-21)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import jv

from ..util.arrays import Array
from ..util.lazy import listed
from .bessel_series import coefficients, finite, finite_impulse, table
from .domain import exponents, real, require, whole

__dir__ = listed(__name__)
__all__ = [
    "coefficients",
    "far_field",
    "finite",
    "finite_impulse",
    "free_end",
    "free_end_impulse",
    "infinite",
    "infinite_general",
    "local",
]


def infinite(n: ArrayLike, p: ArrayLike, T: ArrayLike) -> Array:
    """Return Eq. (6), J_(2(n-p))(2T), of an infinite chain after unit displacement of grain p.

    T is tau sqrt(kappa). The main maximum passes at ``2T = 2|n-p| + 0.8086 (2|n-p|)^(1/3)``, not at
    2T = 2|n-p|.

    Parameters
    ----------
    n, p : array_like
        Whole numbers of any sign.
    T : array_like
        Any real number.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n or p are not whole.

    Examples
    --------
    >>> infinite([-1, 0, 1], 0, 0.0).tolist()
    [0.0, 1.0, 0.0]
    """
    return jv(2 * abs(whole("n", n) - whole("p", p)), 2 * real(T, "T"))


def infinite_general(
    n: ArrayLike,
    T: ArrayLike,
    p: ArrayLike,
    displacement: ArrayLike = 0.0,
    velocity: ArrayLike = 0.0,
) -> Array:
    """Return the motion of the infinite uniform chain from any initial data, Eq. (5).

    The velocities are dphi/dT: the paper's text says dphi/dtau, which is larger by sqrt(kappa).

    Parameters
    ----------
    n, T : array_like
        As for `infinite`; they broadcast.
    p : (P,) array_like
        The grains that have initial data; all others rest at 0.
    displacement, velocity : (P,) array_like
        Their phi and dphi/dT at T = 0.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n or p are not whole.

    Examples
    --------
    >>> # a free end is its own image
    >>> both = infinite_general(3, 2.5, [1, 0], displacement=[1.0, 1.0])
    >>> abs(both - free_end(3, 2.5)) < 1e-14
    np.True_
    """
    n = whole("n", n)
    p = whole("p", p)
    # a picture asks for the same grains and times many times over
    grains, row = np.unique(n, return_inverse=True)
    distance = abs(grains[:, None] - p)
    even, integral, column = table("T", 2 * real(T, "T"), int(distance.max()) + 1)
    motion = np.zeros((grains.size, even.shape[1]))
    for amplitude, functions in ((displacement, even), (velocity, integral)):
        weights = np.zeros((grains.size, len(functions)))
        np.add.at(
            weights, (np.arange(grains.size)[:, None], distance), real(amplitude, "amplitude")
        )
        motion += weights @ functions
    return motion[row.reshape(n.shape), column]


def free_end(n: ArrayLike, T: ArrayLike) -> Array:
    """Return Eq. (11), J_(2n-2)(2T) + J_(2n)(2T): the semi-infinite chain, grain 1 displaced by 1.

    It holds in a finite chain until the wave has come back from the other end.

    Parameters
    ----------
    n : array_like
        Grain, from 1.
    T : array_like
        tau sqrt(kappa), any real number.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1.

    Examples
    --------
    >>> free_end([1, 2, 3], 0.0).tolist()
    [1.0, 0.0, 0.0]
    """
    n = whole("n", n, 1)
    z = 2 * real(T, "T")
    return jv(2 * n - 2, z) + jv(2 * n, z)


def free_end_impulse(n: ArrayLike, T: ArrayLike) -> Array:
    """Return the motion after unit dphi/dT of grain 1, Eq. (13): the integral of `free_end`.

    For unit dphi/dtau divide by sqrt(kappa). Arguments and errors as for `free_end`.

    Parameters
    ----------
    n, T : array_like
        As for `free_end`.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1.

    Examples
    --------
    >>> f"{free_end_impulse(1, 1e-3):.9f}"
    '0.001000000'
    """
    n = whole("n", n, 1)
    _, integral, column = table("T", 2 * real(T, "T"), int(n.max()) + 1)
    return integral[n - 1, column] + integral[n, column]


def local(n: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return J_(2n)(2 sqrt(kappa_n) tau), Eq. (7) with phi_0 = 1 and the tau of Eq. (3).

    An infinite chain of the local kappa is no approximation of Eq. (3): it lacks the image in the
    free end and is 58-127 % off (L2), with the front at tau = n^(eta/2) instead of (2/eta)
    n^(eta/2).

    Parameters
    ----------
    n : array_like
        Whole numbers, 0 or more.
    tau : array_like
        Any real number.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or negative, or delta < 1.

    Examples
    --------
    >>> f"{local(1, 1.0):.6f}"
    '0.352834'
    """
    xi = exponents(delta).xi
    n = whole("n", n, 0)
    return jv(2 * n, 2 * n ** (xi / 2) * real(tau, "tau"))


def far_field(n: ArrayLike, tau: ArrayLike, delta: float = 1.5) -> Array:
    """Return Eq. (8) with phi_0 = 1: the limit of `local` at long times.

    It holds for tau, that of Eq. (3), far above 2 n^2 / sqrt(kappa_n).

    ``n^(-xi/4) cos(2 n^(xi/2) tau - pi n - pi/4) / sqrt(pi tau)``; the paper's own tau here is that
    of Eq. (3) over g^(1/6). It is not how Eq. (3) behaves at long times: there nothing oscillates,
    and a displaced top grain leaves ``-0.23103 tau^(-6/5)``.

    Parameters
    ----------
    n, tau : array_like
        As for `local`; tau above 0.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If n is not whole or below 1, tau is not positive, or delta < 1.

    Examples
    --------
    >>> f"{far_field(1, 100.0):.5f} {local(1, 100.0):.5f}"
    '0.01540 0.01489'
    """
    xi = exponents(delta).xi
    n = whole("n", n, 1)
    tau = real(tau, "tau")
    require(("tau", tau > 0, "must be above 0"))
    return (
        np.cos(2 * n ** (xi / 2) * tau - np.pi * (n + 0.25)) / np.sqrt(np.pi * tau) / n ** (xi / 4)
    )
