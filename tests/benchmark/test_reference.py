"""The reference against exact solutions, conserved energy, and an integrator of another type."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import paper, random_scene, scene_of, smooth, struck
from helpers.independent_integrators import distance, extended_reference
from helpers.reference_scenes import KINDS as SCENES
from helpers.reference_scenes import between
from helpers.taylor_series import reference as independent_reference
from helpers.thinned import thinned
from helpers.trial_scenes import acted_trial_scene, damped, trial_scene

from lmpchain import Chain, Displacement, Drive, Force, Impulse, Law, Scene, simulate
from lmpchain.benchmark.reference import expected_seconds, reference
from lmpchain.benchmark.truth import as_trajectory, truth

EXTENDED = np.finfo(np.longdouble).eps < 1e-18
# Expected error of the reference if the scene does not amplify rounding.
GOOD = 2e-15 if EXTENDED else 1e-12
# Tolerance of the other integrator, whose error is then some 1e-15 even if contacts open.
TIGHT = 1e-18


def strong(samples: int, duration: float = 4e-5) -> Scene:
    """Return the upper 40 grains of the paper's strongest strike, which opens contacts."""
    fields = paper("fig1").given() | {"chain": column(40)}
    return Scene(**fields | {"duration": duration, "samples": samples})


KINDS = SCENES | {
    "springs that open": between(
        Displacement(displacement=1e-8, grain=2), top_load=1e-4, exponent=1.0
    ),
    "burst of a wall": between(
        Drive(amplitude=1e-8, frequency=9e4, cycles=2, grain=0), top_load=1e-4
    ),
    "wall that moves": between(Drive(amplitude=1e-8, frequency=6e4, grain=0), top_load=1e-4),
    "burst of a force": between(
        Force(grain=3, amplitude=2e-4, frequency=9e4, cycles=1.5), top_load=1e-4
    ),
    "half a sine": between(
        Force(grain=1, shape="half-sine", amplitude=1e-3, duration=1e-5), top="free"
    ),
    "pulled": between(Displacement(displacement=-1e-9, grain=2), top="free", exponent=1.3),
    "force through points": between(
        Force(
            grain=2, times=np.arange(9) * 8e-6, force=np.array([0, 1, -1, 2, 0, -2, 1, 1, 0]) * 1e-5
        )
    ),
}


@pytest.mark.parametrize("kind", thinned(KINDS, 5))
def test_the_error_estimate_of_the_reference_holds(kind: str):
    scene = KINDS[kind].replace(duration=KINDS[kind].duration / 4, samples=4)
    truth = reference(scene)
    u, v, itself = extended_reference(scene, TIGHT)
    assert truth.displacement.shape == truth.velocity.shape == (scene.samples, scene.chain.grains)
    assert np.array_equal(truth.time, scene.time)
    assert truth.error < GOOD
    assert itself < (1e-13 if EXTENDED else 1e-11)
    # The other integrator estimates the error of its looser run.
    assert distance(truth, (u, v)) < truth.error + max(itself / 2, 2e-15)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(60))
def test_random_scenes(seed: int):
    scene = random_scene(np.random.default_rng([7, seed]))
    truth = reference(scene)
    u, v, itself = extended_reference(scene, TIGHT)
    # The rounding of a sampled drive may cause errors of 1e-14.
    assert distance(truth, (u, v)) < truth.error + 2 * itself + 1e-14


# Strikes, profiles, forces, drives and walls; contacts that open; all exponents and dampings.
@pytest.mark.parametrize("seed", thinned([0, 1, 2, 4, 5, 8, 13, 16, 17, 19, 23], 2))
def test_scenes_with_damping(rng: np.random.Generator, seed: int):
    draw = trial_scene if seed % 2 else acted_trial_scene
    scene = damped(rng, draw(rng, work=1500))
    truth = reference(scene.replace(samples=min(scene.samples, 11)))
    other, itself = independent_reference(scene.replace(samples=truth.time.size), 1e-19)
    assert truth.error < GOOD
    assert other.error(truth.displacement, truth.velocity) < truth.error + itself + 2e-16


def test_a_collision_that_loses_energy():
    """The reference is SciPy's DOP853 at 1e-13 in reduced velocities, with K = m = v = 1."""
    chain = Chain(
        grains=2,
        diameter=100.0,
        masses=[1.0, 1.0],
        contact_constants=[1.0],
        gravity=0.0,
        bottom="free",
        damping={"viscoelastic": 0.05},
    )
    truth = reference(struck(chain, 1.0, 9.0, 2))
    assert np.diff(truth.velocity[-1]) == pytest.approx(0.893193701608472, rel=1e-12)


@pytest.mark.parametrize(
    ("exponent", "masses"),
    thinned(product([1.0, 1.25, 1.5, 2.0, 3.0], [(1.0, 1.0), (1.0, 3.0), (3.0, 1.0)]), 4),
)
def test_a_collision_of_two_free_grains(exponent: float, masses: tuple[float, float]):
    """A contact closes and opens once.

    Energy and momentum say what velocities are left, whatever the law of force.
    """
    chain = column(2, masses=np.array(masses) * 1e-6, gravity=0.0, bottom="free", exponent=exponent)
    truth = reference(struck(chain, 0.1, 1e-3, 2))
    first, second = masses
    after = 0.1 * np.array([first - second, 2 * first]) / (first + second)
    assert truth.velocity[-1] == pytest.approx(after, rel=0, abs=2e-16)


def test_a_grain_that_is_thrown_up_falls_back_as_fast():
    """The flight between two contacts is a parabola of duration 2 v / g."""
    chain = column(2)
    flight = struck(chain, -1e-2, 3e-3, 31)
    truth = reference(flight)
    energy = chain.excess_energy(truth.displacement, truth.velocity)
    assert energy == pytest.approx(energy[0], rel=1e-14, abs=0)
    apart = truth.displacement[:, 0] < -chain.length_scale
    assert 15 < apart.sum() < 31  # 2 v / g is 2.04 ms
    up = flight.time[apart][1:15]
    speed = truth.velocity[apart, 0][1:15]
    assert np.diff(speed) / np.diff(up) == pytest.approx(9.81, rel=1e-11, abs=0)


def test_grains_beyond_the_wave_have_no_effect():
    """The chains have 120 and 10,000 grains, with different units of time and length."""
    short = paper("fig5 g", samples=3).replace(duration=3e-5)
    long = Scene(**short.given() | {"chain": column(10_000)})
    few = reference(short)
    many = reference(long)
    assert many.error < GOOD
    reached = few.displacement.shape[1]
    assert distance((many.displacement[:, :reached], many.velocity[:, :reached]), few) < 1e-15
    assert not many.displacement[:, 200:].any()


def test_samples_between_steps_are_as_accurate():
    """Samples are exact up to the rounding of their times, which contributes 2e-15."""
    few, many = (reference(strong(samples, 1e-5)) for samples in (5, 101))
    assert distance((many.displacement[::25], many.velocity[::25]), few) < 5e-15
    middle = reference(strong(2, 37 * 1e-7))
    u, v = (x[37:38] for x in (many.displacement, many.velocity))
    assert distance((u, v), (middle.displacement[-1:], middle.velocity[-1:])) < 1e-14


def test_the_reference_states_its_method():
    found = reference(smooth())
    assert "Taylor series of order 32" in found.method
    assert ("18 digits" in found.method) == (np.finfo(np.longdouble).precision == 18)


@pytest.mark.parametrize("beyond", [-1e-3, 0.0, 1e-8, 1e-5, 1e-2, 1.0])
def test_a_spring_that_opens_for_a_moment_has_its_exact_motion(beyond: float):
    """The motion of a loaded grain is a cosine, and a parabola while its linear spring is open."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=1e-3, exponent=1.0)
    constant = np.longdouble(chain.contacts.constant[1])
    omega = np.sqrt(constant / chain.masses[0])
    rest = chain.top_load / constant
    start = Displacement(displacement=float(rest * (1 + beyond)))
    wave = start.displacement / rest
    # Phases of the opening and of the greatest height, about which the motion is symmetric.
    root = np.sqrt(np.maximum(wave**2 - 1, 0))
    turn = np.arctan2(root, np.longdouble(-1)) + root
    scene = scene_of(chain, start, float(2 * turn / omega), 41)
    away = np.abs(scene.time * omega - turn)
    flight = -1 - (root**2 - away**2) / 2
    height = np.where(away < root, flight, wave * np.cos(turn - away)) * rest
    found = reference(scene).displacement[:, 0]
    assert np.abs(found - height).max() < GOOD * np.abs(height).max()


# The second term begins at an overlap of 1 m, so that the law is no power but acts like one.
HERTZ = Law("k*max(o, 0)**1.5 + k*max(o - 1, 0)**1.5")
FORCED = {
    "strike": ({}, Impulse(velocity=0.05)),
    "drive": ({}, Drive(amplitude=2e-8, frequency=3e4)),
    # Grain 1 moves most, and is at rest at the samples.
    "fast drive": ({}, Drive(amplitude=2e-9, frequency=1.5e6)),
    "moving wall": ({"top": "wall"}, Drive(grain=0, amplitude=2e-8, frequency=3e4)),
    # This force ends during the run.
    "force": ({}, Force(grain=2, shape="half-sine", amplitude=0.01, duration=6e-6)),
    "damped": (
        {"damping": {"viscoelastic": 2e-8, "drag": 200.0}},
        Force(grain=1, amplitude=0.01, frequency=3e4, cycles=2),
    ),
}


@pytest.mark.parametrize("name", FORCED)
def test_laws_by_formula_have_the_reference_of_power_laws(name: str) -> None:
    options, excitation = FORCED[name]
    chain = column(4, top_load=0.02, bottom="wall", **options)
    scene = scene_of(chain, excitation, 1e-5, 11)
    by_formula = scene.replace(chain=chain.replace(law=HERTZ))
    true, found = reference(scene), reference(by_formula)
    assert "SciPy" in found.method
    assert found.displacement.shape == true.displacement.shape
    off = distance(found, true, true.scale)
    assert off <= found.error + true.error
    # A tenth of the error is the change from a run at ten times the tolerance.
    assert found.error < 1e-9
    assert found.scale == pytest.approx(true.scale, rel=0.02)


@pytest.mark.parametrize("law", [{}, {"law": HERTZ}], ids=["power", "formula"])
@pytest.mark.parametrize("bottom", ["wall", "fixed"])
def test_a_driven_base_is_the_mirror_image_of_a_driven_top(bottom: str, law: dict[str, Any]):
    diameters = 1e-3 * np.array([1.0, 1.2, 0.9, 1.1])
    kinds = {"grains": 4, "gravity": 0.0, "top_load": 0.02, "damping": {"viscoelastic": 2e-8}}
    below = Chain(diameter=diameters, top="wall", bottom=bottom, **kinds, **law)
    above = Chain(
        diameter=diameters[::-1], top="free" if bottom == "fixed" else "wall", bottom="wall",
        **kinds, **law,
    )  # fmt: skip
    of_base, of_top = (
        reference(scene_of(chain, Drive(amplitude=amplitude, frequency=6e4, **end), 1e-5, 11))
        for chain, amplitude, end in (
            (below, 2e-8, {"end": "bottom"}), (above, -2e-8, {"grain": int(bottom == "fixed")})
        )
    )  # fmt: skip
    mirrored = -of_top.displacement[:, ::-1], -of_top.velocity[:, ::-1]
    assert distance(of_base, mirrored, of_top.scale) <= of_base.error + of_top.error
    assert of_base.scale == pytest.approx(of_top.scale, rel=0.01)
    if bottom == "fixed":
        exact = 2e-8 * np.sin(2 * np.pi * 6e4 * of_base.time)
        np.testing.assert_allclose(of_base.displacement[:, -1], exact, rtol=0, atol=1e-22)


def test_long_scenes_have_a_native_reference(capsys: pytest.CaptureFixture[str]):
    """Three springs of which the lowest grain is held have two exact modes."""
    chain = Chain(grains=3, diameter=1e-3, gravity=0.0, top_load=1.0, exponent=1.0)
    scene = scene_of(chain, Impulse(velocity=1e-3, grain=2), 1.0, 7)
    scene = scene.replace(duration=3.4e4 / scene.highest_frequency, grains=[2])
    assert expected_seconds(scene) > 60
    k, m = chain.linear_stiffness, chain.masses
    matrix = np.array([[k[0], -k[0]], [-k[0], k[0] + k[1]]]) / m[0]
    squares, modes = np.linalg.eigh(matrix)
    phases = np.sqrt(squares) * scene.time[:, None]
    exact = 1e-3 * (np.cos(phases) * modes[1]) @ modes.T
    # If rounding errors exceed a hundredth of the tolerance, the tolerance itself is used.
    for tolerance, stated in ((1e-4, ["1e-06"]), (1e-10, ["1e-11", "1e-10"])):
        found = truth(scene, tolerance)
        assert found.displacement.shape == (7, 3)
        words, _, reached = found.method.partition(" (")[0].rpartition(" ")
        assert words == "the native engine at a tolerance of"
        assert reached in stated
        assert np.abs(found.velocity[:, :2] - exact).max() <= found.error * found.scale[1] + 1e-14
        assert found.error <= float(reached)
    shown = as_trajectory(scene, found)
    assert shown.grains.tolist() == [2]
    np.testing.assert_array_equal(shown.velocity[:, 0], found.velocity[:, 1])
    np.testing.assert_array_equal(shown.displacement[:, 0], found.displacement[:, 1])
    assert (shown.error_estimate.model, shown.error_estimate.solver) == (0.0, found.error)
    # The solution is given, so that it has no cost.
    cost = shown.cost
    assert (cost.integration_s, cost.estimate_s, cost.setup_s, cost.step_s) == (0, 0, 0, 0)
    assert (cost.steps, cost.force_evaluations, cost.active_grains, cost.ranks) == (0, 0, 3, 1)


def on_springs(**chain):
    """Return a strong strike on a chain of springs that may open, on springs to the ground."""
    made = column(4, gravity=9.81, exponent=1, ground=Law("k*u", k=1e5), **chain)
    return scene_of(made, Impulse(velocity=1e-3), 10 * made.time_scale, 2)


def test_scipy_meets_springs_that_open_and_are_viscous():
    scene = on_springs(damping={"viscoelastic": 1e-7})
    native = simulate(scene, "native", tolerance=1e-9)
    exact = reference(scene)
    assert (scene.chain.contacts.overlap[1:-1] + np.diff(-exact.displacement) < 0).any()
    off = np.abs(native.velocity - exact.velocity).max()
    assert off < (1e-9 + exact.error) * exact.scale[1]


def test_scipy_finds_the_largest_motion_between_samples():
    scene = on_springs().replace(excitation=Displacement(displacement=1e-10, grain=3))
    dense = simulate(scene.replace(samples=801), "native", tolerance=1e-9)
    exact = reference(scene)
    largest = np.abs(dense.displacement).max(), np.abs(dense.velocity).max()
    assert exact.scale == pytest.approx(largest, rel=0.01)
    assert np.abs(exact.velocity).max() < 0.9 * largest[1]
