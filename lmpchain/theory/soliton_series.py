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
from scipy.optimize import brentq
from scipy.special import roots_legendre

from ..chain.contact_law import power_law
from ..chain.contacts import Contacts
from ..errors import InputError
from ..util.arrays import Array
from .domain import real


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
