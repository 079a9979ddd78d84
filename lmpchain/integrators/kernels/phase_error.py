"""Phase error of a linear solution, accumulated over its evaluation times."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import Ingredient, compiled_once

compiled = compiled_once("the phase error of linear theory", 2)
joined = numba.njit(pipeline_class=Ingredient)


class PhaseSums(NamedTuple):
    """State of the accumulation.

    Attributes
    ----------
    time, strain, pull : float
        Time of the last evaluation, s; the strain of largest size in it; the largest acceleration
        by open contacts, which pull in linear theory, m/s2.
    shift, squared_strain, pulled : float
        By then: phase shift, s; integral of the squared strain, s; velocity given by the pull, m/s.
    largest_strain, displacement, velocity, acceleration : float
        Largest ones of all times, m, m/s and m/s2.
    displacement_error, velocity_error : float
        Largest effect of the shift in samples, m and m/s.
    opened : float
        The first contact that opened, or NaN.
    """

    time: float
    strain: float
    pull: float
    shift: float
    squared_strain: float
    pulled: float
    largest_strain: float
    displacement: float
    velocity: float
    acceleration: float
    displacement_error: float
    velocity_error: float
    opened: float


STATE = np.dtype([(name, np.float64) for name in PhaseSums._fields])


class LinearLinks(NamedTuple):
    """The linear chain; contact n lies above grain n, from 0, and the last one below all grains.

    Attributes
    ----------
    stiffness, inverse_overlap : (N+1,) arrays
        N/m and 1/m; 0 where nothing is pressed.
    inverse_mass : (N,) array
        1/kg; 0 for a grain that is held or moved.
    """

    stiffness: Array
    inverse_overlap: Array
    inverse_mass: Array


class Evaluations(NamedTuple):
    """The linear solution at some times.

    Attributes
    ----------
    time : (T,) array
        s.
    recorded : (T,) array
        Whether they are samples: errors are those of samples.
    displacement, velocity : (T, N) arrays
        m and m/s.
    reach : (T, 2) array
        First grain, from 0, and the one after the last that moves.
    """

    time: Array
    recorded: NDArray[np.bool_]
    displacement: Array
    velocity: Array
    reach: NDArray[np.intp]


class ImposedMotion(NamedTuple):
    """Motion of the top wall, and acceleration of a grain, that are imposed at these times.

    Attributes
    ----------
    wall : (T, 3) array
        Position, velocity and acceleration of the top wall, m, m/s and m/s2.
    grain : int
        The grain, from 0, that has accelerations besides those by its contacts.
    acceleration : (T,) array
        These, m/s2.
    """

    wall: Array
    grain: int
    acceleration: Array


class StrainError(NamedTuple):
    """How strain becomes an error.

    Attributes
    ----------
    lead : float
        Gain of the speed of a wave over its strain.
    near : float
        s; a contact that turns around within this time is followed there by a parabola.
    opening : float
        Strain from which on a contact counts as open.
    """

    lead: float
    near: float
    opening: float


def start() -> NDArray[np.void]:
    """Return the state at t = 0, (1,) of type `STATE`."""
    state = np.zeros(1, STATE)
    state["opened"] = np.nan
    return state


@joined
def _largest(x):
    """Return the largest |x| of an array in one dimension."""
    largest = 0.0
    for n in range(x.size):
        largest = max(largest, abs(x[n]))
    return largest


@joined
def _fill(bodies, i, links, solution, imposed):
    """Fill displacement, velocity and acceleration, (3, n+2), of the grains that move at time i.

    Above them is the top wall, or a grain at rest, and below a body at rest.
    """
    first, last = solution.reach[i]
    for k in range(3):
        bodies[k, 0] = imposed.wall[i, k] if first == 0 else 0.0
        bodies[k, last - first + 1] = 0.0
    x, v, a = bodies
    for n in range(first, last):
        x[n - first + 1] = solution.displacement[i, n]
        v[n - first + 1] = solution.velocity[i, n]
    above = links.stiffness[first] * (x[0] - x[1])
    for n in range(first, last):
        below = links.stiffness[n + 1] * (x[n - first + 1] - x[n - first + 2])
        a[n - first + 1] = (above - below) * links.inverse_mass[n]
        above = below
    # a force on a grain
    if first <= imposed.grain < last:
        a[imposed.grain - first + 1] += imposed.acceleration[i]


@joined
def _strain(bodies, inverse_overlap, law):
    """Return the strain of largest size, and the first contact that opens, -1 if none does."""
    x, v, a = bodies
    largest = 0.0
    opened = -1
    for n in range(inverse_overlap.size):
        strain = (x[n] - x[n + 1]) * inverse_overlap[n]
        rate = (v[n] - v[n + 1]) * inverse_overlap[n]
        bend = (a[n] - a[n + 1]) * inverse_overlap[n]
        # a contact may open and close again between two times
        lowest = strain
        if bend > 0 and abs(rate) < law.near * bend:
            lowest -= rate * rate / (2 * bend)
        if abs(strain) > abs(largest):
            largest = strain
        if lowest <= law.opening and opened < 0:
            opened = n
    return largest, opened


@joined
def _pull(x, links, first):
    """Return the largest acceleration of a grain by contacts that are open, m/s2."""
    largest = 0.0
    above = 0.0
    for n in range(x.size - 1):
        contact = first + n
        below = 0.0
        # linear theory goes on to pull where an open contact does nothing
        if (x[n] - x[n + 1]) * links.inverse_overlap[contact] < -1.0:
            apart = x[n + 1] - x[n] - 1 / links.inverse_overlap[contact]
            below = links.stiffness[contact] * apart
        if n > 0:
            largest = max(largest, abs(above - below) * links.inverse_mass[contact - 1])
        above = below
    return largest


@compiled
def accumulate(state, links, solution, imposed, law):
    """Take in the solution at later times."""
    now = state[0]
    room = np.empty((3, links.inverse_mass.size + 2))
    for i in range(solution.time.size):
        first, last = solution.reach[i]
        bodies = room[:, : last - first + 2]
        _fill(bodies, i, links, solution, imposed)
        strain, opened = _strain(bodies, links.inverse_overlap[first : last + 1], law)
        if opened >= 0 and np.isnan(now.opened):
            now.opened = first + opened
        pull = 0.0 if np.isnan(now.opened) else _pull(bodies[0], links, first)
        # by the trapezoidal rule
        span = solution.time[i] - now.time
        now.shift += law.lead * (now.strain + strain) / 2 * span
        now.squared_strain += (now.strain**2 + strain**2) / 2 * span
        now.pulled += (now.pull + pull) / 2 * span
        now.time = solution.time[i]
        now.strain = strain
        now.pull = pull
        x, v, a = bodies[:, 1:-1]
        displacement = _largest(x)
        velocity = _largest(v)
        acceleration = _largest(a)
        now.largest_strain = max(now.largest_strain, abs(strain))
        now.displacement = max(now.displacement, displacement)
        now.velocity = max(now.velocity, velocity)
        now.acceleration = max(now.acceleration, acceleration)
        # a shift in time is an error by the rate
        if solution.recorded[i]:
            shift = abs(now.shift)
            now.displacement_error = max(now.displacement_error, shift * velocity)
            now.velocity_error = max(now.velocity_error, shift * acceleration)
