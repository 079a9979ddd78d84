"""A driven grain follows its drive, and the others follow Eq. (1).

(1) to the order of the integrator.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from helpers.independent_integrators import distance, extended_reference
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from lmpchain import Chain, Drive, Impulse, Profile, Scene, engines, simulate
from lmpchain.integrators.methods import METHODS

Array = NDArray[np.float64]
every = pytest.mark.parametrize("integrator", sorted(METHODS))


def loaded(**keys: Any) -> Chain:
    return Chain(**{"grains": 8, "diameter": 1e-3, "gravity": 0.0, "top_load": 1e-3} | keys)


def sine(chain: Chain, strength: float = 1e-3, slower: float = 1.0) -> Drive:
    """Return a sine drive with amplitude in overlaps and period in 2 pi sqrt(m_1 / k_1)."""
    return Drive(
        amplitude=strength * chain.length_scale,
        frequency=1 / (2 * np.pi * slower * chain.time_scale),
    )


def path(chain: Chain, strength: float = 1e-2, points: int = 12, seed: int = 1) -> Drive:
    """Return a path through random points, slightly longer than 8 units of time, by PCHIP."""
    rng = np.random.default_rng(seed)
    apart = rng.uniform(0.4, 1, points)
    times = np.append(0, np.cumsum(apart)) * (8.5 * chain.time_scale / apart.sum())
    return Drive(
        times=times,
        displacement=np.append(0, rng.normal(size=points)) * strength * chain.length_scale,
    )


def cubic(chain: Chain) -> tuple[Drive, Array]:
    """Return a path through seven points of a cubic, and the cubic's coefficients."""
    times = np.array([0, 0.3, 1.1, 3.0, 4.2, 7.0, 9.0]) * chain.time_scale
    coefficients = np.array([1.0, -12.0, 30.0, 0.0]) * 1e-4 * chain.length_scale
    coefficients /= chain.time_scale ** np.array([3, 2, 1, 0])
    values = np.polyval(coefficients, times)
    return Drive(times=times, displacement=values, interpolation="spline"), coefficients


# --- the motion of grain 1


@every
def test_grain_1_follows_a_sine(integrator: str):
    chain = loaded(bottom="wall")
    scene = scene_of(chain, sine(chain, 0.3, slower=0.5), 8 * chain.time_scale, 41)
    t = simulate(scene, engine=engines.Native(integrator=integrator, step=scene.duration / 320))
    a = 0.3 * chain.length_scale
    omega = 2 / chain.time_scale
    phase = omega * scene.time
    assert t.displacement[:, 0] / a == pytest.approx(np.sin(phase), rel=0, abs=3e-15)
    assert t.velocity[:, 0] / (a * omega) == pytest.approx(np.cos(phase), rel=0, abs=3e-15)


@every
def test_grain_1_follows_a_path(integrator: str):
    """The spline through points of a cubic is this cubic; other points give SciPy's curve."""
    chain = loaded()
    drive, coefficients = cubic(chain)
    crooked = path(chain, 0.1)
    curve = PchipInterpolator(crooked.times, crooked.displacement)
    slope = np.polyder(coefficients)
    for given, u, v in (
        (drive, lambda t: np.polyval(coefficients, t), lambda t: np.polyval(slope, t)),
        (crooked, curve, curve.derivative()),
    ):
        scene = scene_of(chain, given, 8 * chain.time_scale, 41)
        t = simulate(scene, engine=engines.Native(integrator=integrator, step=scene.duration / 320))
        for found, true in ((t.displacement, u(scene.time)), (t.velocity, v(scene.time))):
            assert found[:, 0] == pytest.approx(true, rel=0, abs=1e-13 * np.abs(true).max())


def test_two_points_make_a_piston():
    chain = loaded()
    scene = scene_of(chain, Drive(times=[0, 1e-3], displacement=[0, 1e-9]), 8 * chain.time_scale, 9)
    t = simulate(scene)
    assert t.velocity[:, 0] == pytest.approx(1e-6, rel=1e-14)
    assert t.displacement[:, 0] == pytest.approx(1e-6 * scene.time, rel=1e-14)


def test_grain_1_follows_its_drive_for_any_mass():
    chain = loaded()
    runs = []
    for mass in (1e-9, 1.0):
        heavy = loaded(impurity=[{"grain": 1, "mass": mass}])
        scene = scene_of(heavy, sine(chain, 0.5), 8 * chain.time_scale, 5)
        runs.append(
            simulate(scene, engine=engines.Native(step=scene.duration / 400, force="exact"))
        )
    assert np.array_equal(runs[0].displacement, runs[1].displacement)
    assert np.array_equal(runs[0].velocity, runs[1].velocity)


# --- batches, pieces and restarts


@pytest.mark.parametrize("integrator", ["verlet", "kahan-li6", "rkn6"])
@pytest.mark.parametrize("engine", ["native", "lammps"])
@pytest.mark.parametrize(
    "drive",
    [
        Drive(amplitude=2e-7, frequency=3e4),
        Drive(times=np.linspace(0, 1e-4, 9), displacement=2e-7 * np.sin(np.arange(9.0)) ** 2),
    ],
    ids=["harmonic", "sampled"],
)
def test_recorded_motion_of_a_driven_grain(integrator: str, engine: str, drive: Drive) -> None:
    """Displacement and velocity are the prescribed ones, within an ulp of a height in LAMMPS."""
    chain = Chain(grains=12, material="steel", diameter=5e-3, gravity=0.0, top_load=1.0)
    t = simulate(scene_of(chain, drive, 1e-4, 11), engine, 0.9, integrator=integrator, step=2e-7)
    u, v = drive.motion(t.time)
    slack = 1e-22 if engine == "native" else 1e-15
    assert t.displacement[:, 0] == pytest.approx(u, rel=0, abs=slack)
    assert t.velocity[:, 0] == pytest.approx(v, rel=1e-11, abs=1e-14)


def test_knots_and_touching_walls_are_not_smooth() -> None:
    """Knots of a path and a wall that only touches reduce the order without any opening."""
    pressed = Chain(grains=12, material="steel", diameter=5e-3, top_load=1.0)
    loose = Chain(grains=12, material="steel", diameter=5e-3, top="wall")
    points = Drive(times=np.linspace(0, 1e-4, 9), displacement=1e-9 * np.sin(np.arange(9.0)) ** 2)
    for chain, excitation, smooth in (
        (pressed, Drive(amplitude=1e-10, frequency=3e4), True),
        (pressed, Drive(times=[0.0, 1e-4], displacement=[0.0, 1e-9]), True),
        (pressed, points, False),
        (loose, Impulse(velocity=-1e-7, grain=4), False),
        (pressed, Impulse(velocity=-1e-7, grain=4), True),
    ):
        scene = scene_of(chain, excitation, 1e-4, 3)
        solver = engines.Native("rkn4", step=1e-6)
        run = solver.start([scene], solver.propose(scene, 1e-6))
        for _ in run.blocks():
            pass
        assert run.errors()[0].order == (METHODS["rkn4"].order if smooth else 2)


@pytest.mark.parametrize(("top", "grain"), [("free", 1), ("wall", 0)])
def test_a_drive_may_begin_with_grains_in_motion(
    rng: np.random.Generator, top: str, grain: int, tmp_path: Path
):
    """Runs from a scene file and its CSV table agree with an independent integration."""
    chain = loaded(top=top)
    u, v = (
        rng.normal(size=(2, 8))
        * 0.05
        * chain.length_scale
        * np.array([[1.0], [1 / chain.time_scale]])
    )
    u[-1] = v[-1] = 0.0
    u[:grain] = v[:grain] = 0.0
    start = Profile(displacement=u, velocity=v)
    scene = scene_of(
        chain, sine(chain, 0.05).replace(start=start, grain=grain), 8 * chain.time_scale, 9
    )
    t = simulate(scene, "native", 1e-10)
    assert distance(t, extended_reference(scene)) < 1e-9
    scene.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene
    rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(u.tolist(), v.tolist(), strict=True))
    (tmp_path / "start.csv").write_text("displacement,velocity\n" + rows)
    tables = scene.to_dict()
    tables["excitation"]["start"] = {"file": "start.csv"}
    assert Scene.from_dict(tables, tmp_path) == scene
    assert scene.excitation.scaled(2.0).start.velocity == pytest.approx(2 * v)
