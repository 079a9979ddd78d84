"""Stated sizes of excitations against the motion that they cause."""

import numpy as np
import pytest
from helpers.example_scenes import scene_of

from lmpchain import Chain, Displacement, Drive, Impulse, InputError, Profile, simulate
from lmpchain.engines.linear.model_error import expected_error
from lmpchain.scene.base import Excitation

CHAIN = Chain(grains=12, diameter=1e-3, gravity=0.0, top_load=1e-3)
PATH = np.append(0.0, np.random.default_rng(4).normal(size=8) * 1e-13)
WEAK: dict[str, Excitation] = {
    "impulse": Impulse(velocity=-1e-9, grain=3),
    "displacement": Displacement(displacement=2e-14, grain=12 - 1),
    "profile": Profile(displacement=np.linspace(1e-13, 0, 12)),
    "moving profile": Profile(
        velocity=np.linspace(1e-9, 0, 12), displacement=np.linspace(1e-13, 0, 12)
    ),
    "drive": Drive(amplitude=-1e-13, frequency=3e4),
    "sampled drive": Drive(times=np.linspace(0, 1e-4, 9), displacement=PATH),
}
every = pytest.mark.parametrize("excitation", WEAK.values(), ids=WEAK)


@every
def test_the_motion_of_springs_has_the_stated_size(excitation: Excitation) -> None:
    springs = Chain(**CHAIN.given() | {"exponent": 1.0})
    once, thrice = (
        simulate(scene_of(springs, e, 1e-4, 201), engine="native", tolerance=1e-9)
        for e in (excitation, excitation.scaled(3))
    )
    for single, triple in (
        (once.displacement, thrice.displacement),
        (once.velocity, thrice.velocity),
    ):
        assert triple == pytest.approx(3 * single, rel=0, abs=1e-8 * np.abs(triple).max())
    assert excitation.scaled(1.0) == excitation


@every
def test_energy_is_conserved_unless_work_is_done(excitation: Excitation) -> None:
    run = simulate(scene_of(CHAIN, excitation, 1e-4, 201), engine="native", tolerance=1e-9)
    energy = CHAIN.excess_energy(run.displacement, run.velocity)
    assert (np.ptp(energy) > 1e-3 * energy.max()) == excitation.does_work
    still = run.velocity[:, : excitation.driven], run.displacement[:, : excitation.driven]
    if isinstance(excitation, Drive):
        assert still[1][:, 0] == pytest.approx(excitation.motion(run.time)[0], rel=1e-12, abs=1e-28)
    assert (still[0].size > 0) == isinstance(excitation, Drive)


def test_the_input_of_a_harmonic_drive_is_bounded() -> None:
    """Contacts and undriven grains never have more energy than the bound."""
    stiffness = CHAIN.contacts.stiffness
    masses = CHAIN.masses
    for sign in (1, -1):
        for frequency in (2e3, 3e4, CHAIN.band_edge / 8):
            drive = Drive(amplitude=sign * 1e-13, frequency=frequency)
            run = simulate(scene_of(CHAIN, drive, 1e-4, 201), engine="modes", tolerance=1e-4)
            closer = CHAIN.contacts.closer(run.displacement)
            energy = closer**2 @ stiffness / 2 + run.velocity[:, 1:] ** 2 @ masses[1:] / 2
            bound = np.array([drive.energy_norm(CHAIN, t) for t in run.time])
            assert (np.sqrt(2 * energy) <= bound * (1 + 1e-9)).all()


def test_the_sign_of_a_drive_does_not_change_the_error_of_linear_theory() -> None:
    """A negative bound would make linear theory exact; it once occurred for upward drives."""
    for amplitude in (1e-12, 2e-9):
        down, up = (
            expected_error(scene_of(CHAIN, Drive(sign * amplitude, 1e4), 1e-4, 201))
            for sign in (1, -1)
        )
        assert 0 < down <= 1
        assert up == down


def test_labels_of_impulses_have_convenient_units() -> None:
    for velocity, text in (
        *((8.57e-4, "0.857 mm/s"), (1e-5, "0.01 mm/s"), (9.9e-6, "9.9 µm/s")),
        *((-2.5, "-2.5 m/s"), (1.0, "1 m/s"), (0.99, "990 mm/s")),
    ):
        assert Impulse(velocity=velocity).label == f"an impulse of {text}"
    assert Impulse(velocity=1e-3).strikes_top


def test_profiles_of_one_chain_add_up():
    moved = Profile(displacement=[1e-9, 0.0, 2e-9])
    struck = Profile(velocity=[0.0, 1e-3, 0.0])
    total = moved + struck
    assert total.displacement.tolist() == [1e-9, 0.0, 2e-9]
    assert total.velocity.tolist() == [0.0, 1e-3, 0.0]
    assert (total + struck).velocity.tolist() == [0.0, 2e-3, 0.0]
    with pytest.raises(InputError, match="displacement: profiles that are added must be of one"):
        moved + Profile(velocity=[1e-3, 0.0])
    with pytest.raises(TypeError):
        moved + 1.0
