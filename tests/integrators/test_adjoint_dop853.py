"""Adjoints of DOP853 on damped chains against differences of Taylor series."""

import numpy as np
import pytest
from helpers import taylor_series

from lmpchain import Chain, Damping, Drive, Force, Impulse, Scene
from lmpchain.design import KineticEnergy, gradient, parameters
from lmpchain.design.parameters import changed
from lmpchain.integrators import adjoint_dop853
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.differentiation import DIFFERENTIABLE, AnyRun, differentiable, method_for
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps
from lmpchain.scene.base import Excitation

GRAINS = 6
CHAIN = Chain(
    grains=GRAINS,
    diameter=1e-3,
    top_load=0.02,
    bottom="wall",
    damping=Damping(
        viscoelastic=np.linspace(1e-7, 2e-7, GRAINS - 1), drag=np.linspace(0, 5e3, GRAINS)
    ),
)
SCENES = {
    "struck": Impulse(velocity=0.02),
    "pushed": Force(grain=3, amplitude=0.02, frequency=2e5),
}
NAMES = ["masses", "contact_constants", "damping.viscoelastic", "damping.drag"]
GRAIN = 2  # Number of the grain whose parameters are changed.


def energy_at_end(scene: Scene) -> float:
    """Return the kinetic energy of grains 3 and 4, J."""
    velocity = taylor_series.solve(scene, 1e-18).velocity[-1, 2:4]
    return float((scene.chain.masses[2:4] * velocity**2).sum() / 2)


def slope(scene: Scene, name: str, base: np.ndarray, step: float) -> float:
    """Return the central difference of the energy for a change of one parameter."""
    change = step * np.eye(base.size)[GRAIN]
    forth, back = (energy_at_end(changed(scene, {name: base + sign * change})) for sign in (1, -1))
    return (forth - back) / (2 * step)


@pytest.mark.parametrize("kind", SCENES)
def test_gradients_of_damped_chains_agree_with_differences(kind: str):
    scene = Scene(chain=CHAIN, excitation=SCENES[kind], duration=8e-6, samples=5)
    found = gradient(scene, KineticEnergy([3, 4]), NAMES, 1e-7)
    energy = energy_at_end(scene)
    assert found.integrator == "dop853"
    assert abs(energy - found.value) <= found.value_error
    for name in NAMES:
        base = parameters.values(scene, name).astype(float)
        step = 1e-3 * base[GRAIN]
        slopes = [slope(scene, name, base, k * step) for k in (1, 2)]
        # Energies are rounded to double precision.
        rounding = 1e-15 * energy / step
        allowed = found.errors[name] + 1e-9 * np.abs(found[name]).max() + rounding
        assert abs(found[name][GRAIN] - (4 * slopes[0] - slopes[1]) / 3) <= allowed, name


def runs(chain: Chain, excitation: Excitation, units: float = 6.0) -> Scene:
    return Scene(chain=chain, excitation=excitation, duration=units / chain.band_edge, samples=5)


def in_vacuum(exponent: float) -> Scene:
    chain = CHAIN.replace(gravity=0.0, top_load=0.0, exponent=exponent)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=1e-6, samples=5)
    return scene.replace(duration=6 / scene.highest_frequency)


OVERLAP = float(CHAIN.contacts.overlap.max())
TONE = {"amplitude": OVERLAP, "frequency": 0.1 * CHAIN.band_edge}
WALLED = CHAIN.replace(top="wall", exponent=2.0)
TOUCHING = CHAIN.replace(top="wall", top_load=0.0)
LOOSE = CHAIN.replace(gravity=0.0, load_grain=3)
LONG = Chain(grains=300, diameter=1e-3, top_load=0.02, damping={"viscoelastic": 1e-8, "drag": 1e3})
RUNS = {
    "struck": runs(CHAIN, Impulse(velocity=0.1, grain=2)),
    "pushed": runs(CHAIN, Force(grain=3, amplitude=0.1, frequency=0.1 * CHAIN.band_edge)),
    "driven": runs(CHAIN, Drive(**TONE)),
    "driven wall": runs(WALLED, Drive(**TONE | {"amplitude": 20 * OVERLAP}, grain=0)),
    "one viscosity": runs(WALLED.replace(damping={"viscoelastic": 1e-7}), Impulse(velocity=0.3)),
    "one viscosity, driven": runs(CHAIN.replace(damping={"viscoelastic": 1e-7}), Drive(**TONE)),
    "touching wall": runs(TOUCHING, Impulse(velocity=-1e-3)),
    "loose grains": runs(LOOSE, Impulse(velocity=0.1)),
    "vacuum": in_vacuum(1.5),
    "vacuum, 2.5": in_vacuum(2.5),
    "long": runs(LONG, Impulse(velocity=0.05, grain=150)),
    "long, pushed": runs(LONG, Force(grain=150, amplitude=0.1, frequency=0.1 * LONG.band_edge)),
}


@pytest.mark.parametrize("kind", RUNS)
def test_derivatives_of_runs_agree_with_differences(
    rng: np.random.Generator, kind: str, monkeypatch: pytest.MonkeyPatch
):
    """Tangents are differences of two runs, and adjoints are transposes of tangents."""
    short = adjoint_dop853.CHECKPOINTS._replace(kept_bytes=1, noted_bytes=1, steps_of_call=5)
    monkeypatch.setattr(adjoint_dop853, "CHECKPOINTS", short)
    scene = RUNS[kind]
    grains = np.array([1, 2, 3, scene.chain.grains // 2, scene.chain.grains])

    def motion(scene: Scene) -> AnyRun:
        return differentiable(scene, DIFFERENTIABLE["dop853"], scene.duration / 40, 4, grains)

    run = motion(scene)
    assert run.steps == 40
    weights = rng.standard_normal((2, *run.velocity.shape))
    weights[0] *= scene.highest_frequency
    everywhere = run.pull(*weights)
    within_the_light_cone = run.pull(*weights, everywhere=False)
    # A change of touching grains closes some contacts and opens others, so the force has a kink.
    states = ["velocity", "displacement"] if scene.chain.compressed else []
    moving = np.arange(scene.chain.grains) < scene.chain.movable
    sizes = {
        "velocity": moving * np.abs(scene.initial()[1]).max(),
        "displacement": moving * 0.1 * scene.chain.contacts.overlap.max(),
        "damping.drag": scene.highest_frequency,
    }
    forced = scene.excitation.does_work
    for name in [*NAMES, *(["amplitude", "frequency"] if forced else states)]:
        base = parameters.values(scene, name)
        # A drag of 0 can only increase.
        change = sizes.get(name, base) * rng.uniform(-1, name != "damping.drag", base.shape)
        values = [base - 1e-6 * change, base + (name != "damping.drag") * 1e-6 * change]
        ends = [motion(changed(scene, {name: value})) for value in values]
        pushed = np.array(run.push(parameters.push(scene, name, change[None])))[:, 0]
        steps = (1 + (name != "damping.drag")) * 1e-6
        for field, order in (("displacement", 0), ("velocity", 1)):
            slope = (getattr(ends[1], field) - getattr(ends[0], field)) / steps
            assert np.abs(pushed[order] - slope).max() < 3e-5 * np.abs(slope).max(), name
        terms = weights * pushed
        for inputs in [everywhere] if name in states else [everywhere, within_the_light_cone]:
            along = parameters.pull(scene, inputs, name) @ change
            assert abs(along - terms.sum()) < 1e-13 * np.abs(terms).sum(), name


def test_adaptive_steps_are_those_of_the_native_engine(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    """Derivatives at constant steps are transposes of each other, also if contacts open."""
    short = adjoint_dop853.CHECKPOINTS._replace(kept_bytes=1)
    monkeypatch.setattr(adjoint_dop853, "CHECKPOINTS", short)
    chain = LOOSE.replace(damping={"viscoelastic": 1e-8})
    scene = runs(chain, Impulse(velocity=0.1), 20)
    grains = np.arange(1, GRAINS + 1)
    method = DIFFERENTIABLE["dop853"]
    run = differentiable(scene, method, scene.duration / 40, 4, grains, adaptive=True)
    schedule = Steps(10, 1, scene.duration / 40, True)
    stepper = NativeStepper(ChainBatch([scene]), method, schedule, {})
    fields = np.zeros((2, 1, 5, GRAINS))
    stepper.fill(*fields, 0, 4, 2**62)
    assert run.steps == stepper.steps[0] > 60
    assert np.array_equal(run.displacement[1:], fields[0, 0, 1:])
    assert np.array_equal(run.velocity[1:], fields[1, 0, 1:])
    assert run.step <= scene.duration / 40 * (1 + 1e-12)
    weights = rng.standard_normal((2, *run.velocity.shape))
    weights[0] *= scene.highest_frequency
    inputs = run.pull(*weights)
    for name in ("masses", "contact_constants", "damping.viscoelastic", "velocity"):
        change = rng.uniform(-1, 1, parameters.values(scene, name).shape)
        terms = weights * np.array(run.push(parameters.push(scene, name, change[None])))[:, 0]
        along = parameters.pull(scene, inputs, name) @ change
        assert abs(along - terms.sum()) < 1e-12 * np.abs(terms).sum(), name


def test_gradients_over_a_damping_require_a_method_for_damped_chains():
    undamped = CHAIN.replace(damping=None)
    for chain, names, method in (
        (undamped, ["masses"], "rkn6"),
        (undamped, ["masses", "damping.drag"], "dop853"),
        (CHAIN, ["masses"], "dop853"),
    ):
        scene = runs(chain, Impulse(velocity=1e-3))
        assert method_for(scene, names, "rkn6").name == method
