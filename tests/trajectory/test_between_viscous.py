"""The largest force of viscous contacts between samples, and the motion of their bodies."""

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of

from lmpchain import Drive
from lmpchain.trajectory.accumulator import STILL, Accumulator, largest_force, viscous_contact
from lmpchain.trajectory.between.maxima import Window

CHAIN = column(4, top="wall", bottom="wall", top_load=0.02, damping={"viscoelastic": 3e-8})
OMEGA = 2e6
STEP = 0.1 / OMEGA
REST = float(CHAIN.contacts.overlap[2])


@pytest.mark.parametrize("size", [0.3, 2.5])
@pytest.mark.parametrize("phase", [0.2, 1.5, 2.9])
def test_the_largest_force_of_a_known_motion_is_within_its_error(size: float, phase: float):
    """The force K o^1.5 (1 + 1.5 A o'/o) is largest before the contact is closest."""
    amplitude = size * REST

    def motion(t: np.ndarray) -> np.ndarray:
        angle = OMEGA * t + phase
        return amplitude * np.array([np.sin(angle), OMEGA * np.cos(angle)])

    constant = CHAIN.contacts.constant[2]
    fine = motion(np.linspace(0.0, 30 * STEP, 300_001))
    overlap = np.maximum(REST + fine[0], 0.0)
    viscous = 1.5 * CHAIN.contact_viscosity[2] * np.sqrt(overlap) * fine[1]
    true = constant * (overlap**1.5 + viscous)
    found, error, closer, closing = largest_force(
        viscous_contact(CHAIN, 2), motion(STEP * np.arange(31)), STEP, Window(0, 0, 30)
    )
    assert abs(found - true.max()) <= error + 1e-12 * true.max()
    assert error < 1e-5 * true.max()
    # At the maximum a force of 1e-12 less is 1e-6 of a period away.
    expected = fine[:, true.argmax()]
    assert closer == pytest.approx(expected[0], rel=0, abs=1e-4 * amplitude)
    assert closing == pytest.approx(expected[1], rel=0, abs=1e-4 * amplitude * OMEGA)


def test_the_approach_of_a_contact_is_relative_to_both_bodies(rng):
    """The upper body of contact 0 is the moving wall; the lower wall is at rest."""
    drive = Drive(grain=0, amplitude=1e-8, frequency=3e4)
    scene = scene_of(CHAIN, drive, 2e-5, 9)
    u, v = rng.normal(size=(2, 4, 4))
    column = np.array([STILL, 0, 1, 2, 3, STILL])
    known = np.ones(6, dtype=bool)
    accumulator = Accumulator(scene, False, column, known, np.arange(1, 5), ())
    wall = np.array(drive.motion(scene.time[3:7]))
    expected = {
        0: wall - [u[:, 0], v[:, 0]],
        1: [u[:, 0] - u[:, 1], v[:, 0] - v[:, 1]],
        4: [u[:, 3], v[:, 3]],
    }
    for number, motion in expected.items():
        assert np.array_equal(accumulator.relative(number, 3, u, v), motion), number


@pytest.mark.parametrize("tracked", ["velocity", "displacement"])
def test_fronts_start_from_the_first_sample_of_their_field(rng: np.random.Generator, tracked: str):
    scene = scene_of(CHAIN, Drive(grain=0, amplitude=1e-9, frequency=3e4), 2e-5, 9)
    u, v = rng.normal(size=(2, 9, 4))
    column = np.array([STILL, 0, 1, 2, 3, STILL])
    grains = np.arange(1, 5)
    known = np.ones(6, dtype=bool)
    expected = np.abs((v if tracked == "velocity" else u)[0])
    for whole in (False, True):
        accumulator = Accumulator(scene, False, column, known, grains, (tracked,), tracked)
        if whole:
            accumulator.take_all(u, v, np.zeros(4))
        else:
            accumulator.take(0, u, v)
        assert np.array_equal(accumulator.state["start"], expected)
