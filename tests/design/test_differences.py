"""Derivatives by parameters of laws by formula and of grounds, and fits of such parameters.

The reference shares only Eq. (1) with the package: Gragg's midpoint rule, extrapolated to order 16,
in complex arithmetic. A parameter with an imaginary part of 1e-30 gives the exact derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers import extrapolated_midpoint
from helpers.extrapolated_midpoint import TERMS, Term
from numpy.typing import NDArray

from lmpchain import Chain, Drive, Impulse, InputError, Law, Scene, laws, simulate
from lmpchain.design import (
    DriveWork,
    Energy,
    KineticEnergy,
    Momentum,
    Optimum,
    PeakForce,
    Traces,
    fit,
    gradient,
    optimise,
    sensitivity,
)
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
    """A scene, its forces written down a second time, and the names of its parameters."""

    chain: Chain
    law: Callable[[Any, Values], Any]
    ground: Callable[[Any, Values], Any]
    values: Values
    names: dict[str, str]
    strike: float = 0.1
    steps: int = 40
    viscosity: float = 0.0

    @property
    def scene(self) -> Scene:
        return Scene(
            chain=self.chain, excitation=Impulse(velocity=self.strike), duration=END, samples=21
        )


HERTZ = Law("k*max(o, 0)**1.5*(1 + c*o)", c=2e4)
GROUND = Law("s*u + beta*u**3", s=2e5, beta=1e19)
SHORT = PRESSED.replace(grains=4)
SPREAD = K * (1 + 0.05 * np.arange(3))
CASES = {
    "hertz": Case(PRESSED.replace(law=HERTZ), hertz, nothing, {"c": 2e4}, {"c": "chain.law.c"}),
    "viscous": Case(
        PRESSED.replace(law=HERTZ, damping={"viscoelastic": 1e-8}),
        hertz,
        nothing,
        {"c": 2e4},
        {"c": "chain.law.c"},
        viscosity=1e-8,
    ),
    "toda": Case(
        BONDED.replace(law=laws.toda(b=5e5, k=1e6)),
        toda,
        nothing,
        {"b": 5e5, "k": 1e6},
        {"b": "chain.law.b", "k": "chain.law.k"},
    ),
    "duffing": Case(
        PRESSED.replace(ground=GROUND),
        hertz,
        duffing,
        {"s": 2e5, "beta": 1e19},
        {"s": "chain.ground.s", "beta": "chain.ground.beta"},
    ),
    "each contact": Case(
        SHORT.replace(law=Law("k*max(o, 0)**1.5", k=SPREAD)),
        hertz,
        nothing,
        {"k": SPREAD},
        {"k": "chain.law.k"},
    ),
    # A change of c by itself moves the grains by less than the rounding error.
    "hertz near 0": Case(
        PRESSED.replace(law=Law(HERTZ.text, c=1e-9)),
        hertz,
        nothing,
        {"c": 1e-9},
        {"c": "chain.law.c"},
    ),
    "hertz at 0": Case(
        PRESSED.replace(law=Law(HERTZ.text, c=0.0)),
        hertz,
        nothing,
        {"c": 0.0},
        {"c": "chain.law.c"},
    ),
    "duffing at 0": Case(
        PRESSED.replace(ground=Law(GROUND.text, s=0.0, beta=0.0)),
        hertz,
        duffing,
        {"s": 0.0, "beta": 0.0},
        {"s": "chain.ground.s", "beta": "chain.ground.beta"},
    ),
    "each contact at 0": Case(
        SHORT.replace(law=Law(HERTZ.text, c=[0.0] * 3)),
        hertz,
        nothing,
        {"c": np.zeros(3)},
        {"c": "chain.law.c"},
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


@cache
def states_of(name: str, key: str) -> tuple[list[NDArray[Any]], list[float]]:
    """Return the final states for a complex step of each entry of a parameter, and the steps."""
    case = CASES[name]
    base = np.atleast_1d(case.values[key]).astype(complex)
    states, changes = [], []
    for entry in range(base.size):
        value = base.copy()
        changes.append(TINY * float(abs(base[entry]) or 1.0))
        value[entry] += 1j * changes[-1]
        moved = case.values | {key: value if base.size > 1 else value[0]}
        states.append(motion_of(case, moved, 2)[-1])
    return states, changes


def derivatives_of(
    name: str, key: str, objective: Callable[[NDArray[Any]], Any]
) -> NDArray[np.float64]:
    """Return the derivatives of an objective of the final state by all entries of a parameter."""
    states, changes = states_of(name, key)
    return np.array([objective(y).imag for y in states]) / changes


OBJECTIVES: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    "momentum": (Momentum([3]), lambda y: MASS * y[1, 2]),
    "kinetic energy": (KineticEnergy([2, 3]), lambda y: MASS * (y[1, 1:3] ** 2).sum() / 2),
}


# Every chain has the first objective; the second one needs no new forces.
@pytest.mark.parametrize(
    ("name", "what"),
    [(name, "momentum") for name in CASES if name != "hertz at 0"]
    + [(name, "kinetic energy") for name in ("viscous", "duffing")],
)
def test_parameters_of_formulas_have_the_derivatives_of_complex_steps(name: str, what: str) -> None:
    case = CASES[name]
    objective, of_state = OBJECTIVES[what]
    found = gradient(case.scene, objective, case.names.values(), tolerance=1e-5)
    assert found.error <= 1e-5
    for key, parameter in case.names.items():
        true = derivatives_of(name, key, of_state)
        assert found[parameter].shape == true.shape
        off = np.abs(found[parameter] - true).max()
        assert off <= found.errors[parameter], parameter
        assert off <= 1e-5 * np.abs(true).max(), parameter


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


PLAIN = Scene(chain=PRESSED, excitation=Impulse(velocity=0.1), duration=END, samples=21)


@pytest.mark.parametrize("objective", [Momentum([3]), PeakForce(4), Energy([2, 3])])
def test_other_parameters_have_the_derivatives_of_the_adjoint(objective: Any) -> None:
    """A ground that is too soft to matter changes the derivatives to differences."""
    names = ["masses", "contact_constants", "top_load", "velocity"]
    soft = PLAIN.replace(chain=PRESSED.replace(ground=laws.klein_gordon(k=1e-12)))
    exact = gradient(PLAIN, objective, names, tolerance=1e-4)
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
    by_energy = gradient(scene, Energy([2, 3]), ["chain.law.c"], tolerance=1e-4)
    shares = energy.shares(run)
    assert by_energy.value == pytest.approx(shares.of_grain[-1, 1:3].sum(), rel=1e-6)
    by_peak = gradient(scene, PeakForce(3, sharpness=1e4), ["chain.law.c"], tolerance=1e-3)
    assert by_peak.value == pytest.approx(contact.contacts(run, [3]).force[:, 0].max(), rel=1e-3)
    driven = scene.replace(excitation=Drive(amplitude=1e-7, frequency=1e5))
    by_work = gradient(driven, DriveWork(), ["chain.ground.s"], tolerance=1e-4)
    ledger = energy.ledger(simulate(driven, "native", tolerance=1e-9))
    assert by_work.value == pytest.approx((ledger.total - ledger.total[0])[-1], rel=1e-5)


@pytest.mark.slow
def test_fits_recover_parameters_within_their_intervals(rng: np.random.Generator) -> None:
    """Of 12 draws of noise on traces of the reference, 95 % intervals cover 10 or more."""
    chain = PRESSED.replace(law=HERTZ, ground=GROUND)
    values = {"c": 2e4, "s": 2e5, "beta": 1e19}
    case = Case(chain, hertz, duffing, values, {}, strike=0.3)
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
    case = Case(chain, hertz, nothing, {"k": stiffness}, {"k": "chain.law.k"})
    motion = motion_of(case, case.values, 41).real
    guess = case.scene.replace(chain=chain.replace(law=Law("k*max(o, 0)**1.5", k=[K, K])))
    traces = Traces(np.linspace(0.0, END, 41), [1, 2], motion[:, 1])
    found = fit(traces, guess, {"chain.law.k": "each"})
    np.testing.assert_allclose(found.values["chain.law.k"], stiffness, rtol=1e-5)
    np.testing.assert_allclose(found.scene.chain.contact_constants, stiffness, rtol=1e-5)


@pytest.mark.slow
def test_a_fit_begins_at_0() -> None:
    case = CASES["hertz at 0"]
    motion = motion_of(case, {"c": -2e4}, 41).real
    traces = Traces(np.linspace(0.0, END, 41), [2, 4], motion[:, 1, [1, 3]])
    found = fit(traces, case.scene, ["chain.law.c"])
    assert found.values["chain.law.c"] == pytest.approx(-2e4, rel=1e-5)


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
