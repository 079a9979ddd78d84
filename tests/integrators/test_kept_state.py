"""The stored state of a stepper, from which it continues."""

import numpy as np
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

SCENE = scene_of(Chain(grains=12, diameter=1e-3), Impulse(velocity=0.05), 1.5e-4, 13)
SCHEDULE = Steps(2, 1, SCENE.duration / 24, False)  # The steps are four times too long.


def stepper(state):
    return NativeStepper(ChainBatch([SCENE]), METHODS["verlet"], SCHEDULE, state)


def test_a_run_that_broke_down_continues_with_the_same_bits():
    """An auxiliary run may break down and is then stored with the main run."""
    whole = stepper({})
    first = stepper({})
    u = np.zeros((4, 1, 13, 12))
    whole.fill(u[0], u[1], 0, 12, 2**30)
    first.fill(u[2], u[3], 0, 9, 2**30)
    kept = first.state()
    assert not np.isfinite(kept["state"]["largest_displacement"]).all()
    stepper(kept).fill(u[2], u[3], 0, 12, 2**30)
    assert np.array_equal(u[0], u[2], equal_nan=True)
    assert np.array_equal(u[1], u[3], equal_nan=True)
