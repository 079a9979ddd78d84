"""Where something acts all along: estimates against Taylor series, for few and many samples."""

from __future__ import annotations

import pytest
from helpers.taylor_series import reference

from lmpchain import Chain, Force, Scene, simulate

# two grains between walls, the lower one pushed for half of the time: the push ends in a corner
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
