"""Solitary waves of dimer chains: published mass ratios, and waves that travel unchanged."""

from functools import cache

import numpy as np
import pytest

import lmpchain
from lmpchain.theory.dimer_soliton import DimerSoliton, antiresonances, solve


@cache
def wave_near(ratio: float) -> DimerSoliton:
    """Return the solitary wave with the mass ratio next to this one, at 0.1 m/s."""
    return solve(ratio, velocity=0.1)


@pytest.mark.parametrize(
    ("near", "ratio", "published"),
    [
        pytest.param(0.36, 0.3428457812, 0.3428, marks=pytest.mark.slow),
        pytest.param(0.16, 0.1547515139, 0.1548, marks=pytest.mark.slow),
        pytest.param(0.092, 0.0901, 0.0901, marks=pytest.mark.slow),
        pytest.param(0.0625, 0.0615, None, marks=pytest.mark.slow),
    ],
)
def test_antiresonances(near: float, ratio: float, published: float | None):
    """Jayaprakash et al., Phys. Rev. E 83, 036606 (2011); ten digits by another solver."""
    found = wave_near(near).mass_ratio
    assert found == pytest.approx(ratio, abs=1e-10 if near > 0.1 else 5e-5)
    if published:
        assert found == pytest.approx(published, abs=5.1e-5)


@pytest.mark.parametrize(
    ("least", "count"),
    [pytest.param(0.085, 3, marks=pytest.mark.slow), pytest.param(0.06, 4, marks=pytest.mark.soak)],
)
def test_a_scan_finds_the_published_mass_ratios(least: float, count: int):
    """The mass ratios of Jayaprakash et al. from 1 down to 0.06, in order, without a guess."""
    assert antiresonances(least) == pytest.approx(
        (0.3428, 0.1548, 0.0901, 0.0615)[:count], abs=5.1e-5
    )


@pytest.mark.slow
@pytest.mark.parametrize("near", [0.36, 0.16])
def test_travels_unchanged(near: float):
    """After sixty grains the wave has changed by less than 1e-9."""
    wave = wave_near(near)
    masses = np.resize([1e-5, 1e-5 * wave.mass_ratio], 90)
    chain = lmpchain.Chain(grains=90, diameter=1e-2, masses=masses, gravity=0.0,
                           contact_constants=np.full(89, 1e9))  # fmt: skip
    start = wave.on(chain, 13)
    end = wave.on(chain, 73)
    unit = (1e-5 / 1e9) ** 0.4
    assert len(wave.plot().figure.axes[0].lines) == 4
    assert start.velocity[::2].max() <= 0.1 * (1 + 1e-12)
    scene = lmpchain.Scene(
        chain=chain, excitation=start, duration=60 * unit / wave.speed, samples=2
    )
    t = lmpchain.simulate(scene, engine="native", tolerance=1e-9)
    assert np.abs(t.velocity[-1] - end.velocity).max() < 1e-9 * 0.1
    assert np.abs(t.displacement[-1] - end.displacement).max() < 1e-9 * end.displacement.max()


@pytest.mark.parametrize(
    ("keys", "said"), [({"near": 1.5}, "near"), ({"near": 0.3, "delta": 1.0}, "delta")]
)
def test_refusals(keys: dict[str, float], said: str):
    with pytest.raises(lmpchain.InputError, match=f"^{said}: "):
        solve(**keys)


@pytest.mark.slow
def test_a_chain_that_is_not_such_a_dimer():
    with pytest.raises(lmpchain.InputError, match="masses: "):
        wave_near(0.36).on(lmpchain.Chain(grains=60, diameter=1e-3, gravity=0.0), 30)
