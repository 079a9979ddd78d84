"""Eqs. (22) and (23): Dyson's distribution against mpmath, and the sum over the column."""

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import polygamma

from lmpchain import InputError
from lmpchain.theory import bessel, dyson

ORDERS = (0.3, 1, 2.5, 19.999, 20, 143, 144, 1e4)


@pytest.mark.parametrize("m", ORDERS)
@pytest.mark.parametrize(("function", "power"), [(dyson.weight, 0), (dyson.density, 1)])
def test_distribution_by_mpmath(function, power: int, m: float):
    kappa = 1 + np.array([-0.999, -0.5, -1e-3, 0.0, 1e-2, 0.1, 1.0, 3.0])
    with mp.workdps(30):
        exact = [
            mp.mpf(m) ** m / mp.gamma(m) * mp.mpf(k) ** (mp.mpf(m) - power) * mp.exp(-m * mp.mpf(k))
            for k in kappa
        ]
    exact = np.array(exact, dtype=float)
    # Rounding of m log(kappa), which cancels against m (kappa - 1).
    tolerance = 1e-14 + 4e-16 * m * abs(kappa - 1)
    assert np.all(abs(function(kappa, m) - exact) <= tolerance * exact)


def test_at_force_constant_0():
    assert dyson.weight(0.0, [0.5, 1, 7]).tolist() == [0, 0, 0]
    assert dyson.density(0.0, [0.5, 1, 7]).tolist() == [np.inf, pytest.approx(1, rel=1e-14), 0]


@pytest.mark.parametrize("m", [1, 2, 10, 50])
@pytest.mark.parametrize(
    ("function", "mean", "variance"),
    [
        (dyson.weight, lambda m: 1 + 1 / m, lambda m: (m + 1) / m**2),
        (dyson.density, lambda m: 1, lambda m: 1 / m),
    ],
)
def test_moments(function, mean, variance, m: int):
    moments = [
        quad(lambda k, p=p: k**p * function(k, m), 0, 60, epsabs=1e-13, points=[1], limit=200)[0]
        for p in range(3)
    ]
    assert moments[0] == pytest.approx(1, abs=1e-11)
    assert moments[1] == pytest.approx(mean(m), abs=1e-11)
    assert moments[2] - moments[1] ** 2 == pytest.approx(variance(m), abs=1e-10)


@pytest.fixture(scope="module")
def summands() -> tuple[np.ndarray, np.ndarray]:
    """Return kappa_n and velocities at tau = 15 of 60 grains under gravity, struck at the top."""
    kappa = np.arange(1, 61) ** (1 / 3)
    return kappa, np.append(bessel.finite(kappa[:-1], np.arange(1, 60), 1, 15.0), 0.0)


def test_sum_as_printed(summands):
    """The source is the same sum by an independent code, with four digits."""
    kappa, velocity = summands
    published = {1: 0.1523, 3: 0.0258, 5: -0.0241, 100: -0.0380, 1e4: -0.3604}
    found = dyson.average(velocity, kappa, list(published))
    assert found == pytest.approx(list(published.values()), abs=5e-5)
    sums = dyson.average(np.ones(60), kappa, [1, 20, 1e4])
    assert sums == pytest.approx([9.78, 3.40, 39.9], rel=2e-3)


def test_sum_for_large_m(summands):
    """The sum diverges as sqrt(m / 2 pi); normalised it converges to the velocity of grain 1."""
    kappa, velocity = summands
    m = 1e4
    assert dyson.average(velocity, kappa, m) == pytest.approx(
        np.sqrt(m / 2 / np.pi) * velocity[0], rel=1e-5
    )
    assert dyson.average(velocity, kappa, m, normalised=True) == pytest.approx(
        velocity[0], rel=1e-12
    )
    assert velocity[0] == pytest.approx(-0.009035, abs=5e-7)


def test_sum_broadcasts(summands):
    kappa, velocity = summands
    times = np.stack([velocity, 2 * velocity])
    table = dyson.average(times, kappa, np.array([[1], [2], [5]]))
    assert table.shape == (3, 2)
    assert table[2, 1] == pytest.approx(2 * dyson.average(velocity, kappa, 5), rel=1e-14)
    by_hand = sum(
        m**m * k**m * np.exp(-m * k) * v for m, k, v in zip([1] * 60, kappa, velocity, strict=True)
    )
    assert table[0, 0] == pytest.approx(by_hand, rel=1e-13)


# ---------------------------------------------------------------------------------------- Dyson's
# exact spectrum


@pytest.mark.parametrize(
    ("shape", "rate", "frequency"),
    [(1, 1.0, 1.0), (0.3, 0.5, 0.7), (7.3, 7.3, 1.99)],
)
def test_spectrum_by_mpmath(shape: float, rate: float, frequency: float):
    """Tricomi's function and its derivative are integrated along a straight ray from 0."""
    with mp.workdps(16):
        x = mp.mpf(rate) * mp.mpf(frequency) ** 2
        ray = mp.expj(3 * mp.pi / 4)

        # The substitution t = ray y^(1/shape) removes the singularity at 0.
        def integrand(y: mp.mpf) -> mp.mpf:
            t = ray * y ** (1 / mp.mpf(shape))
            return mp.exp(x * t - shape * mp.log(1 + t))

        def with_logarithm(y: mp.mpf) -> mp.mpf:
            return integrand(y) * mp.log(1 + ray * y ** (1 / mp.mpf(shape)))

        places = [mp.mpf(s) ** shape for s in (0, 0.1, 0.5, 1, 2, 4, 10, 40 / x + 20)]
        ratio = mp.quad(with_logarithm, places) / mp.quad(integrand, places)
        exact = float(1 - 2 / mp.pi * ratio.imag)
    assert dyson.integrated(frequency, shape, rate) == pytest.approx(exact, abs=1e-13)
    if rate == 1:
        assert dyson.integrated(frequency, shape) == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("shape", [60, 100])
def test_spectrum_of_nearly_ordered_chains(shape: float):
    """Quadrature with many more nodes and a longer path beyond the saddle, at all frequencies."""
    w = np.sqrt(shape) * np.array([0.5, 1.5, 1.9, 2.5, 8.0])
    s, weight = np.polynomial.legendre.leggauss(40)
    s = ((2 * np.arange(50)[:, None] + 1 + s) / 50 - 1).ravel()
    weight = np.tile(weight / 50, 50)
    exact = []
    for x in w**2:
        saddle = -0.5 + 1j * np.sqrt(max(shape / x - 0.25, 0.04))
        t = saddle * (s + 1) / 2  # Up to the saddle, and beyond it.
        beyond = saddle + np.abs(saddle) * np.exp(0.75j * np.pi) * 3 * (s + 1) / 2
        path = np.concatenate((t, beyond))
        step = np.concatenate(
            (weight * saddle / 2, weight * np.abs(saddle) * np.exp(0.75j * np.pi) * 1.5)
        )
        log = x * path + shape * (np.log(path) - np.log1p(path))
        value = np.exp(log - log.real.max()) * step / path
        exact.append(1 - 2 / np.pi * ((value * np.log1p(path)).sum() / value.sum()).imag)
    assert dyson.integrated(w, shape) == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("shape", [0.05, 1, 100])
def test_dysons_chain_at_its_ends(shape):
    """All modes are below a high frequency, and few below a low one, by psi'(shape) / log^2."""
    mean = np.sqrt(shape)
    assert dyson.integrated(mean * 40, shape) == pytest.approx(1, abs=1e-8)
    low = dyson.integrated(np.array([1e-20, 1e-40]), shape)
    law = polygamma(1, shape) / np.log(np.array([1e-20, 1e-40]) ** 2) ** 2
    assert np.all(np.diff(np.abs(low / law - 1)) < 0)
    assert low[1] / law[1] == pytest.approx(1, abs=0.25)
    steps = dyson.integrated(mean * np.geomspace(1e-3, 40, 20), shape)
    assert (np.diff(steps) > -1e-7).all()


def test_narrow_ratios_are_an_ordered_chain():
    """Corrections to order 1/shape remain."""
    frequency = 2 * np.array([0.1, 0.5, 0.9])
    off = [
        dyson.integrated(frequency, shape, shape) - 2 / np.pi * np.arcsin(frequency / 2)
        for shape in (50, 100)
    ]
    assert np.abs(off[1]).max() < 4e-3
    assert off[0] / off[1] == pytest.approx(2, rel=0.15)


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


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("frequency", (0.0, 1)),
        ("shape", (1.0, 0)),
        ("rate", (1.0, 1, -1)),
        ("shape", (1.0, 0.049)),
        ("shape", (1.0, 100.1)),
        ("rate", (1.0, 1, np.inf)),
        ("frequency", (np.inf, 1)),
    ],
)
def test_invalid_parameters_of_dysons_chain_are_named(key, values):
    with pytest.raises(InputError, match=f"^{key}:"):
        dyson.integrated(*values)
