"""A driven grain follows its drive, and the others follow Eq. (1).

(1) to the order of the integrator.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from helpers.independent_integrators import extended_reference, relative_error
from helpers.whole_runs import blocks_of
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.interpolate import PchipInterpolator

from lmpchain import Chain, Drive, Impulse, InputError, Profile, Scene, engines, simulate
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.methods import METHODS, SPLITTINGS
from lmpchain.scene.waveform import Waveform

Array = NDArray[np.float64]
every = pytest.mark.parametrize("integrator", sorted(METHODS))
splitting = pytest.mark.parametrize("integrator", sorted(SPLITTINGS))
COUNTS = {  # Multiples of 4; Gear's method converges slowly to its order, DOP853 from above.
    "verlet": [256, 512, 1024, 2048],
    "gear4": [512, 1024, 2048, 4096],
    "rkn4": [48, 64, 96, 128],
    "kahan-li6": [32, 48, 64, 96],
    "rkn6": [16, 20, 28, 40],
    "kahan-li8": [32, 40, 48, 56],
    "dop853": [24, 32, 40, 48],
}


def loaded(**keys: Any) -> Chain:
    return Chain(**{"grains": 8, "diameter": 1e-3, "gravity": 0.0, "top_load": 1e-3} | keys)


def scene_of(chain: Chain, drive: Drive, samples: int = 2, units: float = 8.0) -> Scene:
    return Scene(chain=chain, excitation=drive, duration=units * chain.time_scale, samples=samples)


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
    scene = scene_of(chain, sine(chain, 0.3, slower=0.5), samples=41)
    t = simulate(scene, engine=engines.Native(integrator=integrator, step=scene.duration / 320))
    a = 0.3 * chain.length_scale
    omega = 2 / chain.time_scale
    assert t.displacement[:, 0] == pytest.approx(
        a * np.sin(omega * scene.time), rel=0, abs=3e-15 * a
    )
    assert t.velocity[:, 0] == pytest.approx(
        a * omega * np.cos(omega * scene.time), rel=0, abs=3e-15 * a * omega
    )


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
        scene = scene_of(chain, given, samples=41)
        t = simulate(scene, engine=engines.Native(integrator=integrator, step=scene.duration / 320))
        for found, true in ((t.displacement, u(scene.time)), (t.velocity, v(scene.time))):
            assert found[:, 0] == pytest.approx(true, rel=0, abs=1e-13 * np.abs(true).max())


def test_two_points_make_a_piston():
    chain = loaded()
    scene = scene_of(chain, Drive(times=[0, 1e-3], displacement=[0, 1e-9]), samples=9)
    t = simulate(scene)
    assert t.velocity[:, 0] == pytest.approx(1e-6, rel=1e-14)
    assert t.displacement[:, 0] == pytest.approx(1e-6 * scene.time, rel=1e-14)


def test_grain_1_follows_its_drive_for_any_mass():
    chain = loaded()
    runs = []
    for mass in (1e-9, 1.0):
        heavy = loaded(impurity=[{"grain": 1, "mass": mass}])
        scene = Scene(
            chain=heavy, excitation=sine(chain, 0.5), duration=8 * chain.time_scale, samples=5
        )
        runs.append(
            simulate(scene, engine=engines.Native(step=scene.duration / 400, force="exact"))
        )
    assert np.array_equal(runs[0].displacement, runs[1].displacement)
    assert np.array_equal(runs[0].velocity, runs[1].velocity)


# --- motion of the other grains


@every
@pytest.mark.parametrize("bottom", ["fixed", "wall"])
def test_order_of_convergence(integrator: str, bottom: str):
    """If a stage used the path at the wrong time, the order would decrease to 1 or 2."""
    chain = loaded(bottom=bottom)
    check_order(scene_of(chain, sine(chain)), integrator)


@splitting
def test_a_path_without_kinks_keeps_the_order(integrator: str):
    chain = loaded()
    check_order(scene_of(chain, cubic(chain)[0]), integrator)


@every
def test_kinks_between_steps_keep_the_order(integrator: str):
    """If knots are at steps, every step is smooth."""
    chain = loaded()
    displacement = np.array([0, 1, -1, 2, 0]) * 1e-3 * chain.length_scale
    drive = Drive(times=np.arange(5) * 2 * chain.time_scale, displacement=displacement)
    check_order(scene_of(chain, drive), integrator)


@cache
def exact(scene: str) -> tuple[Array, Array, float]:
    """Return the motion of a scene file in extended precision, and its error."""
    return extended_reference(Scene.from_text(scene))


def check_order(scene: Scene, integrator: str) -> None:
    """Compare the observed order of convergence with the documented order of the method."""
    u, v, own = exact(scene.to_text())
    errors = []
    counts = COUNTS[integrator]
    for count in counts:
        t = simulate(
            scene, engine=engines.Native(integrator=integrator, step=scene.duration / count)
        )
        assert t.cost.steps == count
        errors.append(relative_error(t.displacement, t.velocity, u, v))
    assert min(errors) > 100 * own
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(
        METHODS[integrator].order, abs=0.05 if integrator in SPLITTINGS else 0.2
    )


LOADED = loaded()
COLUMN = Chain(grains=20, diameter=1e-3, bottom="wall")
VACUUM = loaded(top_load=0.0, bottom="wall", grains=5)
DRIVEN = {
    "a gentle path": scene_of(LOADED, path(LOADED), samples=5),
    "a crooked path": scene_of(COLUMN, path(COLUMN, 0.3, points=30), samples=5),
    "contacts that open": scene_of(COLUMN, path(COLUMN, 5.0), samples=5),
    "a hammering sine": scene_of(COLUMN, sine(COLUMN, 3.0, slower=0.7), samples=5, units=20),
    "the vacuum": Scene(
        chain=VACUUM,
        excitation=Drive(amplitude=1e-8, frequency=2e5),
        duration=2e-5,
        samples=5,
        grains="2:4",
    ),
}


@pytest.mark.parametrize("scene", DRIVEN.values(), ids=DRIVEN)
def test_accuracy_is_as_requested_and_estimated(scene: Scene):
    u, v, own = extended_reference(scene)
    columns = scene.recorded - 1
    for integrator, tolerance in (
        ("rkn6", 1e-5),
        ("rkn6", 1e-9),
        ("kahan-li6", 1e-7),
        ("verlet", 1e-5),
    ):
        t = simulate(scene, tolerance=tolerance, integrator=integrator, engine="native")
        true = relative_error(t.displacement, t.velocity, u[:, columns], v[:, columns])
        assert true <= tolerance
        assert (true - own) / 3 <= t.error_estimate.total <= tolerance


def by_modes(scene: Scene, mode: Any) -> tuple[Array, Array]:
    """Solve m x'' = -K x + k_1 x_1(t) for the free grains in 30 digits, (T, M-1) each.

    `mode` gives q and q' of q'' = -w^2 q + x_1(t) at a time, at rest to begin with.
    """
    chain = scene.chain
    size = chain.movable - 1
    with mpmath.workdps(30):
        k = mpmath.matrix([*chain.contact_constants, *chain.wall_constants[1:]][: size + 1])
        root = [mpmath.sqrt(mass) for mass in chain.masses[1 : size + 1]]
        matrix = mpmath.zeros(size)
        for n in range(size):
            matrix[n, n] = (k[n] + k[n + 1]) / root[n] ** 2
            if n:
                matrix[n, n - 1] = matrix[n - 1, n] = -k[n] / (root[n] * root[n - 1])
        squares, shapes = mpmath.eigsy(matrix)
        strength = [k[0] * shapes[0, j] / root[0] for j in range(size)]
        states = []
        for t in scene.time:
            q = [mode(mpmath.mpf(t), mpmath.sqrt(square)) for square in squares]
            for n in range(size):
                weights = [shapes[n, j] * strength[j] / root[n] for j in range(size)]
                states += [[float(mpmath.fdot(weights, [each[i] for each in q])) for i in (0, 1)]]
    x, v = np.array(states).reshape(scene.samples, size, 2).transpose(2, 0, 1)
    return x, v


def sine_mode(amplitude: float, frequency: float) -> Any:
    def mode(t: Any, own: Any) -> tuple[Any, Any]:
        w = 2 * mpmath.pi * frequency
        scale = amplitude / (own**2 - w**2)
        return (
            scale * (mpmath.sin(w * t) - w / own * mpmath.sin(own * t)),
            scale * w * (mpmath.cos(w * t) - mpmath.cos(own * t)),
        )

    return mode


def piston_mode(distance: float, time: float) -> Any:
    def mode(t: Any, own: Any) -> tuple[Any, Any]:
        scale = distance / mpmath.mpf(time) / own**2
        return scale * (t - mpmath.sin(own * t) / own), scale * (1 - mpmath.cos(own * t))

    return mode


@pytest.mark.parametrize("bottom", ["fixed", "wall"])
@pytest.mark.parametrize("kind", ["sine", "piston"])
def test_springs_against_their_modes(kind: str, bottom: str):
    """A chain of closed springs is linear: each mode is a driven oscillator."""
    rng = np.random.default_rng(2)
    chain = Chain(
        grains=10,
        diameter=1e-3 * rng.uniform(0.8, 1.2, 10),
        exponent=1.0,
        top_load=1e-3,
        bottom=bottom,
    )
    size = 1e-2 * chain.length_scale
    unit = chain.time_scale
    if kind == "sine":
        drive = Drive(amplitude=size, frequency=0.15 / unit)
        mode = sine_mode(drive.amplitude, drive.frequency)
    else:
        drive = Drive(times=[0, 30 * unit], displacement=[0, 30 * size])
        mode = piston_mode(30 * size, 30 * unit)
    scene = scene_of(chain, drive, samples=11, units=30)
    x, v = by_modes(scene, mode)
    free = slice(1, chain.movable)

    def error(u: Array, w: Array) -> float:
        return relative_error(u[:, free], w[:, free], x, v)

    t = simulate(scene, "native", 1e-11)
    assert error(t.displacement, t.velocity) < 1e-11
    assert error(*extended_reference(scene)[:2]) < 3e-15


def test_the_energy_of_the_chain_is_the_input_of_the_drive():
    """The energy without grain 1 grows at the rate of the force of contact 1 times its speed."""
    chain = Chain(grains=12, diameter=1e-3, bottom="wall")
    scene = scene_of(chain, sine(chain, 2.0, slower=1.5), samples=4001, units=20)
    t = simulate(scene, "native", 1e-9)
    moving = t.velocity.copy()
    moving[:, 0] = 0
    held = chain.excess_energy(t.displacement, moving)
    overlap = chain.length_scale + t.displacement[:, 0] - t.displacement[:, 1]
    force = (
        chain.contact_constants[0] * np.maximum(overlap, 0) ** 1.5 - chain.masses[0] * chain.gravity
    )
    assert held[-1] == pytest.approx(simpson(force * t.velocity[:, 0], x=scene.time), rel=1e-6)
    assert overlap.min() < 0  # The contact opens and closes again.


# --- batches, pieces and restarts


@every
def test_batch_equals_single_runs(integrator: str):
    """Each chain of a batch follows its own drive, a sine or a path, as in a single run."""
    rng = np.random.default_rng(5)
    scenes = []
    for make in (
        sine,
        path,
        lambda chain: sine(chain, 2.0, slower=3),
        lambda chain: path(chain, 0.3, seed=2),
    ):
        chain = Chain(grains=25, diameter=1e-3 * rng.uniform(0.9, 1.1, 25), bottom="wall")
        scenes.append(Scene(chain=chain, excitation=make(chain), duration=3e-5, samples=5))
    solver = engines.Native(integrator=integrator, step=1e-7)
    run = solver.start(scenes, solver.propose(scenes[0], 1e-6))
    u, v = blocks_of(run)
    errors = run.errors()
    threaded = engines.Native(integrator=integrator, step=1e-7, threads=3).start(
        scenes, run.proposal
    )
    for one, other in zip((u, v), blocks_of(threaded), strict=True):
        assert np.array_equal(one, other)
    for i, scene in enumerate(scenes):
        alone = simulate(scene, engine=solver)
        assert np.array_equal(u[i], alone.displacement)
        assert np.array_equal(v[i], alone.velocity)
        assert errors[i].total == alone.error_estimate.solver
    assert len({*u[:, -1, 0]}) == 4


def test_driven_and_struck_chains_are_not_batched_together():
    chain = loaded()
    driven = scene_of(chain, sine(chain))
    struck = Scene(**driven.given() | {"excitation": Impulse(velocity=1e-6)})
    solver = engines.Native(step=1e-6)
    with pytest.raises(ValueError, match="a batch needs"):
        solver.start([driven, struck], solver.propose(driven, 1e-6))


@every
@pytest.mark.parametrize("make", [sine, path])
def test_exact_restart(integrator: str, make: Any, monkeypatch: pytest.MonkeyPatch):
    """A run that continues from a stored state has the same bytes, including the path's time."""
    chain = Chain(grains=30, diameter=1e-3)
    scenes = [
        Scene(chain=chain, excitation=make(chain, s), duration=3e-5, samples=9) for s in (1e-3, 3.0)
    ]
    solver = engines.Native(integrator=integrator, step=1e-7)
    candidate = solver.propose(scenes[0], 1e-6)
    whole = solver.start(scenes, candidate)
    u, v = blocks_of(whole)
    # Four samples per block after the one at t = 0.
    monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 1)
    begun = solver.start(scenes, candidate)
    blocks = []
    for block in begun.blocks():
        blocks.append(block)
        if block.samples.stop == 5:
            break
    kept: Mapping[str, Array] = begun.state()
    begun.close()
    again = solver.start(scenes, candidate, kept)
    rest_u, rest_v = blocks_of(again)
    assert np.array_equal(np.concatenate([*(b.displacement for b in blocks), rest_u], axis=1), u)
    assert np.array_equal(np.concatenate([*(b.velocity for b in blocks), rest_v], axis=1), v)
    assert [e.total for e in again.errors()] == [e.total for e in whole.errors()]


@every
def test_opportunities_to_stop_do_not_change_a_driven_run(
    integrator: str, monkeypatch: pytest.MonkeyPatch
):
    """Interruptions of a run do not change its bits."""
    chain = Chain(grains=10, diameter=1e-3)
    scene = scene_of(chain, path(chain, 2.0), samples=3)
    solver = engines.Native(integrator=integrator, step=scene.duration / 2000)
    whole = simulate(scene, engine=solver)
    monkeypatch.setattr(stepping_run, "PIECE_S", 1e-5)
    pieces = simulate(scene, engine=solver)
    assert np.array_equal(whole.displacement, pieces.displacement)
    assert np.array_equal(whole.velocity, pieces.velocity)


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
    scene = Scene(chain=chain, excitation=drive, duration=1e-4, samples=11)
    t = simulate(scene, engine, 0.9, integrator=integrator, step=2e-7)
    u, v = drive.motion(t.time)
    assert t.displacement[:, 0] == pytest.approx(
        u, rel=0, abs=1e-22 if engine == "native" else 1e-15
    )
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
        scene = Scene(chain=chain, excitation=excitation, duration=1e-4, samples=3)
        solver = engines.Native("rkn4", step=1e-6)
        run = solver.start([scene], solver.propose(scene, 1e-6))
        for _ in run.blocks():
            pass
        assert run.errors()[0].order == (METHODS["rkn4"].order if smooth else 2)


@pytest.mark.parametrize(("top", "grain"), [("free", 1), ("wall", 0)])
def test_a_drive_may_begin_with_grains_in_motion(top: str, grain: int, tmp_path: Path):
    """Runs from a scene file and its CSV table agree with an independent integration."""
    chain = loaded(top=top)
    rng = np.random.default_rng(3)
    u, v = (
        rng.normal(size=(2, 8))
        * 0.05
        * chain.length_scale
        * np.array([[1.0], [1 / chain.time_scale]])
    )
    u[-1] = v[-1] = 0.0
    u[:grain] = v[:grain] = 0.0
    start = Profile(displacement=u, velocity=v)
    scene = scene_of(chain, sine(chain, 0.05).replace(start=start, grain=grain), samples=9)
    t = simulate(scene, "native", 1e-10)
    x, y, _ = extended_reference(scene)
    assert relative_error(t.displacement, t.velocity, x, y) < 1e-9
    scene.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene
    rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(u.tolist(), v.tolist(), strict=True))
    (tmp_path / "start.csv").write_text("displacement,velocity\n" + rows)
    tables = scene.to_dict()
    tables["excitation"]["start"] = {"file": "start.csv"}
    assert Scene.from_dict(tables, tmp_path) == scene
    assert scene.excitation.scaled(2.0).start.velocity == pytest.approx(2 * v)


def test_a_start_of_another_length_is_rejected():
    chain = loaded()
    for start, said in (
        (
            Profile(velocity=np.ones(5)),
            "excitation.start.velocity: must have one entry a grain",
        ),
        (
            Profile(velocity=np.eye(8)[0]),
            "excitation.start.velocity: must be 0 for grain 1, because it is driven",
        ),
        (
            Profile(displacement=np.eye(8)[7]),
            "excitation.start.displacement: must be 0 for grain 8, which is held",
        ),
    ):
        tables = scene_of(chain, sine(chain)).to_dict()
        tables["excitation"]["start"] = {
            key: value.tolist() for key, value in start.given().items()
        }
        with pytest.raises(InputError) as caught:
            Scene.from_dict(tables)
        assert str(caught.value).startswith(said)


@pytest.mark.parametrize("cycles", [None, 2.3])
def test_derivatives_of_a_waveform_are_limits_of_differences(cycles):
    wave = Waveform.sine(2.0, 3.0, cycles)
    t = np.linspace(0.01, 0.7, 30)
    h = 1e-5
    for order in range(3):
        difference = (wave.at(t + h, order) - wave.at(t - h, order)) / (2 * h)
        assert wave.at(t, order + 1) == pytest.approx(
            difference, abs=1e-6 * wave.largest(order + 1)
        )
