"""The largest force of a viscous contact between samples.

The largest force does not occur where the contact is closest. The approach is interpolated by a
polynomial of degree 7 through the approach and its rate at four samples, and the force is computed
from this polynomial. A polynomial of degree 5 through three samples shows the error.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ...chain.contacts import Contacts
from ...chain.damping import viscous_force
from ...util.arrays import Array
from .maxima import Window

# Number of points of an interval at which forces are compared, and number of refinements around the
# largest force.
POINTS = 33
ZOOMS = 4
# Safety factor on the difference of two polynomials, because either may span an opening of the
# contact.
SAFETY = 4.0
# Fraction of the largest force at the samples; intervals that are lower at both ends stay below it.
HIGH = 0.8


class ViscousContact(NamedTuple):
    """A contact, as arrays (1,), and its viscosity, s."""

    law: Contacts
    viscosity: float

    def force(self, closer: Array, closing: Array) -> Array:
        """Return forces, N, for approaches from rest, m, and their rates, m/s."""
        overlap = self.law.overlap + closer
        viscous = viscous_force(self.law, np.array([self.viscosity]), overlap, closing)
        return self.law.force_at(overlap) + viscous


@cache
def _hermite(nodes: tuple[int, ...]) -> Array:
    """Return the matrix (2Q, 2Q) from values and slopes at Q nodes to coefficients."""
    at = np.array(nodes, float)[:, None]
    powers = np.arange(2 * len(nodes))
    slopes = powers * at ** np.maximum(powers - 1, 0)
    return np.linalg.inv(np.concatenate((at**powers, slopes)))


class Polynomials(NamedTuple):
    """Approaches, m, in I intervals of length h, s, as polynomials of time over h, (I, 2Q)."""

    coefficients: Array
    h: float

    def at(self, when: Array) -> tuple[Array, Array]:
        """Return approaches and rates, (I, P) m and m/s, at (I, P) times from 0 to 1."""
        value = np.zeros(when.shape)
        slope = np.zeros(when.shape)
        # The sum is evaluated term by term, because the bits of a matrix product depend on the
        # number of intervals.
        for coefficient in self.coefficients.T[::-1]:
            slope = slope * when + value
            value = value * when + coefficient[:, None]
        return value, slope / self.h


def _between(motion: Array, h: float, first: Array, nodes: range) -> Polynomials:
    """Return polynomials through the samples from these numbers, at these nodes."""
    near = motion[:, first[:, None] + np.arange(len(nodes))]
    # Slopes are in units of the interval.
    data = np.concatenate((near[0], h * near[1]), axis=1)
    terms = (data[:, [k]] * row for k, row in enumerate(_hermite(tuple(nodes)).T))
    return Polynomials(sum(terms, np.zeros((1, 1))), h)


def largest_force(contact: ViscousContact, motion: Array, h: float, window: Window) -> Array:
    """Return the largest force in some intervals: value, N, its error, approach and rate, (4,).

    Parameters
    ----------
    contact : ViscousContact
        Contact with its law and viscosity.
    motion : (2, R) array
        Approach from rest, m, and its rate, m/s, at the samples.
    h : float
        Time between two samples, s.
    window : Window
        Intervals to search.
    """
    sampled = contact.force(*motion)
    numbers = np.arange(window.begin, window.end)
    higher = np.maximum(sampled[numbers], sampled[numbers + 1])
    numbers = numbers[higher >= HIGH * higher.max()]
    best = np.full(4, -np.inf)
    count = motion.shape[1]
    # At the ends of a run, intervals are at the ends of their samples.
    begins = np.clip(numbers - 1, 0, max(count - 4, 0))
    for offset in np.unique(numbers - begins).tolist():
        first = begins[numbers - begins == offset]
        size = min(4, count)
        fine = _between(motion, h, first, range(-offset, size - offset))
        # Three samples around the interval.
        skip = min(max(offset - 1, 0), size - 3) if size > 3 else 0
        begin = skip - offset
        rough = _between(motion, h, first + skip, range(begin, begin + min(3, size)))
        row = np.arange(first.size)
        middle = np.full((first.size, 1), 0.5)
        reach = 0.5
        for _ in range(ZOOMS):
            when = np.clip(middle + reach * np.linspace(-1.0, 1.0, POINTS), 0.0, 1.0)
            force = contact.force(*fine.at(when))
            point = force.argmax(1)
            middle = when[row, point][:, None]
            reach *= 2 / (POINTS - 1)
        top = int(force.max(1).argmax())
        value = force[top].max()
        if value > best[0]:
            at = middle[[top]]
            closer, closing = (x[0, 0] for x in Polynomials(fine.coefficients[[top]], h).at(at))
            other = Polynomials(rough.coefficients[[top]], h).at(at)
            # If the contact closes, add the decrease of the force from the nearest point.
            fall = np.abs(np.diff(force[top]))[max(point[top] - 1, 0) : point[top] + 1].min()
            error = SAFETY * abs(value - contact.force(*other)[0, 0]) + fall
            best[:] = value, error, closer, closing
    return best
