"""The largest force of viscous contacts between samples, and the motion of their bodies."""

from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import scene_of, struck
from scipy.interpolate import CubicHermiteSpline

from lmpchain import Chain, Drive, Force, Impulse
from lmpchain.trajectory.accumulator import STILL, Accumulator, largest_force, viscous_contact
from lmpchain.trajectory.between.derivatives import imposed_on
from lmpchain.trajectory.between.maxima import Window

CHAIN = column(4, top="wall", bottom="wall", top_load=0.02, damping={"viscoelastic": 3e-8})
OMEGA = 2e6
STEP = 0.1 / OMEGA
TABLE = np.linspace(0.0, 1.97e-5, 5)
REST = float(CHAIN.contacts.overlap[2])


@pytest.mark.parametrize("size", [0.3, 2.5])
@pytest.mark.parametrize("phase", [0.2, 1.4, 2.9, -1.5])
def test_the_largest_force_of_a_known_motion_is_within_its_error(size: float, phase: float):
    """The force K o^1.5 (1 + 1.5 A o'/o) is largest before the contact is closest."""
    amplitude = size * REST

    def motion(t: np.ndarray) -> np.ndarray:
        angle = OMEGA * t + phase
        return amplitude * np.array([np.sin(angle), OMEGA * np.cos(angle)])

    constant = CHAIN.contacts.constant[2]
    # Two or three samples have a polynomial of lower degree.
    for intervals, step, missed, most in (
        (30, STEP, 1e-10, 1e-8),
        (8, 4 * STEP, 1e-7, 1e-5),
        (2, 4 * STEP, 2e-6, 1e-3),
        (1, 4 * STEP, 1e-4, 0.3),
    ):
        fine = motion(np.linspace(0.0, intervals * step, 10_000 * intervals + 1))
        overlap = np.maximum(REST + fine[0], 0.0)
        viscous = 1.5 * CHAIN.contact_viscosity[2] * np.sqrt(overlap) * fine[1]
        true = constant * (overlap**1.5 + viscous)
        found, error, closer, closing = largest_force(
            viscous_contact(CHAIN, 2),
            motion(step * np.arange(intervals + 1)),
            step,
            Window(0, 0, intervals),
        )
        assert abs(found - true.max()) <= min(error, missed * true.max()) + 1e-10 * true.max()
        assert error < most * true.max() + 1e-30
        # At the maximum a force of 1e-12 less is 1e-6 of a period away.
        if intervals == 30:
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
@pytest.mark.parametrize("chain", [CHAIN, CHAIN.replace(damping={"drag": 10.0})])
def test_swinging_grains_have_the_extremes_and_fronts_of_a_sine(chain: Chain, tracked: str):
    """Largest values, approaches, arrivals and widths are exact, however the samples are added."""
    count = 62
    scene = struck(chain, 1.0, (count - 1) * STEP, count)
    size = 1e-9 * np.array([1.0, 3.0, 2.0, 4.0])
    # The last grain is beyond half of its largest size at t = 0.
    phase = np.array([0.3, 0.1, -0.4, 1.2]) + (np.pi / 2 if tracked == "velocity" else 0.0)
    angle = OMEGA * scene.time[:, None] + phase
    order = np.array([2, 0, 3, 1])
    u = (size * np.sin(angle))[:, np.argsort(order)]
    v = (size * OMEGA * np.cos(angle))[:, np.argsort(order)]
    column = np.array([STILL, *order, STILL])
    known = np.zeros(6, dtype=bool)
    motion = (scene, False, column, known, np.arange(1, 5), ("displacement", "velocity"))

    def start(state: dict | None = None) -> Accumulator:
        return Accumulator(*motion, tracked, [0, 2], state=state)

    whole, pieces, every = start(), start(), start()
    whole.take(0, u, v)
    begin = 0
    for length in (1, 2, 1, 7, 30, 2, 19):
        pieces.take(begin, u[begin : begin + length], v[begin : begin + length])
        pieces = start(pieces.state)
        begin += length
    assert begin == count
    every.take_all(u, v, np.zeros(4))
    known_error = 1e-12
    for accumulator in (whole, pieces, every):
        for field, unit in (("displacement", 1.0), ("velocity", OMEGA)):
            found, error = accumulator.largest(field, known_error * unit)
            assert (np.abs(found - size * unit) <= error).all()
            assert (error >= known_error * unit).all()
            assert (error < 1.1 * known_error * unit).all()
        # The wall above grain 1 is at rest.
        between = size[1] * np.exp(1j * phase[1]) - size[2] * np.exp(1j * phase[2])
        for row, top in enumerate((size[0], abs(between))):
            found, error = accumulator.closest(row, 0.0)
            assert abs(found[0] - top) <= error[0] < 1e-4 * top
        for row, number in enumerate([0, 2] if chain.damping.longest_time else []):
            fine = np.linspace(0, scene.duration, 100_001)
            upper = size[1] * np.exp(1j * (OMEGA * fine + phase[1])) if number else 0 * fine
            lower = size[number] * np.exp(1j * (OMEGA * fine + phase[number]))
            apart = upper - lower
            contact = viscous_contact(chain, number)
            force = contact.force(apart.imag, OMEGA * apart.real)
            found, error = accumulator.state["strongest"][row, :2]
            assert abs(found - force.max()) <= error + 1e-8 * force.max()
    passed = ((np.pi if tracked == "velocity" else np.pi / 2) - phase) / OMEGA
    arrived, late = whole.arrivals(known_error)
    assert np.array_equal(pieces.arrivals(known_error), [arrived, late], equal_nan=True)
    assert np.isnan(arrived[3])
    assert np.isnan(late[3])
    assert (np.abs(arrived - passed)[:3] <= late[:3]).all()
    assert (late[:3] < 0.01 / OMEGA).all()
    found, error = np.split(every.fronts(0.5, known_error, known_error, True), 2, axis=1)
    height = -size * OMEGA if tracked == "velocity" else size
    exact = np.array([passed, height, np.full(4, 2 * np.pi / 3 / OMEGA)]).T
    assert np.isnan(found[3]).all()
    assert (np.abs(found - exact) <= error)[:3].all()
    assert (error[:3, [0, 2]] < 0.02 / OMEGA).all()
    assert (error[:3, 1] >= known_error).all()
    assert (error[:3, 1] < 0.01 * np.abs(height)[:3]).all()
    with pytest.raises(ValueError, match="does not belong to this scene"):
        start(whole.state | {"fast": np.zeros((3, 3))})


@pytest.mark.parametrize(
    ("excitation", "ends", "grain", "wall_body"),
    [
        (Impulse(velocity=1.0), {}, 0, 0),
        (Force(grain=3, shape="half-sine", amplitude=1e-3, duration=1.13e-5), {}, 3, 0),
        (Force(grain=2, times=TABLE, force=[0.0, 1e-9, 2e-9, -1e-9, 1e-9]), {}, 2, 0),
        (Drive(amplitude=1e-8, frequency=3e4), {}, 1, 0),
        (Drive(grain=0, amplitude=1e-8, frequency=3e4, cycles=0.4), {"top": "wall"}, 0, 0),
        (Drive(end="bottom", amplitude=1e-8, frequency=3e4), {"bottom": "wall"}, 0, 6),
        (Drive(end="bottom", amplitude=1e-8, frequency=3e4), {"bottom": "fixed"}, 5, 0),
        (Drive(times=TABLE, displacement=[0.0, 1e-15, 3e-15, 2e-15, 0.0]), {}, 1, 0),
    ],
)
def test_imposed_motion_is_that_of_the_excitation(
    excitation: Any, ends: dict[str, str], grain: int, wall_body: int
):
    """Derivatives are differences of the motion; errors cover the kinks between samples."""
    chain = column(5, **{"top": "free", "bottom": "wall"} | ends)
    scene = scene_of(chain, excitation, 2e-5, 41)
    step = scene.sampling_interval
    first, count = 3, 38
    imposed = imposed_on(scene, step, first, count)
    assert (imposed.grain, imposed.wall_body) == (grain, wall_body)
    assert imposed.driven == (isinstance(excitation, Drive) and grain > 0)
    time = scene.time[first : first + count]
    if isinstance(excitation, Impulse):
        assert not any(np.any(rows) for rows in imposed[:3])
        return
    wave = excitation.waveform
    order, unit = 2, 1.0
    if isinstance(excitation, Force):
        order, unit = 0, chain.masses[grain - 1]
    near = 1e-4 * step
    # No kink is at a sample.
    rows = [
        wave.at(time, 0) if not n else (wave.at(time + near, n - 1) - wave.at(time - near, n - 1))
        / (2 * near)
        for n in range(order + 2)
    ]  # fmt: skip
    found = imposed.acceleration * unit
    if grain == 0:
        assert not imposed.acceleration.any()
        found = imposed.wall[2:]
        for row, expected in zip(imposed.wall, rows, strict=True):
            np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-6 * np.ptp(expected))
    else:
        assert not imposed.wall.any()
        for row, expected in zip(found, rows[order:], strict=True):
            np.testing.assert_allclose(row, expected, rtol=1e-5, atol=1e-6 * np.ptp(expected))
    between = CubicHermiteSpline(time, *found)
    kinks = np.array(wave.kinks)
    for i in range(count - 1):
        inside = (kinks > time[i]) & (kinks < time[i + 1])
        doubt = imposed.doubt[i] * unit
        if not inside.any():
            assert doubt == 0.0
            continue
        dense = np.linspace(time[i], time[i + 1], 2001)
        off = np.abs(wave.at(dense, order) - between(dense)).max()
        # Jumps of the acceleration of a curve through points are left to the misfit.
        assert off <= doubt * (1 + 1e-6) or wave.spline is not None
        assert 0 < doubt <= 20 * off
    assert imposed.doubt[-1] == 0.0
