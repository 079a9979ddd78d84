"""Damped chains: choice of the engine, refusals, light cone and energy balance."""

import json
import math

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.taylor_series import reference, solve
from helpers.trial_scenes import acted_trial_scene, damped, trial_scene

from lmpchain import (
    Drive,
    Force,
    Impulse,
    InputError,
    Scene,
    engines,
    plan,
    simulate,
    simulate_many,
)
from lmpchain.cli.command_line import main
from lmpchain.engines import Native
from lmpchain.measure import contact, motion
from lmpchain.report.document import page

DAMPING = {"viscoelastic": 3e-8, "drag": 1e3}
WALLS = {"top": "wall", "bottom": "wall", "top_load": 0.1}
ACTS = {
    "strike": Impulse(velocity=1e-3),
    "force": Force(grain=2, amplitude=1e-3, frequency=2e4),
    "drive": Drive(amplitude=1e-10, frequency=2e4),
    "wall": Drive(grain=0, amplitude=1e-10, frequency=2e4),
}


def damped_scene(excitation, samples: int = 401, **chain) -> Scene:
    damped_column = column(**{"damping": DAMPING} | WALLS | chain)
    return scene_of(damped_column, excitation, 6e-5, samples)


def test_contact_forces_agree_with_accelerations():
    t = simulate(damped_scene(ACTS["strike"], 4001), "native", 1e-11)
    history = contact.contacts(t)
    inside = history.change[:, :-1] - history.change[:, 1:]
    chain = t.scene.chain
    a = inside / chain.masses - chain.drag * t.velocity
    h = t.time[1]
    # Differences of velocities at five samples.
    v = t.velocity
    slope = (8 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12 * h)
    assert abs(a[2:-2] - slope).max() < 1e-5 * abs(slope).max()


def test_peaks_between_samples_are_within_their_error():
    fine = simulate(damped_scene(ACTS["strike"], 4001), "native", 1e-9)
    coarse = simulate(damped_scene(ACTS["strike"], 161), "native", 1e-9)
    peaks = motion.peaks(coarse)
    exact = motion.peaks(fine).value
    assert (abs(peaks.value - exact) <= peaks.error + 1e-6 * exact).all()
    gathered = simulate(
        damped_scene(ACTS["strike"], 21).replace(quantities=["peak_velocity"]), "native", 1e-9
    ).gathered
    error = gathered["peak_velocity_error"]
    assert (abs(gathered["peak_velocity"] - exact) <= error + 1e-6 * exact).all()
    assert (error < 0.01 * exact).all()


def test_the_choice_of_engine_considers_damping():
    scene = damped_scene(Impulse(velocity=1e-9), 11)
    assert plan(scene).engine == "native"
    assert plan(scene).integrator == "dop853"
    with pytest.raises(InputError, match="rkn6 is a method for chains without damping: use dop853"):
        simulate(scene, engine=Native("rkn6"))
    names = {"native", "lammps", "modes"}
    assert {name for name in engines.names() if engines.get(name).dissipates} == names


@pytest.mark.parametrize("seed", range(24))
def test_the_effect_of_damping_is_within_its_estimate(seed: int):
    """Weak waves, struck and driven, are compared with an independent integrator."""
    rng = np.random.default_rng([55, seed])
    draw = acted_trial_scene if seed % 3 == 0 else trial_scene
    lossless = draw(rng, work=1e3)
    # A weak wave in a short chain.
    while not lossless.strike_number < 0.1 or lossless.chain.grains > 60:
        lossless = draw(rng, work=1e3)
    lossless = lossless.replace(samples=100)
    scene = damped(rng, lossless)
    damping = scene.chain.damping
    rate = damping.longest_time * scene.fastest_motion**2 + damping.largest_drag
    if rate * scene.duration > 1:
        weaker = rng.random() / (rate * scene.duration)
        fields = {"viscoelastic": damping.viscoelastic * weaker, "drag": damping.drag * weaker}
        scene = scene.replace(chain=scene.chain.replace(damping=fields))
    assert 0 < scene.damping_effect < 1
    other = solve(lossless, 1e-12)
    assert solve(scene, 1e-12).error(other.displacement, other.velocity) < scene.damping_effect


@pytest.mark.slow
def test_a_run_states_the_effect_of_damping():
    scene = damped_scene(ACTS["strike"], 5)
    weak = damped_scene(ACTS["strike"], 5, damping={"drag": 100.0})
    remark = "leaving it out would change the answer by at most about 0.3 %"
    answer = simulate(weak, "native", 1e-6)
    assert answer.provenance["damping"] == weak.damping_remark == remark
    assert remark in str(answer._repr_html_())
    assert remark in page(answer)
    planned = plan(weak)
    assert planned.table().endswith(f"damping: {remark}")
    assert planned.to_json()["damping_effect"] == pytest.approx(math.expm1(3e-3), rel=1e-12)
    # A batch shares one record except for this number.
    strong, again = simulate_many([scene, weak], 1e-6, "native")
    assert again.provenance["damping"] == remark
    assert "up to all of it" in strong.provenance["damping"]
    undamped = damped_scene(ACTS["strike"], 5, damping={})
    assert undamped.damping_effect == 0.0
    assert "damping" not in simulate(undamped, "native", 1e-6).provenance
    assert "damping:" not in plan(undamped).table()


def test_a_comparison_includes_the_lossless_chain(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    numbers = tmp_path / "numbers.json"
    scene = damped_scene(ACTS["strike"], 21, damping={"viscoelastic": 1e-9, "drag": 100.0})
    scene.to_toml(path)
    assert main(["compare", str(path), "--engines", "native,bessel", "--json", str(numbers)]) == 0
    said = capsys.readouterr().out
    assert "reference: Taylor series" in said
    assert "left out: bessel: " in said
    found = json.loads(numbers.read_text())
    row = found["without_damping"]
    lossless = solve(scene.replace(chain=scene.chain.replace(damping=None)), 1e-15)
    error = solve(scene, 1e-15).error(lossless.displacement, lossless.velocity)
    assert row["error"] == pytest.approx(error, rel=1e-2)
    assert row["expected_error"] == scene.damping_effect > error
    assert f"{row['error']:.2e}" in said
    native = next(row for row in found["rows"] if row["engine"] == "native")
    assert native["error"] < 1e-6


@pytest.mark.parametrize("viscoelastic", [0.0, 1e-9, 3e-8, 1e-6])
def test_the_wave_is_negligible_beyond_the_light_cone(viscoelastic):
    """The front of a damped wave is not sharp: it spreads as in a parabolic equation."""
    chain = column(
        900, gravity=0.0, top_load=1.0, damping={"viscoelastic": viscoelastic, "drag": 1e3}
    )
    strike = Impulse(velocity=1e-4, grain=450)
    scene = scene_of(chain, strike, 2e-5, 2)
    cone = scene.light_cone
    assert cone is not None
    true, _ = reference(scene, 1e-18)
    beyond = np.ones(900, bool)
    beyond[cone.columns] = False
    assert beyond.any()
    field = abs(true.displacement[-1])
    assert field[beyond].max() < 1e-20 * field.max()
    # The light cone is not much wider than the wave.
    inside = np.flatnonzero(field > 1e-30 * field.max())
    assert cone.scene.chain.grains < 1.5 * (inside[-1] - inside[0] + 1) + 100


def test_the_largest_wall_force_is_at_least_that_of_samples():
    t = simulate(damped_scene(ACTS["strike"], 21), engine="native")
    with pytest.raises(InputError, match=r'add "peak_force:.*or use wall_force'):
        motion.motion_of(t).largest_wall_force()
    assert contact.wall_force(t).max() > 0
