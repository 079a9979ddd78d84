"""Forced scenes: error estimates against Taylor series, for few and many samples."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.taylor_series import reference

from lmpchain import Chain, Drive, Force, Scene, simulate

# Two grains between walls; the lower one is pushed for half of the time, so that the push ends in a
# kink.
PUSHED = Scene(
    chain=Chain(
        grains=2, diameter=1e-3, gravity=0, exponent=1, top_load=1e-2, top="wall", bottom="wall"
    ),
    excitation=Force(grain=2, shape="half-sine", amplitude=1.22e-3, duration=1.1728e-7),
    duration=2.3133779980076516e-7,
    samples=7,
)


@pytest.mark.parametrize("samples", [2, 3, 7, 20, 101])
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9])
def test_a_push_that_ends_between_samples(samples: int, tolerance: float):
    scene = PUSHED.replace(samples=samples)
    answer = simulate(scene, "native", tolerance)
    best, doubt = reference(scene, 1e-15)
    error = best.error(answer.displacement, answer.velocity)
    assert doubt < error / 10
    assert error <= answer.error_estimate.solver <= tolerance


@pytest.mark.parametrize("number", range(8))
def test_half_sines_of_any_length_with_two_samples(number: int):
    """The kink cuts the steps of all runs at its time, not at the end of a step."""
    rng = np.random.default_rng([5, number])
    edge = PUSHED.chain.band_edge
    push = PUSHED.excitation.replace(duration=float(10 ** rng.uniform(-0.1, 1.0)) * np.pi / edge)
    duration = float(push.duration * rng.uniform(1.05, 4))
    scene = PUSHED.replace(excitation=push, duration=duration, samples=2)
    for integrator in ("rkn4", "rkn6", "dop853"):
        answer = simulate(scene, "native", 1e-5, integrator=integrator)
        error = reference(scene, 1e-17)[0].error(answer.displacement, answer.velocity)
        assert error / 2 <= answer.error_estimate.solver <= 1e-5


@pytest.mark.parametrize("holds", [True, False])
def test_behind_the_last_point_of_a_steep_curve(holds: bool):
    """The end of the curve was once delayed by 1e-12 of its time, 1e-11 of its height."""
    chain = Chain(grains=4, diameter=1e-3, gravity=0, top_load=1.0, top="wall", bottom="wall")
    times = np.linspace(0, 30, 61) / chain.band_edge
    values = np.cos(np.arange(61) * 2.0) - 1.0
    push = {"times": times, "interpolation": "linear"}
    excitation = (
        Drive(displacement=1e-9 * values, grain=0, **push)
        if holds
        else Force(force=1e-3 * values, grain=2, **push)
    )
    scene = Scene(chain=chain, excitation=excitation, duration=1.3 * times[-1], samples=3)
    answer = simulate(scene, "native", 1e-12, integrator="dop853")
    error = reference(scene, 1e-19)[0].error(answer.displacement, answer.velocity)
    assert error <= answer.error_estimate.solver <= 1e-12
