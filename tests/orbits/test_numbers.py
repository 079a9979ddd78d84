"""Text, pictures and multipliers of orbits, guesses, refusals, and paths between orbits."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.independent_theory import dense_modes
from helpers.oscillator_period import oscillator_period

from lmpchain import Chain, Drive, InputError, Profile, orbits, simulate
from lmpchain.errors import RunFailed
from lmpchain.orbits import Orbit, events
from lmpchain.orbits.events import Aspect
from lmpchain.orbits.flow import Flow
from lmpchain.orbits.shooting import Equations, OrbitPoint

CHAIN = Chain(grains=4, diameter=1e-3)
SCALE = CHAIN.length_scale * CHAIN.masses[0] * 9.81


@cache
def orbit() -> Orbit:
    return orbits.normal_mode(CHAIN, 2, 0.1 * SCALE)


@cache
def unstable() -> Orbit:
    """Return an orbit with a real and a complex unstable direction, in which contacts open."""
    return orbits.normal_mode(CHAIN.replace(grains=6), 3, 60 * SCALE)


def test_the_numbers_of_an_orbit_are_written():
    one = orbit()
    json = one.to_json()
    assert json["period_s"] * json["frequency_hz"] == pytest.approx(1, rel=1e-15)
    assert json["period_s"] == one.period
    assert json["energy_J"] == one.energy == pytest.approx(0.1 * SCALE, rel=1e-10)
    assert json["amplitude_m"] == one.amplitude == np.abs(one.motion()[1]).max()
    assert (json["residual"], json["error"], json["stable"]) == (one.residual, one.error, True)
    pairs = np.array(json["multipliers"]) @ [1, 1j]
    np.testing.assert_array_equal(pairs, one.multipliers)
    assert json["displacement_m"] == one.displacement.tolist()
    assert json["velocity_m_per_s"] == one.velocity.tolist()
    assert len(json) == 10


def test_a_motion_covers_the_period():
    one = orbit()
    time, u, v = one.motion()
    assert (time[0], time[-1]) == pytest.approx((0, one.period), rel=1e-12)
    np.testing.assert_allclose(np.diff(time), one.mesh * one.period, rtol=1e-9)
    np.testing.assert_array_equal([u[0], v[0]], [one.displacement, one.velocity])
    left = max(np.abs(x[-1] - x[0]).max() / np.abs(x).max() for x in (u, v))
    assert one.residual == pytest.approx(left, rel=1e-12)
    assert one.scene(2.5, 7).duration == pytest.approx(2.5 * one.period, rel=1e-15)
    assert (one.scene().samples, one.scene().duration) == (101, one.period)


def test_a_picture_has_the_displacements_at_eighths_of_the_period():
    one = orbit()
    time, u, _ = one.motion()
    ax = one.plot()
    labels = ["at t = 0", "T/8", "T/4", "3T/8", "T/2"]
    assert [line.get_label() for line in ax.lines] == labels
    for number, line in enumerate(ax.lines):
        np.testing.assert_array_equal(line.get_xdata(), [1, 2, 3, 4])
        assert line.get_linewidth() == 1
        row = u[np.abs(time - number * one.period / 8).argmin()]
        np.testing.assert_array_equal(line.get_ydata(), row)
    assert len({line.get_color() for line in ax.lines}) == 5
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("grain", "displacement")
    assert ax.yaxis.get_major_formatter()(2e-9) == "2 nm"
    assert [text.get_text() for text in ax.get_legend().get_texts()] == labels


def test_an_unstable_direction_grows_by_its_multiplier():
    """M x = l x for the tangent map, with largest displacement 1 m, for all unstable directions."""
    one = unstable()
    count = one.unstable.size
    assert not one.stable
    assert (np.abs(one.unstable) >= 1 + 1e-6).all()
    assert np.abs(one.unstable[0]) == np.abs(one.multipliers).max()
    assert sorted(one.unstable.imag != 0) == [False, True, True]
    for number, growth in enumerate(one.unstable, 1):
        u, v = one.direction(number)
        assert np.abs(u).max() == pytest.approx(1, rel=1e-12)
        x = one.flow.canonical(u, v).ravel()
        values, vectors = np.linalg.eig(one.monodromy)
        vector = vectors[:, np.abs(values - growth).argmin()]
        largest = np.abs(vector).argmax()
        # The largest component is real.
        assert x / x[largest] == pytest.approx((vector / vector[largest]).real, rel=0, abs=1e-6)
    u, v = one.direction()
    growth = one.unstable[0]
    away = simulate(
        one.scene(2, 3).replace(excitation=one.perturbed(1e-5)), "native", 1e-11
    ).displacement
    away = away - one.displacement
    expected = 2 * growth.real * away[1] - np.abs(growth) ** 2 * away[0]
    assert away[2] == pytest.approx(expected, abs=1e-3 * np.abs(away).max())
    begun = one.perturbed(1e-3)
    np.testing.assert_allclose(
        begun.displacement - one.displacement, 1e-3 * one.amplitude * u, rtol=1e-6
    )
    speed = np.abs(v).max() * 1e-3 * one.amplitude
    np.testing.assert_allclose(
        begun.velocity - one.velocity, 1e-3 * one.amplitude * v, rtol=1e-6, atol=1e-9 * speed
    )
    for number in (0, count + 1):
        with pytest.raises(
            InputError, match=f"^number: the orbit has {count} unstable directions: .* {number}$"
        ):
            one.direction(number)
    with pytest.raises(InputError, match=r"^number: the orbit is stable: there is no direction 1"):
        orbit().direction()


def test_a_linear_mode_has_the_requested_strain():
    for strain in (1e-3, 0.2):
        u, period = orbits.linear_mode(CHAIN, 2, strain)
        change = np.diff(u) / CHAIN.contacts.overlap[1:4]
        assert np.abs(change).max() == pytest.approx(strain, rel=1e-12)
    assert np.abs(orbits.linear_mode(CHAIN, 2)[0] - u / 200).max() < 1e-12 * np.abs(u).max()
    assert 2 * np.pi / period == pytest.approx(np.sqrt(dense_modes(CHAIN)[0][1]), rel=1e-10)
    for mode in (0, 4, True, 1.0, "1"):
        with pytest.raises(InputError, match=r"^mode: must be a whole number from 1 to 3 \(got "):
            orbits.linear_mode(CHAIN, mode)  # type: ignore[arg-type]


def test_invalid_guesses_and_periods_are_rejected(monkeypatch: pytest.MonkeyPatch):
    loaded = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1.0)
    sine = Drive(amplitude=1e-9, frequency=2e4)
    rest = np.zeros(4)
    u = 0.1 * CHAIN.length_scale * np.array([1, 0, 0, 0])

    def heavy(grain: int) -> Chain:
        masses = np.where(np.arange(1, 5) == grain, 3e-6, 1e-6)
        return loaded.replace(masses=masses, top="wall", bottom="wall")

    vacuum = loaded.replace(top_load=0.0, top="wall", bottom="wall")
    for message, call in {
        "energy: is not conserved in a driven":
            lambda: orbits.find(loaded, energy=1e-9, drive=sine),
        "period: must be a whole number of periods of the drive, 5e-05 s":
            lambda: orbits.find(loaded, drive=sine, period=1.2e-4),
        "guess: must be a Profile": lambda: orbits.find(CHAIN, 3.0, 1e-4),
        "guess: is missing, and a chain without compression":
            lambda: orbits.find(vacuum, drive=sine),
        "energy: must be a number above 0": lambda: orbits.find(CHAIN, (u, rest), 1e-4, energy=0.0),
        "period: must be a number above 0 (got inf)": lambda: orbits.find(CHAIN, (u, rest), np.inf),
        "period: must be a number above 0 (got True)": lambda: orbits.find(CHAIN, (u, rest), True),
        "grain: must be a whole number from 1 to 3 (got 4)":
            lambda: orbits.breather(loaded, 4, 1e-5),
        "grain: must be a whole number from 1 to 3 (got 0)":
            lambda: orbits.breather(loaded, 0, 1e-5),
        "grain: must be a whole number from 1 to 3 (got True)":
            lambda: orbits.breather(loaded, True, 1e-5),
        "grain: 1 has no heavier": lambda: orbits.breather(loaded, 1, 1e-5),
        # Each of the two neighbours may be the heavier one, but no other grain.
        "period: must be between": lambda: orbits.breather(heavy(1), 2, 1.0),
        "period: must be betwee": lambda: orbits.breather(heavy(3), 2, 1.0),
        "grain: 3 has no heavier": lambda: orbits.breather(heavy(1), 3, 1.0),
        "grain: 1 has no heavier neighbour": lambda: orbits.breather(heavy(3), 1, 1.0),
        "chain: must be compressed": lambda: orbits.breather(CHAIN, 1, 1e-5),
        "chain: must be compressed by": lambda: orbits.breather(vacuum, 1, 1e-5),
        "until: must be a number": lambda: orbits.follow(orbit(), "energy", True),
        "until: must be a number (got inf)": lambda: orbits.follow(orbit(), "energy", np.inf),
        "until: must be above 0 for the period (got 0)":
            lambda: orbits.follow(orbit(), "period", 0.0),
        "hold: must be": lambda: orbits.follow(orbit(), "gravity", 20.0, hold="mass"),
        "start: is missing": lambda: orbits.follow(orbit(), lambda _: CHAIN, 1.0),
        "parameter: amplitude requires a drive":
            lambda: orbits.follow(orbit(), "amplitude", 1e-9),
        "parameter: must be energy, period": lambda: orbits.follow(orbit(), "masses[5]", 1.0),
        "parameter: must be energy": lambda: orbits.follow(orbit(), "masses[0]", 1.0),
        "parameter: must be ener": lambda: orbits.follow(orbit(), "masses", 1.0),
        "parameter: must be en": lambda: orbits.follow(orbit(), "grains", 5.0),
        "parameter: must be e": lambda: orbits.follow(orbit(), "linear_stiffness[1]", 5.0),
    }.items():  # fmt: skip
        with pytest.raises(InputError) as error:
            call()
        assert str(error.value).startswith(message)
    driven = orbits.find(loaded, drive=sine)
    for parameter, hold, message in (
        ("energy", "period", "parameter: energy is not"),
        ("gravity", "energy", "hold:"),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            orbits.follow(driven, parameter, 1.0, hold=hold)
    monkeypatch.setattr(
        "lmpchain.orbits.modes.follow", lambda *_, **__: SimpleNamespace(reached=False, ended="x")
    )
    with pytest.raises(RunFailed, match=r"^the family of mode 2 does not reach 1e-12 J: x"):
        orbits.normal_mode(CHAIN, 2, 1e-12)


def test_guesses_of_all_types_are_accepted_and_drive_cycles_are_counted():
    one = orbit()
    profile = Profile(displacement=one.displacement, velocity=one.velocity)
    for guess in (profile, one, (one.displacement, one.velocity)):
        again = orbits.find(CHAIN, guess, one.period)
        assert again.displacement == pytest.approx(
            one.displacement, rel=1e-9, abs=1e-9 * one.amplitude
        )
        assert again.reversible
    assert orbits.find(CHAIN, one).period == one.period
    loaded = Chain(grains=4, diameter=1e-3, gravity=0.0, top_load=1.0)
    sine = Drive(amplitude=0.01 * loaded.length_scale, frequency=2e4)
    once = orbits.find(loaded, drive=sine)
    twice = orbits.find(loaded, drive=sine, period=1e-4)
    assert (once.period, twice.period) == pytest.approx((5e-5, 1e-4), rel=1e-12)
    assert twice.velocity == pytest.approx(once.velocity, rel=1e-9)
    assert twice.drive is not None
    assert twice.drive.frequency == pytest.approx(2e4, rel=1e-12)
    assert not once.reversible
    # The tangent map of two periods is the square of that of one period.
    assert np.sort(np.abs(np.angle(twice.multipliers))) == pytest.approx(
        np.sort(np.abs(np.angle(once.multipliers**2))), rel=1e-7
    )


def test_a_single_light_grain_has_the_amplitude_of_its_period():
    """The period is a quadrature over both contacts to fixed neighbours, one of which opens."""
    masses = [3e-3, 1e-3, 3e-3]
    walls = {"top": "wall", "bottom": "wall"}
    chain = Chain(grains=3, diameter=1e-2, gravity=0.0, top_load=20.0, masses=masses, **walls)
    k = chain.contact_constants[0]
    eps = chain.contacts.overlap[1]

    def period(amplitude: float) -> float:
        return oscillator_period(amplitude, k, eps, 1e-3)

    from lmpchain.orbits.modes import amplitude_alone

    for relative in (0.4, 2.0):
        amplitude = relative * eps
        assert amplitude_alone(chain, 2, period(amplitude)) == pytest.approx(amplitude, rel=1e-4)
    with pytest.raises(InputError) as error:
        orbits.breather(chain, 2, 1.0)
    words = str(error.value).split()
    assert words[:4] == ["period:", "must", "be", "between"]
    bounds = [float(words[4]), float(words[6])]
    reach = [period(a * eps) for a in np.geomspace(1e-4, 1e2, 100)[40:]]
    assert bounds == pytest.approx([min(reach), max(reach)], rel=1e-4)


def between_places(here: np.ndarray, there: np.ndarray) -> tuple[Any, Any]:
    """Return two members of a family with a straight or a curved path."""
    straight = (there - here) / np.linalg.norm(there - here)
    orbit: Any = SimpleNamespace(error=1e-9)
    return tuple(SimpleNamespace(unknown=x, direction=straight, orbit=orbit) for x in (here, there))


def test_a_known_orbit_near_the_path_is_found():
    """Known orbits are on, near and far from the path; the solved orbit in the plane decides."""
    flow = Flow(CHAIN, 1e5)
    equations = Equations(lambda _: flow, True, 1.0)
    here, there = between_places(np.array([1.0, 0.0, 0.0, 2.0]), np.array([3.0, 0.0, 0.0, 2.0]))
    asked = []

    def solver(shift: float) -> Any:
        def solved(guess: OrbitPoint, constraint: Any, near: Any) -> Any:
            assert near is there
            unknown = equations.pack(guess)
            left, row = constraint.of(unknown, guess)
            np.testing.assert_allclose(row, [1.0, 0, 0, 0], atol=1e-12)
            asked.append((unknown[0], left))
            exact = unknown - left * row
            exact[0] += shift
            return SimpleNamespace(point=equations.unpack(exact))

        return solved

    def meets(known: list[float], shift: float = 0.0, error: float = 0.0) -> bool:
        return events.returns(
            solver(shift), equations, [Aspect(np.array(known), error)], here, there
        )

    on = [2.2, 0.0, 0.0, 2.0]
    assert meets(on)
    assert asked[0][0] == pytest.approx(2.2, abs=2 / 64)
    assert asked[0][1] == pytest.approx(asked[0][0] - 2.2, abs=1e-12)
    assert not meets(on, 1e-6)
    assert meets(on, 3e-8)  # The distance is within ten times the error of 1e-9, and 1e-8.
    assert not meets(on, 5e-8)
    assert meets(on, 1e-6, 1e-7)
    count = len(asked)
    assert not meets([2.2, 0.15, 0.0, 2.0])  # The distance to the path is more than a twentieth.
    assert not meets([5.5, 0.0, 0.0, 2.0])
    assert len(asked) == count
    assert not meets([2.2, 0.08, 0.0, 2.0])  # The orbit is near, but different.
    assert len(asked) == count + 1
    assert not events.returns(solver(0.0), equations, [Aspect(here.unknown, 0.0)], here, there)
    assert not events.returns(lambda *_: None, equations, [Aspect(np.array(on), 0.0)], here, there)
    # The path is a cubic along the directions of both members.
    here.direction = np.array([0.0, 1.0, 0.0, 0.0])
    bow = [2.0, 2 * 0.125, 0.0, 2.0]
    there.direction = np.array([0.0, -1.0, 0.0, 0.0])
    assert meets([2.0, 2 * 0.25, 0.0, 2.0]) != meets(bow)
