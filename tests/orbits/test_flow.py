"""The flow of a chain, its energy and derivatives, and Newton's equations, against SciPy."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from scipy.integrate import solve_ivp

from lmpchain import Chain, Drive, InputError
from lmpchain.errors import RunFailed
from lmpchain.integrators.halving import SAFETY
from lmpchain.orbits.flow import Flow
from lmpchain.orbits.shooting import (
    Equations,
    OrbitPoint,
    estimate_error,
    fixed,
    solve,
    solve_accurately,
    solve_step,
)

MASSES = np.array([2.0, 1.0, 3.0, 1.5]) * 1e-6
LOADED = column(4, masses=MASSES, top_load=1.0, gravity=500.0, top="wall", bottom="wall")
EPS = LOADED.contacts.overlap[1]
RATE = 1.3e5
PERIOD = 2e-5
U = EPS * np.array([0.3, -0.2, 0.5, 0.1])
V = EPS * RATE * np.array([-0.1, 0.4, 0.2, -0.3])


def force(chain: Chain, u: np.ndarray, above: float = 0.0) -> np.ndarray:
    """Return the force on every grain from Eq. (1) in overlaps."""
    contacts = chain.contacts
    overlap = np.maximum(contacts.overlap - np.diff(u, prepend=above, append=0.0), 0.0)
    carried = contacts.constant * overlap**chain.exponent
    weight = chain.gravity * chain.masses
    return (
        carried[:-1]
        - carried[1:]
        + weight
        + (np.arange(u.size) == 0) * chain.top_load * (chain.top == "free")
    )


def work(chain: Chain, u: np.ndarray, v: np.ndarray) -> float:
    """Return the energy above rest of contacts, weight, load and motion."""
    contacts = chain.contacts

    def held(u: np.ndarray) -> float:
        overlap = np.maximum(contacts.overlap - np.diff(u, prepend=0.0, append=0.0), 0.0)
        return float(
            (contacts.constant * overlap**2.5).sum() / 2.5 - chain.gravity * chain.masses @ u
        )

    return held(u) - held(0 * u) + float(chain.masses @ v**2 / 2)


def moved(
    chain: Chain, u: np.ndarray, v: np.ndarray, period: float, drive: Drive | None = None
) -> np.ndarray:
    """Return u and v (2, N) after a period by SciPy's DOP853; a driven grain follows the drive."""
    held = drive is not None and drive.grain == 1

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        u, v = y.reshape(2, -1) * [[EPS], [EPS * RATE]]
        path = 0.0 if drive is None else drive.amplitude * np.sin(2 * np.pi * drive.frequency * t)
        if held:
            u[0] = path
        pull = force(chain, u, 0.0 if held else path) / chain.masses
        pull[0] *= not held
        return np.concatenate((v / EPS, pull / EPS / RATE))

    start = np.concatenate((u / EPS, v / EPS / RATE))
    end = (
        solve_ivp(rate, (0, period), start, "DOP853", rtol=1e-12, atol=1e-14)
        .y[:, -1]
        .reshape(2, -1)
    )
    return end * [[EPS], [EPS * RATE]]


def test_direction_and_energy_agree_with_the_equation():
    flow = Flow(LOADED, RATE)
    root = np.sqrt(MASSES)
    state = np.stack((root * U, root * V / RATE))
    np.testing.assert_allclose(flow.canonical(U, V), state, rtol=1e-15)
    np.testing.assert_allclose(flow.physical(state), [U, V], rtol=1e-14)
    expected = np.stack((root * V / RATE, force(LOADED, U) / root / RATE**2))
    np.testing.assert_allclose(flow.direction(state), expected, rtol=1e-10)
    energy, slope = flow.energy(state)
    assert energy == pytest.approx(work(LOADED, U, V), rel=1e-9)
    np.testing.assert_allclose(
        slope, np.stack((-force(LOADED, U) / root, root * V * RATE)), rtol=1e-10
    )


@pytest.mark.parametrize("grain", [None, 1, 0])
def test_a_period_agrees_with_an_independent_integration(
    rng: np.random.Generator, grain: int | None
):
    """Steps are uneven; the drive of grain 1 or the wall has two cycles per period."""
    period = PERIOD
    size = 0.2 * EPS
    drive = None if grain is None else Drive(amplitude=size, frequency=2 / period, grain=grain)
    flow = Flow(LOADED, RATE, drive, 2) if drive else Flow(LOADED, RATE)
    assert (flow.held, flow.size) == ((1, 3) if grain == 1 else (0, 4))
    start = np.stack((U, V))
    start[:, 0] *= flow.held == 0
    steps = rng.uniform(0.5, 1.5, 200)
    passage = flow.run(flow.canonical(*start), period, steps / steps.sum())
    assert passage.displacement.shape == (201, 4)
    end = moved(LOADED, *start, period, drive)
    own = slice(flow.held, None)
    assert np.abs(passage.displacement[-1, own] - end[0, own]).max() < 2e-10 * EPS
    assert np.abs(passage.velocity[-1, own] - end[1, own]).max() < 2e-9 * EPS * RATE
    np.testing.assert_allclose(passage.displacement[0, own], start[0, own], rtol=1e-14)
    np.testing.assert_allclose(passage.velocity[0, own], start[1, own], rtol=1e-14)
    if grain == 1:
        turns = 4 * np.pi * np.concatenate(([0.0], np.cumsum(steps / steps.sum())))
        bound = 1e-12 * size
        np.testing.assert_allclose(
            passage.displacement[:, 0], size * np.sin(turns), atol=bound, rtol=0
        )
        rates = size * 4 * np.pi / period * np.cos(turns)
        np.testing.assert_allclose(
            passage.velocity[:, 0], rates, rtol=1e-12, atol=1e-9 * size / period
        )


# A driven orbit is not symmetric about t = 0.
@pytest.mark.parametrize(
    ("grain", "reversible"),
    [
        (None, False),
        (None, True),
        (1, False),
        (0, False),
    ],
)
@pytest.mark.parametrize("parameter", [False, True])
def test_equations_have_the_derivatives_of_differences(
    grain: int | None, parameter: bool, reversible: bool
):
    """Derivatives by state, log(period) and gravity, also of the constraints."""
    drive = None if grain is None else Drive(amplitude=0.2 * EPS, frequency=1 / PERIOD, grain=grain)

    @cache
    def flow_at(value: float) -> Flow:
        return Flow(LOADED.replace(gravity=value) if parameter else LOADED, RATE, drive)

    value, scale = (500.0, 700.0) if parameter else (0.0, 0.0)
    flow = flow_at(value)
    start = np.stack((U, 0 * V if reversible else V))
    start[:, 0] *= flow.held == 0
    state = flow.canonical(*start)
    equations = Equations(flow_at, reversible, 0.7 * np.abs(state).max(), scale, 1.7e-5)
    point = OrbitPoint(state, PERIOD, value)
    steps = np.full(120, 1 / 120)
    unknown = equations.pack(point)
    again = equations.unpack(unknown)
    np.testing.assert_allclose(again.state, state, rtol=1e-14)
    assert again[1:] == pytest.approx((PERIOD, value), rel=1e-14)
    count = (1 if reversible else 2) * flow.size
    assert unknown.size == count + 1 + parameter
    assert unknown[equations.period_at(unknown)] == pytest.approx(
        np.log(PERIOD / 1.7e-5), rel=1e-12
    )
    residual, slopes = equations.linearise(point, steps)
    end = moved(flow.chain, *start, PERIOD / (2 if reversible else 1), drive)
    left = flow.canonical(*end)[1] if reversible else (flow.canonical(*end) - state).ravel()
    closure = equations.closure(point, steps)
    assert np.abs(closure - left / equations.unit).max() < 1e-8 * np.abs(closure).max()
    np.testing.assert_array_equal(residual[: closure.size], closure)
    for place in range(unknown.size):
        change = 1e-6 * (np.arange(unknown.size) == place)
        ends = [
            equations.closure(equations.unpack(unknown + side * change), steps) for side in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / 2e-6
        assert np.abs(slopes[: closure.size, place] - slope).max() < 2e-8 * np.abs(slopes).max()
    # The last row fixes the phase of the orbit, across the motion.
    if not reversible and drive is None:
        across = np.concatenate((MASSES**0.5 * V / RATE, force(LOADED, U) / MASSES**0.5 / RATE**2))
        np.testing.assert_allclose(slopes[-1, :count], across / np.linalg.norm(across), rtol=1e-9)
        np.testing.assert_array_equal(slopes[-1, count:], 0.0)
        assert residual[-1] == 0.0
    for what, target in (("period", 3e-5), ("energy", 2e-8), ("value", 400.0)):
        if (what == "energy" and drive is not None) or (what == "value" and not parameter):
            continue
        constraint = fixed(equations, what, target)
        left, row = constraint.of(unknown, point)
        expected = {
            "period": np.log(PERIOD / target),
            "energy": np.log(work(flow.chain, *start) / target) if what == "energy" else 0.0,
            "value": (value - target) / 700.0,
        }[what]
        assert left == pytest.approx(expected, rel=1e-8)
        for place in range(unknown.size):
            change = 1e-5 * (np.arange(unknown.size) == place)
            sides = [unknown + side * change for side in (1, -1)]
            ends = [constraint.of(side, equations.unpack(side))[0] for side in sides]
            assert row[place] == pytest.approx(
                (ends[0] - ends[1]) / 2e-5, abs=1e-8 * np.abs(row).max()
            )


def test_a_derivative_at_the_limit_of_a_parameter_is_one_sided():
    """Gravity is never negative; a parameter with a single allowed value is reported."""
    equations = Equations(lambda g: Flow(LOADED.replace(gravity=g), RATE), False, 1.0, 100.0)
    point = OrbitPoint(np.zeros((2, 4)), PERIOD, 0.0)
    slope = equations.by_value(point, lambda flow: flow.chain.gravity**2 + flow.chain.gravity)
    assert slope == pytest.approx(100.0, rel=1e-3)
    middle = equations.by_value(point._replace(value=9.0), lambda flow: flow.chain.gravity**2)
    assert middle == pytest.approx(2 * 9.0 * 100.0, rel=1e-9)

    def below(value: float) -> Any:
        if value > 5.0:
            raise InputError([("value", "too large")])
        return value

    equations = Equations(below, False, 1.0, 2.0)
    assert equations.by_value(point._replace(value=5.0), lambda x: 3 * x) == pytest.approx(
        6.0, rel=1e-6
    )

    def only(value: float) -> Any:
        if value != 5.0:
            raise InputError([("value", "is 5")])
        return value

    equations = Equations(only, False, 1.0, 2.0)
    with pytest.raises(RunFailed, match=r"^the parameter cannot differ from 5$"):
        equations.by_value(point._replace(value=5.0), lambda x: x)


def test_singular_equations_are_solved_by_least_squares():
    """The solution is the shortest one, or the one of the smallest residual."""
    matrix = np.array([[1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_allclose(solve_step(matrix, np.array([1.0, 2.0])), [0.2, 0.4], rtol=1e-12)
    tall = np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 2.0]])
    np.testing.assert_allclose(solve_step(tall, np.array([3.0, 1.0, 2.0])), [3.0, 0.75], rtol=1e-12)
    square = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(solve_step(square, square @ [5.0, 6.0]), [5.0, 6.0], rtol=1e-12)


def test_the_error_of_steps_is_a_safe_multiple_of_the_change_by_half_the_steps():
    """The orbit of an oscillator and its period are compared with those at half the steps."""
    chain = column(2)
    flow = Flow(chain, 1 / chain.time_scale)
    state = flow.canonical(np.array([0.8 * chain.length_scale, 0.0]), np.zeros(2))
    equations = Equations(lambda _: flow, True, float(np.abs(state).max()), 0.0, chain.time_scale)
    guess = OrbitPoint(state, 5.2 * chain.time_scale)
    energy = fixed(equations, "energy", flow.energy(state)[0])
    coarse = solve(equations, guess, [energy], reach=2.5)
    assert coarse is not None
    error = estimate_error(equations, coarse, [energy])
    fine = solve(equations, coarse.point, [energy], reach=0.1)
    assert fine is not None
    assert fine.mesh.size > 8 * coarse.mesh.size or coarse.mesh.size == 26
    off = abs(np.log(coarse.point.period / fine.point.period))
    assert error / SAFETY == pytest.approx(off, rel=0.05)
    best, least = solve_accurately(equations, guess, [energy], "here")
    assert least < 1e-12
    assert best.point.period == pytest.approx(fine.point.period, rel=1e-12)
    assert best.iterations <= 16


def test_a_chain_that_flies_apart_has_no_flow():
    free = column(3, gravity=0.0)
    walls = free.replace(top="wall", bottom="wall")
    for chain in (free, free.replace(top="wall", bottom="free"), free.replace(bottom="wall")):
        with pytest.raises(InputError, match=r"^chain: flies apart"):
            Flow(chain, 1.0)
    for chain in (
        walls,
        free.replace(top_load=1.0),
        free.replace(gravity=9.81),
        free.replace(top="wall"),
    ):
        assert Flow(chain, 1.0).size == chain.movable
    sine = {"amplitude": 1e-9, "frequency": 1e4}
    loaded = free.replace(top_load=1.0)
    assert Flow(loaded, 1.0, Drive(**sine)).size == 1
    for drive in (Drive(**sine, cycles=3), Drive(times=[0, 1e-5, 2e-5], displacement=[0, 1e-9, 0])):
        with pytest.raises(InputError, match=r"^drive: must be a sine"):
            Flow(loaded, 1.0, drive)
    with pytest.raises(InputError, match=r"^drive.grain"):
        Flow(loaded, 1.0, Drive(**sine, grain=0))
