"""What a stepper keeps, and goes on from."""

import numpy as np
import pytest

from lmpchain import Chain, Impulse, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

SCENE = Scene(
    chain=Chain(grains=12, diameter=1e-3),
    excitation=Impulse(velocity=0.05),
    duration=1.5e-4,
    samples=13,
)
SCHEDULE = Steps(2, 1, SCENE.duration / 24, False)  # steps four times too long


def stepper(state):
    return NativeStepper(ChainBatch([SCENE]), METHODS["verlet"], SCHEDULE, state)


def test_a_run_that_broke_down_goes_on_with_its_bits():
    """A companion may break down where the answer does not, and is kept beside it."""
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


def test_a_clock_that_is_no_number_is_refused():
    kept = stepper({}).state()
    kept["state"]["done"][0] = np.nan
    with pytest.raises(ValueError, match="does not fit"):
        stepper(kept)
