"""The linear propagator against matrix exponentials, Bessel functions and polynomial sums."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import jv

from lmpchain.integrators.kernels import chebyshev
from lmpchain.integrators.kernels.chebyshev import Propagator

GRAINS = 9
RNG = np.random.default_rng(6)
STIFFNESS = RNG.uniform(0.5, 2, GRAINS + 1)
MOBILITY = RNG.uniform(0.5, 2, GRAINS)


def generator(stiffness: np.ndarray, mobility: np.ndarray, drive: float) -> np.ndarray:
    """Return the matrix of d/dt (u, v)."""
    n = mobility.size
    pull = (
        np.diag(stiffness[:-1] + stiffness[1:])
        - np.diag(stiffness[1:-1], 1)
        - np.diag(stiffness[1:-1], -1)
    )
    pull = mobility[:, None] * pull
    pull[0, 0] += drive**2
    return np.block([[np.zeros((n, n)), np.eye(n)], [-pull, np.zeros((n, n))]])


def exactly(slope: np.ndarray, u: np.ndarray, v: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return exact displacements and velocities at times, (2, T, N)."""
    start = np.concatenate((u, v))
    return np.array([np.split(expm(slope * t) @ start, 2) for t in times]).swapaxes(0, 1)


ENDS = {
    "between walls": (STIFFNESS, MOBILITY, 0.0),
    "free above, held below": (np.append(0, STIFFNESS[1:]), np.append(MOBILITY[:-1], 0), 0.0),
    "driven": (STIFFNESS, np.append(0, MOBILITY[1:]), 1.3),
}


@pytest.mark.parametrize("ends", ENDS)
@pytest.mark.parametrize("start", ["displaced", "struck", "both"])
def test_a_chain_moves_as_by_the_exponential_of_its_matrix(ends: str, start: str):
    """Some times need one series, others several; the second call continues the first."""
    stiffness, mobility, drive = ENDS[ends]
    moving = (mobility > 0) | (drive > 0) * (np.arange(GRAINS) == 0)
    u = RNG.normal(size=GRAINS) * moving * (start != "struck")
    v = RNG.normal(size=GRAINS) * moving * (start != "displaced")
    first = np.array([0.0, 0.3, 1.1, 2.9, 4.0, 11.0, 11.5])
    then = np.array([0.4, 30.0])
    true = exactly(generator(stiffness, mobility, drive), u, v, np.append(first, 11.5 + then))
    chain = Propagator(stiffness, mobility, drive, u.copy(), v.copy())
    parts = [chain.advance(first), chain.advance(then)]
    for order in (0, 1):
        field = np.concatenate([part[order] for part in parts])
        # Rounding of the matrix exponential.
        assert np.abs(field - true[order]).max() < 2e-13 * np.abs(true[order]).max()
    assert np.array_equal(chain.u, parts[1][0][-1])
    assert np.array_equal(chain.v, parts[1][1][-1])
    assert (parts[1][2] == [0, GRAINS - (mobility[-1] == 0)]).all() or (
        parts[1][2] == [0, GRAINS]
    ).all()


def test_a_pulse_stays_within_its_light_cone():
    """Grains outside the light cone are exactly at rest, and all others are reported."""
    n = 400
    place = 150
    u, v = np.zeros((2, n))
    v[place] = 1.0
    stiffness = np.ones(n + 1)
    mobility = np.ones(n)
    chain = Propagator(stiffness, mobility, 0.0, u, v)
    times = np.array([0.0, 0.01, 5.0, 20.0])
    us, vs, reached = chain.advance(times)
    # In an infinite chain, the integral of J_2n(2t) is the sum of J_(2n+1)(2t), J_(2n+3)(2t) ...
    table = jv(np.arange(2 * n + 100)[:, None], 2 * times)
    apart = np.abs(np.arange(n) - place)
    integral = np.array([table[2 * k + 1 : 2 * k + 99 : 2].sum(0) for k in range(n)])
    true = np.array([integral[apart].T, table[2 * apart].T])
    # Each value sums 40 products whose magnitudes add up to 1.9; the linear algebra library chooses
    # the order of summation, which changes the sum by at most 40 * 1.1e-16 * 1.9.
    rounding = 8e-15
    assert np.abs(us - true[0]).max() < rounding
    assert np.abs(vs - true[1]).max() < rounding
    for i, (first, last) in enumerate(reached):
        assert not us[i, :first].any()
        assert not us[i, last:].any()
        assert not vs[i, :first].any()
        assert not vs[i, last:].any()
        front = np.flatnonzero(np.abs(true[:, i]).max(0) > 1e-15)
        assert first <= front[0] <= place <= front[-1] < last
        assert last - first < 2 * times[i] + 80
    mirrored = us[-1, 2 * place - np.arange(n)]
    assert np.abs(us[-1] - mirrored).max() < rounding


@pytest.mark.parametrize("flip", [1, -1])
def test_a_wave_that_reaches_stiffer_contacts_is_exact(rng: np.random.Generator, flip: int):
    """The motion agrees with a sum of eigenmodes; the wave leaves a soft part of the chain."""
    n = 150
    stiffness = rng.uniform(0.5, 1.0, n + 1)
    stiffness[90:] *= 40
    mobility = rng.uniform(0.5, 1.0, n)
    u, v = np.zeros((2, n))
    u[80:82] = 0.3, -0.2
    v[81] = 1.0
    stiffness, mobility, u, v = (row[::flip].copy() for row in (stiffness, mobility, u, v))
    root = np.sqrt(mobility)
    pull = -generator(stiffness, np.ones(n), 0.0)[n:, :n]
    squares, shapes = np.linalg.eigh(root[:, None] * pull * root)
    omega = np.sqrt(squares)
    times = np.array([0.0, 0.4, 1.0, 1.5, 6.0, 6.5, 20.0])
    cosine, sine = np.cos(omega * times[:, None]), np.sin(omega * times[:, None])
    of_u, of_v = (shapes.T @ (row / root) for row in (u, v))
    true = [
        (rows @ shapes.T) * root
        for rows in (cosine * of_u + sine * of_v / omega, cosine * of_v - sine * omega * of_u)
    ]
    chain = Propagator(stiffness, mobility, 0.0, u.copy(), v.copy())
    parts = [chain.advance(piece) for piece in (times[:4], times[4:] - times[3])]
    for order in (0, 1):
        field = np.concatenate([part[order] for part in parts])
        assert np.abs(field - true[order]).max() < 2e-13 * np.abs(true[order]).max()
    assert 0 < parts[0].reached[-1, 0] < parts[0].reached[-1, 1] < n


def test_the_number_of_terms_depends_on_the_times():
    """Six radians of w = 2 sqrt(2) need one series of about 18 terms; 18 radians need three."""
    chains = [
        Propagator(np.ones(31), np.ones(30), 0.0, np.zeros(30), np.eye(30)[15]) for _ in range(3)
    ]
    chains[0].advance(np.array([3.0]))
    chains[1].advance(np.linspace(1e-3, 3.0, 50))
    chains[2].advance(np.array([3.0, 6.0, 9.0]))
    assert chains[0].terms == chains[1].terms
    z = np.sqrt(2 * 2) * 3.0
    needed = int(np.flatnonzero(np.abs(jv(np.arange(100), z)) > 1e-18)[-1]) // 2
    assert needed <= chains[0].terms <= needed + 2
    assert chains[2].terms == 3 * chains[0].terms


@pytest.mark.parametrize("size", [0.0, 1e-25, 1e-9, 0.3, 2.0, 17.0, 90.0])
def test_bessel_functions_agree_with_scipy(size: float):
    z = np.array([0.0, 0.5, 1.0]) * size
    orders = 2 * int(chebyshev.terms(size)) + 2
    table = chebyshev.bessel(z, orders)
    true = jv(np.arange(orders)[:, None], z)
    assert table.shape == (orders, 3)
    assert np.abs(table - true).max() < 3e-15
    tail = np.abs(true) > 1e-200
    assert table[:10][tail[:10]] == pytest.approx(true[:10][tail[:10]], rel=1e-10, abs=1e-16)


@pytest.mark.parametrize("z", [0.1, 3.0, 10.0, 60.0, 500.0])
def test_truncated_terms_are_below_rounding_and_few_are_superfluous(z: float):
    count = int(chebyshev.terms(z))
    with mpmath.workdps(30):
        beyond = [abs(float(mpmath.besselj(k, z))) for k in range(2 * count + 2, 2 * count + 30)]
        before = abs(float(mpmath.besselj(2 * count - 14 - int(z**0.5), z)))
    assert sum(beyond) < 1e-16
    assert before > 1e-20 or z < 1


@pytest.mark.parametrize("orders", [1, 5, 64, 65, 150])
@pytest.mark.parametrize("oscillator", [0.0, 0.7])
def test_series_are_sums_of_chebyshev_polynomials(orders: int, oscillator: float):
    scale = 1.02 * np.sqrt((2 * (STIFFNESS[:-1] + STIFFNESS[1:]) * MOBILITY).max())
    x = np.zeros(GRAINS)
    of_t = RNG.normal(size=(2, orders))
    of_w = RNG.normal(size=(3, orders))
    x[3:5] = 1.0, -0.4
    chain = chebyshev.LinearChain(STIFFNESS, MOBILITY, oscillator)
    sums = chebyshev.series(x, chain, scale, of_t, of_w, (3, 5))
    stiffness = -generator(STIFFNESS, MOBILITY, np.sqrt(oscillator))[GRAINS:, :GRAINS]
    argument = np.eye(GRAINS) - 2 / scale**2 * stiffness
    before = None
    now = x
    total = x
    expected = [np.outer(of_t[:, 0], x), np.outer(of_w[:, 0], x)]
    for k in range(1, orders):
        before, now = now, argument @ now if k == 1 else 2 * argument @ now - before
        total = total + 2 * now
        expected[0] += np.outer(of_t[:, k], 2 * now)
        expected[1] += np.outer(of_w[:, k], total)
    for field, true in zip(sums, expected, strict=True):
        assert np.abs(field - true).max() < 1e-12 * np.abs(true).max()


def test_grains_with_negligible_motion_are_set_to_rest():
    u, v = np.zeros((2, 8))
    u[2] = 1.0
    u[4] = 0.5
    v[3] = 2.0
    v[5] = 3e-25
    u[6] = 0.9e-25
    v[6] = 1.8e-25
    v[1] = 1.9e-25
    # The value v[5] is above 1e-25 of the largest speed, 2.
    assert chebyshev.moving(u, v) == (2, 6)
    assert u.tolist() == [0, 0, 1.0, 0, 0.5, 0, 0, 0]
    assert v.tolist() == [0, 0, 0, 2.0, 0, 3e-25, 0, 0]
    assert tuple(chebyshev.moving(np.zeros(3), np.zeros(3))) in ((3, 3), (0, 0))
