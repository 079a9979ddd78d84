"""Estimates of runs with a given step, for which no tolerance is enforced; and the largest one."""

import warnings

import numpy as np
import pytest
from helpers.taylor_series import reference

from lmpchain import (
    Chain,
    Displacement,
    Impulse,
    Scene,
    ToleranceNotMet,
    Trajectory,
    simulate,
    simulate_many,
)
from lmpchain.trajectory.record import ErrorEstimate

TOLERANCES = (1e-2, 1e-6, 1e-12)
GLASS = {"material": "glass", "diameter": 1e-3, "gravity": 0.0}
BETWEEN_WALLS = Chain(grains=4, top_load=1e-3, top="wall", bottom="wall", **GLASS)
STRUCK = Scene(chain=BETWEEN_WALLS, excitation=Impulse(velocity=0.02), duration=4e-4, samples=21)
FREE = Chain(grains=4, top="free", bottom="free", **GLASS)


def at(tolerance: float, scene: Scene, engine: str, **options) -> tuple[Trajectory, list[str]]:
    """Return the answer at a tolerance that nothing enforces, and the warnings beside it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        answer = simulate(scene, engine, tolerance, **options)
    return answer, [str(warning.message) for warning in said]


@pytest.mark.parametrize(
    ("engine", "options", "duration", "known"),
    [
        ("native", {"integrator": "rkn6", "step": 2e-8}, 4e-4, True),
        ("native", {"integrator": "verlet", "step": 4e-8}, 2e-3, False),
        ("lammps", {"step": 2e-7}, 1e-4, True),
    ],
)
def test_no_tolerance_changes_a_run_with_a_given_step(engine, options, duration, known):
    """Rounding was measured only if a tolerance needed it, and the diameter in LAMMPS followed."""
    scene = STRUCK.replace(duration=duration)
    (first, said), *others = [at(tolerance, scene, engine, **options) for tolerance in TOLERANCES]
    for other, also_said in others:
        np.testing.assert_array_equal(other.velocity, first.velocity)
        assert other.error_estimate == first.error_estimate
        assert also_said == said
    assert [("beyond 0.1 of the motion" in remark) for remark in said] == [True] * (not known)
    if known:
        true, doubt = reference(scene, 1e-18)
        error = true.error(first.displacement, first.velocity)
        assert doubt < error / 10
        assert error <= first.error_estimate.solver < 30 * error
    else:
        assert 1 < first.error_estimate.solver <= 2


def test_a_batch_with_a_given_step_has_the_estimate_of_a_run_alone():
    steps = {"integrator": "rkn6", "step": 1e-8}
    alone = simulate(STRUCK, "native", 1e-2, **steps).error_estimate
    batch = simulate_many([STRUCK, STRUCK], 1e-9, **steps)
    assert [answer.error_estimate for answer in batch] == [alone] * 2


def test_no_estimate_is_above_2():
    """Auxiliary runs that break down, or closed forms far off, say that nothing is known."""
    wide = STRUCK.replace(duration=2e-2)
    fast = 0.3 * 2 / BETWEEN_WALLS.band_edge
    answer, _ = at(1e-6, wide, "native", integrator="rkn4", step=fast)
    assert answer.error_estimate.total == 2.0
    assert answer.error_estimate.remark.endswith("nothing is known of the answer")
    estimate = ErrorEstimate(1.5, 1.0)
    assert estimate.total == 2.0
    assert not ErrorEstimate(0.0, 1e-9).remark
    assert ErrorEstimate(0.0, 0.0).remark == ", because no recorded grain can move"
    # a dump without an estimate
    assert ErrorEstimate(0.0, np.inf).total == np.inf


@pytest.mark.parametrize("velocity", [-5e-23, 1e-140, 1e-170, -1e-170, 1e-300, 1e-308])
def test_the_weakest_motions_have_an_error_relative_to_themselves(velocity: float):
    """Grain 1 flies off, or its collision has hardly begun: x = v t.

    The energy underflows, which was taken for an unstable run.
    """
    scene = Scene(chain=FREE, excitation=Impulse(velocity=velocity), duration=1e-3, samples=5)
    answer = simulate(scene, "native")
    path = velocity * scene.time
    off = np.abs(answer.displacement[:, 0] - path).max() / abs(path[-1])
    assert off <= answer.error_estimate.solver <= 1e-6
    assert answer.error_estimate.solver > 0


@pytest.mark.parametrize("engine", ["native", "modes", "chebyshev"])
def test_nothing_is_known_of_a_motion_of_the_smallest_double(engine: str):
    """5e-324 m/s keeps no digit, and 2e-13 was stated."""
    weakest = STRUCK.replace(excitation=Impulse(velocity=5e-324))
    with pytest.raises(ToleranceNotMet, match=r"estimated at 2 \(nothing is known\)"):
        simulate(weakest, engine)


@pytest.mark.parametrize("excitation", [Impulse(velocity=0.0), Displacement(displacement=-1e-9)])
def test_a_scene_in_which_nothing_happens_has_the_rounding_of_its_units(excitation):
    scene = Scene(chain=FREE, excitation=excitation, duration=1e-3, samples=5)
    answer = simulate(scene, "native")
    assert not answer.velocity.any()
    assert 0 < answer.error_estimate.total < 1e-12
