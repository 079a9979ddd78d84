"""Band edges against LAPACK, exact values, and band edges of long chains."""

import numpy as np
from scipy.linalg.lapack import dstebz

from lmpchain.chain.band_edge import band_edges
from lmpchain.chain.contact_law import dynamical_matrix

EPSILON = np.finfo(float).eps


def test_band_edges_agree_with_lapack(rng):
    for _ in range(1500):
        moving = int(10 ** rng.uniform(0.4, 3))
        unlike = rng.choice([0.0, 0.1, 1.0, 5.0, 20.0])
        stiffness = np.exp(unlike * rng.normal(size=moving + 1))
        if rng.random() < 0.3:  # Under its own weight.
            stiffness = np.arange(1.0, moving + 2) ** rng.uniform(0.1, 1)
        stiffness[[0, -1]] *= rng.integers(2, size=2)  # With and without walls.
        masses = 10 ** rng.uniform(-50, 50) * np.exp(
            rng.choice([0.0, 0.1, 1.0, 5.0]) * rng.normal(size=moving)
        )
        diagonal, coupling = dynamical_matrix(stiffness, masses)
        square = dstebz(diagonal, coupling, 2, 0.0, 1.0, moving, moving, 0.0, "E")[1][0]
        (edge,) = band_edges(diagonal[None], coupling[None])
        assert abs(edge**2 / square - 1) < 8 * EPSILON


def test_they_are_exact_in_a_uniform_chain():
    """N equal masses and N + 1 equal springs: omega^2 = 4 k / m sin^2(N pi / 2 (N + 1))."""
    for grains in (1, 2, 3, 10, 1000, 10**6):
        diagonal, coupling = dynamical_matrix(np.full(grains + 1, 3.0), np.full(grains, 0.5))
        (edge,) = band_edges(diagonal[None], coupling[None])
        exact = 2 * np.sqrt(6.0) * np.sin(grains * np.pi / (2 * (grains + 1)))
        assert abs(edge / exact - 1) < 4 * EPSILON


def test_an_end_of_a_long_chain_that_swings_alone_above_the_band(rng):
    """The mode of a stiff wall decays along the chain and is separate from thousands of others."""
    for _ in range(100):
        moving = int(10 ** rng.uniform(2.5, 4.5))
        stiffness = np.ones(moving + 1)
        stiffness[0] = 10 ** rng.uniform(0, 1.5)
        masses = np.ones(moving)
        masses[0] = rng.uniform(0.3, 1.5)
        diagonal, coupling = dynamical_matrix(stiffness, masses)
        square = dstebz(diagonal, coupling, 2, 0.0, 1.0, moving, moving, 0.0, "E")[1][0]
        (edge,) = band_edges(diagonal[None], coupling[None])
        assert abs(edge**2 / square - 1) < 8 * EPSILON


def test_a_batch_has_the_bits_of_single_chains(rng):
    diagonal, coupling = dynamical_matrix(
        rng.gamma(2.0, size=(50, 101)), rng.gamma(2.0, size=(50, 100))
    )
    together = band_edges(diagonal, coupling)
    alone = [band_edges(d[None], c[None])[0] for d, c in zip(diagonal, coupling, strict=True)]
    assert together.tolist() == alone


def test_uncompressed_chains_have_band_edge_0():
    assert band_edges(np.zeros((2, 5)), np.zeros((2, 4))).tolist() == [0.0, 0.0]
