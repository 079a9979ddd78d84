"""Grains that no wave can have reached are not computed, with the same result."""

from __future__ import annotations

import tracemalloc
from math import lgamma

import numpy as np
import pytest
from helpers.example_chains import column, random_column
from helpers.example_scenes import scene_of
from helpers.independent_integrators import distance
from scipy.special import ive

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Impulse,
    Impurity,
    Profile,
    engines,
    laws,
    simulate,
)
from lmpchain.scene.facts import find_reached

ROUNDING = 1e-14  # The weight in a part is added in another order.
SCENES = {
    "gentle": (column(600), Impulse(velocity=1e-6), 100e-6),
    "the paper's": (column(600), Impulse(velocity=8.57e-4), 100e-6),
    "strong": (column(600), Impulse(velocity=8.57e-3), 100e-6),
    "in the middle": (column(600), Impulse(velocity=1e-3, grain=300), 60e-6),
    "at the floor": (column(600, bottom="wall"), Impulse(velocity=-1e-3, grain=600), 60e-6),
    "moved": (column(600), Displacement(displacement=1e-8, grain=100), 60e-6),
    "sonic vacuum": (column(600, gravity=0.0), Impulse(velocity=0.1), 200e-6),
    "springs": (column(600, exponent=1.0), Impulse(velocity=1e-3), 3e-6),
    "an impurity": (
        column(600, impurity=[Impurity(grain=5, material="tungsten_carbide")]),
        Impulse(velocity=1e-3),
        60e-6,
    ),
    "random": (random_column(600, 3), Impulse(velocity=1e-3), 60e-6),
    "viscous": (
        column(600, exponent=1.0, damping={"viscoelastic": 2e-8}),
        Impulse(velocity=1e-3, grain=300),
        1e-6,
    ),
    # The strike compresses contacts until they are soft, but the front passes stiff contacts.
    "saturating": (
        column(600, gravity=0.0, top_load=9e-5, law=laws.softening(1e-9, k=1e5)),
        Impulse(velocity=0.02, grain=300),
        60e-6,
    ),
}


class Whole(engines.Native):
    """The native engine without the light cone."""

    whole = True


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-12])
def test_omitted_grains_make_no_difference(name: str, tolerance: float):
    chain, strike, duration = SCENES[name]
    scene = scene_of(chain, strike, duration, 5)
    first, last = find_reached(scene)
    assert last - first < 400, "most grains are left out"
    native = engines.Native()
    candidate = native.propose(native.part(scene), tolerance)
    assert candidate.active_grains == last - first + 1
    steps = {"integrator": candidate.integrator, "step": candidate.step}
    alone, whole = (simulate(scene, engine(**steps)) for engine in (engines.Native, Whole))
    assert alone.cost.active_grains < 400 < whole.cost.active_grains
    assert distance(alone, whole) < 1e-3 * tolerance + ROUNDING


def farthest(x: float) -> int:
    """Return two more than the least d >= 8 at which a bound of I_2d is below 1e-22."""
    d = 8
    while d * np.log(x / 2) * 2 - lgamma(2 * d + 1) + x**2 / (8 * d + 4) > np.log(1e-22):
        d += 1
    return d + 2


@pytest.mark.parametrize("x", [1e-3, 0.5, 2.0, 7.0, 30.0, 100.0, 333.0])
def test_the_cone_is_as_wide_as_springs_require(x: float):
    """The motion d grains away is at most I_2d(W t), below 22 digits outside of the cone."""
    chain = column(20_000, gravity=0.0, top_load=1e-3, exponent=1.0, top="wall", bottom="wall")
    springs = Chain(**chain.given() | {"wall_constants": [chain.contact_constants[0]] * 2})
    edge = 2 * np.sqrt(springs.contact_constants[0] / springs.masses[0])
    few = springs.part(1, 2000)
    for long, grain in ((springs, 10_000), (few, 1000)):
        scene = scene_of(long, Impulse(velocity=1e-6, grain=grain), x / edge)
        first, last = find_reached(scene)
        away = farthest(x)
        assert grain - first == last - grain
        assert away <= last - grain <= away + 1
        assert ive(2 * (last - grain), x) * np.exp(x) < 1e-22
    wide = np.zeros(2000)
    wide[[899, 1099]] = 1e-6
    first, last = find_reached(scene_of(few, Profile(velocity=wide), x / edge))
    assert away <= 900 - first == last - 1100 <= away + 1


@pytest.mark.parametrize("x", [0.03, 1.0, 20.0])
@pytest.mark.parametrize("viscosity", [1e-2, 0.3, 10.0])
def test_the_cone_of_viscous_springs_is_as_wide_as_their_laplace_transform(
    x: float, viscosity: float
):
    """The motion d grains away is at most s exp(s t) q^d, q + 1/q + 2 = s^2 / (1 + A s)."""
    springs = column(20_000, gravity=0.0, top_load=1e-3, exponent=1.0)
    rate = np.sqrt(springs.contact_constants[0] / springs.masses[0])
    chain = springs.replace(damping={"viscoelastic": viscosity / rate})
    _, last = find_reached(scene_of(chain, Impulse(velocity=1e-6, grain=10_000), x / rate))

    def log_of_bound(log_s: float, d: int) -> float:
        s = np.exp(log_s)
        decay = np.arccosh(max(s**2 / (1 + viscosity * s) / 2 - 1, 1.0))
        return float(s * x + log_s - d * decay)

    def least(d: int) -> float:
        return min(log_of_bound(log_s, d) for log_s in np.linspace(-3, 14, 5000))

    away = last - 10_000
    # Two grains more than needed are computed.
    assert away >= 10
    assert least(away - 2) <= np.log(1e-22)
    assert away == 10 or least(away - 4) > np.log(1e-22)


def test_short_chains_and_wide_cones_are_not_cut():
    """The cone is used from 128 grains on, if at most seven of ten grains are reached."""
    for grains, cut in ((127, False), (128, True)):
        scene = scene_of(column(grains), Impulse(velocity=1e-6), 1e-6)
        assert (scene.light_cone is not None) is cut
    # Ten grains beside the struck one are the smallest cone, even if nothing moves.
    still = scene_of(column(200, gravity=0.0), Impulse(velocity=0.0, grain=50), 1e-5)
    assert find_reached(still) == (40, 60)
    springs = column(600, gravity=0.0, top_load=1e-3, exponent=1.0, top="wall", bottom="wall")
    edge = 2 * np.sqrt(springs.contact_constants[0] / springs.masses[0])
    for away, cut in ((205, True), (212, False)):
        x = next(x for x in np.arange(1.0, 500.0) if farthest(x) >= away)
        scene = scene_of(springs, Impulse(velocity=1e-6, grain=300), x / edge)
        assert (scene.light_cone is not None) is cut


@pytest.mark.parametrize("end", ["top", "bottom"])
def test_a_stiff_wall_widens_the_cone(end: str):
    beads = column(600, gravity=0.0, top_load=1e-3, exponent=1.0, top="wall", bottom="wall")
    stiff = 9 * beads.contact_constants[0]
    walls = [stiff, stiff / 9] if end == "top" else [stiff / 9, stiff]
    chain = Chain(**beads.given() | {"wall_constants": walls})
    edge = 2 * np.sqrt(stiff / chain.masses[0])
    grain = 1 if end == "top" else 600
    scene = scene_of(chain, Impulse(velocity=1e-6, grain=grain), 60 / edge)
    first, last = find_reached(scene)
    assert farthest(60.0) <= last - first <= farthest(60.0) + 1
    inner = scene_of(chain, Impulse(velocity=1e-6, grain=300), 60 / edge)
    first, last = find_reached(inner)
    assert farthest(20.0) <= last - 300 <= farthest(20.0) + 1


def test_recorded_grains_of_a_cone_keep_their_positions():
    """Rows are among the computed grains, columns among the recorded ones."""
    chain = column(600)
    for grains in ("all", "20:400", [3, 500, 30, 1], [599, 600]):
        scene = scene_of(chain, Impulse(velocity=1e-6), 60e-6, 7, grains=grains)
        cone = scene.light_cone
        _, last = find_reached(scene)
        assert cone.scene.chain == chain.part(1, last)
        assert cone.scene.samples == 7
        numbers = scene.recorded
        assert numbers[cone.columns].tolist() == [n for n in numbers if n <= last]
        assert (np.arange(1, last + 1)[cone.rows]).tolist() == numbers[cone.columns].tolist()
        assert scene.reached is cone.scene


def test_motions_of_unlimited_speed_are_not_cut():
    """A drive may have any energy, and a contact that opens may be infinitely stiff."""
    drive = Drive(amplitude=1e-9, frequency=1e4)
    stiff = column(600, law=laws.power(0.6, k=1e3))
    for chain, excitation in ((column(600), drive), (stiff, Impulse(velocity=1e-6))):
        assert find_reached(scene_of(chain, excitation, 1e-6)) == (1, 600)


def test_a_million_grains_take_the_memory_of_few():
    def strike(grains: int) -> tuple[np.ndarray, int]:
        scene = scene_of(column(grains), Impulse(velocity=8.57e-4), 100e-6, 11, grains="1:50")
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
