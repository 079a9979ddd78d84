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
        Strain of the largest magnitude of any contact at that time. Among strains that are equal up
        to rounding, it has the sign of the strain before.
    pull : float
        Largest acceleration of a grain at that time by open contacts, m/s2. In linear theory, open
        contacts still pull.
    shift : float
        Phase shift up to that time, s.
    squared_strain : float
        Integral over time of the squared strain up to that time, s.
    pulled : float
        Velocity that the pull of open contacts has added up to that time, m/s.
    largest_strain : float
        Largest magnitude of a strain so far.
    displacement : float
        Largest magnitude of a displacement so far, m.
    velocity : float
        Largest magnitude of a velocity so far, m/s.
    acceleration : float
        Largest magnitude of an acceleration so far, m/s2.
    displacement_error : float
        Largest effect of the phase shift on the displacements at samples, m.
    velocity_error : float
        Largest effect of the phase shift on the velocities at samples, m/s.
    opened : float
        Number of the first contact that opened, or NaN if none has opened.
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


# Relative difference of two strains of opposite sign that may be due to rounding, as in the two
# waves of a strike inside a chain. Random signs would hide the phase shifts of both waves.
EQUAL = 1e-6
STATE = np.dtype([(name, np.float64) for name in PhaseSums._fields])


class LinearLinks(NamedTuple):
    """The linear chain; contact n is above grain n, from 0, and the last one below all grains.

    Attributes
    ----------
    stiffness : (N+1,) array
        Stiffness of every contact, N/m; 0 for a contact that is not compressed.
    inverse_overlap : (N+1,) array
        1 / overlap of every contact at rest, 1/m; 0 for a contact that is not compressed.
    inverse_mass : (N,) array
        Inverse mass of every grain, 1/kg; 0 for a grain that is held or driven.
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
        Times of the evaluations, s.
    recorded : (T,) array of bool
        Whether each time is a sample; errors are computed only at samples.
    displacement : (T, N) array
        Displacement of every grain, m.
    velocity : (T, N) array
        Velocity of every grain, m/s.
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
        Number of the grain on which a force acts, from 0.
    acceleration : (T,) array
        Acceleration of this grain by the applied force, m/s2.
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
        Longest time, s, over which the motion of a contact is extrapolated by a parabola to the
        time at which it reverses.
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

    The results are stored in `bodies`, (3, n+2), for the n grains that move. The first body is the
    top wall or a grain at rest, and the last one is a body at rest.
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
def _strain(bodies, inverse_overlap, law, before):
    """Return the strain of largest magnitude, and the first contact that opens, -1 if none does.

    `before` is the strain of largest magnitude at the time before.
    """
    x, v, a = bodies
    highest = 0.0
    deepest = 0.0
    opened = -1
    for n in range(inverse_overlap.size):
        strain = (x[n] - x[n + 1]) * inverse_overlap[n]
        rate = (v[n] - v[n + 1]) * inverse_overlap[n]
        bend = (a[n] - a[n + 1]) * inverse_overlap[n]
        # A contact may open and close again between two times.
        lowest = strain
        if bend > 0 and abs(rate) < law.near * bend:
            lowest -= rate * rate / (2 * bend)
        highest = max(highest, strain)
        deepest = min(deepest, strain)
        if lowest <= law.opening and opened < 0:
            opened = n
    excess = highest + deepest
    if abs(excess) <= EQUAL * highest:
        excess = before
    return highest if excess >= 0 else deepest, opened


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
        strain, opened = _strain(bodies, links.inverse_overlap[first : last + 1], law, now.strain)
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
