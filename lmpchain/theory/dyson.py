"""Dyson's distribution of force constants (Eq. 23) and the paper's weighted sum (Eq. 22)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, xlogy

from ..util.arrays import Array
from .domain import real, require


def weight(kappa: ArrayLike, m: ArrayLike) -> Array:
    """Return D_m(kappa) = m^m / (m-1)! kappa^m exp(-m kappa), Eq. (23) as printed.

    It is a normalised density of mean 1 + 1/m and variance (m+1)/m^2: the power is one too high for Dyson's own, which
    is `density`.

    Parameters
    ----------
    kappa : array_like
        Force constants, 0 or more.
    m : array_like
        Order, above 0 and not necessarily whole; broadcasts against kappa. Large m means order.

    Raises
    ------
    InputError
        If kappa is negative or m is not positive.

    Examples
    --------
    >>> f"{weight(1.0, 1):.12f} {np.exp(-1):.12f}"
    '0.367879441171 0.367879441171'
    """
    return _gamma(kappa, m, 0)


def density(kappa: ArrayLike, m: ArrayLike) -> Array:
    """Return Dyson's own m^m / (m-1)! kappa^(m-1) exp(-m kappa), of mean 1 and variance 1/m.

    F. J. Dyson, Phys. Rev. 92, 1331 (1953). Arguments as for `weight`; infinite at kappa = 0 for m < 1.

    Examples
    --------
    >>> float(density(0.0, 1))
    1.0
    """
    return _gamma(kappa, m, 1)


def average(velocity: ArrayLike, kappa: ArrayLike, m: ArrayLike, normalised: bool = False) -> Array:
    """Return sum_n D_m(kappa_n) velocity_n, Eq. (22) as printed, or divided by sum_n D_m(kappa_n).

    As printed this is no average: the weights add up to anything, and as m grows the sum tends to
    ``sqrt(m / 2 pi)`` times the velocity of the grain with kappa = 1.

    Parameters
    ----------
    velocity : (..., N) array_like
    kappa : (N,) array_like
        kappa_1 ... kappa_N.
    m : array_like
        Order; broadcasts against the leading axes of velocity.
    normalised : bool
        Divide by the sum of the weights.

    Returns
    -------
    (...) array

    Raises
    ------
    InputError
        As `weight`, or if there is not one kappa a grain.

    Examples
    --------
    >>> float(average([1.0, 1.0, 1.0], [1.0, 2.0, 3.0], 5, normalised=True))
    1.0
    """
    velocity, kappa = real(velocity), real(kappa)
    require(("kappa", kappa.shape == velocity.shape[-1:], "must hold one force constant for each grain of velocity"))
    weights = weight(kappa, real(m)[..., None])
    total = (weights * velocity).sum(-1)
    return total / weights.sum(-1) if normalised else total


def _gamma(kappa: ArrayLike, m: ArrayLike, lower: int) -> Array:
    """Return m^m / Gamma(m) kappa^(m - lower) exp(-m kappa), with no large terms that cancel."""
    kappa, m = real(kappa), real(m)
    require(("kappa", kappa >= 0, "must be 0 or more"), ("m", (m > 0) & np.isfinite(m), "must be above 0"))
    return np.exp(_log_peak(m) + xlogy(m - lower, kappa) - m * (kappa - 1))


def _log_peak(m: Array) -> Array:
    """Return log(m^m exp(-m) / Gamma(m)), by Stirling's series where m is large."""
    small, large = np.minimum(m, 20.0), np.maximum(m, 20.0)
    series = (1 / 12 - (1 / 360 - (1 / 1260 - 1 / 1680 / large**2) / large**2) / large**2) / large
    return np.where(m < 20, xlogy(small, small) - small - gammaln(small), np.log(large / (2 * np.pi)) / 2 - series)
