"""Eqs. (5)-(8), (11), (13) and (19)-(21) against independent computations.

The comparisons are with an integrator, mpmath, image sources, and published numbers.
"""

import mpmath as mp
import numpy as np
import pytest
from helpers.independent_theory import gravity_column, integrate, largest, springs, unit
from scipy.special import jv

from lmpchain import InputError
from lmpchain.theory import bessel, continuum, modes

RNG = np.random.default_rng(5)


def besselj(order: int, z: float) -> float:
    with mp.workdps(30):
        return float(mp.besselj(order, mp.mpf(float(z)), maxprec=20000))


# ----------------------------------------------------------------------------------------------
# uniform chains


def test_general_initial_data_against_an_integrator():
    """Eq. (5) with velocities dphi/dT, and Eq. (6), its case of one displaced grain."""
    T = np.array([0.0, 0.3, 2.0, 9.0])
    p = np.array([55, 48, 49, 60])
    displacement, velocity = RNG.normal(size=(2, 4))
    start = np.zeros((2, 99))
    start[:, p - 1] = displacement, velocity
    exact, _ = integrate(np.ones(99), *start, T)
    found = bessel.infinite_general(np.arange(1, 100), T[:, None], p, displacement, velocity)
    assert found == pytest.approx(exact, abs=1e-12)
    one = bessel.infinite_general(np.arange(1, 100), T[:, None], [50], [1.0])
    assert bessel.infinite(np.arange(1, 100), 50, T[:, None]) == pytest.approx(one, abs=1e-14)


def test_general_initial_data_may_repeat_grains_and_reach_below_zero():
    found = bessel.infinite_general([[-3], [4]], [0.5, 2.0, 0.5], [-2, 1, -2], [1.0, 2.0, 3.0])
    expected = 4 * bessel.infinite([[-3], [4]], -2, [0.5, 2.0, 0.5]) + 2 * bessel.infinite(
        [[-3], [4]], 1, [0.5, 2.0, 0.5]
    )
    assert found == pytest.approx(expected, abs=1e-15)


def test_main_maximum_passes_later_than_2t_equals_2n():
    T = np.linspace(50, 54, 40001)
    passed = 2 * T[bessel.infinite(50, 0, T).argmax()]
    assert passed == pytest.approx(103.77, abs=0.01)
    assert passed == pytest.approx(100 + 0.8086 * 100 ** (1 / 3), abs=0.02)


@pytest.mark.parametrize(
    ("n", "T"), [(1, 0.4), (3, 7.0), (50, 10.0), (200, 3.0), (300, 310.0), (1000, 900.0)]
)
def test_free_end_by_the_other_closed_form(n: int, T: float):
    """Eq. (11) equals (2n-1)/T J_(2n-1)(2T), with relative accuracy far ahead of the front."""
    exact = (2 * n - 1) / T * besselj(2 * n - 1, 2 * T)
    assert bessel.free_end(n, T) == pytest.approx(exact, rel=1e-12, abs=0 if n / 2 > T else 1e-13)


@pytest.mark.parametrize(("n", "T"), [(1, 0.4), (3, 7.0), (20, 25.0), (200, 3.0)])
def test_free_end_impulse_by_quadrature(n: int, T: float):
    """Even tiny values of Eq. (13) agree with quadrature, whose integrand is scaled to 1."""
    with mp.workdps(25):
        last = mp.besselj(2 * n - 1, 2 * T) if n > T else mp.mpf(1)
        places = mp.linspace(0, T, 3 + int(T / 2))
        exact = last * mp.quad(
            lambda t: (2 * n - 1) / t * mp.besselj(2 * n - 1, 2 * t) / last, places
        )
    assert bessel.free_end_impulse(n, T) == pytest.approx(float(exact), rel=1e-13)
    assert bessel.free_end_impulse(n, -T) == -bessel.free_end_impulse(n, T)


def test_free_end_against_an_integrator():
    T = np.array([0.0, 0.7, 5.0, 20.0])
    n = np.arange(1, 61)
    static, _ = integrate(np.ones(60), unit(60, 1), 0.0, T)
    dynamic, _ = integrate(np.ones(60), 0.0, unit(60, 1), T)
    assert bessel.free_end(n, T[:, None]) == pytest.approx(static, abs=1e-13)
    assert bessel.free_end_impulse(n, T[:, None]) == pytest.approx(dynamic, abs=1e-12)


@pytest.mark.parametrize("delta", [1.0, 1.5, 3.0])
def test_local_and_far_field(delta: float):
    """The next term of the asymptotic series of Eqs. (7) and (8) is (16 n^2 - 1) / (8 x)."""
    for n in (1, 2, 5):
        root = n ** ((1 - 1 / delta) / 2)
        assert bessel.local(n, 7.3, delta) == pytest.approx(
            besselj(2 * n, 2 * root * 7.3), abs=1e-14
        )
        tau = 1600.0 + np.linspace(0, 4, 200)
        miss = np.abs(bessel.local(n, tau, delta) - bessel.far_field(n, tau, delta)).max()
        envelope = 1 / np.sqrt(np.pi * root * 1600)
        assert miss / envelope == pytest.approx((16 * n**2 - 1) / (8 * 2 * root * 1600), rel=0.01)
    assert bessel.local(0, 5.0, 1.5) == 1


# --------------------------------------------------------------------------------- any chain: Eqs.
# (19) to (21)


@pytest.mark.parametrize("grains", [2, 3, 10, 50])
@pytest.mark.parametrize("delta", [1.0, 1.5, 3.0])
def test_coefficients_by_eigenvectors(grains: int, delta: float):
    """Eqs. (20) and (21) with the paper's kappa_N and the brace on j."""
    kappa = gravity_column(grains - 1, delta)
    top = grains ** (1 - 1 / delta)
    matrix = (
        np.diag(kappa + np.append(0, kappa[:-1])) - np.diag(kappa[:-1], 1) - np.diag(kappa[:-1], -1)
    )
    square, X = np.linalg.eigh(matrix)
    phase = np.arcsin(np.sqrt(square) / 2 / np.sqrt(top))
    n = np.arange(1, grains)
    k = (grains + 1) // 2
    j = np.arange(1, 81)
    brace = np.where(j == 1, 1, 2 * np.cos((2 * j - 2) * phase[:, None]))
    found = bessel.coefficients(kappa, n, k, 80, scale=top)
    assert found == pytest.approx((X * X[k - 1]) @ brace, abs=2e-12)


def test_coefficients_of_high_order_are_accurate():
    kappa = gravity_column(30)
    A = bessel.coefficients(kappa, [1, 30], 1, 8000)
    square, X = np.linalg.eigh(
        np.diag(kappa + np.append(0, kappa[:-1])) - np.diag(kappa[:-1], 1) - np.diag(kappa[:-1], -1)
    )
    angle = np.arccos(1 - square / 2 / kappa[-1])
    exact = 2 * np.cos(7999 * angle) * X[0] @ X[[0, 29]].T
    assert np.abs(A).max() <= 2
    assert A[:, -1] == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("scale", [None, 7.0])
def test_series_is_the_sum_of_its_coefficients(scale: float | None):
    kappa = RNG.uniform(0.5, 2, 12)
    A = bessel.coefficients(kappa, 5, 2, 60, scale)
    z = 2 * np.sqrt(scale or kappa.max()) * 4.0
    assert A @ jv(2 * np.arange(60), z) == pytest.approx(bessel.finite(kappa, 5, 2, 4.0), abs=1e-13)


CHAINS = {
    "two grains": np.ones(1),
    "three grains": gravity_column(2),
    "N = 10": gravity_column(9),
    "N = 50": gravity_column(49),
    "delta = 3": gravity_column(30, 3.0),
    "softening": 1 / gravity_column(30, 2.0),
    "disordered": RNG.gamma(2, 0.5, 40) + 0.05,
}


@pytest.mark.parametrize("kappa", CHAINS.values(), ids=CHAINS)
def test_series_against_an_integrator(kappa: np.ndarray):
    count = len(kappa)
    tau = np.array([0.0, 0.4, 3.0, 15.0])
    n = np.arange(1, count + 1)
    k = (count + 1) // 2
    static, _ = integrate(kappa, unit(count, k), 0.0, tau)
    dynamic, velocity = integrate(kappa, 0.0, unit(count, k), tau)
    assert bessel.finite(kappa, n, k, tau[:, None]) == pytest.approx(static, abs=1e-12)
    assert bessel.finite(kappa, n, k, tau[:, None]) == pytest.approx(velocity, abs=1e-12)
    assert bessel.finite_impulse(kappa, n, k, tau[:, None]) == pytest.approx(dynamic, abs=1e-12)


def test_series_against_modes_over_a_long_time():
    chain = springs(gravity_column(120))
    velocity = unit(120, 1)
    n = np.arange(1, 121)
    u, v = modes.eigenmodes(chain).response([1000.0], velocity=velocity)
    assert bessel.finite_impulse(chain.linear_stiffness, n, 1, 1000.0) == pytest.approx(
        u[0], abs=1e-11
    )
    assert bessel.finite(chain.linear_stiffness, n, 1, 1000.0) == pytest.approx(v[0], abs=1e-11)


def test_the_series_has_relative_accuracy_ahead_of_the_front():
    assert bessel.finite(np.ones(99), 60, 1, 2.0) == pytest.approx(
        119 / 2 * besselj(119, 4.0), rel=1e-12
    )


@pytest.mark.parametrize(
    ("n", "peak"), [(100, 0.251742), (500, 0.169778), (1000, 0.142535), (4000, 0.099840)]
)
def test_peak_velocity_published(n: int, peak: float):
    """The source is an independent code for the column struck at grain 1, with six digits."""
    h = n - 0.5
    expected = 1.2 * h ** (5 / 6) + 0.908 * (h**0.5 / 4) ** (1 / 3)
    kappa = gravity_column(int(continuum.depth(expected + 20)) + 50)
    found = largest(lambda tau: bessel.finite(kappa, n, 1, tau), expected - 0.8, expected + 0.5)
    assert found == pytest.approx(peak, abs=1e-6)


def test_long_time_laws_of_the_top_grain():
    """The dynamic law is C tau^(-1/5), the static one -(C/5) tau^(-6/5).

    (8).
    """
    kappa = gravity_column(2600)
    tau = np.array([50.0, 200.0, 1600.0])
    law = continuum.impulse_amplitude() * tau**-0.2
    assert bessel.finite_impulse(kappa, 1, 1, tau) / law == pytest.approx([1.00002, 1, 1], abs=5e-6)
    static = bessel.finite(kappa, 1, 1, 1600.0)
    assert static == pytest.approx(-3.30156e-5, rel=2e-6)
    assert static == pytest.approx(-law[-1] / 5 / 1600, rel=1e-6)


# ------------------------------------------------------------------------------------------------
# the whole module


def test_tables_of_bessel_functions():
    """J_(2k) and sums of odd orders for arguments from 0 to large ones, and all orders."""
    z = np.array([0.0, 1e-5, 0.5, 3.0, -30.0, 77.7, 1000.3])
    even, integral, column = bessel.table("z", z, 700)
    for i, x in enumerate(z):
        for k in (0, 1, 2, 10, 40, 300, 699):
            exact = besselj(2 * k, x)
            tolerance = 1e-13 * abs(exact) if abs(x) < k else 4e-16
            assert even[k, column[i]] == pytest.approx(exact, abs=max(tolerance, 1e-270))
    # Without a count, a table ends where the largest argument has its last values above 0.
    whole, *_ = bessel.table("z", z)
    assert whole[:700].tolist() == even.tolist()
    assert 0 < np.abs(whole[-1]).max() < 1e-250
    with mp.workdps(30):
        for k, x in ((0, 0.5), (0, 77.7), (10, 3.0), (40, 77.7)):
            exact = sum(mp.besselj(2 * k + 2 * j + 1, x) for j in range(80))
            assert integral[k, column[z == x][0]] == pytest.approx(
                float(exact), rel=1e-13, abs=4e-16
            )


def test_shapes_follow_the_arguments():
    n = np.arange(1, 4)
    T = np.linspace(0, 2, 5)[:, None]
    for call in (
        lambda n, T: bessel.infinite(n, 2, T),
        lambda n, T: bessel.infinite_general(n, T, [1, 2], [1.0, 0.5], 2.0),
        bessel.free_end,
        bessel.free_end_impulse,
        bessel.local,
        lambda n, T: bessel.far_field(n, T + 1),
        lambda n, T: bessel.finite([1.0, 2.0, 3.0], n, 1, T),
        lambda n, T: bessel.finite_impulse([1.0, 2.0, 3.0], n, 1, T),
    ):
        together = call(n, T)
        assert together.shape == (5, 3)
        one_by_one = [[float(call(int(i), float(t))) for i in n] for t in T[:, 0]]
        assert together == pytest.approx(np.array(one_by_one), rel=1e-13, abs=1e-15)
    assert bessel.coefficients([1.0, 2.0], [[1], [2]], 1, 4).shape == (2, 1, 4)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: bessel.infinite(0.5, 0, 1.0), "n"),
        (lambda: bessel.infinite(0, np.nan, 1.0), "p"),
        (lambda: bessel.free_end(0, 1.0), "n"),
        (lambda: bessel.free_end_impulse(1, np.inf), "T"),
        (lambda: bessel.local(-1, 1.0), "n"),
        (lambda: bessel.local(1, 1.0, 0.9), "delta"),
        (lambda: bessel.far_field(1, 0.0), "tau"),
        (lambda: bessel.far_field(0, 1.0), "n"),
        (lambda: bessel.coefficients([1.0, -1.0], 1, 1, 3), "kappa"),
        (lambda: bessel.coefficients([1.0, 1.0], 3, 1, 3), "n"),
        (lambda: bessel.coefficients([1.0, 1.0], 1, 3, 3), "k"),
        (lambda: bessel.coefficients([1.0, 1.0], 1, 1, 0), "terms"),
        (lambda: bessel.coefficients([1.0, 1.0], 1, 1, 3, scale=0.9), "scale"),
        (lambda: bessel.finite([], 1, 1, 1.0), "kappa"),
        (lambda: bessel.finite([1.0], 1, 1, np.nan), "tau"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: must"):
        call()
