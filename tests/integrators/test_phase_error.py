"""What is accumulated of a linear solution, against plain NumPy."""

from itertools import pairwise

import numpy as np
import pytest

from lmpchain.integrators.kernels import phase_error
from lmpchain.integrators.kernels.phase_error import accumulate, start

GRAINS, TIMES = 5, 6
RNG = np.random.default_rng(12)
TIME = np.cumsum(RNG.uniform(0.5, 1.5, TIMES))
U, V = RNG.normal(size=(2, TIMES, GRAINS)) * 0.3
STIFFNESS, SOFTNESS = RNG.uniform(1, 2, (2, GRAINS + 1))
MOBILITY = RNG.uniform(0.5, 1, GRAINS)
WALLS, GIVEN = RNG.normal(size=(TIMES, 3)) * 0.2, RNG.normal(size=TIMES)
RECORDED = np.array([True, False, True, True, False, True])
WHOLE = np.array([[0, GRAINS]] * TIMES)
FASTER = 0.125


def plainly(
    u, v, reach, walls, place, given, near, open_at, inverse_overlap=SOFTNESS
) -> np.ndarray:
    """Return the state at the end."""
    state = start()
    before = {"time": 0.0, "strain": 0.0, "pull": 0.0}
    for i, t in enumerate(TIME):
        first, last = reach[i]
        bodies = np.zeros((3, GRAINS + 2))  # displacement, velocity, acceleration
        bodies[0, first + 1 : last + 1], bodies[1, first + 1 : last + 1] = (
            u[i, first:last],
            v[i, first:last],
        )
        if first == 0:
            bodies[:, 0] = walls[i]
        force = STIFFNESS * (bodies[0, :-1] - bodies[0, 1:])
        bodies[2, 1:-1] = (force[:-1] - force[1:]) * MOBILITY
        bodies[2, 1 : first + 1] = bodies[2, last + 1 : -1] = 0
        if first <= place < last:
            bodies[2, place + 1] += given[i]
        strain, rate, bend = (bodies[:, :-1] - bodies[:, 1:]) * inverse_overlap
        some = slice(first, last + 1)
        lowest = strain.copy()
        turns = np.abs(rate) < near * bend
        lowest[turns] -= (rate**2 / (2 * np.where(turns, bend, 1)))[turns]
        largest = strain[some][np.argmax(np.abs(strain[some]))]
        opened = np.flatnonzero(lowest[some] <= open_at)
        if opened.size and np.isnan(state[phase_error.OPENED]):
            state[phase_error.OPENED] = first + opened[0]
        held = np.zeros(GRAINS + 1)
        held[some] = (STIFFNESS / inverse_overlap * np.maximum(-1 - lowest, 0))[some]
        pull = (np.abs(held[:-1] - held[1:]) * MOBILITY)[first:last].max(initial=0)
        span = t - before["time"]
        state[phase_error.SHIFT] += FASTER * (before["strain"] + largest) / 2 * span
        state[phase_error.SQUARED_STRAIN] += (before["strain"] ** 2 + largest**2) / 2 * span
        state[phase_error.PULLED] += (before["pull"] + pull) / 2 * span
        before = {"time": t, "strain": largest, "pull": pull}
        speed, acceleration = (
            np.abs(field[first + 1 : last + 1]).max(initial=0) for field in bodies[1:]
        )
        sizes = (
            abs(largest),
            np.abs(bodies[0, first + 1 : last + 1]).max(initial=0),
            speed,
            acceleration,
        )
        for name, size in zip(
            ("STRAIN", "DISPLACEMENT", "VELOCITY", "ACCELERATION"), sizes, strict=True
        ):
            place_of = getattr(phase_error, f"MOST_{name}")
            state[place_of] = max(state[place_of], size)
        if RECORDED[i]:
            shift = abs(state[phase_error.SHIFT])
            off = phase_error.OFF_DISPLACEMENT, phase_error.OFF_VELOCITY
            state[list(off)] = np.maximum(state[list(off)], shift * np.array([speed, acceleration]))
    state[[phase_error.TIME, phase_error.STRAIN, phase_error.PULL]] = list(before.values())
    return state


def compiled(
    u, v, reach, walls, place, given, near, open_at, inverse_overlap=SOFTNESS, pieces=(0, TIMES)
) -> np.ndarray:
    state = start()
    for begin, end in pairwise(pieces):
        some = slice(begin, end)
        accumulate(
            TIME[some], RECORDED[some], u[some], v[some], reach[some], walls[some], place, given[some],
            inverse_overlap, STIFFNESS, MOBILITY, FASTER, near, open_at, state,
        )  # fmt: skip
    return state


NARROW = np.array([[0, 2], [0, 3], [1, 3], [1, 4], [2, 5], [0, 5]])


@pytest.mark.parametrize("reach", [WHOLE, NARROW], ids=["whole", "growing"])
@pytest.mark.parametrize("place", [0, 2, 4])
@pytest.mark.parametrize(("size", "near"), [(1.0, 0.0), (1.0, 0.7), (4.0, 0.3), (20.0, 5.0)])
def test_the_state_is_that_of_plain_numpy(reach: np.ndarray, place: int, size: float, near: float):
    """In one call and in two; for weak waves and such in which contacts open."""
    fields = size * U, size * V, reach, size * WALLS, place, size * GIVEN
    expected = plainly(*fields, near, -0.9)
    for pieces in ((0, TIMES), (0, 2, TIMES)):
        assert compiled(*fields, near, -0.9, pieces=pieces) == pytest.approx(
            expected, rel=1e-13, nan_ok=True
        )
    if size > 1:
        assert expected[phase_error.PULLED] > 0
        assert expected[phase_error.OPENED] >= 0


def test_a_contact_that_opens_between_two_times_is_told():
    """A parabola that comes below the limit for a moment; behind its turn, and not if that is far from here."""
    u, v = np.zeros((2, TIMES, GRAINS))
    still, none = np.zeros((TIMES, 3)), np.zeros(TIMES)
    alike = np.ones(GRAINS + 1)
    u[0], v[0] = (
        [0, 0, 0.9, 0, 0],
        [0, 0, -0.5, 0, 0],
    )  # contact 2 is stretched by 0.9 and comes back
    force = STIFFNESS * -np.diff(np.concatenate(([0], u[0], [0])))
    acceleration = (force[:-1] - force[1:]) * MOBILITY
    bend = acceleration[1] - acceleration[2]
    assert bend > 0
    lowest = -0.9 - 0.5**2 / (2 * bend)
    how = u, v, WHOLE, still, 0, none
    just, beyond = lowest * (1 - 1e-9), lowest * (1 + 1e-9)
    near = 0.5 / bend
    assert compiled(*how, 1.01 * near, just, alike)[phase_error.OPENED] == 2
    assert np.isnan(compiled(*how, 1.01 * near, beyond, alike)[phase_error.OPENED])
    assert np.isnan(compiled(*how, 0.99 * near, just, alike)[phase_error.OPENED])
    assert compiled(*how, 0.99 * near, -0.9, alike)[phase_error.OPENED] == 2


def test_nothing_is_known_at_first():
    state = start()
    assert np.isnan(state[phase_error.OPENED])
    assert state.size == 13
    assert not np.delete(state, phase_error.OPENED).any()
