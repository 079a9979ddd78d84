"""Forces and prescribed motions of a grain or the top wall, against independent solutions."""

import itertools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of
from helpers.forcing import Curve
from helpers.independent_integrators import distance, extended_reference
from helpers.standalone_lammps import lmp, read_dump
from helpers.thinned import thinned
from helpers.whole_runs import blocks_of
from numpy.typing import NDArray
from scipy.integrate import quad

from lmpchain import Chain, Drive, Force, InputError, Packet, Scene, engines, simulate
from lmpchain.benchmark.reference import reference
from lmpchain.engines.lammps.export import write_deck
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.integrators.methods import METHODS, SPLITTINGS
from lmpchain.measure import energy
from lmpchain.scene.excitation import EXCITATIONS
from lmpchain.scene.waveform import Waveform

Array = NDArray[np.float64]
every = pytest.mark.parametrize("integrator", sorted(METHODS))
LOADED = column(8, gravity=0.0, top_load=1e-3)
WALLED = Chain(**LOADED.given() | {"top": "wall"})
UNIT = LOADED.time_scale
LENGTH = LOADED.length_scale
LASTS = 8 * UNIT
LOAD = LOADED.top_load
POINTS = np.append(0.0, np.random.default_rng(3).normal(size=11))
TIMES = np.append(0.0, np.cumsum(np.random.default_rng(4).uniform(0.4, 1, 11)))
TIMES *= 8.5 * UNIT / TIMES[-1]


def forces(size: float, grain: int = 1, period: float = 2 * np.pi) -> dict[str, Force]:
    """Return forces of every kind with this size in top loads and period in sqrt(m_1 / k_1)."""
    wave = {"amplitude": size * LOAD, "frequency": 1 / (period * UNIT)}
    return {
        "sine": Force(grain=grain, **wave),
        "burst": Force(grain=grain, **wave, cycles=0.9),
        "half-sine": Force(
            grain=grain, shape="half-sine", amplitude=size * LOAD, duration=period * UNIT / 2
        ),
        "points": Force(grain=grain, times=TIMES, force=(1 + POINTS) * size * LOAD),
    }


def drives(size: float, grain: int = 0, period: float = 2 * np.pi) -> dict[str, Drive]:
    """Return motions of every kind with this size in overlaps."""
    wave = {"amplitude": size * LENGTH, "frequency": 1 / (period * UNIT)}
    return {
        "sine": Drive(grain=grain, **wave),
        "burst": Drive(grain=grain, **wave, cycles=0.9),
        "points": Drive(grain=grain, times=TIMES, displacement=POINTS * size * LENGTH),
    }


# --- exact solutions

SPRING = column(1, exponent=1.0, bottom="wall", masses=[2e-6], wall_constants=[0.0, 50.0])
OWN = 5000.0  # Natural frequency sqrt(50 / 2e-6), rad/s.


def course(given: Any) -> Any:
    """Return the imposed force or displacement over time from its definition."""
    if given.times is not None:
        values = given.force if given.kind == "force" else given.displacement
        curve = Curve(given, values, np.float64)
        return lambda t: curve(t)[0]
    if getattr(given, "shape", None):
        return lambda t: (
            given.amplitude * np.sin(np.pi * t / given.duration) if t < given.duration else 0.0
        )
    f = given.frequency
    cycles = given.cycles

    def value(t: float) -> float:
        if cycles is None:
            return given.amplitude * np.sin(2 * np.pi * f * t)
        hann = (1 - np.cos(2 * np.pi * f * t / cycles)) / 2 * (f * t < cycles)
        return given.amplitude * np.sin(2 * np.pi * f * t) * hann

    return value


def duhamel(given: Any, strength: float, times: Array, kinks: list[float]) -> tuple[Array, Array]:
    """Return x and x' of x'' = -OWN^2 x + strength f(t), initially at rest, by quadrature."""
    f = course(given)
    found = []
    largest = max(abs(f(t)) for t in np.linspace(0, times[-1], 101))
    for t in times:
        inside = [c for c in kinks if 0 < c < t] or None
        options = {"points": inside, "epsrel": 1e-14, "limit": 500}
        options["epsabs"] = 1e-13 * abs(strength / OWN) * t * largest
        sin, _ = quad(lambda s, t=t: f(s) * np.sin(OWN * (t - s)), 0, t, **options)
        cos, _ = quad(lambda s, t=t: f(s) * np.cos(OWN * (t - s)), 0, t, **options)
        found.append((strength / OWN * sin, strength * cos))
    x, v = np.array(found).T
    return x, v


ON_A_SPRING = {
    "sine": Force(amplitude=1e-7, frequency=300.0),
    "resonance": Force(amplitude=1e-7, frequency=OWN / (2 * np.pi)),
    "burst": Force(amplitude=1e-7, frequency=900.0, cycles=5),
    "broken burst": Force(amplitude=-1e-7, frequency=900.0, cycles=2.3),
    "half-sine": Force(shape="half-sine", amplitude=1e-7, duration=7.3e-4),
    "points": Force(times=np.linspace(0, 5e-3, 9), force=1e-7 * np.cos(np.arange(9.0))),
}


@pytest.mark.parametrize("kind", ON_A_SPRING)
@pytest.mark.parametrize("where", ["grain", "wall"])
def test_one_grain_on_a_spring(kind: str, where: str):
    """The driven oscillator by Duhamel's integral: forced, or by a spring with a moving end."""
    given = ON_A_SPRING[kind]
    chain = SPRING
    strength = 1 / 2e-6
    if where == "wall":
        if kind == "half-sine":
            return
        keys = given.given() | {"grain": 0}
        points = 1e-3 * (given.force - given.force[0]) if kind == "points" else None
        keys.pop("force", None)
        given = Drive(
            **keys | ({"displacement": points} if points is not None else {"amplitude": 1e-10})
        )
        chain = Chain(
            **SPRING.given() | {"top": "wall", "top_load": 1e-3, "wall_constants": [20.0, 30.0]}
        )
        strength = 20.0 / 2e-6
    scene = scene_of(chain, given, 5e-3, 9)
    kinks = [*given.waveform.kinks]
    # At resonance the samples miss most of the motion.
    between = np.linspace(0.0, scene.duration, 8 * 8 + 1)[1:]
    fields = duhamel(given, strength, between, kinks)
    (x, v) = (field[7::8] for field in fields)
    largest = [np.abs(field).max() for field in fields]

    def error(u: Array, w: Array) -> float:
        pairs = zip((u, w), (x, v), largest, strict=True)
        return max(float(np.abs(found[1:, 0] - true).max() / size) for found, true, size in pairs)

    truth = reference(scene)
    assert error(truth.displacement, truth.velocity) < 1e-13
    assert error(*extended_reference(scene)[:2]) < 1e-13
    t = simulate(scene, "native", 1e-11)
    assert error(t.displacement, t.velocity) < min(3 * t.error_estimate.total, 1e-11) + 1e-13
    if kind != "points":
        t = simulate(scene, "modes", on_miss="warn")
        assert error(t.displacement, t.velocity) < 1e-13


@pytest.mark.parametrize("name", ["modes", "chebyshev", "bessel"])
def test_walls_and_forces_in_linear_engines(name: str):
    """Modes and Chebyshev polynomials know sines, modes also bursts, and only modes know forces."""
    springs = WALLED.replace(exponent=1.0)
    acting = [*drives(1e-2).items(), *forces(1e-2, grain=3).items()]
    for kind, given in acting:
        scene = scene_of(springs, given, LASTS, 5)
        known = {"modes": True, "chebyshev": given.kind == "drive" and kind == "sine"}
        if kind == "points" or not known.get(name):
            with pytest.raises(InputError, match="excitation: "):
                simulate(scene, name)
        else:
            assert distance(simulate(scene, name), extended_reference(scene)) < 1e-12


# --- integrators

# All counts are 4 beyond a multiple of 8, so that a push of three eighths ends within a step.
COUNTS = {
    "verlet": [252, 508, 1020, 2044],
    "gear4": [508, 1020, 1532, 2044, 4092],
    "rkn4": [44, 60, 76, 100, 132],
    "kahan-li6": [44, 52, 60, 76, 92],
    "rkn6": [44, 52, 60, 76, 100],
    "kahan-li8": [36, 44, 52, 60],
    "dop853": [44, 52, 60, 76],
}
PERIODS = {"sine": 7.3, "burst": 3 / 0.9, "half-sine": 6.0}
ACTING = {
    f"force, {kind}": (LOADED, forces(1e-3, 3, period)[kind]) for kind, period in PERIODS.items()
} | {
    f"{name}, {kind}": (chain, drives(1e-3, grain, PERIODS[kind])[kind])
    for name, chain, grain in (("wall", WALLED, 0), ("grain 1", LOADED, 1))
    for kind in ("sine", "burst")
}


@cache
def gentle(kind: str) -> tuple[Array, Array, float]:
    """Return the motion in extended precision, and its error."""
    return extended_reference(scene_of(*ACTING[kind], LASTS, 2))


@every
@pytest.mark.parametrize("kind", ACTING)
def test_order_of_convergence(integrator: str, kind: str):
    """Half-sines and bursts end within a step, which is divided to preserve the order."""
    scene = scene_of(*ACTING[kind], LASTS, 2)
    u, v, own = gentle(kind)
    errors = []
    counts = COUNTS[integrator]
    for count in counts:
        t = simulate(
            scene, engine=engines.Native(integrator=integrator, step=scene.duration / count)
        )
        assert t.cost.steps == count or integrator == "dop853"
        errors.append(distance(t, (u, v)))
    assert min(errors) > 100 * own
    # The divided step has a smaller error than the others.
    n = np.array(counts, dtype=float)
    laws = [np.ones(n.size), -np.log(n)] + (
        [1 / n] if scene.excitation.waveform.kinks and integrator in SPLITTINGS else []
    )
    slope = np.linalg.lstsq(np.stack(laws, axis=1), np.log(errors), rcond=None)[0][1]
    assert slope == pytest.approx(
        METHODS[integrator].order, abs=0.05 if integrator in SPLITTINGS else 0.2
    )


STRONG = {
    **{
        f"force, {kind}": (Chain(**LOADED.given() | {"gravity": 9.81}), g)
        for kind, g in forces(3.0, 2).items()
    },
    **{f"wall, {kind}": (WALLED, g) for kind, g in drives(2.0).items()},
    **{f"grain below a wall, {kind}": (WALLED, g) for kind, g in drives(2.0, 1).items()},
    **{
        f"grain 1, {kind}": (Chain(**LOADED.given() | {"bottom": "wall"}), g)
        for kind, g in drives(2.0, 1).items()
    },
    "grain 1 on a sonic vacuum": (
        column(5, gravity=0.0, bottom="wall"),
        Drive(amplitude=1e-8, frequency=0.1 / UNIT),
    ),
    "a hammer on a sonic vacuum": (
        column(5, gravity=0.0, bottom="wall"),
        Force(shape="half-sine", amplitude=1e-2, duration=2 * UNIT),
    ),
    "a wall on a sonic vacuum": (
        column(5, gravity=0.0, top="wall", bottom="free"),
        Drive(amplitude=1e-8, frequency=0.1 / UNIT, grain=0),
    ),
}


@cache
def strong(kind: str) -> Any:
    """Return the reference solution, computed once for all its tests."""
    return reference(scene_of(*STRONG[kind], LASTS, 5))


@pytest.mark.parametrize("kind", thinned(STRONG, 5))
def test_accuracy_is_as_requested_and_estimated(kind: str):
    """Contacts open and close as well; the two references agree."""
    scene = scene_of(*STRONG[kind], LASTS, 5)
    truth = strong(kind)
    u, v, own = extended_reference(scene)
    assert distance(truth, (u, v)) < truth.error + 2 * own + 1e-13
    for integrator, tolerance in (
        ("rkn6", 1e-5),
        ("rkn6", 1e-9),
        ("kahan-li8", 1e-7),
        ("dop853", 1e-8),
        ("verlet", 1e-5),
    ):
        t = simulate(scene, "native", tolerance, integrator=integrator)
        true = distance(t, truth, truth.scale)
        assert true <= tolerance
        assert (true - truth.error) / 3 <= t.error_estimate.total <= tolerance


IN_LAMMPS = "force, burst", "force, half-sine", "force, points", "wall, burst", "wall, points"


@pytest.mark.parametrize(
    ("kind", "integrator"),
    thinned(itertools.product(IN_LAMMPS, ("rkn6", "kahan-li6", "verlet")), 7),
)
def test_lammps(kind: str, integrator: str):
    """Estimates hold for runs of LAMMPS with forces and moving walls."""
    scene = scene_of(*STRONG[kind], LASTS, 5)
    truth = strong(kind)
    t = simulate(scene, "lammps", 1e-3 if integrator == "verlet" else 1e-6, integrator=integrator)
    assert (distance(t, truth, truth.scale) - truth.error) / 3 <= t.error_estimate.total


# --- batches, pieces and restarts


BATCHES = {
    "forces and walls": [
        *forces(2.0, 3).values(),
        *drives(2.0).values(),
        Force(grain=7, amplitude=1e-3, frequency=1e5),
    ],
    "grain 1": [*drives(2.0, 1).values(), *drives(0.3, 1, 3.0).values()],
}


@every
@pytest.mark.parametrize("given", BATCHES.values(), ids=BATCHES)
def test_batch_equals_single_runs(integrator: str, given: list[Any]):
    scenes = [scene_of(WALLED, each, LASTS, 5) for each in given]
    solver = engines.Native(integrator=integrator, step=scenes[0].duration / 200)
    run = solver.start(scenes, solver.propose(scenes[0], 1e-6))
    u, v = blocks_of(run)
    for i, scene in enumerate(scenes):
        alone = simulate(scene, engine=solver)
        assert np.array_equal(u[i], alone.displacement)
        assert np.array_equal(v[i], alone.velocity)
    assert len({*u[:, -1, 1]}) == len(scenes)


PLACES = [("native", integrator) for integrator in sorted(METHODS)] + [
    pytest.param("lammps", integrator, marks=pytest.mark.slow)
    for integrator in ("verlet", "kahan-li6", "rkn6")
]


@pytest.mark.parametrize(("engine", "integrator"), PLACES)
@pytest.mark.parametrize(
    "kind", [kind for kind in STRONG if kind.startswith(("force", "wall", "grain 1,"))]
)
def test_exact_restart(engine: str, integrator: str, kind: str, monkeypatch: pytest.MonkeyPatch):
    """A run that continues from a stored state ends with the same bytes, including the clock."""
    scene = scene_of(*STRONG[kind], LASTS, 9)
    options = {"diameter": "gauge"} if engine == "lammps" else {}
    solver = engines.get(engine, integrator=integrator, step=scene.duration / 203, **options)
    candidate = solver.propose(scene, 1e-6)
    whole = solver.start([scene], candidate)
    u, v = blocks_of(whole)
    monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 1)  # Four samples per block.
    begun = solver.start([scene], candidate)
    blocks = []
    for block in begun.blocks():
        blocks.append(block)
        if block.samples.stop == 5:
            break
    kept = begun.state()
    begun.close()
    again = solver.start([scene], candidate, kept)
    rest_u, rest_v = blocks_of(again)
    assert np.array_equal(np.concatenate([*(b.displacement for b in blocks), rest_u], axis=1), u)
    assert np.array_equal(np.concatenate([*(b.velocity for b in blocks), rest_v], axis=1), v)
    assert [e.total for e in again.errors()] == [e.total for e in whole.errors()]


def test_adaptive_steps_restart_exactly(monkeypatch: pytest.MonkeyPatch):
    for kind in ("force, burst", "force, points", "wall, burst", "wall, points"):
        scene = scene_of(*STRONG[kind], LASTS, 9)
        whole = simulate(scene, "native", 1e-8)
        monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 1)
        monkeypatch.setattr(stepping_run, "PIECE_S", 1e-5)
        pieces = simulate(scene, "native", 1e-8)
        monkeypatch.undo()
        assert np.array_equal(whole.displacement, pieces.displacement)


# --- balances


@pytest.mark.parametrize(
    "wave",
    [
        Waveform.sine(2.0, 3.0),
        Waveform.sine(2.0, 3.0, cycles=1),
        Waveform.sine(2.0, 3.0, cycles=2.5),
        Waveform.half_sine(2.0, 0.4),
        Waveform.through(np.array([0.1, 0.3, 0.4]), np.array([1.0, 3.0, 2.0]), "linear", True),
        Waveform.through(np.array([0.1, 0.3, 0.4]), np.array([1.0, 3.0, 2.0]), "pchip", False),
    ],
)
def test_the_integral_of_a_forcing(wave: Waveform):
    """The integral agrees with quadrature from kink to kink."""
    edges = np.unique(np.append([0.0, 0.25, 0.9], [t for t in wave.kinks if t < 0.9]))
    parts = [quad(wave.at, a, b, epsabs=1e-13)[0] for a, b in itertools.pairwise(edges)]
    assert wave.integral(edges[1:]) == pytest.approx(np.cumsum(parts), rel=1e-11, abs=1e-12)
    assert wave.integral(0.0) == 0


@pytest.mark.parametrize("kind", thinned(STRONG, 2))
def test_work_and_impulse_are_balanced(kind: str):
    """Energy is the work of the force or driver; momentum is its impulse, with load and walls."""
    t = simulate(scene_of(*STRONG[kind], LASTS, 4001), "native", 1e-9)
    ledger = energy.ledger(t)
    assert np.ptp(ledger.total) > 0
    assert np.abs(ledger.drift).max() <= ledger.drive_error + 1e-8 * ledger.total.max()
    largest = np.abs(ledger.momentum).max()
    assert np.abs(ledger.momentum_drift).max() <= ledger.impulse_error + 1e-8 * largest
    # The force on the driver has kinks at the points of a curve.
    assert ledger.drive_error < (2e-5 if "points" in kind else 1e-5) * ledger.total.max()
    parts = ledger.kinetic + ledger.contact + ledger.gravity + ledger.load
    assert parts == pytest.approx(ledger.total, rel=0, abs=1e-9 * np.abs(ledger.contact).max())


# --- files


@pytest.mark.parametrize("kind", [*STRONG, "packet"])
def test_scene_files(kind: str):
    """A scene file contains everything, and a scaled excitation is stronger by the factor."""
    chain = column(90, gravity=0.0, top_load=1.0, bottom="wall", wall_constants=[0.0, 3e9])
    chain, given = (chain, Packet(2e4, 5.0, 40, 1e-12)) if kind == "packet" else STRONG[kind]
    scene = scene_of(chain, given, LASTS, 2)
    assert Scene.from_text(scene.to_text()) == scene
    assert Scene.from_dict(scene.to_dict()) == scene
    assert given.kind in EXCITATIONS
    assert given.scaled(1.0) == given
    twice = given.scaled(2.0).largest(chain)[1].max()
    assert twice > 1.2 * given.largest(chain)[1].max()


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["force, burst", "force, half-sine", "force, points", "wall, burst", "wall, points"]
)
def test_decks(kind: str, tmp_path: Path):
    """A complete deck has forces and a moving wall: equal steps give the same motion."""
    scene = scene_of(*STRONG[kind], LASTS, 5)
    step = scene.duration / 400
    write_deck(scene, tmp_path, step=step, diameter="gauge")
    lmp(tmp_path)
    u, v = read_dump(tmp_path / "column.lammpstrj")
    same = simulate(scene, engines.Native("verlet", step))
    assert distance((u, v), same) < 1e-10


@pytest.mark.parametrize(
    ("integrator", "uneven"),
    thinned(itertools.product(["dop853", "rkn4", "rkn6", "kahan-li8"], [False, True]), 5),
)
def test_knots_that_cut_the_steps_of_all_runs_hide_no_error(integrator: str, uneven: bool):
    """The error estimate holds even if the knots are closer than the steps at 1e-2."""
    chain = column(5, top_load=0.1)
    times = np.linspace(0, 1, 101)
    times += uneven * 0.3 * np.sin(np.arange(101)) * times[1] * (np.arange(101) % 100 > 0)
    shape = (
        0.2
        * chain.length_scale
        * np.sin(np.linspace(0, 6, 101))
        * (1 + 0.02 * np.sin(37 * np.arange(101)))
    )
    duration = 20 / chain.band_edge
    drive = Drive(times=1.05 * duration * times, displacement=shape)
    scene = scene_of(chain, drive, duration, 2)
    found = simulate(scene, engines.Native(integrator), 1e-2)
    truth = reference(scene)
    assert distance(found, truth, truth.scale) < found.error_estimate.total < 1e-2
