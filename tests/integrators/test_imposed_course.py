"""The compiled forcing and its derivatives against the waveforms of the scene."""

import numpy as np
import pytest

from lmpchain import Chain, Drive, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels import right_hand_side

CHAIN = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1e-3)
UNIT = CHAIN.time_scale
TIMES = np.linspace(0.1, 5.9, 30) * UNIT
WAVE = {"amplitude": 1e-9, "frequency": 0.3 / UNIT}
DRIVES = {
    "sine": Drive(**WAVE),
    "burst that ends": Drive(**WAVE, cycles=1.2),
    "points": Drive(
        times=np.arange(7.0) * UNIT, displacement=1e-9 * np.array([0, 1, -1, 2, 0, 1, 0])
    ),
}


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_the_compiled_forcing_equals_that_of_the_scene(drive: Drive, order: int):
    scene = Scene(chain=CHAIN, excitation=drive, duration=6 * UNIT, samples=3)
    arrays = ChainBatch([scene]).arrays
    right_hand_side.addresses()
    found = [
        right_hand_side._course(arrays.wave[0], arrays.knots[0], arrays.pieces[0], t, order, t)
        for t in TIMES
    ]
    exact = scene.excitation.waveform.at(TIMES, order)
    # Rounding errors near a zero are relative to the largest value.
    assert found == pytest.approx(exact, rel=1e-10, abs=1e-12 * np.abs(exact).max())
