"""Eqs. (22) and (23): Dyson's distribution against mpmath, its moments, and the sum over the column."""

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

from lmpchain import InputError
from lmpchain.theory import bessel, dyson

ORDERS = (0.3, 1, 2.5, 19.999, 20, 143, 144, 1e4)


@pytest.mark.parametrize("m", ORDERS)
@pytest.mark.parametrize(("function", "power"), [(dyson.weight, 0), (dyson.density, 1)])
def test_distribution_by_mpmath(function, power: int, m: float):
    kappa = 1 + np.array([-0.999, -0.5, -1e-3, 0.0, 1e-2, 0.1, 1.0, 3.0])
    with mp.workdps(30):
        exact = [
            mp.mpf(m) ** m / mp.gamma(m) * mp.mpf(k) ** (mp.mpf(m) - power) * mp.exp(-m * mp.mpf(k)) for k in kappa
        ]
    exact = np.array(exact, dtype=float)
    tolerance = 1e-14 + 4e-16 * m * abs(kappa - 1)  # of m log(kappa), which cancels against m (kappa - 1)
    assert np.all(abs(function(kappa, m) - exact) <= tolerance * exact)


def test_at_no_force_constant():
    assert dyson.weight(0.0, [0.5, 1, 7]).tolist() == [0, 0, 0]
    assert dyson.density(0.0, [0.5, 1, 7]).tolist() == [np.inf, pytest.approx(1, rel=1e-14), 0]


@pytest.mark.parametrize("m", [1, 2, 10, 50])
@pytest.mark.parametrize(
    ("function", "mean", "variance"),
    [(dyson.weight, lambda m: 1 + 1 / m, lambda m: (m + 1) / m**2), (dyson.density, lambda m: 1, lambda m: 1 / m)],
)
def test_moments(function, mean, variance, m: int):
    moments = [
        quad(lambda k, p=p: k**p * function(k, m), 0, 60, epsabs=1e-13, points=[1], limit=200)[0] for p in range(3)
    ]
    assert moments[0] == pytest.approx(1, abs=1e-11)
    assert moments[1] == pytest.approx(mean(m), abs=1e-11)
    assert moments[2] - moments[1] ** 2 == pytest.approx(variance(m), abs=1e-10)


@pytest.mark.parametrize("m", [1, 2, 10])
def test_printed_form_leaves_the_compliance_alone(m: int):
    """The mean of 1/kappa is exactly 1 for every m, so disorder does not change the speed of long waves."""
    assert quad(lambda k: dyson.weight(k, m) / k, 0, 60, points=[1])[0] == pytest.approx(1, abs=1e-11)


@pytest.fixture(scope="module")
def column() -> tuple[np.ndarray, np.ndarray]:
    """kappa_n and the velocities at tau = 15 of 60 grains under gravity, the top one struck."""
    kappa = np.arange(1, 61) ** (1 / 3)
    return kappa, np.append(bessel.finite(kappa[:-1], np.arange(1, 60), 1, 15.0), 0.0)


def test_sum_as_printed(column):
    """Source: the same sum by an independent code, four digits."""
    kappa, velocity = column
    published = {1: 0.1523, 3: 0.0258, 5: -0.0241, 100: -0.0380, 1e4: -0.3604}
    found = dyson.average(velocity, kappa, list(published))
    assert found == pytest.approx(list(published.values()), abs=5e-5)
    sums = dyson.average(np.ones(60), kappa, [1, 20, 1e4])
    assert sums == pytest.approx([9.78, 3.40, 39.9], rel=2e-3)


def test_sum_for_large_m(column):
    """It diverges as sqrt(m / 2 pi) times the velocity of grain 1, where kappa = 1; normalised it is that velocity."""
    kappa, velocity = column
    m = 1e4
    assert dyson.average(velocity, kappa, m) == pytest.approx(np.sqrt(m / 2 / np.pi) * velocity[0], rel=1e-5)
    assert dyson.average(velocity, kappa, m, normalised=True) == pytest.approx(velocity[0], rel=1e-12)
    assert velocity[0] == pytest.approx(-0.009035, abs=5e-7)


def test_sum_broadcasts(column):
    kappa, velocity = column
    times = np.stack([velocity, 2 * velocity])
    table = dyson.average(times, kappa, np.array([[1], [2], [5]]))
    assert table.shape == (3, 2)
    assert table[2, 1] == pytest.approx(2 * dyson.average(velocity, kappa, 5), rel=1e-14)
    by_hand = sum(m**m * k**m * np.exp(-m * k) * v for m, k, v in zip([1] * 60, kappa, velocity, strict=True))
    assert table[0, 0] == pytest.approx(by_hand, rel=1e-13)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: dyson.weight(-1.0, 1), "kappa"),
        (lambda: dyson.density(np.nan, 1), "kappa"),
        (lambda: dyson.density(1.0, 0), "m"),
        (lambda: dyson.weight(1.0, np.inf), "m"),
        (lambda: dyson.average([1.0, 2.0], [1.0], 1), "kappa"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: must"):
        call()
