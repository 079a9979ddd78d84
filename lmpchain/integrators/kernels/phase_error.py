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
    time : float
        Time of the last evaluation, s.
    strain : float
        Strain of the largest magnitude at that time.
    pull : float
        Largest acceleration at that time by open contacts, which still pull in linear theory, m/s2.
    shift : float
        Phase shift up to that time, s.
    squared_strain : float
        Integral of the squared strain up to that time, s.
    pulled : float
        Velocity that the pull of open contacts has added up to that time, m/s.
    largest_strain, displacement, velocity, acceleration : float
        Largest magnitudes over all times; the last three in m, m/s and m/s2.
    displacement_error, velocity_error : float
        Largest effect of the phase shift on samples, m and m/s.
    opened : float
        Number of the first contact that opened, or NaN.
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
    """The linear chain; contact n is above grain n, from 0, and the last one below all grains.

    Attributes
    ----------
    stiffness, inverse_overlap : (N+1,) arrays
        N/m and 1/m; 0 for a contact that is not compressed.
    inverse_mass : (N,) array
        1/kg; 0 for a grain that is held or driven.
    ground : (N,) array
        Stiffness between each grain and the ground, N/m.
    """

    stiffness: Array
    inverse_overlap: Array
    inverse_mass: Array
    ground: Array


class Evaluations(NamedTuple):
    """The linear solution at T times.

    Attributes
    ----------
    time : (T,) array
        s.
    recorded : (T,) array
        Whether each time is a sample; errors are computed for samples.
    displacement, velocity : (T, N) arrays
        m and m/s.
    reach : (T, 2) array
        First grain that moves, from 0, and the grain after the last one that moves.
    """

    time: Array
    recorded: NDArray[np.bool_]
    displacement: Array
    velocity: Array
    reach: NDArray[np.intp]


class ImposedMotion(NamedTuple):
    """Imposed motion of the top wall, and acceleration of a forced grain, at T times.

    Attributes
    ----------
    wall : (T, 3) array
        Position, velocity and acceleration of the top wall, m, m/s and m/s2.
    grain : int
        The forced grain, from 0.
    acceleration : (T,) array
        Acceleration of that grain by the applied force, m/s2.
    """

    wall: Array
    grain: int
    acceleration: Array


class StrainError(NamedTuple):
    """Parameters that relate strain to an error.

    Attributes
    ----------
    lead : float
        Relative increase of the wave speed per unit of strain.
    near : float
        A contact that reverses within this time is extrapolated by a parabola, s.
    opening : float
        Strain below which a contact counts as open.
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
    """Compute the displacement, velocity and acceleration of the moving grains at time i.

    They are stored in `bodies`, (3, n+2). The first body is the top wall or a grain at rest; the
    last one is a body at rest.
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
        a[n - first + 1] = (
            above - below - links.ground[n] * x[n - first + 1]
        ) * links.inverse_mass[n]
        above = below
    # Add the applied force on a grain.
    if first <= imposed.grain < last:
        a[imposed.grain - first + 1] += imposed.acceleration[i]


@joined
def _strain(bodies, inverse_overlap, law):
    """Return the strain of largest magnitude, and the first contact that opens, -1 if none does."""
    x, v, a = bodies
    largest = 0.0
    opened = -1
    for n in range(inverse_overlap.size):
        strain = (x[n] - x[n + 1]) * inverse_overlap[n]
        rate = (v[n] - v[n + 1]) * inverse_overlap[n]
        bend = (a[n] - a[n + 1]) * inverse_overlap[n]
        # A contact may open and close again between two times.
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
        # In linear theory an open contact continues to pull.
        if (x[n] - x[n + 1]) * links.inverse_overlap[contact] < -1.0:
            apart = x[n + 1] - x[n] - 1 / links.inverse_overlap[contact]
            below = links.stiffness[contact] * apart
        if n > 0:
            largest = max(largest, abs(above - below) * links.inverse_mass[contact - 1])
        above = below
    return largest


@compiled
def accumulate(state, links, solution, imposed, law):
    """Update the state with the solution at later times."""
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
        # Integrate by the trapezoidal rule.
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
        # A time shift changes each quantity by the shift times its rate.
        if solution.recorded[i]:
            shift = abs(now.shift)
            now.displacement_error = max(now.displacement_error, shift * velocity)
            now.velocity_error = max(now.velocity_error, shift * acceleration)
