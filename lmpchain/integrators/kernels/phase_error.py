"""Phase error of a linear solution, accumulated over its evaluation times.

The state of the accumulation: time, strain and phase shift (s) by then; largest strain, displacement, velocity and
acceleration; largest effect of the shift on displacement and velocity; the first contact that opens, if any; largest
displacement and velocity in samples; integral of the squared strain.
"""

from __future__ import annotations

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once

(
    TIME,
    STRAIN,
    SHIFT,
    MOST_STRAIN,
    MOST_DISPLACEMENT,
    MOST_VELOCITY,
    MOST_ACCELERATION,
    OFF_DISPLACEMENT,
    OFF_VELOCITY,
    OPENED,
    SAMPLED_DISPLACEMENT,
    SAMPLED_VELOCITY,
    SQUARED_STRAIN,
) = range(13)


def start() -> Array:
    """Return the state at t = 0."""
    state = np.zeros(13)
    state[OPENED] = np.nan
    return state


@compiled_once("the phase error of linear theory", 3)
def accumulate(times, recorded, us, vs, walls, reach, inverse_overlap, stiffness, inverse_mass, faster, state):
    """Take in the solution (T, N) at these times, with the top wall at (T,)."""
    for i in range(times.size):
        first, last = reach[i]
        u, v = us[i, first:last], vs[i, first:last]
        largest = displacement = velocity = acceleration = before = 0.0
        above = walls[i] if first == 0 else 0.0
        for n in range(u.size + 1):  # contacts; before and after these grains is one at rest
            r = (u[n - 1] if n > 0 else above) - (u[n] if n < u.size else 0.0)
            strain, force = r * inverse_overlap[first + n], r * stiffness[first + n]
            if abs(strain) > abs(largest):
                largest = strain
            if strain <= -1.0 and np.isnan(state[OPENED]):
                state[OPENED] = first + n
            if n > 0:
                displacement, velocity = max(displacement, abs(u[n - 1])), max(velocity, abs(v[n - 1]))
                acceleration = max(acceleration, abs(before - force) * inverse_mass[first + n - 1])
            before = force
        state[SHIFT] += faster * (state[STRAIN] + largest) / 2 * (times[i] - state[TIME])
        state[SQUARED_STRAIN] += (state[STRAIN] ** 2 + largest**2) / 2 * (times[i] - state[TIME])
        state[TIME], state[STRAIN] = times[i], largest
        state[MOST_STRAIN] = max(state[MOST_STRAIN], abs(largest))
        state[MOST_DISPLACEMENT] = max(state[MOST_DISPLACEMENT], displacement)
        state[MOST_VELOCITY] = max(state[MOST_VELOCITY], velocity)
        state[MOST_ACCELERATION] = max(state[MOST_ACCELERATION], acceleration)
        if recorded[i]:
            shift = abs(state[SHIFT])
            state[OFF_DISPLACEMENT] = max(state[OFF_DISPLACEMENT], shift * velocity)
            state[OFF_VELOCITY] = max(state[OFF_VELOCITY], shift * acceleration)
            state[SAMPLED_DISPLACEMENT] = max(state[SAMPLED_DISPLACEMENT], displacement)
            state[SAMPLED_VELOCITY] = max(state[SAMPLED_VELOCITY], velocity)
