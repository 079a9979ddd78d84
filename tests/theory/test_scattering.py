"""Scattering of linear waves: closed forms, a dense linear solve, conservation, refusals."""

import numpy as np
import pytest

from lmpchain import Chain, InputError
from lmpchain.theory.scattering import transmission, transparent

LOADED = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
HOST = Chain(grains=11, **LOADED)
EDGE = 2 / HOST.time_scale
RNG = np.random.default_rng(5)


def solved(chain: Chain, w: float) -> tuple[complex, complex]:
    """Return amplitudes by one dense linear solve for all grains and both waves that leave."""
    m, k, n = chain.masses, chain.linear_stiffness, chain.grains
    q = [2 * np.arcsin(w / 2 * np.sqrt(m[end] / k[end])) for end in (0, -1)]
    matrix, right = np.zeros((n, n), complex), np.zeros(n, complex)
    for i in range(n):  # unknown: all displacements, with phi_1 = 1 + r and phi_N = t
        above, below = k[max(i - 1, 0)], k[min(i, n - 2)]
        matrix[i, i] = above + below - m[i] * w**2
        if i:
            matrix[i, i - 1] = -above
        if i < n - 1:
            matrix[i, i + 1] = -below
    matrix[0, 0] -= k[0] * np.exp(1j * q[0])
    right[0] = k[0] * (np.exp(-1j * q[0]) - np.exp(1j * q[0]))
    matrix[-1, -1] -= k[-1] * np.exp(1j * q[1])
    phi = np.linalg.solve(matrix, right)
    return phi[0] - 1, phi[-1]


def test_against_a_linear_solve():
    """Amplitudes with their phases, for a random piece and unlike leads."""
    chain = Chain(grains=14, material=["steel", "glass"] * 7, gravity=0.0, top_load=2.0,
                  diameter=RNG.uniform(0.8e-3, 1.3e-3, 14))  # fmt: skip
    edges = [2 * np.sqrt(chain.linear_stiffness[end] / chain.masses[end]) for end in (0, -1)]
    w = min(edges) * np.array([0.01, 0.3, 0.7, 0.95])
    found = transmission(chain, w)
    exact = np.array([solved(chain, one) for one in w]).T
    assert found.amplitude_reflected == pytest.approx(exact[0], rel=1e-10, abs=1e-12)
    assert found.amplitude_transmitted == pytest.approx(exact[1], rel=1e-10)
    assert found.reflected == pytest.approx(np.abs(exact[0]) ** 2, rel=1e-10)


def test_a_uniform_chain_lets_all_pass():
    w = EDGE * np.linspace(1e-6, 1 - 1e-6, 7)
    found = transmission(HOST, w)
    assert np.abs(found.reflected).max() < 1e-20
    assert found.amplitude_transmitted == pytest.approx(np.exp(1j * 10 * found.wavenumber), abs=1e-12)


def test_energy_is_conserved_in_long_pieces():
    chain = Chain(grains=3000, diameter=RNG.uniform(0.7e-3, 1.3e-3, 3000), gravity=0.0, top_load=1.0)
    edge = 2 * min(np.sqrt(chain.linear_stiffness[end] / chain.masses[end]) for end in (0, -1))
    found = transmission(chain, edge * np.linspace(0.01, 0.9, 30))
    assert np.abs(found.reflected + found.transmitted - 1).max() < 1e-12
    assert found.transmitted.min() < 1e-100


def test_a_wave_that_cannot_go_on_comes_back():
    heavy = Chain(grains=9, material=["steel"] * 4 + ["tungsten_carbide"] * 5, diameter=[1e-3] * 4 + [3e-3] * 5,
                  gravity=0.0, top_load=1.0)  # fmt: skip
    edge = 2 * np.sqrt(heavy.linear_stiffness[-1] / heavy.masses[-1])
    found = transmission(heavy, [0.9 * edge, 1.1 * edge])
    assert found.transmitted[0] > 0.01
    assert found.transmitted[1] == 0
    assert found.reflected == pytest.approx(1 - found.transmitted, abs=1e-13)


def test_two_uniform_leads():
    """A step in mass and stiffness: T = 4 Z Z' / (Z + Z')^2 with Z = sqrt(k m) of long waves."""
    masses, constants = np.ones(8), np.ones(7)
    masses[4:], constants[4:] = 3.0, 2.0
    chain = Chain(grains=8, diameter=1e5, gravity=0.0, top_load=1.0, masses=masses, contact_constants=constants)
    one, other = (np.sqrt(chain.linear_stiffness[end] * masses[end]) for end in (0, -1))
    found = transmission(chain, 1e-4)
    assert found.transmitted == pytest.approx(4 * one * other / (one + other) ** 2, rel=1e-7)


@pytest.mark.parametrize("grains", [[5, 6], [5, 6, 7], [4, 8]])
@pytest.mark.parametrize("vary", ["diameter", "mass", "modulus"])
def test_transparent_impurities(grains: list[int], vary: str):
    for x in (0.45, 0.62, 0.83):
        for factor in transparent(HOST, x * EDGE, grains, vary):
            odd = {
                "diameter": lambda n, f=factor: {"diameter": 1e-3 * f},
                "mass": lambda n, f=factor: {"mass": HOST.masses[0] * f},
                "modulus": lambda n, f=factor: {
                    "material": {**HOST.material.given(), "youngs_modulus": HOST.material.youngs_modulus * f}
                },
            }[vary]
            chain = Chain(grains=11, **LOADED, impurity=[{"grain": n} | odd(n) for n in grains])
            assert transmission(chain, x * EDGE).reflected < 1e-20
            assert abs(np.log(factor)) > 1e-9


def test_one_impurity_has_no_resonance_in_mass():
    assert transparent(HOST, 0.5 * EDGE, [6], "mass").size == 0


def test_picture():
    axes = transmission(HOST, EDGE * np.linspace(0.1, 0.9, 5)).plot().figure.axes[0]
    assert len(axes.lines) == 2


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: transmission(Chain(grains=5, diameter=1e-3, gravity=0.0), 1.0), "chain"),
        (lambda: transmission(HOST, [0.5 * EDGE, EDGE * 1.001]), "frequency"),
        (lambda: transmission(HOST, 0.0), "frequency"),
        (lambda: transparent(HOST, 0.5 * EDGE, [4, 5, 7]), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, []), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, [1, 2]), "grains"),
        (lambda: transparent(HOST, 0.5 * EDGE, [5, 6], "colour"), "vary"),
        (lambda: transparent(HOST, 0.5 * EDGE, [5, 6], between=(2.0, 1.0)), "between"),
        (lambda: transparent(Chain(grains=11, diameter=1e-3), 1e5, [5, 6]), "gravity"),
        (lambda: transparent(Chain(grains=2, **LOADED, masses=[1e-6, 1e-6]), 1e5, [5, 6]), "grains"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"{key}: "):
        call()
