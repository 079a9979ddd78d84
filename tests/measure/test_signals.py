"""Forces, arrivals and spectra of motions given by formulas."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of, struck
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar
from scipy.signal import get_window

from lmpchain import Chain, Drive, Force, Impulse, InputError, Trajectory, engines, simulate
from lmpchain.measure.bodies import known_contacts, motion, motion_of_all
from lmpchain.measure.contact import contacts, drive_force, drive_motion, sensor, wall_force
from lmpchain.measure.crests import summit
from lmpchain.measure.flight import Flight, arrival, time_of_flight
from lmpchain.measure.motion import peaks
from lmpchain.measure.recorded import check, check_field, columns, leaves_rest
from lmpchain.measure.spectrum import cut_off, dispersion, spectrum, travel_time

Array = NDArray[np.float64]
RNG = np.random.default_rng(8)


def noise(grains: Any = "all", samples: int = 21, **chain: Any) -> Trajectory:
    """Return displacements as large as overlaps, and random velocities, of an uneven chain."""
    given = {"grains": 9, "diameter": np.linspace(1e-3, 1.5e-3, 9), "top_load": 1e-3} | chain
    scene = scene_of(Chain(**given), Impulse(velocity=1e-6), 2e-5, samples, grains=grains)
    t = simulate(scene, engines.Native(step=1e-7))
    u, v = RNG.normal(size=(2, *t.displacement.shape))
    still = t.grains > scene.chain.movable
    u[:, still] = 0.0
    v[:, still] = 0.0
    return replace(t, displacement=scene.chain.contacts.overlap.max() * u, velocity=1e-3 * v)


@pytest.mark.parametrize(
    "ends",
    [
        {},
        {"bottom": "wall"},
        {"top": "wall", "bottom": "wall", "exponent": 2.0},
        {"bottom": "wall", "damping": {"viscoelastic": 3e-6}},
    ],
)
def test_overlaps_and_forces_of_any_motion(ends: dict[str, Any]):
    """The overlap is o = eps + phi_n - phi_(n+1); the force is (1 + A d/dt) K o^delta, or 0."""
    t = noise(**ends)
    chain = t.scene.chain
    seen = contacts(t)
    zero = np.zeros((21, 1))
    u, v = (np.hstack((zero, x, zero)) for x in (t.displacement, t.velocity))
    n = seen.contact
    overlap = chain.contacts.overlap[n] + u[:, n] - u[:, n + 1]
    force = chain.contacts.constant[n] * np.maximum(overlap, 0) ** chain.exponent
    closing = v[:, n] - v[:, n + 1]
    stiffness = (
        chain.exponent * chain.contacts.constant[n] * np.maximum(overlap, 0) ** (chain.exponent - 1)
    )
    force += chain.contact_viscosity[n] * stiffness * closing
    rest = chain.contacts.constant[n] * chain.contacts.overlap[n] ** chain.exponent
    assert n.tolist() == np.flatnonzero(chain.contacts.exists).tolist()
    assert (overlap < 0).any()
    assert seen.overlap == pytest.approx(overlap, rel=1e-9, abs=1e-22)
    assert seen.closing == pytest.approx(closing, rel=1e-12)
    assert seen.force == pytest.approx(force, rel=1e-9, abs=1e-18)
    assert seen.change == pytest.approx(force - rest, rel=1e-9, abs=1e-15)
    assert np.array_equal(seen.time, t.time)
    last = force[:, -1] + (chain.masses[-1] * 9.81 if "bottom" not in ends else 0.0)
    assert wall_force(t) == pytest.approx(last, rel=1e-9, abs=1e-18)
    assert np.array_equal(wall_force(t), wall_force(t, "bottom"))
    if "top" in ends:
        assert wall_force(t, "top") == pytest.approx(force[:, 0], rel=1e-9, abs=1e-18)
    signal = sensor(t, 5)
    place = n.tolist().index(4)
    assert signal.force == pytest.approx(force[:, [place, place + 1]].mean(1), rel=1e-9, abs=1e-18)
    assert signal.change == pytest.approx(
        (force - rest)[:, [place, place + 1]].mean(1), rel=1e-9, abs=1e-15
    )
    assert signal.grain == 5


@pytest.mark.parametrize(
    ("ends", "place", "body"),
    [
        ({}, {"grain": 1}, 1),
        ({"top": "wall"}, {"grain": 1}, 1),
        ({"top": "wall"}, {"grain": 0}, 0),
        ({"bottom": "wall"}, {"end": "bottom"}, 8),
        ({}, {"end": "bottom"}, 7),
    ],
)
def test_force_of_a_driver(ends: dict[str, Any], place: dict[str, Any], body: int):
    """The force is m (a - g) of a driven grain, plus the contact below, minus the one above."""
    chain = column(7, top_load=1e-3, **ends)
    drive = Drive(**place, amplitude=2e-9, frequency=1e5)
    t = simulate(scene_of(chain, drive, 2e-5, 41), engines.Native(step=1e-8))
    omega = 2 * np.pi * 1e5
    given = [2e-9 * np.sin(omega * t.time), 2e-9 * omega * np.cos(omega * t.time)]
    given.append(-(omega**2) * given[0])
    for seen, exact in zip(drive_motion(t), given, strict=True):
        assert seen == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())
    u = np.pad(t.displacement, ((0, 0), (1, 1)))
    u[:, body] = given[0]
    contacts = chain.contacts
    overlap = np.maximum(contacts.overlap + u[:, :-1] - u[:, 1:], 0.0)
    pressed = np.where(contacts.exists, contacts.constant * overlap**1.5, 0.0)
    above, below = np.pad(pressed, ((0, 0), (1, 1)))[:, body : body + 2].T
    mass = chain.masses[body - 1] if 1 <= body <= 7 else 0.0
    force = mass * (given[2] - 9.81) + below - above
    assert drive_force(t) == pytest.approx(force, rel=1e-7, abs=1e-9 * np.abs(force).max())
    # At rest a driver carries the load on its own grain.
    still = Drive(times=[0, 1e-6], displacement=[0, 0])
    for load_grain, load in ((1, 0.5), (2, 0.0)):
        loaded = column(5, gravity=0.0, top_load=0.5, load_grain=load_grain)
        assert drive_force(run(loaded, still, 1e-6)).tolist() == [load, load]
    pushed = scene_of(chain, Force(grain=2, amplitude=1e-4, frequency=1e5), 1e-6, 3)
    with pytest.raises(InputError, match="excitation: nothing is driven"):
        drive_motion(simulate(pushed, engines.Native(step=1e-8)))


def test_a_grain_is_a_sensor_between_two_contacts():
    t = noise()
    for grain in (2, 7, 8):
        assert sensor(t, grain).grain == grain
    for grain in (0, 1, 9, 10):
        with pytest.raises(
            InputError, match=f"grain: grain {grain} does not exist or lacks a contact"
        ):
            sensor(t, grain)
    walled = noise(top="wall", bottom="wall")
    for grain in (1, 9):
        assert sensor(walled, grain).grain == grain


# --- arrivals


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("top", [1, 5, 20, 38])
def test_the_summit_of_a_quintic_spline(stride: int, top: int):
    """The maximum of the spline through every n-th sample agrees with a numerical search."""
    time = np.linspace(0, 4, 41)
    values = np.exp(-3 * (time - time[top] - 0.013) ** 2)
    places = np.arange(top - 6 * stride, top + 6 * stride + 1, stride)
    places = places[(places >= 0) & (places <= 40)]
    spline = make_interp_spline(time[places], values[places], k=5)
    found = minimize_scalar(
        lambda s: -spline(s),
        bounds=(time[top] - 0.05, min(time[top] + 0.08, 4.0)),
        method="bounded",
        options={"xatol": 1e-12},
    )
    when, height = summit(time, values, top, stride)
    assert when == pytest.approx(found.x, abs=3e-8)
    assert height == pytest.approx(-found.fun, rel=1e-10)


def test_the_error_of_an_arrival():
    """The error is the shift with every second sample, or one interval near an end."""
    time = np.linspace(0, 4, 41)
    for top, near in ((1, False), (2, True), (20, True), (38, True), (39, False)):
        values = np.exp(-3 * (time - time[top] - 0.013) ** 2)
        peak = arrival(time, values)
        when, _ = summit(time, values, top, 1)
        other, _ = summit(time, values, top, 2)
        assert peak.time == when
        assert peak.error == pytest.approx(abs(when - other) if near else 0.1, rel=1e-9)
    # The samples miss the top of the sharp maximum, so that either maximum may be the largest.
    longer = np.linspace(0, 8, 81)
    sharp = np.exp(-(((longer - 2.03) / 0.12) ** 2))
    for height in (0.98, 0.99):
        peak = arrival(longer, sharp + height * np.exp(-((longer - 6.01) ** 2)))
        assert peak.error == pytest.approx(3.98, abs=0.05)
        assert abs(peak.time - 2.03) <= peak.error
    for values in (np.full(41, np.nan), np.zeros(40)):
        with pytest.raises(InputError, match="values: must be finite numbers, one for each time"):
            arrival(time, values)
    for values, words in (
        (np.arange(41.0), "the signal is largest in the last sample: record for longer"),
        (-np.arange(41.0), "the signal is largest in the first sample: it has no later maximum"),
    ):
        with pytest.raises(InputError, match=f"duration: {words}"):
            arrival(time, values)
    with pytest.raises(InputError, match="the force is largest"):
        arrival(time, time, "force")


def test_a_time_of_flight_in_metres_and_grains():
    flight = Flight(4, 5e-3, 2e-5, 1e-9)
    assert flight.speed == pytest.approx(250.0, rel=1e-14)
    assert flight.grains_per_second == pytest.approx(2e5, rel=1e-14)


@pytest.mark.parametrize("method", ["peak", "correlation"])
def test_the_flight_of_a_bump(method: Any):
    """A bump of displacement passes one grain in 1.013 us, so the forces are equal but delayed."""
    chain = column(30, gravity=0.0, top_load=1.0, exponent=1.0)
    t = simulate(struck(chain, 1e-6, 4e-5, 401), engines.Native(step=1e-7))
    late = t.time[:, None] - 8e-6 - 1.013e-6 * t.grains
    made = replace(t, displacement=1e-9 * np.tanh(late / 2e-6) * (t.grains < 30))
    apart = 8 * (1e-3 - chain.equilibrium_overlap[0])
    for first, second, seconds in ((5, 13, 8.104e-6), (13, 5, -8.104e-6)):
        flight = time_of_flight(made, first, second, method)
        assert flight.seconds == pytest.approx(seconds, rel=1e-6)
        assert flight.distance == pytest.approx(apart, rel=1e-12)
        assert flight.grains == 8
        assert 0 < flight.error < 1e-9
        assert flight.speed == pytest.approx(apart / seconds, rel=1e-6)
    for first, second, way in ((5, 5, "peak"), (5, 6, "phase")):
        with pytest.raises(InputError, match="second: choose two different grains"):
            time_of_flight(made, first, second, way)  # type: ignore[arg-type]


def test_a_correlation_is_an_integral_by_the_trapezoidal_rule():
    """Forces that are not 0 at the start and the end count half there, for either direction."""
    chain = column(30, gravity=0.0, top_load=1.0, exponent=1.0)
    t = simulate(struck(chain, 1e-6, 1.6e-5, 161), engines.Native(step=1e-7))
    late = t.time[:, None] + 3e-6 - 1.013e-6 * t.grains
    made = replace(t, displacement=1e-9 * np.tanh(late / 2e-6) * (t.grains < 30))
    shifts = np.arange(-160, 161)
    for first, second in ((5, 13), (13, 5)):
        one, two = (sensor(made, grain).change for grain in (first, second))
        assert abs(one[0] * two[0]) > 1e-6 * np.abs(one).max() * np.abs(two).max()
        products = np.array(
            [
                np.trapezoid(one[max(0, -k) : 161 - max(0, k)] * two[max(0, k) : 161 + min(0, k)])
                for k in shifts
            ]
        )
        best = arrival(1e-7 * shifts, products)
        found = time_of_flight(made, first, second, "correlation")
        assert found.seconds == pytest.approx(best.time, rel=1e-9)
        assert found.error >= best.error


@pytest.mark.parametrize(("load", "bottom", "duration"), [(10.0, "fixed", 70), (1.0, "wall", 80)])
def test_the_error_of_a_correlation_covers_the_sampling(load: float, bottom: str, duration: int):
    """Echoes that are cut off by the end of the recording change the integrals over time."""
    chain = column(24, gravity=0.0, top_load=load, bottom=bottom)
    flights = []
    for samples in (201, 1601):
        t = run(chain, Impulse(velocity=1e-3), duration * chain.time_scale, samples, 1e-9)
        flights.append(time_of_flight(t, 4, 14, "correlation"))
    coarse, fine = flights
    assert abs(coarse.seconds - fine.seconds) <= coarse.error < 0.01 * fine.seconds
    assert fine.error < 0.1 * coarse.error


@pytest.mark.parametrize(("duration", "rise"), [(6e-5, 1.013e-6), (6e-5, 1e-3), (2.2e-5, 1.013e-6)])
def test_correlation_of_lasting_forces_is_rejected(duration: float, rise: float):
    """Behind a piston both forces persist, so that their correlation has no maximum at the delay.

    The same holds while the force still grows, and before the wave has reached the second grain.
    """
    ends = {"top": "wall", "bottom": "wall"}
    chain = column(60, gravity=0.0, top_load=1.0, **ends)
    piston = Drive(shape="piston", velocity=1e-3, rise=rise, grain=0)
    t = run(chain, piston, duration, 401, 1e-6, engines.Native(step=1e-7))
    with pytest.raises(InputError, match="duration: the wave has not passed grain 1"):
        time_of_flight(t, 10, 34, "correlation")
    if duration > 5e-5 and rise < 1e-4:
        sound = np.sqrt(chain.linear_stiffness[9] / chain.masses[9])
        assert time_of_flight(t, 10, 34).seconds == pytest.approx(24 / sound, rel=0.05)


# --- spectra


@pytest.mark.parametrize("window", ["boxcar", "hann"])
@pytest.mark.parametrize("field", ["velocity", "displacement"])
@pytest.mark.parametrize(("samples", "first"), [(24, 2), (25, 1)])
def test_spectra_are_sums_over_samples_and_grains(
    field: Any, window: str, samples: int, first: int
):
    """Every number of the spectra agrees with its sum, with windows over time and grains."""
    t = noise([5, 2, 3, 4, 9, 6, 7, 8, 1], samples)
    motion = getattr(t, field)[:, np.argsort(t.grains)]
    over_time = get_window(window, samples)
    step = 2e-5 / (samples - 1)
    seen = spectrum(t, field, window)
    wave = np.exp(-2j * np.pi * np.arange(13)[:, None] * np.arange(samples) / samples)
    assert seen.grain.tolist() == list(range(1, 10))
    assert seen.frequency == pytest.approx(np.arange(13) / (samples * step), rel=1e-12)
    assert seen.amplitude == pytest.approx(
        np.abs(step * wave @ (over_time[:, None] * motion)), rel=1e-9
    )
    both = dispersion(t, first, 9, field, window)
    width = 10 - first
    over_grains = get_window(window, width)
    wavenumber = 2 * np.pi * (np.arange(width) - width // 2) / width
    phase = np.exp(1j * np.arange(width)[:, None] * wavenumber)
    windowed = over_time[:, None] * motion[:, first - 1 :] * over_grains
    assert both.wavenumber == pytest.approx(wavenumber, abs=1e-14)
    scale = 1e-9 * both.amplitude.max()
    assert both.amplitude == pytest.approx(
        np.abs(step * wave @ windowed @ phase), rel=1e-9, abs=scale
    )
    assert both.frequency == pytest.approx(seen.frequency, rel=1e-14)
    assert both.grain.tolist() == [first, 5, 9]
    expected = cut_off(t.scene.chain)[[first - 1, 4, 8]][:, None] * np.abs(np.sin(wavenumber / 2))
    assert both.relation[:, 0] == pytest.approx(expected, rel=1e-9)
    assert np.array_equal(spectrum(t).amplitude, spectrum(t, "velocity", "boxcar").amplitude)
    assert np.array_equal(
        dispersion(t, 2, 9).amplitude, dispersion(t, 2, 9, "velocity", "hann").amplitude
    )
    assert both.field == seen.field == field


def test_travel_times_and_their_refusals():
    """The travel time is the sum of sqrt(m / k), with half a contact more from a free top."""
    chain = Chain(grains=7, diameter=np.linspace(1e-3, 1.6e-3, 7), top_load=1e-3)
    apart = np.sqrt((chain.masses[1:] + chain.masses[:-1]) / 2 / chain.linear_stiffness)
    reached = np.append(0.0, np.cumsum(apart))
    assert travel_time(chain) == pytest.approx(reached + apart[0] / 2, rel=1e-12)
    assert travel_time(chain, 4) == pytest.approx(np.abs(reached - reached[3]), rel=1e-12)
    for source in (1, 7):
        assert travel_time(chain, source).shape == (7,)
    for source in (0, 8):
        with pytest.raises(
            InputError, match=rf"source: grains are numbered 1 to 7 \(got {source}\)"
        ):
            travel_time(chain, source)


# --- what was recorded


def test_sixteen_samples_are_enough_and_there_are_two_fields():
    check(noise(samples=16), "velocity")
    with pytest.raises(InputError, match="samples: must be 16 or more"):
        check(noise(samples=15), "velocity")
    for wrong in ("energy", ""):
        with pytest.raises(InputError, match="field: must be"):
            check_field(wrong)  # type: ignore[arg-type]


def test_columns_of_recorded_bodies():
    """The result is -1 for a wall or a fixed body, -2 for an unknown one, otherwise the column."""
    assert columns(6, 4, np.array([4, 1, 5])).tolist() == [-1, 1, -2, -2, 0, 2, -1, -1]
    u, v = np.zeros((2, 3, 4))
    u[1, 1] = 1e-9
    v[2, 2] = -1e-9
    assert leaves_rest(u, v).tolist() == [False, True, True, False]
    assert leaves_rest(np.ones((2, 2)), np.zeros((2, 2))).tolist() == [True, True]


@pytest.mark.parametrize("place", [{"grain": 0}, {"end": "bottom"}])
def test_motion_of_any_bodies(place: dict[str, Any]):
    """A body at rest has no motion, a driven wall that of its drive; contacts need two bodies."""
    chain = column(8, top="wall", bottom="wall")
    drive = Drive(**place, amplitude=2e-9, frequency=1e5)
    t = simulate(scene_of(chain, drive, 2e-5, 11, grains=[8, 3, 4, 1, 6]), "native", 1e-6)
    assert contacts(t).contact.tolist() == known_contacts(t).tolist() == [0, 3, 8]
    u, v = motion(t, np.array([0, 3, 9, 8]))
    omega = 2 * np.pi * 1e5
    given = 2e-9 * np.sin(omega * t.time), 2e-9 * omega * np.cos(omega * t.time)
    moves, rests = (0, 2) if "grain" in place else (2, 0)
    for seen, wall, recorded in zip((u, v), given, (t.displacement, t.velocity), strict=True):
        assert seen[:, moves] == pytest.approx(wall, abs=1e-12 * np.abs(wall).max())
        assert not seen[:, rests].any()
        assert np.array_equal(seen[:, [1, 3]], recorded[:, [1, 0]])
    with pytest.raises(InputError, match=r"record these too: 2, 5$"):
        motion(t, np.array([5, 4, 2, 5]))


def test_largest_values_are_labelled_by_grain():
    t = run(column(6), Impulse(velocity=1e-6, grain=2), 2e-5, 101, 1e-9, grains=[4, 2, 3, 1, 5])
    for field in ("velocity", "displacement"):
        seen = peaks(t, field)  # type: ignore[arg-type]
        assert seen.grain.tolist() == [4, 2, 3, 1, 5]
        sampled = np.abs(getattr(t, field)).max(0)
        assert seen.value == pytest.approx(sampled, rel=2e-2)
        assert (seen.value >= sampled * (1 - 1e-12)).all()
    assert np.array_equal(peaks(t).value, peaks(t, "velocity").value)


def test_the_balance_needs_every_grain_that_can_move():
    """The moving part includes two grains at rest; every unrecorded grain is an error."""
    scene = scene_of(column(100, bottom="wall"), Impulse(velocity=1e-6), 5e-7, 5)
    t = simulate(scene, "native", 1e-9)
    part, u, v = motion_of_all(t)
    last = int(np.flatnonzero(t.displacement.any(0) | t.velocity.any(0)).max()) + 1
    assert part.chain.grains == last + 2 < 98
    assert np.array_equal(u, t.displacement[:, : last + 2])
    assert np.array_equal(v, t.velocity[:, : last + 2])
    for grains, missing in (
        (range(1, 100), "100"),
        (range(1, 99), "99, 100"),
        (range(2, 101), "1"),
        (range(1, 93), "93, 94, 95, 96, 97, 98, 99, 100"),
        (range(1, 92), "92, 93, 94, 95, 96, 97, 98, 99, ..."),
    ):
        some = simulate(scene.replace(grains=list(grains)), "native", 1e-9)
        with pytest.raises(InputError, match=f"record these too: {missing}$"):
            motion_of_all(some)
    held = scene.replace(chain=scene.chain.replace(bottom="fixed"), grains=list(range(1, 100)))
    assert motion_of_all(simulate(held, "native", 1e-9))[0].chain.grains == last + 2
