"""Bounds that a stable run cannot exceed."""

import numpy as np
import pytest

from lmpchain import Chain, Drive, Impulse, RunFailed, Scene
from lmpchain.engines.native import Native
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.table import UNBOUNDED
from lmpchain.integrators.steps import Steps


def test_the_bound_on_the_kinetic_energy():
    """Drives have no limit; other scenes have 1.5 times the energy input."""
    chain = Chain(grains=5, diameter=1e-3)
    struck = Scene(chain=chain, excitation=Impulse(velocity=1e-2), duration=1e-4)
    slow = chain.masses.sum() * (1e-3 * chain.length_scale / chain.time_scale) ** 2
    expected = 1.5 * chain.masses[0] * 1e-4 + slow
    assert ChainBatch([struck]).arrays.allowed == pytest.approx(expected, rel=1e-13)
    driven = Scene(chain=chain, excitation=Drive(amplitude=1e-9, frequency=1e4), duration=1e-4)
    assert ChainBatch([driven]).arrays.allowed.tolist() == [UNBOUNDED]


@pytest.mark.parametrize(("steps", "lost"), [(1, "answer"), (12, "companion"), (64, "nothing")])
def test_grains_that_come_too_close_are_detected(steps: int, lost: str):
    """If steps are far too long, grains pass through each other, and the error is infinite."""
    chain = Chain(grains=9, diameter=1e-3, gravity=0.0, bottom="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1.862e-3), duration=4.5e-4, samples=9)
    engine = Native("rkn4", adaptive=False)
    step = scene.duration / 8 / steps
    run = engine.start([scene], engine.propose(scene, 1e-3).with_steps(Steps(steps, 1, step)))
    if lost == "answer":
        with pytest.raises(RunFailed, match="a contact overlaps more than the total energy allows"):
            list(run.blocks())
        return
    list(run.blocks())
    assert (run.errors()[0].truncation == np.inf) == (lost == "companion")
