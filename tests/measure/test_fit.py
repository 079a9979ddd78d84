"""Fits of theory to trajectories and of scenes to traces, compared with exact solutions."""

from __future__ import annotations

import json
import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.convergence import slope
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck
from helpers.faults import fault_keys

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Impulse,
    InputError,
    Material,
    Profile,
    Scene,
    Trajectory,
    simulate,
)
from lmpchain.measure.fit import (
    ExponentFit,
    Trace,
    fit_bessel,
    fit_continuum,
    fit_exponents,
    fit_modes,
    fit_parameter,
    summary,
)
from lmpchain.measure.front import track

C = 1.155137236596699  # 2 (6/5)^(1/5) / B(3/5, 9/10)


def answered(
    chain: Chain,
    excitation: Any,
    units: float,
    samples: int,
    engine: str = "chebyshev",
    **rest: Any,
):
    """Return a run of a given length in units of tau, regardless of its model error."""
    scene = scene_of(chain, excitation, units * chain.time_scale, samples, **rest)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)
        return simulate(scene, engine, 1e-9)


@pytest.fixture(scope="module")
def weak() -> Trajectory:
    """Simulate a weak strike on 300 grains until the front returns halfway from the bottom."""
    return answered(column(300), Impulse(velocity=1e-9), 200.0, 1601)


UNIFORM = column(40, gravity=0.0, top_load=0.1)


@pytest.fixture(scope="module")
def uniform() -> Trajectory:
    return answered(UNIFORM, Impulse(velocity=1e-9), 30.0, 121)


# --- Bessel functions


@pytest.mark.parametrize(
    ("excitation", "engine"),
    [
        (Impulse(velocity=1e-9), "native"),
        (Impulse(velocity=1e-9), "chebyshev"),
        (Impulse(velocity=-1e-9, grain=17), "chebyshev"),
        (Displacement(displacement=1e-15, grain=3), "chebyshev"),
    ],
)
def test_the_parameters_of_a_uniform_chain_are_recovered(excitation: Any, engine: str):
    fit = fit_bessel(answered(UNIFORM, excitation, 30.0, 121, engine))
    assert fit.amplitude / fit.expected[0] == pytest.approx(1, abs=1e-6)
    assert fit.kappa == pytest.approx(1, abs=1e-6)
    assert fit.rate * UNIFORM.time_scale == pytest.approx(1, abs=1e-6)
    assert abs(fit.delay) < 1e-6 * UNIFORM.time_scale
    assert fit.residual < 1e-6
    assert (fit.error[[0, 1]] / np.abs(fit.expected[[0, 1]]) < 1e-6).all()


def test_the_local_speed_in_a_column():
    """The fit near grain 150 gives kappa_n = n^(1/3), within the neglected terms."""
    fit = fit_bessel(answered(column(300), Impulse(velocity=1e-9, grain=150), 40.0, 401))
    assert fit.kappa == pytest.approx(150 ** (1 / 3), rel=5e-3)
    assert fit.amplitude == pytest.approx(1e-9, rel=5e-3)
    assert np.unique(fit.grain)[[0, -1]].tolist() == [129, 174]
    assert fit.residual < 0.1


# --- the continuum


def test_amplitude_of_the_impulse_response(weak: Trajectory):
    fit = fit_continuum(weak)
    assert fit.amplitude == pytest.approx(C, rel=5e-6)
    assert fit.expected == pytest.approx(C, rel=1e-14)
    assert abs(fit.amplitude - C) < fit.error < 1e-4
    assert fit.residual < 1e-5


def test_amplitude_at_the_surface():
    """The top grain alone has v0 C tau^(-1/5), to 5e-5 from tau = 50 on."""
    top = answered(column(200), Impulse(velocity=-2e-9), 150.0, 301, grains=[1])
    fit = fit_continuum(top)
    assert fit.front is None
    assert np.unique(fit.grain).tolist() == [1]
    assert fit.amplitude == pytest.approx(C, rel=5e-5)
    assert fit.cone.min() > 50**2 - 1


def test_law_of_the_front(weak: Trajectory):
    """Without the lag 0.908 h^(1/6) / 4^(1/3), the exponent of (6/5) h^(5/6) would be 0.825."""
    law = fit_continuum(weak).front
    assert law is not None
    assert law.exponent == pytest.approx(5 / 6, abs=1e-3)
    assert law.factor == pytest.approx(6 / 5, rel=5e-3)
    assert (np.abs([law.exponent, law.factor] - law.expected) < law.error[:2]).all()
    assert law.error[0] < 2e-3
    assert law.shift == pytest.approx(0.908 * law.depth ** (1 / 6) / 4 ** (1 / 3), rel=1e-3)
    assert np.abs(law.residual).max() < 1e-3
    raw = slope(law.depth, law.time)
    assert abs(raw - 5 / 6) > 5e-3


def test_the_front_is_found_for_any_error(weak: Trajectory):
    """The error of a dump is unknown, and its estimate infinite."""
    law, same = (fit_continuum(of_error(weak, error)).front for error in (1e-12, math.inf))
    assert law is not None
    assert same is not None
    assert same.exponent == law.exponent


@pytest.mark.parametrize("delta", [1.2, 2.0])
def test_other_exponents_of_the_contacts(delta: float):
    chain = column(150, exponent=delta)
    end = 2 / (1 + 1 / delta) * 150 ** ((1 + 1 / delta) / 2)
    fit = fit_continuum(answered(chain, Impulse(velocity=1e-9), 1.3 * end, 1001))
    assert abs(fit.amplitude - fit.expected) < fit.error < 1e-3 * fit.expected
    assert fit.front is not None
    assert abs(fit.front.exponent - (1 + 1 / delta) / 2) < fit.front.error[0] < 6e-3


@pytest.fixture(scope="module")
def fit(weak: Trajectory) -> ExponentFit:
    return fit_exponents(weak)


def test_exponents_of_the_front(fit: ExponentFit):
    true = {
        "velocity": -4 / 15,
        "displacement": -1 / 10,
        "time": 5 / 6,
        "speed": 1 / 6,
        "width": 1 / 6,
    }
    assert dict(fit.expected) == pytest.approx(true)
    for name, law in fit.laws.items():
        assert law.exponent == pytest.approx(true[name], abs=4e-3)
        assert law.error[0] < 1e-2
        assert law.depth[0] == 19.5
    assert abs(fit.laws["velocity"].exponent + 4 / 15) < fit.laws["velocity"].error[0]


# --- the inverse


def struck_with(parameter: str, value: float) -> Scene:
    given = {"velocity": 8e-4, "top_load": 0.05, "youngs_modulus": 62e9} | {parameter: value}
    stuff = Material(density=2426.0, youngs_modulus=given["youngs_modulus"], poissons_ratio=0.2)
    chain = column(16, top_load=given["top_load"], material=stuff)
    return struck(chain, given["velocity"], 2e-5, 61)


PARAMETERS = {"velocity": (8e-4, 1.3e-3), "top_load": (0.05, 0.08), "youngs_modulus": (62e9, 45e9)}
NATIVE = partial(simulate, engine="native", tolerance=1e-9)


@pytest.mark.parametrize(
    ("parameter", "field"),
    [
        ("velocity", "force"),
        ("top_load", "displacement"),
        ("youngs_modulus", "velocity"),
        ("youngs_modulus", "force"),
    ],
)
def test_a_parameter_is_recovered_from_a_run_of_lammps(parameter: Any, field: Any):
    true, guess = PARAMETERS[parameter]
    trace = Trace.of(simulate(struck_with(parameter, true), "lammps", 1e-8), [4, 9], field)
    fit = fit_parameter(trace, struck_with(parameter, guess), parameter, NATIVE)
    assert fit.value == pytest.approx(true, rel=1e-6)
    assert fit.residual < 1e-6
    assert fit.error < 1e-6 * true
    assert fit.model.shape == trace.values.shape == (61, 2)
    assert fit.runs < 40


def test_times_of_an_oscilloscope():
    """Unevenly spaced times that begin after 0 are interpolated between the engine's samples."""
    scene = struck_with("velocity", 8e-4)
    dense = simulate(Scene(**scene.given() | {"samples": 2001}), "lammps", 1e-8)
    chosen = np.unique(np.random.default_rng(1).integers(200, 2001, 80))
    trace = Trace(dense.time[chosen], 5, dense.velocity[chosen, 4])
    fit = fit_parameter(trace, struck_with("velocity", 1e-3), "velocity", NATIVE)
    assert fit.value == pytest.approx(8e-4, rel=1e-6)


def test_the_trace_of_a_trajectory_and_the_engine_by_default():
    fit = fit_parameter(
        simulate(struck_with("velocity", 8e-4)), struck_with("velocity", 7e-4), "velocity", simulate
    )
    assert fit.value == pytest.approx(8e-4, rel=1e-5)
    assert fit.trace.grain.tolist() == list(range(1, 16))
    assert fit.scene.excitation.velocity == fit.value


CLEAN = Trace(np.linspace(0, 1e-5, 21), 5, np.linspace(1e-5, 2e-5, 21))


@pytest.mark.parametrize(
    ("given", "key"),
    [
        (([0, 1e-6], 3, [1, 2]), "time"),
        (([0, 2e-6, 1e-6], 3, [1, 2, 3]), "time"),
        (([-1e-6, 0, 1e-6], 3, [1, 2, 3]), "time"),
        (([0, 1e-6, 2e-6], 3, [1, 2, 3, 4]), "values"),
        (([0, 1e-6, 2e-6], 3, [1, np.nan, 3]), "values"),
        (([0, 1e-6, 2e-6], 3, [0, 0, 0]), "values"),
        (([0, 1e-6, 2e-6], 3, ["one", "two", "three"]), "values"),
        (([0, 1e-6, 2e-6], 3.5, [1, 2, 3]), "grain"),
        (([0, 1e-6, 2e-6], 3, [1, 2, 3], "colour"), "field"),
    ],
)
def test_invalid_traces(given: tuple[Any, ...], key: str):
    assert fault_keys(Trace, *given) == [key]


@pytest.mark.parametrize("grains", [[], [0], [3, 41], [2.5]])
def test_a_trace_needs_recorded_grains(grains: list[Any], uniform: Trajectory):
    assert fault_keys(Trace.of, uniform, grains) == ["grain"]


def dropped() -> Scene:
    chain = column(8, contact_constants=np.full(7, 1e9))
    return scene_of(chain, Displacement(displacement=1e-9), 1e-5)


def mixed() -> Scene:
    chain = column(8, material=["glass", "steel"] * 4)
    return struck(chain, 1e-4, 1e-5)


# The motion of grain 15 before the arrival of any wave.
EARLY = Trace(np.linspace(0, 1e-8, 5), 15, np.ones(5))


@pytest.mark.parametrize(
    ("trace", "scene", "parameter", "key"),
    [
        (CLEAN, struck_with("velocity", 0.0), "velocity", "velocity"),
        (CLEAN, struck_with("velocity", 1e-3), "colour", "parameter"),
        (CLEAN, paper("weak"), "top_load", "top_load"),
        (CLEAN, dropped(), "velocity", "excitation"),
        (CLEAN, dropped(), "youngs_modulus", "contact_constants"),
        (CLEAN, mixed(), "youngs_modulus", "material"),
        (CLEAN, struck_with("velocity", 1e-6), "velocity", "velocity"),
        (EARLY, struck_with("youngs_modulus", 62e9), "youngs_modulus", "youngs_modulus"),
    ],
)
def test_invalid_parameters(trace: Trace, scene: Scene, parameter: Any, key: str):
    assert fault_keys(fit_parameter, trace, scene, parameter, NATIVE) == [key]


# --- what does not apply


@pytest.mark.parametrize(
    ("fit", "changes", "key"),
    [
        (fit_modes, {"excitation": Drive(amplitude=1e-9, frequency=1e4)}, "excitation"),
        (fit_modes, {"chain": {"gravity": 0.0}}, "chain"),
        (fit_modes, {"chain": {"top": "wall"}}, "top"),
        (fit_modes, {"grains": [1, 2, 3]}, "grains"),
        (fit_bessel, {"excitation": Profile(velocity=1e-9 * (np.arange(30) < 29))}, "excitation"),
        (fit_bessel, {"chain": {"gravity": 0.0}}, "chain"),
        (fit_bessel, {}, "chain"),
        (fit_bessel, {"chain": {"top_load": 1.0}, "grains": [1], "samples": 5}, "samples"),
        (fit_bessel, {"chain": {"top_load": 1.0}, "grains": [29], "duration": 1e-6}, "samples"),
        (fit_continuum, {"chain": {"top": "wall"}}, "top"),
        (fit_continuum, {}, "duration"),
        (partial(fit_continuum, inside=1.5), {}, "inside"),
        (fit_exponents, {"excitation": Displacement(displacement=1e-12)}, "excitation"),
        (fit_exponents, {}, "duration"),
    ],
)
def test_scenes_to_which_a_fit_does_not_apply(fit: Any, changes: dict[str, Any], key: str):
    chain = column(30, **changes.get("chain", {}))
    scene = struck(chain, 1e-9, 1e-5, 51).replace(**changes | {"chain": chain})
    assert fault_keys(fit, simulate(scene, "native", 1e-6)) == [key]


def test_the_summary_names_suitable_and_unsuitable_fits(weak: Trajectory, uniform: Trajectory):
    found = summary(weak)
    assert list(dict.fromkeys(row.fit for row in found.rows)) == [
        "front",
        "modes",
        "continuum",
        "exponents",
    ]
    assert [fit for fit, _ in found.left_out] == ["bessel", "soliton"]
    assert "strike a grain further down" in found.left_out[0][1]
    value = {row.quantity: row.value for row in found.rows}
    assert value["amplitude C of Eq. (35)"] == pytest.approx(C, rel=1e-5)
    other = summary(uniform)
    assert list(dict.fromkeys(row.fit for row in other.rows)) == ["front", "modes", "bessel"]
    assert [fit for fit, _ in other.left_out] == ["continuum", "exponents", "soliton"]
    data = found.to_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert set(data) == {"strike_number", "rows", "left_out", "notes"}
    assert set(data["rows"][0]) == {"fit", "quantity", "value", "error", "expected", "unit"}
    assert [(each["fit"], each["reason"]) for each in data["left_out"]] == list(found.left_out)
    assert data["notes"] == list(found.notes)
    assert [note.partition(":")[0] for note in found.notes][:2] == ["continuum", "exponents"]
    lines = found.table().splitlines()
    assert lines[0].split() == ["fit", "quantity", "value", "error", "theory", "unit"]
    assert lines[-1].startswith("strike number")
    assert max(map(len, lines)) <= 80
    assert str(found) == found.table()


def test_local_exponents_are_compared_with_those_of_great_depth(weak: Trajectory, fit: ExponentFit):
    """After a weak strike, the local exponents tend to the exponents of the front."""
    front = track(weak).between(20, 10**6)
    local = fit.local["velocity"]
    last = fit.grain[-1]
    inside = (front.grain > last - 11) & (front.grain <= last)
    power = slope(front.grain[inside] - 0.5, np.abs(front.amplitude[inside]))
    assert local.exponent[-1] == pytest.approx(power, rel=1e-9)
    assert local.depth[-1] + 0.5 == pytest.approx(last - 5, abs=0.5)
    rows = {row.quantity: row for row in fit.rows()}
    near = rows[f"velocity near grain {local.depth[-1] + 0.5:.0f}"]
    assert (near.value, near.error) == (local.exponent[-1], local.error[-1])
    assert near.expected == rows["velocity at great depth"].expected == pytest.approx(-4 / 15)
    assert {fit.approach(name) for name in fit.local} == {"towards the law of weak waves"}


def test_a_summary_without_suitable_fits():
    chain = column(5, gravity=0.0, bottom="free")
    found = summary(simulate(struck(chain, 0.1, 1e-5, 5), "native", 1e-6))
    assert (found.rows, len(found.left_out)) == ((), 6)
    assert "linear theory is not expected to hold" in found.table()
    assert found.to_json()["strike_number"] is None
    assert not summary(simulate(struck(UNIFORM, 0.0, 1e-6, 21), "native", 1e-6)).rows


@pytest.mark.parametrize("grain", [1, 40])
def test_bessel_functions_need_a_passing_wave(grain: int):
    """The grain at a wall is disturbed at once, so its motion cannot be fitted."""
    walls = {"top": "wall", "bottom": "wall", "gravity": 0.0, "top_load": 2.0}
    chain = column(40, material="steel", diameter=5e-3, **walls)
    scene = scene_of(chain, Impulse(velocity=1e-4, grain=grain), 3e-4, 301)
    with pytest.raises(InputError, match="too few or do not show the wave"):
        fit_bessel(simulate(scene, engine="native"))
