"""Steps of an orbit: number, lengths and positions, against a brute-force search for openings."""

import numpy as np
import pytest

from lmpchain import Chain, Drive
from lmpchain.orbits import shooting
from lmpchain.orbits.flow import Flow, Passage

CHAIN = Chain(grains=5, diameter=1e-3, gravity=0.0, top_load=1.0, top="wall", bottom="wall")
FLOW = Flow(CHAIN, 1e6)
EPS = CHAIN.contacts.overlap


def test_the_highest_frequency_bounds_the_stiffest_chain(rng):
    """The bound is twice the summed stiffness at a grain over its mass (Gershgorin)."""
    masses = rng.uniform(1, 3, 5) * 1e-6
    chain = CHAIN.replace(masses=masses)
    u = rng.normal(size=(7, 5)) * EPS[1]
    overlap = chain.contacts.overlap - np.diff(u, axis=1, prepend=0.0, append=0.0)
    stiffness = 1.5 * chain.contacts.constant * np.sqrt(np.maximum(overlap, 0.0)).max(0)
    bound = 2 * (stiffness[:-1] + stiffness[1:]) / masses
    assert shooting.highest_frequency(Flow(chain, 1e6), u) == pytest.approx(
        np.sqrt(bound.max()), rel=1e-12
    )
    driven = Flow(chain, 1e6, Drive(amplitude=1e-9, frequency=1e5))
    assert shooting.highest_frequency(driven, u) == pytest.approx(
        np.sqrt(bound[1:].max()), rel=1e-12
    )


@pytest.mark.parametrize("turns", [0.5, 10.0, 37.0])
@pytest.mark.parametrize("reach", [0.3, 0.1])
def test_uniform_steps_limit_the_phase_of_the_fastest_motion(turns: float, reach: float):
    rest = np.zeros((1, 5))
    period = turns / shooting.highest_frequency(FLOW, rest)
    steps = shooting.uniform(FLOW, period, rest, reach)
    assert steps.size % 2 == 0
    np.testing.assert_allclose(steps, 1 / steps.size, rtol=1e-14)
    fewest = max(24.0, turns / reach)
    assert fewest <= steps.size <= fewest + 3
    if reach == 0.3:
        assert shooting.uniform(FLOW, period, rest).size == steps.size


def test_very_long_periods_have_a_limited_number_of_steps():
    rest = np.zeros((1, 5))
    steps = shooting.uniform(FLOW, 1e9 / shooting.highest_frequency(FLOW, rest), rest)
    assert 20_000 <= steps.size <= 20_003


def moving(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement and velocity (K, 5) of a motion of period 1 with openings."""
    turn = 2 * np.pi * time[:, None]
    n = np.arange(5)
    u = EPS[1] * (1.3 * np.sin(turn + n) * (n > 1) + 0.3 * np.sin(2 * turn) * (n == 0))
    v = EPS[1] * 2 * np.pi * (1.3 * np.cos(turn + n) * (n > 1) + 0.6 * np.cos(2 * turn) * (n == 0))
    return u, v


def passage_of(u: np.ndarray, v: np.ndarray) -> Passage:
    """Return the passage of a motion below a wall at rest."""
    return Passage(u, v, np.zeros((2, len(u))), u[-1:], np.zeros(0))


def test_openings_are_at_zero_overlaps(rng):
    """The motion is given in closed form, and openings are found by a search over many times."""
    steps = rng.uniform(0.5, 1.5, 400)
    steps /= steps.sum()
    u, v = moving(np.concatenate(([0.0], np.cumsum(steps))))
    period = 3e-5
    times = shooting.openings(FLOW, passage_of(u, v / period), period, steps)
    dense = np.linspace(0, 1, 100_001)
    overlap = EPS - np.diff(moving(dense)[0], axis=1, prepend=0.0, append=0.0)
    passed = np.flatnonzero(np.diff(overlap > 0, axis=0).any(1))
    assert len(passed) > 2
    np.testing.assert_allclose(times, dense[passed], rtol=0, atol=1.2e-5)
    closed = shooting.openings(FLOW, passage_of(0.2 * u, 0.2 * v / period), period, steps)
    assert closed.size == 0


def test_a_contact_that_never_closes_does_not_open():
    """A contact that touches only by rounding does not open either, in a chain without load."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, top="wall", bottom="wall")
    flow = Flow(chain, 1e6)
    steps = np.full(4, 0.25)
    size = 1e-7
    u = size * np.array([[1.0, -0.5], [0.9, -0.4], [0.8, -0.3], [0.9, -0.4], [1.0, -0.5]])
    passage = passage_of(u, np.zeros((5, 2)))
    assert shooting.openings(flow, passage, 1.0, steps).size == 0
    for touch, many in ((1e-10, 0), (1e-8, 2)):
        touching = u.copy()
        touching[2, 0] = -touch * size  # The contact with the top wall closes for a moment.
        times = shooting.openings(flow, passage_of(touching, np.zeros((5, 2))), 1.0, steps)
        assert times.size == many


@pytest.mark.parametrize(
    ("times", "turns", "reach"),
    [
        ([0.13, 0.31, 0.62], 20.0, 0.18),
        ([0.13, 0.31, 0.62], 200.0, 0.3),
        *(([time], 50.0, 0.3) for time in (0.004, 0.996, 0.5, 0.0)),
    ],
)
def test_graded_steps_are_symmetric_and_shrink_towards_openings(
    times: list[float], turns: float, reach: float
):
    """Steps are about 0.35 of the time to the nearest opening, including its mirror images."""
    rest = np.zeros((1, 5))
    highest = shooting.highest_frequency(FLOW, rest)
    period = turns / highest
    steps = shooting.graded(FLOW, period, rest, np.array(times), reach)
    even = shooting.uniform(FLOW, period, rest, reach)
    assert steps.size % 2 == 0
    assert steps.sum() == pytest.approx(1, rel=1e-12)
    np.testing.assert_allclose(steps, steps[::-1], rtol=1e-12)
    once = np.array([*times, *(1 - np.array(times))])
    every = np.array([*once, *(once - 1), *(once + 1)])
    ends = np.concatenate(([0.0], np.cumsum(steps)))
    distance = np.abs((ends[1:] + ends[:-1])[:, None] / 2 - every).min(1)
    least = shooting.MESH.crossing / turns
    grading = 0.35 * reach / 0.3
    wanted = np.clip(grading * distance, least, even[0])
    smooth = (np.abs(grading * distance - least) > 0.5 * least) & (distance > steps)
    assert (steps <= even[0] * (1 + 1e-9)).all()
    # A step may be as long as allowed at its farther end.
    slack = np.clip(grading * (distance + steps / 2), least, even[0])
    assert (steps <= 1.05 * slack).all()
    away = smooth & (grading * distance > 1.5 * even[0])
    np.testing.assert_allclose(steps[away], even[0], rtol=0.01 + 2 / steps.size)
    graded = smooth & (grading * distance < 0.8 * even[0]) & (grading * distance > 3 * least)
    np.testing.assert_allclose(steps[graded], wanted[graded], rtol=0.05)
    for time in once:
        near = np.abs(ends[1:-1] - time).argmin()
        shortest = steps[max(near - 2, 0) : near + 3].min()
        assert shortest == pytest.approx(least, rel=0.1)


def test_without_openings_steps_are_uniform():
    rest = np.zeros((1, 5))
    period = 100 / shooting.highest_frequency(FLOW, rest)
    for reach in (0.3, 0.1):
        steps = shooting.graded(FLOW, period, rest, np.zeros(0), reach)
        np.testing.assert_array_equal(steps, shooting.uniform(FLOW, period, rest, reach))


@pytest.mark.parametrize("drive", [None, Drive(amplitude=1e-9, frequency=1e5)])
def test_very_many_openings_give_a_limited_number_of_steps(drive: Drive | None):
    rest = np.zeros((1, 5))
    flow = Flow(CHAIN, 1e6, drive)
    times = np.linspace(0.01, 0.99, 800) if drive else np.linspace(0.01, 0.49, 400)
    period = 4e3 / shooting.highest_frequency(flow, rest)
    steps = shooting.graded(flow, period, rest, times)
    assert steps.size == 20_000
    assert steps.sum() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("time", [0.004, 0.2, 0.996])
def test_an_opening_of_a_driven_chain_counts_a_period_earlier_and_later(time: float):
    """Steps shorten at both ends of a period if a contact opens near one of them, and nowhere else.

    A motion without a drive is symmetric in time, so that they would also shorten at the mirrored
    times.
    """
    turns = 50.0
    rest = np.zeros((1, CHAIN.grains))
    flow = Flow(CHAIN, 1e6, Drive(amplitude=1e-9, frequency=1e5))
    period = turns / shooting.highest_frequency(flow, rest)
    steps = shooting.graded(flow, period, rest, np.array([time]))
    ends = np.concatenate(([0.0], np.cumsum(steps)))
    middles = (ends[1:] + ends[:-1]) / 2
    distance = np.abs(middles[:, None] - (time + np.array([-1.0, 0.0, 1.0]))).min(1)
    even = shooting.uniform(flow, period, rest)[0]
    close = (
        (distance > 2 * steps) & (0.35 * distance < 0.8 * even) & (0.35 * distance > 3e-4 / turns)
    )
    for half in (close & (middles < time), close & (middles > time)):
        assert half.any()
        np.testing.assert_allclose(steps[half], 0.35 * distance[half], rtol=0.05)
    far = 0.35 * distance > 1.5 * even
    np.testing.assert_allclose(steps[far], even, rtol=0.02)
    assert steps.sum() == pytest.approx(1, rel=1e-12)
