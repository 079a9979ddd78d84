"""The laws of stability, checked numerically.

Trends, predictability, overlaps, warnings, and the boundaries that are shown.
"""

from __future__ import annotations

import math
import re
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck_in_units
from matplotlib.figure import Figure
from scipy import stats

from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Law, Scene, simulate
from lmpchain.engines import Lammps, Native
from lmpchain.engines.cost_model import TooLong, budget, in_words
from lmpchain.engines.linear.engine import Chebyshev
from lmpchain.integrators.methods import METHODS
from lmpchain.stability import find
from lmpchain.stability.linear_theory import linear_law, strike_number_at, strike_number_where
from lmpchain.stability.pre_run import deepest, hertz_excess, pre_run_warnings
from lmpchain.stability.predictability import (
    amplifies,
    growth_rate,
    predictability_time_of,
    predicted_time,
    reflection_time,
)
from lmpchain.stability.result import Boundary, Curve, Stability
from lmpchain.stability.roundoff import floor
from lmpchain.stability.step_limit import (
    EnergyError,
    energy_error,
    limit,
    struck_frequency,
    suspect,
)

STEEL = Chain(grains=12, material="steel", diameter=3e-3)
STRUCK = Scene(chain=STEEL, excitation=Impulse(velocity=0.05), duration=1e-3, samples=101)
WEAK = Scene(chain=STEEL, excitation=Impulse(velocity=1e-6), duration=1e-3, samples=101)
DRIVEN = scene_of(STEEL, Drive(amplitude=1e-9, frequency=1e4), 2e-4, 11)


# --- trends of the energy


def trend(error: Any, duration: float = 2.0) -> tuple[float, float]:
    return EnergyError(np.linspace(0.0, duration, len(error)), np.asarray(error), 1.0).trend()


def test_the_interval_of_a_trend_covers_in_99_of_100_draws(rng: np.random.Generator) -> None:
    """White noise, whose slope has the standard deviation sqrt(12 / n) / T.

    T of 48 degrees is 2.68 at 99 %.
    """
    size = 250
    draws = np.array(
        [trend(0.3 * np.linspace(0, 2, size) + rng.normal(size=size)) for _ in range(300)]
    )
    rates, widths = draws.T
    assert 0.97 <= np.mean(np.abs(rates - 0.3) < widths) < 1
    deviation = np.sqrt(12 / size) / 2.0
    assert np.std(rates) == pytest.approx(deviation, rel=0.1)
    assert np.mean(widths) == pytest.approx(stats.t.ppf(0.995, 48) * deviation, rel=0.04)


def test_the_interval_of_a_trend_is_wider_for_correlated_stretches(
    rng: np.random.Generator,
) -> None:
    """An autoregressive sequence with r = 0.6 counts as a quarter of its length."""
    hits = 0
    plain = 0
    for _ in range(200):
        values = rng.normal(size=150)
        for n in range(1, 150):
            values[n] += 0.6 * values[n - 1]
        time = np.linspace(0.0, 2.0, 50)
        rate, width = trend(values[100:])
        hits += abs(rate) < width
        plain += abs(rate) < 2.68 * stats.linregress(time, values[100:]).stderr
    assert plain < 0.9 * 200  # Without the correction.
    assert hits > 0.94 * 200


def test_a_drift_that_slows_down_is_not_a_correlation(rng: np.random.Generator) -> None:
    """The trend of a parabola is its regression line, with the standard error of the residuals."""
    time = np.linspace(0.0, 2.0, 50)
    noise = 1e-3 * rng.normal(size=50)
    rate, width = trend(time - 0.2 * time**2 + noise)
    line = stats.linregress(time, time - 0.2 * time**2 + noise)
    assert rate == pytest.approx(0.6, abs=1e-3)
    assert width == pytest.approx(2.68 * line.stderr, rel=0.15)


def test_the_last_samples_form_fifty_stretches() -> None:
    """Earlier samples that do not fill a stretch are ignored."""
    error = np.append(1e6 * np.ones(7), np.linspace(0, 1, 100))
    rate, _ = trend(error, duration=106.0)
    assert rate == pytest.approx(1 / 99, rel=1e-9)


# --- steps


def test_the_longest_step_is_the_stability_limit_over_the_frequency_of_the_strike() -> None:
    for name in ("verlet", "rkn6", "kahan-li6"):
        method = METHODS[name]
        assert limit(STRUCK, name) == pytest.approx(
            method.stability_limit / struck_frequency(STRUCK), rel=1e-14
        )
    grown = WEAK.replace(duration=0.1)
    step = limit(grown, "gear4")
    edge = STEEL.band_edge
    factor = METHODS["gear4"].growth(step * edge)
    assert 2 * math.log(factor) * grown.duration / step == pytest.approx(math.log(1.5), rel=1e-9)
    assert step < METHODS["gear4"].stability_limit / edge


def test_the_most_suspect_step_is_that_of_the_fastest_growth() -> None:
    method = METHODS["rkn4"]
    reaches = np.linspace(1.0, 1.02, 701) * method.stability_limit
    most = max(method.growth(reach) for reach in reaches)
    assert method.stability_limit <= suspect("rkn4") <= 1.02 * method.stability_limit
    assert math.log(method.growth(suspect("rkn4"))) == pytest.approx(math.log(most), rel=0.05)


def test_energies_are_followed_for_a_number_of_periods_of_the_band_edge() -> None:
    """The relative energy error of Verlet is below (w h)^2 / 4, and 0 at the start."""
    chain = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1e-2)
    scene = scene_of(chain, Impulse(velocity=1e-7), 1.0, 3, grains=[2])
    step = 0.1 / chain.band_edge
    run = energy_error(scene, "verlet", step, 10, samples=41)
    assert run.time.size == 41
    assert run.time[-1] == pytest.approx(20 * np.pi / chain.band_edge, rel=1e-12)
    assert 0.9 * step < run.step <= step * (1 + 1e-9)
    assert run.error[0] == 0.0
    assert 1e-4 < np.abs(run.error).max() < 0.01 / 4
    assert energy_error(scene, "verlet", step, 1).time.size == 2001


# --- predictability


def struck_column(grains: int, number: float, **keys: Any) -> Scene:
    return struck_in_units(column(grains, **keys), number, 1.0).replace(duration=1e-3)


def test_the_reflection_time_agrees_with_a_pulse_in_an_unloaded_chain() -> None:
    """The largest velocity between grains 20 and 40 of a vacuum is 0.6816 of the strike."""
    chain = Chain(grains=50, diameter=1e-3, gravity=0.0)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=1.4e-4, samples=1401)
    t = simulate(scene, "native", 1e-7)
    arrival = []
    for grain in (20, 40):
        speed = t.velocity[:, grain - 1]
        top = int(speed.argmax())
        a, b, c = speed[top - 1 : top + 2]
        arrival.append(t.time[top] + t.time[1] * (a - c) / (a - 2 * b + c) / 2)
        assert speed.max() == pytest.approx(0.0681632, rel=1e-3)
    pace = 20 / (arrival[1] - arrival[0])
    assert reflection_time(scene) == pytest.approx(2 * 50 / pace, rel=2e-4)
    upward = scene.replace(excitation=Impulse(velocity=-0.1))
    assert reflection_time(upward) == reflection_time(scene)
    with pytest.raises(
        InputError, match=r"^excitation: must be an impulse on a chain with exponent"
    ):
        reflection_time(scene.replace(excitation=Displacement(displacement=1e-9)))


def test_amplification_is_predicted_within_the_measured_limits() -> None:
    """The limits are 6 to 40 grains, strike numbers of 30 to 50 N, and Hertz's law."""
    for grains, number, known in (
        (5, 100, False),
        (6, 100, True),
        (40, 100, True),
        (41, 100, False),
        (10, 29.9, False),
        (10, 30.1, True),
        (10, 499, True),
        (10, 501, False),
    ):
        assert amplifies(struck_column(grains, number)) is known, (grains, number)
    inner = struck_column(10, 100)
    assert not amplifies(
        inner.replace(excitation=Impulse(velocity=inner.excitation.velocity, grain=2))
    )
    assert not amplifies(struck_column(10, 100, exponent=1.6))


def test_predicted_times_count_decades_from_the_rounding_error() -> None:
    scene = struck_column(10, 100)
    assert predicted_time(scene, 1e-14) == pytest.approx(0.0, abs=1e-18)
    assert predicted_time(scene, 1e-4) == pytest.approx(10 / growth_rate(scene), rel=1e-12)
    longer = struck_column(10, 100, gravity=1.0)
    shorter = reflection_time(scene) / reflection_time(longer)
    assert growth_rate(longer) / growth_rate(scene) == pytest.approx(shorter, rel=1e-12)
    rise = [
        growth_rate(s) * reflection_time(s)
        for s in (struck_column(10, 100), struck_column(20, 100), struck_column(40, 100))
    ]
    # The law is 1 - exp(-N / const).
    assert (rise[1] / rise[0] - 1) ** 2 == pytest.approx((rise[2] / rise[1] - 1), rel=1e-9)


def test_a_tolerance_is_missed_where_a_change_has_grown_tenfold_beyond_it() -> None:
    """The change of 1e-13 is ten times the effect of rounding."""
    times = np.linspace(0.0, 1.0, 11)
    apart = 1e-13 * 10.0 ** np.arange(11)
    assert predictability_time_of(times, apart, 0.99e-9) == pytest.approx(0.5, rel=1e-12)
    assert predictability_time_of(times, apart, 1.01e-9) == pytest.approx(0.6, rel=1e-12)
    assert predictability_time_of(times, apart, 1e-3) == math.inf


# --- overlaps


@pytest.mark.parametrize("strain", [1e-7, 0.9e-4, 1.1e-4, 1e-3, 0.01, 0.1, 0.5])
def test_the_excess_of_hertz_over_spheres(strain: float) -> None:
    """Sneddon's solution in 40 digits."""
    with mp.workdps(40):
        x = mp.findroot(
            lambda a: a * mp.atanh(a) - mp.mpf(strain), mp.sqrt(strain) * (1 - mp.mpf(strain) / 6)
        )
        exact = float(
            1 - ((x * x + 1) * mp.atanh(x) - x) / (mp.mpf(4) / 3 * mp.mpf(strain) ** mp.mpf(1.5))
        )
    assert float(hertz_excess(strain)) == pytest.approx(exact, rel=5e-4)


def test_the_deepest_overlap_is_that_of_all_energy_in_one_contact() -> None:
    chain = Chain(grains=3, diameter=1e-3, gravity=0.0)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.5), duration=1e-5)
    energy = chain.masses[0] * 0.125
    assert deepest(scene) == pytest.approx(
        (2.5 * energy / chain.contact_constants[0]) ** 0.4 / 1e-3, rel=1e-12
    )
    driven = Scene(chain=chain, excitation=Drive(amplitude=1e-9, frequency=1e4), duration=1e-5)
    assert deepest(driven) == np.inf


# --- linear theory


def test_strike_numbers_at_the_limit_of_linear_theory() -> None:
    scene = struck_column(20, 0.01).replace(duration=5e-5)
    assert strike_number_where(0.03, scene) == pytest.approx(
        strike_number_at(0.03, "package"), rel=1e-14
    )
    assert strike_number_at(0.69, "package") == np.inf
    assert strike_number_at(0.689, "package") < np.inf
    chain = Chain(grains=20, diameter=1e-3, gravity=0.0, top_load=1e-3)
    loaded = scene_of(chain, Impulse(velocity=1e-6, grain=4), 1e-4, 21)
    for error in (1e-3, 0.01):
        number = strike_number_where(error, loaded)
        stronger = loaded.excitation.scaled(number / loaded.strike_number)
        there = Chebyshev().look(loaded.replace(excitation=stronger).reached).error
        assert there == pytest.approx(error, rel=0.02)
    still = loaded.replace(excitation=Impulse(velocity=0.0))
    assert strike_number_where(0.01, still) == np.inf
    alien = linear_law(1e9, "velocity")  # Two fields of equal energy without correlation.
    assert alien == pytest.approx(np.sqrt(2), rel=1e-6)
    with pytest.raises(
        InputError, match=r"norm: must be one of velocity, displacement, package, peak \(got "
    ):
        linear_law(0.1, "energy")
    at_20, at_80 = (linear_law(1e-6, "peak", grain=grain) for grain in (20, 80))
    assert linear_law(1e-6, "peak") == at_20
    assert at_80 / at_20 == pytest.approx(4**-0.25, rel=1e-6)


# --- round-off


@pytest.mark.parametrize("number", [1e-4, 30.0])
def test_floors_are_those_of_engines_at_omega_h_of_0_3(number: float) -> None:
    scene = struck_column(12, number)
    steps = 100 * math.ceil(1e-5 * scene.highest_frequency / 0.3)
    speed = abs(scene.excitation.velocity)
    for options, engine in (
        ({}, Native("rkn6")),
        ({"force": "plain"}, Native("rkn6", force="plain")),
        ({"engine": "lammps"}, Lammps("rkn6")),
        ({"engine": "lammps", "diameter": "gauge"}, Lammps("rkn6", None, "gauge")),
    ):
        expected = engine.typical_round_off(scene, steps, speed)
        assert floor(scene, **options) == pytest.approx(expected, rel=1e-12)
    moved = scene.replace(excitation=Displacement(displacement=1e-3 * scene.chain.length_scale))
    speed = 1e-3 * scene.chain.length_scale * moved.highest_frequency
    steps = 100 * math.ceil(1e-5 * moved.highest_frequency / 0.3)
    assert floor(moved) == pytest.approx(
        Native("rkn6").typical_round_off(moved, steps, speed), rel=1e-12
    )
    still = scene.replace(excitation=Impulse(velocity=0.0))
    speed = scene.chain.length_scale / scene.chain.time_scale
    steps = 100 * math.ceil(1e-5 * still.highest_frequency / 0.3)
    assert floor(still) == pytest.approx(
        Native("rkn6").typical_round_off(still, steps, speed), rel=1e-12
    )


# --- warnings before a run


def test_warnings_state_their_numbers() -> None:
    longest = 0.7 * limit(STRUCK, "verlet")
    assert not list(pre_run_warnings(STRUCK, Native("verlet", 0.999 * longest), 0.5))
    (text,) = pre_run_warnings(STRUCK, Native("verlet", 1.01 * longest), 0.5)
    assert text == (
        f"step: {1.01 * longest:.3g} s is stable at rest, but may be unstable while contacts are "
        f"compressed by the strike: use a step below {longest:.3g} s"
    )
    refused = Native("verlet", 2.01 / STEEL.band_edge)
    assert not list(pre_run_warnings(STRUCK, refused, 0.5))
    assert not list(pre_run_warnings(WEAK, Native("verlet", 1.99 / STEEL.band_edge), 0.5))
    bouncing = STRUCK.replace(duration=0.02)
    end = predicted_time(bouncing, 1e-6)
    (text,) = pre_run_warnings(bouncing, None, 1e-6)
    assert text == (
        f"duration: opening contacts amplify rounding errors beyond 1e-06 at about {end:.2g} s; "
        "the later motion is unpredictable"
    )
    assert not list(pre_run_warnings(bouncing.replace(duration=0.99 * end), None, 1e-6))
    assert len(list(pre_run_warnings(bouncing.replace(duration=1.01 * end), None, 1e-6))) == 1


def test_warnings_about_deep_overlaps_state_the_error_of_hertz() -> None:
    chain = Chain(grains=8, material="ptfe", diameter=5e-3 * 0.7 ** np.arange(8), gravity=0.0)
    texts = {}
    for speed in (0.1, 3.0):
        scene = Scene(chain=chain, excitation=Impulse(velocity=speed), duration=1e-4, samples=11)
        texts[speed] = list(pre_run_warnings(scene, None, 1e-6))
        deep = deepest(scene)
    assert not texts[0.1]
    excess = 100 * float(hertz_excess(min(deep, 0.5)))
    assert texts[3.0] == [
        f"contacts may be compressed by {100 * deep:.2g} % of the diameter: "
        f"Hertz's law then has an error of {excess:.2g} % or more"
    ]


# --- displayed results


def shown() -> Stability:
    rows = (
        Boundary("longest step", "native verlet", "s", 2e-6, 1.9e-6),
        Boundary("longest step", "native rkn6", "s", 5e-6, math.inf),
        Boundary("smallest error", "native", "", 1e-15),
        Boundary("predictable to 1e-6 until", "any", "s", 4e-4, 5e-4, 1e-3, True),
    )
    x = np.array([0.0, 1e-4, 1e-3])
    curves = (
        Curve("energy", "verlet", x, np.array([0.0, 1e-5, 0.0])),
        Curve("growth", "", x, np.array([1e-13, 1e-9, np.inf])),
        Curve("strength", "Eq. (3), estimate", x, np.array([1e-3, 1e-2, 1e-1])),
        Curve("strength", "lammps, physical diameter, round-off", x, np.array([1e-9, 1e-10, 0.0])),
        Curve("strength", "lammps, gauge diameter, round-off", x, np.array([1e-10, 1e-11, 1e-12])),
    )
    return Stability(STRUCK, rows, curves, ("overlap: too long",))


def test_the_table_marks_exceeded_limits() -> None:
    lines = shown().table().splitlines()
    assert lines[0].split() == ["predicted", "measured", "this", "scene"]
    assert [line.startswith("!") for line in lines[1:]] == [False, False, False, True]
    assert lines[1].split() == ["longest", "step", "native", "verlet", "2e-06", "s", "1.9e-06", "s"]
    assert lines[2].split()[-3:] == ["5e-06", "s", "none"]
    assert lines[4].split()[-6:] == ["0.0004", "s", "0.0005", "s", "0.001", "s"]
    written = shown().to_json()
    assert written["rows"][1]["measured"] is None
    assert written["rows"][0] == {
        "what": "longest step",
        "method": "native verlet",
        "unit": "s",
        "predicted": 2e-6,
        "measured": 1.9e-6,
        "here": None,
        "beyond": False,
    }
    assert written["curves"][1]["y"] == [1e-13, 1e-9, None]
    assert written["curves"][0] == {
        "panel": "energy",
        "name": "verlet",
        "x": [0.0, 1e-4, 1e-3],
        "y": [0.0, 1e-5, 0.0],
    }
    assert written["left_out"] == ["overlap: too long"]


def lines_of(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axes.get_lines()}


def test_the_four_panels_contain_the_numbers() -> None:
    panels = Figure().subplots(2, 2).ravel()
    assert shown().plot(panels) is panels[0]
    steps, energy, growth, strength = panels
    marks = lines_of(steps)
    assert list(marks["predicted"].get_xdata()) == [5e-6, 2e-6]
    assert list(marks["measured"].get_xdata()) == [math.inf, 1.9e-6]
    assert list(marks["measured"].get_ydata()) == [0, 1]
    assert [label.get_text() for label in steps.get_yticklabels()] == [
        "native rkn6",
        "native verlet",
    ]
    assert steps.get_xlabel() == "longest step before a run of this duration breaks down"
    ticks = {f"{tick:.0e}" for tick in steps.xaxis.get_major_locator().tick_values(1e-6, 9e-6)}
    assert {"1e-06", "2e-06", "5e-06"} <= ticks
    assert not {"3e-06", "4e-06", "6e-06"} & ticks
    assert all(line.get_visible() for line in steps.get_xgridlines())
    drawn = lines_of(energy)["verlet"]
    assert drawn.get_xdata().tolist() == [1e-4, 1e-3]
    assert drawn.get_ydata().tolist() == [1e-5, 1e-17]
    assert (energy.get_xlabel(), energy.get_ylabel()) == ("time", "relative error of the energy")
    assert growth.get_lines()[0].get_ydata().tolist() == [1e-13, 1e-9, np.inf]
    levels = [line.get_ydata()[0] for line in growth.get_lines()[1:4]]
    assert levels == [1e-3, 1e-6, 1e-9]
    assert [text.get_text() for text in growth.texts] == ["0.001", "$10^{-6}$", "$10^{-9}$"]
    assert [text.xy for text in growth.texts] == [(1, level) for level in levels]
    assert {text.get_position() for text in growth.texts} == {(-2, 2)}
    assert growth.get_ylim()[1] == 10.0
    ends = lines_of(growth)
    assert list(ends["predictable to $10^{-6}$, predicted"].get_xdata()) == [4e-4, 4e-4]
    assert list(ends["predictable to $10^{-6}$, measured"].get_xdata()) == [5e-4, 5e-4]
    assert growth.get_ylabel() == "distance / largest value"
    curves = lines_of(strength)
    assert curves["Eq. (3), estimate"].get_linestyle() == "-"
    assert curves["lammps, physical diameter, round-off"].get_linestyle() == "--"
    assert curves["lammps, gauge diameter, round-off"].get_linestyle() == ":"
    assert curves["lammps, physical diameter, round-off"].get_ydata().tolist() == [
        1e-9,
        1e-10,
        1e-17,
    ]
    assert list(strength.get_lines()[-1].get_xdata()) == [1.0, 1.0]
    (said,) = strength.texts
    assert (said.get_text(), said.xy, said.get_position()) == ("this scene", (1.0, 0.6), (-4, 0))
    assert strength.get_xlabel() == "strength of the strike, over that of the scene"
    assert strength.get_ylabel() == "relative error"
    for axes, scales in (
        (steps, ("log", "linear")),
        (energy, ("log", "log")),
        (growth, ("linear", "log")),
        (strength, ("log", "log")),
    ):
        assert (axes.get_xscale(), axes.get_yscale()) == scales
        assert axes.get_legend() is not None
    alone = Figure().subplots()
    assert shown().plot(alone) is alone
    assert len(shown().plot().figure.axes) == 4


def test_times_far_after_the_end_are_not_drawn() -> None:
    for late, count in ((1.19e-3, 1), (1.21e-3, 0)):
        row = Boundary("predictable to 1e-6 until", "any", "s", late, math.inf, 1e-3)
        axes = Figure().subplots(2, 2).ravel()
        Stability(STRUCK, (row,), (), ()).plot(axes)
        assert len(axes[2].get_lines()) == 3 + count
        assert all(each.get_legend() is None for each in axes[[1, 3]])


# --- all limits, predicted only


def test_long_measurements_are_replaced_by_predictions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(find, "LONGEST_S", 0.0)
    result = find.stability(STRUCK)
    steps = {row.method: row for row in result.boundaries if row.what == "longest step"}
    assert list(steps) == [*(f"native {name}" for name in METHODS), "lammps verlet"]
    for name in METHODS:
        assert steps[f"native {name}"].predicted == limit(STRUCK, name)
    assert all(math.isnan(row.measured) for row in result.boundaries)
    assert all(row.unit == "s" for row in steps.values())
    floors = {
        row.method: row.predicted for row in result.boundaries if row.what == "smallest error"
    }
    assert floors == {
        "native": floor(STRUCK),
        "lammps, physical diameter": floor(STRUCK, "lammps"),
        "lammps, gauge diameter": floor(STRUCK, "lammps", "gauge"),
    }
    (until,) = (row for row in result.boundaries if row.what == "predictable to 1e-6 until")
    assert until.predicted == predicted_time(STRUCK, 1e-6)
    assert (until.here, until.beyond, until.unit) == (1e-3, False, "s")
    linear = {row.what: row for row in result.boundaries if row.what.startswith("linear theory")}
    assert list(linear) == ["linear theory 1 % off at v0*", "linear theory 10 % off at v0*"]
    for row, error in zip(linear.values(), (0.01, 0.1), strict=True):
        assert row.predicted == strike_number_where(error, STRUCK)
        assert (row.here, row.beyond, row.method) == (STRUCK.strike_number, True, "Eq. (3)")
    (deep,) = (row for row in result.boundaries if row.what == "Hertz's law: overlap over diameter")
    assert (deep.predicted, deep.here, deep.beyond) == (0.1, deepest(STRUCK), False)
    said = "too many to follow the energy for a thousand periods"
    assert list(result.left_out) == [f"energy, {name}: {said}" for name in METHODS]
    curves = {curve.name: curve for curve in result.curves}
    strengths = 10.0 ** np.arange(-8, 3)
    assert curves["native, round-off"].x == pytest.approx(strengths, rel=1e-12)
    weaker = [STRUCK.replace(excitation=STRUCK.excitation.scaled(factor)) for factor in strengths]
    assert curves["native, round-off"].y == pytest.approx(
        [floor(scene) for scene in weaker], rel=1e-9
    )
    looks = [Chebyshev().look(scene.reached) for scene in weaker]
    assert curves["Eq. (3), estimate"].y == pytest.approx([look.error for look in looks], rel=1e-9)
    assert curves["Eq. (3), at most"].y == pytest.approx([look.at_most for look in looks], rel=1e-9)
    assert {curve.panel for curve in result.curves} == {"strength"}


def test_the_expected_time_is_that_of_runs_and_followed_periods() -> None:
    """A search takes 60 runs at the limit; energies are followed for 1000 periods of 40 steps."""
    for scene in (STRUCK, *(WEAK.replace(duration=time) for time in (1e-2, 100.0))):
        expected = 0.0
        for name, method in METHODS.items():
            costs = [Native().seconds_per_grain_step]
            if name == "verlet":
                costs.append(Lammps().seconds_per_grain_step)
            work = 12 * method.evaluations
            searches = [60 * scene.duration / limit(scene, name) * work * cost for cost in costs]
            follow = 40_000 * work * costs[0]
            expected += sum(time for time in (*searches, follow) if time < find.LONGEST_S)
        said = rf"the search for the limits would take about {re.escape(in_words(expected))}$"
        with budget(0.9999 * expected), pytest.raises(TooLong, match=said):
            find.stability(scene)


def test_missing_predictions_state_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(find, "LONGEST_S", 0.0)
    vacuum = scene_of(Chain(grains=5, diameter=1e-3, gravity=0.0), Impulse(velocity=0.1), 1e-4)
    texts = find.stability(vacuum).left_out
    assert "energy, verlet: a chain without gravity and load has no band edge" in texts
    assert any(line.startswith("linear theory: without gravity and load") for line in texts)
    for scene, message in (
        (None, "scene: must be a Scene"),
        (WEAK.replace(chain=STEEL.replace(damping={"drag": 1.0})), "does not support damping"),
        (WEAK.replace(chain=STEEL.replace(ground=Law("k*u", k=1.0))), "a force from the ground"),
    ):
        with pytest.raises(InputError, match=message):
            find.stability(scene)
    result = find.stability(DRIVEN)
    assert (
        "energy, verlet: the energy is not conserved, because the excitation does work"
        in result.left_out
    )
    (deep,) = (row for row in result.boundaries if row.what.startswith("Hertz"))
    assert (deep.here, deep.beyond) == (math.inf, False)


@pytest.mark.parametrize(("level", "beyond"), [(1e-3, True), (1e-9, False)])
def test_a_scene_is_beyond_its_predictability_horizon_if_its_runs_separate(
    level: float, beyond: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.linspace(0, DRIVEN.duration, 11)
    apart = np.where(times < 0.45 * DRIVEN.duration, 1e-12, level)
    monkeypatch.setattr(find, "growth", lambda scene: (times, apart))
    monkeypatch.setattr(find, "blow_up", lambda *_: 2e-6)
    rows = {(row.what, row.method): row for row in find.stability(DRIVEN).boundaries}
    boundary = rows["predictable to 1e-6 until", "any"]
    assert boundary.beyond == beyond
    assert boundary.here == DRIVEN.duration
    assert boundary.measured == pytest.approx(times[5] if beyond else math.inf, rel=1e-12)
    assert rows["longest step", "native verlet"].measured == 2e-6
