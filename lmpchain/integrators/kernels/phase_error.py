"""Phase error of a linear solution, accumulated over its evaluation times.

The state of the accumulation: time, strain and phase shift (s) by then; largest strain, displacement, velocity and
acceleration; largest effect of the shift on displacement and velocity in samples; the first contact that opens, if any;
pull of open contacts by then, and the velocity that it has given; integral of the squared strain.
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
    PULL,
    PULLED,
    SQUARED_STRAIN,
) = range(13)


def start() -> Array:
    """Return the state at t = 0."""
    state = np.zeros(13)
    state[OPENED] = np.nan
    return state


@compiled_once("the phase error of linear theory", 3)
def accumulate(
    times, recorded, us, vs, reach, walls, place, given, inverse_overlap, stiffness, inverse_mass,
    faster, near, open_at, state,
):  # fmt: skip
    """Take in the solution (T, N) at these times, with the motion (T, 3) of the top wall.

    The grain at the index `place` has the accelerations `given` (T,) besides those by its contacts. A contact that
    turns around within the time `near` is followed there by a parabola; one that comes below the strain `open_at` is
    open.
    """
    acceleration = np.zeros(us.shape[1] + 2)  # between the top wall and a body that stands still
    for i in range(times.size):
        first, last = reach[i]
        u, v, a = us[i, first:last], vs[i, first:last], acceleration[first : last + 2]
        wall = wall_speed = a[0] = a[-1] = 0.0
        if first == 0:
            wall, wall_speed, a[0] = walls[i, 0], walls[i, 1], walls[i, 2]
        above = stiffness[first] * (wall - u[0]) if u.size else 0.0
        for n in range(u.size):  # beyond these grains is one at rest
            below = stiffness[first + n + 1] * (u[n] - (u[n + 1] if n + 1 < u.size else 0.0))
            a[n + 1] = (above - below) * inverse_mass[first + n]
            above = below
        if first <= place < last:
            a[place - first + 1] += given[i]
        largest = displacement = velocity = fastest = pull = before = 0.0
        for n in range(u.size + 1):  # contacts
            x, y = (u[n - 1] if n > 0 else wall), (u[n] if n < u.size else 0.0)
            p, q = (v[n - 1] if n > 0 else wall_speed), (v[n] if n < u.size else 0.0)
            strain, bend = (
                (x - y) * inverse_overlap[first + n],
                (a[n] - a[n + 1]) * inverse_overlap[first + n],
            )
            rate, lowest = (p - q) * inverse_overlap[first + n], strain
            if bend > 0 and abs(rate) < near * bend:
                lowest = strain - rate * rate / (2 * bend)
            if abs(strain) > abs(largest):
                largest = strain
            if lowest <= open_at and np.isnan(state[OPENED]):
                state[OPENED] = first + n
            held = (
                stiffness[first + n] / inverse_overlap[first + n] * (-1.0 - lowest)
                if lowest < -1.0
                else 0.0
            )
            if n > 0:
                displacement, velocity = (
                    max(displacement, abs(u[n - 1])),
                    max(velocity, abs(v[n - 1])),
                )
                fastest = max(fastest, abs(a[n]))
                pull = max(pull, abs(before - held) * inverse_mass[first + n - 1])
            before = held
        span = times[i] - state[TIME]
        state[SHIFT] += faster * (state[STRAIN] + largest) / 2 * span
        state[SQUARED_STRAIN] += (state[STRAIN] ** 2 + largest**2) / 2 * span
        state[PULLED] += (state[PULL] + pull) / 2 * span
        state[TIME], state[STRAIN], state[PULL] = times[i], largest, pull
        state[MOST_STRAIN] = max(state[MOST_STRAIN], abs(largest))
        state[MOST_DISPLACEMENT] = max(state[MOST_DISPLACEMENT], displacement)
        state[MOST_VELOCITY] = max(state[MOST_VELOCITY], velocity)
        state[MOST_ACCELERATION] = max(state[MOST_ACCELERATION], fastest)
        if recorded[i]:
            shift = abs(state[SHIFT])
            state[OFF_DISPLACEMENT] = max(state[OFF_DISPLACEMENT], shift * velocity)
            state[OFF_VELOCITY] = max(state[OFF_VELOCITY], shift * fastest)
