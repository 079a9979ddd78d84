"""Auxiliary runs are advanced in the same compiled call as the main run."""

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck

from lmpchain import Impulse
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels.layout import PAD
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

CHAIN = column(30, top="wall")
SCENES = [struck(CHAIN, speed, 6e-5, 25) for speed in (1e-3, 2e-2, 0.1)]


# Method, whether steps are adaptive, and number of samples from one landing to the next.
CASES = [
    *(("rkn6", True, 1), ("rkn6", True, 12), ("rkn6", False, 12), ("rkn4", False, 1)),
    *(("verlet", False, 1), ("dop853", True, 1), ("gear4", False, 1)),
]


def steps_of(name: str, adaptive: bool, landing: int, interval: float) -> Steps:
    """Return the steps of the main run; methods of one stage have more steps."""
    steps = landing * (9 if METHODS[name].evaluations == 1 else 3)
    return Steps(steps, landing, landing * interval / steps, adaptive, dense=int(landing > 1))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("name", "adaptive", "landing"), CASES)
def test_auxiliary_runs_have_the_bits_of_separate_runs(
    name: str, adaptive: bool, landing: int, threads: int
):
    """The bits agree for pieces of a few steps, in a batch, and with threads."""
    method = METHODS[name]
    own = steps_of(name, adaptive, landing, SCENES[0].sampling_interval)
    schedules = [own, own.longer(2), own.longer(4)]
    shape = len(SCENES), 25, CHAIN.grains
    alone = []
    for schedule in schedules:
        stepper = NativeStepper(ChainBatch(SCENES), method, schedule, {})
        fields = np.zeros(shape), np.zeros(shape)
        stepper.fill(*fields, 0, 24, 2**62)
        alone.append((*fields, stepper.state()))
    together = NativeStepper(ChainBatch(SCENES), method, schedules[0], {}, threads, schedules[1:])
    own = (np.zeros(shape), np.zeros(shape))
    beside = (np.zeros((2, *shape)), np.zeros((2, *shape)))
    while together.sample < 24:
        together.fill(*own, 0, 24, 7, beside)
    together.close()
    kept = together.state()
    assert together.progress == 1
    assert 0.4 < together.own_part < 0.7
    for number, (u, v, state) in enumerate(alone):
        found = own if number == 0 else (beside[0][number - 1], beside[1][number - 1])
        assert np.array_equal(found[0], u)
        assert np.array_equal(found[1], v)
        assert u.any()
        for key in ("u", "v"):
            assert np.array_equal(kept[key][number], state[key][0])


@pytest.mark.parametrize(("name", "adaptive", "landing"), CASES)
def test_samples_of_short_chains_are_written_whole(name: str, adaptive: bool, landing: int):
    """No zeros are written ahead of the wave, nor after auxiliary runs that stop."""
    chain = column(300)
    scene = scene_of(chain, Impulse(velocity=1e-3, grain=150), 4e-6, 25)
    own = steps_of(name, adaptive, landing, scene.sampling_interval)
    stepper = NativeStepper(ChainBatch([scene]), METHODS[name], own, {}, 1, [own.longer(2)])
    fields = np.full((2, 1, 25, 300), np.nan)
    beside = np.full((2, 1, 1, 25, 300), np.nan)
    stepper.fill(*fields, 0, 24, 2**62, tuple(beside))
    first, last = (stepper.watched[name][0] - PAD for name in ("first", "last"))
    assert 0 < first < 149 < last < 300
    every = own.longer(2).dense or own.longer(2).stride
    for found in (fields[:, :, 1:], beside[:, 0, :, every::every]):
        assert found[..., 149].all()
        assert not found[..., : int(first)].any()
        assert not found[..., int(last) :].any()
        assert not np.isnan(found).any()
