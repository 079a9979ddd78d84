"""Derivatives by parameters of laws by formula and of grounds, and fits of such parameters.

The reference shares only Eq. (1) with the package: Gragg's midpoint rule, extrapolated to order 16,
in complex arithmetic. A parameter with an imaginary part of 1e-30 gives the exact derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers import extrapolated_midpoint
from helpers.example_scenes import struck
from helpers.extrapolated_midpoint import TERMS, Term
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from lmpchain import Chain, Drive, Impulse, InputError, Law, Scene, laws, simulate
from lmpchain.design import (
    DriveWork,
    Energy,
    Momentum,
    Optimum,
    PeakForce,
    Traces,
    fit,
    gradient,
    optimise,
    sensitivity,
)
from lmpchain.design.differences import differentiate, size_by_force
from lmpchain.design.gradients import at_step
from lmpchain.design.objectives import Seen, contact_force
from lmpchain.errors import RunFailed
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.measure import contact, energy

TINY = 1e-30

END = 2e-5
PRESSED = Chain(grains=5, diameter=1e-3, gravity=0.0, top_load=1.0)
BONDED = PRESSED.replace(top_load=0.0)
MASS = float(PRESSED.masses[0])
K = float(PRESSED.contact_constants[0])
COUNTS = range(2, 18, 2)
Values = dict[str, Any]


def positive(overlap: Any) -> Any:
    """Return the overlap of a closed contact, 0 if it is open."""
    return np.where(overlap.real > 0, overlap, 0.0)


def hertz(overlap: Any, p: Values) -> Any:
    return p.get("k", K) * positive(overlap) ** 1.5 * (1 + p.get("c", 0.0) * overlap)


def toda(overlap: Any, p: Values) -> Any:
    return p["k"] * (np.exp(p["b"] * overlap) - 1) / p["b"]


def duffing(u: Any, p: Values) -> Any:
    return p["s"] * u + p["beta"] * u**3


def nothing(u: Any, p: Values) -> Any:
    return 0.0 * u


class Case(NamedTuple):
    """A scene, its forces written down a second time, and the values of their parameters."""

    chain: Chain
    law: Callable[[Any, Values], Any]
    ground: Callable[[Any, Values], Any]
    values: Values
    strike: float = 0.1
    steps: int = 20
    viscosity: float = 0.0

    @property
    def scene(self) -> Scene:
        return struck(self.chain, self.strike, END, 21)

    @property
    def names(self) -> dict[str, str]:
        owner = "law" if self.ground is nothing else "ground"
        return {key: f"chain.{owner}.{key}" for key in self.values}


HERTZ = Law("k*max(o, 0)**1.5*(1 + c*o)", c=2e4)
GROUND = Law("s*u + beta*u**3", s=2e5, beta=1e19)
SHORT = PRESSED.replace(grains=4)
SPREAD = K * (1 + 0.05 * np.arange(3))
CASES = {
    "hertz": Case(PRESSED.replace(law=HERTZ), hertz, nothing, {"c": 2e4}),
    "viscous": Case(
        PRESSED.replace(law=HERTZ, damping={"viscoelastic": 1e-8}),
        hertz,
        nothing,
        {"c": 2e4},
        viscosity=1e-8,
    ),
    "toda": Case(BONDED.replace(law=laws.toda(b=5e5, k=1e6)), toda, nothing, {"b": 5e5, "k": 1e6}),
    "duffing": Case(PRESSED.replace(ground=GROUND), hertz, duffing, {"s": 2e5, "beta": 1e19}),
    "each contact": Case(
        SHORT.replace(law=Law("k*max(o, 0)**1.5", k=SPREAD)), hertz, nothing, {"k": SPREAD}
    ),
    # A change of c by itself moves the grains by less than the rounding error.
    "hertz near 0": Case(PRESSED.replace(law=Law(HERTZ.text, c=1e-9)), hertz, nothing, {"c": 1e-9}),
    "hertz at 0": Case(PRESSED.replace(law=Law(HERTZ.text, c=0.0)), hertz, nothing, {"c": 0.0}),
    "duffing at 0": Case(
        PRESSED.replace(ground=Law(GROUND.text, s=0.0, beta=0.0)),
        hertz,
        duffing,
        {"s": 0.0, "beta": 0.0},
    ),
    "each contact at 0": Case(
        SHORT.replace(law=Law(HERTZ.text, c=[0.0] * 3)), hertz, nothing, {"c": np.zeros(3)}
    ),
}


def rest_of(case: Case, p: Values) -> NDArray[Any]:
    """Return the overlaps at rest, (N-1,), by iterations with the real slope."""
    load = case.chain.top_load
    overlap = np.full(case.chain.grains - 1, 1e-6 if load else 0.0, complex)
    for _ in range(60 if load else 0):
        slope = (case.law(overlap.real + 1e-10, p) - case.law(overlap.real - 1e-10, p)) / 2e-10
        overlap = overlap - (case.law(overlap, p) - load) / slope.real
    return overlap


def motion_of(case: Case, p: Values, samples: int = 21) -> NDArray[Any]:
    """Return displacements and velocities of the free grains at the samples, (T, 2, N-1)."""
    rest = rest_of(case, p)
    still = case.law(rest, p)

    def rate(y: Any) -> Any:
        u, v = y
        overlap = rest + u - np.append(u[1:], 0.0)
        force = case.law(overlap, p) - still
        if case.viscosity:
            h = 1e-11
            stiffness = (case.law(overlap + h, p) - case.law(overlap - h, p)) / (2 * h)
            force = force + case.viscosity * stiffness * (v - np.append(v[1:], 0.0))
        push = np.append(0.0, force[:-1]) - force - case.ground(u, p)
        return np.array([v, push / MASS])

    def step(y: Any, length: float) -> Any:
        row: list[Any] = []
        for j, count in enumerate(COUNTS):
            h = length / count
            before, now = y, y + h * rate(y)
            for _ in range(count - 1):
                before, now = now, before + 2 * h * rate(now)
            new = [(before + now + h * rate(now)) / 2]
            for k in range(j):
                ratio = (count / COUNTS[j - k - 1]) ** 2
                new.append(new[k] + (new[k] - row[k]) / (ratio - 1))
            row = new
        return row[-1]

    y = np.zeros((2, case.chain.grains - 1), complex)
    y[1, 0] = case.strike
    rows = [y]
    each = max(1, case.steps // (samples - 1))
    for _ in range(samples - 1):
        for _ in range(each):
            y = step(y, END / (samples - 1) / each)
        rows.append(y)
    return np.array(rows)


def momentum_slopes(case: Case, key: str) -> NDArray[np.float64]:
    """Return the derivatives of the final momentum of grain 3 by all entries of a parameter."""
    base = np.atleast_1d(case.values[key]).astype(complex)
    slopes = []
    for entry in range(base.size):
        value = base.copy()
        change = TINY * float(abs(base[entry]) or 1.0)
        value[entry] += 1j * change
        moved = case.values | {key: value if base.size > 1 else value[0]}
        slopes.append(MASS * motion_of(case, moved, 2)[-1, 1, 2].imag / change)
    return np.array(slopes)


@pytest.mark.parametrize("name", [name for name in CASES if name != "hertz at 0"])
def test_parameters_of_formulas_have_the_derivatives_of_complex_steps(name: str) -> None:
    case = CASES[name]
    found = gradient(case.scene, Momentum([3]), case.names.values(), tolerance=1e-4)
    assert found.error <= 1e-4
    for key, parameter in case.names.items():
        true = momentum_slopes(case, key)
        assert found[parameter].shape == true.shape
        off = np.abs(found[parameter] - true).max()
        assert off <= found.errors[parameter], parameter
        assert off <= 1e-4 * np.abs(true).max(), parameter


@pytest.mark.slow
def test_opening_contacts_keep_the_stated_error() -> None:
    """The reference ends its steps where a contact opens; its differences are of order 4."""
    c = 2e4
    chain = PRESSED.replace(grains=6, top_load=0.01, law=HERTZ)
    scene = CASES["hertz"]._replace(chain=chain, strike=0.3).scene

    def momentum(value: float) -> float:
        law = Law(HERTZ.text, c=value)
        TERMS[law] = [Term("one-sided", K, p=1.5), Term("one-sided", K * value, p=2.5)]
        changed = scene.replace(chain=chain.replace(law=law), samples=2)
        run = extrapolated_midpoint.solve(changed, 1e-15)
        assert run.events > 0
        return float(MASS * run.velocity[-1, 2])

    def difference(h: float) -> float:
        return (momentum(c * (1 + h)) - momentum(c * (1 - h))) / (2 * c * h)

    true = (4 * difference(1e-3) - difference(2e-3)) / 3
    for adaptive in (False, True):
        found = gradient(scene, Momentum([3]), ["chain.law.c"], tolerance=1e-4, adaptive=adaptive)
        off = abs(found["chain.law.c"][0] - true)
        assert off <= found.errors["chain.law.c"] <= 1e-4 * abs(true) * 1.01, adaptive


@pytest.mark.parametrize("waves", [1.0, 30.0, 1000.0])
@pytest.mark.parametrize("digit", [1e-13, 1e-9])
def test_differences_keep_the_accuracy_or_state_a_larger_error(waves: float, digit: float) -> None:
    """The value is a sine of the load, rounded to a digit; some loads are not allowed."""

    def value(scene: Scene, reach: float = 1.0) -> NDArray[np.float64]:
        load = scene.chain.top_load
        if abs(load - 1) > reach:
            raise InputError.at("top_load", "is too large")
        return np.array([np.round(np.sin(waves * load) / digit) * digit, 1.0])

    true = waves * np.cos(waves)
    for accuracy in (1e-3, 1e-5):
        found = differentiate(PLAIN, "top_load", np.eye(1), value, digit / 2, accuracy)
        assert found.slope[0, 1] == 0
        assert abs(found.slope[0, 0] - true) <= found.error <= 1.001 * accuracy * abs(true)

    def limited(scene: Scene) -> NDArray[np.float64]:
        return value(scene, 0.0101)

    # Changes that would reduce the rounding error enough are not allowed.
    found = differentiate(PLAIN, "top_load", np.eye(1), limited, digit / 2, digit)
    assert digit * abs(true) < found.error
    assert abs(found.slope[0, 0] - true) <= found.error <= 1e-5 * max(1.0, waves**2)


def on_a_ground(share: float) -> tuple[Scene, float, float]:
    """Return a grain between a linear wall and a soft ground, their stiffness and frequency.

    The stiffness of the ground relative to the wall is `share`.
    """
    chain = Chain(
        grains=1, diameter=1e-3, exponent=1.0, gravity=0.0, top_load=1.0, bottom="wall",
        ground=Law("s*u", s=share * K),
        wall_constants=(0.0, K),
    )  # fmt: skip
    omega = np.sqrt((1 + share) * K / MASS)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=10 / omega, samples=41)
    return scene, (1 + share) * K, omega


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_harmonic_grain_has_the_derivatives_of_a_cosine(share: float) -> None:
    scene, stiffness, omega = on_a_ground(share)
    v = 1e-3
    # The force on the grain is the stiffness times its displacement.
    assert size_by_force(scene, "chain.ground.s") == pytest.approx(stiffness, rel=0.05)
    names = ["chain.ground.s", "wall_constants", "velocity", "displacement"]
    found = gradient(scene, Momentum([1]), names, tolerance=1e-5)
    by_stiffness = -MASS * v * np.sin(10) * 10 / (2 * stiffness)
    exact = {
        "chain.ground.s": [by_stiffness],
        "wall_constants": [0.0, by_stiffness],
        "velocity": [MASS * np.cos(10)],
        "displacement": [-MASS * omega * np.sin(10)],
    }
    assert found.value == pytest.approx(MASS * v * np.cos(10), rel=1e-6)
    for name, true in exact.items():
        off = np.abs(found[name] - true).max()
        assert off <= found.errors[name] <= 1e-5 * np.abs(true).max(), name


def test_a_fit_finds_the_ground_of_a_harmonic_grain() -> None:
    """The traces are a cosine, a sine, and the force of the wall, with different times."""
    truth = -0.01  # The fit begins at 0 and may change the sign.
    omega = on_a_ground(truth)[2]
    time = np.linspace(0.0, 9.0, 31) / omega
    v = 1e-3 * np.cos(omega * time)
    u = 1e-3 * np.sin(omega * time) / omega
    traces = [
        Traces(time, [1], v, noise=1e-6),
        Traces(time[3:], [1], u[3:], "displacement", noise=1e-6 / omega),
        Traces(time[:9], [1], K * u[:9], "contact", noise=1e-6 * MASS * omega),
    ]
    found = fit(traces, on_a_ground(0.0)[0], ["chain.ground.s"])
    assert found.names == ["chain.ground.s"]
    assert abs(found.estimate[0] - truth * K) <= found.bias[0] <= 0.051 * found.error[0]
    assert found.values["chain.ground.s"] == found.estimate


@pytest.mark.parametrize("top", ["free", "wall"])
def test_the_size_of_a_parameter_follows_from_the_largest_force(top: str) -> None:
    """A grain on or between linear walls: c o^2 is as large as k o at the largest overlap."""
    chain = Chain(
        grains=1, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall", top=top,
        law=Law("k*o + c*o**2", c=0.0),
    )  # fmt: skip
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-2), duration=1e-6, samples=3)
    wall = chain.contacts.constant[1]
    largest = 1.0 / wall + 1e-2 / np.sqrt((1 + (top == "wall")) * wall / MASS)
    assert size_by_force(scene, "chain.law.c") == pytest.approx(wall / largest, rel=1e-2)


def test_a_run_that_breaks_down_is_reported() -> None:
    scene = CASES["toda"].scene.replace(duration=2e-3)
    with pytest.raises(RunFailed, match=r"^the motion breaks down with steps of 0\.0001 s: use"):
        gradient(scene, Momentum([2]), ["masses"], step=1e-3)


PLAIN = Scene(chain=PRESSED, excitation=Impulse(velocity=0.1), duration=END, samples=21)


@pytest.mark.parametrize("objective", [PeakForce(3), Energy([2, 3])])
def test_other_parameters_have_the_derivatives_of_the_adjoint(objective: Any) -> None:
    """A ground that is too soft to matter changes the derivatives to differences."""
    plain = PLAIN.replace(chain=SHORT)
    names = ["masses", "contact_constants", "top_load", "velocity"]
    soft = PLAIN.replace(chain=SHORT.replace(ground=laws.klein_gordon(k=1e-12)))
    exact = gradient(plain, objective, names, tolerance=1e-4)
    found = gradient(soft, objective, names, tolerance=1e-4)
    assert found.value == pytest.approx(exact.value, rel=1e-10)
    for name in names:
        off = np.abs(found[name] - exact[name]).max()
        assert off <= found.errors[name] + exact.errors[name]
        assert off <= 2e-4 * np.abs(exact[name]).max()


def test_objectives_of_formulas_have_the_values_of_measures() -> None:
    case = CASES["duffing"]
    chain = case.chain.replace(law=HERTZ)
    scene = case.scene.replace(chain=chain, samples=401)
    run = simulate(scene, "native", tolerance=1e-9)

    def value(scene: Scene, objective: Any) -> float:
        return at_step(scene, objective, (), SPLITTINGS["rkn4"], 2e-8).value

    shares = energy.shares(run)
    assert value(scene, Energy([2, 3])) == pytest.approx(shares.of_grain[-1, 1:3].sum(), rel=1e-6)
    peak = contact.contacts(run, [3]).force[:, 0].max()
    assert value(scene, PeakForce(3, sharpness=1e4)) == pytest.approx(peak, rel=1e-3)
    driven = scene.replace(excitation=Drive(amplitude=1e-7, frequency=1e5))
    ledger = energy.ledger(simulate(driven, "native", tolerance=1e-9))
    work = (ledger.total - ledger.total[0])[-1]
    assert value(driven, DriveWork()) == pytest.approx(work, rel=1e-5)


@pytest.mark.slow
def test_fits_recover_parameters_within_their_intervals(rng: np.random.Generator) -> None:
    """Of 12 draws of noise on traces of the reference, 95 % intervals cover 10 or more."""
    chain = PRESSED.replace(law=HERTZ, ground=GROUND)
    values = {"c": 2e4, "s": 2e5, "beta": 1e19}
    case = Case(chain, hertz, duffing, values, strike=0.3)
    motion = motion_of(case, values, 41).real
    time = np.linspace(0.0, END, 41)
    noise = 2e-3
    guess = case.scene.replace(
        chain=chain.replace(
            law=Law(HERTZ.text, c=2.3e4), ground=Law(GROUND.text, s=1.6e5, beta=1e19)
        )
    )
    true = np.array([2e4, 2e5])
    inside = np.zeros(2)
    off = []
    for _ in range(12):
        noisy = motion[:, 1, [2, 3]] + noise * rng.standard_normal((41, 2))
        found = fit(
            Traces(time, [3, 4], noisy, noise=noise), guess, ["chain.law.c", "chain.ground.s"]
        )
        assert found.names == ["chain.law.c", "chain.ground.s"]
        assert (found.bias <= 0.051 * found.error).all()
        guess = found.scene  # A near guess saves runs.
        off.append((found.estimate - true) / found.error)
        inside += np.abs(off[-1]) <= 1.96
    assert (inside >= 10).all()
    assert (np.abs(np.mean(off, axis=0)) < 3 / np.sqrt(12)).all()


@pytest.mark.slow
def test_an_exact_trace_returns_the_stiffness_of_each_contact() -> None:
    stiffness = SPREAD[:2]
    chain = PRESSED.replace(grains=3, law=Law("k*max(o, 0)**1.5", k=stiffness))
    case = Case(chain, hertz, nothing, {"k": stiffness})
    motion = motion_of(case, case.values, 41).real
    guess = case.scene.replace(chain=chain.replace(law=Law("k*max(o, 0)**1.5", k=[K, K])))
    traces = Traces(np.linspace(0.0, END, 41), [1, 2], motion[:, 1])
    found = fit(traces, guess, {"chain.law.k": "each"})
    np.testing.assert_allclose(found.values["chain.law.k"], stiffness, rtol=1e-5)
    np.testing.assert_allclose(found.scene.chain.contact_constants, stiffness, rtol=1e-5)


@pytest.mark.slow
def test_optima_and_sensitivities_take_parameters_of_formulas() -> None:
    chain = PRESSED.replace(grains=3, law=HERTZ)
    scene = CASES["hertz"].scene.replace(chain=chain)
    bounds = {"chain.law.c": (1e4, 3e4)}
    best = optimise(scene, Momentum([2]), ["chain.law.c"], bounds, starts=1, maximise=True, runs=10)
    assert isinstance(best, Optimum)
    ends = [
        gradient(
            scene.replace(chain=chain.replace(law=Law(HERTZ.text, c=c))),
            Momentum([2]),
            ["chain.law.c"],
            tolerance=1e-3,
        ).value
        for c in (1e4, 3e4)
    ]
    assert best.value >= max(ends) - 1e-4 * abs(max(ends))
    found = sensitivity(scene, "momentum:2", {"chain.law.c": 0.05}, tolerance=1e-3)
    assert "chain.law.c" in found.relative
    assert found.scatter == pytest.approx(found.uncertainty["chain.law.c"], rel=0.3)


@pytest.mark.parametrize(
    ("name", "chain", "message"),
    [
        ("chain.law.b", {"law": HERTZ}, "parameters: must be masses | .* | chain.law.c"),
        ("chain.law.c", {}, "parameters: must be masses"),
        ("chain.law.q", {"law": Law("k*o + q*max(o - 1, 0)", q=0.0)}, "is 0, so that the size"),
        ("contact_constants", {"law": laws.toda(b=1e5, k=1e6)}, "use chain.law.k"),
        ("masses", {"law": HERTZ, "impurity": [{"grain": 2, "mass": 1e-6}]}, "with impurities"),
    ],
)
def test_missing_derivatives_are_refused(name: str, chain: dict[str, Any], message: str) -> None:
    scene = PLAIN.replace(chain=PRESSED.replace(**chain))
    with pytest.raises(InputError, match=message.replace("|", r"\|")):
        gradient(scene, Momentum([1]), [name])


def test_a_viscous_bond_has_the_force_that_the_momentum_shows() -> None:
    """Contact 3 alone acts on grains 1 to 3, also while the bond is stretched."""
    chain = BONDED.replace(law=laws.toda(b=5e5, k=1e6), damping={"viscoelastic": 1e-7})
    scene = CASES["toda"].scene.replace(chain=chain, samples=401)
    run = simulate(scene, "native", tolerance=1e-9)
    acceleration = make_interp_spline(run.time, run.velocity, k=5)(run.time, 1)
    true = -MASS * acceleration[:, :3].sum(axis=1)
    u, v = run.displacement[:, 2:4], run.velocity[:, 2:4]
    assert 0.1 < np.mean(u[:, 0] < u[:, 1]) < 0.9
    view = Seen(scene, run.time, np.array([3, 4]), u, v)
    for found in (contact_force(view, 3).value, contact.contacts(run, [3]).force[:, 0]):
        np.testing.assert_allclose(found, true, rtol=0, atol=1e-5 * np.abs(true).max())
    ledger = energy.ledger(run)
    np.testing.assert_allclose(ledger.total + ledger.dissipated, ledger.total[0], rtol=1e-6)


def test_a_drive_excludes_initial_motion() -> None:
    scene = PLAIN.replace(
        chain=PRESSED.replace(law=HERTZ), excitation=Drive(amplitude=1e-7, frequency=1e5)
    )
    with pytest.raises(InputError, match="velocity: has no derivative with formulas and a drive"):
        gradient(scene, Momentum([2]), ["velocity"])


def test_a_ground_in_time_has_no_energy_of_grains() -> None:
    ground = Law("s*(1 + a*sin(w*t))*u", s=1e5, a=0.1, w=1e5)
    scene = PLAIN.replace(chain=PRESSED.replace(ground=ground))
    with pytest.raises(InputError, match="the energy of grains does not support"):
        gradient(scene, Energy([2]), ["chain.ground.a"])
    assert gradient(scene, Momentum([2]), ["chain.ground.w"], tolerance=1e-4).error <= 1e-4
