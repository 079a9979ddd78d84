"""The front after a strike on the top grain: exponents, amplitude and shape, against the chain."""

from functools import cache

import numpy as np
import pytest
from helpers.independent_theory import gravity_column, largest
from scipy.integrate import quad
from scipy.special import airy, gamma

from lmpchain import InputError
from lmpchain.theory import bessel, continuum, front


@cache
def peak(n: int, delta: float = 1.5) -> float:
    """Return the largest velocity of grain n in the chain."""
    expected = float(front.peak_time(n, delta))
    kappa = gravity_column(int(continuum.depth(expected + 15, delta)) + 50, delta)
    return largest(lambda tau: bessel.finite(kappa, n, 1, tau), expected - 0.8, expected + 0.5)


@pytest.mark.parametrize(
    ("delta", "p", "q"),
    [(1.0, 1 / 3, 0), (1.5, 4 / 15, 1 / 10), (2.0, 2 / 9, 5 / 36), (5.0, 0.2, 0.2)],
)
def test_exponents(delta: float, p: float, q: float):
    assert front.decay(delta) == pytest.approx((p, q), abs=1e-15)


def test_exponents_are_continuous_at_three():
    assert front.decay(3 - 1e-9) == pytest.approx(front.decay(3.0), abs=1e-9)


@pytest.mark.parametrize(
    ("n", "slope"),
    [(100, -0.2381), (500, -0.2504), (2000, -0.2569)],
)
def test_local_exponents_of_the_chain_published(n: int, slope: float):
    """The exponents approach -4/15 slowly and pass -1/4 near n = 500.

    Source: an independent code, four digits.
    """
    low = round(n / 1.05)
    high = round(n * 1.05)
    assert np.log(peak(high) / peak(low)) / np.log(high / low) == pytest.approx(slope, abs=3e-4)


@pytest.mark.parametrize(("delta", "coefficient"), [(1.0, 1.071313), (1.5, 0.931768)])
def test_absolute_peak_velocity(delta: float, coefficient: float):
    """The ratio of chain and limit, extrapolated in n^(-1/3), is 1."""
    n = np.array([250, 500, 1000, 2000])
    p, _ = front.decay(delta)
    assert front.peak_velocity(10**9, delta) * 1e9**p == pytest.approx(coefficient, rel=1e-6)
    ratio = [peak(int(i), delta) for i in n] / front.peak_velocity(n, delta)
    assert np.polyfit(n ** (-1 / 3), ratio, 3)[-1] == pytest.approx(1, abs=1e-3)


def test_peak_of_the_airy_function_published():
    """A_max = 0.495579 for Hertz; for delta = 1 it is the maximum of Ai, at 1.018793."""
    n = 10**6
    a = 0.1
    chi = continuum.chi(n - 0.5)
    width = ((n - 0.5) ** 0.5 / 4) ** (1 / 3)
    height = continuum.impulse_amplitude() * (2 * chi) ** -a * gamma(1 - a) * width ** (-1 - a)
    assert front.peak_velocity(n) / height == pytest.approx(0.495579, abs=5e-7)
    assert (front.peak_time(n, 1.0) - (n - 0.5)) / ((n - 0.5) / 8) ** (1 / 3) == pytest.approx(
        1.01879297, abs=1e-7
    )


@pytest.mark.parametrize("delta", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("s", [-3.0, 0.9, 5.0, 25.0])
def test_profiles_by_quadrature(delta: float, s: float):
    """The integrands are y^(-a) Ai(y - s) and its derivative."""
    xi = 1 - 1 / delta
    eta = 1 + 1 / delta
    n = 1000
    a = xi / (2 * eta)
    power = 1 - 1.5 * xi
    h = n - 0.5
    width = (h**power / (8 * power)) ** (1 / 3)
    chi = float(continuum.chi(h, delta))
    scale = continuum.impulse_amplitude(delta) * (2 * chi * width) ** -a
    integrals = [
        quad(
            lambda y, k=k: airy(y - s)[k],
            0,
            max(s, 0) + 18,
            weight="alg",
            wvar=(-a, 0),
            epsabs=1e-12,
            limit=500,
        )[0]
        for k in (0, 1)
    ]
    tau = chi + s * width
    assert front.displacement(n, tau, delta) / scale == pytest.approx(integrals[0], abs=2e-11)
    assert front.velocity(n, tau, delta) / scale * width == pytest.approx(-integrals[1], abs=2e-10)


def test_shape_of_the_front_in_the_chain():
    """The limit converges by 2^(-1/3) or faster per doubling of n, and is 2 % off at n = 4000."""
    misses = []
    for n in (500, 4000):
        width = ((n - 0.5) ** 0.5 / 4) ** (1 / 3)
        tau = continuum.chi(n - 0.5) + np.linspace(-3, 3, 31) * width
        kappa = gravity_column(int(continuum.depth(tau[-1] + 15)) + 50)
        exact = bessel.finite_impulse(kappa, n, 1, tau)
        misses.append(np.abs(exact - front.displacement(n, tau)).max() / exact.max())
    assert misses[1] < 0.02
    assert misses[0] / misses[1] > 2


def test_shapes_follow_the_arguments():
    n = np.array([990, 1000])
    tau = np.array([[377.0], [380.0], [381.0]])
    for call in (front.displacement, front.velocity):
        together = call(n, tau)
        assert together.shape == (3, 2)
        assert together == pytest.approx(
            np.array([[call(int(i), float(t)) for i in n] for t in tau[:, 0]]), abs=1e-9
        )
    assert front.peak_velocity([10, 20]).shape == (2,)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: front.decay(0.9), "delta"),
        (lambda: front.velocity(0, 1.0), "n"),
        (lambda: front.displacement(10, 50.0), "tau"),
        (lambda: front.peak_time(1.5), "n"),
        (lambda: front.peak_velocity(10, 3.0), "delta"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: must"):
        call()
