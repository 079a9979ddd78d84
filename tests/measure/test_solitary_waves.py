"""Solitary waves behind a strike agree with exact waves, and with known shares of the energy."""

from functools import cache

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from scipy import stats

from lmpchain import Chain, Drive, Impulse, InputError, Scene, Trajectory, simulate
from lmpchain.measure import crests, solitary
from lmpchain.theory import soliton


def chain(grains: int = 90, delta: float = 1.5, **others: object) -> Chain:
    """Return grains of 1 mg with contacts of 1 GN/m^delta."""
    masses = np.full(grains, 1e-6)
    masses[0] *= float(others.pop("striker", 1.0))  # type: ignore[arg-type]
    constants = np.full(grains - 1, 1e9)
    free = {"gravity": 0.0, "bottom": "free", "diameter": 1e-3, "exponent": delta}
    return Chain(grains=grains, masses=masses, contact_constants=constants, **free | others)


@cache
def strike(delta: float = 1.5, striker: float = 1.0, grains: int = 90) -> Trajectory:
    """Strike the first grain with 0.1 m/s, until the first wave is near the end."""
    struck = chain(grains, delta, striker=striker)
    height = 0.1 * (0.7 if striker == 1 else 1.5)
    length = (1e-6 / 1e9) ** (1 / (1 + delta))
    speed = soliton.nesterenko_speed(height, delta) / length
    duration = 0.9 * grains / float(speed)
    scene = scene_of(struck, Impulse(velocity=0.1), duration, 16 * grains)
    return simulate(scene, engine="native", tolerance=1e-7)


@pytest.mark.parametrize(
    ("delta", "share", "velocity"), [(1.5, 0.99366104, 0.68163155), (2.0, 0.99845214, None)]
)
def test_shares_of_a_strike_agree_with_independent_runs(
    delta: float, share: float, velocity: float | None
) -> None:
    """Shares and heights agree with runs by SciPy's DOP853, at any velocity, to 1e-7."""
    train = solitary.find(strike(delta))
    assert train.share[0] == pytest.approx(share, abs=1e-7)
    assert train.share_error[0] < 1e-5
    if velocity:
        assert train.velocity[0] == pytest.approx(0.1 * velocity, rel=1e-7)
        assert train.velocity_error[0] < 1e-7


def test_heavy_striker_sends_a_train_of_exact_solitary_waves() -> None:
    """Speeds and energies agree with exact waves of the same height, within the errors."""
    train = solitary.find(strike(striker=6.0, grains=200))
    assert train.grain.size >= 6
    assert (np.diff(train.velocity) < 0).all()
    # Speeds of exact waves grow as v^(1/5) with their velocity v, and energies as v^2.
    velocity = train.velocity_error / train.velocity
    off = np.abs(train.speed / train.exact_speed - 1)
    assert (off <= train.speed_error / train.speed + velocity / 5 + 1e-12).all()
    off = np.abs(train.energy / train.exact_energy - 1)
    assert (off <= train.energy_error / train.energy + 2 * velocity).all()
    for name in ("speed", "velocity", "energy"):
        errors = getattr(train, f"{name}_error") / getattr(train, name)
        assert (errors[:5] < 1e-6).all()
        assert errors.max() < 1e-3
    share, error = train.all_share
    assert 0.99 < share < 1 + error
    ax = train.plot()
    line, *marks = ax.lines
    assert np.array_equal(line.get_xdata(), train.place)
    density = np.maximum(train.density, 1e-12 * train.total)
    assert line.get_ydata() == pytest.approx(density, rel=1e-12)
    heights = np.interp(train.grain, train.place, train.density)
    for mark, place in zip(marks, np.stack((train.grain, heights), axis=1), strict=True):
        assert mark.get_xydata()[0] == pytest.approx(place, rel=1e-12)
    assert ax.get_legend_handles_labels()[1] == ["solitary waves"]
    for text, grain, height, part in zip(
        ax.texts, train.grain[:6], heights, train.share, strict=False
    ):
        assert text.get_text() == f"{100 * part:.3g} %"
        assert text.get_position() == pytest.approx((grain, 2 * height), rel=1e-12)
    assert len(ax.texts) == 6
    assert ax.get_ylim()[1] == pytest.approx(1e4 * density.max(), rel=1e-12)
    words = f"{train.grain.size} solitary waves have {100 * share:.6g} ± "
    assert ax.get_title("left").startswith(words)


def test_errors_add_scatter_sampling_and_change() -> None:
    """Speeds and heights follow from the crests of the later half of the way, at least 12 grains.

    The errors are half the 95 % interval, the effect of sampling, and the change along the way.
    """
    t = strike(striker=6.0, grains=200)
    train = solitary.find(t)
    velocity = t.velocity
    arrived = velocity[:, -5:].max(1) > 1e-3 * velocity[len(velocity) // 2 :].max()
    last = int(arrived.argmax()) if arrived.any() else len(velocity)
    found = crests.find(t.time[:last], velocity[:last], 1e-4)
    end = t.time[last - 1]
    tops = crests.local_maxima(velocity[last - 1])
    # Sampling limits the accuracy of the first waves, and their radiation that of the last ones.
    for k in (0, 2, 4, 5, 6):
        top = int(tops[np.abs(tops + 1 - train.grain[k]).argmin()])
        pace = 1 / train.exact_speed[k]
        begin = found.first(top - 2, end - 3.5 * pace, end)
        assert begin is not None
        way = found.follow(begin, pace, -1)
        way = way[: max(12, way.size // 2)]
        place, time, height = found.grain[way], found.time[way], found.height[way]
        half = way.size // 2
        middle = place - place.mean()
        slope, early, late = (
            np.polyfit(middle[s], time[s] - time.mean(), 1)[0]
            for s in (slice(None), slice(half), slice(half, None))
        )
        left = time - time.mean() - slope * middle
        scatter = np.sqrt(left @ left / (way.size - 2) / (middle @ middle))
        error = stats.t.ppf(0.975, way.size - 2) * scatter + abs(early - late)
        error += 3 * found.time_error[way].max() / np.ptp(place)
        assert train.speed[k] == pytest.approx(1 / slope, rel=1e-9)
        assert train.speed_error[k] / train.speed[k] ** 2 == pytest.approx(error, rel=1e-3)
        error = stats.t.ppf(0.975, way.size - 1) * height.std(ddof=1) / np.sqrt(way.size)
        error += abs(height[:half].mean() - height[half:].mean()) + found.height_error[way].max()
        assert train.velocity[k] == pytest.approx(height.mean(), rel=1e-9)
        assert train.velocity_error[k] == pytest.approx(error, rel=1e-6)


def test_errors_cover_a_coarser_run() -> None:
    """Half the number of samples changes no value by more than its error."""
    fine = solitary.find(strike())
    run = strike()
    coarse = solitary.find(simulate(run.scene.replace(samples=721), "native", 1e-7))
    for name in ("speed", "velocity", "energy"):
        shift = np.abs(getattr(coarse, name) - getattr(fine, name))
        error = getattr(coarse, f"{name}_error")
        assert (shift <= error).all()
        assert (error < 1e-6 * getattr(coarse, name)).all()


def test_exact_upward_wave_under_a_load() -> None:
    """An exact wave that travels up a compressed chain keeps its speed, height and energy."""
    loaded = chain(60, top_load=0.01, bottom="wall")
    unit = loaded.time_scale
    wave = soliton.solve(speed=1.4)
    scene = scene_of(loaded, wave.on(loaded, 41, downward=False), 20 * unit, 401)
    train = solitary.find(simulate(scene, "native", 1e-8), "up")
    assert train.grain == pytest.approx([41 - 28], abs=1e-4)
    assert train.speed * unit == pytest.approx([1.4], rel=1e-6)
    height = loaded.length_scale / unit * float(wave.velocity(0.0))
    assert train.velocity == pytest.approx([height], rel=1e-6)
    assert train.exact_speed == pytest.approx(train.speed, rel=1e-6)
    for energy in (train.energy, train.exact_energy):
        assert energy == pytest.approx([scene.energy], rel=1e-5)
    assert train.total == pytest.approx(scene.energy, rel=1e-8)
    assert train.plot().get_title("left").startswith("1 solitary wave has 100 ")


def test_a_weak_strike_under_a_load_sends_no_solitary_wave() -> None:
    loaded = chain(60, top_load=10.0, bottom="wall")
    scene = scene_of(loaded, Impulse(velocity=1e-4), 1e-4, 301)
    with pytest.raises(InputError, match="duration: no wave keeps"):
        solitary.find(simulate(scene, "native", 1e-3))


def test_other_directions_are_rejected() -> None:
    with pytest.raises(InputError, match="direction"):
        solitary.find(strike(), "left")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="duration"):
        solitary.find(strike(), "up")


@pytest.mark.parametrize(
    ("excitation", "key"),
    [
        (Drive(shape="piston", velocity=-0.1, rise=1e-6, grain=0), "duration: no wave keeps"),
        (Impulse(velocity=0.1, grain=90), "direction: .* strike further from that end"),
    ],
)
def test_pull_and_strike_at_the_far_end_send_no_wave(excitation: Drive | Impulse, key: str) -> None:
    """Runs without a useful sample, or without motion in the given direction, are rejected."""
    struck = chain(top="wall", bottom="wall", top_load=1.0)
    scene = Scene(chain=struck, excitation=excitation, duration=5e-5, samples=400)
    with pytest.raises(InputError, match=key):
        solitary.find(simulate(scene, engine="native", tolerance=1e-4))
