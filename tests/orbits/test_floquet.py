"""Pairs of Floquet multipliers of symplectic matrices against the eigenvalues of the matrix."""

import numpy as np
import pytest
from scipy.linalg import expm

from lmpchain.orbits import floquet


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_multipliers_agree_with_the_matrix_in_exact_pairs(size: int):
    rng = np.random.default_rng(size)
    symmetric = rng.normal(size=(2 * size, 2 * size))
    turn = np.kron([[0, 1], [-1, 0]], np.eye(size))
    matrix = expm(0.3 * turn @ (symmetric + symmetric.T))
    assert floquet.inverse(matrix) @ matrix == pytest.approx(np.eye(2 * size), abs=1e-12)
    found = floquet.multipliers(floquet.means(matrix), False)
    exact = np.linalg.eigvals(matrix)
    assert np.abs(found[:, None] - exact).min(1).max() < 1e-10
    assert np.abs(exact[:, None] - found).min(1).max() < 1e-10
    assert found[::2] * found[1::2] == pytest.approx(np.ones(size), abs=1e-14)


def test_half_a_period_gives_the_multipliers_of_the_whole_period(rng):
    size = 5
    symmetric = rng.normal(size=(2 * size, 2 * size))
    half = expm(0.2 * np.kron([[0, 1], [-1, 0]], np.eye(size)) @ (symmetric + symmetric.T))
    whole = floquet.close(half)
    mirror = np.diag(np.repeat([1.0, -1.0], size))
    assert whole == pytest.approx(mirror @ np.linalg.inv(half) @ mirror @ half, abs=1e-12)
    means = np.sort_complex(floquet.reversible_means(half))
    assert means == pytest.approx(np.sort_complex(floquet.means(whole)), abs=1e-11)
