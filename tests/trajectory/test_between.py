"""Polynomials between samples at an opening or closing contact, compared with quadrature."""

import numpy as np
import pytest
from helpers.between_samples import block_of, bound, front_among, polynomial, power
from scipy.optimize import brentq

from lmpchain.trajectory.between import hermite
from lmpchain.trajectory.between.derivatives import STILL, derive

SAMPLES, FINE = 8, 2000  # Number of samples, and of quadrature times between two of them.
KNOTS, WEIGHTS = np.polynomial.legendre.leggauss(4)


def integral(values: np.ndarray) -> np.ndarray:
    """Return the running integral, (K+1,), of values (K, 4) at Gauss points of K intervals."""
    return np.concatenate(([0.0], np.cumsum(values @ WEIGHTS) / 2 / FINE))


def motion(overlap: np.polynomial.Polynomial, exponent: float) -> tuple[np.ndarray, ...]:
    """Return the time and motion of a grain of 1 kg with one contact, with its acceleration."""
    ends = np.arange((SAMPLES - 1) * FINE + 1) / FINE
    inside = (ends[:-1, None] + ends[1:, None] + KNOTS / FINE) / 2

    def force(t: np.ndarray) -> np.ndarray:
        y = overlap(t)
        return np.where(y > 0, np.abs(y) ** exponent, 0.0)

    v = integral(force(inside))
    middle = (
        v[:-1, None] + (inside - ends[:-1, None]) * (force(ends[:-1])[:, None] + force(inside)) / 2
    )
    return ends, integral(middle), v, force(ends)


def worst(overlap: np.polynomial.Polynomial, exponent: float) -> np.ndarray:
    """Return the largest ratios of true to claimed errors of v, v' and v'', (3,)."""
    t, u, v, a = motion(overlap, exponent)
    at = slice(None, None, FINE)
    # Displacement and velocity of the other body.
    above = (
        u[at] + overlap(t[at]),
        v[at] + overlap.deriv()(t[at]),
    )
    fields = [np.stack(pair, axis=1) for pair in zip(above, (u[at], v[at]), strict=True)]
    contacts = np.array([[0.0, 1.0, 0.0], np.zeros(3), np.zeros(3)])
    block = block_of(*fields, [STILL, 0, 1, STILL], contacts, np.ones(2), exponent, False, 1.0)
    found = derive(block, np.array([2]))[0]
    path = np.zeros((8, SAMPLES))
    path[:5] = [u[at], v[at], *found]
    bound(path, hermite.VELOCITY, 1.0)
    error = path[hermite.ERROR]
    np.testing.assert_allclose(found[0], a[at], rtol=1e-9, atol=1e-9 * a.max(initial=1e-300))
    ratios = np.zeros(3)
    for i in range(1, SAMPLES - 2):
        part = power(polynomial(path, hermite.VELOCITY, 1.0, i)[0])
        here = slice(i * FINE, (i + 1) * FINE + 1)
        s = t[here] - i
        rate = np.gradient(a[here], 1 / FINE)
        allowed = error[i] * np.array([1, hermite.SHAPE.slope, hermite.SHAPE.curvature])
        off = [np.abs(part.deriv(k)(s) - true)[2:-2].max() if k else np.abs(part(s) - true).max()
               for k, true in enumerate((v[here], a[here], rate))]  # fmt: skip
        ratios = np.maximum(
            ratios, np.array(off) / (allowed + 1e-6 * np.abs(a).max(initial=1e-300))
        )
    return ratios


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("kind", ["crosses", "leaves for a moment", "touches for a moment"])
def test_errors_cover_kinks(kind: str, exponent: float):
    rng = np.random.default_rng(round(100 * exponent))
    t = np.polynomial.Polynomial([0.0, 1.0])
    found = []
    for _ in range(3):
        place = SAMPLES // 2 - 1 + rng.uniform()
        if kind == "crosses":
            overlap = (t - place) * rng.choice([-1, 1]) + rng.uniform(-0.6, 0.6) * (t - place) ** 2
        else:
            width = 10 ** rng.uniform(-1.5, 0) / 2
            overlap = ((t - place) ** 2 - width**2) * (1 if kind == "leaves for a moment" else -1)
        found.append(worst(overlap, exponent))
    assert np.max(found) <= 1


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.7])
def test_a_width_ends_at_a_narrow_dip(shift: float):
    """Between two bumps, the motion falls just below half of the first one, or just not."""
    t = np.polynomial.Polynomial([0.0, 1.0])

    def bumps(second: float, time: np.ndarray) -> np.ndarray:
        """Return u, v, a, j (4, ...) of two Gaussian bumps."""
        found = np.zeros((4, *np.shape(time)))
        for size, middle, width in ((1.0, 20 + shift, 4.0), (second, 29.5 + shift, 4.0)):
            s = (time - middle) / width
            factor = np.polynomial.Polynomial([size])
            for order in range(4):
                found[order] += factor(s) * np.exp(-(s**2)) / width**order
                factor = factor.deriv() - 2 * t * factor
        return found

    def depth(second: float) -> float:
        """Return the relative depth of the dip below half of the first bump."""
        u = bumps(second, np.linspace(18, 28, 20001) + shift)[0]
        return float(1 - 2 * u[8000:].min() / u[:8000].max())

    for sign in (1, -1):
        second = brentq(lambda size, sign=sign: depth(size) - sign * 1e-6, 0.5, 1.2, xtol=1e-14)
        values = np.zeros((5, 60))
        values[:4] = bumps(second, np.arange(60.0))
        found = front_among(values, hermite.DISPLACEMENT, 1.0, 0.5, 0.0, 0.0, 0.5)
        time, height, width, _, _, error = found
        assert abs(time - 20 - shift) < 0.1
        dense = np.linspace(10, 40, 300_001) + shift
        low = dense[bumps(second, dense)[0] < height / 2]
        end = low[low > time][0]
        assert (end - time < 6) == (sign > 0)
        assert abs(end - low[low < time][-1] - width) <= error + 3e-4
