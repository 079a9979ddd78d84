"""Sums over a linear solution, against plain NumPy."""

from itertools import pairwise

import numpy as np
import pytest

from lmpchain.integrators.kernels.phase_error import (
    STATE,
    Evaluations,
    ImposedMotion,
    LinearLinks,
    StrainError,
    accumulate,
    start,
)

GRAINS = 5
TIMES = 6
RNG = np.random.default_rng(12)
TIME = np.cumsum(RNG.uniform(0.5, 1.5, TIMES))
U, V = RNG.normal(size=(2, TIMES, GRAINS)) * 0.3
STIFFNESS, SOFTNESS = RNG.uniform(1, 2, (2, GRAINS + 1))
MOBILITY = RNG.uniform(0.5, 1, GRAINS)
LINKS = LinearLinks(STIFFNESS, SOFTNESS, MOBILITY, RNG.uniform(0, 1, GRAINS))
WALL = RNG.normal(size=(TIMES, 3)) * 0.2
PUSH = RNG.normal(size=TIMES)
RECORDED = np.array([True, False, True, True, False, True])
WHOLE = np.array([[0, GRAINS]] * TIMES)
LEAD = 0.125


def plainly(
    solution: Evaluations, imposed: ImposedMotion, law: StrainError, links: LinearLinks = LINKS
) -> np.ndarray:
    """Return the final state computed in plain NumPy."""
    state = start()
    now = state[0]
    for i, t in enumerate(solution.time):
        first, last = solution.reach[i]
        bodies = np.zeros((3, GRAINS + 2))  # Displacement, velocity, acceleration.
        bodies[0, first + 1 : last + 1] = solution.displacement[i, first:last]
        bodies[1, first + 1 : last + 1] = solution.velocity[i, first:last]
        if first == 0:
            bodies[:, 0] = imposed.wall[i]
        force = links.stiffness * (bodies[0, :-1] - bodies[0, 1:])
        pulled = links.ground * bodies[0, 1:-1]
        bodies[2, 1:-1] = (force[:-1] - force[1:] - pulled) * links.inverse_mass
        bodies[2, 1 : first + 1] = bodies[2, last + 1 : -1] = 0
        if first <= imposed.grain < last:
            bodies[2, imposed.grain + 1] += imposed.acceleration[i]
        strain, rate, bend = (bodies[:, :-1] - bodies[:, 1:]) * links.inverse_overlap
        contacts = slice(first, last + 1)
        lowest = strain.copy()
        turns = np.abs(rate) < law.near * bend
        lowest[turns] -= (rate**2 / (2 * np.where(turns, bend, 1)))[turns]
        largest = strain[contacts][np.argmax(np.abs(strain[contacts]))]
        opened = np.flatnonzero(lowest[contacts] <= law.opening)
        if opened.size and np.isnan(now["opened"]):
            now["opened"] = first + opened[0]
        pull = 0.0
        if not np.isnan(now["opened"]):
            held = np.zeros(GRAINS + 1)
            apart = links.stiffness / links.inverse_overlap * np.maximum(-1 - strain, 0)
            held[contacts] = apart[contacts]
            pulls = np.abs(held[:-1] - held[1:]) * links.inverse_mass
            pull = pulls[first:last].max(initial=0)
        span = t - now["time"]
        now["shift"] += law.lead * (now["strain"] + largest) / 2 * span
        now["squared_strain"] += (now["strain"] ** 2 + largest**2) / 2 * span
        now["pulled"] += (now["pull"] + pull) / 2 * span
        now["time"] = t
        now["strain"] = largest
        now["pull"] = pull
        sizes = np.abs(bodies[:, first + 1 : last + 1]).max(1, initial=0)
        names = ("displacement", "velocity", "acceleration", "largest_strain")
        for name, size in zip(names, (*sizes, abs(largest)), strict=True):
            now[name] = max(now[name], size)
        if solution.recorded[i]:
            for name, size in zip(("displacement", "velocity"), sizes[1:], strict=True):
                now[f"{name}_error"] = max(now[f"{name}_error"], abs(now["shift"]) * size)
    return state


def compiled(
    solution: Evaluations,
    imposed: ImposedMotion,
    law: StrainError,
    links: LinearLinks = LINKS,
    pieces: tuple[int, ...] = (0, TIMES),
) -> np.ndarray:
    state = start()
    for begin, end in pairwise(pieces):
        piece = Evaluations(*(field[begin:end] for field in solution))
        acting = ImposedMotion(
            imposed.wall[begin:end], imposed.grain, imposed.acceleration[begin:end]
        )
        accumulate(state, links, piece, acting, law)
    return state


NARROW = np.array([[0, 2], [0, 3], [1, 3], [1, 4], [2, 5], [0, 5]])


@pytest.mark.parametrize("reach", [WHOLE, NARROW], ids=["whole", "growing"])
@pytest.mark.parametrize("grain", [0, 2, 4])
@pytest.mark.parametrize(("size", "near"), [(1.0, 0.0), (1.0, 0.7), (4.0, 0.3), (20.0, 5.0)])
def test_the_state_agrees_with_plain_numpy(reach: np.ndarray, grain: int, size: float, near: float):
    """One call and two calls agree with plain NumPy, also if contacts open."""
    solution = Evaluations(TIME, RECORDED, size * U, size * V, reach)
    imposed = ImposedMotion(size * WALL, grain, size * PUSH)
    law = StrainError(LEAD, near, -0.9)
    expected = plainly(solution, imposed, law)
    for pieces in ((0, TIMES), (0, 2, TIMES)):
        state = compiled(solution, imposed, law, pieces=pieces)
        assert state.view(float) == pytest.approx(expected.view(float), rel=1e-13, nan_ok=True)
    if size > 1:
        assert expected["pulled"] > 0
        assert expected["opened"] >= 0


def test_an_opening_between_two_times_is_detected():
    """The overlap, a parabola in time, is below the limit for a moment between two times."""
    u, v = np.zeros((2, TIMES, GRAINS))
    links = LinearLinks(STIFFNESS, np.ones(GRAINS + 1), MOBILITY, np.zeros(GRAINS))
    u[0] = [0, 0, 0.9, 0, 0]  # Contact 2 is stretched by 0.9 and returns.
    v[0] = [0, 0, -0.5, 0, 0]
    force = STIFFNESS * -np.diff(np.concatenate(([0], u[0], [0])))
    acceleration = (force[:-1] - force[1:]) * MOBILITY
    bend = acceleration[1] - acceleration[2]
    assert bend > 0
    lowest = -0.9 - 0.5**2 / (2 * bend)
    solution = Evaluations(TIME, RECORDED, u, v, WHOLE)
    imposed = ImposedMotion(np.zeros((TIMES, 3)), 0, np.zeros(TIMES))

    def opened(near: float, opening: float) -> float:
        return float(
            compiled(solution, imposed, StrainError(LEAD, near, opening), links)["opened"][0]
        )

    just = lowest * (1 - 1e-9)
    beyond = lowest * (1 + 1e-9)
    near = 0.5 / bend
    assert opened(1.01 * near, just) == 2
    assert np.isnan(opened(1.01 * near, beyond))
    assert np.isnan(opened(0.99 * near, just))
    assert opened(0.99 * near, -0.9) == 2


@pytest.mark.parametrize("before", [0.5, -0.5])
def test_equal_strains_of_both_signs_get_the_sign_of_the_strain_before(before: float):
    """Strains whose magnitudes differ by less than 1e-6 are equal up to rounding."""
    links = LinearLinks(STIFFNESS, np.ones(GRAINS + 1), MOBILITY, np.zeros(GRAINS))
    still = ImposedMotion(np.zeros((2, 3)), 0, np.zeros(2))
    for less in (0.9e-6, -0.9e-6, 1.1e-6, -1.1e-6):
        # The strains are before and -before / 2, twice; and then -1, 1 - less and less.
        u = np.array([[0, 0, -before, -before / 2, 0], [0, 0, 1, less, 0]])
        solution = Evaluations(TIME[:2], RECORDED[:2], u, 0 * u, WHOLE[:2])
        state = start()
        accumulate(state, links, solution, still, StrainError(LEAD, 0.0, -2.0))
        sign = before if abs(less) < 1e-6 else -less
        assert state["strain"][0] == (1 - less if sign > 0 else -1)
        mean = (before * TIME[0] + (before + state["strain"][0]) * (TIME[1] - TIME[0])) / 2
        assert state["shift"][0] == pytest.approx(LEAD * mean, rel=1e-14)


def test_the_initial_state():
    state = start()
    assert np.isnan(state["opened"][0])
    assert not any(state[name][0] for name in STATE.names if name != "opened")
