"""Largest values and fronts of one body whose displacement, velocity,
acceleration and jerk are given.
"""

import math
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from lmpchain.trajectory.between import hermite
from lmpchain.trajectory.between.derivatives import (
    BodySeries,
    ChainForces,
    ImposedSamples,
    SampledBlock,
)
from lmpchain.trajectory.between.fronts import Rules, front_of
from lmpchain.trajectory.between.maxima import Log, Window, events_of, follow, lowest


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


def path_of(
    values: np.ndarray, kind: int, h: float, ceiling: np.ndarray | None = None
) -> hermite.BodyPath:
    """Return a body between its samples, from u, v, a, j and the error of a at each (5, T)."""
    u, v, a, j, off = np.ascontiguousarray(values, float)
    doubt = np.append(np.maximum(off[:-1], off[1:]), 0.0)
    limits = np.zeros(0) if ceiling is None else np.ascontiguousarray(ceiling, float)
    bounds = np.empty((2, u.size - 1))
    path: hermite.BodyPath = hermite.path(BodySeries(u, v, a, j, doubt), kind, h, limits, bounds)
    return path


def peak_of(
    values: np.ndarray,
    kind: int,
    h: float,
    known: float = 0.0,
    ceiling: np.ndarray | None = None,
) -> tuple[float, float]:
    """Return the largest value and its error."""
    path = path_of(values, kind, h, ceiling)
    largest = lowest(1, -np.inf)
    none = events_of(np.zeros(0))
    follow(path, Window(0, 0, path.error.size), largest, none, 0, Log(none, 0))
    value, error = largest.estimate(known)
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
    """Return time, height and width of the front and their errors, (6,)."""
    path = path_of(values, kind, h, ceiling)
    rules = Rules(fraction, known, certain, frequency, h, h * path.error.size)
    front: np.ndarray = front_of(path, width, rules)
    return front


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
    """Return samples (T, C) of a chain from constants, forces and
    overlaps of its contacts (3, N+1).

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
