"""Eigenmodes of the linearised chain (Eqs. 14-16), and frequencies in the continuum limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh_tridiagonal
from scipy.special import ai_zeros, jv, jvp, roots_legendre

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.lazy import listed
from .domain import exponents, real, require, whole

__dir__ = listed(__name__)

# Relative gap of modes of one eigenspace, and mixing whose square is at rounding level.
DEGENERATE = 1e-8
# Half the difference of the two rates of a critically damped mode, relative to its frequency.
CRITICAL = 1e-9


@dataclass(frozen=True, eq=False)
class Eigenmodes:
    """The eigenmodes of a chain with M moving grains.

    Attributes
    ----------
    frequency : (M,) array
        Frequencies, rad/s, ascending.
    shape : (M, M) array
        Column p is mode p, X_n(lambda_p) / sqrt(K_p) of Eqs. (14)-(16), normalised such that
        ``shape.T @ diag(mass) @ shape = 1``.
    mass : (M,) array
        Masses, kg.
    decay : (M,) array or None
        Decay rates, 1/s, ``(A w^2 + gamma) / 2`` for uniform A and gamma; None without damping. The
        amplitude of free motion decays as ``exp(-decay t)``, at the frequency ``sqrt(w^2 -
        decay^2)``.
    """

    frequency: Array
    shape: Array
    mass: Array
    decay: Array | None = None

    def response(
        self, time: ArrayLike, displacement: ArrayLike = 0.0, velocity: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Return the motion after any initial displacement, Eq. (15), and velocity, with sin(wt)/w.

        Damped modes are independent, too, and may be overdamped.

        Parameters
        ----------
        time : (T,) array_like
            Times, s.
        displacement : (M,) array_like
            Displacements at time 0, m.
        velocity : (M,) array_like
            Velocities at time 0, m/s.

        Returns
        -------
        displacement : (T, M) array
            Displacements, m.
        velocity : (T, M) array
            Velocities, m/s.

        Examples
        --------
        >>> chain = Chain(grains=2, diameter=1e-3)  # Eq. (17): phi_1 = cos(tau)
        >>> u, v = eigenmodes(chain).response([0.0, np.pi * chain.time_scale], displacement=[1.0])
        >>> u.ravel().round(12).tolist()
        [1.0, -1.0]
        """

        def project(start: ArrayLike) -> Array:
            return (np.broadcast_to(real(start, "start"), self.mass.shape) * self.mass) @ self.shape

        later = real(time, "time")[..., None]
        amplitude, rate = self.free(later, project(displacement), project(velocity))
        return amplitude @ self.shape.T, rate @ self.shape.T

    def free(self, time: Array, amplitude: Array, rate: Array) -> tuple[Array, Array]:
        """Return the amplitudes of the modes and their rates after a time, (..., M).

        Parameters
        ----------
        time : (..., M) array
            Time, s; broadcasts with the other arguments.
        amplitude : (..., M) array
            Amplitudes at time 0, sqrt(kg) m.
        rate : (..., M) array
            Time derivatives of the amplitudes at time 0, sqrt(kg) m/s.
        """
        w = self.frequency
        if self.decay is None:
            angle = time * w
            cos = np.cos(angle)
            sin = np.sin(angle)
            return amplitude * cos + rate / w * sin, rate * cos - amplitude * w * sin
        slow, fast = self.exponents
        apart = slow - fast
        # Neither exponential overflows for overdamped modes.
        lag = np.expm1(-apart * time)
        left = np.exp(slow * time)
        sine = (left * -lag / apart).real
        cosine = (left * (1 + lag / 2)).real
        decay = self.decay
        return (
            amplitude * (cosine + decay * sine) + rate * sine,
            rate * (cosine - decay * sine) - amplitude * w**2 * sine,
        )

    @property
    def exponents(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Both rates, 1/s, of the exponentials of every damped mode, the slower one first."""
        assert self.decay is not None
        w = self.frequency
        # The roots of a critical mode are separated by an invisible amount.
        difference = (self.decay - w) * (self.decay + w)
        difference = np.where(
            np.abs(difference) < (CRITICAL * w) ** 2, (CRITICAL * w) ** 2, difference
        )
        fast = -(self.decay + np.sqrt(difference + 0j))
        return w**2 / fast, fast


def eigenmodes(chain: Chain) -> Eigenmodes:
    """Return the eigenmodes of the chain linearised about its equilibrium, Eqs. (14)-(16).

    The paper does not state that its lambda is -omega^2. Its recursion for X_n from the top
    overflows beyond about 700 grains, so the symmetric tridiagonal matrix is diagonalised instead.
    Frequencies are computed as Rayleigh quotients, which are sums of squares:
    ``omega^2 = sum_n k_n (X_n - X_(n+1))^2``. All of them have relative errors of a few 1e-16. The
    shapes of modes below half the highest frequency are as accurate, if the highest frequency is
    less than 1e5 times the lowest. Time and memory grow as M^2, to seconds at M = 5000.

    Parameters
    ----------
    chain : Chain
        A chain under gravity or a load.

    Returns
    -------
    Eigenmodes
        Frequencies, ascending, and shapes, orthonormal in mass; with damping, decay rates.

    Raises
    ------
    InputError
        If no contact is compressed, so that nothing can be linearised, or if contacts or grains are
        damped differently, which couples the modes.

    Examples
    --------
    >>> chain = Chain(grains=11, diameter=1e-3)
    >>> modes = eigenmodes(chain)
    >>> (modes.frequency * chain.time_scale)[[0, -1]].round(12).tolist()
    [0.205435847948, 2.719178378759]
    """
    message = "carries no force at rest: nothing to linearise without gravity or a top load"
    require(("chain", chain.compressed, message), *unequal_damping(chain))
    chain.refuse_loose("theory of modes")
    chain.refuse_ground_without_modes("theory of modes")
    moving = slice(0, chain.movable)
    stiffness = chain.contacts.stiffness[: chain.movable + 1]
    modes = between(stiffness, chain.masses[moving], ground_of(chain)[moving])
    return damped(modes, chain)


def ground_of(chain: Chain) -> Array:
    """Return the ground stiffness of every grain at rest; raise an error if one is negative.

    Parameters
    ----------
    chain : Chain
        The chain at rest.

    Returns
    -------
    (N,) array
        Stiffness, N/m.

    Raises
    ------
    InputError
        If the ground pushes a grain away from rest.
    """
    cure = "must have a stiffness of 0 or more at rest: no mode is sure to exist otherwise"
    require(("chain.ground", bool((chain.ground_stiffness >= 0).all()), cure))
    return chain.ground_stiffness


def unequal_damping(chain: Chain) -> list[tuple[str, bool, str]]:
    """Return whether damping couples no modes: equal viscosities, drags, and pulls of the ground.

    Parameters
    ----------
    chain : Chain
        The chain to check.

    Returns
    -------
    list of (str, bool, str)
        Rules for `require`: the field, whether it leaves the modes uncoupled, and the message if it
        does not.
    """
    cure = "give one number"
    # Without the ground, the viscous forces of a mode are A w^2 times its velocity.
    pulls = _squared_rates_of_ground(chain)
    even = not chain.contact_viscosity.any() or np.ptp(pulls) <= 1e-14 * pulls.max(initial=0.0)
    return [
        (
            "chain.damping.viscoelastic",
            not np.ptp(chain.contact_viscosity),
            f"differs from contact to contact, which couples the modes: {cure}",
        ),
        (
            "chain.damping.drag",
            not np.ptp(chain.drag),
            f"differs from grain to grain, which couples the modes: {cure}",
        ),
        (
            "chain.ground",
            bool(even),
            "acts differently on different grains, which couples viscous modes: use drag alone",
        ),
    ]


def _squared_rates_of_ground(chain: Chain) -> Array:
    """Return the squared frequency of each moving grain on the ground alone, (M,) rad^2/s^2."""
    moving = slice(0, chain.movable)
    return chain.ground_stiffness[moving] / chain.masses[moving]


def damped(modes: Eigenmodes, chain: Chain) -> Eigenmodes:
    """Return the modes with the decay by the common A and the common gamma of a chain.

    Parameters
    ----------
    modes : Eigenmodes
        Modes of the chain without damping.
    chain : Chain
        The chain with damping.

    Returns
    -------
    Eigenmodes
    """
    if not chain.damped:
        return modes
    # Contacts alone are viscous, not the ground.
    squared = modes.frequency**2 - _squared_rates_of_ground(chain)[:1].sum()
    decay = (chain.contact_viscosity[0] * squared + chain.drag[0]) / 2
    return replace(modes, decay=decay)


def between(stiffness: Array, mass: Array, ground: Array | None = None) -> Eigenmodes:
    """Return the eigenmodes of M grains between two fixed bodies, or free ends.

    Parameters
    ----------
    stiffness : (M+1,) array
        Stiffnesses of the contacts above, between and below the grains, N/m; 0 at a free end.
    mass : (M,) array
        Masses, kg.
    ground : (M,) array, optional
        Stiffness between each grain and the ground, N/m.

    Returns
    -------
    Eigenmodes
    """
    ground = np.zeros(mass.size) if ground is None else ground
    diagonal = (stiffness[:-1] + stiffness[1:] + ground) / mass
    _, vectors = eigh_tridiagonal(diagonal, -stiffness[1:-1] / np.sqrt(mass[:-1] * mass[1:]))
    shape = vectors / np.sqrt(mass)[:, None]
    shape /= np.sqrt(mass @ shape**2)
    frequency = _rayleigh(shape, stiffness, ground)
    order = np.argsort(frequency)
    frequency = frequency[order]
    shape = shape[:, order]
    # LAPACK's error is relative to the highest frequency, so only low modes are inaccurate.
    low = int(frequency.searchsorted(frequency[-1] / 2))
    if low > 1:
        shape[:, :low] = _separate(shape[:, :low], stiffness, mass, ground)
        frequency[:low] = _rayleigh(shape[:, :low], stiffness, ground)
    return Eigenmodes(frequency, shape, mass)


def _extend(shape: Array) -> Array:
    """Return the extension of every contact by every mode, (M+1, P)."""
    return np.diff(shape, axis=0, prepend=0.0, append=0.0)


def _rayleigh(shape: Array, stiffness: Array, ground: Array) -> Array:
    """Return the frequencies of mass-normalised modes as Rayleigh quotients."""
    return np.sqrt(stiffness @ _extend(shape) ** 2 + ground @ shape**2)


def _separate(shape: Array, stiffness: Array, mass: Array, ground: Array) -> Array:
    """Return low modes after removing the other modes that the diagonalisation mixes into them.

    The diagonalisation mixes modes by about ``eps omega_max^2 / gap``. Sums of extensions over
    contacts determine the fraction of mode j in mode i with an error of only
    ``eps omega_i omega_j / gap``. The correction is of first order, and is repeated while it is
    large; T. Ogita and K. Aishima, Jpn. J. Ind. Appl. Math. 35, 1007 (2018).
    """
    for _ in range(3):
        extension = np.sqrt(stiffness)[:, None] * _extend(shape)
        elastic = extension.T @ extension
        if ground.any():
            elastic += shape.T @ (ground[:, None] * shape)
        overlap = shape.T @ (mass[:, None] * shape)
        squares = np.diag(elastic) / np.diag(overlap)
        gap = squares - squares[:, None]
        # Modes of equal frequency are only orthonormalised.
        mixed = (np.eye(squares.size) - overlap) / 2
        apart = np.abs(gap) > DEGENERATE * np.maximum(squares, squares[:, None])
        np.divide(elastic - overlap * squares, gap, out=mixed, where=apart)
        shape = shape + shape @ mixed
        if np.abs(mixed).max() < DEGENERATE:
            break
    return shape


def quasi_normal(k: ArrayLike, grains: int, delta: float = 1.5) -> Array:
    """Return the quasi-normal frequencies of Eq. (30) in a column of N grains, in units of 1/tau.

    They are ``(eta/2) j H^(-eta/2)`` with the k-th zero j of J_(-nu) and the depth H = N - 1/2 of
    the held grain N. They solve the Sturm-Liouville problem without flux through the free top. The
    relative error is of order (k/N)^2.

    Parameters
    ----------
    k : array_like
        Number of the mode, from 1.
    grains : int
        Number of grains N, of which the last one is held.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If k or grains are out of range or delta < 1.

    Examples
    --------
    >>> f"{quasi_normal(1, 1001):.6f}"
    '0.004612'
    """
    _, eta, nu = exponents(delta)
    return eta / 2 * _zero(-nu, real(whole("k", k, 1))) * _bottom(grains) ** (-eta / 2)


def band_edge(grains: int, delta: float = 1.5) -> float:
    """Return the highest frequency of a column of N grains, in units of 1/tau, by Airy's equation.

    It is ``omega^2 = H^xi [4 - 2.338107 (4 xi / H)^(2/3)]`` with H = N - 1/2. The error is 2e-4 for
    N = 100, and 1e-5 for N = 1000. The mode is localised in the lowest (H / 4 xi)^(1/3) grains.

    Parameters
    ----------
    grains : int
        Number of grains N.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If grains < 2 or delta <= 1, because a uniform chain has no localised mode.

    Examples
    --------
    >>> f"{band_edge(101):.3f}"
    '4.241'
    """
    xi = exponents(delta).xi
    require(("delta", delta > 1, "must be above 1"))
    depth = _bottom(grains)
    first = float(ai_zeros(1)[0][0])
    return float(np.sqrt(depth**xi * (4 + first * (4 * xi / depth) ** (2 / 3))))


def count(frequency: ArrayLike, grains: int, delta: float = 1.5) -> Array:
    """Return the number of modes of a column of N grains below a frequency, by WKB.

    The number is the integral of (2/pi) arcsin(min(1, omega h^(-xi/2) / 2)) over
    0 < h < H = N - 1/2. At the k-th eigenfrequency it is k - 1/4 - nu/2 for omega < 2, and k - 1/4
    for larger omega, where the mode has a turning point.

    Parameters
    ----------
    frequency : array_like
        Frequencies omega, in units of 1/tau.
    grains : int
        Number of grains N.
    delta : float
        Exponent of the contact force.

    Returns
    -------
    array

    Raises
    ------
    InputError
        If a frequency is negative, grains < 2 or delta < 1.

    Examples
    --------
    >>> f"{count(2.0, 101, 1.0):.1f}"
    '100.5'
    """
    xi = exponents(delta).xi
    depth = _bottom(grains)
    frequency = real(frequency, "frequency")
    require(("frequency", frequency >= 0, "must be 0 or more"))
    ratio = np.minimum(1.0, frequency / 2 * depth ** (-xi / 2))
    # The second term is the integral of (ratio cosh s)^steep over 0 < s < arccosh(1/ratio). It
    # starts from the upper end, from which the integrand decays at least as exp(-steep slope / 2).
    steep = 2 / xi - 1 if xi else np.inf
    slope = np.sqrt(1 - ratio**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.fmin(np.arccosh(1 / ratio), 80 / (steep * slope))
    x, weight = roots_legendre(64)
    below = reach[..., None] * (1 + x) / 2
    base = np.cosh(below) - slope[..., None] * np.sinh(below)
    return 2 / np.pi * depth * (np.arcsin(ratio) + ratio * reach / 2 * (base**steep @ weight))


def _bottom(grains: int) -> float:
    """Return the depth H of the fixed grain."""
    return float(whole("grains", grains, 2)) - 0.5


def _zero(order: float, k: Array) -> Array:
    """Return the k-th positive zero of J_order, -1/2 <= order <= 0, by Newton's method."""
    # Two terms of McMahon's expansion.
    z = (k + order / 2 - 0.25) * np.pi
    z = z - (4 * order**2 - 1) / (8 * z)
    for _ in range(6):
        z = z - jv(order, z) / jvp(order, z)
    return z
