"""Series for the logarithm of the overlap in a solitary wave, by Newton's method.

The equation and the units are those of `lmpchain.theory.soliton`. The series is one in even Chebyshev polynomials, of x
in the sonic vacuum, of a stretched x under a load; beyond its reach the logarithm goes on as it falls, as a cosh or
straight.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import roots_legendre

from ..chain.contacts import Contacts
from ..errors import InputError
from ..util.arrays import Array
from .domain import real

DROP = 45.0  # of log r from the middle to where its series ends
RESOLVED = 1e-13  # residual of the equation over the largest overlap
IN_TAILS = 1e-5  # weight of residuals over the overlap in place
FURTHEST = 20.0  # logarithm of how often log(overlap) is larger than at the reach: beyond, the overlap is 0
CROWDED = 3.0  # b of the stretched x = reach sinh(b z) / sinh(b)
PICARD = 12  # iterations before those of Newton
FEWEST, MOST = 48, 370  # coefficients
POINTS = 40  # of Gauss and Legendre, for half of the kernel; 8 delta more


class Series(NamedTuple):
    """Speed, reach, coefficients of T_0, T_2, T_4 ..., and the largest residual between the points."""

    speed: float
    reach: float
    coefficients: Array
    residual: float


def long_wave_speed(overlap: Array, delta: float) -> Array:
    """Return the speed at which ``c^2 r^2`` is twice the energy of a contact, over that of sound."""
    return np.sqrt(2 * law(delta, True).energy(overlap)) / overlap


def law(delta: float, loaded: bool) -> Contacts:
    """Return the contact in the units of the module: stiffness 1 at rest, or constant 1."""
    return Contacts.at_rest(
        np.array(1 / delta if loaded else 1.0), np.array(1 / delta if loaded else 0.0), delta
    )


def rows(x: Array, terms: int, reach: float, delta: float, loaded: bool) -> Array:
    """Return the matrix from a series to log(overlap / height) at x, also beyond the reach."""
    x = np.abs(x) / reach
    beyond, rate = np.maximum(x - 1, 0.0), reach * np.log(delta)
    if loaded:  # linear far out, with its structure in the middle
        place = np.arcsinh(np.minimum(x, 1.0) * np.sinh(CROWDED)) / CROWDED
        beyond *= np.tanh(CROWDED) / CROWDED
    else:  # as cosh(rate x)
        place, half = np.minimum(x, 1.0), np.minimum(rate * beyond, FURTHEST) / 2
        beyond = 2 * np.sinh(half) * np.sinh(rate + half) / (rate * np.sinh(rate))
    order = 2 * np.arange(terms)
    inside = np.cos(np.arccos(np.minimum(place, 1.0))[..., None] * order)
    return inside + beyond[..., None] * order**2  # the slope of T_k at 1 is k^2


@cache
def solved(delta: float, speed: float | None, velocity: float | None = None) -> Series:
    """Return the wave of this speed under a load, or that of speed 1 in the sonic vacuum.

    With a velocity, that of the grains at their fastest, the speed is an approximation to begin with.
    """
    guess, reach = _guess(delta, speed)
    terms = FEWEST
    while terms <= MOST:
        with np.errstate(over="ignore", invalid="ignore"):
            found = _newton(delta, speed, velocity, terms, guess, reach)
        if found and found.residual < RESOLVED:
            return found
        if found:
            guess = partial(_continued, found, delta, speed is not None)
        terms = 3 * terms // 2
    raise InputError(
        [
            (
                "speed" if speed else "delta",
                "its wave is too wide or too sharp: no series resolves it",
            )
        ]
    )


def _continued(found: Series, delta: float, loaded: bool, x: Array) -> Array:
    """Return log(overlap) by a series that is too short."""
    return rows(x, found.coefficients.size, found.reach, delta, loaded) @ found.coefficients


def _newton(
    delta: float,
    speed: float | None,
    velocity: float | None,
    terms: int,
    guess: Callable[[Array], Array],
    reach: float,
) -> Series | None:
    """Solve for a series of so many terms and the logarithm of the speed; None if that does not converge."""
    loaded, c = speed is not None, speed or 1.0
    contact = law(delta, loaded)
    y, halves = roots_legendre(POINTS + round(8 * delta))
    s = np.concatenate((y - 1, y + 1)) / 2  # the halves of the kernel
    weight = np.tile(halves, 2) / 2 * (1 - np.abs(s))

    def around(x: Array) -> Array:
        return rows(x[:, None] + s, terms, reach, delta, loaded)

    x = np.cos(np.pi * (np.arange(terms) + 0.5) / (2 * terms))
    x = reach * (np.sinh(CROWDED * x) / np.sinh(CROWDED) if loaded else x)
    here, beside, within = (
        rows(x, terms, reach, delta, loaded),
        around(x),
        rows(s / 2, terms, reach, delta, loaded),
    )
    series = np.linalg.solve(here, guess(x))
    matrix = np.zeros((terms + 1, terms + 1))
    matrix[:-1, -1] = 2.0
    for step in range(60):
        overlap = np.exp(beside @ series)
        force = contact.force_change(overlap) @ weight
        off = here @ series - np.log(force) + 2 * np.log(c)
        if (
            not loaded and step < PICARD
        ):  # the shape by iteration, of which the scale alone is unstable
            series = np.linalg.solve(here, np.log(force))
            series[0] += off[-1] * delta / (delta - 1)
            continue
        slope = (
            contact.stiffness_at(contact.overlap + overlap) * overlap * (weight / force[:, None])
        )
        matrix[:-1, :-1] = here - np.matmul(slope[:, None], beside)[:, 0]
        matrix[-1], closing = np.append(np.zeros(terms), 1.0), 0.0
        if velocity is not None:  # c times it is the mean force over one grain
            middle = np.exp(within @ series)
            share = np.tile(halves, 2) / 4
            mean = contact.force_change(middle) @ share
            matrix[-1, :-1] = (
                -(contact.stiffness_at(contact.overlap + middle) * middle * share / mean) @ within
            )
            closing = float(np.log(c * velocity / mean))
        change = np.linalg.solve(matrix, np.append(off, closing))
        size = np.abs(np.append(here @ change[:-1], change[-1])).max()
        if not np.isfinite(size):
            return None
        change *= min(1.0, 3 / size)
        series, c = series - change[:-1], float(c * np.exp(-change[-1]))
        if size < 1e-6:  # the next change is its square
            break
    else:
        return None
    between = np.linspace(0, reach, 4 * terms + 1)
    overlap = np.exp(rows(between, terms, reach, delta, loaded) @ series)
    miss = np.abs(contact.force_change(np.exp(around(between) @ series)) @ weight / c**2 - overlap)
    return Series(
        c,
        reach,
        real(series),
        float(max(miss.max() / overlap.max(), IN_TAILS * (miss / overlap).max())),
    )


def _guess(delta: float, speed: float | None) -> tuple[Callable[[Array], Array], float]:
    """Return an approximation of log(overlap), and the reach over which it falls by e^DROP."""
    bend = 2 * (delta - 1) * 6 / (delta * (delta + 1))  # of Nesterenko's log(overlap) in the middle
    if speed is None:
        rate = np.log(delta)
        return lambda x: -bend / rate**2 * (np.cosh(rate * x) - 1), float(
            np.arccosh(1 + DROP * rate**2 / bend) / rate
        )
    strong = np.log(delta * (delta + 1) / 2 * speed**2) / (delta - 1)
    weak = np.log(6 * (speed - 1) / (delta - 1)) - 1
    highest = brentq(
        lambda y: float(long_wave_speed(np.exp(y), delta)) - speed,
        min(weak, strong) - 3,
        max(weak, strong) + 3,
    )
    kappa = 2 * brentq(
        lambda z: float(np.sinh(z) / z) - speed, 1e-9, 2 * np.log(speed) + 10, xtol=1e-15
    )
    power = max(2.0, kappa**2 / bend)
    return (
        lambda x: (
            highest - power * (np.logaddexp(kappa * x / power, -kappa * x / power) - np.log(2))
        ),
        DROP / kappa + 1,
    )
