"""Solitary waves recognised in trajectories."""

import numpy as np
import pytest

from lmpchain import Chain, Impulse, InputError, Profile, Scene, Trajectory, simulate
from lmpchain.measure.fit import fit_soliton
from lmpchain.measure.fit.overview import summary
from lmpchain.theory.soliton import solve

CHAIN = {"grains": 60, "diameter": 1e-3, "gravity": 0.0, "material": "steel"}


def strike(
    chain: Chain, excitation: Impulse | Profile, duration: float, samples: int = 801
) -> Trajectory:
    scene = Scene(chain=chain, excitation=excitation, duration=duration, samples=samples)
    return simulate(scene, engine="native", tolerance=1e-8)


def unit(chain: Chain) -> float:
    """Return the unit of time of a sonic vacuum for velocities in m/s."""
    return float((chain.masses[0] / chain.contact_constants[0]) ** (1 / (1 + chain.exponent)))


@pytest.mark.parametrize(
    ("exponent", "share", "speed"), [(1.5, 0.68163155, 0.9074700784), (2.0, None, 0.855251932)]
)
def test_behind_a_strike(exponent: float, share: float | None, speed: float):
    """The height of the first pulse, its speed and its width agree with published values."""
    chain = Chain(**CHAIN, exponent=exponent)
    t = strike(
        chain, Impulse(velocity=0.1), 65 * unit(chain) / 0.1 ** ((exponent - 1) / (exponent + 1))
    )
    fit = fit_soliton(t)
    if share:
        assert fit.amplitude == pytest.approx(0.1 * share, rel=1e-6)
    own = speed / unit(chain) * fit.amplitude ** ((exponent - 1) / (exponent + 1))
    assert fit.speed == pytest.approx(own, rel=1e-6)
    assert fit.expected[1] == pytest.approx(own, rel=1e-9)
    assert fit.width == pytest.approx(fit.expected[2], rel=1e-5)
    assert 0.003 < fit.formula / fit.speed - 1 < 0.05
    assert (np.abs(np.array([fit.speed, fit.width]) - fit.expected[1:]) < 5 * fit.error[1:]).all()


@pytest.mark.parametrize("downward", [True, False])
def test_under_a_load(downward: bool):
    """A prescribed wave is found in either direction."""
    chain = Chain(**CHAIN | {"grains": 110}, top_load=1.0)
    wave = solve(speed=1.3)
    t = strike(chain, wave.on(chain, 30 if downward else 80, downward), 40 * chain.time_scale)
    fit = fit_soliton(t)
    assert fit.wave.speed == pytest.approx(1.3, rel=1e-5)
    assert fit.speed == pytest.approx(1.3 / chain.time_scale, rel=1e-5)
    assert fit.width == pytest.approx(wave.width, rel=1e-4)
    assert fit.formula < fit.speed
    rows = {row.quantity: row for row in summary(t).rows if row.fit == "soliton"}
    assert rows["speed"].value == fit.speed
    assert rows["width"].expected == pytest.approx(wave.width, rel=1e-5)
    height, speed, formula = fit.plot().lines
    assert np.max(height.get_ydata()) < 1e-4
    assert np.median(speed.get_ydata()) < 1e-4
    assert formula.get_ydata()[0] == pytest.approx(1 - fit.formula / fit.expected[1], rel=1e-9)


@pytest.mark.parametrize(
    ("chain", "excitation", "said"),
    [
        (Chain(**CHAIN, top_load=1.0), Impulse(velocity=1e-4), "no solitary wave"),
        (Chain(**CHAIN | {"gravity": 9.81}), Impulse(velocity=0.1), "gravity"),
        (Chain(**CHAIN, exponent=1.0, top_load=1.0), Impulse(velocity=1e-4), "exponent"),
        (
            Chain(**CHAIN, impurity=[{"grain": 30, "diameter": 1.1e-3}]),
            Impulse(velocity=0.1),
            "uniform",
        ),
    ],
)
def test_what_is_no_solitary_wave(chain: Chain, excitation: Impulse, said: str):
    t = strike(chain, excitation, 50 * chain.time_scale if chain.compressed else 1e-4)
    with pytest.raises(InputError, match=said):
        fit_soliton(t)


@pytest.mark.parametrize("striker", ["ptfe", "steel"])
def test_a_striker_of_another_kind(striker: str):
    """The row behind the striker is uniform, and its wave the exact one: 0.9074700784 v^(1/5)."""
    chain = Chain(**CHAIN, impurity=[{"grain": 1, "material": striker}])
    fit = fit_soliton(strike(chain, Impulse(velocity=0.44), 1.5e-4))
    row = Chain(**CHAIN)
    assert fit.speed == pytest.approx(0.9074700784 / unit(row) * fit.amplitude**0.2, rel=1e-5)
    assert "within 5 of an end" in " ".join(str(fit).split())


def test_a_pull_is_no_solitary_wave():
    chain = Chain(**CHAIN, top_load=1.0)
    t = strike(chain, Impulse(velocity=-0.5), 45 * chain.time_scale)
    with pytest.raises(InputError, match="front"):
        fit_soliton(t)
