"""Echoes of pulses, against an independent integration by SciPy and exact solitary waves."""

import numpy as np
import pytest
from helpers.changed_recordings import of_error
from helpers.example_scenes import run
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from lmpchain import Chain, Force, Impulse, InputError, Scene, simulate
from lmpchain.measure import echo, flight
from lmpchain.measure.motion import motion_of
from lmpchain.theory import soliton

BEADS = {"diameter": 5e-3, "material": "steel", "gravity": 0.0}


def time_of(chain: Chain, velocity: float, grains: float) -> float:
    """Return the travel time of a pulse or of sound over a number of grains, s."""
    if chain.compressed:
        return grains * float(np.sqrt(chain.masses[0] / chain.linear_stiffness[0]))
    speed = 0.90747 * (chain.contact_constants[0] / chain.masses[0]) ** 0.4
    return float(grains / (speed * (0.6816 * velocity) ** 0.2))


def exact_peaks(chain: Chain, velocity: float, grain: int, duration: float) -> tuple[float, float]:
    """Return the times of the largest power downward and upward, from Eq. (1) and SciPy."""
    contacts = chain.contacts
    constants = contacts.constant
    rest = contacts.force
    at_rest = contacts.overlap
    exists = contacts.exists

    def change(u: np.ndarray) -> np.ndarray:
        overlap = at_rest.copy()
        overlap[1:] += u
        overlap[:-1] -= u
        return np.where(exists, constants * np.maximum(overlap, 0.0) ** 1.5 - rest, 0.0)

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        u, v = state.reshape(2, -1)
        force = change(u)
        pull = (force[:-1] - force[1:]) / chain.masses
        pull[chain.movable :] = 0.0
        return np.append(v, pull)

    begin = np.zeros(2 * chain.grains)
    begin[chain.grains] = velocity
    answer = solve_ivp(
        rate, (0, duration), begin, "DOP853", dense_output=True, rtol=1e-11, atol=1e-18
    )

    def power(t: float) -> float:
        u, v = answer.sol(t).reshape(2, -1)
        force = change(u)
        return float((force[grain - 1] + force[grain]) / 2 * v[grain - 1])

    times = np.linspace(0, duration, 1000)
    values = np.array([power(t) for t in times])
    found = []
    for sign in (1, -1):
        top = int((sign * values).argmax())
        best = minimize_scalar(
            lambda t, sign=sign: -sign * power(t),
            bounds=(times[top - 1], times[top + 1]),
            method="bounded",
            options={"xatol": 1e-13},
        )
        found.append(float(best.x))
    return found[0], found[1]


@pytest.mark.parametrize(
    ("changes", "velocity", "reflector", "inverted"),
    [
        ({"bottom": "wall"}, 0.1, None, False),
        ({"bottom": "wall", "impurity": [{"grain": 21, "diameter": 9e-3}]}, 0.1, 21, False),
        ({"top_load": 10.0, "bottom": "fixed"}, 1e-3, None, False),
        ({"top_load": 10.0, "material": ["steel"] * 20 + ["ptfe"] * 6}, 1e-3, 21, True),
    ],
)
def test_time_of_flight_agrees_with_an_independent_integration(
    changes: dict, velocity: float, reflector: int | None, inverted: bool
) -> None:
    """The time between the two largest powers is right within the stated error, for each end."""
    chain = Chain(**{"grains": 26} | BEADS | changes)
    place = reflector or 26
    # The run ends soon after the echo and has four samples per grain that the wave passes.
    grains = 2 * place - 8 + (8 if reflector is None else 4)
    duration = time_of(chain, velocity, grains)
    out, back = exact_peaks(chain, velocity, 8, duration)
    assert back > out
    t = run(chain, Impulse(velocity=velocity), duration, 1 + 4 * grains)
    found = echo.find(t, 8, reflector, least=0.01)
    assert abs(found.seconds - (back - out)) <= found.error < 0.01 * found.seconds
    assert found.inverted == inverted
    assert 0.02 < found.share < 1
    assert found.distance / 5e-3 == pytest.approx(2 * (place - 8), abs=1.01)


def test_errors_cover_coarse_sampling(rng: np.random.Generator) -> None:
    """Times and energies of echoes in random chains are right within their errors.

    Behind the first pulse there are weak ones, and `least` determines which of them is the echo.
    """
    near = []
    for load in (0.0, 10.0):
        chain = Chain(grains=24, bottom="wall", top_load=load, **BEADS)
        velocity = 10 ** rng.uniform(-2, -1)
        duration = time_of(chain, velocity, 48)
        chain = chain.replace(diameter=5e-3 * rng.uniform(0.9, 1.1, 24))
        samples = int(rng.integers(150, 500))
        coarse, fine = (
            run(chain, Impulse(velocity=velocity), duration, 1 + size)
            for size in (samples, 8 * samples)
        )
        for least in np.geomspace(3e-3, 0.1, 4):
            found, true = (echo.find(t, 8, least=least) for t in (coarse, fine))
            assert abs(found.seconds - true.seconds) <= found.error + true.error
            assert abs(found.share - true.share) <= found.share_error + true.share_error
            near.append(found.error < 0.01 * found.seconds)
            out, back = found.pulses[:2]
            assert found.error >= out.error + back.error
            relative = sum(abs(pulse.energy_error / pulse.energy) for pulse in (out, back))
            assert found.share_error >= found.share * relative * (1 - 1e-12)
    assert np.mean(near) > 0.5


def test_a_solitary_wave_comes_back_at_the_exact_speed() -> None:
    """Exact solitary waves have the same travel times, apart from the delay at the wall."""
    chain = Chain(grains=80, bottom="wall", **BEADS)
    t = run(chain, Impulse(velocity=0.1), time_of(chain, 0.1, 150), 5001)
    upper, lower = (echo.find(t, grain) for grain in (35, 55))
    constant = chain.contact_constants[0] / chain.masses[0]
    # V = C (K/m)^(2/5) v^(1/5) grains/s for the largest velocity v of a grain.
    unit = soliton.solve(velocity=1.0).speed * constant**0.4
    expected = 0.0
    for number, direction in ((0, 1), (1, -1)):
        window = np.abs(t.time - upper.pulses[number].time) < 5e-5
        speed = float((direction * t.velocity[window, 34]).max())
        expected += 20 / (unit * speed**0.2)
    assert upper.seconds - lower.seconds == pytest.approx(expected, rel=2e-5)
    # The other measure takes the larger of two peaks, here that of the same pulse.
    assert flight.arrival(t.time, upper.power).time == pytest.approx(upper.pulses[0].time, rel=1e-7)


def test_energy_of_pulses_is_that_of_the_chain() -> None:
    """The downward energy past a grain is the strike energy minus the part that stays above."""
    chain = Chain(grains=30, bottom="wall", **BEADS)
    t = run(chain, Impulse(velocity=0.1), time_of(chain, 0.1, 60), 2001)
    pulses = echo.find(t, 10).pulses
    strike = chain.masses[0] * 0.1**2 / 2
    assert pulses[0].energy == pytest.approx(strike, rel=0.02)
    assert pulses[0].energy < strike
    assert pulses[1].energy < 0 < pulses[1].force


def test_missing_echoes_are_rejected_and_pictures_have_labels() -> None:
    """A run that ends before the echo, or a wrong reflector, raises an error."""
    chain = Chain(grains=24, bottom="wall", **BEADS)
    t = run(chain, Impulse(velocity=0.1), time_of(chain, 0.1, 48), 801)
    with pytest.raises(InputError, match="no echo"):
        echo.find(run(chain, Impulse(velocity=0.1), 1.2e-4, 201), 8)
    for reflector in (-1, 8, 26):
        with pytest.raises(InputError, match="another grain"):
            echo.find(t, 8, reflector)
    with pytest.raises(InputError, match="between 0 and 1"):
        echo.find(t, 8, least=2.0)
    # Walls are half a diameter beyond the last grains.
    for reflector, diameters in ((None, 16.5), (25, 16.5), (24, 16), (1, 7), (0, 7.5)):
        distance = echo.find(t, 8, reflector).distance
        assert distance == pytest.approx(2 * diameters * 5e-3, rel=1e-12)
    found = echo.find(t, 8)
    assert found.speed == pytest.approx(found.distance / found.seconds, rel=1e-14)
    axes = found.plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time", "power through the grain")
    assert axes.get_title("left").startswith("Grain 8: echo after ")
    whole, down, up = axes.lines
    assert np.array_equal(whole.get_xydata().T, [found.time, found.power])
    for line, downward in ((down, True), (up, False)):
        times = [pulse.time for pulse in found.pulses if pulse.downward == downward]
        assert line.get_xdata() == pytest.approx(times, rel=1e-12)
        heights = np.interp(times, found.time, found.power)
        assert line.get_ydata() == pytest.approx(heights, rel=1e-12)
        assert line.get_label() == f"pulse that goes {'down' if downward else 'up'}"
    # An error e of all motion changes force and velocity by e, and energies by 2 e.
    unknown, rough = (of_error(t, error) for error in (np.inf, 1e-4))
    part = 2 * motion_of(rough).known_error("velocity") / np.abs(t.velocity).max()
    assert part >= 2e-4
    one, other = (echo.find(each, 8) for each in (unknown, rough))
    for before, after in zip(one.pulses, other.pulses, strict=True):
        more = after.energy_error - before.energy_error
        assert more == pytest.approx(part * abs(after.energy), rel=1e-9)
    assert other.share_error - one.share_error == pytest.approx(2 * part * other.share, rel=1e-6)
    push = Force(grain=1, shape="half-sine", amplitude=1e-9, duration=1e-3)
    still = simulate(Scene(chain=chain, excitation=push, duration=1e-9), "native")
    with pytest.raises(InputError, match="0 pulses"):
        echo.find(still, 20)
