"""Fits of laws and parameters, compared with an independent least-squares fit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.convergence import slope
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck, struck_in_units
from helpers.independent_theory import dense_modes
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.integrate import solve_ivp

from lmpchain import Chain, Displacement, Impulse, InputError, Profile, Scene, Trajectory, simulate
from lmpchain.measure.fit.column import (
    bottom,
    fit_continuum,
    fit_exponents,
    front_before_echo,
    strike_at_top,
)
from lmpchain.measure.fit.inverse import Trace, fit_parameter
from lmpchain.measure.fit.overview import Summary, summary
from lmpchain.measure.fit.table import FittedNumber
from lmpchain.measure.front import Front, asymptotic, exponent, track

Array = NDArray[np.float64]


def least_squares(
    h: Array, y: Array, orders: list[float], power: float | None = None
) -> tuple[Array, Array]:
    """Fit y = f h^p (1 + sum of c h^-order) to logarithms.

    Return p, ln f, c ... and their standard errors.
    """

    def off(x: Array) -> Array:
        p, scale, *terms = x if power is None else np.append(power, x)
        bent = 1 + sum(c * h**-order for c, order in zip(terms, orders, strict=True))
        return np.log(y) - scale - p * np.log(h) - np.log(np.abs(bent))

    begin = np.append(np.polyfit(np.log(h), np.log(y), 1), np.zeros(len(orders)))
    begin = begin if power is None else begin[1:]
    solution = optimize.least_squares(
        off, begin, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
    )
    freedom = h.size - begin.size
    covariance = 2 * solution.cost / freedom * np.linalg.inv(solution.jac.T @ solution.jac)
    return solution.x, np.sqrt(np.diag(covariance))


def noisy_front(seed: int = 5, noise: float = 1e-3) -> Front:
    grain = np.arange(10, 120)
    h = grain - 0.5
    amplitude = 1e-9 * h**-0.3 * (1 - 0.4 * h ** (-1 / 3) + 0.1 * h ** (-2 / 3))
    amplitude *= 1 + noise * np.random.default_rng(seed).normal(size=h.size)
    zero = np.zeros(h.size)
    return Front("velocity", grain, h * 1e-3, h**0.8, -amplitude, h**2, zero, zero, zero)


@pytest.mark.parametrize("power", [None, -0.28])
@pytest.mark.parametrize("delta", [1.0, 1.5, 2.0])
def test_an_asymptotic_law_and_its_errors(delta: float, power: float | None):
    """The error is half the 95 % interval plus the shift with a term of twice the order.

    If the deeper half differs by more than its noise, its extrapolated change replaces the shift.
    """
    front = noisy_front()
    order = 1 / delta - 1 / 3
    law = asymptotic(front, "amplitude", delta, power)
    h = front.grain - 0.5
    fitted, error = least_squares(h, -front.amplitude, [order], power)
    further, _ = least_squares(h, -front.amplitude, [order, 2 * order], power)
    half = slice(-(h.size // 2), None)
    below, scatter = least_squares(h[half], -front.amplitude[half], [order], power)
    noise = stats.t.ppf(0.975, h[half].size - fitted.size) * scatter
    ratio = stats.gmean(h[half]) / stats.gmean(h)
    remote = np.maximum(np.abs(below - fitted) - noise, 0.0) / (1 - ratio ** (-2 * order))
    interval = stats.t.ppf(0.975, h.size - fitted.size) * error
    interval += np.maximum(np.abs(further[:-1] - fitted), remote)
    if power is not None:
        fitted = np.append(power, fitted)
        interval = np.append(0.0, interval)
    factor = np.exp(fitted[1])
    assert law.order == pytest.approx(order, rel=1e-14)
    assert (law.exponent, law.factor, law.correction) == pytest.approx(
        (fitted[0], factor, fitted[2]), rel=1e-4
    )
    assert law.error == pytest.approx(interval * [1, factor, 1], rel=2e-2)
    assert law.residual == pytest.approx(
        law.values / (law.factor * h**law.exponent * (1 + law.correction / h**order)) - 1, abs=1e-12
    )


def test_six_grains_are_enough_for_a_law_and_five_are_not():
    front = noisy_front(noise=0.0)
    assert asymptotic(front.between(10, 15), "amplitude", 1.5, -0.3).depth.size == 6
    with pytest.raises(InputError, match=r"front: a fit needs 6 or more grains \(got 5\)"):
        asymptotic(front.between(10, 14), "amplitude", 1.5, -0.3)
    for delta in (0.99, 2.01):
        with pytest.raises(InputError, match="requires 1 <= delta <= 2"):
            asymptotic(front, "amplitude", delta)
    for window in (2, 111):
        with pytest.raises(InputError, match=rf"window: must be 3 to 110.*\(got {window}\)"):
            exponent(front, window=window)


@pytest.mark.parametrize("window", [3, 11, 110])
def test_local_exponents_and_their_intervals(window: int):
    front = noisy_front()
    seen = exponent(front, window=window)
    x = np.log(front.grain - 0.5)
    y = np.log(-front.amplitude)
    assert seen.exponent.size == 110 - window + 1
    for k in (0, seen.exponent.size // 2, seen.exponent.size - 1):
        a = x[k : k + window]
        b = y[k : k + window]
        slope, start = np.polyfit(a, b, 1)
        left = b - start - slope * a
        error = np.sqrt(left @ left / (window - 2) / ((a - a.mean()) ** 2).sum())
        assert seen.exponent[k] == pytest.approx(slope, rel=1e-9)
        assert seen.error[k] == pytest.approx(stats.t.ppf(0.975, window - 2) * error, rel=1e-6)
        assert seen.residual[k] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
        assert seen.depth[k] == pytest.approx(np.exp(a.mean()), rel=1e-12)
    assert exponent(front).exponent.size == 100, "eleven grains by default"


# --- a column struck at its top


def weakly_struck(
    grains: int = 120, units: float = 90.0, samples: int = 361, **more: Any
) -> Trajectory:
    chain = column(grains)
    excitation = Impulse(velocity=-1e-9)
    duration = units * chain.time_scale
    return run(chain, excitation, duration, samples, 1e-8, "chebyshev", **more)


@pytest.fixture(scope="module")
def wave() -> Trajectory:
    return weakly_struck()


def chi(h: Any, delta: float = 1.5) -> Any:
    eta = 1 + 1 / delta
    return 2 / eta * np.asarray(h) ** (eta / 2)


@pytest.mark.parametrize("inside", [0.5, 0.3])
def test_the_amplitude_of_eq_35(rng: np.random.Generator, wave: Trajectory, inside: float):
    """Synthetic data with C = 1.3 and scatter test the selection of samples and the regression."""
    unit = wave.scene.chain.time_scale
    chain = wave.scene.chain
    tau = wave.time[:, None] / unit
    travel = chi(wave.grains - 0.5)
    cone = np.maximum(tau**2 - travel**2, 1e-9)
    scatter = 1 + 1e-3 * rng.normal(size=cone.shape)
    made = replace(wave, displacement=-1e-9 * unit * 1.3 * cone**-0.1 * scatter)
    fit = fit_continuum(made, inside=inside)
    width = np.cbrt((chain.grains - 0.5) ** 0.5 / 4)
    known = tau <= 2 * chi(chain.grains - 0.5) - travel - 10 * width
    behind = known & (travel <= inside * tau)
    since = min(50.0, tau[behind.any(1)].max() / 2)
    behind &= tau >= since
    rows, columns = np.nonzero(behind)
    assert fit.grain.tolist() == wave.grains[columns].tolist()
    values = made.displacement[rows, columns] / (-1e-9 * unit)
    shape = cone[rows, columns] ** -0.1
    assert fit.values == pytest.approx(values, rel=1e-12)
    assert fit.cone == pytest.approx(cone[rows, columns], rel=1e-11)
    slope = shape @ values / (shape @ shape)
    left = values - slope * shape
    error = np.sqrt(left @ left / (values.size - 1) / (shape @ shape))
    late = tau[rows, 0] >= (since + tau[rows].max()) / 2
    later = shape[late] @ values[late] / (shape[late] @ shape[late])
    # A disturbance of 1 / tau shifts the whole and the later half by its means.
    whole, rest = (
        (shape[part] ** 2 @ (1 / tau[rows[part], 0])) / (shape[part] @ shape[part])
        for part in (slice(None), late)
    )
    interval = stats.t.ppf(0.975, values.size - 1) * error
    interval += abs(later - slope) * whole / (whole - rest)
    assert fit.amplitude == pytest.approx(slope, rel=1e-11)
    assert fit.error == pytest.approx(interval, rel=1e-6)
    assert fit.model == pytest.approx(slope * shape, rel=1e-10)
    assert fit.residual == pytest.approx(np.sqrt((left @ left) / (values @ values)), rel=1e-9)
    assert fit.power == pytest.approx(0.1, rel=1e-12)
    assert abs(fit.amplitude - 1.3) < fit.error


def test_the_law_of_the_front_and_its_errors(wave: Trajectory):
    law = fit_continuum(wave).front
    assert law is not None
    front = front_before_echo(wave, "velocity", 10)
    unit = wave.scene.chain.time_scale
    assert front.grain[[0, -1]].tolist() == [10, int(120 - 3 - 2.5 * 120 ** (1 / 3))]
    assert law.depth.tolist() == (front.grain - 0.5).tolist()
    assert law.time == pytest.approx(front.time / unit, rel=1e-13)
    less = law.time - law.shift
    fitted, error = least_squares(law.depth, less, [1.0])
    further, _ = least_squares(law.depth, less, [1.0, 4 / 3])
    interval = stats.t.ppf(0.975, less.size - 3) * error + 2 * np.abs(further[:3] - fitted)
    factor = np.exp(fitted[1])
    assert law.order == pytest.approx(1.0, rel=1e-14)
    assert (law.exponent, law.factor) == pytest.approx((fitted[0], factor), rel=1e-6)
    assert law.correction == pytest.approx(fitted[2], rel=1e-3, abs=1e-4)
    assert law.error == pytest.approx(interval * [1, factor, 1], rel=2e-2)
    assert law.expected == pytest.approx([5 / 6, 6 / 5], rel=1e-14)


def test_the_fitted_laws_depend_on_the_front(wave: Trajectory):
    seen = fit_exponents(wave, 15, 70)
    velocity, displacement = (
        track(wave, field).between(15, 70) for field in ("velocity", "displacement")
    )
    fronts = {
        "velocity": (velocity, "amplitude"),
        "displacement": (displacement, "amplitude"),
        "time": (velocity, "time"),
        "speed": (velocity, "speed"),
        "width": (velocity, "width"),
    }
    assert list(seen.laws) == list(fronts)
    for name, (front, quantity) in fronts.items():
        same = asymptotic(front, quantity, 1.5)  # type: ignore[arg-type]
        assert (seen.laws[name].exponent, seen.laws[name].factor) == (same.exponent, same.factor)
    with pytest.raises(
        InputError, match=r"needs 6 or more grains from grain 60 on \(got 5\): record longer"
    ):
        fit_exponents(wave, 60, 64)
    assert set(fit_exponents(wave, 60, 65).laws) >= {"time"}


@pytest.mark.parametrize("delta", [1.2, 1.5, 2.0])
def test_arrival_of_the_front_at_the_bottom(delta: float):
    power = 1.5 / delta - 0.5
    width = (79.5**power / (8 * power)) ** (1 / 3)
    assert bottom(80, delta) == pytest.approx((float(chi(79.5, delta)), width), rel=1e-12)


def test_recognition_of_columns_struck_at_their_top():
    strike = Impulse(velocity=-2e-9)

    def keys(excitation: Any = strike, **more: Any) -> list[str]:
        chain = Chain(**{"grains": 8, "diameter": 1e-3} | more)
        trajectory: Any = SimpleNamespace(scene=scene_of(chain, excitation, 1e-6, 2))
        try:
            assert strike_at_top(trajectory) == -2e-9
        except InputError as error:
            return [key for key, _ in error.faults]
        return []

    assert keys() == []
    assert keys(masses=1e-6 * (1 + 0.9e-9 * (np.arange(8) == 3))) == []
    assert keys(masses=1e-6 * (1 + 1.2e-9 * (np.arange(8) == 3))) == ["material"]
    assert keys(contact_constants=1e9 * (1 + 1.2e-9 * (np.arange(7) == 3))) == ["material"]
    assert keys(top_load=1e-3) == ["gravity"]
    assert keys(gravity=0.0, top_load=1e-3) == ["gravity"]
    assert keys(top="wall", exponent=3.0) == ["top", "exponent"]
    assert keys(exponent=2.99) == []
    assert keys(grains=1, bottom="wall") == ["grains"]
    assert keys(Impulse(velocity=-2e-9, grain=2)) == ["excitation"]
    assert keys(Impulse(velocity=0.0)) == ["excitation"]
    assert keys(Displacement(displacement=1e-12), top_load=1.0) == ["gravity", "excitation"]


# --- parameters of a scene


def guessed(velocity: float) -> Scene:
    return struck(column(8), velocity, 1e-5, 3)


def waving(asked: list[Scene]) -> Any:
    """Return a solver with the velocities v sin(2e5 t + n), which notes its scenes."""

    def solve(scene: Scene) -> Any:
        asked.append(scene)
        grains = np.arange(1, 9)[np.asarray(scene.grains) - 1]
        velocity = scene.excitation.velocity * np.sin(2e5 * scene.time[:, None] + grains)
        return SimpleNamespace(
            scene=scene, time=scene.time, grains=grains, velocity=velocity, displacement=velocity
        )

    return solve


@pytest.mark.parametrize("even", [True, False])
def test_a_parameter_with_a_linear_effect(rng: np.random.Generator, even: bool):
    """The value is sum(x y) / sum(x^2), with the error sqrt(s^2 / sum(x^2))."""
    time = np.linspace(0, 4e-5, 30) if even else 4e-5 * np.linspace(0.1, 1, 30) ** 1.5
    shape = np.sin(2e5 * time[:, None] + np.array([3, 5]))
    values = 2e-3 * (shape + 0.1 * rng.normal(size=shape.shape))
    asked: list[Scene] = []
    fit = fit_parameter(Trace(time, [3, 5], values), guessed(1.5e-3), "velocity", waving(asked))
    slope = (shape * values).sum() / (shape**2).sum()
    left = values - slope * shape
    assert fit.value == pytest.approx(slope, rel=1e-7)
    assert fit.error == pytest.approx(np.sqrt((left**2).sum() / 59 / (shape**2).sum()), rel=1e-5)
    assert fit.model == pytest.approx(slope * shape, abs=1e-7 * 2e-3)
    assert fit.residual == pytest.approx(np.sqrt((left**2).sum() / (values**2).sum()), rel=1e-6)
    assert fit.scene.excitation.velocity == fit.value
    tried = [scene.excitation.velocity for scene in asked[:9]]
    assert tried == pytest.approx(1.5e-3 * np.geomspace(0.5, 2, 9), rel=1e-12)
    assert fit.runs == len(asked) < 40
    first = asked[0]
    assert list(first.grains) == [2, 3, 4, 5, 6], "the neighbours too, for forces"
    assert first.duration == pytest.approx(4e-5, rel=1e-14)
    apart = min(0.1 / first.chain.band_edge, 4e-5 / 200)
    assert first.samples == (30 if even else int(np.ceil(4e-5 / apart)) + 1)


def test_the_range_of_a_parameter_search():
    """The search reaches 2 span from the best of nine values; a span of 1 has one start value."""
    time = np.linspace(0, 4e-5, 30)
    shape = np.sin(2e5 * time + 3)
    asked: list[Scene] = []
    fit = fit_parameter(
        Trace(time, 3, 1.9e-3 * shape), guessed(1e-3), "velocity", waving(asked), 1.0
    )
    assert fit.value == pytest.approx(1.9e-3, rel=1e-9)
    assert asked[0].excitation.velocity == pytest.approx(1e-3, rel=1e-15)
    with pytest.raises(InputError, match=r"velocity: no value between 0.0005 and 0.002 fits"):
        fit_parameter(Trace(time, 3, 2.3e-3 * shape), guessed(1e-3), "velocity", waving([]), 1.0)
    fit = fit_parameter(Trace(time, 3, 11e-3 * shape), guessed(1e-3), "velocity", waving([]), 3.0)
    assert fit.value == pytest.approx(11e-3, rel=1e-9)
    with pytest.raises(InputError, match=r"velocity: no value between 0.0005 and 0.018 fits"):
        fit_parameter(Trace(time, 3, 19e-3 * shape), guessed(1e-3), "velocity", waving([]), 3.0)
    for span in (0.99, np.inf):
        with pytest.raises(InputError, match="span: must be 1 or more"):
            fit_parameter(Trace(time, 3, shape), guessed(1e-3), "velocity", waving([]), span)
    for grain in (0, 8):
        with pytest.raises(
            InputError, match=f"grain: the trace has grain {grain}, but only 1 to 7 move"
        ):
            fit_parameter(Trace(time, grain, shape), guessed(1e-3), "velocity", waving([]))


def test_trial_values_without_a_valid_scene():
    """Values without a valid scene are skipped; an error is raised if all values are invalid."""
    time = np.linspace(0, 4e-5, 30)
    shape = np.sin(2e5 * time + 3)

    def limited(most: float) -> Any:
        solve = waving([])

        def answer(scene: Scene) -> Any:
            if scene.excitation.velocity > most:
                raise InputError([("velocity", "crushes the grains")])
            return solve(scene)

        return answer

    fit = fit_parameter(Trace(time, 3, 0.9e-3 * shape), guessed(1e-3), "velocity", limited(1.3e-3))
    assert fit.value == pytest.approx(0.9e-3, rel=1e-9)
    with pytest.raises(InputError, match="velocity: crushes the grains"):
        fit_parameter(Trace(time, 3, shape), guessed(1e-3), "velocity", limited(0.0))


# --- the summary


def test_the_table_of_a_summary():
    """Values are rounded to the digits that their errors leave; each fit is named once."""
    rows = (
        FittedNumber("one", "a", 1.23456789, 0.00234, 1.25, "m/s"),
        FittedNumber("one", "b", -123456.789, np.nan, np.nan),
        FittedNumber("two", "c", 0.0, 0.1, 0.0),
        FittedNumber("two", "d", 1.0000004, 1e-20, 1.0),
        FittedNumber("two", "e", 5.4321, 60.0, np.nan),
    )
    reasons = (("three", "why: not; more"), ("four", "other: no"), ("five", "why: not"))
    text = Summary(0.31, rows, reasons, ("one: short",)).table().splitlines()
    assert [line.split() for line in text[:6]] == [
        ["fit", "quantity", "value", "error", "theory", "unit"],
        ["one", "a", "1.2346", "0.002", "1.25", "m/s"],
        ["b", "-123457"],
        ["two", "c", "0", "0.1", "0"],
        ["d", "1.0000004", "1e-20", "1"],
        ["e", "5.4", "6e+01"],
    ]
    assert text[6:] == [
        "one: short",
        "left out: three, five (why: not)",
        "left out: four (other: no)",
        "strike number 0.31, so linear theory is not expected to hold",
    ]
    assert Summary(0.3, (), ()).table() == "strike number 0.3"


def test_the_rows_of_a_summary():
    chain = column(20, gravity=0.0, top_load=0.1)
    scene = scene_of(chain, Displacement(displacement=1e-14, grain=9), 12 * chain.time_scale)
    t = simulate(scene, "chebyshev", 1e-7)
    seen = summary(t)
    rows = {(row.fit, row.quantity): row for row in seen.rows}
    whole = rows["modes", "energy of all modes"]
    assert (whole.value, whole.expected, whole.unit) == (
        pytest.approx(scene.energy, rel=1e-6), scene.energy, "J"
    )  # fmt: skip
    squares, vectors = dense_modes(chain)
    energies = squares * vectors[8] ** 2
    most = int(energies.argmax())
    strongest = rows["modes", f"share of mode {most + 1}, strongest"]
    assert strongest.value == pytest.approx(energies[most] / energies.sum(), rel=1e-6)
    assert rows["modes", "its frequency"].value == pytest.approx(
        np.sqrt(squares[most]) / (2 * np.pi), rel=1e-9
    )
    assert rows["modes", "its frequency"].unit == "Hz"
    assert rows["modes", "residual of linear motion"].expected == 0
    amplitude = rows["bessel", "amplitude"]
    speed = rows["bessel", "wave speed"]
    assert (amplitude.unit, speed.unit, rows["bessel", "delay"].unit) == ("m", "grains/s", "s")
    assert amplitude.value == pytest.approx(1e-14, rel=1e-5)
    assert speed.value == pytest.approx(1 / chain.time_scale, rel=1e-5)
    assert seen.strike_number == float(scene.strike_number)
    still = scene.replace(excitation=Profile(velocity=np.zeros(20)))
    reasons = dict(summary(simulate(still, "chebyshev", 1e-7)).left_out)
    assert reasons["modes"] == "excitation: nothing moves"


@pytest.mark.parametrize("strike", [100.0, 1000.0])
def test_local_exponents_after_a_strong_strike(strike: float):
    """The exponents agree with SciPy's solution of (3/2) u'' = F_(n-1) - F_n + 1."""
    grains = 60
    rest = np.arange(1, grains) ** (2 / 3)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        u = np.append(y[: grains - 1], 0.0)
        force = np.maximum(rest + u[:-1] - u[1:], 0.0) ** 1.5
        return np.append(y[grains - 1 :], (np.append(0.0, force[:-1]) - force + 1) / 1.5)

    start = np.zeros(2 * grains - 2)
    start[grains - 1] = strike
    time = np.arange(0, 26, 5e-3)
    found = solve_ivp(rates, (0, 26), start, "DOP853", time, rtol=1e-9, atol=1e-9 * strike)
    peaks = found.y[grains - 1 :].max(1)
    fit = fit_exponents(simulate(struck_in_units(column(grains), strike, 26, 1301), "native", 1e-8))
    n = np.arange(fit.grain[-1] - 10, fit.grain[-1] + 1)
    power = slope(n - 0.5, peaks[n - 1])
    assert fit.grain[-1] == 47
    assert fit.local["velocity"].exponent[-1] == pytest.approx(power, abs=2e-4)
    assert -4 / 15 < power < 0
    assert fit.approach("velocity") == "towards the law of weak waves"
    # The reference velocity of a contact at rest is (n^(2/3)) sqrt(n^(1/3)) in these units.
    holds = 47 ** (2 / 3 + 1 / 6)
    assert fit.strength[-1] == pytest.approx(peaks[46] / holds, rel=1e-4)
