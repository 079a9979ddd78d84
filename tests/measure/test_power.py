"""Power through contacts, compared with scattering theory, energy input and output."""

from functools import cache

import numpy as np
import pytest
from helpers.changed_recordings import of_error, part_of
from helpers.example_chains import column
from helpers.example_scenes import run

from lmpchain import Chain, Drive, Force, Impulse, InputError, Trajectory, patterns, simulate
from lmpchain.measure import energy, power
from lmpchain.measure.motion import motion_of
from lmpchain.theory import scattering

CHAIN = column(
    60, gravity=0.0, top_load=1.0, bottom="wall", impurity=[{"grain": 30, "diameter": 1.6e-3}]
)
FREQUENCY = 0.15 / CHAIN.time_scale


@cache
def pushed(amplitude: float) -> Trajectory:
    """Simulate a force on a grain between absorbing boundaries for 150 periods."""
    chain = patterns.absorbing(CHAIN, bottom=60, top=60)
    push = Force(grain=80, amplitude=amplitude, frequency=FREQUENCY)
    return run(chain, push, 150 / FREQUENCY, 3001, 1e-6)


def test_power_of_weak_waves_agrees_with_scattering_theory() -> None:
    """The power behind an impurity, relative to an endless chain, agrees with theory to 3e-4."""
    omega = 2 * np.pi * FREQUENCY
    stiffness = float(CHAIN.linear_stiffness[0])
    q = 2 * np.arcsin(omega / 2 * np.sqrt(float(CHAIN.masses[0]) / stiffness))
    # The incoming power is half of omega k sin(q) |u|^2 of the wave u = F / (2 k sin q).
    incoming = 1e-4**2 * omega / (8 * stiffness * np.sin(q))
    passed = power.through(pushed(1e-4), 100)
    theory = float(scattering.transmission(CHAIN, omega).transmitted)
    assert passed.mean / incoming == pytest.approx(theory, rel=3e-4)
    # Linear theory of the same chain, with its absorbing boundaries.
    assert passed.mean == pytest.approx(passed.linear, abs=passed.error)
    assert passed.error < 1e-5 * passed.mean
    assert passed.share == pytest.approx(passed.linear_share, abs=passed.share_error)


def test_power_into_an_undamped_part_equals_power_out_of_it() -> None:
    """In an undamped part, the mean power is the same in every contact."""
    means = [power.through(pushed(1e-2), contact).mean for contact in (82, 89, 95, 110)]
    assert means == pytest.approx([means[0]] * 4, rel=1e-5)


def test_input_equals_the_work_in_the_ledger() -> None:
    """The mean power of a force and of both kinds of drives agrees with the ledger."""
    chain = patterns.absorbing(CHAIN.replace(top="wall", impurity=[]), bottom=60)
    for drive in (
        Force(grain=3, amplitude=1e-4, frequency=FREQUENCY),
        Drive(grain=0, amplitude=1e-10, frequency=FREQUENCY),
        Drive(grain=1, amplitude=1e-10, frequency=FREQUENCY),
    ):
        t = run(chain, drive, 80 / FREQUENCY, 1601, 1e-7)
        work = energy.ledger(t).drive
        mean = (work[-1] - work[800]) / (t.time[-1] - t.time[800])
        passed = power.through(t, 20)
        assert passed.periods == 40
        assert passed.input == pytest.approx(mean, rel=1e-4)
        assert passed.linear_input == pytest.approx(mean, rel=1e-3)
        # All power flows downward.
        assert passed.linear_share == pytest.approx(1, abs=1e-9)
        assert passed.share == pytest.approx(1, abs=1e-3)


def test_the_share_decreases_with_amplitude_beyond_the_errors() -> None:
    """Harmonics and a slower wave reduce the share of a strong force."""
    weak = power.through(pushed(1e-4), 100)
    strong = power.through(pushed(0.3), 100)
    assert weak.share - strong.share > 3 * (weak.share_error + strong.share_error)


@pytest.mark.parametrize(("drag", "periods"), [(2.0, 25), (30.0, 60), (6000.0, 23)])
def test_errors_cover_what_is_left_of_transients(drag: float, periods: int) -> None:
    """Until a damped chain moves steadily, the errors cover the distance from linear theory."""
    chain = CHAIN.replace(grains=28, impurity=[], top="wall", damping={"drag": drag})
    for body, frequency in ((0, 0.7 * FREQUENCY), (1, FREQUENCY), (0, 1.4 * FREQUENCY)):
        drive = Drive(grain=body, amplitude=1e-13, frequency=frequency)
        t = run(chain, drive, periods / frequency, 16 * periods + 1, 1e-7)
        for contact in (3, 20):
            passed = power.through(t, contact)
            assert abs(passed.mean - passed.linear) <= passed.error
            assert abs(passed.input - passed.linear_input) <= passed.input_error


def test_the_picture_has_the_range_the_mean_theory_and_the_share() -> None:
    """Without the driven grain, the power of the drive and its share are unknown."""
    t = pushed(1e-4)
    passed = power.through(t, 100)
    ax = passed.plot()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time", "power")
    mean, linear = ax.lines
    begin = t.time[-1] - passed.periods / FREQUENCY
    assert mean.get_xdata() == pytest.approx([begin, t.time[-1]], rel=1e-9)
    assert mean.get_ydata().tolist() == [passed.mean, passed.mean]
    assert np.asarray(linear.get_ydata()).tolist() == [passed.linear, passed.linear]
    assert [line.get_label().split(",")[0] for line in ax.lines] == ["mean", "linear"]
    (band,) = ax.collections
    places = band.get_paths()[0].vertices
    assert (places[:, 1].min(), places[:, 1].max()) == (passed.power.min(), passed.power.max())
    assert f"{100 * passed.share:.5g} % of that of the drive" in ax.get_title("left")
    error = passed.error + passed.share * passed.input_error
    assert passed.share_error == pytest.approx(error / passed.input, rel=1e-9)
    alone = power.through(part_of(t, columns=slice(95, 104)), 100)
    assert alone.mean == pytest.approx(passed.mean, rel=1e-9)
    assert np.isnan([alone.input, alone.input_error, alone.share]).all()
    assert "drive" not in alone.plot().get_title("left")


def test_errors_of_powers_include_the_error_of_the_motion() -> None:
    """An error e of all motion changes force and velocity by e, and the power by 2 e."""
    t = pushed(1e-4)
    unknown, rough = (of_error(t, error) for error in (np.inf, 1e-4))
    part = 2 * motion_of(rough).known_error("velocity") / np.abs(t.velocity).max()
    one, other = (power.through(each, 100) for each in (unknown, rough))
    more = other.error - one.error
    assert more == pytest.approx(part * np.abs(one.power).max(), rel=1e-6)
    driven = t.scene.excitation.waveform.at(t.time) * t.velocity[:, 79]
    more = other.input_error - one.input_error
    assert more == pytest.approx(part * np.abs(driven).max(), rel=1e-6)


def test_unsteady_runs_are_rejected() -> None:
    """Each mistake raises an error of one line with its key."""
    t = pushed(1e-4)
    assert power.through(t, 100, 6).periods == 6
    for arguments, key in (
        ((500,), "contact"),
        ((-1,), "contact"),
        ((0,), "contact"),
        ((100, 5), "periods"),
        ((100, 151), "periods"),
    ):
        with pytest.raises(InputError, match=f"^{key}"):
            power.through(t, *arguments)
    short = t.scene.replace(samples=201)
    with pytest.raises(InputError, match="samples: must be 1201"):
        power.through(simulate(short, "native", 1e-3), 100)
    push = short.excitation
    for other in (Impulse(velocity=1e-6), push.replace(amplitude=0.0), push.replace(cycles=3)):
        t = simulate(short.replace(excitation=other), "native", 1e-3)
        with pytest.raises(InputError, match="excitation: must be a drive"):
            power.through(t, 100)


def test_viscous_contacts_absorb_their_part_of_the_power() -> None:
    """The share of a driven grain with a wall above includes the power that the wall returns."""
    level = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0, "top": "wall", "bottom": "wall"}
    chain = Chain(grains=12, damping={"viscoelastic": 0.05 / (2 * np.pi * FREQUENCY)}, **level)
    drive = Drive(grain=1, amplitude=1e-10, frequency=FREQUENCY)
    t = run(chain, drive, 80 / FREQUENCY, 1601, 1e-7)
    ledger = energy.ledger(t)
    elapsed = t.time[-1] - t.time[800]
    passed = power.through(t, 5)
    given = (ledger.drive[-1] - ledger.drive[800]) / elapsed
    lost = (ledger.dissipated[-1] - ledger.dissipated[800]) / elapsed
    assert given == pytest.approx(lost, rel=1e-3)
    assert passed.input == pytest.approx(given, rel=1e-3)
    assert passed.linear_input == pytest.approx(given, rel=1e-3)
    assert 0 < passed.share < 1
    assert passed.share == pytest.approx(passed.linear_share, rel=1e-3)
