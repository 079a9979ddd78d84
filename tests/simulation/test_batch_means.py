"""Intervals from batch means for sequences with exactly known mean and correlation."""

import numpy as np
import pytest
from helpers.thinned import thinned
from scipy.signal import lfilter
from scipy.stats import t

from lmpchain.simulation.batch_means import BATCHING, correlation_of_neighbours, estimate

TRIALS = 1000


def sequences(memory: float, copies: int, per_stretch: int, rng: np.random.Generator) -> np.ndarray:
    """Return stationary AR(1) sequences of mean 0 and variance 1, (R, S, P)."""
    shape = copies, BATCHING.stretches * per_stretch
    noise = np.sqrt(1 - memory**2) * rng.normal(size=shape)
    start = memory * rng.normal(size=(copies, 1))
    values, _ = lfilter([1.0], [1.0, -memory], noise, axis=1, zi=start)
    return values.reshape(copies, BATCHING.stretches, per_stretch)


def coverage(memory: float, copies: int, per_stretch: int, trials: int, seed: int) -> float:
    """Return the fraction of intervals of the mean that cover 0."""
    rng = np.random.default_rng(seed)
    covered = 0
    for _ in range(trials):
        average = estimate(sequences(memory, copies, per_stretch, rng).mean(-1))
        covered += abs(average.mean) <= average.half_width
    return covered / trials


@pytest.mark.parametrize(
    ("memory", "copies"), thinned([(0.5, 1), (0.0, 1), (0.9, 4), (0.8, 4), (-0.5, 1), (0.9, 1)], 2)
)
@pytest.mark.slow
def test_94_to_96_percent_of_1000_intervals_cover(memory: float, copies: int):
    """A fraction of a thousand intervals scatters by 0.7 %, hence 2 % instead of 1 %."""
    least, most = (0.93, 0.97) if memory >= 0 else (0.93, 1.0)
    assert least <= coverage(memory, copies, 8 if memory < 0.9 else 16, TRIALS, 1) <= most


@pytest.mark.parametrize("memory", [0.95, 0.99, 0.999, 0.9999])
def test_intervals_of_long_correlations_are_not_too_narrow(memory: float):
    """Intervals from few batches may be infinite; the others are wide enough on average."""
    assert coverage(memory, 1, 8, 400, 3) > 0.92


@pytest.mark.slow
def test_intervals_of_correlations_over_two_stretches_cover(rng):
    """Correlations that are small by chance must not make intervals too narrow."""
    averages = [estimate(sequences(np.exp(-1 / 16), 1, 8, rng).mean(-1)) for _ in range(8000)]
    known = [average for average in averages if average.batches]
    assert len(known) / len(averages) > 0.9
    assert 0.94 <= np.mean([abs(average.mean) <= average.half_width for average in known]) <= 0.96


@pytest.mark.slow
def test_intervals_of_oscillations_cover(rng):
    """Successive batches of a damped oscillation have opposite signs."""
    size = 2000, BATCHING.stretches * 8
    radius, angle = 0.98, 0.5
    swings = lfilter([1.0], [1.0, -2 * radius * np.cos(angle), radius**2], rng.normal(size=size))
    averages = [estimate(row.reshape(1, -1, 8).mean(-1)) for row in swings]
    # The standard deviation of the coverage of two thousand intervals is 0.5 %.
    covered = np.mean([abs(average.mean) <= average.half_width for average in averages])
    assert 0.935 <= covered <= 0.965


def test_a_random_walk_has_no_interval():
    steps = np.random.default_rng(4).normal(size=BATCHING.stretches)
    average = estimate(np.cumsum(steps)[None])
    assert average.batches == 0
    assert average.half_width == np.inf


def test_the_standard_error_agrees_with_the_sequence(rng):
    """The variance of the mean of n values of AR(1) is (1 + a) / (1 - a) / n."""
    memory, per_stretch = 0.9, 64
    errors = [estimate(sequences(memory, 1, per_stretch, rng).mean(-1)).error for _ in range(400)]
    exact = (1 + memory) / (1 - memory) / (BATCHING.stretches * per_stretch)
    # The mean of 400 estimates with 15 degrees of freedom each has a deviation of 1.8 %.
    assert 0.93 < np.mean(np.square(errors)) / exact < 1.07


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.96])
def test_the_interval_is_that_of_the_amplitudes_of_cosines(
    rng: np.random.Generator, memory: float
) -> None:
    """The formulas of the module, with sums over cosines and over neighbours written out."""
    middle = (np.arange(256) + 0.5) / 256
    for _ in range(3):
        means = sequences(memory, 3, 8, rng).mean(-1) + 2.0
        found = estimate(means)
        count = found.batches // 3
        assert count in (4, 8, 16)
        cosines = np.sqrt(2 / 256) * np.cos(np.pi * np.arange(count)[:, None] * middle)
        cosines[0] = 1 / 16
        amplitudes = (means - means.mean()) @ cosines.T
        variance = (amplitudes**2).sum() / (3 * count - 1)
        slowest = 0.0
        for finer in (8, 4):
            stretches = means.reshape(3, finer * count, -1).mean(-1) - means.mean()
            products = (stretches[:, 1:] * stretches[:, :-1]).mean()
            correlation = products / (stretches**2).mean() + 1 / (3 * finer * count)
            slowest = max(slowest, correlation / finer)
            if finer == 8:
                assert found.resemblance == pytest.approx(correlation, rel=1e-9)
                assert correlation <= 0.5
        # The correlation time c = 2 b r makes the spectrum s / (1 + (c w)^2) narrower.
        widening = 1 + (2 * np.pi * slowest) ** 2 / 3
        error = np.sqrt(widening * variance / means.size)
        assert found.mean == pytest.approx(means.mean(), rel=1e-12)
        assert found.error == pytest.approx(error, rel=1e-9)
        assert found.half_width == pytest.approx(t.ppf(0.975, 3 * count - 1) * error, rel=1e-9)


def test_a_constant_has_no_error():
    average = estimate(np.full((2, BATCHING.stretches), 3.0))
    assert average[:4] == (3.0, 0.0, 0.0, 32)


def test_correlation_of_neighbours_is_unbiased(rng):
    rows = [correlation_of_neighbours(rng.normal(size=(1, 64))) for _ in range(2000)]
    assert abs(np.mean(rows)) < 4 / np.sqrt(64 * 2000)


def test_a_correlation_with_a_known_walk_is_removed():
    """The energy of a run is a random walk, and changes the averages."""
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(1, BATCHING.stretches))
    walk = np.cumsum(rng.normal(size=(1, BATCHING.stretches)), axis=1)
    assert estimate(noise + walk).batches == 0
    free = estimate(noise + 3.0 * walk, walk)
    assert free.batches == 16
    assert free.error == pytest.approx(1 / 16, rel=0.4)
    assert free.mean == pytest.approx(float((noise + 3.0 * walk).mean()), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("stretches", "share"), [(3, 0.9), (5, 0.7)])
def test_few_cosines_cover_correlations_over_several_stretches(
    rng: np.random.Generator, stretches: int, share: float
):
    """Intervals that exist because correlations are small by chance cover slightly less."""
    memory = np.exp(-1 / (8 * stretches))
    averages = [estimate(sequences(memory, 1, 8, rng).mean(-1)) for _ in range(4000)]
    known = [average for average in averages if average.batches]
    assert len(known) / len(averages) > share
    assert 0.92 <= np.mean([abs(average.mean) <= average.half_width for average in known]) <= 0.96
