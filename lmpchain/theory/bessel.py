"""Bessel-function solutions of uniform chains (Eqs. 5-8, 11, 13) and of any chain (Eqs. 19-21)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import jv

from ..util.arrays import Array
from ..util.lazy import listed
from .domain import exponents, real, require, whole

# Recurrences start where Bessel functions are exp(-640), near the smallest double.
DECAY = 640.0


def coefficients(
    kappa: ArrayLike, n: ArrayLike, k: int, terms: int, scale: float | None = None
) -> Array:
    """Return the coefficients A_1(n) ... A_terms(n) of the series (19), by Eqs. (20)-(21).

    The series is phi_n = sum_j A_j(n) J_(2j-2)(2 sqrt(scale) tau). Because of
    ``cos(2 phi_i) = 1 - omega_i^2 / (2 scale)``, its coefficients are Chebyshev polynomials of the
    matrix of Eq. (3), and a three-term recurrence computes them without eigenvectors. The paper has
    two misprints: the cases of Eq. (20) are j = 1 and j > 1, not i; and after Eq. (21), 90 degrees
    is not a mode of N = 3, which has only two modes.

    Parameters
    ----------
    kappa : (N-1,) array_like
        Constants kappa_1 ... kappa_(N-1) of the contacts, above 0. Grain N is held.
    n : array_like
        Numbers of grains, 1 to N - 1.
    k : int
        Number of the grain that is displaced by 1 at tau = 0, 1 to N - 1.
    terms : int
        Number of coefficients.
    scale : float, optional
        The paper's kappa_N: any number with ``omega <= 2 sqrt(scale)`` for all frequencies; by
        default max(kappa).

    Returns
    -------
    (..., terms) array
        Coefficients; the leading axes are those of n.

    Raises
    ------
    InputError
        If a grain is not in the chain, a kappa is not positive, or the scale is too small.

    Examples
    --------
    >>> # the images of grain 1: J_2 + J_4 at grain 2
    >>> coefficients([1.0, 1.0, 1.0], 2, 1, 5).round(12).tolist()
    [0.0, 1.0, 1.0, 0.0, 0.0]
    """
    kappa = _constants(kappa)
    n = whole("n", n, 1)
    terms = int(whole("terms", terms, 1))
    last = kappa.size + 1
    above = np.append(0.0, kappa[:-1])
    scale = float(kappa.max()) if scale is None else scale
    large = scale >= (above + kappa).max() / 2
    require(
        ("n", n < last, f"must be below {last}, the grain that is held"),
        ("k", 1 <= k < last, f"must be 1 or more and below {last}, the grain that is held"),
        ("scale", large, "must be larger: all frequencies must be below 2 sqrt(scale)"),
    )
    coefficients = np.empty((*n.shape, terms))
    # T_(j-1) and T_j of the matrix, applied to the displacement of grain k.
    previous, current = np.zeros((2, kappa.size))
    current[int(whole("k", k)) - 1] = 1.0
    for j in range(terms):
        coefficients[..., j] = current[n - 1] * (2 if j else 1)
        stretch = np.diff(current, append=0.0) * kappa
        following = 2 * current + np.diff(stretch, prepend=0.0) / scale - previous
        previous = current
        current = following if j else following / 2
    return coefficients


def finite(kappa: ArrayLike, n: ArrayLike, k: int, tau: ArrayLike) -> Array:
    """Return the series (19) for unit displacement of grain k, exact if grain N is fixed.

    Parameters
    ----------
    kappa : (N-1,) array_like
        Constants of the contacts, above 0. Grain N is held.
    n : array_like
        Numbers of grains, 1 to N - 1; broadcasts with tau.
    k : int
        Number of the grain that is displaced, 1 to N - 1.
    tau : array_like
        Times, any real numbers.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a grain is not in the chain, or if a kappa is not positive.

    Examples
    --------
    >>> float(finite([1.0], 1, 1, np.pi).round(12))  # Eq. (17): cos(tau)
    -1.0
    """
    return _series(kappa, n, k, tau)[0]


def finite_impulse(kappa: ArrayLike, n: ArrayLike, k: int, tau: ArrayLike) -> Array:
    """Return the motion after unit dphi/dtau of grain k: the integral of `finite`, term by term.

    The velocity of this motion is `finite`, which has the same arguments.

    Parameters
    ----------
    kappa : (N-1,) array_like
        Constants of the contacts, above 0. Grain N is held.
    n : array_like
        Numbers of grains, 1 to N - 1; broadcasts with tau.
    k : int
        Number of the grain that is struck, 1 to N - 1.
    tau : array_like
        Times, any real numbers.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a grain is not in the chain, or if a kappa is not positive.

    Examples
    --------
    >>> float(finite_impulse([1.0], 1, 1, np.pi / 2).round(12))
    1.0
    """
    return _series(kappa, n, k, tau)[1]


def _constants(kappa: ArrayLike) -> Array:
    kappa = real(kappa, "kappa")
    positive = kappa.ndim == 1 and kappa.size and (kappa > 0).all()
    require(("kappa", positive, "must be a list of numbers above 0"))
    return kappa


def _series(kappa: ArrayLike, n: ArrayLike, k: int, tau: ArrayLike) -> tuple[Array, Array]:
    """Return Eq. (19) and its integral over tau."""
    kappa = _constants(kappa)
    n = whole("n", n, 1)
    root = np.sqrt(kappa.max())
    grains, row = np.unique(n, return_inverse=True)
    even, integral, column = table("tau", 2 * root * real(tau, "tau"))
    weights = coefficients(kappa, grains, k, len(even))
    index = row.reshape(n.shape), column
    return (weights @ even)[index], (weights @ integral)[index] / root


def table(key: str, z: Array, count: int | None = None) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return J_0, J_2 ... J_(2 count - 2) of z, half their integrals, and the index of each z.

    Bessel functions are computed by Miller's downward recurrence, normalised by
    ``J_0 + 2 (J_2 + J_4 + ...) = 1``. Half the integral of J_(2k) is ``J_(2k+1) + J_(2k+3) + ...``.
    Values below exp(-640) may be returned as 0. Without a count the tables end where all values are
    that small.

    Returns
    -------
    even : (count, Z) array
        Bessel functions of the Z different numbers in z.
    integral : (count, Z) array
        Half their integrals from 0.
    column : array of the shape of z
        Index of each z among the different numbers.
    """
    require((key, np.isfinite(z), "must be finite"))
    values, column = np.unique(z, return_inverse=True)
    size = np.maximum(abs(values), 1e-290)
    start = _start(size)
    count = count or int(start.max()) // 2 + 1
    even, integral = np.zeros((2, count, values.size))
    higher, current, norm, odd = np.zeros((4, values.size))
    # Each z starts at its own order; its column is 0 for higher orders.
    for order in range(int(start.max()), -1, -1):
        lower = 2 * (order + 1) / size * current - higher
        higher = current
        current = np.where(order == start, np.exp(-DECAY), lower)
        if order % 2:
            odd += current
            continue
        norm += 2 * current if order else current
        if order // 2 < count:
            even[order // 2] = current
            integral[order // 2] = odd
    return even / norm, integral * np.sign(values) / norm, column.reshape(z.shape)


def _start(z: Array) -> NDArray[np.int64]:
    """Return the order at which J(z) has decayed to exp(-DECAY), by Debye's exponent."""
    # Newton's method starts from above, where the exponent is convex.
    order = z + 80 * np.cbrt(z) + 1
    for _ in range(12):
        angle = np.arccosh(order / z)
        order = order - (order * angle - np.sqrt((order - z) * (order + z)) - DECAY) / angle
    return np.maximum(np.ceil(order), 1).astype(np.int64)


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
    """Return Eq. (6), J_(2(n-p))(2T), for an infinite chain and unit displacement of grain p.

    The main maximum passes grain n at ``2T = 2|n-p| + 0.8086 (2|n-p|)^(1/3)``, not at 2T = 2|n-p|.

    Parameters
    ----------
    n : array_like
        Numbers of grains, of any sign.
    p : array_like
        Number of the displaced grain, of any sign.
    T : array_like
        Times tau sqrt(kappa), any real numbers.

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

    The velocities are dphi/dT. The text of the paper has dphi/dtau, which is larger by the factor
    sqrt(kappa).

    Parameters
    ----------
    n : array_like
        Numbers of grains, of any sign; broadcasts with T.
    T : array_like
        Times tau sqrt(kappa), any real numbers.
    p : (P,) array_like
        Numbers of the grains that have initial data; all other grains are at rest.
    displacement : (P,) array_like
        Displacements phi of these grains at T = 0.
    velocity : (P,) array_like
        Velocities dphi/dT of these grains at T = 0.

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
    # A picture often repeats the same grains and times.
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
    """Return Eq. (11), J_(2n-2)(2T) + J_(2n)(2T), for unit displacement of a free end.

    In a finite chain it is valid until the wave returns from the other end.

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    T : array_like
        Times tau sqrt(kappa), any real numbers.

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

    For unit dphi/dtau, divide the result by sqrt(kappa).

    Parameters
    ----------
    n : array_like
        Numbers of grains, from 1.
    T : array_like
        Times tau sqrt(kappa), any real numbers.

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

    An infinite chain with the local kappa does not approximate Eq. (3). It has no image in the free
    end, its error is 58 to 127 % (L2 norm), and its front arrives at tau = n^(eta/2) instead of
    (2/eta) n^(eta/2).

    Parameters
    ----------
    n : array_like
        Whole numbers, 0 or more.
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

    The limit is ``n^(-xi/4) cos(2 n^(xi/2) tau - pi n - pi/4) / sqrt(pi tau)``, for tau far above
    2 n^2 / sqrt(kappa_n). Here tau is the time of Eq. (3); the tau of Eq. (8) in the paper is this
    time divided by g^(1/6). Solutions of Eq. (3) differ at long times: they do not oscillate, and
    after a displacement of the top grain they are ``-0.23103 tau^(-6/5)``.

    Parameters
    ----------
    n : array_like
        Whole numbers, 1 or more.
    tau : array_like
        Times, above 0.
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
