"""Wave fronts between samples, compared with exact solutions, published laws and exponents."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_chains import column, vacuum
from helpers.example_scenes import run, scene_of, struck, struck_in_units
from helpers.faults import fault_keys
from helpers.independent_theory import dense_modes
from numpy.typing import NDArray
from scipy.optimize import brentq

from lmpchain import Impulse, InputError, Trajectory, simulate
from lmpchain.measure.front import Front, asymptotic, exponent, track
from lmpchain.report import panels

Array = NDArray[np.float64]


def past(
    last: int, strike: float, grains: int, per_unit: int = 8, recorded: str = "all", **chain: Any
) -> Trajectory:
    """Simulate a column struck at the top until the weak front has passed the `last` grain."""
    beads = column(grains, **chain)
    eta = 1 + 1 / beads.exponent
    end = 2 / eta * last ** (eta / 2) + 2.5 * last ** (eta / 2 - 2 / 3) + 4
    scene = struck_in_units(beads, strike, end, round(per_unit * end) + 1, grains=recorded)
    return simulate(scene, engine="native", tolerance=1e-8)


@pytest.fixture(scope="module")
def weak() -> Trajectory:
    return past(505, 1e-4, 540)


@pytest.fixture(scope="module")
def velocity(weak: Trajectory) -> Front:
    return track(weak).between(2, 500)


@pytest.fixture(scope="module")
def displacement(weak: Trajectory) -> Front:
    return track(weak, "displacement").between(1, 500)


def made_up(
    motion: Callable[[Array, Array], Array], samples: int = 401, grains: int = 5
) -> Trajectory:
    """Return a trajectory with the velocity motion(t, n) for 0 to 20 us, without an equation."""
    scene = struck(column(grains + 1), 1e-6, 20e-6, samples, grains=f"1:{grains}")
    numbers = np.arange(1.0, grains + 1)
    step = 20 / (samples - 1)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    inside = scene.time[:-1, None, None] * 1e6 + step * (nodes[:, None] + 1) / 2
    way = (motion(inside, numbers) * weights[:, None]).sum(1) * step / 2 * 1e-6
    displacement = np.concatenate((np.zeros((1, grains)), np.cumsum(way, axis=0)))
    t = simulate(scene, engine="native", tolerance=1e-3)
    velocity = motion(scene.time[:, None] * 1e6, numbers)
    unknown = replace(t.error_estimate, solver=np.inf)
    return replace(
        t, velocity=velocity, displacement=displacement, error_estimate=unknown, equation=0
    )


def gauss(t: Array, middle: Array | float, width: Array | float = 1.0) -> Array:
    return np.exp(-(((t - middle) / width) ** 2))


# --- where the truth is known


@pytest.mark.parametrize("up", [1, -1])
def test_time_height_and_width_between_the_samples(up: int):
    t = made_up(lambda t, n: up * n * gauss(t, 5 + 2.1234 * n, 1 + 0.1 * n))
    front = track(t)
    n = front.grain
    assert n.tolist() == [1, 2, 3, 4, 5]
    assert front.time == pytest.approx((5 + 2.1234 * n) * 1e-6, rel=1e-9)
    assert front.amplitude == pytest.approx(up * n, rel=1e-9)
    assert front.width == pytest.approx(2 * np.sqrt(np.log(2)) * (1 + 0.1 * n) * 1e-6, rel=1e-8)
    assert front.grains_per_second == pytest.approx(1e6 / 2.1234, rel=1e-8)
    assert front.speed == pytest.approx(1e3 / 2.1234, rel=1e-5), (
        "grains are 1 mm apart but for their overlap"
    )


@pytest.mark.parametrize("samples", [31, 41, 61, 101])
def test_the_errors_are_above_the_true_ones(samples: int):
    front = track(made_up(lambda t, n: n * gauss(t, 6 + 1.2345 * n, 2), samples))
    for error, true in (
        (front.time_error, front.time - (6 + 1.2345 * front.grain) * 1e-6),
        (front.amplitude_error, front.amplitude - front.grain),
        (front.width_error, front.width - 4e-6 * np.sqrt(np.log(2))),
    ):
        assert (np.abs(true) < error).all()


def test_the_front_is_the_first_maximum_that_is_high_enough():
    t = made_up(lambda t, n: 0.1 * gauss(t, 3) - 1.0 * gauss(t, 8) + 1.5 * gauss(t, 13) + 0 * n)
    for fraction, amplitude in ((0.05, 0.1), (0.5, -1.0), (0.8, 1.5)):
        assert track(t, fraction=fraction).amplitude == pytest.approx(amplitude, rel=1e-6)


def test_grains_that_the_front_has_not_passed_are_left_out():
    # The arrival times are 0, 10, 20 and so on.
    t = made_up(lambda t, n: gauss(t, 10 * (n - 1)) + 1e-9 * np.sin(5 * t) * (n == 5))
    assert track(of_error(t, 1e-8)).grain.tolist() == [2], (
        "noise below the error of the trajectory is no front"
    )
    t = made_up(lambda t, n: np.tanh(t - 10) + 1 + 0 * n)
    with pytest.raises(InputError, match="no front of the velocity passes"):
        track(t)


@pytest.mark.parametrize("field", ["velocity", "displacement"])
def test_a_front_falls_by_more_than_the_error(field: Any):
    """Behind its maximum the field falls by 1e-3 of its size, which a larger error could cause."""

    def ridge(t: Array, n: Array) -> Array:
        rise, fall = (1 / (1 + np.exp(-2 * (t - middle))) for middle in (6, 13))
        if field == "velocity":
            return rise * (1 - 1e-3 * fall) + 0 * n
        slope = rise * (1 - rise) * (1 - 1e-3 * fall) - 1e-3 * rise * fall * (1 - fall)
        return 2 * slope + 0 * n

    t = made_up(ridge)
    known, unsure = (of_error(t, error) for error in (5e-4, 2e-3))
    assert track(known, field).grain.tolist() == [1, 2, 3, 4, 5]
    with pytest.raises(InputError, match=f"no front of the {field} passes"):
        track(unsure, field)


def test_a_wave_without_a_recorded_decrease_has_no_width():
    front = track(made_up(lambda t, n: gauss(t, 17 - n) + 0.6 * (1 + np.tanh(t - 17 + n))))
    assert front.grain.tolist() == [1, 2, 3, 4, 5]
    assert (np.diff(front.time) < 0).all()
    assert np.isnan(front.width).all()
    assert np.isnan(front.width_error).all()


def test_recorded_grains_may_come_in_any_order():
    strike = Impulse(velocity=1e-6, grain=10)
    scene = scene_of(column(40), strike, 6e-5, 301, grains=[20, 4, 12, 10, 16, 8])
    front = track(simulate(scene, engine="native", tolerance=1e-8))
    assert front.grain.tolist() == [4, 8, 12, 16, 20], "the one that was struck is left out"
    assert (np.diff(front.time[2:]) > 0).all()
    assert front.time[0] > front.time[1]
    assert front.speed[0] < 0 < front.speed[-1]
    assert front.depth == pytest.approx(1e-3 * (front.grain - 1), rel=1e-5)


def test_against_the_exact_motion_of_a_weak_strike():
    """The maxima of the exact sum over all modes are found as roots, without sampling."""
    t = past(60, 1e-7, 80)
    chain = t.scene.chain
    strike = t.scene.excitation.velocity
    squares, shape = dense_modes(chain)
    omega = np.sqrt(squares)
    front = track(t).between(2, 60)
    assert front.grain.tolist() == list(range(2, 61))
    for grain, time, amplitude in zip(front.grain, front.time, front.amplitude, strict=True):
        weight = strike * shape[grain - 1] * shape[0]
        true = brentq(
            lambda s, weight=weight: weight @ (omega * np.sin(omega * s)),
            time - 0.3 * chain.time_scale,
            time + 0.3 * chain.time_scale,
            xtol=1e-14 * chain.time_scale,
        )
        assert time == pytest.approx(true, abs=1e-6 * chain.time_scale)
        assert amplitude == pytest.approx(weight @ np.cos(omega * true), rel=2e-6)


def test_soliton_of_the_sonic_vacuum():
    """The front of the exact lattice soliton has its known speed and width.

    The speed is V = 0.9074700784 v^(1/5), and the full width at half maximum is 1.5791 grains.
    """
    scene = struck(vacuum(90), 1.0, 110.0, 2201, grains="50:80")
    t = simulate(scene, engine="native", tolerance=1e-8)
    front = track(t)
    assert front.grain.tolist() == list(range(50, 81))
    assert front.amplitude == pytest.approx(0.68163155, rel=1e-6)
    assert front.grains_per_second / front.amplitude**0.2 == pytest.approx(0.9074700784, rel=1e-6)
    assert front.speed == pytest.approx(100 * front.grains_per_second, rel=1e-12)
    assert front.width * front.grains_per_second == pytest.approx(1.5791, abs=5e-5)
    assert exponent(front, "amplitude", None).exponent == pytest.approx(0, abs=1e-6)
    still_moving = simulate(scene.replace(grains="60:80"), engine="native", tolerance=1e-8)
    with pytest.raises(InputError, match="no front of the displacement passes"):
        track(still_moving, "displacement")


# --- the column: numbers of the linear chain


def at(front: Front, grain: int, values: Array) -> float:
    return float(values[front.grain == grain].item())


@pytest.mark.parametrize(("grain", "ratio"), [(100, 0.251742), (500, 0.169778)])
def test_peak_velocity(velocity: Front, weak: Trajectory, grain: int, ratio: float):
    assert at(
        velocity, grain, velocity.amplitude
    ) / weak.scene.excitation.velocity == pytest.approx(ratio, rel=1e-5)


def test_local_speed(velocity: Front, weak: Trajectory):
    """The ratio of speed to n^(1/6) is 0.9944 at grain 100.

    It is less than 1 because the maximum lags behind (6/5) h^(5/6).
    """
    unit = weak.scene.chain.time_scale
    assert at(velocity, 100, velocity.grains_per_second) * unit / 100 ** (1 / 6) == pytest.approx(
        0.9944, abs=7e-4
    )
    h = 499.5
    slowness = h ** (-1 / 6) + 0.908 / 4 ** (1 / 3) / 6 * h ** (-5 / 6)
    assert at(velocity, 500, velocity.grains_per_second) * unit == pytest.approx(
        1 / slowness, rel=2e-4
    )


@pytest.mark.parametrize(
    ("window", "grain", "slope"), [(5, 100, -0.2381), (11, 200, -0.2441), (21, 489, -0.2502)]
)
def test_local_exponents(velocity: Front, window: int, grain: int, slope: float):
    """The exponent d ln v / d ln n of the linear column is smaller in terms of h = n - 1/2."""
    found = exponent(velocity, window=window)
    assert np.interp(grain - 0.5, found.depth, found.exponent) * grain / (
        grain - 0.5
    ) == pytest.approx(slope, abs=3e-4)
    assert (
        found.depth.shape
        == found.exponent.shape
        == found.error.shape
        == (velocity.grain.size - window + 1,)
    )
    assert (found.error[100:] < 2e-3).all()
    assert (found.residual[100:] < 1e-4).all()


@pytest.mark.parametrize(("strike", "slope"), [(10, -0.2374), (100, -0.1700), (1000, -0.0512)])
def test_local_exponents_of_stronger_waves(strike: float, slope: float):
    """The exponents at n = 100 go from a weak wave to a soliton without gravity."""
    front = track(past(112, strike, 130, per_unit=15, recorded="88:112"))
    found = exponent(front, window=None)
    assert found.exponent[0] == pytest.approx(slope, abs=2e-3)


@pytest.mark.parametrize(
    ("field", "quantity", "power", "factor"),
    [
        ("velocity", "amplitude", -4 / 15, 0.931767),
        ("displacement", "amplitude", -1 / 10, 1.155137 * 2.4**-0.1 * 4 ** (1 / 30) * 1.23707),
        ("velocity", "time", 5 / 6, 6 / 5),
        ("velocity", "speed", 1 / 6, 1.0),
        ("velocity", "width", 1 / 6, None),
    ],
)
def test_asymptotic_laws(
    velocity: Front,
    displacement: Front,
    weak: Trajectory,
    field: str,
    quantity: str,
    power: float,
    factor: float,
):
    """The velocity decays as 0.931767 n^(-4/15), and the displacement as n^(-1/10).

    Hong, Ji and Kim published the exponents -1/4 and -1/12.
    """
    unit = weak.scene.chain.time_scale
    strike = weak.scene.excitation.velocity
    scale = {
        "amplitude": strike if field == "velocity" else strike * unit,
        "speed": 1e-3 / unit,
    }.get(quantity, unit)
    front = {"velocity": velocity, "displacement": displacement}[field].between(20, 500)
    free = asymptotic(front, quantity, 1.5)
    fixed = asymptotic(front, quantity, 1.5, power)
    assert free.exponent == pytest.approx(power, abs=2.5e-3)
    assert free.error[0] < 7e-3
    assert np.abs(free.residual).max() < 2e-3
    assert fixed.exponent == power
    assert fixed.error[0] == 0
    if factor:
        assert abs(free.exponent - power) < free.error[0]
        assert fixed.factor / scale == pytest.approx(factor, rel=5e-3)
    if (field, quantity) == ("velocity", "amplitude"):
        assert fixed.correction == pytest.approx(-0.339, abs=0.05)
        assert abs(free.exponent + 1 / 4) > 2 * free.error[0], (
            "told from the exponent of Hong, Ji and Kim"
        )


@pytest.mark.parametrize(
    ("delta", "power", "factor"), [(1.0, -1 / 3, 1.071313), (2.0, -2 / 9, None)]
)
def test_asymptotic_laws_of_other_contacts(delta: float, power: float, factor: float | None):
    """1.071313 n^(-1/3) for springs, the front of a Bessel function; n^(-2/9) for delta = 2."""
    t = past(300, 1e-3, 340, exponent=delta)
    front = track(t).between(30, 295)
    free = asymptotic(front, "amplitude", delta)
    assert free.exponent == pytest.approx(power, abs=2e-3)
    assert free.order == pytest.approx(1 / delta - 1 / 3)
    # The front passes at times h^((1 + 1/delta) / 2); the errors cover what deeper grains change.
    for quantity, limit in (("time", (1 + 1 / delta) / 2), ("speed", (1 - 1 / delta) / 2)):
        law = asymptotic(front, quantity, delta)
        assert law.order == pytest.approx(2 / 3)
        assert abs(law.exponent - limit) < law.error[0] < 0.02
    assert abs(free.exponent - power) < free.error[0]
    if factor:
        fixed = asymptotic(front, "amplitude", delta, power)
        assert fixed.factor / t.scene.excitation.velocity == pytest.approx(factor, rel=1e-3)


# --- the fits themselves


def power_law(terms: tuple[float, ...] = (-0.4,)) -> Front:
    grain = np.arange(10, 300)
    h = grain - 0.5
    amplitude = 1e-9 * h**-0.3 * (1 + sum(c * h ** (-k / 3) for k, c in enumerate(terms, 1)))
    zero = np.zeros(h.size)
    return Front("velocity", grain, h * 1e-3, h.astype(float), -amplitude, h**2, zero, zero, zero)


def test_a_power_law_is_recovered():
    for given in (None, -0.3):
        law = asymptotic(power_law(), "amplitude", 1.5, given)
        assert (law.exponent, law.factor, law.correction) == pytest.approx(
            (-0.3, 1e-9, -0.4), rel=1e-5
        )
        assert (law.error < [1e-5, 1e-13, 1e-4]).all()
        assert np.abs(law.residual).max() < 1e-6
        assert law(np.array([9.5])) == pytest.approx(law.values[:1], rel=1e-6)
    local = exponent(power_law(terms=()), window=None)
    assert local.depth.shape == (1,)
    assert local.exponent == pytest.approx(-0.3, abs=1e-12)
    assert local.residual < 1e-6


def test_fronts_without_a_power_law_are_rejected():
    front = power_law()
    with pytest.raises(InputError, match="choose other grains"):
        asymptotic(replace(front, amplitude=np.exp(-front.depth / 0.05)), "amplitude", 1.5, -0.3)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda t: track(t, "energy"), "field"),
        (lambda t: track(made_up(lambda t, n: gauss(t, 10 + n), samples=15)), "samples"),
        (lambda t: exponent(power_law(), "grain"), "quantity"),
        (lambda t: exponent(power_law(), window=3.5), "window"),
        (lambda t: track(t, fraction=0.0), "fraction"),
        (lambda t: track(t, fraction=1.1), "fraction"),
        (lambda t: power_law().between(10, 10).speed, "grains"),
    ],
)
def test_faults_name_their_key(call: Callable[[Trajectory], object], key: str):
    assert fault_keys(call, made_up(lambda t, n: gauss(t, 10 + n))) == [key]


def test_speed_of_the_front_between_two_grains():
    front = power_law().between(10, 11)
    assert front.grains_per_second == pytest.approx(1)


@pytest.mark.filterwarnings("error")
def test_simultaneous_peaks_have_infinite_speed():
    """Simultaneous maxima are rounding errors: the speed is infinite, without a warning."""
    one = np.ones(4)
    at_once = Front(
        "velocity", np.arange(1, 5), np.arange(4.0), np.array([1.0, 1.0, 1.0, 2.0]), *(one,) * 5
    )
    assert np.isinf(at_once.speed[:2]).all()
    assert at_once.against_depth("speed")[0].tolist() == [2.5, 3.5]


def test_a_displacement_that_turns_just_before_a_flight() -> None:
    """Where an interval is flat within its error, the error of the height covers the maximum."""
    chain = column(20, diameter=5e-3, material="steel", gravity=0.0, bottom="wall")
    upward = Impulse(velocity=-0.0159718, grain=20)
    coarse, dense = (run(chain, upward, 1.9275e-3, 123 * n + 1, 1e-8) for n in (1, 32))
    front, exact = (track(each, "displacement") for each in (coarse, dense))
    same = exact.where(np.isin(exact.grain, front.grain))
    assert same.grain.tolist() == front.grain.tolist() == list(range(6, 21))
    assert (np.abs(front.amplitude - same.amplitude) <= front.amplitude_error).all()
    assert (np.abs(front.time - same.time) <= front.time_error).all()


def test_an_unresolved_front_reports_the_number_of_resolved_grains():
    """The message gives the number of grains whose arrival times are too uncertain."""
    scene = struck(column(1000), 1e-5, 1.2e-3, 241)
    coarse = simulate(scene, "native")
    with pytest.raises(
        InputError, match=r"samples: 241 samples do not show .*: record (\d+) samples"
    ) as no:
        track(coarse)
    with pytest.raises(InputError, match="record"):
        panels.arrival(coarse)
    needed = int(str(no.value).rpartition("record ")[2].split()[0])
    # The fastest motion turns by 2 rad between two samples.
    assert 1.99 < scene.replace(samples=needed).sampling_phase <= 2
    front = track(simulate(scene.replace(samples=needed), "native"))
    truth = track(simulate(scene.replace(samples=2401), "native"))
    assert front.grain.size > 350
    assert np.array_equal(front.grain, truth.grain)
    assert (np.abs(front.time - truth.time) <= front.time_error + truth.time_error).all()
    assert front.time_error.max() < 1e-6 * scene.duration
