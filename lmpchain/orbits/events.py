"""Folds and bifurcations along a family of orbits, located by regula falsi, halving where it does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array
from .floquet import Complex
from .orbit import Orbit
from .shooting import Solution

EVENTS = ("fold", "period doubling", "Neimark-Sacker", "branch point")
SPLIT = 1e-6  # of two means: less is what round-off makes of a double one
TRIES = 24
NEAR = 1e-6  # of a step: where an event is located


class Place(NamedTuple):
    """A point of a family: its orbit, the unknowns (U,) and the direction (U,) of the family.

    `rate` is that of the parameter along it; where `turning` passes 0 a pair of multipliers passes 1 by itself.
    """

    orbit: Orbit
    unknown: Array
    direction: Array
    rate: float
    turning: float
    solution: Solution


def between(
    kind: str, here: Place, there: Place, at: Callable[[float], Place | None]
) -> Place | None:
    """Return where between two places something happens, nearer the second, or None.

    Parameters
    ----------
    at : function
        Of the part of the way, 0 to 1.
    """
    before, after = _count(kind, here), _count(kind, there)
    if before == after or (kind == "branch point" and here.turning * there.turning < 0):
        return None
    low, high, found = 0.0, 1.0, there
    more, pairs_meet = max(before, after), kind == "Neimark-Sacker"
    centre = _centre(here if before == more else there) if pairs_meet else 0.0
    f_low, f_high = (
        _distance(kind, here, centre, before == more),
        _distance(kind, there, centre, after == more),
    )
    side, width = 0, 1.0
    for number in range(TRIES):
        slow = (
            number % 3 == 2 and high - low > width / 4
        )  # as where another pair is nearer than the one that meets
        falsi = f_low + f_high > 0 and not slow
        part = (low * f_high + high * f_low) / (f_high + f_low) if falsi else (low + high) / 2
        width = width if number % 3 else high - low
        part = min(max(part, low + 0.02 * (high - low)), high - 0.02 * (high - low))
        middle = at(part)
        if middle is None:
            break
        count = _count(kind, middle)
        centre = _centre(middle) if pairs_meet and count == more else centre
        f = _distance(kind, middle, centre, count == more)
        if count == before:
            low, f_low = part, f
            f_high, side = (f_high / 2 if side < 0 else f_high), -1
        else:
            high, f_high, found = part, f, middle
            f_low, side = (f_low / 2 if side > 0 else f_low), 1
        if high - low < NEAR:
            break
    return found


def _count(kind: str, place: Place) -> int:
    """Return a number that changes where something of this kind happens."""
    if kind == "fold":
        return int(place.rate > 0)
    mean = place.orbit.means
    real = _real(mean)
    if kind == "Neimark-Sacker":
        return mean.size - real.size
    return int((real > 1).sum() if kind == "branch point" else (real < -1).sum())


def _centre(place: Place) -> float:
    """Return around which mean two pairs of multipliers have met: those that are least apart."""
    mean = place.orbit.means
    apart = mean[np.abs(mean.imag) > SPLIT]
    return float(apart.real[np.abs(apart.imag).argmin()]) if apart.size else 0.0


def _distance(kind: str, place: Place, centre: float, met: bool) -> float:
    """Return a number that goes through zero, but for its sign, where something of this kind happens.

    Of two pairs of multipliers that meet around a mean, it is the discriminant, before and after.
    """
    if kind == "fold":
        return abs(place.rate)
    mean = place.orbit.means
    real = np.sort(_real(mean))
    if kind == "Neimark-Sacker":
        if met:
            apart = mean.imag[np.abs(mean.imag) > SPLIT]
            return float((4 * apart**2).min()) if apart.size else 0.0
        nearest = np.abs(real[1:] + real[:-1] - 2 * centre).argmin() if real.size > 1 else 0
        return float((np.diff(real) ** 2)[nearest]) if real.size > 1 else 0.0
    return float(np.abs(real - (1 if kind == "branch point" else -1)).min()) if real.size else 0.0


def _real(mean: Complex) -> Array:
    return mean.real[np.abs(mean.imag) <= SPLIT]
