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


def test_the_order_of_multipliers(rng):
    """The largest is first, of conjugates that with the positive angle; a trivial pair is last."""
    turned = 0.9 * np.exp(0.5j)
    exact = np.array([-2.0, turned, turned.conjugate(), 0.3])
    block = np.zeros((4, 4))
    block[0, 0], block[3, 3] = -2.0, 0.3
    block[1:3, 1:3] = [[turned.real, turned.imag], [-turned.imag, turned.real]]
    basis = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    assert floquet.all_multipliers(basis @ block @ basis.T) == pytest.approx(exact, abs=1e-12)
    outer = np.exp([0.2 + 1j, 0.2 - 1j])
    large = np.array([-3.0, *outer, np.exp(0.3j), np.exp(2.0j)])
    order = np.array([0, 2, 1, 3, 4])  # Smaller angles are first.
    means = (large + 1 / large) / 2
    found = floquet.multipliers(means[[3, 0, 4, 1, 2]], True)
    assert found[0:-2:2] == pytest.approx(large[order], abs=1e-12)
    assert found[1:-2:2] == pytest.approx(1 / large[order], abs=1e-12)
    assert found[-2:].tolist() == [1.0, 1.0]
    # Pairs that have just left the circle, on which the root is small.
    beyond = floquet.multipliers(np.array([1 + 1e-9, -1 - 1e-9], complex), False)
    assert np.abs(beyond[::2]) == pytest.approx([1 + np.sqrt(2e-9)] * 2, rel=2e-9)
    near = np.array([1.2, 1.0 - 1e-9j, 0.7])
    assert floquet.without_trivial(near).tolist() == [1.2, 0.7]
