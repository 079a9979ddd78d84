"""Eigenmodes of chains against mpmath, an integrator, exact columns and published numbers."""

from functools import cache

import mpmath as mp
import numpy as np
import pytest
from helpers.independent_theory import gravity_column, integrate, springs
from helpers.thinned import thinned
from scipy.linalg import expm
from scipy.special import eval_laguerre, roots_laguerre

from lmpchain import GLASS, STEEL, Chain, InputError, Law
from lmpchain.theory import modes

RNG = np.random.default_rng(11)
CHAINS = {
    "the paper's": Chain(grains=61, diameter=1e-3),
    "delta = 1": Chain(grains=30, diameter=1e-3, exponent=1.0),
    "delta = 3": Chain(grains=30, diameter=1e-3, exponent=3.0),
    "disordered": Chain(
        grains=30,
        material=[GLASS, STEEL] * 15,
        diameter=RNG.uniform(0.5e-3, 2e-3, 30),
        top_load=1e-4,
    ),
    "disordered by 100": springs(10 ** RNG.uniform(-1, 1, 40), 10 ** RNG.uniform(-1, 1, 41)),
    "soft bottom": springs(np.exp(-0.3 * np.arange(60.0))),
    "light top": springs(np.ones(30), np.append(1e-3, np.ones(30))),
    "one grain moves": Chain(grains=2, diameter=1e-3),
}


@cache
def column_modes(movable: int, delta: float = 1.5) -> modes.Eigenmodes:
    """Return the modes of a column of unit masses with the stiffnesses of Eq. (3)."""
    return modes.eigenmodes(springs(gravity_column(movable, delta)))


each_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


def exact_squares(chain: Chain, start: np.ndarray) -> list[mp.mpf]:
    """Return the roots near `start` of det(K - lambda M), by Newton's method in mpmath."""
    k = [mp.mpf(0), *map(mp.mpf, chain.linear_stiffness.tolist())]
    m = list(map(mp.mpf, chain.masses.tolist()))
    roots = []
    for guess in map(mp.mpf, start.tolist()):
        root = guess
        for _ in range(2):
            before = mp.mpf(0)
            now = mp.mpf(1)
            slope_before = mp.mpf(0)
            slope = mp.mpf(0)
            for n in range(chain.movable):
                pivot = (k[n] + k[n + 1]) / m[n] - root
                coupling = k[n] ** 2 / (m[n] * m[n - 1])
                ahead = pivot * now - coupling * before
                slope_before, slope = slope, pivot * slope - now - coupling * slope_before
                before = now
                now = ahead
            change = now / slope
            root -= change
        assert abs(change) < 1e-20 * guess
        roots.append(root)
    return roots


@each_chain
def test_every_frequency_is_accurate(chain: Chain):
    found = modes.eigenmodes(chain).frequency
    with mp.workdps(40):
        exact = [float(mp.sqrt(square)) for square in exact_squares(chain, found**2)]
    assert np.all(np.diff(exact) > 0)
    assert found == pytest.approx(exact, rel=2e-15)


def test_lowest_frequencies_of_a_long_chain():
    """Plain diagonalisation has absolute errors, which would cost five digits here."""
    found = column_modes(1000).frequency[:3]
    with mp.workdps(40):
        squares = exact_squares(springs(gravity_column(1000)), found**2)
        exact = [float(mp.sqrt(square)) for square in squares]
    assert found == pytest.approx(exact, rel=2e-15)


def test_lowest_shapes_are_accurate():
    """Plain diagonalisation mixes low modes by ``eps (omega_max / omega)^2``, here 1e-10."""
    stiffness = 10 ** RNG.uniform(-2, 2, 16)
    masses = 10 ** RNG.uniform(-2, 2, 16)
    found = modes.eigenmodes(springs(stiffness, np.append(masses, 1.0)))
    with mp.workdps(40):
        m, k = (list(map(mp.mpf, x.tolist())) for x in (masses, stiffness))
        exact = mp.matrix(16, 16)
        for n in range(16):
            exact[n, n] = (k[n] + (k[n - 1] if n else 0)) / m[n]
            if n:
                exact[n, n - 1] = exact[n - 1, n] = -k[n - 1] / mp.sqrt(m[n] * m[n - 1])
        vectors = mp.eigsy(exact)[1]
        shape = np.array(
            [[float(vectors[n, p] / mp.sqrt(m[n])) for p in range(8)] for n in range(16)]
        )
    shape *= np.sign(found.mass @ (shape * found.shape[:, :8]))
    assert np.sqrt(found.mass @ (shape - found.shape[:, :8]) ** 2).max() < 2e-14


@each_chain
def test_shapes_solve_eq_14_and_are_orthonormal_in_mass(chain: Chain):
    result = modes.eigenmodes(chain)
    m = result.mass
    k = chain.linear_stiffness
    shape = result.shape
    assert np.abs(shape.T @ (m[:, None] * shape) - np.eye(chain.movable)).max() < 2e-14
    force = k[:, None] * np.diff(shape, axis=0, append=0.0)
    miss = np.diff(force, axis=0, prepend=0.0) + result.frequency**2 * m[:, None] * shape
    assert np.abs(miss / np.sqrt(m)[:, None]).max() < 2e-14 * result.frequency[-1] ** 2


@each_chain
def test_response_against_an_integrator(chain: Chain):
    """Eqs. (15) and (16) with both types of initial data."""
    scale = chain.time_scale
    displacement, velocity = RNG.normal(size=(2, chain.movable))
    tau = np.linspace(0, 60, 6) / (chain.band_edge * scale)
    found = modes.eigenmodes(chain).response(tau * scale, displacement, velocity / scale)
    stiffness = chain.linear_stiffness / chain.linear_stiffness[0]
    masses = chain.masses[:-1] / chain.masses[0]
    exact = integrate(stiffness, displacement, velocity, tau, masses)
    for x, true in zip((found[0], found[1] * scale), exact, strict=True):
        assert np.abs(x - true).max() < 2e-12 * np.abs(true).max()


@pytest.mark.parametrize(
    ("viscous", "drag", "ground"),
    [(0.1, 0.0, 0.0), (0.0, 0.3, 0.0), (3.0, 0.2, 0.0), (0.5, 0.1, 0.7), (0.0, 0.4, "uneven")],
)
def test_damped_response_is_that_of_the_matrix_exponential(
    viscous: float, drag: float, ground: float | str
):
    """Weak damping, drag, overdamped modes, and springs to the ground; rates over the band edge."""
    masses = 1e-6 * RNG.uniform(1.0, 2.0, 6)
    plain = Chain(grains=6, diameter=1e-3, top_load=1e-3, top="wall", gravity=9.81, masses=masses)
    w = plain.band_edge
    pulls = np.linspace(0.5, 1, 6) if ground == "uneven" else np.full(6, ground, float)
    damping = {"viscoelastic": viscous / w, "drag": drag * w}
    law = Law("s*u", s=pulls * w**2 * plain.masses) if pulls.any() else None
    chain = plain.replace(damping=damping, ground=law)
    k = np.diag(chain.contacts.stiffness[:6] / w**2)
    springs = np.diff(np.eye(6), axis=0, prepend=0.0)[:, :5]
    contacts = (springs.T @ k @ springs) / chain.masses[:5, None]
    rates = np.block([
        [np.zeros((5, 5)), np.eye(5)],
        [-contacts - np.diag(pulls[:5]), -viscous * contacts - drag * np.eye(5)],
    ])  # fmt: skip
    u, v = RNG.normal(size=(2, 5))
    times = np.array([0.0, 0.3, 2.0, 9.0])
    found = np.hstack(modes.eigenmodes(chain).response(times / w, u, w * v))
    exact = np.array([expm(rates * t) @ np.append(u, v) for t in times])
    assert np.abs(found / np.repeat([1.0, w], 5) - exact).max() < 1e-12


def test_damping_that_couples_modes_is_refused():
    plain = Chain(grains=3, diameter=1e-3, ground=Law("s*u", s=[1e3, 2e3, 0.0]))
    for damping, key in (
        ({"viscoelastic": 1e-7}, "chain.ground"),
        ({"viscoelastic": [1e-7, 2e-7]}, "chain.damping.viscoelastic"),
        ({"drag": [1.0, 1.0, 2.0]}, "chain.damping.drag"),
    ):
        with pytest.raises(InputError, match=f"{key}: .* couples"):
            modes.eigenmodes(plain.replace(damping=damping))
    for law, message in (
        (Law("-s*u", s=1.0), "must have a stiffness of 0 or more at rest"),
        (Law("s*sin(t)*u", s=1.0), "does not support a stiffness that changes in time"),
        (Law("s*max(u, 0)", s=1.0), "does not support a kink at rest"),
    ):
        with pytest.raises(InputError, match=f"^chain.ground: .*{message}"):
            modes.eigenmodes(plain.replace(ground=law))


@pytest.mark.parametrize(
    ("movable", "lowest", "highest"),
    [
        (10, [0.205435847948, 0.568197206709, 0.919847924023], 2.719178378759),
        (100, [0.031305606405, 0.087215363664, 0.143291996878], 4.240427874418),
    ],
)
def test_published_frequencies(movable: int, lowest: list[float], highest: float):
    """The source is an independent code for the same column, with twelve digits."""
    found = column_modes(movable).frequency
    assert found[[0, 1, 2]] == pytest.approx(lowest, abs=1e-12)
    assert found[-1] == pytest.approx(highest, abs=1e-12)


def test_uniform_chain():
    """Eq. (21) for kappa = 1; N = 3 has 18 and 54 degrees, not 90."""
    for movable in (2, 7, 300):
        angle = np.pi / 2 * (2 * np.arange(1, movable + 1) - 1) / (2 * movable + 1)
        assert modes.eigenmodes(springs(np.ones(movable))).frequency == pytest.approx(
            2 * np.sin(angle), rel=1e-14
        )


def test_column_of_infinite_exponent():
    """For kappa_n = n the squared frequencies are the zeros of the Laguerre polynomial L_M."""
    result = modes.eigenmodes(springs(np.arange(1.0, 101)))
    zeros, _ = roots_laguerre(100)
    assert result.frequency**2 == pytest.approx(zeros, rel=1e-13)
    low = result.shape[:, :20] / result.shape[0, :20]
    assert low == pytest.approx(eval_laguerre(np.arange(100)[:, None], zeros[:20]), abs=1e-11)


@pytest.mark.parametrize("delta", [1.0, 1.2, 1.5, 2.0, 3.0])
def test_quasi_normal_modes_of_the_continuum(delta: float):
    """Frequencies from the zeros of J_(-nu), with depth N - 1/2, accurate to some 0.1 (k/M)^2."""
    nu = 1 / (1 + delta)
    eta = 1 + 1 / delta
    k = np.arange(1, 400)
    zeros = modes.quasi_normal(k, 100, delta) * 2 / eta * 99.5 ** (eta / 2)
    with mp.workdps(20):
        miss = [
            mp.besselj(-nu, mp.mpf(z)) * mp.sqrt(mp.pi * z / 2) for z in zeros[[0, 1, 2, 50, 398]]
        ]
    assert max(map(abs, miss)) < 5e-13
    assert np.all(abs(np.diff(zeros) - np.pi) < 0.05)  # No zero is missing.
    assert zeros[0] < np.pi
    errors = [
        modes.quasi_normal(1, movable + 1, delta) / column_modes(movable, delta).frequency[0] - 1
        for movable in (100, 300)
    ]
    assert 1.1e-6 < errors[1] < 1.5e-6
    assert np.log(errors[0] / errors[1]) / np.log(3) == pytest.approx(2, abs=0.06)


def test_zeros_published():
    found = modes.quasi_normal([1, 2, 3, 4], 2) / (5 / 6 * 1.5 ** (-5 / 6))
    assert found == pytest.approx(
        [1.7509753662, 4.8785160495, 8.0166321837, 11.1566713204], abs=1e-10
    )


@pytest.mark.parametrize(("movable", "error"), [(100, 1.9e-4), (1000, 8.5e-6)])
def test_band_edge(movable: int, error: float):
    exact = column_modes(movable).frequency[-1]
    assert modes.band_edge(movable + 1) / exact - 1 == pytest.approx(error, rel=0.02)


def test_participation_numbers():
    """The number of participating grains in modes 1, 500, 900 and 1000 of 1000.

    Source: an independent code, five digits.
    """
    square = column_modes(1000).shape[:, [0, 499, 899, 999]] ** 2
    assert (square**2).sum(0) ** -1 == pytest.approx([620.99, 482.86, 224.75, 21.64], abs=0.006)


def test_wkb_counts_the_modes():
    """WKB counts k - 1/4 - nu/2 at frequency k for modes at the top, otherwise k - 1/4."""
    k = np.arange(1, 1001)
    excess = modes.count(column_modes(1000).frequency, 1001) - k
    assert excess[5:40] == pytest.approx(-0.45, abs=1e-3)
    assert excess[500:990] == pytest.approx(-0.25, abs=3e-3)
    uniform = modes.eigenmodes(springs(np.ones(50))).frequency
    assert modes.count(uniform, 51, 1.0) - k[:50] == pytest.approx(-0.5, abs=1e-12)


@pytest.mark.parametrize("delta", thinned([1.001, 5 / 3, 1.5, 3.0, 8.0], 2))
def test_wkb_integral_by_quadrature(delta: float):
    xi = 1 - 1 / mp.mpf(delta)
    depth = mp.mpf(30.5)
    for frequency in (1e-3, 2.0, 2.4, 50.0):
        top = min(depth, (mp.mpf(frequency) / 2) ** (2 / xi))  # Above this depth every mode counts.
        low = max(mp.log(top), mp.mpf(-60))
        rest = mp.quad(
            lambda x, top=top, xi=xi: (
                2 / mp.pi * mp.asin(min(1, (top / mp.exp(x)) ** (xi / 2))) * mp.exp(x)
            ),
            mp.linspace(low, mp.log(depth), 8),
        )
        exact = top + (rest if top < depth else 0)
        assert modes.count(frequency, 31, delta) == pytest.approx(float(exact), rel=1e-12)


def test_count_at_the_ends():
    assert modes.count([0.0, 1e3], 31).tolist() == [0.0, pytest.approx(30.5, rel=1e-15)]


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: modes.eigenmodes(Chain(grains=5, diameter=1e-3, gravity=0.0)), "chain"),
        (lambda: modes.quasi_normal(0, 10), "k"),
        (lambda: modes.quasi_normal(1.5, 10), "k"),
        (lambda: modes.quasi_normal(1, 1), "grains"),
        (lambda: modes.quasi_normal(1, 10, 0.5), "delta"),
        (lambda: modes.band_edge(10, 1.0), "delta"),
        (lambda: modes.count(-1.0, 10), "frequency"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: "):
        call()
