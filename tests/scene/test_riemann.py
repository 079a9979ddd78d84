"""Initial states of steps of velocity and compression, and of pistons."""

import numpy as np
import pytest

from lmpchain import Chain, Drive, InputError, Riemann, Scene, simulate


def relative(values: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference over the largest expected value."""
    return float(np.abs(values - expected).max() / np.abs(expected).max())


LOADED = Chain(grains=12, diameter=1e-3, gravity=0.0, top_load=1.0)
PISTON = Drive(shape="piston", velocity=0.02, rise=1e-5)


def test_contacts_are_closer_by_the_strain_on_either_side() -> None:
    """Overlaps in excess of rest are the strains times the mean diameter, including the wall."""
    walls = LOADED.replace(bottom="wall", diameter=np.linspace(1e-3, 2e-3, 12))
    step = Riemann(velocity=(0.3, -0.1), strain=(2e-4, -1e-5), grain=5)
    displacement, velocity = step.initial(walls)
    closer = walls.contacts.closer(displacement)[1:] / walls.contact_lengths[1:]
    assert closer == pytest.approx(np.repeat([2e-4, -1e-5], (5, 7)), rel=1e-9)
    assert velocity.tolist() == [0.3] * 5 + [-0.1] * 7


def test_a_fixed_grain_is_not_displaced() -> None:
    """Grain N of a chain with a fixed bottom is not displaced."""
    displacement, _ = Riemann(velocity=(0, 0), strain=(1e-4, 1e-4), grain=5).initial(LOADED)
    assert displacement[-1] == 0
    assert displacement[0] == pytest.approx(11e-7)


def test_piece_of_a_chain_has_the_same_step() -> None:
    """Grains of a part start as in the whole chain."""
    step = Riemann(velocity=(0.3, 0), strain=(2e-4, 0), grain=5)
    whole = step.initial(LOADED)
    assert step.reach(LOADED) == (1, 5)
    assert step.scaled(2.0).strain.tolist() == [4e-4, 0.0]
    for values, expected in zip(step.part(2, 9).initial(LOADED.part(2, 9)), whole, strict=True):
        assert values == pytest.approx(expected[1:9])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"strain": (0, 0, 0)}, "strain: must have two entries"),
        ({"grain": 12}, "grain: must be at most 11"),
        ({"velocity": (0, 1)}, "velocity: must be 0 on the right"),
        ({"strain": (0.9, 0)}, "velocity: squeezes contact"),
    ],
)
def test_invalid_steps(keys, message) -> None:
    """A step that does not fit the chain is rejected in one line."""
    keys = {"velocity": (0, 0), "strain": (0, 0), "grain": 3} | keys
    with pytest.raises(InputError, match=message):
        Scene(chain=LOADED, excitation=Riemann(**keys), duration=1e-4)


def test_piston_rises_along_straight_lines() -> None:
    """The acceleration is a triangle whose area is the speed, and the motion its integrals."""
    rise = PISTON.rise
    time = np.linspace(0, 3 * rise, 30001)
    hat = np.interp(time / rise, [0, 0.5, 1, 3], [0, 2 * 0.02 / rise, 0, 0])
    assert relative(PISTON.acceleration(time), hat) < 1e-12
    step = time[1]
    speed = np.append(0, np.cumsum((hat[1:] + hat[:-1]) / 2)) * step
    assert relative(PISTON.motion(time)[1], speed) < 1e-8
    path = np.append(0, np.cumsum((speed[1:] + speed[:-1]) / 2)) * step
    assert relative(PISTON.motion(time)[0], path) < 1e-7
    assert PISTON.motion(9 * rise)[0] == pytest.approx(0.02 * 8.5 * rise, rel=1e-14)


def test_piston_needs_speed_and_rise() -> None:
    """A piston without a rise is rejected with the alternatives."""
    with pytest.raises(InputError, match='give shape = "piston", velocity and rise'):
        Drive(shape="piston", velocity=0.1)
    with pytest.raises(InputError, match="rise: corresponds to"):
        Drive(shape="piston", velocity=0.1, rise=1e-25)


def test_piston_in_lammps() -> None:
    """LAMMPS moves the wall at constant speed long after the start, as the native engine does."""
    chain = LOADED.replace(top="wall", bottom="wall")
    piston = PISTON.replace(grain=0)
    scene = Scene(chain=chain, excitation=piston, duration=1e-4, samples=51)
    native = simulate(scene, engine="native")
    lammps = simulate(scene, engine="lammps")
    assert relative(lammps.velocity, native.velocity) < 1e-3
