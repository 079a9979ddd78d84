"""A list of scenes in one call: results, order, errors and refusals."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, smooth, struck
from helpers.independent_integrators import distance, extended_reference

from lmpchain import Drive, Impulse, InputError, Scene, ToleranceNotMet, simulate, simulate_many
from lmpchain.engines import Native


def short(velocity: float, **chain: Any) -> Scene:
    return struck(column(**{"grains": 12} | chain), velocity, 2e-5, 11)


def test_results_are_in_order_with_the_bits_of_single_runs():
    """The scenes have several shapes and strengths, in random order.

    Those that are alike go together, and each is itself.
    """
    scenes = [short(v, grains=n) for v in (1e-6, 1e-4, 1e-2) for n in (12, 9, 12)] + [
        short(1e-4, gravity=1.62)
    ]
    found = simulate_many(scenes, 1e-8)
    assert [t.scene for t in found] == scenes
    for t, scene in zip(found, scenes, strict=True):
        alone = simulate(scene, "native", 1e-8)
        assert np.array_equal(t.displacement, alone.displacement)
        assert np.array_equal(t.velocity, alone.velocity)
        assert np.array_equal(t.time, alone.time)
        assert np.array_equal(t.grains, alone.grains)
        assert t.provenance == alone.provenance
        assert (t.cost.integrator, t.cost.step_s) == (alone.cost.integrator, alone.cost.step_s)
        assert t.error_estimate.total <= 1e-8


def test_a_sine_beside_sampled_drives_is_computed_as_alone():
    """DOP853 has longer steps without knots.

    Those of a scene, not those of another in its batch.
    """
    chain = column(6, top_load=0.1)
    duration = 30 / chain.band_edge
    height = 0.1 * chain.length_scale
    times = np.linspace(0, 1.01 * duration, 5)
    points = Drive(times=times, displacement=height * np.sin(times * chain.band_edge / 5))
    drives = points, Drive(amplitude=height, frequency=points.fastest / (20 * np.pi))
    scenes = [scene_of(chain, drive, duration, 3) for drive in drives]
    engine = Native("dop853")
    candidates = [engine.propose(scene, 1e-6).steps for scene in scenes]
    assert candidates[0] == candidates[1]
    for t, scene in zip(simulate_many(scenes, 1e-6, engine), scenes, strict=True):
        assert np.array_equal(t.velocity, simulate(scene, engine, 1e-6).velocity)


def test_the_estimate_covers_the_error():
    """The run agrees with SciPy's DOP853 on another form of the equation of motion.

    Chains that open contacts and chains that do not.
    """
    scenes = [
        smooth(grains=6, samples=6).replace(excitation=Impulse(velocity=v))
        for v in (1e-6, 1e-3, 1e-2)
    ]
    for t in simulate_many(scenes, 1e-7):
        u, v, _ = extended_reference(t.scene)
        error = distance((np.asarray(t.displacement), np.asarray(t.velocity)), (u, v))
        assert error <= t.error_estimate.total + 1e-10
        assert t.error_estimate.total <= 1e-7


def test_other_engines_and_given_steps():
    scenes = [short(1e-8), short(1e-7)]
    for options in ({"engine": "modes"}, {"engine": "auto"}, {"engine": Native(step=1e-7)}):
        for t, scene in zip(simulate_many(scenes, 1e-2, **options), scenes, strict=True):
            alone = simulate(scene, tolerance=1e-2, **options)
            assert (t.engine, t.equation) == (alone.engine, alone.equation)
            assert np.array_equal(t.velocity, alone.velocity)
    assert simulate_many([]) == []


def test_a_tolerance_that_cannot_be_met():
    scenes = [short(1e-6), short(3e-2)]
    with pytest.raises(ToleranceNotMet) as missed:
        simulate_many(scenes, 3e-15)
    assert missed.value.reason
    with pytest.warns(UserWarning, match="round-off|not help"):
        found = simulate_many(scenes, 3e-15, on_miss="warn")
    assert len(found) == 2
    assert found[1].error_estimate.total > 3e-15


def test_invalid_requests_are_rejected():
    with pytest.raises(InputError, match=r"scenes\.1: must be a Scene"):
        simulate_many([short(1e-6), 3])
    with pytest.raises(InputError, match="on_miss"):
        simulate_many([short(1e-6)], on_miss="ignore")
    with pytest.raises(InputError, match=r"scenes\.1\.gravity"):
        simulate_many([short(1e-6), short(1e-6, gravity=0.0)], engine="modes")
    with pytest.raises(InputError, match="scenes: must be"):
        simulate_many(short(1e-6))
    with pytest.raises(InputError, match="scenes: must be"):
        simulate_many(3)
