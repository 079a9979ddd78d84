"""Laws for the errors of the homogeneous and the continuous chain, in the paper's variables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lmpchain.theory.continuum import chi, depth
from lmpchain.theory.domain import exponents, real, require
from lmpchain.util.arrays import Array

SLOWEST_TAIL = {0.01: 3.3, 0.001: 6.1, 0.0001: 8.5}  # Constants of `behind_front`.


def uniform_law(gradient: float, travelled: float, width: float = 0.0) -> float:
    """Return the first-order error of Eq. (6) in a column.

    (6), all contacts as stiff as that below the displaced grain.

    Norm: root of the sum of squares over grains at an instant, of displacements. A wave of wave
    number k, with omega = 2 sin(k/2), that runs for T = tau sqrt(kappa) meets other stiffnesses
    than those where it began, and gets out of phase by sin(k) T^2 gradient / 4. Its amplitude
    changes, too; and the contact above is softer. The difference of both solutions, where Eq. (6)
    itself is cos(omega T) exp(-s^2 k^2/2), is ::

        i gradient [(cos(k/2) / 4 - omega s^2 k / 2) T sin(omega T) + sin(k) T^2/4 cos(omega T)]
        exp(-s^2 k^2/2)
          + gradient omega T/4 sin(omega T) exp(-s^2 k^2/2)

    Parameters
    ----------
    gradient : float
        Relative change of stiffness from one contact to the next; xi/n in a column.
    travelled : float
        T, how many grains the front has gone.
    width : float
        s, standard deviation in grains of a displacement of Gaussian shape; 0 for that of one
        grain.
    """
    T = travelled
    s = width
    count = 64 + 8 * int(T + 1)
    k = np.pi * (np.arange(count) + 0.5) / count
    weight = np.exp(-((s * k) ** 2))
    omega = 2 * np.sin(k / 2)
    sine = np.sin(omega * T)
    cosine = np.cos(omega * T)
    odd = (np.cos(k / 2) / 4 - omega * s**2 * k / 2) * T * sine + np.sin(k) * T**2 / 4 * cosine
    even = omega * T / 4 * sine
    return float(
        gradient * np.sqrt((weight * (odd**2 + even**2)).sum() / (weight * cosine**2).sum())
    )


def uniform_reach(error: float, gradient: float) -> float:
    """Return the distance in grains at which the error of Eq. (6) reaches this value.

    sqrt(4 sqrt(2) error / gradient), the limit of `uniform_law` for many grains: sqrt(12 sqrt(2)
    error n) at grain n of a Hertzian column.

    Examples
    --------
    >>> round(uniform_reach(0.1, 1 / (3 * 50)), 1)  # grain 50, as in Fig. 2
    9.2
    """
    return float(np.sqrt(4 * 2**0.5 * error / gradient))


def bessel_law(contrast: float, tau: float) -> float:
    """Return the error of the engine "bessel" after a strike, with contacts as stiff as the first.

    Norm: that of the package. Early, contact 2 is harder by the contrast than assumed: tau^4
    contrast / 24 (Taylor series); exp(-tau^2/4), fitted, stands for the further terms. Late, the
    front is at n = tau - 0.51 tau^(1/3) and, through contacts each harder than the one before,
    early by contrast (n^2/4 - n/2); displacements are off by that times the largest velocity, 1.071
    n^(-1/3), over the largest displacement, 1.274 (Airy). Within 25 % of what is measured for
    errors below 0.05, and 40 % below 0.1.

    Parameters
    ----------
    contrast : float
        Stiffness of contact 2 over that of contact 1, minus 1; 2^xi - 1 without a load.

    Examples
    --------
    >>> f"{bessel_law(2 ** (1 / 3) - 1, 1.0):.4f}"
    '0.0084'
    """
    early = tau**4 / 24 * np.exp(-(tau**2) / 4)
    front = max(tau - 0.51 * np.cbrt(tau), 2.0)  # Earlier, the wave has passed no grain.
    late = (front**2 / 4 - front / 2) * 1.071 / 1.274 / np.cbrt(front)
    return float(contrast * (early + late))


def far_field_law(n: ArrayLike, tau: ArrayLike, exponent: float = 1.5) -> Array:
    """Return the error of Eq. (8) against its parent Eq. (7): (16 n^2 - 1) / (16 n^(xi/2) tau).

    Norm: at one grain over a period, relative to the amplitude 1 / (n^(xi/4) sqrt(pi tau)). The
    next term of Hankel's expansion of J_2n. Both are far from Eq. (3), in which nothing oscillates
    after long times.

    Examples
    --------
    >>> float(far_field_law(1, 93.75))
    0.01
    """
    xi, _, _ = exponents(exponent)
    return (16 * real(n) ** 2 - 1) / (16 * real(n) ** (xi / 2) * real(tau))


def continuum_law(width: float, tau: float, exponent: float = 1.5) -> float:
    """Return the error of Eq. (27) after a strike spread as exp(-chi(h)^2 / (2 width^2)).

    Norm: root of the sum of squares over grains at tau, of velocities. The wave of frequency lambda
    lags behind by the phase lambda^3 w^3 / 3, w^3 = h^(1 - 3 xi/2) / (8 - 12 xi) (Airy), at the
    depth h of the front. In the travel time chi, Eq. (27) is the radial wave equation in d = 1 +
    xi/eta dimensions, where the spectrum of a Gaussian is one: error = (w^3/3) sqrt((d/2) (d/2 + 1)
    (d/2 + 2)) / width^3. Some 20 % too large for Hertz at tau = 10, 7 % at 100.

    Parameters
    ----------
    width : float
        In units of tau; in grains it is `lmpchain.theory.continuum.depth` of it.

    Examples
    --------
    >>> f"{continuum_law(3.0, 100.0):.3f}"
    '0.069'
    """
    return _airy_lag(tau, exponent) / width**3


def continuum_width(error: float, tau: float, exponent: float = 1.5) -> float:
    """Return the width, in grains, above which the error of Eq. (27) at tau is below this value.

    It follows from `continuum_law`.
    It grows as slowly as tau^(6/25) for Hertz.

    Examples
    --------
    >>> [round(continuum_width(error, 100.0), 1) for error in (0.01, 0.1)]
    [6.5, 2.6]
    """
    return float(depth(np.cbrt(_airy_lag(tau, exponent) / error), exponent))


def _airy_lag(tau: float, exponent: float) -> float:
    xi, eta, _ = exponents(exponent)
    power = 1 - 1.5 * xi
    half = (1 + xi / eta) / 2
    lag = float(depth(tau, exponent)) ** power / (24 * power)
    return float(lag * np.sqrt(half * (half + 1) * (half + 2)))


def harmonic_law(frequency: ArrayLike, h: ArrayLike) -> Array:
    """Return the error of Eq. (30) at depth h below a driven top: phase omega^3 sqrt(h) / 12.

    The difference of the wave numbers, k^3 / 24 with k = omega / h^(1/6), summed up from the top.
    At the first grains, where no wavelength fits in, it is less: what is measured is lower by 0.01
    at omega = 0.3 and 0.03 at 0.7.

    Examples
    --------
    >>> float(harmonic_law(0.5, 96.0 ** 2 / 100).round(3))  # Fig. 8, grain 92
    0.1
    """
    return real(frequency) ** 3 * np.sqrt(real(h)) / 12


def behind_front(h: ArrayLike, error: float = 0.01) -> Array:
    """Return the time tau after which Eq. (35) at depth h has less than this error (Hertz).

    Norm: relative error of the displacement of one grain after a strike on grain 1. The top sends
    down no wave above its own band edge, omega = 2, and the slowest of them lags behind the light
    cone by sqrt(h). They leave a tail: chi + sqrt(h) + s h^(1/4), with s fitted for tau from 30 to
    300, 3.3 for an error of 1 %.

    Raises
    ------
    InputError
        If s is not known for that error.
    """
    require(
        (
            "error",
            error in SLOWEST_TAIL,
            f"must be one of {', '.join(map(str, SLOWEST_TAIL))} (got {error})",
        )
    )
    return chi(h) + np.sqrt(real(h)) + SLOWEST_TAIL[error] * real(h) ** 0.25


def phase_velocity(wavelength: ArrayLike) -> Array:
    """Return the ratio of phase velocities of chain and continuum, sin(x)/x.

    Here x = pi / wavelength in grains.
    From omega = 2 sqrt(kappa) sin(k/2). It is 1 % lower at 12.8 grains and 10 % at 4.0.

    Examples
    --------
    >>> phase_velocity([12.8, 4.0]).round(2).tolist()
    [0.99, 0.9]
    """
    return np.sinc(1 / real(wavelength))
