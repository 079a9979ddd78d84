"""Runs of the engines.

What they have cost, how far they are, where they go on, how they end, and in which company.
"""

from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest
from helpers.example_chains import random_column
from helpers.example_scenes import paper, scene_of, smooth, struck
from helpers.independent_integrators import distance, extended_reference
from helpers.whole_runs import blocks_of
from scipy.integrate import solve_ivp

from lmpchain import (
    Chain,
    Displacement,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    RunFailed,
    Scene,
    simulate,
)
from lmpchain.engines import Bessel, Chebyshev, Continuum, Lammps, Modes, Native
from lmpchain.engines.stepping import monitor
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.engines.stepping.monitor import place_looks
from lmpchain.engines.stepping.time_stepping import kind
from lmpchain.integrators.methods import METHODS
from lmpchain.util.arrays import EPSILON

CHAIN = Chain(grains=10, diameter=1e-3)
SCENE = Scene(chain=CHAIN, excitation=Impulse(velocity=1e-3), duration=4e-5, samples=21)


@pytest.fixture
def small_blocks(monkeypatch):
    """Make blocks of four samples."""
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)


def test_attributes_of_engines():
    """The attributes are the equation number of the paper and supported features."""
    engines = Native(), Lammps(), Modes(), Chebyshev(), Bessel(), Continuum()
    assert [
        (each.name, each.equation, each.batches, each.whole, each.ranks_of_mpi) for each in engines
    ] == [
        ("native", 1, True, False, False),
        ("lammps", 1, False, False, True),
        ("modes", 3, True, False, False),
        ("chebyshev", 3, True, False, False),
        ("bessel", 4, False, True, False),
        ("continuum", 27, False, True, False),
    ]
    assert Modes().methods(smooth()) == ()
    assert [method.name for method in Native().methods(smooth())] == ["rkn4", "rkn6"]
    assert [method.name for method in Native("verlet").methods(smooth())] == ["verlet"]


@pytest.mark.parametrize("engine", [*METHODS, Lammps("rkn6", step=SCENE.duration / 160)])
def test_the_cost_of_a_run(engine):
    """Steps divide the time between samples, and each step has the evaluations of its method."""
    interval = SCENE.duration / 20
    engine = Native(engine, step=interval / 7.5) if isinstance(engine, str) else engine
    began = perf_counter()
    cost = simulate(SCENE, engine).cost
    spent_s = perf_counter() - began
    name = engine.integrator
    assert (cost.integrator, cost.active_grains, cost.ranks) == (name, 10, 1)
    assert cost.steps == 20 * 8
    assert cost.step_s == pytest.approx(interval / 8, rel=1e-12)
    assert cost.force_evaluations == 160 * METHODS[name].evaluations
    assert min(cost.integration_s, cost.estimate_s, cost.setup_s) > 0
    assert cost.integration_s + cost.estimate_s + cost.setup_s + cost.compile_s < spent_s


@pytest.mark.parametrize("engine", [Native(step=2e-8), Lammps("rkn6", step=1e-7)])
def test_a_run_continues_from_any_block_with_the_same_bits(engine, small_blocks):
    candidate = engine.propose(SCENE, 1e-6)
    run = engine.start([SCENE], candidate)
    blocks = []
    states = []
    progress = [run.progress]
    for block in run.blocks():
        if block.samples.stop == block.samples.start:
            continue  # An opportunity to stop.
        blocks.append(block)
        states.append(run.state())
        progress.append(run.progress)
    errors = run.errors()[0]
    run.close()
    stops = [block.samples.stop for block in blocks]
    assert stops[-1] == 21
    assert [block.samples.start for block in blocks] == [0, *stops[:-1]]
    assert len(blocks) > 3
    assert (progress[0], progress[-1]) == (0, 1)
    assert progress == sorted(progress)
    assert progress[1] == pytest.approx((stops[0] - 1) / 20, rel=1e-9)
    state = states[1]
    again = engine.start([SCENE], candidate, state)
    rest = blocks_of(again)[1]
    other = again.errors()[0]
    assert np.array_equal(rest, np.concatenate([block.velocity for block in blocks[2:]], axis=1))
    assert (other.truncation, other.roundoff) == (errors.truncation, errors.roundoff)
    assert again.monitor.peaks[0, 1] == pytest.approx(1e-3, rel=0.05)
    for spoilt in (
        {"differences": state["differences"][:1]},
        {"peaks": np.zeros((2, 2))},
        {"sample": state["sample"] + 1},
    ):
        with pytest.raises(InputError, match="checkpoint: does not belong to its run, or was"):
            engine.start([SCENE], candidate, state | spoilt)


def test_differences_of_auxiliary_runs_equal_those_of_single_runs():
    """The differences are between steps h and 2h, and between 2h and 4h."""
    step = SCENE.duration / 160
    engine = Native("verlet", step=step)
    run = engine.start([SCENE], engine.propose(SCENE, 1e-6))
    blocks_of(run)
    distances = run.state()["differences"][:, :, 0]
    answers = [simulate(SCENE, Native("verlet", step=n * step)) for n in (1, 2, 4)]
    for index, (one, other) in enumerate(pairwise(answers)):
        for field, name in enumerate(("displacement", "velocity")):
            expected = np.abs(getattr(one, name) - getattr(other, name)).max(1)
            scale = 1e-9 * np.abs(getattr(one, name)).max()
            np.testing.assert_allclose(distances[index, :, field], expected, rtol=1e-6, atol=scale)
    assert run.monitor.closest[0] > 0


def test_a_breakdown_is_reported_with_its_time_and_step():
    """Steps are stable at rest, but not after a strike stiffens a contact."""
    scene = SCENE.replace(excitation=Impulse(velocity=1.0), duration=1e-3, samples=501)
    engine = Native("verlet", step=1.9 / CHAIN.band_edge)
    step = engine.propose(scene, 1e-6).step
    with pytest.raises(RunFailed) as failed:
        simulate(scene, engine)
    reason, _, rest = str(failed.value).partition(", after t = ")
    assert reason in (*monitor.WRONG.values(), monitor.TOO_CLOSE)
    time, _, rest = rest.partition(" s at steps of ")
    assert rest == f"{step:.3g} s: use a shorter step or a tolerance"
    assert 0 <= float(time) < 1e-3


def test_recorded_grains_are_columns_of_the_full_motion():
    whole = simulate(SCENE, Native(step=2e-8))
    some = simulate(SCENE.replace(grains=[7, 2, 9]), Native(step=2e-8))
    assert np.array_equal(some.displacement, whole.displacement[:, [6, 1, 8]])
    assert np.array_equal(some.velocity, whole.velocity[:, [6, 1, 8]])
    assert some.error_estimate == whole.error_estimate


@pytest.mark.parametrize("grains", ["all", [3, 1]])
def test_a_shaken_base_moves_springs_from_below(grains):
    masses = np.array([1.0, 2.0, 3.0]) * 1e-6
    pressed = {"gravity": 0.0, "top_load": 1.0, "bottom": "wall"}
    chain = Chain(grains=3, diameter=1e-3, exponent=1.0, masses=masses, **pressed)
    edge = chain.band_edge
    drive = Drive(end="bottom", amplitude=1e-9, frequency=0.3 * edge / 2 / np.pi)
    scene = scene_of(chain, drive, 20 / edge, 21, grains=grains)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        u, v = state.reshape(2, -1)
        base = 1e-9 * np.sin(0.3 * edge * t)
        force = chain.contacts.stiffness[1:] * -np.diff(np.append(u, base))
        return np.concatenate((v, -np.diff(force, prepend=0.0) / masses))

    start, span = np.zeros(6), (0, scene.duration)
    true = solve_ivp(rates, span, start, "DOP853", scene.time, rtol=1e-12, atol=1e-22).y
    answer = simulate(scene, "native", 1e-9)
    motion = np.concatenate((answer.displacement.T, answer.velocity.T))
    rows = np.concatenate([scene.recorded - 1, scene.recorded + 2])
    for one, other in zip(motion, true[rows], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-8 * np.abs(other).max())


def test_interpolated_samples_are_as_accurate_as_others():
    """Few of a thousand samples of a smooth motion are at the end of a step."""
    scene = smooth(samples=1001)
    candidate = Native("rkn6").propose(scene, 1e-6)
    assert candidate.steps.stride > 1
    assert candidate.steps.total(1000) < 500
    t = simulate(scene, Native("rkn6"), 1e-6)
    assert t.cost.steps < 500
    u, v, own = extended_reference(scene)
    error = distance(t, (u, v))
    assert own < error / 10
    assert error / 3 < t.error_estimate.total <= 1e-6
    assert Native("rkn6", adaptive=False).propose(scene, 1e-6).steps.stride == 1
    vacuum = scene_of(CHAIN.replace(gravity=0.0), Impulse(velocity=1e-2), scene.duration, 1001)
    assert Native("rkn6").propose(vacuum, 1e-6).steps.stride == 1


def test_scenes_of_a_batch_are_of_one_kind():
    """Scenes of a batch may differ in numbers, but not in the computed or recorded quantities."""
    engine = Native()
    candidate = engine.propose(SCENE, 1e-6)
    for excitation in (
        Impulse(velocity=2e-3),
        Impulse(velocity=1e-3, grain=4),
        Displacement(displacement=1e-9),
    ):
        assert kind(SCENE.replace(excitation=excitation)) == kind(SCENE)
    for change in ({"gravity": 5.0}, {"top_load": 1.0}, {"gravity": 0.0, "top_load": 1.0}):
        assert kind(SCENE.replace(chain=CHAIN.replace(**change))) == kind(SCENE)
    unlike_ones = [
        *(SCENE.replace(excitation=each(amplitude=1e-9, frequency=1e4)) for each in (Drive, Force)),
        *(
            SCENE.replace(chain=CHAIN.replace(**change))
            for change in (
                {"grains": 11},
                {"exponent": 2.0},
                {"bottom": "wall"},
                {"top": "wall"},
                {"gravity": 0.0},
                {"gravity": 0.0, "top_load": 1.0, "load_grain": 3},
                {"damping": {"drag": 1.0}},
                {"ground": Law("s*u", s=1.0)},
            )
        ),
        *(
            SCENE.replace(**each)
            for each in ({"samples": 22}, {"duration": 4.1e-5}, {"grains": [1]})
        ),
    ]
    assert len({kind(other) for other in (SCENE, *unlike_ones)}) == 1 + len(unlike_ones)
    for other in unlike_ones:
        with pytest.raises(ValueError, match="a batch needs chains of the same kind and length"):
            engine.start([SCENE, other], candidate)
    key = engine.batch_key(SCENE, candidate)
    steps = candidate.steps
    for changed in (
        {"steps": steps._replace(per_landing=3)},
        {"steps": steps._replace(stride=2)},
        {"steps": steps._replace(step=1e-8)},
        {"steps": steps._replace(adaptive=not steps.adaptive)},
        {"steps": steps._replace(coarse_openings=not steps.coarse_openings)},
        {"integrator": "verlet"},
        {"choices": {"force": "plain"}},
    ):
        assert engine.batch_key(SCENE, candidate._replace(**changed)) != key


def test_progress_in_lammps_grows_between_samples(monkeypatch):
    """The progress is above 0 before the first sample is done, and 1 at the end."""
    monkeypatch.setattr(stepping_run, "PIECE_S", 1e-4)
    engine = Lammps("verlet", step=1e-8)
    scene = SCENE.replace(samples=2)
    run = engine.start([scene], engine.propose(scene, 1e-6))
    assert run.proposal.steps.total(1) == 4000
    assert run.progress == 0
    progress = [run.progress for _ in run.blocks()]
    assert 0 < progress[0] < progress[1] < progress[2] < 1
    assert progress[-1] == 1
    run.close()


def test_a_batch_has_the_results_and_errors_of_its_scenes(small_blocks):
    """Weak and strong scenes have the steps of the strong ones."""
    velocities = (1e-3, 1e-5, 8e-4)
    scenes = [SCENE.replace(excitation=Impulse(velocity=v)) for v in velocities]
    engine = Native(step=2e-8)
    run = engine.start(scenes, engine.propose(SCENE, 1e-6))
    together = blocks_of(run)[1]
    for scene, velocity, error in zip(scenes, together, run.errors(), strict=True):
        alone = simulate(scene, engine)
        assert np.array_equal(velocity, alone.velocity)
        assert error.solver == pytest.approx(alone.error_estimate.solver, rel=1e-9)
    np.testing.assert_allclose(run.monitor.peaks[:, 1], velocities, rtol=0.05, atol=0)


def test_longer_runs_are_expected_to_cost_more():
    """The cost is proportional to steps and active grains, plus the start-up."""
    engine = Native("rkn6")
    scene = paper("weak", 3)
    costs = [engine.cost(scene, METHODS["rkn6"], n) - engine.start_up_s for n in (1000, 2000, 4000)]
    assert costs == pytest.approx([costs[0] * n for n in (1, 2, 4)], rel=1e-9)
    brief, short, late, long = (
        engine.count_active(scene.replace(duration=t)) for t in (1e-9, 5e-7, 1e-6, 1e-2)
    )
    assert long == 120
    assert late - short == pytest.approx(scene.highest_frequency * 5e-7 / 4, rel=1e-9)
    first, last = scene.excitation.reach(scene.chain)
    assert brief > last - first + 1
    assert Lammps().count_active(scene) == 120


class Slow(Native):
    """An engine that is thought to be slow, so that its runs are judged."""

    seconds_per_grain_step = 1e-5


@pytest.mark.parametrize("size", [1, 2])
def test_a_run_is_judged_at_times_of_its_expected_work(size: int) -> None:
    """The samples follow from evaluations, grains and scenes, and all runs land on them."""
    engine = Slow("rkn6", step=2e-8)
    proposal = engine.propose(SCENE, 1e-6)
    seconds = 1e-5 * proposal.steps.total(20) * METHODS["rkn6"].evaluations * 10 * size
    expected = place_looks(seconds, 20, 4)
    assert len(expected) > 2
    run = engine.start([SCENE] * size, proposal)
    judged: list[int] = []
    run.judge = lambda run: judged.append(int(run.state()["sample"]))
    velocity = blocks_of(run)[1]
    assert judged == sorted(expected)
    # Fast runs are not judged, with the same bits.
    quick = Native("rkn6", step=2e-8)
    run = quick.start([SCENE] * size, quick.propose(SCENE, 1e-6))
    run.judge = lambda run: judged.append(-1)
    assert np.array_equal(blocks_of(run)[1], velocity)
    assert -1 not in judged
    # A scene that may be unpredictable is judged as soon as possible, too.
    scene = struck(random_column(6, 2, 0.3, top="wall"), 0.1, 2e-3, 21)
    run = quick.start([scene], quick.propose(scene, 1e-6))
    run.judge = lambda run: judged.append(-int(run.state()["sample"]))
    blocks_of(run)
    assert judged[len(expected) :] == [-4]


def test_blocks_fit_into_memory_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e6)
    engine = Native("rkn6", step=1e-7)
    proposal = engine.propose(SCENE, 1e-6)
    run = engine.start([SCENE, SCENE], proposal)
    assert [block.samples for block in run.blocks()] == [slice(0, 21)]
    assert run.monitor.runs == 2
    # Displacement and velocity of all runs at ten samples.
    for size, stops in ((10, [9, 17, 21]), (7.9, [5, 9, 13, 17, 21]), (21, [21]), (0, [5, 9])):
        monkeypatch.setattr(stepping_run, "BLOCK_BYTES", int(size * 16 * 3 * 2 * 10))
        run = engine.start([SCENE, SCENE], proposal)
        found = [block.samples.stop for block in run.blocks() if block.samples.stop > 0]
        assert found[: len(stops)] == stops
    monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 2**25)
    # The first block has the expected time, and later ones that of the block before.
    slow = proposal._replace(cost_s=21 * 1e6 / 2 / 8.5)
    run = engine.start([SCENE, SCENE], slow)
    assert [block.samples.stop for block in run.blocks()] == [9, 21]


def test_long_pieces_of_work_can_be_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call of a compiled loop makes a single step; the bits and the errors are the same."""
    engine = Native("rkn6", step=1e-7)
    proposal = engine.propose(SCENE, 1e-6)
    whole = engine.start([SCENE], proposal)
    velocity = blocks_of(whole)[1]
    monkeypatch.setattr(stepping_run, "PIECE_S", 0.0)
    run = engine.start([SCENE], proposal)
    parts, progress = zip(*((block.velocity, run.progress) for block in run.blocks()), strict=True)
    assert len(parts) > 20
    assert {part.shape[2] for part in parts} == {10}
    assert (np.diff(progress) > -1e-12).all()
    assert 0 <= progress[0] < 0.1
    assert np.array_equal(np.concatenate(parts, axis=1), velocity)
    assert run.errors()[0].solver == whole.errors()[0].solver
    cost = run.cost()
    # Of the steps with h, 2h and 4h, four sevenths belong to the answer.
    assert 0 < cost.integration_s <= 4 / 7 * (cost.integration_s + cost.estimate_s) * (1 + 1e-9)
    # A run that continues has the progress of the stored one.
    assert engine.start([SCENE], proposal, whole.state()).progress == 1.0


def test_the_expected_rounding_error_of_a_run() -> None:
    """It includes the loss of the plain force, relative to the largest speed."""
    scene = smooth(samples=5)
    walk = np.sqrt(1000 * METHODS["rkn6"].evaluations)
    weight = 1e-3 / scene.chain.masses.min()
    plain = 0.9 * weight * scene.duration / np.sqrt(1000) / 1e-4
    for force, lost in (("plain", plain), ("exact", 0.0)):
        expected = EPSILON * (2 + walk + 1.5 / 4 * scene.total_phase + lost)
        found = Native("rkn6", force=force).typical_round_off(scene, 1000, 1e-4)
        assert found == pytest.approx(expected, rel=1e-9)


def test_methods_of_damped_and_other_chains() -> None:
    damped = SCENE.replace(chain=CHAIN.replace(damping={"drag": 1e3}))
    assert [method.name for method in Native().methods(damped)] == ["dop853"]
    for scene, name, words in (
        (damped, "rkn4", "a method for chains without damping: use dop853 or"),
        (SCENE, "lagged-verlet", "a method for chains with damping: use kahan-li8 or"),
    ):
        engine = Native(name)
        ((key, fault),) = engine.refuses(scene)
        assert key == "integrator"
        assert words in fault
        with pytest.raises(InputError, match=words):
            engine.methods(scene)
    with pytest.raises(InputError, match="integrator: must be"):
        Native("euler")
