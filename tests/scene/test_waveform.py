"""Waveforms against their definitions in 30 digits, and their bounds against quadrature."""

import re
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from helpers.faults import faults
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from lmpchain import Force
from lmpchain.scene.waveform import Waveform

AMPLITUDE = -2.5
FREQUENCY = 3.0
CYCLES = [None, 0.5, 0.9, 2.3, 7.0]
KNOTS = np.array([0.0, 0.3, 0.4, 0.9, 1.5, 1.7])
VALUES = np.array([0.5, -1.0, 2.0, 0.3, -0.7, 0.1])


def definition(cycles: float | None) -> Callable[[Any], Any]:
    def value(t: Any) -> Any:
        hann = 1 if cycles is None else mp.sin(mp.pi * FREQUENCY * t / mp.mpf(cycles)) ** 2
        return AMPLITUDE * mp.sin(2 * mp.pi * FREQUENCY * t) * hann

    return value


@pytest.mark.parametrize("cycles", CYCLES)
def test_values_and_derivatives_agree_with_the_definition(cycles: float | None) -> None:
    wave = Waveform.sine(AMPLITUDE, FREQUENCY, cycles)
    times = np.linspace(0.003, 0.99 * min(wave.end, 1.0), 9)
    for order in range(4):
        with mp.workdps(30):
            exact = [float(mp.diff(definition(cycles), mp.mpf(t), order)) for t in times.tolist()]
        slack = 1e-12 * np.abs(exact).max()
        assert wave.at(times, order) == pytest.approx(exact, rel=1e-11, abs=slack)
        if cycles is not None:
            assert not wave.at(np.array([wave.end, 2 * wave.end]), order).any()
    assert wave.end == (np.inf if cycles is None else cycles / FREQUENCY)
    assert wave.kinks == (() if cycles is None else (wave.end,))
    assert wave.smooth_until(1e3)
    assert wave.kink_spacing == wave.end
    sum_of_sines = sum(a * np.sin(w * times) for a, w in wave.sines)
    assert sum_of_sines == pytest.approx(wave.at(times), rel=0, abs=1e-14 * abs(AMPLITUDE))
    assert wave.fastest == pytest.approx(max(w for _, w in wave.sines), rel=1e-14)


def test_a_half_sine_ends_at_its_zero() -> None:
    wave = Waveform.half_sine(AMPLITUDE, 0.4)
    times = np.array([0.1, 0.2, 0.3999, 0.4, 0.5])
    expected = AMPLITUDE * np.sin(np.pi * times / 0.4) * (times < 0.4)
    assert wave.at(times) == pytest.approx(expected, rel=1e-12, abs=0)
    slope = AMPLITUDE * np.pi / 0.4 * np.cos(np.pi * times / 0.4) * (times < 0.4)
    assert wave.at(times, 1) == pytest.approx(slope, rel=1e-12, abs=1e-12)
    assert (wave.end, wave.kinks, wave.smooth_until(1e3)) == (0.4, (0.4,), True)
    assert wave.fastest == pytest.approx(np.pi / 0.4, rel=1e-15)
    assert wave.gained == pytest.approx(-AMPLITUDE * 0.8 / np.pi, rel=1e-15)
    assert wave.area(1.0) == pytest.approx(-AMPLITUDE * 0.8 / np.pi, rel=1e-14)


def test_a_spline_passes_through_its_points() -> None:
    wave = Waveform.through(KNOTS, VALUES, "spline", holds=True)
    spline = CubicSpline(KNOTS, VALUES)
    times = np.linspace(0, 1.7, 1001)
    for order in range(4):
        assert np.array_equal(wave.at(times, order), spline(times, order))
        assert wave.largest(order) == pytest.approx(np.abs(spline(times, order)).max(), rel=0.02)
    assert wave.kinks[:-1] == pytest.approx(KNOTS, rel=1e-11)
    assert wave.kink_spacing == pytest.approx(0.1, rel=1e-12)
    assert wave.fastest == pytest.approx(10.0, rel=1e-12)
    line = Waveform.through(KNOTS[:2], VALUES[:2], "spline", holds=True)
    assert line.smooth_until(KNOTS[1])
    assert not line.smooth_until(1.01 * KNOTS[1])
    assert not wave.smooth_until(1.0)
    integral = [
        quad(spline, 0, t, points=[k for k in KNOTS if k < t], limit=200)[0]
        for t in np.linspace(0, 1.7, 171)
    ]
    assert wave.gained == pytest.approx(np.abs(integral).max(), rel=0.02)
    assert wave.area(1.0) == np.inf
    assert wave.path(1.0) == np.inf


@pytest.mark.parametrize("first", [0.4, 0.1])
def test_later_first_points_are_reached_from_rest_in_one_interval(first: float) -> None:
    """The rise begins at t = 0 if the first point is earlier than one interval."""
    wave = Waveform.through(first + KNOTS, VALUES, "linear", holds=True)
    begin = max(first - 0.3, 0.0)
    times = np.array([0.0, begin / 2, begin, (begin + first) / 2, first])
    expected = VALUES[0] * np.array([0.0, 0.0, 0.0, 0.5, 1.0])
    # Rounding of a slope times a time: 1e-15 of the values.
    assert wave.at(times) == pytest.approx(expected, rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("cycles", CYCLES)
def test_no_value_or_derivative_exceeds_the_largest(cycles: float | None) -> None:
    wave = Waveform.sine(AMPLITUDE, FREQUENCY, cycles)
    times = np.linspace(0, min(wave.end, 1.0) * (1 - 1e-12), 4001)
    for order in range(4):
        size = np.abs(wave.at(times, order)).max()
        assert size <= wave.largest(order) * (1 + 1e-12)
        close = 1e-5 if cycles is None else {0.5: 9.0, 0.9: 1.1, 2.3: 0.45, 7.0: 0.3}[cycles]
        assert wave.largest(order) < (1 + close) * size


@pytest.mark.parametrize("cycles", CYCLES)
@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.75, 1.0, 1.5])
def test_areas_and_paths_are_bounded(cycles: float | None, share: float) -> None:
    """Areas and paths by quadrature, also if the time ends before a burst does."""
    wave = Waveform.sine(AMPLITUDE, FREQUENCY, cycles)
    duration = share * (4 / FREQUENCY if cycles is None else wave.end)
    until = min(duration, wave.end) * (1 - 1e-14)
    turns = np.arange(1, 60) / (4 * FREQUENCY)
    size = np.linspace(0, until, 20001)
    area, path = (np.trapezoid(np.abs(wave.at(size, order)), size) for order in (0, 1))
    slack = 1e-6 * abs(AMPLITUDE)
    assert area <= wave.area(duration) + slack
    assert path <= wave.path(duration) + slack
    assert wave.area(duration) <= abs(AMPLITUDE) * until * (1 + 1e-12)
    points = turns[turns < until] if cycles is None else None
    whole = quad(lambda t: abs(wave.at(t)), 0, until, points=points, limit=500)
    # The bound is exact at whole half periods, and exceeds the path by 1 at quarter periods.
    if cycles is None:
        assert wave.area(duration) <= whole[0] + 2 * abs(AMPLITUDE) / wave.omega
        whole_arches = (2 * FREQUENCY * duration) % 1 == 0
        assert not whole_arches or wave.area(duration) == pytest.approx(whole[0], rel=1e-9)
        if (4 * FREQUENCY * duration) % 1 == 0:
            assert wave.path(duration) == pytest.approx(path + abs(AMPLITUDE), rel=1e-5)
    else:
        bound = abs(AMPLITUDE) * (3 + 4 * FREQUENCY * until)
        assert wave.path(duration) == pytest.approx(bound, rel=1e-9)
        if share >= 1:
            assert wave.area(duration) == pytest.approx(abs(AMPLITUDE) * wave.end / 2, rel=1e-12)


@pytest.mark.parametrize("cycles", CYCLES)
def test_no_integral_exceeds_the_largest(cycles: float | None) -> None:
    wave = Waveform.sine(AMPLITUDE, FREQUENCY, cycles)
    times = np.linspace(0, min(wave.end, 1.0), 20001)
    integral = np.abs(np.cumsum(wave.at(times)) * times[1]).max()
    assert integral <= wave.gained * (1 + 1e-3)
    if cycles is None:
        assert wave.gained == pytest.approx(integral, rel=1e-3)


@pytest.mark.parametrize("rate", [1e6, 25e6])
@pytest.mark.parametrize(("holds", "noise"), [(False, 0.0), (False, 1e-3), (True, 0.0)])
def test_points_denser_than_the_motion_are_bounded_by_their_spectrum(
    rng: np.random.Generator, rate: float, holds: bool, noise: float
) -> None:
    """A Hann burst of n cycles has the frequencies f - f/n, f and f + f/n, and side lobes."""
    frequency, cycles = 2e4, 5
    times = np.arange(int(1e-3 * rate)) / rate
    values = Waveform.sine(2.0, frequency, cycles).at(times)
    values = values + noise * rng.normal(size=times.size)
    # The slopes of a monotone curve oscillate from point to point.
    wave = Waveform.through(times, values, "spline" if holds else "pchip", holds)
    highest = 2 * np.pi * frequency * (1 + 1 / cycles)
    assert highest < wave.fastest < 5 * highest
    # The rest of the spectrum hardly moves a free mass or the grain itself.
    speed = np.gradient(values, times) if holds else np.cumsum(values) / rate
    spectrum = np.fft.rfft(speed - np.linspace(speed[0], speed[-1], speed.size))
    omega = 2 * np.pi * rate * np.arange(spectrum.size) / times.size
    rest = np.fft.irfft(spectrum * (omega > wave.fastest), times.size)
    assert np.abs(rest).max() < 5e-3 * np.abs(speed).max()


@pytest.mark.parametrize("holds", [False, True])
@pytest.mark.parametrize(("share", "counts"), [(0.0, False), (0.8e-3, False), (1.3e-3, True)])
def test_fast_parts_count_from_a_thousandth_of_the_speed(
    holds: bool, share: float, counts: bool
) -> None:
    """The limit of frequency is within an octave above the fastest sine that counts."""
    slow, fast = 2 * np.pi * 5, 2 * np.pi * 160
    times = np.linspace(0, 1, 16001)
    # A free mass has the speed (1 - cos wt) / w under sin wt, so its largest speed is 2 / w.
    size = share * (slow / fast if holds else 2 * fast / slow)
    values = np.sin(slow * times) + size * np.sin(fast * times)
    wave = Waveform.through(times, values, "spline", holds)
    highest = fast if counts else slow
    assert highest <= wave.fastest <= 2 * highest
    assert wave.kink_spacing == pytest.approx(1 / 16000, rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_spline_may_leave_the_range_of_its_points_by_a_tenth(sign: float) -> None:
    times = np.arange(4.0)
    near, far = (sign * np.array([0.0, 1.0, third, 0.0]) for third in (0.93, 0.98))
    for values, expected in ((near, 0.088), (far, 0.114)):
        beyond = np.abs(CubicSpline(times, values)(np.linspace(0, 3, 3001))).max() - 1
        assert beyond == pytest.approx(expected, abs=0.002)
    Force(times=times, force=near, interpolation="spline")
    ((key, text),) = faults(Force, times=times, force=far, interpolation="spline")
    assert key == "interpolation"
    low, high, *points = (float(x) for x in re.findall(r"[-+.e\d]*\d", text))
    assert sorted(points) == sorted([0.0, sign])
    assert sorted([low, high]) == pytest.approx(sorted([0.0, 1.114 * sign]), abs=0.005)
