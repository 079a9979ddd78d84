"""Time mesh of an orbit: fixed fractions of its period, short where contacts open or close.

The force has a singular derivative where a contact opens, so that steps of equal length would lose
their order of accuracy there. Steps that are fixed in advance keep the map symplectic, whatever
their lengths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..util.arrays import Array
from .flow import Flow, Passage


@dataclass(frozen=True)
class Mesh:
    """Lengths of mesh steps.

    Attributes
    ----------
    reach : float
        Step times the highest frequency of the chain in its stiffest state, rad.
    grading : float
        Step relative to the time to the nearest opening.
    crossing : float
        Shortest step, at an opening, times the highest frequency, rad; the error of such a step is
        negligible.
    steps : int
        Largest number of steps in a period.
    """

    reach: float = 0.3
    grading: float = 0.35
    crossing: float = 1e-5
    steps: int = 20_000


MESH = Mesh()


def highest_frequency(flow: Flow, displacement: Array) -> float:
    """Return a bound on the frequencies of the chain linearised about states (K, N), rad/s."""
    contacts = flow.chain.contacts
    overlap = np.maximum(contacts.overlap + contacts.closer(displacement), 0.0).max(0)
    stiffness = contacts.stiffness_at(overlap)
    pull = (stiffness[:-1] + stiffness[1:])[flow.free]
    return float(np.sqrt(2 * (pull / flow.chain.masses[flow.free]).max()))


def openings(flow: Flow, passage: Passage, period: float, mesh: Array) -> Array:
    """Return the times at which contacts open or close, as ascending fractions of the period."""
    contacts = flow.chain.contacts
    overlap = contacts.overlap + contacts.closer(passage.displacement, passage.wall[0])
    # A contact pressed only by rounding errors does not count as closed.
    noise = 1e-9 * np.abs(overlap).max()
    crossing = contacts.exists & (overlap.min(0) < 0) & (overlap.max(0) > noise)
    if not crossing.any():
        return np.zeros(0)
    time = np.concatenate(([0.0], np.cumsum(mesh)))
    rate = contacts.closer(passage.velocity, passage.wall[1]) * period
    spline = CubicHermiteSpline(time, overlap[:, crossing], rate[:, crossing])
    times = np.concatenate([np.asarray(roots) for roots in spline.roots(extrapolate=False)])
    return np.sort(times[np.isfinite(times)])


def uniform(flow: Flow, period: float, displacement: Array, reach: float = MESH.reach) -> Array:
    """Return an even number of equal fractions that resolve the motion through states (K, N)."""
    count = highest_frequency(flow, displacement) * period / reach
    half = max(24, int(np.ceil(min(count, MESH.steps)))) // 2 + 1
    return np.full(2 * half, 0.5 / half)


def graded(
    flow: Flow, period: float, displacement: Array, times: Array, reach: float = MESH.reach
) -> Array:
    """Return fractions that decrease towards openings at `times` (E,).

    The fractions are symmetric in time unless there is a drive, because driven motion is not.
    """
    even = uniform(flow, period, displacement, reach)
    if not times.size:
        return even
    shortest = MESH.crossing / (highest_frequency(flow, displacement) * period)
    mirrored = flow.drive is None
    mirrors = (1 - times, -times) if mirrored else ()
    near = np.unique(np.concatenate((times, times - 1, times + 1, *mirrors)))
    # Openings closer together than the shortest step are merged.
    near = near[np.append(True, np.diff(near) > shortest)]
    # The density of steps is evaluated at close nodes on both sides of every opening.
    away = np.geomspace(shortest / 4, 4 * even[0] / MESH.grading, 600)
    beside = (*(near + away[:, None]), *(near - away[:, None]))
    end = 0.5 if mirrored else 1.0
    nodes = np.concatenate((np.linspace(0.0, end, 8 * even.size), near, *beside))
    nodes = np.unique(np.concatenate(([0.0], nodes[(nodes > 0) & (nodes < end)], [end])))
    after = np.searchsorted(near, nodes).clip(1, near.size - 1)
    distance = np.minimum(np.abs(near[after] - nodes), np.abs(near[after - 1] - nodes))
    density = 1 / np.clip(MESH.grading * reach / MESH.reach * distance, shortest, even[0])
    count = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(nodes))))
    number = int(np.ceil(min(count[-1], MESH.steps * end)))
    steps = np.diff(np.interp(np.linspace(0.0, count[-1], number + 1), count, nodes))
    return np.concatenate((steps, steps[::-1])) if mirrored else steps
