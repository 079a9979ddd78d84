"""Shifts of colliding solitary waves tend to the shifts in integrable chains as amplitudes fall."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.example_scenes import run
from scipy.interpolate import make_interp_spline

from lmpchain import Chain, Impulse, InputError, Profile, Scene, Trajectory, simulate
from lmpchain.measure import collision
from lmpchain.theory import collision as theory
from lmpchain.theory import soliton

HOST = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}


@cache
def head_on(speed: float, grains: int) -> Trajectory:
    """Simulate two equal waves under a load that meet in the middle."""
    wave = soliton.solve(speed=speed)
    chain = Chain(grains=grains, **HOST)
    pair = wave.on(chain, grains // 4) + wave.on(chain, 3 * grains // 4, downward=False)
    duration = grains / 2 / speed * chain.time_scale
    return run(chain, pair, duration, 8 * grains, 1e-8)


def overtaking(fast: float, slow: float, grains: int, gap: int) -> Trajectory:
    """Simulate one wave under a load that overtakes another."""
    waves = [soliton.solve(speed=speed) for speed in (fast, slow)]
    chain = Chain(grains=grains, **HOST)
    pair = waves[0].on(chain, 40) + waves[1].on(chain, 40 + gap)
    duration = (grains - 80) / fast * chain.time_scale
    return run(chain, pair, duration, 8 * grains, 1e-8)


@pytest.mark.slow
def test_head_on_shifts_tend_to_todas_as_amplitudes_fall() -> None:
    """The deviation of the ratio from 1 is about proportional to c - 1."""
    apart = []
    for speed, grains in ((1.05, 500), (1.025, 900)):
        met = collision.find(head_on(speed, grains))
        assert met.head_on
        assert met.shift[0] == pytest.approx(met.shift[1], abs=1e-9)
        assert met.speed == pytest.approx(met.exact_speed, rel=1e-9)
        assert met.place == pytest.approx(grains / 2, abs=0.6)
        apart.append(1 - met.shift[0] / met.toda[0])
    assert apart[0] / apart[1] == pytest.approx(1.7, abs=0.3)


@pytest.mark.parametrize(
    ("speed", "grains", "more", "most"),
    [(1.1, 100, 300, 0.02), pytest.param(1.05, 500, 1000, 0.005, marks=pytest.mark.slow)],
)
def test_errors_cover_the_change_in_a_longer_run(
    speed: float, grains: int, more: int, most: float
) -> None:
    """A longer run changes the shift by less than the sum of both errors."""
    short = collision.find(head_on(speed, grains))
    long = collision.find(head_on(speed, more))
    error = short.shift_error[0] + long.shift_error[0]
    assert abs(short.shift[0] - long.shift[0]) < error < most


@pytest.mark.slow
def test_overtaking_waves_shift_by_the_laws_as_amplitudes_fall() -> None:
    """The faster wave is advanced and the slower one delayed; both shifts tend to the laws."""
    strong = collision.find(overtaking(1.4, 1.1, 400, 17))
    weak = collision.find(overtaking(1.2, 1.05, 850, 23))
    for met in (strong, weak):
        assert not met.head_on
        assert met.shift[0] > 0 > met.shift[1]
        assert (met.shift_error < 0.01).all()
    for law in ("toda", "kdv"):
        apart = [np.abs(met.shift / getattr(met, law) - 1) for met in (strong, weak)]
        assert apart[1][0] < 0.6 * apart[0][0]
    # The shift of the slower wave agrees with the law that is exact for Toda's chain.
    assert weak.shift[1] == pytest.approx(weak.toda[1], rel=0.08)


def test_equal_waves_in_a_vacuum_lose_more_if_they_meet_at_a_contact() -> None:
    """The energy loss agrees with Santibanez et al., Phys. Rev. E 84, 026604 (2011)."""
    wave = soliton.solve(velocity=0.1)
    lost = []
    for grains in (160, 161):
        chain = Chain(grains=grains, diameter=1e-3, gravity=0.0)
        pair = wave.on(chain, 40.0) + wave.on(chain, grains - 39.0, downward=False)
        unit = float(chain.masses[0] / chain.contact_constants[0]) ** 0.4
        duration = (grains - 60) * unit / wave.speed
        met = collision.find(run(chain, pair, duration, 16 * grains, 1e-8))
        assert np.isnan(met.toda).all()
        assert met.shift_error.max() < 1e-6
        assert 0.35 < met.shift[0] < 0.37
        lost.append(1 - float(met.velocity_after[0] / met.velocity[0]))
    assert lost[0] > 2 * lost[1] > 1e-3


# Speed or height, way and first place of each wave; number of grains; duration in units of time.
PAIRS = {
    "head-on": (((0.1, 1, 25.3), (1.0, -1, 134.6)), 160, 115.0),
    "overtaking": (((0.1, -1, 148.7), (1.0, -1, 172.5)), 190, 130.0),
    "head-on under a load": (((1.3, 1, 25.3), (2.0, -1, 134.6)), 160, 58.0),
    "overtaking under a load": (((1.3, -1, 148.7), (2.0, -1, 172.5)), 190, 78.0),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * ("load" in name)) for name in PAIRS]
)
def test_shifts_of_given_waves(name: str) -> None:
    """Exact waves are lowered and shifted as they cross, the second one not at once."""
    pair, grains, end = PAIRS[name]
    loaded = "load" in name
    chain = Chain(grains=grains, **HOST | {"top_load": float(loaded)})
    waves = [soliton.solve(**{"speed" if loaded else "velocity": each[0]}) for each in pair]
    unit, scale = chain.time_scale, chain.length_scale / chain.time_scale
    if not loaded:
        unit, scale = float(chain.masses[0] / chain.contact_constants[0]) ** 0.4, 1.0
    still = Profile(velocity=np.zeros(grains))
    t = run(chain, still, end * unit, int(12 * end), 1e-3)
    time = t.time[:, None] / unit
    (_, way1, x1), (_, way2, x2) = pair
    c1, c2 = (wave.speed for wave in waves)
    met = (x2 - x1) / (way1 * c1 - way2 * c2)
    later = time > met
    given = np.array([0.31, -0.17])
    motion = np.zeros((t.time.size, grains))
    heights = []
    for wave, (_, way, place), shift in zip(waves, pair, given, strict=True):
        slow = 0.0 if shift > 0 else 0.02 * np.exp(-np.abs(time - met) / 6)
        gone = wave.speed * time + later * (shift + slow)
        reach = np.linspace(-20.0, 20.0, 801)
        shape = make_interp_spline(reach, wave.velocity(reach), 5)
        height = shape(np.clip(way * (t.grains - place) - gone, -20.0, 20.0))
        motion += way * np.where(later, 0.9, 1.0) * height
        heights.append(float(wave.velocity(0.0)))
    made = replace(t, velocity=scale * motion)
    found = collision.find(made, 1.0 * unit)
    assert found.head_on == name.startswith("head-on")
    assert found.time == pytest.approx(met * unit, rel=1e-4)
    assert found.place == pytest.approx(x1 + way1 * c1 * met, abs=0.01)
    assert found.way.tolist() == [way1, way2]
    assert found.speed * unit == pytest.approx([c1, c2], rel=1e-5)
    assert found.exact_speed * unit == pytest.approx([c1, c2], rel=1e-4)
    assert found.velocity / scale == pytest.approx(heights, rel=1e-4)
    assert found.velocity_after / found.velocity == pytest.approx([0.9, 0.9], rel=1e-4)
    assert (np.abs(found.shift - given) <= found.shift_error).all()
    assert found.shift_error[0] < 1e-3
    assert found.shift_error[1] < 0.02
    assert found.speed_after * unit == pytest.approx([c1, c2], rel=1e-4)
    for law in ("toda", "kdv"):
        if not loaded or (law == "kdv" and found.head_on):
            assert np.isnan(getattr(found, law)).all()
            continue
        options = (found.head_on,) if law == "toda" else ()
        expected = [getattr(theory, law)(*each, *options) for each in ((c1, c2), (c2, c1))]
        assert getattr(found, law) == pytest.approx(expected, rel=1e-3)
    axes = found.plot()
    assert axes.get_title("left") == name.partition(" ")[0]
    lines = list(axes.lines)
    for k in range(2):
        before, after, shift = (lines.pop(0) for _ in range(3))
        assert before.get_ydata() == pytest.approx(np.zeros(len(before.get_ydata())), abs=1e-3)
        assert after.get_ydata() == pytest.approx(given[[k] * len(after.get_ydata())], abs=1e-2)
        assert before.get_xdata().max() < found.time < after.get_xdata().min()
        assert shift.get_ydata()[0] == found.shift[k]
        # The change of speed from half to half of the way continues back to the collision.
        moment, ahead = (np.asarray(x) for x in after.get_data())
        half = moment.size // 2
        early, late = (
            np.polyfit(moment[s], ahead[s], 1)[0] for s in (slice(half), slice(half, None))
        )
        away = moment.mean() - found.time
        bent = abs(early - late) * max(1.0, away / np.ptp(moment)) * away
        assert bent <= found.shift_error[k]
        if k == 1 and not loaded:
            assert found.shift_error[k] < 1.5 * bent
        label = f"wave {k + 1}: {found.shift[k]:.5g} ± {found.shift_error[k]:.1g} grains"
        assert shift.get_label() == label
        if loaded:
            theories = lines.pop(0)
            assert theories.get_ydata()[0] == found.toda[k]
            assert theories.get_label() == f"wave {k + 1} in Toda's chain: {found.toda[k]:.5g}"
    assert lines[0].get_xdata()[0] == found.time


def test_waves_that_do_not_meet_are_rejected() -> None:
    """One wave alone, separating waves, and a run that ends too early are rejected."""
    chain = Chain(grains=120, **HOST | {"top_load": 0.0})
    unit = float(chain.masses[0] / chain.contact_constants[0]) ** 0.4
    wave = soliton.solve(velocity=0.1)
    parting = wave.on(chain, 40, downward=False) + wave.on(chain, 80)
    meeting = wave.on(chain, 30) + wave.on(chain, 90, downward=False)
    near = wave.on(chain, 58) + wave.on(chain, 62, downward=False)
    for excitation, steps, words in (
        (Impulse(velocity=0.1), 40, "must produce two solitary waves"),
        (parting, 20, "never meet"),
        (meeting, 60, "record longer"),
        (near, 2, "excitation: the waves overlap at the start"),
    ):
        scene = Scene(chain=chain, excitation=excitation, duration=steps * unit, samples=401)
        t = simulate(scene, "native", 1e-6)
        with pytest.raises(InputError, match=words):
            collision.find(t)
    for start in (-1e-9, 1.0, np.nan):
        with pytest.raises(InputError, match="start: must be 0 to"):
            collision.find(t, start)
