"""Adjoints of DOP853 on damped chains against differences of Taylor series."""

import numpy as np
import pytest
from helpers import taylor_series

from lmpchain import Chain, Damping, Force, Impulse, Scene
from lmpchain.design import KineticEnergy, gradient, parameters
from lmpchain.design.parameters import changed
from lmpchain.integrators.differentiation import DIFFERENTIABLE, differentiable

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


@pytest.mark.parametrize("kind", SCENES)
def test_adjoints_are_transposes_of_tangents(rng: np.random.Generator, kind: str):
    scene = Scene(chain=CHAIN, excitation=SCENES[kind], duration=8e-6, samples=5)
    step = 0.5 / scene.highest_frequency
    grains = np.arange(1, GRAINS + 1)
    run = differentiable(scene, DIFFERENTIABLE["dop853"], step, 4, grains)
    weights = rng.standard_normal((2, *run.velocity.shape))
    weights[0] *= scene.highest_frequency
    inputs = run.pull(*weights)
    for name in [*NAMES, "velocity", "displacement"] if kind == "struck" else NAMES:
        back = parameters.pull(scene, inputs, name)
        u, v = run.push(parameters.push(scene, name, np.eye(back.size)))
        along = (weights[0] * u).sum((1, 2)) + (weights[1] * v).sum((1, 2))
        # Both sum the same terms, so that they differ by rounding errors of the largest term.
        assert np.abs(along - back).max() <= 1e-11 * np.abs(back).max(), name
