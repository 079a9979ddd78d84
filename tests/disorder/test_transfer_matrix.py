"""Lyapunov exponents and densities of states against exact results, ordered and random."""

import math
import re

import numpy as np
import pytest
from scipy.stats import expon, gamma, norm, uniform

from lmpchain import InputError
from lmpchain.disorder import density_of_states, lyapunov, transfer_matrix
from lmpchain.theory import dyson
from lmpchain.util.progress import ProgressBar


def test_an_ordered_chain():
    """Waves in the band do not grow; above the band they decay by arcosh(w^2 / 2 - 1) per grain."""
    share = np.array([0.0, 1e-3, 0.25, 0.5, 0.95, 1.25, 30.0])  # Of the band edge.
    states = density_of_states(4.0 * share, 2.0, 0.5, grains=100)
    exact = 2 / np.pi * np.arcsin(np.minimum(share, 1))
    assert states.integrated == pytest.approx(exact, rel=1e-12, abs=1e-15)
    waves = lyapunov(4.0 * share, 2.0, 0.5, grains=1000)
    decay = 2 * np.arccosh(np.maximum(share, 1))
    assert waves.exponent == pytest.approx(decay, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("shape", [1.0, 3.0])
def test_transfer_matrices_find_dysons_spectrum(shape):
    square = np.array([0.1, 0.5, 1, 2, 4, 6])
    found = density_of_states(
        np.sqrt(square), ratios=gamma(shape), grains=30_000, chains=20, seed=3
    )
    assert (
        np.abs(found.integrated - dyson.integrated(np.sqrt(square), shape)) < 4 * found.error
    ).all()
    assert (found.error < 2e-3).all()


class Given:
    """A distribution that returns given values in turn, and records the random generators."""

    def __init__(self, values: np.ndarray):
        self.values = values
        self.states: list[str] = []

    def rvs(self, *, size: int, random_state: np.random.Generator) -> np.ndarray:
        self.states.append(str(random_state.bit_generator.seed_seq.entropy))
        head = self.values[:size]
        self.values = self.values[size:]
        return head


def growth_and_nodes(
    k: np.ndarray, above: np.ndarray, below: np.ndarray, w: float, passed: int
) -> tuple[float, float]:
    """Return growth and nodes per grain of u_n from a free top, by the equation of motion.

    The ratios k_n / m_n and k_n / m_(n+1) are `above` and `below`; the force is kept over the mass.
    """
    u = 1.0
    force = w**2
    logarithm = 0.0
    nodes = 0.0
    slowness = float(np.mean(1 / above))

    def wave() -> complex:
        """Return A e^(i phase) / u for the wave A cos(q n + phase) in the mean chain."""
        turn = min(max(w**2 * slowness, 1e-300), 3.96)
        cosine = 1 - turn / 2
        # Ratio of the next displacement to this one in the mean chain.
        ahead = 1 - force / u * slowness
        return 1 + 1j * (cosine - ahead) / math.sqrt(turn * (1 - turn / 4))

    for n in range(k.size):
        if n == passed:
            logarithm -= math.log(abs(wave()))
            nodes -= math.atan(wave().imag) / math.pi
        ahead = u - force / above[n]
        force = force * below[n] / above[n] + w**2 * ahead
        if n >= passed:
            logarithm += np.log(abs(ahead / u))
            nodes += ahead / u < 0
        u = ahead / abs(ahead)
        force = force / abs(ahead)
    logarithm += math.log(abs(wave()))
    nodes += math.atan(wave().imag) / math.pi
    return logarithm / (k.size - passed), nodes / (k.size - passed)


@pytest.mark.parametrize("kind", ["masses", "ratios"])
@pytest.mark.parametrize("piece", [2**16, 37])
def test_every_grain_by_its_equation_of_motion(rng, kind: str, piece: int, monkeypatch):
    """Three chains of given grains: mean after a tenth, standard error, and draw order."""
    monkeypatch.setattr(transfer_matrix, "PIECE", piece)
    chains = 3
    grains = 150
    w = np.array([0.0, 0.3, 1.1, 2.5, 40.0])
    k = rng.uniform(0.5, 2, (chains, grains))
    m = rng.uniform(0.5, 2, (chains, grains + 1))
    above = k / m[:, :-1]
    below = k / m[:, 1:]
    if kind == "ratios":
        below = rng.uniform(0.5, 2, (chains, grains))
        rows = []
        for a, b in zip(above, below, strict=True):
            starts = range(0, grains, piece)
            rows += [x[first : first + piece] for first in starts for x in (a, b)]
        given = {"ratios": np.concatenate(rows)}
    else:
        given = {"stiffness": k.ravel(), "masses": m.ravel()}
    exact = np.array(
        [[growth_and_nodes(k[i], above[i], below[i], x, 15) for x in w] for i in range(chains)]
    )
    options = {"grains": grains, "chains": chains, "seed": 6}
    laws = {key: Given(values) for key, values in given.items()}
    grown = lyapunov(w, **laws, **options)
    share = density_of_states(w, **{key: Given(values) for key, values in given.items()}, **options)
    # Neither an exponent nor a fraction of modes is negative.
    mean = np.maximum(exact[..., 0].mean(0), 0)
    assert grown.exponent == pytest.approx(mean, rel=1e-9, abs=1e-15)
    assert grown.error == pytest.approx(
        exact[..., 0].std(0, ddof=1) / np.sqrt(3), rel=1e-8, abs=1e-15
    )
    assert share.integrated == pytest.approx(np.clip(exact[..., 1].mean(0), 0, 1), rel=1e-12)
    assert share.error == pytest.approx(
        exact[..., 1].std(0, ddof=1) / np.sqrt(3), rel=1e-12, abs=1e-16
    )
    assert share.density == pytest.approx(np.diff(share.integrated) / np.diff(w), rel=1e-14)
    with np.errstate(divide="ignore"):
        assert grown.length == pytest.approx(1 / grown.exponent, rel=1e-14)
    seeds = list(dict.fromkeys(next(iter(laws.values())).states))
    assert seeds == ["[6, 0]", "[6, 1]", "[6, 2]"]


def test_a_node_on_a_grain():
    """For w = 1 and equal grains, every third ratio is 0 or infinite; a third of modes is lower."""
    options = {"grains": 6000, "chains": 2}
    assert density_of_states(1.0, **options).integrated == pytest.approx(1 / 3, abs=2e-4)
    assert abs(lyapunov(1.0, **options).exponent[0]) < 0.01
    assert lyapunov(1.0, grains=100, chains=2).error == pytest.approx(0, abs=1e-15)


def test_progress_in_grains(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(transfer_matrix, "PIECE", 60)
    reached: list[float] = []
    monkeypatch.setattr(ProgressBar, "reach", lambda _, done: reached.append(done))
    lyapunov(0.5, grains=100, chains=2, progress=True)
    assert re.search(r"transfer matrices\W.* of 200 grains", capsys.readouterr().err)
    density_of_states(0.5, grains=100, chains=2)
    assert capsys.readouterr().err == ""
    assert reached == 2 * [60, 100, 160, 200]


def test_defaults():
    """The default is sixteen chains of a hundred thousand equal grains, here of 1 kg and 1 N/m."""
    counted = []

    class Unit:
        def rvs(self, *, size, random_state):
            counted.append(size)
            return np.ones(size)

    found = density_of_states(0.5, masses=Unit())
    assert sum(counted) == 16 * 100_001
    assert found.integrated == pytest.approx(2 / np.pi * np.arcsin(0.25), abs=2e-5)
    assert lyapunov(2.5, grains=100).exponent == pytest.approx(2 * np.arccosh(1.25), rel=1e-9)


def test_pictures_have_labels_and_bars():
    frequency = np.geomspace(0.1, 2, 5)
    grown = lyapunov(frequency, expon(0.1), grains=1000)
    share = density_of_states(frequency, expon(0.1), grains=1000)
    for found, values, label, scale in (
        (grown, grown.exponent, "Lyapunov exponent per grain", "log"),
        (share, share.integrated, "share of the modes below", "linear"),
    ):
        (ax,) = found.plot().figure.axes
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("frequency (rad/s)", label)
        assert (ax.get_xscale(), ax.get_yscale()) == (scale, scale)
        (container,) = ax.containers
        line, caps, (bars,) = container.lines
        assert line.get_xdata().tolist() == frequency.tolist()
        assert line.get_ydata().tolist() == values.tolist()
        ends = np.array(bars.get_segments())[:, :, 1]
        assert np.diff(ends, axis=1)[:, 0] == pytest.approx(4 * found.error, rel=1e-9)
        assert len(caps) == 2


@pytest.mark.parametrize(
    ("what", "key"),
    [
        ({"frequency": [-1.0]}, "frequency"),
        ({"frequency": []}, "frequency"),
        ({"frequency": [np.nan]}, "frequency"),
        ({"frequency": [[0.5]]}, "frequency"),
        ({"frequency": [np.inf]}, "frequency"),
        ({"stiffness": 0.0}, "stiffness"),
        ({"masses": np.inf}, "masses"),
        ({"grains": 99}, "grains"),
        ({"stiffness": norm()}, "stiffness"),
        ({"stiffness": "soft"}, "stiffness"),
        ({"masses": -1.0}, "masses"),
        ({"ratios": norm()}, "ratios"),
        ({"grains": 3}, "grains"),
        ({"chains": 1}, "chains"),
        ({"seed": -1}, "seed"),
    ],
)
def test_invalid_arguments_are_named(what, key):
    with pytest.raises(InputError, match=f"^{key}:"):
        lyapunov(**({"frequency": [0.5], "grains": 1000, "chains": 2} | what))


def test_chains_shorter_than_their_localisation_length_are_not_biased():
    """The law of weak disorder, w^2 Var(1/k) / (8 <1/k>), holds within the scatter of many runs."""
    omega = np.array([0.01, 0.03, 0.1])
    law = omega**2 * (1 / 4) / 8
    misses = []
    for seed in range(12):
        # The chain is a tenth of a localisation length at the lowest frequency.
        waves = lyapunov(omega, gamma(6, scale=1 / 5), grains=30_000, seed=seed)
        assert (waves.exponent >= 0).all()
        misses.append((waves.exponent - law) / waves.error)
    assert np.abs(misses).max() < 4.5
    # Twelve means have a standard deviation of 1 each; clipping at 0 increases the first one
    # slightly.
    assert (np.abs(np.mean(misses, axis=0)) < 3 / math.sqrt(12) + np.array([0.3, 0, 0])).all()


@pytest.mark.parametrize("grains", [200, 1000])
def test_weak_disorder_leaves_the_modes_of_the_uniform_chain(grains: int):
    """The fraction of modes is 2 arcsin(w/2) / pi for chains of any length."""
    omega = np.array([0.05, 0.3, 1.0])
    exact = 2 * np.arcsin(omega / 2) / np.pi
    misses = []
    for seed in range(12):
        masses = uniform(0.95, 0.1)
        states = density_of_states(omega, 1.0, masses, grains=grains, chains=64, seed=seed)
        misses.append((states.integrated - exact) / states.error)
    assert np.abs(misses).max() < 4.5
    assert (np.abs(np.mean(misses, axis=0)) < 3 / math.sqrt(12)).all()
