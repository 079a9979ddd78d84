"""Steps of an orbit: fixed fractions of its period, short where contacts open and close.

The force has a singular derivative where a contact opens, so that steps of one size would lose their order there.
Steps fixed in advance keep the map symplectic, whatever their lengths.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..util.arrays import Array
from .flow import Flow, Passage

REACH = 0.3  # step times the highest frequency of the chain at its stiffest
GRADING = 0.35  # step over the time to the nearest opening
CROSSING = 1e-4  # the shortest step times that frequency, around an opening: its error is far below that of the others
MOST = 20_000  # steps
FEWEST = 24


def highest_frequency(flow: Flow, displacement: Array) -> float:
    """Return a bound on the frequencies of the chain linearised about any of these states (K, N), rad/s."""
    contacts, masses = flow.chain.contacts, flow.chain.masses[flow.free]
    overlap = np.maximum(contacts.overlap + contacts.closer(displacement), 0.0).max(0)
    stiffness = contacts.stiffness_at(overlap)
    return float(np.sqrt(2 * ((stiffness[:-1] + stiffness[1:])[flow.free] / masses).max()))


def openings(flow: Flow, passage: Passage, period: float, mesh: Array) -> Array:
    """Return when contacts open or close, as ascending fractions of the period."""
    contacts = flow.chain.contacts
    overlap = contacts.overlap + contacts.closer(passage.displacement)
    crossing = (
        contacts.exists & (overlap.min(0) < 0) & (overlap.max(0) > 1e-9 * np.abs(overlap).max())
    )
    if not crossing.any():
        return np.zeros(0)
    time = np.concatenate(([0.0], np.cumsum(mesh)))
    rate = contacts.closer(passage.velocity) * period
    roots = CubicHermiteSpline(time, overlap[:, crossing], rate[:, crossing]).roots(
        extrapolate=False
    )
    times = np.concatenate([np.asarray(each) for each in roots])
    return np.sort(times[np.isfinite(times)])


def uniform(flow: Flow, period: float, displacement: Array, reach: float = REACH) -> Array:
    """Return an even number of equal fractions that resolve a motion through these states (K, N)."""
    count = highest_frequency(flow, displacement) * period / reach
    half = max(FEWEST, int(np.ceil(min(count, MOST)))) // 2 + 1
    return np.full(2 * half, 0.5 / half)


def graded(
    flow: Flow, period: float, displacement: Array, times: Array, reach: float = REACH
) -> Array:
    """Return fractions that are symmetric in time and shrink towards openings, `times` (E,) as fractions."""
    even = uniform(flow, period, displacement, reach)
    if not times.size:
        return even
    least = CROSSING / (highest_frequency(flow, displacement) * period)
    near = np.unique(np.concatenate((times, 1 - times, times - 1, times + 1, -times)))
    near = near[np.append(True, np.diff(near) > least)]
    away = np.geomspace(least / 4, 4 * even[0] / GRADING, 600)
    places = np.concatenate(
        (
            np.linspace(0.0, 0.5, 8 * even.size),
            near,
            *(near + away[:, None]),
            *(near - away[:, None]),
        )
    )
    places = np.unique(np.concatenate(([0.0], places[(places > 0) & (places < 0.5)], [0.5])))
    after = np.searchsorted(near, places).clip(1, near.size - 1)
    distance = np.minimum(np.abs(near[after] - places), np.abs(near[after - 1] - places))
    density = 1 / np.clip(GRADING * reach / REACH * distance, least, even[0])
    count = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(places))))
    half = int(np.ceil(min(count[-1], MOST / 2)))
    steps = np.diff(np.interp(np.linspace(0.0, count[-1], half + 1), count, places))
    return np.concatenate((steps, steps[::-1]))
