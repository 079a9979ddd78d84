"""Fits of solitary waves: recognition, heights, speeds, widths and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import run
from helpers.faults import fault_keys
from helpers.thinned import thinned
from scipy import stats

from lmpchain import Chain, Impulse, InputError, Profile, Trajectory
from lmpchain.measure.fit import fit_soliton, solitary
from lmpchain.measure.fit.overview import summary
from lmpchain.measure.front import Front, track
from lmpchain.theory.soliton import solve

CHAIN = Chain(grains=44, diameter=1e-3, gravity=0.0, material="steel")
STEEL = {"grains": 60, "diameter": 1e-3, "gravity": 0.0, "material": "steel"}


def strike(
    chain: Chain, excitation: Impulse | Profile, duration: float, samples: int = 801
) -> Trajectory:
    return run(chain, excitation, duration, samples, 1e-8)


def unit(chain: Chain) -> float:
    """Return the unit of time of a sonic vacuum for velocities in m/s."""
    return float((chain.masses[0] / chain.contact_constants[0]) ** (1 / (1 + chain.exponent)))


@pytest.mark.parametrize(
    ("exponent", "share", "speed"), [(1.5, 0.68163155, 0.9074700784), (2.0, None, 0.855251932)]
)
def test_behind_a_strike(exponent: float, share: float | None, speed: float):
    """The height of the first pulse, its speed and its width agree with published values."""
    chain = Chain(**STEEL, exponent=exponent)
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


@pytest.mark.parametrize("downward", thinned([False, True], 2))
def test_under_a_load(downward: bool):
    """A prescribed wave is found in either direction."""
    chain = Chain(**STEEL | {"grains": 110}, top_load=1.0)
    wave = solve(speed=1.3)
    t = strike(chain, wave.on(chain, 30 if downward else 80, downward), 40 * chain.time_scale)
    fit = fit_soliton(t)
    assert fit.wave.speed == pytest.approx(1.3, rel=1e-5)
    assert fit.speed == pytest.approx(1.3 / chain.time_scale, rel=1e-5)
    assert fit.width == pytest.approx(wave.width, rel=1e-4)
    assert fit.formula < fit.speed
    rows = {row.quantity: row for row in summary(t).rows if row.fit == "soliton"}
    assert rows["width"].expected == pytest.approx(wave.width, rel=1e-5)
    for name, value, error, unit_name in (
        ("largest velocity", fit.amplitude, fit.error[0], "m/s"),
        ("speed", fit.speed, fit.error[1], "grains/s"),
        ("width", fit.width, fit.error[2], "grains"),
    ):
        row = rows[name]
        assert (row.value, row.error, row.unit) == (value, error, unit_name)
    formula = rows["speed by long-wave formula"]
    assert (formula.value, formula.expected) == (fit.formula, rows["speed"].expected)
    height, speed, formula = fit.plot().lines
    assert np.max(height.get_ydata()) < 1e-4
    assert np.median(speed.get_ydata()) < 1e-4
    assert formula.get_ydata()[0] == pytest.approx(1 - fit.formula / fit.expected[1], rel=1e-9)


@pytest.mark.parametrize(
    ("chain", "excitation", "said"),
    [
        (Chain(**STEEL, top_load=1.0), Impulse(velocity=1e-4), "not a solitary wave"),
        (
            Chain(**STEEL, impurity=[{"grain": 30, "diameter": 1.1e-3}]),
            Impulse(velocity=0.1),
            "uniform",
        ),
    ],
)
def test_waves_that_are_not_solitary(chain: Chain, excitation: Impulse, said: str):
    t = strike(chain, excitation, 50 * chain.time_scale if chain.compressed else 1e-4)
    with pytest.raises(InputError, match=said):
        fit_soliton(t)


@pytest.mark.parametrize("striker", ["ptfe", "steel"])
def test_a_striker_of_another_kind(striker: str):
    """The chain below the striker is uniform, so the speed is the exact 0.9074700784 v^(1/5)."""
    chain = Chain(**STEEL, impurity=[{"grain": 1, "material": striker}])
    fit = fit_soliton(strike(chain, Impulse(velocity=0.44), 1.5e-4))
    row = Chain(**STEEL)
    assert fit.speed == pytest.approx(0.9074700784 / unit(row) * fit.amplitude**0.2, rel=1e-5)
    assert "within 5 of an end" in " ".join(str(fit).split())


def test_a_pull_sends_no_solitary_wave():
    chain = Chain(**STEEL, top_load=1.0)
    t = strike(chain, Impulse(velocity=-0.5), 45 * chain.time_scale)
    with pytest.raises(InputError, match="front"):
        fit_soliton(t)


# --- numbers of the fit


@pytest.fixture(scope="module")
def pulse() -> Trajectory:
    unit = (CHAIN.masses[0] / CHAIN.contact_constants[0]) ** 0.4
    duration = 46 * unit / 0.1**0.2
    return strike(CHAIN, Impulse(velocity=0.1), duration, 461)


@pytest.fixture(scope="module")
def front(pulse: Trajectory) -> Front:
    return track(pulse)


@pytest.mark.parametrize(("first", "last"), [(20, 30), (25, None), (None, None)])
def test_height_speed_and_width(
    pulse: Trajectory, front: Front, first: int | None, last: int | None
):
    """The default grains are the later half of grains 6 to 39.

    The errors include a 95 % interval and the sampling.
    """
    fit = fit_soliton(pulse, first, last)
    if first is None and last is None:
        inner = front.between(6, 39)
        later = inner.grain[np.argsort(inner.time)[inner.grain.size // 2 :]]
        used = front.between(later.min(), later.max())
    else:
        used = front.between(first or 1, last or 44)
    assert fit.grain.tolist() == used.grain.tolist()
    assert np.array_equal(fit.time, used.time)
    assert np.array_equal(fit.velocity, np.abs(used.amplitude))
    slope, _ = np.polyfit(used.grain, used.time, 1)
    speed = 1 / slope
    whole = np.isfinite(used.width)
    count = whole.sum()
    assert fit.amplitude == pytest.approx(used.amplitude.mean(), rel=1e-13)
    assert fit.speed == pytest.approx(speed, rel=1e-9)
    assert fit.width == pytest.approx(used.width[whole].mean() * speed, rel=1e-9)
    n = used.grain - used.grain.mean()
    left = used.time - used.time.mean() - slope * n
    line = np.sqrt(left @ left / (n.size - 2) / (n @ n)) * speed**2
    scatter = used.amplitude.std(ddof=1) / np.sqrt(n.size)
    width = used.width[whole].std(ddof=1) / np.sqrt(count) * speed
    sampled = np.array(
        [
            used.amplitude_error.max(),
            3 * used.time_error.max() / np.ptp(used.grain) * speed**2,
            used.width_error[whole].max() * speed,
        ]
    )
    sure = stats.t.ppf(0.975, count - 2)
    assert fit.error == pytest.approx(sure * np.array([scatter, line, width]) + sampled, rel=1e-6)
    unit = (CHAIN.masses[0] / CHAIN.contact_constants[0]) ** 0.4
    exact = 0.9074700784 / unit * fit.amplitude**0.2
    assert fit.expected == pytest.approx([fit.amplitude, exact, 1.5791], rel=1e-4)
    assert fit.expected[1] == pytest.approx(exact, rel=1e-9)
    assert 1.003 < fit.formula / exact < 1.05


def test_the_first_grains_still_change(pulse: Trajectory):
    """The wave still changes near the top, so those grains are used only on request."""
    with pytest.raises(InputError, match="not a solitary wave") as error:
        fit_soliton(pulse, None, 30)
    assert "from grain 2 to 30" in str(error.value)


def moved(front: Front, **changes: Any) -> Any:
    """Return a tracker that returns this front with changes."""
    changed = replace(front, **changes)
    return lambda trajectory, field: changed


def test_limits_of_a_steady_wave(pulse: Trajectory, front: Front, monkeypatch: pytest.MonkeyPatch):
    """Heights may scatter by 2 %, and speed and width may deviate by 2 %."""
    grain = front.grain
    amplitude = np.full(front.grain.size, front.amplitude[20])
    clean = {"amplitude": amplitude, "time": 1e-6 + (grain - 1) / fit_soliton(pulse).speed}

    def given(**changes: Any) -> Any:
        monkeypatch.setattr(solitary, "track", moved(front, **clean | changes))
        return fit_soliton(pulse, 15, 34)

    assert given().speed == pytest.approx(fit_soliton(pulse).expected[1], rel=1e-5)
    bump = np.where(grain == 20, 1.0, 0.0)
    assert given(amplitude=amplitude * (1 + 0.0195 * bump)).velocity.max() > amplitude[0]
    with pytest.raises(InputError, match=r"front: its height changes by 2.1% from grain 15 to 34"):
        given(amplitude=amplitude * (1 + 0.021 * bump))
    for factor in (0.983, 1.017):
        given(time=clean["time"] * factor, width=front.width * factor)
    for factor in (0.977, 1.023):
        with pytest.raises(
            InputError, match=r"times the speed and .* times the width of a solitary wave"
        ):
            given(time=clean["time"] * factor, width=front.width * factor)
    for factor in (0.975, 1.025):
        with pytest.raises(InputError, match="the width of a solitary wave"):
            given(width=front.width * factor)
    with pytest.raises(InputError, match="grains move against the wave"):
        given(amplitude=-amplitude)
    six, five = (np.where((grain > 14) & (grain < 15 + k), front.width, np.nan) for k in (6, 5))
    assert given(width=six).width > 1.5
    with pytest.raises(InputError, match=r"recorded grains completely \(got 5\)"):
        given(width=five)


def test_chains_in_which_waves_change(pulse: Trajectory):
    """Masses and constants of the fitted grains are equal to nine digits."""
    single = Chain(grains=1, bottom="wall", diameter=1e-3, gravity=0.0)
    assert fault_keys(solitary.check_chain, single) == ["grains"]
    for key in ("masses", "contact_constants"):
        for off, uniform in ((0.9e-9, True), (1.2e-9, False)):
            values = np.array(getattr(CHAIN, key))
            values[25] *= 1 + off
            chain = CHAIN.replace(**{key: values})
            run = replace(pulse, scene=pulse.scene.replace(chain=chain))
            if uniform:
                assert fit_soliton(run).speed == pytest.approx(fit_soliton(pulse).speed, rel=1e-9)
            else:
                assert fault_keys(fit_soliton, run) == ["chain"]
