"""Largest values and fronts of one body, given its motion and derivatives."""

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.polynomial import Polynomial
from scipy.optimize import brentq

from lmpchain.trajectory.between import hermite
from lmpchain.trajectory.between.derivatives import (
    STILL,
    ChainForces,
    ImposedSamples,
    SampledBlock,
)
from lmpchain.trajectory.between.fronts import Rules, fronts
from lmpchain.trajectory.between.maxima import (
    Window,
    estimate,
    events_of,
    levels_of,
    reduce,
    table_of,
)


def direct(function: Callable) -> Callable:
    """Return a Python function for a function that only compiled functions can call."""

    @numba.njit
    def call(*arguments: Any) -> Any:
        return function(*arguments)

    called: Callable = call
    return called


bound = direct(hermite.bound)
fill_polynomial = direct(hermite.fill_polynomial)
value = direct(hermite.value)
find_roots = direct(hermite.roots)


def polynomial(path: np.ndarray, kind: int, h: float, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients of the polynomial after sample i, and of its derivative."""
    work = hermite.scratch()
    count = fill_polynomial(path, kind, h, i, work)
    return work[hermite.C, :count], work[hermite.D, : count - 1]


def roots(c: np.ndarray) -> np.ndarray:
    """Return the sign changes of a polynomial, given its Bernstein coefficients."""
    places = np.zeros(8)
    return places[: find_roots(c, c.size, places, hermite.scratch())]


def power(c: np.ndarray) -> Polynomial:
    """Return a polynomial in powers of s from its Bernstein coefficients."""
    s = Polynomial([0, 1])
    degree = c.size - 1
    parts = (
        math.comb(degree, k) * c[k] * s**k * (1 - s) ** (degree - k) for k in range(degree + 1)
    )
    return sum(parts, start=Polynomial([0.0]))


def bernstein(curve: Polynomial, degree: int) -> np.ndarray:
    """Return the Bernstein coefficients of a polynomial."""
    powers = np.append(curve.coef, np.zeros(degree + 1 - curve.coef.size))
    return np.array(
        [
            sum(math.comb(k, q) / math.comb(degree, q) * powers[q] for q in range(k + 1))
            for k in range(degree + 1)
        ]
    )


def path_of(values: np.ndarray, kind: int, h: float) -> np.ndarray:
    """Return the path of a body, given u, v, a, j and the error of a at each sample (5, T)."""
    path = np.zeros((8, values.shape[1]))
    path[:4] = values[:4]
    path[hermite.DOUBT, :-1] = np.maximum(values[4, :-1], values[4, 1:])
    bound(path, kind, h)
    return path


def bodies_of(values: np.ndarray, h: float) -> tuple[SampledBlock, np.ndarray, np.ndarray]:
    """Return samples, numbers and derivatives of grains, given u, v, a, j and the error of a."""
    count = len(values)
    u, v = values[:, :2].transpose(1, 2, 0)
    contacts = np.array([[0.0], [0.0], [1.0]]) * np.ones(count + 1)
    columns = [STILL, *range(count), STILL]
    block = block_of(u, v, columns, contacts, np.ones(count), 1.5, False, h)
    paths = np.array([path_of(each, hermite.VELOCITY, h) for each in values])
    return block, np.arange(1, count + 1), np.ascontiguousarray(paths[:, 2:5])


def followed(
    values: np.ndarray, kind: int, h: float, ceiling: np.ndarray | None, level: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the largest sizes, the latest maxima and the events of one body, or of G bodies.

    The values are (5, T) or (G, 5, T), and the level is a number or (G,).
    """
    block, grains, derived = bodies_of(values.reshape(-1, *values.shape[-2:]), h)
    limits = np.zeros((1, 0)) if ceiling is None else np.array(ceiling, float)[None]
    raised = kind == hermite.RAISED
    largest = np.full((3, grains.size), -np.inf if raised else 0.0)
    sizes = [np.zeros((3, 0))] * 3
    sizes[kind] = largest
    latest = events_of(np.zeros(0)) if raised else levels_of(np.atleast_1d(level))
    window = Window(0, 0, values.shape[-1] - 1)
    log = events_of(np.zeros(0))
    table = table_of(grains, [kind], [])
    events = reduce(block, table, derived, limits, window, sizes, kind, latest, log)
    return largest, latest, events


def peak_of(
    values: np.ndarray,
    kind: int,
    h: float,
    known: float = 0.0,
    ceiling: np.ndarray | None = None,
) -> tuple[float, float]:
    """Return the largest value and its error."""
    value, error = estimate(followed(values, kind, h, ceiling, 0.0)[0], known)
    return float(value[0]), float(error[0])


def front_among(
    values: np.ndarray,
    kind: int,
    h: float,
    fraction: float,
    known: float,
    certain: float,
    frequency: float,
    ceiling: np.ndarray | None = None,
    width: bool = True,
) -> np.ndarray:
    """Return the time, height and width of the front and their errors, (6,)."""
    more = known, certain, frequency, ceiling, width
    front: np.ndarray = fronts_among(values[None], kind, h, fraction, *more)[0]
    return front


def fronts_among(
    values: np.ndarray,
    kind: int,
    h: float,
    fraction: float,
    known: float = 0.0,
    certain: float = 0.0,
    frequency: float = 1.0,
    ceiling: np.ndarray | None = None,
    width: bool = True,
) -> np.ndarray:
    """Return the time, height and width of the fronts of G bodies and their errors, (G, 6)."""
    sampled = np.abs(values[:, kind])
    levels = fraction / 2 * np.maximum(sampled.max(1) - known, 0.0)
    largest, latest, events = followed(values, kind, h, ceiling, levels)
    duration = h * (values.shape[2] - 1)
    rules = Rules(fraction, known, certain, frequency, h, duration, kind, width)
    maxima = (events, latest, largest, sampled[:, 0].copy(), rules)
    found: np.ndarray = fronts(*bodies_of(values, h), *maxima)
    return found


def block_of(
    u: np.ndarray,
    v: np.ndarray,
    columns: Any,
    contacts: np.ndarray,
    inverse_mass: np.ndarray,
    exponent: float,
    linear: bool,
    h: float,
    known: Any = True,
    imposed: ImposedSamples | None = None,
) -> SampledBlock:
    """Return samples (T, C) of a chain, given constants, forces and overlaps of contacts (3, N+1).

    `columns` are those of all bodies, walls included, or marks.
    """
    constant, force, overlap = contacts
    pressed = force > 0
    rows = np.array(
        [1 / np.where(pressed, overlap, 1), np.where(pressed, force, constant), pressed]
    )
    if linear and exponent > 1:
        rows[1, ~pressed] = 0.0
    samples = u.shape[0]
    bodies = len(columns)
    nothing = ImposedSamples(
        np.zeros((4, samples)), np.zeros((2, samples)), np.zeros(samples), 0, False
    )
    law = ChainForces(rows, inverse_mass, exponent, linear)
    fields = (np.ascontiguousarray(field.T) for field in (u, v))
    obeys = np.broadcast_to(np.asarray(known, bool), bodies).copy()
    return SampledBlock(*fields, np.array(columns), obeys, h, law, imposed or nothing)


def two(first: float, second: float, ratio: float) -> tuple[Polynomial, float]:
    """Return a curve from 0 with maxima of `ratio` and 1, and the time of the minimum between."""

    def curve(dip: float) -> Polynomial:
        shape = (Polynomial.fromroots([first, dip, second]) * Polynomial([-1.0, -1.0])).integ()
        return shape / shape(second)

    dip = brentq(
        lambda place: curve(place)(first) - ratio, first + 0.01, first + 0.6 * (second - first)
    )
    return curve(dip), dip
