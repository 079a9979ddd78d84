"""How large answers are and how far apart, against plain NumPy."""

import numpy as np
import pytest

from lmpchain.integrators.kernels.layout import STATE
from lmpchain.integrators.kernels.reductions import (
    NO_NUMBERS,
    SOUND,
    TOO_CLOSE,
    TOO_FAST,
    compared,
    in_parts,
    may_give_way,
)
from lmpchain.util.arrays import read_only

CHAINS, SAMPLES, GRAINS, OTHERS = 3, 5, 4, 2
BEGIN, FINAL = 3, 9
RNG = np.random.default_rng(8)
U, V = RNG.normal(size=(2, CHAINS, SAMPLES, GRAINS))
OTHERS_U, OTHERS_V = RNG.normal(size=(2, OTHERS, CHAINS, SAMPLES, GRAINS))
MASSES = RNG.uniform(1, 2, (CHAINS, GRAINS))
AGAINST, STRIDES = np.array([0, 1]), np.array([1, 2])
OVERLAP = RNG.uniform(0.5, 1, (CHAINS, GRAINS + 1))
STIFFNESS, CONSTANT = RNG.uniform(1, 2, (2, CHAINS, GRAINS + 1))
KINETIC = (MASSES[:, None] * V**2).sum(-1)  # twice the energy


def verdict(
    u=U, v=V, allowed=None, closest=0.1, furthest=10.0, begin=BEGIN, peaks=None, differences=None
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return what is said of the answers, their differences, and their peaks."""
    allowed = 1.01 * KINETIC.max(1) if allowed is None else allowed
    differences = np.full((OTHERS, FINAL + 1, CHAINS, 2), np.nan)
    peaks = np.zeros((CHAINS, 2)) if peaks is None else peaks
    state = np.zeros(2 * CHAINS, STATE)
    state["largest_approach"] = closest
    said = compared(
        u, v, OTHERS_U, OTHERS_V, AGAINST, STRIDES, MASSES, begin, differences, peaks, allowed, state, OVERLAP,
        STIFFNESS, CONSTANT, 1.5, furthest,
    )  # fmt: skip
    return said, differences, peaks


def test_differences_are_those_of_the_samples_where_others_stop():
    said, differences, peaks = verdict()
    assert said == SOUND
    expected = np.full((OTHERS, FINAL + 1, CHAINS, 2), np.nan)
    for at in range(BEGIN, BEGIN + SAMPLES):
        i = at - BEGIN
        expected[0, at, :, 0] = np.abs(U[:, i] - OTHERS_U[0, :, i]).max(-1)
        expected[0, at, :, 1] = np.abs(V[:, i] - OTHERS_V[0, :, i]).max(-1)
        if (
            at % 2 == 0 or at == FINAL
        ):  # the second stops at even samples, and is measured from the first
            expected[1, at, :, 0] = np.abs(OTHERS_U[0, :, i] - OTHERS_U[1, :, i]).max(-1)
            expected[1, at, :, 1] = np.abs(OTHERS_V[0, :, i] - OTHERS_V[1, :, i]).max(-1)
    assert np.array_equal(differences, expected, equal_nan=True)
    assert np.array_equal(peaks, np.stack([np.abs(field).max((1, 2)) for field in (U, V)], axis=1))


def test_all_begin_alike_and_all_stop_at_the_end():
    _, first, _ = verdict(begin=0)
    assert np.isnan(first[:, 0]).all()
    assert not np.isnan(first[:, 2]).any()
    assert np.isnan(first[1, [1, 3]]).all()
    _, last, _ = verdict(begin=FINAL - SAMPLES + 1)
    assert not np.isnan(last[:, FINAL]).any()
    assert np.isnan(last[1, FINAL - 2]).all()


def test_peaks_grow_only():
    larger, smaller = np.full((CHAINS, 2), 7.0), np.full((CHAINS, 2), 1e-3)
    assert (verdict(peaks=larger)[2] == 7.0).all()
    assert verdict(peaks=smaller)[2][:, 1] == pytest.approx(np.abs(V).max((1, 2)), rel=1e-15)


@pytest.mark.parametrize("chain", range(CHAINS))
def test_what_moves_faster_than_its_energy_allows_is_told(chain: int):
    allowed = 1.01 * KINETIC.max(1)
    allowed[chain] = 0.9999999 * KINETIC[chain].max()
    assert verdict(allowed=allowed)[0] == TOO_FAST
    allowed[chain] = 1.0000001 * KINETIC[chain].max()
    assert verdict(allowed=allowed)[0] == SOUND


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", [0, 1])
def test_what_is_no_number_is_told_before_all_else(field: int, wrong: float):
    fields = [U.copy(), V.copy()]
    fields[field][1, 2, 3] = wrong
    said, differences, _ = verdict(*fields, allowed=np.full(CHAINS, 1e-9), closest=100.0)
    assert said == NO_NUMBERS
    assert np.isnan(differences[:, BEGIN + 2, 1]).all()


def bound(chain: int, energy: float) -> float:
    """Return how much closer two grains may come than at rest at most, m."""
    power = (2.5 * energy / CONSTANT[chain]) ** (1 / 2.5)
    return float((OVERLAP[chain] + np.minimum(power, np.sqrt(2 * energy / STIFFNESS[chain]))).max())


@pytest.mark.parametrize("row", range(2 * CHAINS))
def test_what_comes_closer_than_its_energy_allows_is_told(row: int):
    allowed, closest = 1.01 * KINETIC.max(1), np.zeros(2 * CHAINS)
    most = bound(row % CHAINS, allowed[row % CHAINS])
    for factor, expected in ((0.999999, SOUND), (1.000001, TOO_CLOSE)):
        closest[row] = factor * most
        assert verdict(closest=closest)[0] == expected
        assert verdict(closest=closest, furthest=most * 0.999)[0] == TOO_CLOSE
    assert verdict(closest=0.4, furthest=0.4)[0] == SOUND
    closest[row] = np.nan
    assert verdict(closest=closest)[0] == TOO_CLOSE
    closest[row] = 2 * most
    slow = allowed.copy()
    slow[(row + 1) % CHAINS] *= 1e-3
    assert verdict(closest=closest, allowed=slow)[0] == TOO_FAST  # which says more


def test_contacts_that_are_none_or_not_pressed_bound_what_they_can():
    zero, one = read_only(np.zeros(1)), read_only(np.ones(1))
    assert may_give_way(0.0, 1.0, zero, zero, zero, 1.5)
    assert not may_give_way(1e-300, 1.0, zero, zero, zero, 1.5)
    loose = 2.5 ** (1 / 2.5)  # of a contact of K = 1 that nothing presses, by 1 J
    assert may_give_way(loose * (1 - 1e-12), 1.0, zero, zero, one, 1.5)
    assert not may_give_way(loose * (1 + 1e-12), 1.0, zero, zero, one, 1.5)


def told(differences=None, peaks=None, instead=None, scale=None, seen=None):
    """Return `in_parts` of random differences and a state of two schedules."""
    rng = np.random.default_rng(3)
    differences = rng.uniform(0, 1, (OTHERS, 6, CHAINS, 2)) if differences is None else differences
    state = np.zeros(2 * CHAINS, STATE)
    state["least_strain"] = [
        -0.4,
        -0.1,
        -0.6,
        -0.2,
        -0.5,
        -0.3,
    ]  # now by one schedule lower, now by the other
    state["steps"] = 100 + np.arange(6)
    state["largest_displacement"] = 0.2 + np.arange(6)
    state["largest_speed"] = 0.7 + np.arange(6)
    if seen is not None:
        state["largest_displacement"], state["largest_speed"] = np.broadcast_to(
            seen, (2, len(state))
        )
    units = np.array([[3.0, 4.0]] * CHAINS)
    scale = np.ones((CHAINS, 2)) if scale is None else scale
    peaks = np.array([[0.1, 5.0], [2.0, 0.1], [0.0, 0.0]]) if peaks is None else peaks
    none = np.empty((0, 2)) if instead is None else instead
    return differences, *in_parts(differences, peaks, none, scale, units, state)


def test_differences_are_parts_of_the_largest_motion():
    differences, summary, every = told()
    over = np.array([[0.2, 5.0], [2.0, 1.7], [2.2, 2.7]])  # of samples, or between them
    relative = differences / over
    assert summary[:, 0, 0] == pytest.approx([-0.4, -0.5, -0.6], rel=1e-15)
    assert summary[:, 0, 1].tolist() == [100, 101, 102]
    assert summary[:, 1] == pytest.approx(over, rel=1e-15)
    assert summary[:, 2, 0] == pytest.approx(over[:, 0] / over[:, 1], rel=1e-15)
    assert not summary[:, 2, 1].any()
    assert summary[:, 3:] == pytest.approx(relative.max(1).swapaxes(0, 1), rel=1e-14)
    assert every == pytest.approx(relative.max((0, 3)).T, rel=1e-14)


def test_differences_are_parts_of_what_is_given_instead_or_of_units_at_rest():
    instead = np.array([[7.0, 8.0], [9.0, 10.0]])
    assert told(instead=instead)[1][:, 1] == pytest.approx(
        np.array([[7, 8], [9, 10], [2.2, 2.7]]), rel=1e-15
    )
    scale = np.array(
        [[1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]
    )  # of which the first and the last are at rest
    over = told(instead=instead, scale=scale)[1][:, 1]
    assert over == pytest.approx(np.array([[3, 4], [9, 10], [3, 4]]), rel=1e-15)
    still = told(peaks=np.zeros((CHAINS, 2)), seen=0.0)[1]
    assert (still[:, 1] == 1.0).all()
    assert not still[:, 2].any()


def test_a_difference_that_is_no_number_is_infinite():
    differences = np.full((OTHERS, 6, CHAINS, 2), 0.5)
    differences[1, 3, 1, 0] = np.nan
    _, summary, every = told(differences)
    assert summary[1, 4, 0] == np.inf
    assert np.isfinite(summary[[0, 2]]).all()
    assert np.flatnonzero(np.isinf(every)).tolist() == [6 + 3]
