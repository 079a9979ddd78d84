"""What engines refuse, what they cost, and how closed forms are compared with Eq. (3)."""

from __future__ import annotations

import json
import math
import platform
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from scipy.integrate import cumulative_trapezoid

from lmpchain import Displacement, Drive, Force, Impulse, InputError, Law, Scene, engines
from lmpchain.engines import Bessel, Chebyshev, Continuum, Lammps, Modes, Native, cost_model
from lmpchain.engines.base import Engine
from lmpchain.engines.linear import engine as linear
from lmpchain.theory import continuum
from lmpchain.util.arrays import EPSILON

STRIKE = Impulse(velocity=1e-9)
LOAD: dict[str, Any] = {"gravity": 0.0, "top_load": 1e-2}
POINTS = {"times": [0.0, 1e-6, 2e-6]}


# Words of the reasons for which linear engines and closed forms refuse a scene.
REASONS = {
    "gravity": "without gravity and load",
    "load_grain": "grain 1 only touches grain 2.*, or use native",
    "top": "a wall that only touches|bessel needs|continuum needs",
    "masses": "needs equal grains; use modes or chebyshev",
    "contact_constants": "needs equal grains; use modes or chebyshev",
    "top_load": "continuum needs a chain",
}
CLOSED = "needs an impulse on grain 1"


def keys(
    engine: Engine, chain: dict[str, Any], excitation: Any = STRIKE, acting: str = CLOSED
) -> list[str]:
    """Return the keys of the reasons for which an engine refuses a scene; check their words."""
    reasons = engine.refuses(scene_of(column(9, **chain), excitation, 1e-5, 3))
    for key, reason in reasons:
        assert re.search((REASONS | {"excitation": acting}).get(key, ""), reason)
    return [key for key, _ in reasons]


@pytest.mark.parametrize(
    ("chain", "excitation", "modes", "chebyshev"),
    [
        ({}, STRIKE, [], []),
        ({"gravity": 0.0}, STRIKE, ["gravity"], ["gravity"]),
        (LOAD | {"load_grain": 2}, STRIKE, ["load_grain"], ["load_grain"]),
        ({"top": "wall"}, STRIKE, ["top"], ["top"]),
        (LOAD | {"top": "wall"}, STRIKE, [], []),
        ({}, Force(force=[0, 1e-9, 0], **POINTS), ["excitation"], ["excitation"]),
        # A propagator is a constant matrix with an endless sine only.
        ({}, Drive(amplitude=1e-12, frequency=1e4), [], []),
        ({}, Drive(amplitude=1e-12, frequency=1e6, cycles=3), [], ["excitation"]),
        ({}, Force(amplitude=1e-9, frequency=1e4), [], ["excitation"]),
        # Modes that damping or the ground couples.
        ({"damping": {"drag": 1.0}}, STRIKE, [], []),
        ({"damping": {"drag": np.arange(9.0)}}, STRIKE, ["damping.drag"], []),
        ({"ground": Law("s*u", s=1.0)}, STRIKE, [], []),
        ({"ground": Law("s*u", s=-1.0)}, STRIKE, ["chain.ground"], []),
        ({"ground": Law("s*u**3", s=1.0)}, STRIKE, ["chain.ground"], []),
    ],
)
def test_linear_engines_refuse_what_is_not_linear(
    chain: dict[str, Any], excitation: Any, modes: list[str], chebyshev: list[str]
) -> None:
    points = "do not support a motion or force by points|endless"
    found = [key.removeprefix("chain.") for key in keys(Modes(), chain, excitation, points)]
    assert found == [key.removeprefix("chain.") for key in modes]
    assert keys(Chebyshev(), chain, excitation, points) == chebyshev


def test_a_drive_from_below_and_too_many_modes_are_refused() -> None:
    below = Drive(end="bottom", amplitude=1e-12, frequency=1e4)
    chain: dict[str, Any] = LOAD | {"bottom": "wall"}
    assert "end" in keys(Modes(), chain, below)
    assert "end" not in keys(Modes(), chain)
    for grains, fault in ((12_000, []), (12_001, ["grains"])):
        scene = struck(column(grains, **LOAD), 1e-9, 1e-5)
        assert [key for key, _ in Modes().refuses(scene)] == fault


@pytest.mark.parametrize(
    ("chain", "excitation", "bessel", "formula"),
    [
        ({}, STRIKE, [], []),
        (LOAD, STRIKE, [], ["top_load"]),
        ({"top_load": 1e-3}, STRIKE, [], ["top_load"]),
        ({"masses": np.linspace(1, 2, 9) * 1e-6}, STRIKE, ["masses"], ["masses"]),
        # Differences by rounding are allowed.
        ({"masses": 1e-6 + np.arange(9) * 1e-20}, STRIKE, [], []),
        ({"masses": 1e-6 + np.arange(9) * 1e-18}, STRIKE, ["masses"], ["masses"]),
        (
            {"contact_constants": np.linspace(1, 2, 8) * 1e9},
            STRIKE,
            ["contact_constants"],
            ["contact_constants"],
        ),
        (LOAD | {"top": "wall"}, STRIKE, ["top"], ["top", "top_load"]),
        ({}, Impulse(velocity=1e-9, grain=2), ["excitation"], ["excitation"]),
        ({}, Displacement(displacement=1e-15), ["excitation"], ["excitation"]),
        ({"law": Law("k*max(o, 0)**1.5", k=1e9)}, STRIKE, [], ["law"]),
    ],
)
def test_closed_forms_are_those_of_a_uniform_column(
    chain: dict[str, Any], excitation: Any, bessel: list[str], formula: list[str]
) -> None:
    assert keys(Bessel(), chain, excitation) == bessel
    assert keys(Continuum(), chain, excitation) == formula


def test_grains_beyond_the_wave_may_differ() -> None:
    masses = np.full(600, 1e-6)
    masses[500:] = 3e-6
    scene = struck(column(600, **LOAD, masses=masses), 1e-9, 1e-5, 3)
    assert scene.reached.chain.grains < 500
    assert Bessel().refuses(scene) == []
    assert Bessel().refuses(scene.replace(duration=1e-3))[0][0] == "masses"
    # The formula is exact for equal contacts before the wave reaches the bottom.
    assert Bessel().exact(scene)
    assert not Bessel().exact(struck(column(600), 1e-9, 1e-5, 3))
    assert not Bessel().exact(scene.replace(duration=1e-3))
    assert not Continuum().exact(scene)


@pytest.mark.parametrize("engine", [Bessel(), Continuum()])
def test_a_closed_form_continues_from_a_stored_state(
    engine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The largest difference from Eq. (3) so far is a part of the state."""
    monkeypatch.setattr(linear, "BLOCK", 4)
    monkeypatch.setattr(linear, "SMALL_BLOCK", 4)
    scene = struck(column(40, **({} if engine.name == "continuum" else LOAD)), 1e-9, 1e-4, 25)
    proposal = engine.propose(scene, 0.9)
    run = engine.start([scene], proposal)
    blocks = list(run.blocks())
    assert [block.samples.stop for block in blocks] == [4, 8, 12, 16, 20, 24, 25]
    assert run.progress == 1.0
    broken = engine.start([scene], proposal)
    first = [next(broken.blocks()), next(broken.blocks())]
    assert broken.progress == 8 / 25
    rest = engine.start([scene], proposal, broken.state())
    again = [*first, *rest.blocks()]
    for one, other in zip(blocks, again, strict=True):
        assert np.array_equal(one.velocity, other.velocity)
    assert rest.errors()[0].model == run.errors()[0].model
    # The error is the larger of two relative distances plus the error of Eq. (3) itself.
    exact = Chebyshev().start([scene], proposal)
    solved = list(exact.blocks())
    true = [np.concatenate([getattr(b, x) for b in solved], 1) for x in FIELDS]
    own = [np.concatenate([getattr(b, x) for b in blocks], 1) for x in FIELDS]
    apart = [float(np.abs(a - b).max()) for a, b in zip(own, true, strict=True)]
    distance = float((np.array(apart) / exact.scale[:, 0]).max())
    (error,), (linear_error,) = run.errors(), exact.errors()
    assert error.model == pytest.approx(linear_error.model + distance, rel=1e-9)
    assert error.model_bound == pytest.approx(linear_error.model_bound + distance, rel=1e-9)
    cost = run.cost()
    assert (cost.force_evaluations, cost.integrator) == (0, engine.name)
    # The displacement is the integral of the velocity, which begins with the strike.
    fine = scene.replace(samples=4001, duration=3e-5)
    u, v = engine.wave(fine, fine.time)
    assert v[0, 0] == pytest.approx(1e-9, rel=0.02)
    path = cumulative_trapezoid(v, fine.time, axis=0, initial=0)
    assert np.abs(path - u).max() < 0.01 * np.abs(u).max()


FIELDS = ("displacement", "velocity")


def test_the_continuum_formula_is_in_units_of_the_chain() -> None:
    scene = struck(column(40, exponent=1.8), 1e-9, 3e-5, 7)
    u, v = Continuum().wave(scene, scene.time)
    unit = scene.chain.time_scale
    phi, speed = continuum.impulse_of_grain(scene.recorded, scene.time[:, None] / unit, 1.8)
    assert u == pytest.approx(1e-9 * unit * phi, rel=1e-12)
    assert v == pytest.approx(1e-9 * speed, rel=1e-12)


def test_the_time_of_closed_forms_includes_the_exact_solution() -> None:
    scene = scene_of(column(40), STRIKE, 1e-4, 201, grains=[1, 5, 9])
    for engine in (Bessel(), Continuum()):
        series = Chebyshev().propose(scene, 0.9).cost_s - Chebyshev.start_up_s
        formula = engine.propose(scene, 0.9).cost_s - engine.start_up_s
        assert formula == pytest.approx(series + 1e-6 * 201 * 3, rel=1e-9)


def test_the_rounding_error_of_a_weak_linear_motion_is_larger() -> None:
    """A velocity near the smallest double has few digits."""
    for speed, digit in ((1e-9, EPSILON), (1e-320, 2.0**-1074 / 1e-320)):
        scene = struck(column(5, **LOAD), speed, 1e-5, 3)
        run = Modes().start([scene], Modes().propose(scene, 1e-6))
        for _ in run.blocks():
            pass
        (error,) = run.errors()
        expected = Modes().round_off(scene) / EPSILON * digit
        # The displacement is the smaller of both, and the digit of the strike is a lower bound.
        assert error.roundoff >= expected * (1 - 1e-3)
        assert (error.truncation, error.order) == (0.0, 1.0)
        assert speed < 1e-300 or error.roundoff == pytest.approx(expected, rel=1e-9)


def test_energies_of_linear_runs_take_little_time() -> None:
    """Short runs have 2^14 evaluated values for them, or 2^16 with a forcing."""
    scene = struck(column(64, **LOAD), 1e-9, 1e-5, 3)
    assert Modes().most_summed(scene) == 2**14 // 64
    tone = scene.replace(excitation=Force(amplitude=1e-9, frequency=1e4))
    assert Modes().most_summed(tone) == 2**16 // 64
    # A run of more samples may use as many evaluations.
    assert Modes().most_summed(scene.replace(samples=5001)) == 5001


# --- the engines by name


def test_engines_by_name() -> None:
    assert engines.automatic() == ("native", "modes", "chebyshev", "bessel", "continuum")
    assert engines.automatic("last") == ("lammps",)
    assert engines.plain("modes") is engines.plain("modes")
    assert engines.class_of("chebyshev") is Chebyshev
    assert engines.class_of("unknown") is Engine
    assert engines.brief("modes", "modes needs a spring: use native; or not") == "needs a spring"
    with pytest.raises(InputError) as fault:
        engines.get("modes", integrator="rkn6", colour=2)
    words = "the engine modes has no such option; it has no options: leave it out"
    assert str(fault.value).count(words) == 2
    with pytest.raises(InputError, match="did you mean 'tolerance'"):
        engines.get("native", tolerence=1e-3)
    with pytest.raises(AttributeError, match="has no attribute 'Moods'"):
        _ = engines.Moods


def test_obstacles_name_engines_that_solve_the_scene() -> None:
    scene = struck(column(9, damping={"drag": 1.0}, ground=Law("s*u", s=1.0)), 1e-9, 1e-5, 3)
    found = dict(engines.obstacles(Chebyshev(), scene))
    assert found.keys() == {"chain.damping", "chain.ground"}
    assert found["chain.damping"].endswith("or use native, modes or lammps")
    assert found["chain.ground"].endswith("or use native, modes or lammps")
    assert engines.obstacles(Native(), scene) == []
    asked = struck(column(9), 1e-9, 1e-5, 3, quantities=["peak_velocity"])
    (obstacle,) = engines.obstacles(Bessel(), asked)
    assert obstacle[0] == "quantities"
    assert obstacle[1].endswith("use native, modes, chebyshev or lammps")
    for engine in (Native(), Modes(), Chebyshev(), Lammps()):
        assert engine.moves_grains
        assert engines.obstacles(engine, asked) == []


# --- the speed of this machine


def test_measured_speeds_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only plausible numbers of this machine are used."""
    file = tmp_path / "speeds.json"
    monkeypatch.setattr(cost_model, "cache_file", lambda: file)

    def seconds(*pair: Any, host: str = platform.node()) -> float:
        file.write_text(json.dumps({"host": host, "engines": {"modes": list(pair)}}))
        cost_model.measured.cache_clear()
        return cost_model.seconds("modes", 1e-3, 2.0)

    try:
        assert seconds(2e-3, 3.0) == 2e-3 + 3.0 * 2.0
        assert cost_model.seconds("native", 1e-3, 2.0) == 2.001
        assert seconds(2e-3, 3.0, host="another machine") == 2.001
        for start, slowness in ((9.9, 0.9e4), (1.01e-7, 1.1e-4)):
            assert seconds(start, slowness) == start + 2 * slowness
        for start, slowness in ((10.1, 1.0), (0.99e-7, 1.0), (1e-3, 1.1e4), (1e-3, 0.9e-4)):
            assert seconds(start, slowness) == 2.001
        for pair in ((math.nan, 1.0), (1e-3, math.nan), ("x", 1.0), (1.0,)):
            assert seconds(*pair) == 2.001
        for text in ("{", "[]", '{"engines": {}}', '{"host": 1, "engines": []}'):
            file.write_text(text)
            cost_model.measured.cache_clear()
            assert cost_model.seconds("modes", 1e-3, 2.0) == 2.001
        file.unlink()
        cost_model.measured.cache_clear()
        assert cost_model.seconds("modes", 1e-3, 2.0) == 2.001
    finally:
        cost_model.measured.cache_clear()


def part(scene: Scene, engine: Engine) -> int:
    return engine.part(scene).chain.grains


def test_engines_solve_the_light_cone_or_all_grains() -> None:
    scene = struck(column(600, **LOAD), 1e-9, 1e-6, 3)
    assert part(scene, Bessel()) == 600
    assert part(scene, Native()) == part(scene, Modes()) == scene.reached.chain.grains < 600
