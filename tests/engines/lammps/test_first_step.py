"""The first step in LAMMPS if no bound on the strain is known.

It is as long as the tolerance allows, by a native trial of the same map. The reference is the
Taylor series of `helpers.taylor_series`.
"""

import math

import pytest
from helpers import taylor_series
from helpers.example_scenes import struck
from helpers.independent_integrators import distance

from lmpchain import Chain, Impulse, Scene, simulate
from lmpchain.engines import Lammps, Native

STRIKER = Chain(
    grains=14,
    material=["ptfe"] + 13 * ["steel"],
    diameter=4.76e-3,
    gravity=0.0,
    top_load=2.38,
    load_grain=2,
    bottom="wall",
)
VACUUM = Chain(grains=10, diameter=1e-3, gravity=0.0, bottom="wall")


@pytest.mark.parametrize("chain", [STRIKER, VACUUM], ids=["striker", "vacuum"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_steps_are_as_long_as_the_tolerance_allows(chain, tolerance):
    """Steps were once 40 times too short, with errors 2000 times below the tolerance."""
    scene = struck(chain, 0.44, 1e-4, 6)
    lammps = Lammps("verlet")
    step = lammps.propose(lammps.part(scene), tolerance).step
    truth, doubt = taylor_series.reference(scene, 1e-16)
    # The native run makes the same steps as LAMMPS, without its rounding.
    answer = simulate(scene, Native("verlet", step=step, adaptive=False))
    error = truth.error(answer.displacement, answer.velocity)
    assert doubt < error / 10
    assert tolerance / 100 < error <= tolerance / 2
    answer = simulate(scene, "lammps", tolerance, integrator="verlet")
    assert answer.cost.step_s == pytest.approx(step, rel=1e-12)
    error = truth.error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver <= tolerance


def test_steps_stay_where_companions_are_stable():
    """Steps are limited to a quarter of the largest stable omega h, at any tolerance."""
    scene = struck(VACUUM, 0.44, 1e-4, 6)
    for integrator in Lammps.integrators:
        lammps = Lammps(integrator)
        step = lammps.propose(lammps.part(scene), 0.5).step
        stable = min(lammps.methods(scene)[0].stability_limit, math.pi)
        assert step * scene.highest_frequency <= stable / 4 * (1 + 1e-12)


def test_the_estimate_holds_in_random_strikers(rng):
    """With the steps of LAMMPS, a native run is compared with a run at 1e-11."""
    for _ in range(12):
        grains = int(rng.integers(3, 20))
        materials = rng.choice(["steel", "ptfe", "glass"], 2)
        load = {"top_load": 10 ** rng.uniform(-1, 1), "load_grain": 2} if rng.random() < 0.6 else {}
        chain = Chain(
            grains=grains,
            material=[materials[0]] + (grains - 1) * [materials[1]],
            diameter=5e-3,
            gravity=0.0,
            bottom="wall",
            **load,
        )
        strike = Impulse(velocity=10 ** rng.uniform(-1, 0.5))
        scene = Scene(chain=chain, excitation=strike, duration=2e-4, samples=21)
        tolerance = 10 ** rng.uniform(-6, -3)
        lammps = Lammps("verlet")
        step = lammps.propose(lammps.part(scene), tolerance).step
        truth = simulate(scene, "native", 1e-11)
        answer = simulate(scene, Native("verlet", step=step, adaptive=False))
        error = distance(answer, truth)
        assert error <= answer.error_estimate.solver <= tolerance / 2
