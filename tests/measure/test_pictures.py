"""Pictures of measured quantities: lines, maps, labels, scales and units."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from matplotlib.collections import PolyCollection
from matplotlib.ticker import LogLocator

from lmpchain import Chain, Impulse, Profile, simulate
from lmpchain.measure.contact import ContactHistory, Signal
from lmpchain.measure.fit.column import ContinuumFit, ExponentFit, FrontLaw
from lmpchain.measure.fit.inverse import ParameterFit, Trace
from lmpchain.measure.fit.solitary import SolitonFit
from lmpchain.measure.fit.table import FittedNumber
from lmpchain.measure.fit.waves import BesselFit, ModeFit
from lmpchain.measure.front import Exponents, Front, PowerLaw
from lmpchain.measure.spectrum import (
    Dispersion,
    Spectrum,
    cut_off,
    space_time,
    spectrum,
    travel_time,
)
from lmpchain.util.plotting import figure

RNG = np.random.default_rng(4)


def labels(axes: Any) -> list[str]:
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else []


def assert_lines(axes: Any, *expected: tuple[Any, Any]) -> None:
    """Check the first lines of axes: x and y of each."""
    assert len(axes.lines) >= len(expected)
    for line, (x, y) in zip(axes.lines, expected, strict=False):
        assert line.get_xdata() == pytest.approx(np.asarray(x), rel=1e-12)
        assert line.get_ydata() == pytest.approx(np.asarray(y), rel=1e-12, abs=1e-14)


def colours(image: Any, shape: tuple[int, int]) -> np.ndarray:
    return np.ma.getdata(image.get_array()).reshape(shape)


# --- contacts


def history(contact: list[int]) -> ContactHistory:
    """Return synthetic forces of contacts at five times, 1 us apart."""
    force = np.abs(RNG.normal(size=(5, len(contact)))) + 1
    none = np.zeros(force.shape)
    return ContactHistory(np.arange(5) * 1e-6, np.array(contact), none, none, force, force - 1.5)


@pytest.mark.parametrize("above_rest", [False, True])
def test_forces_of_up_to_six_contacts_are_lines(above_rest: bool):
    few = history([3, 1, 9, 5, 7, 2])
    axes = few.plot(above_rest=above_rest)
    values = few.change if above_rest else few.force
    assert_lines(axes, *((few.time, values[:, k]) for k in range(6)))
    assert labels(axes) == [f"contact {n}" for n in (3, 1, 9, 5, 7, 2)]
    assert axes.get_ylabel() == ("contact force above rest" if above_rest else "contact force")


@pytest.mark.parametrize("above_rest", [False, True])
def test_forces_of_more_contacts_are_a_map(above_rest: bool):
    many = history([3, 1, 9, 5, 7, 2, 8])
    axes = many.plot(above_rest=above_rest)
    values = many.change if above_rest else many.force
    order = [1, 5, 0, 3, 4, 6, 2]  # Row order by contact number: 1, 2, 3, 5, 7, 8, 9.
    assert not axes.lines
    (image,) = axes.images or axes.collections
    assert np.array_equal(colours(image, (7, 5)), values.T[order])
    assert axes.get_ylim() == (9.5, 0.5)
    assert axes.get_xlim() == pytest.approx((-0.5e-6, 4.5e-6))
    bar = axes.figure.axes[1]
    assert bar.get_ylabel() == ("contact force above rest" if above_rest else "contact force")
    if above_rest:
        limit = np.median(np.abs(values).max(0))
        assert (image.norm.vmin, image.norm.vmax) == pytest.approx((-limit, limit))
        assert image.get_cmap().name == "RdBu_r"
    else:
        assert (image.norm.vmin, image.norm.vmax) == (values.min(), values.max())
        assert image.get_cmap().name == "cividis"


def test_the_signal_of_a_sensor():
    signal = Signal(4, np.arange(5) * 1e-6, np.arange(5.0), np.arange(5.0) - 1)
    axes = signal.plot()
    assert_lines(axes, (signal.time, signal.force))
    assert labels(axes) == ["grain 4"]


# --- spectra


def test_a_spectrum_over_frequency_and_depth():
    """The logarithmic map has three decades, with the edges of two bands around each grain."""
    bands = np.array([[[0, 10], [20, 30.0]], [[0, 11], [22, 33.0]], [[0, 12], [24, 36.0]]])
    amplitude = 10.0 ** RNG.uniform(-5, 0, (21, 3))
    shown = Spectrum("velocity", np.arange(21) * 5.0, np.array([2, 3, 5]), bands, amplitude)
    axes = shown.plot()
    grain = [2, 3, 5]
    assert_lines(axes, ([30, 33, 36], grain), ([10, 11, 12], grain), ([20, 22, 24], grain))
    assert labels(axes) == ["local cut-off", "gap between branches"]
    assert [line.get_linestyle() for line in axes.lines] == ["-", "--", "--"]
    (image,) = axes.images or axes.collections
    largest = amplitude.max()
    values = np.maximum(amplitude.T, largest / 1e3)
    assert colours(image, (3, 21)) == pytest.approx(values, rel=1e-12)
    assert (image.norm.vmin, image.norm.vmax) == pytest.approx((largest / 1e3, largest))
    assert axes.get_ylim() == (6, 1.5)
    assert axes.get_xlim() == pytest.approx((0, 54))
    assert axes.figure.axes[1].get_ylabel() == "velocity (m/s per Hz)"
    assert shown.cut_off.tolist() == [30, 33, 36]
    high = Spectrum(
        "displacement", np.arange(21) * 1.0, np.array([2, 3, 5]), bands, amplitude
    ).plot()
    assert high.get_xlim() == pytest.approx((0, 20)), "no further than what was recorded"
    assert high.figure.axes[1].get_ylabel() == "displacement (m per Hz)"
    none = Spectrum(
        "velocity", np.arange(21) * 5.0, np.array([2, 3, 5]), 0 * bands[:, :1], 0 * amplitude
    ).plot()
    assert not none.lines
    assert none.get_xlim() == pytest.approx((0, 100))


def test_a_spectrum_over_wavenumber_and_frequency():
    frequency = np.arange(9) * 5.0
    wavenumber = np.linspace(-3, 2, 6)
    amplitude = 10.0 ** RNG.uniform(-5, 0, (9, 6))
    relation = RNG.uniform(1, 10, (3, 2, 6))
    shown = Dispersion(
        "displacement", frequency, wavenumber, amplitude, np.array([4, 7, 11]), relation
    )
    axes = shown.plot()
    assert_lines(axes, *((wavenumber, branch) for branches in relation for branch in branches))
    assert [line.get_linestyle() for line in axes.lines] == [":", ":", "-", "-", "--", "--"]
    assert labels(axes) == ["grain 4", "grain 7", "grain 11"]
    assert axes.get_legend().get_title().get_text() == "local relation"
    (image,) = axes.images or axes.collections
    values = np.maximum(amplitude, amplitude.max() / 1e3)
    assert colours(image, (9, 6)) == pytest.approx(values, rel=1e-12)
    assert axes.get_ylim() == pytest.approx((0, 1.5 * relation.max()))
    assert axes.get_xlim() == pytest.approx((-3.5, 2.5))
    assert axes.figure.axes[1].get_ylabel() == "displacement (m per Hz)"
    assert np.array_equal(shown.ridge, frequency[amplitude.argmax(0)])
    high = Dispersion(
        "velocity", frequency / 10, wavenumber, amplitude, np.array([4, 7, 11]), relation
    ).plot()
    assert high.get_ylim() == pytest.approx((0, 4))
    none = Dispersion(
        "velocity", frequency, wavenumber, amplitude, np.array([4, 7, 11]), 0 * relation
    ).plot()
    assert not none.lines
    assert none.get_ylim() == pytest.approx((0, 40))


@pytest.mark.parametrize("grains", ["all", [2, 9, 7], [4]], ids=["all", "some", "one"])
def test_the_motion_over_time_and_depth(grains: Any):
    chain = Chain(grains=12, diameter=1e-3)
    scene = scene_of(chain, Impulse(velocity=1e-6, grain=3), 1e-4, 41, grains=grains)
    t = simulate(scene, "native", 1e-4)
    axes = space_time(t, "displacement", law=True)
    (line,) = axes.lines
    assert np.array_equal(line.get_xdata(), travel_time(chain, 3))
    assert line.get_ydata().tolist() == list(range(1, 13))
    assert labels(axes) == ["long weak wave"]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    (shown,) = axes.images or axes.collections
    assert colours(shown, (t.grains.size, 41)) == pytest.approx(
        t.displacement[:, np.argsort(t.grains)].T, rel=1e-6
    )
    assert axes.figure.axes[1].get_ylabel() == "displacement, downward"
    assert not space_time(t).lines
    assert spectrum(t).plot().lines[0].get_xdata() == pytest.approx(
        cut_off(chain)[np.sort(t.grains) - 1]
    )


def test_pictures_without_motion():
    scene = scene_of(Chain(grains=12, diameter=1e-3), Profile(velocity=np.zeros(12)), 1e-4)
    still = simulate(scene, "native", 1e-6)
    spectrum(still).plot().figure.draw_without_rendering()
    space_time(still)


# --- fronts


def a_front(grain: Any, time: Any) -> Front:
    n = np.asarray(grain)
    up = np.full(n.size, -2e-3) / n
    one = np.ones(n.size)
    return Front("velocity", n, n * 1e-3, np.asarray(time), up, n * 1e-6, one, one, one)


def test_a_front_against_depth():
    n = np.arange(1, 9)
    front = a_front(n, 1e-6 * n**1.5)
    speed = 1e-3 / np.gradient(1e-6 * n**1.5, n.astype(float), edge_order=2)
    for quantity, values, label in (
        ("amplitude", 2e-3 / n, "amplitude of the front (m/s)"),
        ("time", 1e-6 * n**1.5, "time of the front (s)"),
        ("width", 1e-6 * n, "width of the front (s)"),
        ("speed", speed, "speed of the front (m/s)"),
    ):
        axes = front.plot(quantity=quantity)
        assert_lines(axes, (n - 0.5, values))
        assert (axes.get_ylabel(), axes.get_xlabel()) == (label, "depth h = n − 1/2 (grains)")
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert axes.xaxis.get_major_formatter()(20.0) == "20"
        # Only the times differ by more than a decade.
        assert isinstance(axes.yaxis.get_major_locator(), LogLocator) == (quantity == "time")
    assert_lines(front.plot(), (n - 0.5, 2e-3 / n))
    assert_lines(front.between(9, 10).plot(), ([], []))


def test_local_exponents_and_a_power_law():
    depth = np.array([2.0, 4, 8])
    error = np.array([0.1, 0.2, 0.3])
    axes = Exponents("speed", depth, np.array([-0.3, -0.2, -0.25]), error, error).plot()
    assert_lines(axes, (depth, [-0.3, -0.2, -0.25]))
    bars = np.array([segment[:, 1] for segment in axes.collections[0].get_segments()])
    assert bars == pytest.approx(np.array([[-0.4, -0.2], [-0.4, 0.0], [-0.55, 0.05]]), abs=1e-12)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    law = PowerLaw("what", depth, np.array([3.0, 2, 1]), "m", 0.5, error, -0.75, 4.0, 0.25)
    curve = 4 * depth**-0.75 * (1 + 0.25 / depth**0.5)
    axes = law.plot()
    assert_lines(axes, (depth, law.values), (depth, curve))
    assert law.residual == pytest.approx(law.values / curve - 1, rel=1e-12)
    assert labels(axes) == ["exponent −0.7500 ± 0.1000, corrected for finite depth"]
    assert axes.get_yscale() == "log"


# --- fits


def test_the_continuum_and_the_law_of_the_front():
    depth = np.array([2.0, 4, 8])
    time = np.array([3.0, 5, 9])
    law = FrontLaw(
        depth,
        time,
        np.array([0.5, 0.6, 0.7]),
        1.0,
        0.8,
        1.25,
        0.5,
        np.array([0.02, 0.03, 0.1]),
        np.array([5 / 6, 1.2]),
    )
    rows = [
        FittedNumber("continuum", "exponent of the front", 0.8, 0.02, 5 / 6),
        FittedNumber("continuum", "factor of the front", 1.25, 0.03, 1.2),
    ]
    assert list(law.rows()) == rows
    curve = 1.25 * depth**0.8 * (1 + 0.5 / depth)
    axes = law.plot()
    assert_lines(axes, (depth, time), (depth, time - law.shift), (depth, curve))
    assert law.residual == pytest.approx((time - law.shift) / curve - 1, rel=1e-12)
    assert labels(axes)[2] == "1.2500 $h^{0.8000}$, expected 1.2000 $h^{0.8333}$"
    assert labels(axes)[:2] == ["largest velocity", "less the lag of the grains"]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    cone = np.array([100.0, 400, 900])
    values = np.array([0.7, 0.6, 0.5])
    fit = ContinuumFit(1.15, 0.02, 1.155, 0.1, np.array([1, 2, 2]), cone, values, values, 0.1, law)
    names = ["amplitude C of Eq. (35)", *(row.quantity for row in rows), "residual"]
    assert [row.quantity for row in fit.rows()] == names
    first, *_, last = replace(fit, front=None).rows()
    assert (first.value, first.error, first.expected) == (1.15, 0.02, 1.155)
    assert (last.value, last.expected) == (0.1, 0.0)
    axes = fit.plot()
    relative = values * cone**0.1 / 1.155 - 1
    fitted = 1.15 / 1.155 - 1
    assert_lines(axes, (cone, relative), ([0, 1], [fitted, fitted]), ([0, 1], [0, 0]))
    assert labels(axes) == ["samples of 2 grains", "C = 1.15 ± 0.02", "Eq. (35): 1.155"]
    assert axes.get_xscale() == "log"


def test_exponents_relative_to_those_of_a_weak_wave():
    laws = {
        name: PowerLaw(
            name, np.ones(1), np.ones(1), "", 1.0, np.array([error, 1, 1]), power, 1.0, 0.0
        )
        for name, power, error in (("velocity", -0.25, 0.01), ("time", 0.8, 0.02))
    }
    depth = np.array([20.0, 40.0])
    error = np.array([0.03, 0.02])
    local = {"velocity": Exponents("amplitude", depth, np.array([-0.2, -0.22]), error, error)}
    theory = {"velocity": -4 / 15, "time": 5 / 6}
    weak = ExponentFit(laws, theory, local, np.array([14, 46]), np.array([0.2, 0.1]))
    rows = [
        FittedNumber("exponents", "strength at grain 46", 0.1),
        FittedNumber("exponents", "velocity near grain 40", -0.22, 0.02, -4 / 15),
        FittedNumber("exponents", "velocity at great depth", -0.25, 0.01, -4 / 15),
        FittedNumber("exponents", "time at great depth", 0.8, 0.02, 5 / 6),
    ]
    assert list(weak.rows()) == rows
    axes = weak.plot()
    above = local["velocity"].exponent + 4 / 15
    curve = next(line for line in axes.lines if line.get_label() == "velocity")
    assert curve.get_xydata() == pytest.approx(np.stack([depth, above], axis=1), rel=1e-14)
    points = [line for line in axes.lines if line.get_marker() == "o"]
    heights = [4 / 15 - 0.25, 0.8 - 5 / 6]
    assert [point.get_ydata()[0] for point in points] == pytest.approx(heights, abs=1e-12)
    assert [point.get_xdata()[0] for point in points] == pytest.approx([48, 1.06 * 48])
    assert axes.lines[0].get_ydata() == [0, 0]
    (band,) = (shape for shape in axes.collections if isinstance(shape, PolyCollection))
    edges = band.get_paths()[0].vertices
    for place, height, off in zip(depth, above, error, strict=True):
        ends = edges[edges[:, 0] == place, 1]
        assert (ends.min(), ends.max()) == pytest.approx((height - off, height + off), rel=1e-12)
    assert len({point.get_color() for point in points}) == 2
    assert labels(axes) == ["law of weak waves", "velocity"]
    # A strong wave has no law of great depth.
    strong = ExponentFit(laws, theory, local, np.array([14, 46]), np.array([9.0, 5.0]))
    assert list(strong.rows()) == [replace(rows[0], value=5.0), rows[1]]
    axes = strong.plot()
    assert not [line for line in axes.lines if line.get_marker() == "o"]
    assert "no law of great depth: the wave is still strong" in str(strong)
    assert "great depth " not in str(strong)
    assert "velocity near grain 40" in str(strong)


@pytest.mark.parametrize(
    ("exponents", "error", "verdict"),
    [
        ([-0.2, -0.21, -0.22], (0.015, 1, 0.004), "towards the law of weak waves"),
        ([-0.2, -0.21, -0.22], (0.004, 0, 0.017), "towards no law within these grains"),
        ([-0.26, -0.2, -0.264], (0.001, 0, 0.005), "on the law of weak waves"),
        ([-0.1, -0.2, -0.04], (0.01, 1, 0.01), "towards the law of a solitary wave without load"),
        ([0.1, 0.5, 0.001], (0, 0, 0.01), "on the law of a solitary wave without load"),
        ([0.1, 0.0, 0.2], (0.01, 0, 0.01), "towards no law within these grains"),
    ],
)
def test_the_approached_law(exponents: list[float], error: tuple[float, ...], verdict: str):
    """The first and the last exponent count, each with its own error."""
    depth = np.array([20.0, 30.0, 40.0])
    local = Exponents("amplitude", depth, np.array(exponents), np.array(error), depth)
    fit = ExponentFit({}, {"velocity": -4 / 15}, {"velocity": local})
    assert fit.approach("velocity") == verdict


def test_the_energies_of_modes():
    frequency = 2 * np.pi * np.array([1e3, 2e3])
    time = np.arange(3) * 1e-3
    none = np.zeros((3, 2))
    energy = np.array([3.0, 1.0])
    error = np.array([0.4, 0.2])
    fit = ModeFit(frequency, time, none, none, energy, error, np.array([0.0, 0.02, 0.01]))
    assert fit.share.tolist() == [0.75, 0.25]
    assert fit.share_error == pytest.approx(np.array([0.1, 0.05]), rel=1e-14)
    axes = fit.plot()
    assert_lines(axes, ([1e3, 2e3], [75, 25]))
    bars = np.array([segment[:, 1] for segment in axes.collections[0].get_segments()])
    assert bars == pytest.approx(np.array([[65, 85], [20, 30]]), abs=1e-9)
    assert axes.get_title("left") == "Linear motion from t = 0: off by at most 0.02"
    over_time = fit.plot(what="residual")
    assert_lines(over_time, (time, fit.residual))
    still = ModeFit(frequency, time, none, none, 0 * energy, 0 * error, np.zeros(3))
    assert not still.share.any()
    assert not still.share_error.any()


def test_a_wave_of_bessel_functions():
    """The picture shows four of the grains with more than 5 % of the largest value."""
    grain = np.repeat(np.arange(1, 12), 3)
    time = np.tile(np.arange(3) * 1e-6, 11)
    size = np.where(np.arange(1, 12) <= 10, np.linspace(1, 0.06, 11), 0.04)
    values = (size[:, None] * np.array([0.1, -1.0, 0.5])).ravel()
    fit = BesselFit(
        "displacement",
        3,
        1.0,
        2e6,
        5e-7,
        1.2,
        np.array([1, 1, 1, 0.03]),
        np.eye(3),
        np.ones(4),
        grain,
        time,
        values,
        2 * values,
        0.125,
    )
    axes = fit.plot()
    chosen = [1, 4, 7, 10]
    rows = [grain == number for number in chosen]
    assert_lines(
        axes,
        *(
            pair
            for row in rows
            for pair in ((time[row], values[row]), (time[row], 2 * values[row]))
        ),
    )
    assert labels(axes) == [f"grain {number}" for number in chosen]
    assert all(axes.lines[k].get_color() == axes.lines[k + 1].get_color() for k in (0, 2, 4, 6))
    assert axes.get_title("left") == "kappa 1.2 ± 0.03, residual 0.12 (lines)"
    for number in (1, 43):  # The arrival is at 2 s = m + 0.8086 m^(1/3) with m = 2 |n - p|.
        m = 2 * abs(number - 3)
        assert fit.front_time(number) == pytest.approx(
            5e-7 + (m + 0.8086 * m ** (1 / 3)) / 4e6, rel=1e-12
        )


@pytest.mark.parametrize("loaded", [False, True])
def test_a_solitary_wave(loaded: bool):
    grain = np.array([5, 7, 8, 10])
    time = np.array([1.0, 2.1, 2.5, 3.4]) * 1e-5
    velocity = np.array([1.01, 0.99, 1.0, 1.02])
    wave: Any = SimpleNamespace(loaded=loaded)
    fit = SolitonFit(
        grain,
        time,
        velocity,
        1.005,
        2e5,
        1.6,
        np.ones(3),
        wave,
        np.array([1.0, 2.1e5, 1.58]),
        2.2e5,
    )
    axes = fit.plot()
    local = 1 / np.gradient(time, grain.astype(float))
    assert_lines(
        axes,
        (grain, np.abs(velocity / 1.005 - 1)),
        (grain, np.abs(local / 2.1e5 - 1)),
        ([0, 1], [2.2 / 2.1 - 1] * 2),
    )
    name = "Coste" if loaded else "Nesterenko"
    assert labels(axes)[2] == f"speed by {name}'s formula"
    assert labels(axes)[0] == "largest velocity, over its mean"
    assert (axes.get_yscale(), axes.get_ylabel()) == ("log", "|relative difference|")


@pytest.mark.parametrize(
    ("field", "label"), [("velocity", "velocity, downward"), ("force", "force above rest")]
)
def test_a_fitted_parameter(field: Any, label: str):
    """The picture shows four traces, from the first to the last, and the fit to each."""
    time = np.arange(4) * 1e-6
    values = RNG.normal(size=(4, 7))
    trace = Trace(time, [1, 2, 3, 4, 5, 6, 8], values, field)
    scene: Any = None
    fit = ParameterFit("youngs_modulus", 62.1234e9, 1.24e8, trace, 2 * values, 0.1, scene, 20)
    axes = fit.plot()
    columns = [0, 2, 4, 6]
    pairs = [pair for k in columns for pair in ((time, values[:, k]), (time, 2 * values[:, k]))]
    assert_lines(axes, *pairs)
    assert len(axes.lines) == 8
    assert labels(axes) == ["grain 1", "grain 3", "grain 5", "grain 8"]
    assert all(axes.lines[k].get_color() == axes.lines[k + 1].get_color() for k in (0, 2, 4, 6))
    assert axes.get_title("left") == "Young's modulus 62.1 ± 0.1 GPa (lines)"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time", label)
    assert axes.yaxis.get_major_formatter()(2e-3) == ("2 mN" if field == "force" else "2 mm/s")
    mine = figure().subplots()
    load = ParameterFit("top_load", 0.05, 1.2e-3, trace, values, 0.1, scene, 20).plot(mine)
    assert load is mine
    assert mine.get_title("left") == "top load 50 ± 1 mN (lines)"
