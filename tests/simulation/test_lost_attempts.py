"""Hopeless attempts end early, and unpredictable runs end at their predictability horizon."""

import numpy as np
import pytest
from helpers import taylor_series
from helpers.example_scenes import stirred

import lmpchain
from lmpchain import Chain, Drive, Impulse, Scene, Stopped, ToleranceNotMet, resume, simulate
from lmpchain.engines import Native
from lmpchain.engines.step_control import PATIENCE
from lmpchain.engines.stepping import monitor
from lmpchain.engines.stepping.monitor import JudgingTimes


def agitated(grains: int = 60, duration: float = 1e-3) -> Scene:
    """Return flying grains that all move."""
    chain = Chain(grains=grains, diameter=1e-3)
    start = stirred(chain, 1e-3, seed=3)
    return Scene(chain=chain, excitation=start, duration=duration, samples=101)


def springs(duration: float) -> Scene:
    """Return nearly linear contacts that open, a motion that soon becomes unpredictable."""
    chain = Chain(grains=12, diameter=1e-3, exponent=1.05)
    strike = Impulse(velocity=0.05)
    samples = round(duration / 2e-5) + 1
    return Scene(chain=chain, excitation=strike, duration=duration, samples=samples)


@pytest.fixture
def early(monkeypatch):
    """Judge short runs as well."""
    monkeypatch.setattr(monitor, "JUDGING", JudgingTimes(begin_s=1e-5))


@pytest.fixture
def runs(monkeypatch):
    """Record the native runs."""
    runs = []
    honest = Native.start
    monkeypatch.setattr(Native, "start", lambda *given: runs.append(honest(*given)) or runs[-1])
    return runs


def early_ends(runs):
    """Return the fraction and the error of every run that ended early."""
    return [(run.progress, run.errors()[0].solver) for run in runs if run.progress < 1]


def test_a_hopeless_attempt_ends_early_and_sets_the_next_step(early, runs):
    """An attempt ends early because its estimate already exceeds the tolerance."""
    scene = agitated(12, 4e-4)
    answer = simulate(scene, "native", 1e-8)
    assert answer.error_estimate.solver <= 1e-8
    runs.clear()
    again = simulate(scene, "native", 1e-8)
    assert np.array_equal(again.velocity, answer.velocity)
    assert min(error for _, error in early_ends(runs)) > PATIENCE.lost * 1e-8


def test_unpredictable_scenes_are_stopped_early(runs):
    """Runs one ulp apart show the growth before the error is large."""
    for scene in (springs(1e-2), agitated(12, 2e-3)):
        with pytest.raises(ToleranceNotMet, match="amplifies round-off") as missed:
            simulate(scene, "native", 1e-6)
        done, error = early_ends(runs)[0]
        assert done < 0.05
        assert error < 1e-6
        runs.clear()
        kept = missed.value.trajectory
        assert kept.error_estimate.solver <= 1e-6
        truth, doubt = taylor_series.reference(kept.scene, 1e-17)
        assert truth.error(kept.displacement, kept.velocity) + doubt <= kept.error_estimate.solver


def test_a_horizon_that_needs_ever_shorter_steps_is_halved(tmp_path):
    """Errors grow like rounding: twice the duration squares them."""
    chain = Chain(grains=12, diameter=1e-3, bottom="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=0.02, samples=501)
    with pytest.raises(ToleranceNotMet, match="amplifies round-off") as missed:
        simulate(scene, "native", 1e-2)
    said = float(missed.value.reason.split("at t = ")[1].split()[0])
    assert missed.value.known_until == pytest.approx(said / 2, rel=1e-3, abs=0)
    kept = missed.value.trajectory
    assert kept.scene == scene.until(missed.value.known_until)
    truth, doubt = taylor_series.reference(kept.scene, 1e-12)
    assert truth.error(kept.displacement, kept.velocity) + doubt <= kept.error_estimate.solver
    assert kept.error_estimate.solver <= 1e-2
    with pytest.raises(ToleranceNotMet) as new:
        simulate(scene, "native", 1e-2, folder=tmp_path / "run")
    with pytest.raises(ToleranceNotMet) as again:
        resume(tmp_path / "run")
    for error in (new.value, again.value):
        assert (error.reason, error.known_until) == (missed.value.reason, missed.value.known_until)
    disk = lmpchain.Trajectory.load(tmp_path / "run")
    assert np.array_equal(disk.velocity[:], kept.velocity)


@pytest.mark.slow
def test_an_interrupted_folder_ends_with_the_same_bits(early, tmp_path):
    """Stops are in any attempt, also in a run that ends at its predictability horizon."""
    for name, scene in {"agitated": agitated(12, 4e-4), "springs": springs(4e-3)}.items():
        folder = tmp_path / name
        answers = []
        for options in ({}, {"folder": folder, "max_wall": 1e-9}):
            try:
                answers.append(simulate(scene, "native", 1e-7, **options))
            except ToleranceNotMet as missed:
                answers.append(missed.trajectory)
            except Stopped:
                for _ in range(300):
                    try:
                        answers.append(resume(folder, max_wall=0.02))
                    except Stopped:
                        continue
                    except ToleranceNotMet as missed:
                        answers.append(missed.trajectory)
                    break
        memory, disk = answers
        assert np.array_equal(memory.time, disk.time)
        assert np.array_equal(memory.velocity, disk.velocity[:])
        assert memory.error_estimate == disk.error_estimate


def test_unpredictable_scenes_end_at_their_horizon(early, tmp_path):
    """The stored part is right, and equals the result of the scene up to this time."""
    scene = springs(4e-3)
    with pytest.raises(ToleranceNotMet, match="amplifies round-off, which may exceed") as missed:
        simulate(scene, "native", 1e-6)
    kept = missed.value.trajectory
    assert 0 < kept.time[-1] < missed.value.known_until < scene.duration
    assert missed.value.known_until <= kept.time[-1] + 1.001 * scene.time[1]
    assert kept.error_estimate.solver <= 1e-6
    truth, doubt = taylor_series.reference(kept.scene, 1e-12)
    assert truth.error(kept.displacement, kept.velocity) + doubt <= kept.error_estimate.solver
    again = simulate(kept.scene, "native", 1e-6)
    assert np.array_equal(again.velocity, kept.velocity)
    with pytest.raises(ToleranceNotMet):
        simulate(scene, "native", 1e-6, folder=tmp_path / "run")
    assert lmpchain.simulation.run_folder.status(tmp_path / "run")["state"] == "finished"
    disk = lmpchain.Trajectory.load(tmp_path / "run")
    assert np.array_equal(disk.velocity[:], kept.velocity)
    assert disk.scene == kept.scene


def test_the_best_possible_result_is_complete(early):
    scene = springs(1e-3)
    with pytest.warns(UserWarning, match="amplifies round-off"):
        answer = simulate(scene, "native", 1e-6, on_miss="warn")
    assert answer.time[-1] == scene.duration
    with pytest.raises(ToleranceNotMet) as missed:
        simulate(scene, "native", 1e-6)
    kept = missed.value.trajectory
    assert answer.cost.step_s < kept.cost.step_s
    # The result is equally accurate up to the predictability horizon.
    apart = answer.velocity[: kept.time.size] - kept.velocity
    assert np.abs(apart).max() <= 2e-6 * np.abs(kept.velocity).max()


@pytest.mark.slow
def test_rounding_of_lammps_is_judged_at_the_end(early):
    """Rounding of heights is large at first, when a slow drive has moved little."""
    times = np.linspace(0.0, 4e-4, 401)
    shake = 1e-7 * np.sin(np.pi / 2 * times / times[-1]) ** 8
    chain = Chain(grains=8, diameter=1e-3, gravity=0.0, top_load=1.0)
    drive = Drive(times=times, displacement=shake)
    scene = Scene(chain=chain, excitation=drive, duration=4e-4, samples=401)
    answer = simulate(scene, "lammps", 1e-6)
    truth, doubt = taylor_series.reference(scene, 1e-16)
    error = truth.error(answer.displacement, answer.velocity)
    assert doubt < error / 10
    assert error <= answer.error_estimate.solver <= 1e-6
