"""Dyson's distribution of force constants (Eq. 23), its exact spectrum, and the sum of Eq. (22)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, xlogy

from ..util.arrays import Array, check_flags
from ..util.lazy import listed
from .domain import real, require

__dir__ = listed(__name__)


def weight(kappa: ArrayLike, m: ArrayLike) -> Array:
    """Return D_m(kappa) = m^m / (m-1)! kappa^m exp(-m kappa), Eq. (23) as printed.

    It is a normalised density of mean 1 + 1/m and variance (m+1)/m^2. Its power of kappa is larger
    by 1 than in Dyson's own density, see `density`.

    Parameters
    ----------
    kappa : array_like
        Force constants, 0 or more.
    m : array_like
        Order m, above 0 and not necessarily whole; broadcasts against kappa. A larger m means less
        disorder.

    Returns
    -------
    array

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
    """Return Dyson's density m^m / (m-1)! kappa^(m-1) exp(-m kappa), of mean 1 and variance 1/m.

    See F. J. Dyson, Phys. Rev. 92, 1331 (1953). For m < 1 the density is infinite at kappa = 0.

    Parameters
    ----------
    kappa : array_like
        Force constants, 0 or more.
    m : array_like
        Order m, above 0 and not necessarily whole; broadcasts against kappa.

    Returns
    -------
    array

    Examples
    --------
    >>> float(density(0.0, 1))
    1.0
    """
    return _gamma(kappa, m, 1)


def average(velocity: ArrayLike, kappa: ArrayLike, m: ArrayLike, normalised: bool = False) -> Array:
    """Return sum_n D_m(kappa_n) velocity_n, Eq. (22) as printed, or divided by sum_n D_m(kappa_n).

    The printed sum is not an average, because the weights do not add up to 1. As m grows the sum
    tends to ``sqrt(m / 2 pi)`` times the velocity of the grain with kappa = 1.

    Parameters
    ----------
    velocity : (..., N) array_like
        Velocities of the grains.
    kappa : (N,) array_like
        Force constants kappa_1 ... kappa_N.
    m : array_like
        Order m; broadcasts against the leading axes of velocity.
    normalised : bool
        Whether the sum is divided by the sum of the weights.

    Returns
    -------
    (...) array

    Raises
    ------
    InputError
        If a kappa is negative, if m is not positive, or if there is not one kappa for each grain.

    Examples
    --------
    >>> float(average([1.0, 1.0, 1.0], [1.0, 2.0, 3.0], 5, normalised=True))
    1.0
    """
    check_flags(normalised=normalised)
    velocity = real(velocity, "velocity")
    kappa = real(kappa, "kappa")
    alike = kappa.shape == velocity.shape[-1:]
    require(("kappa", alike, "must have one force constant for each grain of velocity"))
    weights = weight(kappa, real(m, "m")[..., None])
    total = (weights * velocity).sum(-1)
    return total / weights.sum(-1) if normalised else total


def integrated(frequency: ArrayLike, shape: float, rate: float = 1.0) -> Array:
    """Return the fraction of modes below a frequency in Dyson's exactly solvable random chain.

    All 2N - 1 ratios k_n / m_n and k_n / m_(n+1) of this chain are independent, with a gamma
    distribution of this shape and rate; F. J. Dyson, Phys. Rev. 92, 1331 (1953). The fraction is
    ``1 - Im Omega(-1/omega^2 + i0) / pi`` with ``Omega(x) = 2 d/dc ln U(shape, c, rate/x)`` at
    c = 1. The integral of Tricomi's function U is computed along a path where the integrand decays.

    Parameters
    ----------
    frequency : array_like
        Frequencies omega, rad/s, above 0.
    shape : float
        Shape of the gamma distribution, 0.05 to 100.
    rate : float
        Inverse scale of the gamma distribution, s2: the mean ratio is shape / rate.

    Returns
    -------
    array
        Fractions, 0 to 1, of the shape of `frequency`, with an error of 1e-7 or less.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> f"{integrated(1.0, 1):.10f}"
    '0.4215709293'
    """
    square = real(frequency, "frequency") ** 2
    require(
        ("frequency", (square > 0) & np.isfinite(square), "must be above 0 and finite"),
        ("shape", 0.05 <= shape <= 100, "must be 0.05 to 100"),
        ("rate", 0 < rate < np.inf, "must be above 0 and finite"),
    )
    # U(a, c, z) Gamma(a) is the integral of exp(-z t) t^(a-1) (1+t)^(c-a-1) from 0 to infinity,
    # with -z = rate omega^2. The path passes the saddle point in the upper half plane, where the
    # steepest descent has the angle three quarters of pi.
    scale = rate * square
    discriminant = 0.25 - shape / scale
    saddle = -0.5 + 1j * np.sqrt(np.maximum(-discriminant, 0.04))
    top = np.where(discriminant > 0, np.sqrt(np.maximum(discriminant, 0)) - 0.5, saddle)
    peak = (scale * top + shape * np.log(top / (1 + top))).real
    onward = np.abs(saddle) * np.exp(0.75j * np.pi)
    # Exponent beyond which the integrand is negligible.
    far = 60.0
    total = np.zeros((2, *scale.shape), complex)

    def add(t: Array, log: Array, speed: Array) -> None:
        """Add the integrand times d log(t), and the same times log(1+t)."""
        size = np.exp(scale * t + shape * (log - np.log1p(t)) - peak) * speed
        total[:] += size, size * np.log1p(t)

    # The range is larger if the peak at the saddle is sharp, for a large shape, because it is then
    # like a Gaussian at first.
    toward = far / shape + 0.5 + np.log(np.abs(saddle) / np.minimum(np.abs(top), 1))
    beyond = np.log1p((far + 0.4 * shape) / np.sqrt(shape * scale))
    for node, weight in zip(*_panels(), strict=True):
        y = node * toward
        w = node * beyond
        add(saddle * np.exp(-y), np.log(saddle) - y, weight * toward)
        t = saddle + onward * np.expm1(w)
        add(t, np.log(t), weight * beyond * onward * np.exp(w) / t)
    return 1 - 2 / np.pi * (total[1] / total[0]).imag


def _panels(count: int = 200) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights in equal panels of the unit interval."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    positions = (np.arange(count)[:, None] + (nodes + 1) / 2) / count
    return positions.ravel(), np.tile(weights / 2 / count, count)


def _gamma(kappa: ArrayLike, m: ArrayLike, lower: int) -> Array:
    """Return m^m / Gamma(m) kappa^(m - lower) exp(-m kappa) without cancellation of large terms."""
    kappa = real(kappa, "kappa")
    m = real(m, "m")
    require(
        ("kappa", kappa >= 0, "must be 0 or more"),
        ("m", (m > 0) & np.isfinite(m), "must be above 0"),
    )
    return np.exp(_log_peak(m) + xlogy(m - lower, kappa) - m * (kappa - 1))


def _log_peak(m: Array) -> Array:
    """Return log(m^m exp(-m) / Gamma(m)), by Stirling's series for large m."""
    small = np.minimum(m, 20.0)
    large = np.maximum(m, 20.0)
    series = (1 / 12 - (1 / 360 - (1 / 1260 - 1 / 1680 / large**2) / large**2) / large**2) / large
    # The terms of the exact formula cancel for large m.
    return np.where(
        m < 20,
        xlogy(small, small) - small - gammaln(small),
        np.log(large / (2 * np.pi)) / 2 - series,
    )
