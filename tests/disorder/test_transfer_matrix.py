"""Lyapunov exponents and densities of states against exact results, of ordered chains and of Dyson's random ones."""

import numpy as np
import pytest
from scipy.special import polygamma
from scipy.stats import expon, gamma, norm

from lmpchain import InputError
from lmpchain.disorder import density_of_states, lyapunov
from lmpchain.theory import dyson


def test_an_ordered_chain():
    """In the band nothing grows and the modes are those of sin; above, waves decay as arcosh says."""
    k, m, edge = 2.0, 0.5, 4.0
    below, above = edge * np.array([1e-3, 0.1, 0.5, 0.99]), edge * np.array([1.01, 2.0, 30.0])
    found = density_of_states([*below, *above], k, m, grains=200_000, chains=2)
    assert found.integrated[: below.size] == pytest.approx(2 / np.pi * np.arcsin(below / edge), abs=2e-5)
    assert (found.integrated[below.size :] == 1).all()
    assert lyapunov(above, k, m, grains=10_000, chains=2).exponent == pytest.approx(2 * np.arccosh(above / edge), 1e-12)
    assert (np.abs(lyapunov(below, k, m, grains=200_000, chains=2).exponent) < 1e-4).all()


@pytest.mark.parametrize("shape", [0.05, 0.5, 1, 7.3, 100])
def test_dysons_chain_at_its_ends(shape):
    """All modes lie below a high frequency; few below a low one, by the singularity psi'(shape) / log^2."""
    mean = np.sqrt(shape)
    assert dyson.integrated(mean * 40, shape) == pytest.approx(1, abs=1e-8)
    low = dyson.integrated(np.array([1e-20, 1e-40]), shape)
    law = polygamma(1, shape) / np.log(np.array([1e-20, 1e-40]) ** 2) ** 2
    assert np.all(np.diff(np.abs(low / law - 1)) < 0)
    assert low[1] / law[1] == pytest.approx(1, abs=0.25)
    steps = dyson.integrated(mean * np.geomspace(1e-3, 40, 400), shape)
    assert (np.diff(steps) > -1e-7).all()


def test_narrow_ratios_are_an_ordered_chain():
    """Corrections to order 1/shape remain."""
    frequency = 2 * np.array([0.1, 0.5, 0.9])
    off = [dyson.integrated(frequency, shape, shape) - 2 / np.pi * np.arcsin(frequency / 2) for shape in (50, 100)]
    assert np.abs(off[1]).max() < 4e-3
    assert off[0] / off[1] == pytest.approx(2, rel=0.15)


@pytest.mark.parametrize("shape", [1.0, 3.0])
def test_transfer_matrices_find_dysons_spectrum(shape):
    square = np.array([0.1, 0.5, 1, 2, 4, 6])
    found = density_of_states(np.sqrt(square), ratios=gamma(shape), grains=30_000, chains=20, seed=3)
    assert (np.abs(found.integrated - dyson.integrated(np.sqrt(square), shape)) < 4 * found.error).all()
    assert (found.error < 2e-3).all()


def test_the_error_is_that_of_the_mean():
    """The standard error, from the spread of the chains, is that of the results of other seeds."""
    several = [lyapunov(0.5, gamma(5, scale=0.2), grains=2000, chains=10, seed=seed) for seed in range(60)]
    spread = np.std([each.exponent for each in several], ddof=1)
    assert spread == pytest.approx(np.sqrt(np.mean([each.error**2 for each in several])), rel=0.3)


def test_the_same_seed_gives_the_same_bits():
    first, again, other = (lyapunov([0.5], expon(0.1), grains=70_000, chains=2, seed=seed) for seed in (1, 1, 2))
    assert first.exponent == again.exponent != other.exponent
    assert first.length == 1 / first.exponent


def test_pictures_have_labels():
    frequency = np.geomspace(0.1, 2, 5)
    for found in (lyapunov(frequency, expon(0.1), grains=1000), density_of_states(frequency, expon(0.1), grains=1000)):
        (ax,) = found.plot().figure.axes
        assert ax.get_xlabel() == "frequency, rad/s"
        assert ax.get_ylabel()


@pytest.mark.parametrize(
    ("what", "key"),
    [
        ({"frequency": [-1.0]}, "frequency"),
        ({"frequency": []}, "frequency"),
        ({"frequency": [np.nan]}, "frequency"),
        ({"stiffness": norm()}, "stiffness"),
        ({"stiffness": "soft"}, "stiffness"),
        ({"masses": -1.0}, "masses"),
        ({"ratios": norm()}, "ratios"),
        ({"grains": 3}, "grains"),
        ({"chains": 1}, "chains"),
        ({"seed": -1}, "seed"),
    ],
)
def test_what_is_wrong_is_named(what, key):
    with pytest.raises(InputError, match=f"^{key}:"):
        lyapunov(**({"frequency": [0.5], "grains": 1000, "chains": 2} | what))


@pytest.mark.parametrize(("key", "values"), [("frequency", (0.0, 1)), ("shape", (1.0, 0)), ("rate", (1.0, 1, -1))])
def test_what_is_wrong_with_dysons_chain_is_named(key, values):
    with pytest.raises(InputError, match=f"^{key}:"):
        dyson.integrated(*values)
