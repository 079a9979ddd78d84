"""The compiled forcing and its derivatives against the waveforms of the scene."""

import numpy as np
import pytest
from helpers.between_samples import direct

from lmpchain import Chain, Drive, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels import right_hand_side

CHAIN = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1e-3)
UNIT = CHAIN.time_scale
TIMES = np.linspace(0.1, 5.9, 30) * UNIT
COURSE = direct(right_hand_side.call_course)
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
    address, _ = right_hand_side.addresses()
    given = arrays.wave[0], arrays.knots[0], arrays.pieces[0]
    found = [COURSE(address, (*given, t, order, t)) for t in TIMES]
    exact = scene.excitation.waveform.at(TIMES, order)
    # Rounding errors near a zero are relative to the largest value.
    assert found == pytest.approx(exact, rel=1e-10, abs=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("kind", ["linear", "pchip", "burst"])
def test_the_branch_on_one_side_of_a_kink_is_evaluated(kind: str, order: int):
    knots = np.array([0.0, 1.0, 2.5, 4.0, 5.5]) * UNIT
    bump = 1e-9 * np.array([0, 1, -1, 2, 1])
    drive = Drive(**WAVE, cycles=1.2)
    if kind != "burst":
        drive = Drive(times=knots, displacement=bump, interpolation=kind)
    scene = Scene(chain=CHAIN, excitation=drive, duration=6 * UNIT, samples=3)
    arrays = ChainBatch([scene]).arrays
    address, _ = right_hand_side.addresses()
    given = arrays.wave[0], arrays.knots[0], arrays.pieces[0]
    kinks = [t for t in scene.excitation.waveform.kinks if t > 0]
    assert kinks
    for kink in kinks:
        for side in (-1e-9, 1e-9):
            near = kink + side * UNIT
            (exact,) = scene.excitation.waveform.at(np.array([near]), order)
            found = COURSE(address, (*given, kink, order, near))
            assert found == pytest.approx(exact, rel=1e-6, abs=1e-16 / UNIT**order)
