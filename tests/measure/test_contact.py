"""Contact forces, openings, sensors and wave speeds, compared with independent numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.changed_recordings import until
from helpers.example_chains import column, vacuum
from helpers.example_scenes import run, scene_of
from helpers.thinned import thinned

from lmpchain import Chain, Drive, Impulse, InputError, Trajectory, engines, simulate
from lmpchain.measure.contact import ContactHistory, contacts, drive_force, sensor, wall_force
from lmpchain.measure.flight import arrival, time_of_flight

REST = Impulse(velocity=0.0)


@pytest.fixture(scope="module")
def pulse() -> Trajectory:
    """Simulate a strike on 60 grains in a vacuum until the pulse returns from an equal wall."""
    scene = scene_of(vacuum(60, bottom="wall"), Impulse(velocity=1.0), 84.0, 2101)
    return simulate(scene, engine=engines.Native(step=0.02))


@pytest.fixture(scope="module")
def opening() -> Trajectory:
    """Return a column with a strike that opens and closes contacts."""
    return run(column(12), Impulse(velocity=2e-2), 1.2e-4, 601)


# --- forces


def test_two_balls_that_collide() -> None:
    """Two balls separate after 2.9432751843 x_max / v; the largest force is K x_max^1.5.

    These are the results of Landau and Lifshitz, volume 7, section 9.
    """
    deepest = (2.5 * 0.5 * 0.5) ** 0.4  # Here v = m = K = 1, and the reduced mass is 1/2.
    lasts = 2.9432751843 * deepest
    t = run(vacuum(2), Impulse(velocity=1.0), 1.5 * lasts, 201, tolerance=1e-11)
    history = contacts(t)
    (parted,) = history.events()
    assert (parted.contact, parted.opens) == (1, True)
    assert parted.time == pytest.approx(lasts, rel=1e-8, abs=0)
    peak = arrival(history.time, history.force[:, 0])
    assert peak.height == pytest.approx(deepest**1.5, rel=1e-11, abs=0)
    assert peak.time == pytest.approx(lasts / 2, rel=1e-9, abs=0)


# --- openings


def made_up(time: Any, overlap: Any, closing: Any) -> ContactHistory:
    time, overlap, closing = (np.array(x, dtype=float) for x in (time, overlap, closing))
    force = np.maximum(overlap, 0.0)[:, None]
    return ContactHistory(time, np.array([3]), overlap[:, None], closing[:, None], force, force)


def sine(offset: float, samples: int) -> ContactHistory:
    """Return a contact with the overlap sin(t) + offset, t = 0 to 20."""
    time = np.linspace(0.0, 20.0, samples)
    return made_up(time, np.sin(time) + offset, np.cos(time))


@pytest.mark.parametrize(("offset", "samples"), [(0.3, 81), (0.3, 161), (0.999, 81), (-0.999, 81)])
def test_events_of_a_sine(offset: float, samples: int) -> None:
    """The times are known: sin(t) = -offset. With 0.999 both are between two samples."""
    turn = np.arcsin(offset)
    opens = np.pi + turn + 2 * np.pi * np.arange(3)
    closes = 2 * np.pi * np.arange(4) - turn
    expected = sorted([(t, True) for t in opens] + [(t, False) for t in closes if 0 < t < 20])
    events = sine(offset, samples).events()
    assert [(event.contact, event.opens) for event in events] == [
        (3, opens) for _, opens in expected
    ]
    bound = (20 / (samples - 1)) ** 4 / 384 / np.cos(turn) * 1.5
    assert np.array([e.time for e in events]) == pytest.approx(
        np.array([t for t, _ in expected]), abs=bound
    )


def test_events_at_the_edge_of_touching(rng: np.random.Generator) -> None:
    """A contact that touches at a sample is closed there; one that nearly opens does not open."""
    for _ in range(100):
        start = rng.uniform()
        step = rng.uniform()
        rates = rng.uniform(size=2) * 10 ** rng.uniform(-6, 2)
        (event,) = made_up(
            [start, start + step], [-rng.uniform() * 10 ** rng.uniform(-20, 0), 0.0], rates
        ).events()
        assert start <= event.time <= start + step
        assert not event.opens
    trembling = made_up([0, 1, 2, 3], [0, 0, 1e-20, 1e-10], [-1e-18, 1e-18, 1e-18, 1e-9])
    assert trembling.events() == []
    touching = made_up([0, 1], [0.25, 0.25], [-1, 1])  # (t - 1/2)^2
    assert touching.events() == []
    parting = made_up([0, 1], [0.24, 0.24], [-1, 1]).events()
    assert [(event.time, event.opens) for event in parting] == [
        (pytest.approx(0.4), True),
        (pytest.approx(0.6), False),
    ]


def test_a_gentle_wave_opens_nothing() -> None:
    chain = column(12)
    assert contacts(run(chain, Impulse(velocity=1e-6), 2e-5, 41)).events() == []


def test_grains_that_just_touch_have_not_opened() -> None:
    """The front in a vacuum rises faster than any power, so that an interpolant overshoots."""
    chain = vacuum(12)
    assert contacts(run(chain, REST, 10.0, 11)).events() == []
    # The pulse moves 1.2 grains per unit of time and gets halfway. Samples are coarse to fine.
    for samples in (5, 9, 33):
        events = contacts(run(chain, Impulse(velocity=1.0), 8.0, samples)).events()
        assert all(event.opens for event in events)
        assert [event.contact for event in events] == list(range(1, len(events) + 1))
        assert len(events) == 4
    struck = scene_of(column(12, gravity=0.0, bottom="free"), Impulse(velocity=0.1), 4e-5, 161)
    native, lammps = (
        contacts(simulate(struck, engine, 1e-5)).events() for engine in ("native", "lammps")
    )
    assert [(e.contact, e.opens) for e in lammps] == [(e.contact, e.opens) for e in native]
    assert [e.contact for e in lammps] == list(range(1, 12))
    away = contacts(run(chain, Impulse(velocity=-1.0, grain=4), 1.0, 5)).events()
    assert [(event.time, event.contact, event.opens) for event in away] == [(0.0, 4, True)]


# --- sensors and waves


def test_arrival_of_a_known_peak() -> None:
    """The error for a sampled Gaussian falls with the sixth power and stays within its estimate."""
    worst = []
    for step in (0.4, 0.2):
        found = []
        for shift in np.linspace(0, step, 11):
            time = np.arange(-6, 6, step)
            peak = arrival(time, 3 * np.exp(-((time - shift) ** 2)))
            assert abs(peak.time - shift) <= peak.error + 1e-15
            assert peak.height == pytest.approx(3, rel=1e-4, abs=0)
            found.append(abs(peak.time - shift))
        worst.append(max(found))
    assert worst[1] < 1e-5
    assert np.log2(worst[0] / worst[1]) == pytest.approx(6, abs=1)


def test_an_arrival_that_sampling_hardly_shows() -> None:
    # The parabola through the three samples.
    peak = arrival(np.array([0.0, 1.0, 2.0]), np.array([0.0, 3.0, 2.0]))
    assert (peak.time, peak.height, peak.error) == pytest.approx(
        (1.25, 3.125, 1.0), rel=1e-12, abs=0
    )
    flat = arrival(np.arange(9.0), np.array([0, 0, 0, 1, 1, 1, 1, 0, 0]))
    assert 2 < flat.time < 7
    time = np.arange(12.0)
    # The second maximum is higher between its samples.
    two = np.exp(-((time - 4) ** 2)) + 1.2 * np.exp(-((time - 8.5) ** 2))
    assert arrival(time, two).time == pytest.approx(8.5, abs=0.02)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_maximum_beside_an_end_may_be_the_largest(direction: int) -> None:
    """The samples do not show how high the signal rises beside its steep end."""
    time = np.arange(40.0)
    values = np.exp(-(((time - 20) / 5) ** 2))
    values[:3] = 0.0, 0.75, 0.7
    values[-1] = 0.72
    peak = arrival(time, values[::direction])
    middle, end = (20, 1) if direction > 0 else (19, 38)
    assert peak.time == pytest.approx(middle, abs=0.01)
    assert peak.error > abs(middle - end)


@pytest.mark.parametrize("per_wave", thinned([3.0, 4.0, 6.0, 10.0], 2))
def test_the_largest_of_nearly_equal_maxima_is_within_the_error(per_wave: float) -> None:
    """The error of the largest value includes the choice between nearly equal maxima.

    The signals are sums of six sines; `per_wave` is the number of samples in the shortest period.
    In up to a fourth of the signals, the largest sample is next to a lower maximum.
    """
    tried = 0
    doubtful = 0
    for seed in range(60):
        random = np.random.default_rng(seed)
        frequency = random.uniform(0.3, 1, 6)
        height = random.normal(size=6)
        phase = random.uniform(0, 2 * np.pi, 6)

        def signal(t: np.ndarray, w=2 * np.pi * frequency, a=height, p=phase) -> np.ndarray:
            return np.asarray((a * np.sin(w * t[:, None] + p)).sum(1))

        time = np.arange(0, random.uniform(8, 25), 1 / per_wave)
        values = signal(time)
        fine = np.arange(0, time[-1], 1e-3)
        truth = fine[signal(fine).argmax()]
        # A signal with its maximum at an end is rejected.
        if not 1e-3 < truth < fine[-1] - 1e-3 or not 0 < values.argmax() < values.size - 1:
            continue
        tried += 1
        peak = arrival(time, values)
        assert abs(peak.time - truth) <= peak.error + 1e-3, seed
        doubtful += peak.error > 1 / per_wave
    assert tried > 40
    # With good sampling, all but the most similar maxima are distinguished.
    assert per_wave < 6 or doubtful < 0.05 * tried


@pytest.mark.parametrize("method", ["peak", "correlation"])
def test_speed_of_a_solitary_wave_between_sensors(pulse: Trajectory, method: Any) -> None:
    """The speed is V = 0.9074700784 v_m^(1/5) for the exact lattice soliton.

    The constant is by Ahnert and Pikovsky (2009), and English and Pego (2005).
    """
    before_the_echo = until(pulse, 65.0)
    flight = time_of_flight(before_the_echo, 30, 50, method)
    strength = arrival(before_the_echo.time, before_the_echo.velocity[:, 29]).height
    speed = 0.9074700784 * strength**0.2
    assert flight.grains_per_second == pytest.approx(speed, rel=1e-8, abs=0)
    assert flight.speed == pytest.approx(100 * speed, rel=1e-8, abs=0)
    assert abs(flight.seconds - 20 / speed) < flight.error + 1e-7
    assert flight.error < 1e-7
    if method == "peak":
        signals = [sensor(before_the_echo, n) for n in (30, 50)]
        assert flight.error == sum(arrival(s.time, s.change).error for s in signals)
    back = time_of_flight(before_the_echo, 50, 30, method)
    assert back.seconds == pytest.approx(-flight.seconds, rel=1e-9, abs=0)


def test_the_distance_between_sensors_of_unlike_grains() -> None:
    sizes = np.array([1e-3, 2e-3, 1e-3, 3e-3, 1e-3])
    loose = Chain(grains=5, diameter=sizes, gravity=0.0, bottom="free")
    t = run(loose, Impulse(velocity=1e-2), 3e-5, 301)
    assert time_of_flight(t, 2, 4).distance == pytest.approx(3.5e-3, rel=1e-12, abs=0)


def test_weak_signals_keep_their_digits() -> None:
    chain = column(12)
    signals = [
        sensor(run(chain, Impulse(velocity=v), 2e-5, 41, tolerance=1e-11), 5).change / v
        for v in (1e-16, 2e-16)
    ]
    assert signals[0] == pytest.approx(signals[1], abs=1e-9 * np.abs(signals[0]).max())


# --- what was recorded


def test_some_recorded_grains_are_enough(opening: Trajectory) -> None:
    everything = contacts(opening)
    some = run(opening.scene.chain, opening.scene.excitation, 1.2e-4, 601, grains=[7, 11, 5, 6])
    history = contacts(some)
    assert history.contact.tolist() == [5, 6, 11]  # Grain 12 is fixed.
    assert np.array_equal(history.overlap, everything.overlap[:, [4, 5, 10]])
    assert np.array_equal(history.force, contacts(opening, [5, 6, 11]).force)
    assert np.array_equal(contacts(some, [11, 5]).closing, everything.closing[:, [10, 4]])
    assert np.array_equal(wall_force(some), wall_force(opening))
    assert np.array_equal(sensor(some, 6).force, sensor(opening, 6).force)


def test_what_is_not_there_is_named(opening: Trajectory) -> None:
    some = run(opening.scene.chain, opening.scene.excitation, 1e-6, 5, grains=[3, 5])
    driven = run(column(4), Drive(amplitude=1e-9, frequency=1e4), 1e-6, 5, grains=[1])
    free = run(vacuum(4), Impulse(velocity=1.0), 1.0, 5)
    for fault, wrong in [
        (
            "grains: some grains that are needed were not recorded; record these too: 4",
            lambda: contacts(some, [3, 4]),
        ),
        ("grains: no two neighbouring grains were recorded", lambda: contacts(some)),
        ("record these too: 4, 6", lambda: sensor(some, 5)),
        ("record these too: 11", lambda: wall_force(some)),
        ("record these too: 2", lambda: drive_force(driven)),
        ("numbers: the contacts are numbered 1 to 11 (got [0])", lambda: contacts(opening, [0])),
        ("end: there is no wall at the end 'top'", lambda: wall_force(opening, "top")),
        ("end: there is no wall at the end 'bottom'", lambda: wall_force(free)),
        (
            "end: there is no wall at the end 'left'",
            lambda: wall_force(opening, "left"),  # type: ignore[arg-type]
        ),
        ("excitation: nothing is driven", lambda: drive_force(opening)),
    ]:
        with pytest.raises(InputError) as error:
            wrong()
        assert fault in str(error.value)
