"""The largest force of a viscous contact between samples.

It is not where the contact is closest. Approach and closing rate at four samples make a polynomial
of degree 7, of which the force follows with its kinks; one of degree 5, through three of them,
shows its error.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ...chain.contacts import Contacts
from ...chain.damping import viscous_force
from ...util.arrays import Array
from .maxima import Window

POINTS = 33  # of an interval, at which forces are compared
# of the largest at samples: what is smaller at both ends of an interval stays so
HIGH = 0.8


class ViscousContact(NamedTuple):
    """A contact, as arrays (1,), and its viscosity, s."""

    law: Contacts
    viscosity: float

    def force(self, closer: Array, closing: Array) -> Array:
        """Return forces, N, for approaches beyond that at rest, m, and their rates, m/s."""
        overlap = self.law.overlap + closer
        viscous = viscous_force(self.law, np.array([self.viscosity]), overlap, closing)
        return self.law.force_at(overlap) + viscous


@cache
def _hermite(nodes: tuple[int, ...]) -> Array:
    """Return the polynomial through values and slopes at nodes, and its slope, (2, POINTS, 2Q).

    At points from 0 to 1, as sums over the values at the Q nodes and then the slopes.
    """
    powers = np.arange(2 * len(nodes))

    def rows(at: Array) -> Array:
        value = at[:, None] ** powers
        slope = powers * at[:, None] ** np.maximum(powers - 1, 0)
        return np.array([value, slope])

    given = np.concatenate(rows(np.array(nodes, float)))
    return rows(np.linspace(0.0, 1.0, POINTS)) @ np.linalg.inv(given)


def _between(motion: Array, h: float, first: Array, size: int, offset: int) -> Array:
    """Return approach and rate at the points of intervals, (2, I, POINTS).

    From `size` samples each, the first of which have these numbers, and lie `offset` before the
    intervals; `motion` is approach and rate at the samples, (2, R).
    """
    table = _hermite(tuple(range(-offset, size - offset)))
    near = motion[:, first[:, None] + np.arange(size)]
    # slopes in units of the interval
    data = np.concatenate((near[0], h * near[1]), axis=1)
    # term by term: the bits of a product of matrices depend on how many intervals there are
    terms = (data[:, [k]] * table[:, None, :, k] for k in range(2 * size))
    return sum(terms, np.zeros((2, 1, 1))) / np.array([1.0, h])[:, None, None]


def largest_force(contact: ViscousContact, motion: Array, h: float, window: Window) -> Array:
    """Return the largest force in some intervals: value, N, its error, approach and rate, (4,).

    Parameters
    ----------
    contact : ViscousContact
    motion : (2, R) array
        Approach beyond that at rest, m, and rate, m/s, at samples.
    h : float
        Time between two of them, s.
    window : Window
        The intervals.
    """
    sampled = contact.force(*motion)
    numbers = np.arange(window.begin, window.end)
    higher = np.maximum(sampled[numbers], sampled[numbers + 1])
    numbers = numbers[higher >= HIGH * higher.max()]
    best = np.full(4, -np.inf)
    count = motion.shape[1]
    # at the ends of a run intervals lie at the ends of their samples
    begins = np.clip(numbers - 1, 0, max(count - 4, 0))
    for offset in np.unique(numbers - begins).tolist():
        of_offset = numbers - begins == offset
        first = begins[of_offset]
        size = min(4, count)
        fine = _between(motion, h, first, size, offset)
        # three samples around the interval
        skip = min(max(offset - 1, 0), size - 3) if size > 3 else 0
        rough = _between(motion, h, first + skip, min(3, size), offset - skip)
        force = contact.force(*fine)
        row, point = np.unravel_index(force.argmax(), force.shape)
        value = force[row, point]
        error = abs(value - contact.force(*rough)[row, point])
        if 0 < point < POINTS - 1:
            # the top of a parabola through three points
            below, above = force[row, point - 1], force[row, point + 1]
            bend = 2 * value - below - above
            rise = (above - below) ** 2 / (8 * bend) if bend > 0 else 0.0
            value += rise
            error += rise / POINTS
        if value > best[0]:
            best[:] = value, error, *fine[:, row, point]
    return best
