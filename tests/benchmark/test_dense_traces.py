"""Scenes whose force is sampled much more densely than the motion of the chain requires."""

from pathlib import Path

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from scipy.interpolate import CubicHermiteSpline

from lmpchain import Chain, Drive, Force, Impulse, Scene, engines, simulate
from lmpchain.benchmark import truth
from lmpchain.benchmark.reference import expected_seconds
from lmpchain.cli import main
from lmpchain.design import Traces
from lmpchain.design.unknowns import Problem
from lmpchain.measure import front
from lmpchain.report.verdicts import front_below
from lmpchain.trajectory.between.derivatives import imposed_on

RATE = 25e6
CHAIN = Chain(grains=12, diameter=5e-3, gravity=0.0, top_load=5.0, bottom="wall")
LENGTH = 40e-6


def hammer(noise: float = 1e-3, duration: float = 2e-4) -> Force:
    """Return the half-sine of a hammer, 3 N in 40 us, sampled at 25 MS/s with noise."""
    times = np.arange(int(duration * RATE) + 1) / RATE
    push = np.where(times < LENGTH, 3.0 * np.sin(np.pi * times / LENGTH), 0.0)
    noises = noise * np.random.default_rng(5).normal(size=times.size)
    return Force(grain=1, times=times, force=push + noises)


def test_steps_and_samples_follow_the_motion_and_not_the_points():
    """Steps depend on the chain for a push by formula, and on the spectrum for a sampled one."""
    formula = Force(grain=1, shape="half-sine", amplitude=3.0, duration=LENGTH)
    exact = scene_of(CHAIN, formula, 2e-4, 401)
    dense = scene_of(CHAIN, hammer(), 2e-4, 401)
    assert exact.highest_frequency <= dense.highest_frequency < 0.1 * RATE
    run = simulate(dense, "native")
    truth = simulate(exact, "native", 1e-9)
    # The noise changes the motion by less than its own amplitude.
    assert np.abs(run.velocity - truth.velocity).max() < 1e-3 * np.abs(truth.velocity).max()
    track, true_track = front.track(run), front.track(truth)
    assert track.grain.tolist() == true_track.grain.tolist()
    np.testing.assert_allclose(track.time[1:], true_track.time[1:], rtol=2e-3)
    assert front_below(run).grain[0] == 2
    traces = Traces(run.time, [6], run.velocity[:, 5])
    assert Problem(dense, [traces], {"masses": "common"}).looks < 2000
    # A native run with few equal steps has the estimated error.
    fixed = simulate(dense, engines.Native(integrator="rkn6", step=5e-7))
    error = np.abs(fixed.velocity - run.velocity).max() / np.abs(run.velocity).max()
    assert error < 2 * fixed.error_estimate.total + 1e-6


@pytest.mark.parametrize("driven", [False, True])
def test_noise_between_samples_is_in_the_doubt_of_what_is_imposed(driven: bool):
    """Between samples, the acceleration is a cubic that misses the noise of 50 points."""
    force = hammer(noise=0.02)
    excitation: Force | Drive = force
    if driven:
        path = np.cumsum(np.cumsum(force.force)) / 2e13
        excitation = Drive(times=force.times, displacement=path - path[0])
    scene = Scene(chain=CHAIN, excitation=excitation, duration=2e-4, samples=101)
    imposed = imposed_on(scene, 2e-6, 0, 101)
    fine = np.linspace(0, 2e-4, 20_001)
    order, share = (2, 1.0) if driven else (0, 1 / CHAIN.masses[0])
    cubic = CubicHermiteSpline(scene.time, *imposed.acceleration)
    off = np.abs(share * excitation.waveform.at(fine, order) - cubic(fine))
    off = off[:-1].reshape(100, 200).max(axis=1)
    # The last interval ends in an additional kink.
    assert (off[:-1] <= 1.1 * imposed.doubt[:-2]).all()
    assert off.max() > 1e-3 * np.abs(imposed.acceleration[0]).max()


def test_a_reference_is_expected_to_take_a_step_for_each_point():
    assert expected_seconds(scene_of(CHAIN, hammer(), 2e-4, 401)) > 50 * expected_seconds(
        scene_of(
            CHAIN, Force(grain=1, shape="half-sine", amplitude=3.0, duration=LENGTH), 2e-4, 401
        )
    )


@pytest.mark.parametrize("driven", [False, True])
def test_a_comparison_says_what_it_leaves_out(driven: bool, monkeypatch: pytest.MonkeyPatch):
    """The reported change is the difference between two runs of another integrator."""
    monkeypatch.setattr(truth, "MOST_POINTS", 100)
    force = hammer()
    path = np.cumsum(np.cumsum(force.force)) / 2e13
    excitation = Drive(times=force.times, displacement=path - path[0]) if driven else force
    chain = Chain(grains=2, diameter=5e-3, gravity=0.0, top_load=5.0, bottom="wall")
    scene = Scene(chain=chain, excitation=excitation, duration=1e-4, samples=51)
    thinner, words = truth.thin_trace(scene, 1e-8)
    kept = int((thinner.excitation.times < 1e-4).sum()) + 1
    assert words.startswith(f"trace: {kept} of the 2501 points of this run are used (every=26, ")
    assert kept < 100
    whole, part = (
        simulate(each, engines.Native(integrator="verlet", step=2e-9)) for each in (scene, thinner)
    )
    changes = [
        np.abs(a - b).max() / np.abs(a).max()
        for a, b in ((whole.displacement, part.displacement), (whole.velocity, part.velocity))
    ]
    assert f"changes the answer by {max(changes):.1e}"[:-5] in words
    assert truth.thin_trace(thinner, 1e-8) == (thinner, "")
    struck = scene.replace(excitation=Impulse(velocity=1e-3))
    assert truth.thin_trace(struck, 1e-8) == (struck, "")
    # The filter needs equal distances between points; the tolerance is out of reach.
    times = force.times.copy()
    times[1] *= 1.1
    uneven = scene.replace(excitation=excitation.replace(times=times))
    fewer, words = truth.thin_trace(uneven, 1e-17)
    assert "are used (every=26), because" in words
    assert "the effect on the answer is unknown (" in words
    np.testing.assert_array_equal(fewer.excitation.times, times[::26])
    values = getattr(fewer.excitation, fewer.excitation.strength[1])
    np.testing.assert_array_equal(
        values, (excitation.displacement if driven else force.force)[::26]
    )


@pytest.mark.slow
def test_compare_ends_soon_for_a_hammer_trace_of_25_megasamples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(truth, "MOST_POINTS", 100)
    force = hammer()
    np.savez(tmp_path / "hammer.npz", time=force.times, force=force.force)
    (tmp_path / "scene.toml").write_text(
        '[chain]\ngrains = 6\ndiameter = 5e-3\ngravity = 0.0\ntop_load = 5.0\nbottom = "wall"\n'
        '[excitation]\nkind = "force"\nfile = "hammer.npz"\n'
        "[recording]\nduration = 1e-4\nsamples = 51\n"
    )
    assert main(["compare", str(tmp_path / "scene.toml"), "--engines", "lammps,native"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "trace: 98 of the 2501 points of this run are used (every=26, lowpass=2.4e+05)" in out
