"""Series for the logarithm of the overlap in a solitary wave, by Newton's method.

The equation and the units are those of `lmpchain.theory.soliton`. The series consists of even
Chebyshev polynomials, of x in the sonic vacuum and of a stretched x under a load. Beyond its reach
the logarithm is extrapolated as a cosh in the sonic vacuum, and linearly under a load.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import roots_legendre

from ..chain.contact_law import Contacts, power_law
from ..errors import InputError
from ..util.arrays import Array
from .domain import finite, real, require


@dataclass(frozen=True)
class Resolution:
    """Length and accuracy of a series.

    Attributes
    ----------
    drop : float
        Decrease of log(overlap) from the middle to the end of the series.
    residual : float
        Largest residual of the equation that is accepted, relative to the largest overlap.
    tails : float
        Weight of residuals that are relative to the local overlap.
    stretch : float
        Parameter b of the stretched x = reach sinh(b z) / sinh(b).
    fewest_terms : int
        Number of coefficients of the first series that is tried.
    most_terms : int
        Largest number of coefficients.
    """

    drop: float = 45.0
    residual: float = 1e-13
    tails: float = 1e-5
    stretch: float = 3.0
    fewest_terms: int = 48
    most_terms: int = 370


RESOLUTION = Resolution()


class SolitonSeries(NamedTuple):
    """Speed, reach, coefficients of T_0, T_2, T_4 ..., and largest residual between the points."""

    speed: float
    reach: float
    coefficients: Array
    residual: float


def long_wave_speed(overlap: Array, delta: float) -> Array:
    """Return the Mach number c at which ``c^2 r^2`` is twice the contact energy."""
    return np.sqrt(2 * law(delta, True).energy(overlap)) / overlap


def law(delta: float, loaded: bool) -> Contacts:
    """Return the contact law in units of this module: stiffness 1 at rest, or constant 1."""
    constant = 1 / delta if loaded else 1.0
    force = 1 / delta if loaded else 0.0
    return Contacts.at_rest(np.array(constant), np.array(force), power_law(delta))


def rows(x: Array, terms: int, reach: float, delta: float, loaded: bool) -> Array:
    """Return the matrix from a series to log(overlap / height) at x, also outside the reach."""
    x = np.abs(x) / reach
    beyond = np.maximum(x - 1, 0.0)
    z = np.minimum(x, 1.0)
    if loaded:
        # The logarithm is linear far from the middle, and has its structure in the middle.
        b = RESOLUTION.stretch
        z = np.arcsinh(z * np.sinh(b)) / b
        beyond *= np.tanh(b) / b
    else:
        # The logarithm decreases as cosh(rate x); beyond e^20 times its value at the reach, r is 0.
        rate = reach * np.log(delta)
        half = np.minimum(rate * beyond, 20.0) / 2
        beyond = 2 * np.sinh(half) * np.sinh(rate + half) / (rate * np.sinh(rate))
    order = 2 * np.arange(terms)
    inside = np.cos(np.arccos(np.minimum(z, 1.0))[..., None] * order)
    # The derivative of T_k at 1 is k^2.
    return inside + beyond[..., None] * order**2


@cache
def solve_series(delta: float, speed: float | None, velocity: float | None = None) -> SolitonSeries:
    """Return the wave of a given speed under a load, or of speed 1 in the sonic vacuum.

    If the largest velocity of a grain is given, the speed is only a first approximation.
    """
    guess, reach = _guess(delta, speed)
    terms = RESOLUTION.fewest_terms
    while terms <= RESOLUTION.most_terms:
        with np.errstate(over="ignore", invalid="ignore"):
            series = _newton(delta, speed, velocity, terms, guess, reach)
        if series and series.residual < RESOLUTION.residual:
            return series
        # A longer series starts from the shorter one.
        if series:
            guess = partial(_extend, series, delta, speed is not None)
        terms = 3 * terms // 2
    key = "speed" if speed else "delta"
    raise InputError.at(key, "its wave is too wide or too sharp: no series resolves it")


def _extend(series: SolitonSeries, delta: float, loaded: bool, x: Array) -> Array:
    """Return log(overlap) from a series that is too short."""
    return rows(x, series.coefficients.size, series.reach, delta, loaded) @ series.coefficients


def _newton(
    delta: float,
    speed: float | None,
    velocity: float | None,
    terms: int,
    guess: Callable[[Array], Array],
    reach: float,
) -> SolitonSeries | None:
    """Return a series with a number of terms, and the speed; None if it does not converge."""
    loaded = speed is not None
    c = speed or 1.0
    contact = law(delta, loaded)
    # Gauss-Legendre nodes on either half of the kernel.
    y, halves = roots_legendre(40 + round(8 * delta))
    s = np.concatenate((y - 1, y + 1)) / 2
    weight = np.tile(halves, 2) / 2 * (1 - np.abs(s))

    def basis(x: Array) -> Array:
        return rows(x, terms, reach, delta, loaded)

    # The equation is collocated at Chebyshev nodes.
    z = np.cos(np.pi * (np.arange(terms) + 0.5) / (2 * terms))
    b = RESOLUTION.stretch
    x = reach * (np.sinh(b * z) / np.sinh(b) if loaded else z)
    at = basis(x)
    beside = basis(x[:, None] + s)
    within = basis(s / 2)
    series = np.linalg.solve(at, guess(x))
    matrix = np.zeros((terms + 1, terms + 1))
    matrix[:-1, -1] = 2.0
    for step in range(60):
        overlap = np.exp(beside @ series)
        force = contact.force_change(overlap) @ weight
        residual = at @ series - np.log(force) + 2 * np.log(c)
        if not loaded and step < 12:
            # The shape converges by iteration; only the scale is unstable.
            series = np.linalg.solve(at, np.log(force))
            series[0] += residual[-1] * delta / (delta - 1)
            continue
        stiffness = contact.stiffness_at(contact.overlap + overlap)
        slope = stiffness * overlap * (weight / force[:, None])
        matrix[:-1, :-1] = at - np.matmul(slope[:, None], beside)[:, 0]
        matrix[-1] = np.append(np.zeros(terms), 1.0)
        closing = 0.0
        if velocity is not None:
            # c times the velocity is the mean force over one grain.
            middle = np.exp(within @ series)
            share = np.tile(halves, 2) / 4
            mean = contact.force_change(middle) @ share
            stiffness = contact.stiffness_at(contact.overlap + middle)
            matrix[-1, :-1] = -(stiffness * middle * share / mean) @ within
            closing = float(np.log(c * velocity / mean))
        change = np.linalg.solve(matrix, np.append(residual, closing))
        size = np.abs(np.append(at @ change[:-1], change[-1])).max()
        if not np.isfinite(size):
            return None
        # A step changes overlaps by a factor of e^3 at most, because the equation is nonlinear.
        change *= min(1.0, 3 / size)
        series = series - change[:-1]
        c = float(c * np.exp(-change[-1]))
        # Convergence is quadratic: the next change is the square of this one.
        if size < 1e-6:
            break
    else:
        return None
    # Residuals between the nodes, where the equation is not enforced.
    between = np.linspace(0, reach, 4 * terms + 1)
    overlap = np.exp(basis(between) @ series)
    force = contact.force_change(np.exp(basis(between[:, None] + s) @ series)) @ weight
    miss = np.abs(force / c**2 - overlap)
    largest = max(miss.max() / overlap.max(), RESOLUTION.tails * (miss / overlap).max())
    return SolitonSeries(c, reach, real(series, "series"), float(largest))


def _guess(delta: float, speed: float | None) -> tuple[Callable[[Array], Array], float]:
    """Return an approximation of log(overlap), and the reach over which it falls by e^45."""
    # Second derivative of Nesterenko's log(overlap) in the middle.
    bend = 2 * (delta - 1) * 6 / (delta * (delta + 1))
    drop = RESOLUTION.drop
    if speed is None:
        rate = np.log(delta)
        reach = float(np.arccosh(1 + drop * rate**2 / bend) / rate)
        return lambda x: -bend / rate**2 * (np.cosh(rate * x) - 1), reach
    # The long-wave soliton has log(overlap) in closed form in the strong and in the weak limit.
    strong = np.log(delta * (delta + 1) / 2 * speed**2) / (delta - 1)
    weak = np.log(6 * (speed - 1) / (delta - 1)) - 1
    low = min(weak, strong) - 3
    high = max(weak, strong) + 3
    highest = brentq(lambda y: float(long_wave_speed(np.exp(y), delta)) - speed, low, high)
    # The tail decays as exp(-kappa x) with sinh(kappa/2) = c kappa/2.
    furthest = 2 * np.log(speed) + 10
    kappa = 2 * brentq(lambda z: float(np.sinh(z) / z) - speed, 1e-9, furthest, xtol=1e-15)
    # A power of sech has this tail and the curvature of Nesterenko's wave.
    power = max(2.0, kappa**2 / bend)

    def logarithm(x: Array) -> Array:
        fall = np.logaddexp(kappa * x / power, -kappa * x / power) - np.log(2)
        return np.asarray(highest - power * fall)

    return logarithm, drop / kappa + 1


def _steep(delta: float) -> tuple[str, bool, str]:
    """Return the rule that the exponent is above 1, where waves depend on their amplitude."""
    return "delta", 1 < delta < np.inf, f"must be above 1 (got {delta!r})"


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
        If a velocity is negative or not finite, or if delta is not above 1.

    Examples
    --------
    >>> from lmpchain.theory.soliton import solve
    >>> f"{nesterenko_speed(1.0) / solve(velocity=1.0).speed - 1:.4f}"
    '0.0079'
    """
    v = finite(velocity, "velocity")
    require(("velocity", v >= 0, "must be 0 or more"), _steep(delta))
    return (2 / (delta + 1)) ** (1 / (delta + 1)) * v ** ((delta - 1) / (delta + 1))


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
        If x is not finite, if the speed is not above 0, or if delta is not above 1.
    """
    require(("speed", 0 < speed < np.inf, f"must be above 0 (got {speed!r})"), _steep(delta))
    q = (delta - 1) * np.sqrt(6 / (delta * (delta + 1)))
    angle = q * finite(x, "x")
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
    x = finite(x, "x")
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
        If a force is not finite and above 1, or if delta is not above 1.

    Examples
    --------
    >>> f"{coste_speed(2.12584727):.6f}"
    '1.049464'
    """
    f = finite(force, "force")
    require(("force", f > 1, "must be above 1, the value at rest"), _steep(delta))
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
        If x is not finite, if the speed is below 1, or if delta is not above 1.
    """
    require(("speed", 1 <= speed < np.inf, f"must be 1 or more (got {speed!r})"), _steep(delta))
    e = speed - 1
    return 6 * e / (delta - 1) / np.cosh(np.sqrt(6 * e) * finite(x, "x")) ** 2
