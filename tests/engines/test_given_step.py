"""Estimates of runs with a given step, which enforces no tolerance, and the largest estimate."""

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

TOLERANCES = (1e-2, 1e-12)
GLASS = {"material": "glass", "diameter": 1e-3, "gravity": 0.0}
BETWEEN_WALLS = Chain(grains=4, top_load=1e-3, top="wall", bottom="wall", **GLASS)
STRUCK = Scene(chain=BETWEEN_WALLS, excitation=Impulse(velocity=0.02), duration=4e-4, samples=21)
# Rounding, amplified by openings of contacts, exceeds the error of short steps.
ROUNDED = STRUCK.replace(
    chain=BETWEEN_WALLS.replace(exponent=3.0), excitation=Impulse(velocity=0.3), duration=6.97e-3
)
FREE = Chain(grains=4, top="free", bottom="free", **GLASS)


def at(tolerance: float, scene: Scene, engine: str, **options) -> tuple[Trajectory, list[str]]:
    """Return the run at a tolerance that nothing enforces, and its warnings."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        answer = simulate(scene, engine, tolerance, **options)
    return answer, [str(warning.message) for warning in said]


@pytest.mark.parametrize(
    ("engine", "options", "scene", "known"),
    [
        pytest.param(
            "native",
            {"integrator": "kahan-li8", "step": 5.8e-8},
            ROUNDED,
            True,
            marks=pytest.mark.slow,
        ),
        ("native", {"integrator": "verlet", "step": 4e-8}, STRUCK.replace(duration=2e-3), False),
        ("lammps", {"step": 2e-7}, STRUCK.replace(duration=1e-4), True),
    ],
)
def test_no_tolerance_changes_a_run_with_a_given_step(engine, options, scene, known):
    """Rounding was once measured only if a tolerance required it, also for the diameter."""
    (first, said), (other, also_said) = [
        at(tolerance, scene, engine, **options) for tolerance in TOLERANCES
    ]
    np.testing.assert_array_equal(other.velocity, first.velocity)
    assert other.error_estimate == first.error_estimate
    assert also_said == said
    assert [("beyond 0.1 of the motion" in remark) for remark in said] == [True] * (not known)
    if known:
        true, doubt = reference(scene, 1e-18)
        error = true.error(first.displacement, first.velocity)
        assert doubt < error / 10
        assert error <= first.error_estimate.solver < 10 * error
    else:
        assert 1 < first.error_estimate.solver <= 2


def test_a_batch_with_a_given_step_has_the_estimates_of_single_runs():
    steps = {"integrator": "rkn6", "step": 1e-8}
    alone = simulate(STRUCK, "native", 1e-2, **steps).error_estimate
    batch = simulate_many([STRUCK, STRUCK], 1e-9, **steps)
    assert [answer.error_estimate for answer in batch] == [alone] * 2


def test_no_estimate_is_above_2():
    """Auxiliary runs that break down, and very wrong closed forms, have the estimate 2."""
    wide = STRUCK.replace(duration=2e-2)
    fast = 0.3 * 2 / BETWEEN_WALLS.band_edge
    answer, _ = at(1e-6, wide, "native", integrator="rkn4", step=fast)
    assert answer.error_estimate.total == 2.0
    assert answer.error_estimate.remark.endswith("nothing is known about the solution")
    estimate = ErrorEstimate(1.5, 1.0)
    assert estimate.total == 2.0
    assert not ErrorEstimate(0.0, 1e-9).remark
    assert ErrorEstimate(0.0, 0.0).remark == ", because no recorded grain can move"
    # A dump without an estimate.
    assert ErrorEstimate(0.0, np.inf).total == np.inf


@pytest.mark.parametrize("velocity", [-5e-23, 1e-140, 1e-170, -1e-170, 1e-300, 1e-308])
def test_the_weakest_motions_have_an_error_relative_to_themselves(velocity: float):
    """Grain 1 flies away, or its collision has hardly begun: x = v t.

    The energy underflows, which was taken for an unstable run.
    """
    scene = Scene(chain=FREE, excitation=Impulse(velocity=velocity), duration=1e-3, samples=5)
    answer = simulate(scene, "native")
    path = velocity * scene.time
    off = np.abs(answer.displacement[:, 0] - path).max() / abs(path[-1])
    assert off <= answer.error_estimate.solver <= 1e-6
    assert answer.error_estimate.solver > 0


@pytest.mark.parametrize("engine", ["native", "modes", "chebyshev"])
def test_a_motion_of_the_smallest_double_has_the_largest_estimate(engine: str):
    """A velocity of 5e-324 m/s has no accurate digit; its error was once given as 2e-13."""
    weakest = STRUCK.replace(excitation=Impulse(velocity=5e-324))
    with pytest.raises(ToleranceNotMet, match=r"estimated at 2 \(nothing is known\)"):
        simulate(weakest, engine)


@pytest.mark.parametrize("excitation", [Impulse(velocity=0.0), Displacement(displacement=-1e-9)])
def test_a_scene_at_rest_has_the_rounding_error_of_its_units(excitation):
    scene = Scene(chain=FREE, excitation=excitation, duration=1e-3, samples=5)
    answer = simulate(scene, "native")
    assert not answer.velocity.any()
    assert 0 < answer.error_estimate.total < 1e-12
