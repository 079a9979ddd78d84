"""Grains that no wave can have reached are not computed, and nobody can tell."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from helpers.example_scenes import random_scene

from lmpchain import GLASS, Chain, Displacement, Drive, Impulse, Impurity, Scene, engines, simulate
from lmpchain.scene.light_cone import reached as grains_reached

BEADS = {"material": GLASS, "diameter": 1e-3}
ROUNDING = 1e-14  # what a part weighs is added up in another order
RANDOM = 1e-3 * np.random.default_rng(3).uniform(0.8, 1.2, 600)
SCENES = {
    "gentle": (Chain(grains=600, **BEADS), Impulse(velocity=1e-6), 100e-6),
    "the paper's": (Chain(grains=600, **BEADS), Impulse(velocity=8.57e-4), 100e-6),
    "strong": (Chain(grains=600, **BEADS), Impulse(velocity=8.57e-3), 100e-6),
    "in the middle": (Chain(grains=600, **BEADS), Impulse(velocity=1e-3, grain=300), 60e-6),
    "at the floor": (Chain(grains=600, bottom="wall", **BEADS), Impulse(velocity=-1e-3, grain=600), 60e-6),
    "moved": (Chain(grains=600, **BEADS), Displacement(displacement=1e-8, grain=100), 60e-6),
    "sonic vacuum": (Chain(grains=600, gravity=0.0, **BEADS), Impulse(velocity=0.1), 200e-6),
    "springs": (Chain(grains=600, exponent=1.0, **BEADS), Impulse(velocity=1e-3), 3e-6),
    "an impurity": (
        Chain(grains=600, impurity=[Impurity(grain=5, material="tungsten_carbide")], **BEADS),
        Impulse(velocity=1e-3),
        60e-6,
    ),
    "random": (Chain(grains=600, material=GLASS, diameter=RANDOM), Impulse(velocity=1e-3), 60e-6),
}


def reached(scene: Scene) -> tuple[int, int]:
    return grains_reached(scene.chain, scene.excitation, scene.energy, scene.duration)


class Whole(engines.Native):
    """The engine, without the light cone."""

    whole = True


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-12])
def test_what_is_left_out_makes_no_difference(name: str, tolerance: float):
    chain, strike, duration = SCENES[name]
    scene = Scene(chain=chain, excitation=strike, duration=duration, samples=5)
    first, last = reached(scene)
    assert last - first < 400, "most grains are left out"
    native = engines.Native()
    candidate = native.candidate(native.part(scene), tolerance)
    assert candidate.active_grains == last - first + 1
    steps = {"integrator": candidate.integrator, "step": candidate.step}
    alone, whole = (simulate(scene, engine(**steps)) for engine in (engines.Native, Whole))
    assert alone.cost.active_grains < 400 < whole.cost.active_grains
    for one, other in ((alone.displacement, whole.displacement), (alone.velocity, whole.velocity)):
        assert np.abs(one - other).max() < (1e-3 * tolerance + ROUNDING) * np.abs(other).max()


@pytest.mark.parametrize("seed", range(20))
def test_random_scenes(seed: int):
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    while scene.drive or scene.chain.grains < 20:
        scene = random_scene(rng)
    few = Scene(**scene.given() | {"duration": scene.duration / 20, "samples": 3})
    first, last = reached(few)
    step = few.duration / 64
    if step * few.chain.band_edge > 0.5:
        step = 0.5 / few.chain.band_edge
    alone, whole = (simulate(few, engine(integrator="rkn4", step=step)) for engine in (engines.Native, Whole))
    outside = np.ones(few.chain.grains, bool)
    outside[first - 1 : last] = False
    for one, other in ((alone.displacement, whole.displacement), (alone.velocity, whole.velocity)):
        assert np.abs(one - other).max() <= 1e-12 * np.abs(other).max()
        assert np.abs(other[:, outside]).max(initial=0.0) <= 1e-12 * np.abs(other).max()


def test_a_drive_is_not_cut():
    drive = Drive(amplitude=1e-9, frequency=1e4)
    scene = Scene(chain=Chain(grains=600, **BEADS), excitation=drive, duration=1e-5)
    assert reached(scene) == (1, 600)


def test_a_million_grains_take_the_memory_of_few():
    def strike(grains: int) -> tuple[np.ndarray, int]:
        scene = Scene(
            chain=Chain(grains=grains, **BEADS),
            excitation=Impulse(velocity=8.57e-4),
            duration=100e-6,
            samples=11,
            grains="1:50",
        )
        tracemalloc.start()
        try:
            t = simulate(scene, "native")
            return np.stack((t.displacement, t.velocity)), tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    strike(200)
    few, least = strike(200)
    many, most = strike(10**6)
    assert np.array_equal(few, many)
    assert most < 2 * least + 2**20
