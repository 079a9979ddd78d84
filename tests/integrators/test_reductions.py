"""Sizes of solutions and distances between them, against plain NumPy."""

import numpy as np
import pytest

from lmpchain.integrators.kernels.reductions import (
    NOT_A_NUMBER,
    SOUND,
    TOO_FAST,
    compare,
)

CHAINS = 3
SAMPLES = 5
GRAINS = 4
OTHERS = 2
BEGIN = 3
FINAL = 9
RNG = np.random.default_rng(8)
U, V = RNG.normal(size=(2, CHAINS, SAMPLES, GRAINS))
OTHERS_U, OTHERS_V = RNG.normal(size=(2, OTHERS, CHAINS, SAMPLES, GRAINS))
MASSES = RNG.uniform(1, 2, (CHAINS, GRAINS))
AGAINST = np.array([0, 1])
STRIDES = np.array([1, 2])
KINETIC = (MASSES[:, None] * V**2).sum(-1)  # Twice the energy.


def verdict(u=U, v=V, allowed=None, begin=BEGIN, peaks=None) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the reductions of solutions, of their differences and of their peaks."""
    allowed = 1.01 * KINETIC.max(1) if allowed is None else allowed
    differences = np.full((OTHERS, FINAL + 1, CHAINS, 2), np.nan)
    peaks = np.zeros((CHAINS, 2)) if peaks is None else peaks
    runs = (OTHERS_U, OTHERS_V, AGAINST, STRIDES)
    said = compare(u, v, runs, begin, MASSES, allowed, differences, peaks)
    return said, differences, peaks


def test_differences_are_taken_at_samples_of_both_runs():
    said, differences, peaks = verdict()
    assert said == SOUND
    expected = np.full((OTHERS, FINAL + 1, CHAINS, 2), np.nan)
    for at in range(BEGIN, BEGIN + SAMPLES):
        i = at - BEGIN
        expected[0, at, :, 0] = np.abs(U[:, i] - OTHERS_U[0, :, i]).max(-1)
        expected[0, at, :, 1] = np.abs(V[:, i] - OTHERS_V[0, :, i]).max(-1)
        # The second run stops at even samples, and is compared with the first.
        if at % 2 == 0 or at == FINAL:
            expected[1, at, :, 0] = np.abs(OTHERS_U[0, :, i] - OTHERS_U[1, :, i]).max(-1)
            expected[1, at, :, 1] = np.abs(OTHERS_V[0, :, i] - OTHERS_V[1, :, i]).max(-1)
    assert np.array_equal(differences, expected, equal_nan=True)
    assert np.array_equal(peaks, np.stack([np.abs(field).max((1, 2)) for field in (U, V)], axis=1))


def test_all_runs_begin_equal_and_stop_at_the_end():
    _, first, _ = verdict(begin=0)
    assert np.isnan(first[:, 0]).all()
    assert not np.isnan(first[:, 2]).any()
    assert np.isnan(first[1, [1, 3]]).all()
    _, last, _ = verdict(begin=FINAL - SAMPLES + 1)
    assert not np.isnan(last[:, FINAL]).any()
    assert np.isnan(last[1, FINAL - 2]).all()


def test_peaks_only_grow():
    larger = np.full((CHAINS, 2), 7.0)
    smaller = np.full((CHAINS, 2), 1e-3)
    assert (verdict(peaks=larger)[2] == 7.0).all()
    assert verdict(peaks=smaller)[2][:, 1] == pytest.approx(np.abs(V).max((1, 2)), rel=1e-15)


@pytest.mark.parametrize("chain", range(CHAINS))
def test_motion_above_the_allowed_energy_is_detected(chain: int):
    allowed = 1.01 * KINETIC.max(1)
    allowed[chain] = 0.9999999 * KINETIC[chain].max()
    assert verdict(allowed=allowed)[0] == TOO_FAST
    allowed[chain] = 1.0000001 * KINETIC[chain].max()
    assert verdict(allowed=allowed)[0] == SOUND


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", [0, 1])
def test_nan_is_detected_first(field: int, wrong: float):
    fields = [U.copy(), V.copy()]
    fields[field][1, 2, 3] = wrong
    said, differences, _ = verdict(*fields, allowed=np.full(CHAINS, 1e-9))
    assert said == NOT_A_NUMBER
    assert np.isnan(differences[:, BEGIN + 2, 1]).all()
