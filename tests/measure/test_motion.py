"""Motion between samples: peaks and their errors against exact and densely sampled motion."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck

from lmpchain import Chain, Drive, Impulse, InputError, Scene, engines, simulate
from lmpchain.measure.front import track
from lmpchain.measure.motion import Motion, motion_of, peaks

CALIBRATION = Path(__file__).parents[2] / "analysis" / "calibration"


@pytest.fixture(scope="module")
def dense():
    return simulate(paper("fig5 g", 6401), "native", 1e-10)


@pytest.mark.parametrize("samples", [11, 21, 41, 81])
def test_sparse_samples_state_their_error(dense, samples):
    sparse = simulate(paper("fig5 g", samples), "native", 1e-10)
    for field in ("velocity", "displacement"):
        sampled = np.abs(getattr(dense, field)).max(0)
        seen = peaks(sparse, field)
        assert (np.abs(seen.value - sampled) <= seen.error + 2e-6 * sampled.max()).all(), (
            "what hides between these"
        )
        true = peaks(dense, field).value
        assert (np.abs(seen.value - true) <= seen.error + 1e-9 * true.max()).all()
        if samples > 40:
            assert np.abs(seen.value - true).max() < 1e-6 * true.max()
            assert seen.error.max() < 1e-3 * true.max()
    if samples > 20:
        true = track(dense)
        seen = track(sparse)
        assert seen.grain.tolist() == true.grain.tolist()
        for name in ("time", "amplitude", "width"):
            off = np.abs(getattr(seen, name) - getattr(true, name))
            error = getattr(seen, f"{name}_error") + getattr(true, f"{name}_error")
            known = np.isfinite(true.width) if name == "width" else np.ones(off.size, dtype=bool)
            assert (off <= error)[known].all(), "none is lost: with NaN this fails"


@pytest.mark.parametrize("samples", [7, 10, 13])
def test_two_grains_against_the_exact_oscillation(samples: int):
    """One spring between fixed ends moves as phi = (v/omega) sin(omega t).

    Its frequency is known to be at most 2^(1/2) omega. From 4.5 samples in a period on, no motion
    hides between two of them, and a peak is found wherever it is. Of three in a period none is near
    the largest displacement: the value is 13.4 % low, for it is that of the largest sample, and its
    error says that more than that may hide.
    """
    chain = Chain(grains=2, diameter=1e-3, exponent=1.0, top_load=1.0, gravity=0.0)
    omega = float(np.sqrt(chain.linear_stiffness[0] / chain.masses[0]))
    scene = scene_of(chain, Impulse(velocity=1e-6), 4 * np.pi / omega, samples)
    between = motion_of(simulate(scene, "native", 1e-12))
    sampled = np.sin(omega * scene.time)
    largest = {"displacement": np.abs(sampled).max(), "velocity": 1.0}
    for field, size in (("displacement", 1e-6 / omega), ("velocity", 1e-6)):
        value, error = between.peaks(field)[1:]
        assert abs(value[0] - size) <= error[0]
        assert value[1] == 0
        if samples > 7:
            assert value[0] == pytest.approx(size, rel=1e-6)
            assert error[0] < 7e-4 * size
        else:
            assert value[0] == pytest.approx(largest[field] * size, rel=1e-9)
            assert error[0] > 0.3 * size


@pytest.mark.parametrize("equation", [1, 0])
def test_order_of_the_interpolation(dense, equation):
    """The interpolation error of the velocity is of sixth or fourth order in the interval."""
    every = np.array([200, 100, 50]) if equation else np.array([100, 50, 25])
    off = []
    true = peaks(dense).value
    for step in every:
        scene = paper("fig5 g", 6400 // step + 1)
        thin = Motion(
            scene, equation, dense.grains, dense.displacement[::step], dense.velocity[::step], 0.0
        )
        off.append(np.abs(thin.peaks("velocity").value - true)[1:15].max())
    power = 6 if equation else 4
    assert off[0] > 2**power * off[1] > 4**power * off[2] > 0


def test_motion_hidden_between_two_samples_is_bounded():
    """A pulse of the sonic vacuum passes between samples: the error is the bound by energy."""
    chain = Chain(grains=60, diameter=1e-3, gravity=0.0, bottom="free")
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1), duration=4e-4, samples=3)
    sparse = peaks(simulate(scene, "native", 1e-8))
    true = peaks(simulate(Scene(**scene.given() | {"samples": 801}), "native", 1e-8))
    assert (np.abs(sparse.value - true.value) <= sparse.error + true.error).all()
    assert (sparse.value + sparse.error <= 0.1 * (1 + 1e-6) * 1.5).all()


@pytest.mark.parametrize("samples", [41, 5])
def test_grains_at_rest_do_not_change_peaks(samples):
    """Peaks and fronts of the first grains do not depend on the number of grains at rest below."""
    found = []
    for grains in (200, 2000):
        chain = Chain(grains=grains, diameter=1e-3, gravity=0.0, top_load=0.1)
        scene = scene_of(chain, Impulse(velocity=1e-2, grain=9), 2e-5, samples)
        between = motion_of(simulate(scene, engines.Native(step=1e-8)))
        known = [between.known_error(field) for field in ("velocity", "displacement")]
        values = [
            *(between.peaks(field)[1:] for field in ("velocity", "displacement")),
            between.fronts("velocity", 0.5).T,
        ]
        found.append((known, [np.array(each)[:, :60] for each in values]))
        assert (between.peaks("velocity").value[100:] == 0).all()
    assert found[0][0] == pytest.approx(found[1][0], rel=0.1)
    for one, other in zip(found[0][1], found[1][1], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=10 * max(found[0][0]))


def test_recorded_grains_alone():
    """Accelerations follow from the samples if a neighbour was not recorded, else from forces."""
    whole = simulate(paper("fig5 g", 401), "native", 1e-9)
    few = simulate(paper("fig5 g", 401).replace(grains=[3, 8, 9, 10]), "native", 1e-9)
    one = peaks(whole)
    other = peaks(few)
    assert other.grain.tolist() == [3, 8, 9, 10]
    assert (np.abs(other.value - one.value[[2, 7, 8, 9]]) <= other.error).all()
    assert (other.error < 1e-3 * other.value).all()
    less = other.error / one.error[[2, 7, 8, 9]]
    assert less[2] == pytest.approx(1, rel=0.02)
    assert (less[[0, 1, 3]] > 10).all()


def test_unknown_errors_leave_the_sampling_errors():
    t = simulate(paper("fig5 g", 201), "native", 1e-6)
    unknown = replace(t, error_estimate=replace(t.error_estimate, solver=np.inf))
    one = peaks(t)
    other = peaks(unknown)
    assert np.isfinite(other.error).all()
    assert one.value[:15] == pytest.approx(other.value[:15], rel=1e-6)
    with pytest.raises(InputError, match="field"):
        peaks(t, "energy")


def worst(count: int, seed: int, equation: int, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return the largest ratio of true to claimed error in each of these random scenes."""
    monkeypatch.syspath_prepend(str(CALIBRATION))
    from between_samples import ratios, trials

    return np.array([max(ratios(*pair, equation).values()) for pair in trials(count, seed)])


@pytest.mark.parametrize("equation", [1, 0])
def test_random_scenes(equation, monkeypatch):
    assert (worst(5, 11, equation, monkeypatch) < 1).all()


@pytest.mark.soak
@pytest.mark.parametrize("equation", [1, 0])
def test_random_scenes_soak(equation, monkeypatch):
    found = worst(400, 12, equation, monkeypatch)
    assert (found > 1).mean() < 0.01
    assert found.max() < 3
    assert "between_samples" in sys.modules


def test_a_driven_grain_with_few_samples():
    """The drive gives the acceleration of the grain; contacts give all other accelerations."""
    drive = Drive(amplitude=1e-9, frequency=20e3)
    scene = scene_of(Chain(grains=12, diameter=1e-3), drive, 1e-4, 11)
    samples = int(scene.highest_frequency * scene.duration / 1.5) + 2
    seen = peaks(simulate(scene.replace(samples=samples), "native", 1e-9))
    speed = 2 * np.pi * 20e3 * 1e-9
    assert abs(seen.value[0] - speed) <= seen.error[0] < 1e-2 * speed
    assert np.isfinite(seen.error[1:]).all()


def test_a_front_that_rises_after_a_sample_near_an_opening():
    """The largest sample is before the maximum, and the interval before it has a smaller error."""
    sizes = (8.8256e-3, 7.3948e-3, 12.8546e-3, 11.8211e-3, 9.6739e-3)
    walls = {"top": "wall", "bottom": "wall"}
    chain = Chain(grains=5, material="ptfe", diameter=sizes, gravity=12.0993, **walls)
    strike = Impulse(grain=4, velocity=14.5657)
    scene = Scene(chain=chain, excitation=strike, duration=1.55346e-3, samples=152)
    few = motion_of(simulate(scene, "native", 1e-9)).fronts("velocity", 0.5)[2]
    many = motion_of(simulate(scene.replace(samples=1209), "native", 1e-9))
    arrival, height, _ = many.fronts("velocity", 0.5)[2, :3]
    assert abs(few[0] - arrival) <= few[3] < 3e-5
    assert abs(few[1] - height) <= few[4] < 0.05


def test_maxima_of_a_field_follow_the_fraction():
    """Fronts are below the peaks, and another fraction needs other maxima."""
    scene = struck(column(20), 1e-3, 3e-5, 61)
    motion = motion_of(simulate(scene, "native"))
    top = motion.peaks("velocity")
    first = motion.fronts("velocity", 0.5)
    heights = np.abs(first[:, 1])
    passed = np.isfinite(heights)
    assert passed.sum() > 3
    assert (heights[passed] <= top.value[passed] * (1 + 1e-12)).all()
    other = motion_of(simulate(scene, "native")).fronts("velocity", 0.3)
    np.testing.assert_array_equal(motion.fronts("velocity", 0.3), other)
