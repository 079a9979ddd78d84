"""Strikers: grains above a load, which only touch each other and the chain at rest.

The reference is the Taylor series of `helpers.taylor_series`, which finds the equilibrium itself.
"""

import numpy as np
import pytest
from helpers import taylor_series

import lmpchain
from lmpchain import Chain, Displacement, Impulse, Scene, simulate
from lmpchain.errors import InputError

PTFE = {
    "grains": 14,
    "material": "ptfe",
    "diameter": 4.76e-3,
    "gravity": 0.0,
    "top_load": 2.38,
    "load_grain": 2,
    "bottom": "wall",
}
BEAD = {"impurity": [{"grain": 1, "material": "steel", "diameter": 3e-3}]}
HIT = Impulse(velocity=0.5)
SCENES = {
    "striker of another material": (BEAD, HIT),
    "as gently as rounding allows": ({}, Impulse(velocity=1e-5)),
    "wave from below": ({}, Impulse(velocity=-1e-4, grain=9)),
    "two beads strike": ({"load_grain": 3, "bottom": "fixed"}, HIT),
    "load on the last grain": ({"load_grain": 14}, HIT),
    "between a wall and the load": (
        {"top": "wall", "load_grain": 4},
        Impulse(velocity=0.3, grain=2),
    ),
    "weight above the load": ({"gravity": 9.81, "load_grain": 5}, Impulse(velocity=1e-2)),
    "weight below a wall": ({"gravity": 9.81, "top": "wall"}, Impulse(velocity=1e-2)),
    "another exponent": ({"exponent": 1.3}, Impulse(velocity=0.1)),
    "damped": ({"damping": {"viscoelastic": 2e-6, "drag": 10.0}}, HIT),
    "later": (BEAD, lmpchain.Profile(displacement=[-1e-5] + [0] * 13, velocity=[0.5] + [0] * 13)),
    "pushed": (BEAD, lmpchain.Force(grain=1, shape="half-sine", amplitude=10.0, duration=2e-4)),
}


def scene(changes=None, excitation=HIT, **keys) -> Scene:
    options = {"duration": 6e-4, "samples": 31} | keys
    return Scene(chain=Chain(**PTFE | (changes or {})), excitation=excitation, **options)


@pytest.mark.parametrize("name", SCENES)
def test_native_agrees_with_taylor_series(name):
    struck = scene(*SCENES[name])
    true, _ = taylor_series.reference(struck, 1e-14)
    answer = simulate(struck, engine="native", tolerance=1e-9)
    assert true.error(answer.displacement, answer.velocity) < 1e-9


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_a_lifted_striker_remains_in_place(exponent):
    lifted = Displacement(displacement=-1e-5)
    answer = simulate(scene({"exponent": exponent}, lifted), "native", 1e-9)
    assert answer.displacement[:, 0] == pytest.approx(-1e-5, rel=1e-15)
    assert np.abs(answer.displacement[:, 1:]).max() < 1e-25


@pytest.mark.parametrize("name", ["striker of another material", "weight above the load"])
@pytest.mark.parametrize("diameter", ["physical", "gauge"])
def test_lammps_agrees_to_its_stated_error(name, diameter):
    struck = scene(*SCENES[name])
    true, _ = taylor_series.reference(struck, 1e-14)
    engine = lmpchain.engines.Lammps(integrator="verlet", step=1e-7, diameter=diameter)
    answer = simulate(struck, engine=engine)
    error = true.error(answer.displacement, answer.velocity)
    assert 1e-7 < error < answer.error_estimate.total < 1e-4


def test_a_long_chain_is_cut_above_and_below_the_wave():
    changes = {"grains": 400, "bottom": "fixed", "load_grain": 3}
    for grain in (1, 3, 200):
        struck = scene(changes, Impulse(velocity=0.01, grain=grain), duration=1e-4, samples=3)
        small = struck.reached.chain
        assert small.grains < 300
        assert small.loose_grains == (0 if grain == 200 else 2)
        last = small.grains if grain < 200 else 260
        alone = Chain(**PTFE | changes | {"grains": last})
        short = Scene(chain=alone, excitation=struck.excitation, duration=1e-4, samples=3)
        answer, true = (simulate(s, engine="native", tolerance=1e-10) for s in (struck, short))
        largest = np.abs(true.velocity).max()
        assert np.abs(answer.velocity[:, :last] - true.velocity).max() < 1e-9 * largest
    weighed = Chain(**PTFE | {"grains": 300, "load_grain": 150, "gravity": 1.0})
    with pytest.raises(InputError, match="begin with grain 1, or with grain 150 or a later one"):
        weighed.part(100, 200)
    cut = weighed.part(150, 200)
    assert cut.contacts.force[1:-1] == pytest.approx(weighed.contacts.force[150:200])


def test_energy_includes_the_work_of_the_load():
    answer = simulate(scene(BEAD), engine="native", tolerance=1e-11)
    energy = lmpchain.measure.energy.ledger(answer)
    assert np.abs(energy.drift).max() < 1e-9 * energy.total[0]
    parts = energy.kinetic + energy.contact + energy.load
    assert np.ptp(parts) < 1e-9 * energy.total[0]


def test_derivatives_by_the_load_agree_with_differences():
    chain = Chain(**PTFE | BEAD)

    def loaded(load: float) -> Scene:
        pressed = chain.replace(top_load=load)
        return Scene(chain=pressed, excitation=HIT, duration=3e-4, samples=2)

    energy = lmpchain.design.KineticEnergy([8])
    gradient = lmpchain.design.gradient(loaded(2.38), energy, ["top_load"], tolerance=1e-7)
    near = [simulate(loaded(2.38 + x), engine="native", tolerance=1e-12) for x in (-1e-3, 1e-3)]
    low, high = (chain.masses[7] * t.velocity[-1, 7] ** 2 / 2 for t in near)
    assert gradient["top_load"] == pytest.approx((high - low) / 2e-3, rel=1e-5)


def test_batches_and_files_keep_the_grain(tmp_path):
    scene(BEAD).to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene(BEAD)
    scenes = [scene(BEAD | {"load_grain": n}) for n in (1, 2, 3)]
    together = lmpchain.simulate_many(scenes, engine="native", tolerance=1e-9)
    for one, answer in zip(scenes, together, strict=True):
        alone = simulate(one, engine="native", tolerance=1e-9)
        assert np.abs(alone.velocity - answer.velocity).max() < 1e-9
