"""Decisions about the start and end of compiled loops, most of them in plain Python."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.between_samples import direct

from lmpchain import Chain, Impulse, Scene
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels import right_hand_side, sample_loop, team, window
from lmpchain.integrators.kernels.layout import (
    LEAST_SHARE,
    PAD,
    STATE,
    WAVE,
    Team,
)
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps

share = team.share.py_func
widen = window.widen.py_func
ahead = right_hand_side.ahead.py_func
cut = right_hand_side.cut.py_func
passes = window.passes.py_func
rest_ahead = window.rest_ahead.py_func
end_of_step = sample_loop.end_of_step.py_func


def windowed(first: int, last: int, **fields: Any) -> Any:
    state = np.zeros(1, STATE).view(np.recarray)[0]
    state.first = first
    state.last = last
    return SimpleNamespace(state=state, **fields)


@pytest.mark.parametrize("parts", [1, 2, 3, 5])
@pytest.mark.parametrize("lines", [1, 511, 512, 1023, 1024, 1535, 1536, 2560, 4001])
def test_a_window_is_divided_into_equal_parts_of_whole_lines(parts: int, lines: int):
    """As many threads as possible get at least the least share; the others get nothing."""
    first = 3 * PAD
    last = first + lines * PAD
    shares = []
    for part in range(parts):
        chain = windowed(
            first, last, team=Team(part, parts, np.zeros(1, int), *np.zeros((2, 1, 1)))
        )
        shares.append(share(chain))
    busy = [part for part in shares if part[0] < part[1]]
    assert len(busy) == max(1, min(parts, lines * PAD // LEAST_SHARE))
    assert busy == shares[: len(busy)]
    assert busy[0][0] == first
    assert busy[-1][1] == last
    assert [end for _, end in busy[:-1]] == [begin for begin, _ in busy[1:]]
    sizes = [end - begin for begin, end in busy]
    assert all(size % PAD == 0 for size in sizes)
    assert max(sizes) - min(sizes) <= PAD
    assert all(part == (last, last) for part in shares[len(busy) :])


@pytest.mark.parametrize("field", ["x", "v"])
@pytest.mark.parametrize("margin", [1, 4, 12])
@pytest.mark.parametrize("place", range(100, 116))
def test_a_window_grows_by_whole_lines_up_to_a_margin_at_rest(field: str, margin: int, place: int):
    """Grains that move by less than 1e-19 of the strike are at rest, unless they are driven."""
    width = 240
    for moving, acted in ((1.1e-19, False), (0.9e-19, False), (0.0, True)):
        bodies = {"x": np.zeros(width), "v": np.zeros(width)}
        bodies[field][place] = -2.0 * moving if field == "x" else 3.0 * moving
        reach = (place, place) if acted else (width, 0)
        chain = windowed(
            96, 120, imposed=SimpleNamespace(reach=reach), scale=np.array([2.0, 3.0]), **bodies
        )
        widen(chain, margin)
        first = chain.state.first
        last = chain.state.last
        assert first % PAD == last % PAD == 0
        if moving == 0.9e-19:
            assert 104 - margin >= first or first == 96
            assert (first, last) == (96, 120) or margin > 4
            continue
        assert first <= min(96, place - margin) < first + PAD or first == 96
        assert last >= max(120, place + 1 + margin) > last - PAD or last == 120


def test_a_window_ends_at_the_end_of_the_chain():
    width = 64
    x = np.ones(width)
    chain = windowed(
        16, 40, x=x, v=0 * x, imposed=SimpleNamespace(reach=(width, 0)), scale=np.ones(2)
    )
    widen(chain, 50)
    assert (chain.state.first, chain.state.last) == (PAD, width - PAD)


@pytest.mark.parametrize("sign", [1, -1])
def test_grains_that_hardly_move_at_the_ends_of_a_window_are_set_to_rest(sign: int):
    scale = np.array([2.0, 3.0])
    x, v = sign * 0.9 * window.NOTHING * scale[:, None] * np.ones(30)
    x[13] *= -1.2
    v[16] *= -1.2
    expected = np.array([x, v])
    expected[:, [10, 11, 12, 17, 18, 19]] = 0.0
    rest_ahead(windowed(10, 20, x=x, v=v, scale=scale))
    assert np.array_equal([x, v], expected)


def acting(end: float = np.inf, knots: Any = ()) -> Any:
    wave = np.zeros(1, WAVE).view(np.recarray)[0]
    wave.end = end
    wave.knots = len(knots)
    imposed = SimpleNamespace(acts=True, wave=wave, knots=np.array(knots, dtype=float))
    return SimpleNamespace(imposed=imposed)


def test_the_next_kink_is_the_end_of_a_burst_or_a_knot():
    _, address = right_hand_side.addresses()
    call = direct(right_hand_side.call_kink)

    def kink(*given: Any) -> Any:
        return call(address, given)

    burst = acting(3.0).imposed
    spline = acting(knots=(0.0, 1.0, 2.0, 4.0)).imposed
    assert kink(burst.wave, burst.knots, 1.0, 5.0, 1e-9) == 2.0
    assert kink(burst.wave, burst.knots, 3.0 - 2e-9, 5.0, 1e-9) == pytest.approx(2e-9, rel=1e-6)
    for t, end in (
        (3.0, 5.0),
        (4.0, 5.0),
        (3.0 - 0.5e-9, 5.0),
        (1.0, 3.0),
        (1.0, 2.0),
        (1.0, 3.0 + 0.5e-9),
    ):
        assert kink(burst.wave, burst.knots, t, end, 1e-9) > 1e200
    assert kink(spline.wave, spline.knots, 0.0, 9.0, 1e-9) == 1.0
    assert kink(spline.wave, spline.knots, 1.0, 9.0, 1e-9) == 1.0
    assert kink(spline.wave, spline.knots, 1.0 - 0.5e-9, 9.0, 1e-9) == pytest.approx(1.0, rel=1e-8)
    assert kink(spline.wave, spline.knots, 2.5, 9.0, 1e-9) == 1.5
    for t, end in ((2.5, 4.0), (4.0, 9.0), (0.2, 0.9), (5.0, 9.0)):
        assert kink(spline.wave, spline.knots, t, end, 1e-9) > 1e200
    still = acting(3.0)
    still.imposed.acts = False
    assert ahead(still, 1.0, 5.0, 1e-9) > 1e200
    assert cut(still, 2.5, 1.0) == 0


def test_a_step_is_cut_where_a_burst_ends_within_it():
    burst = acting(3.0)
    assert cut(burst, 2.5, 1.0) == 0.5
    assert cut(burst, 2.001, 1.0) == pytest.approx(0.999, rel=1e-12)
    for t in (2.0, 3.0, 3.5, 1.0, 2.0 + 0.5e-9, 3.0 - 0.5e-9):
        assert cut(burst, t, 1.0) == 0
    assert cut(burst, 2.0 + 2e-9, 1.0) > 0
    assert cut(burst, 3.0 - 2e-9, 1.0) > 0
    assert cut(acting(3.0, (0.0, 5.0)), 2.5, 1.0) == 0


@pytest.mark.parametrize("every", [1, 2, 4])
@pytest.mark.parametrize("sample", [0, 5, 8])
def test_a_step_passes_the_interpolated_samples(every: int, sample: int):
    """A step passes the multiples after its start and up to its end, except landings."""
    chain = windowed(PAD, 2 * PAD)
    chain.state.sample = sample
    clock = SimpleNamespace(dense=every, interval=0.5, length=4.0)
    for begin in np.arange(0, 4, 0.25):
        for end in np.arange(begin + 0.25, 4.01, 0.25):
            numbers = [
                n for n in range(1, 8) if begin < n * 0.5 <= end and (sample + n) % every == 0
            ]
            assert passes(chain, clock, begin, end) == (numbers[0] if numbers else 0)


def test_steps_are_equal_parts_of_the_remaining_time():
    chain = windowed(PAD, 2 * PAD)
    span = SimpleNamespace(length=3.0)
    chain.state.done = 1.0
    assert end_of_step(chain, span, 2.0, 0.7) == pytest.approx(1 + 2 / 3, rel=1e-15)
    assert end_of_step(chain, span, 2.0, 1.0) == 2.0
    assert end_of_step(chain, span, 2.0, 1.0 - 1e-12) == 2.0
    assert end_of_step(chain, span, 2.0, 5.0) == 3.0
    assert end_of_step(chain, span, 0.5, 5.0) == 1.5
    # The shortest step is 2^-50 of the time between two landings.
    assert end_of_step(chain, span, 2.0, 0.0) == pytest.approx(1 + 3 * 2.0**-50, rel=1e-16)


@pytest.mark.parametrize("reach", [0.1, 0.3, 2.0])
@pytest.mark.parametrize("name", ["verlet", "dop853", "gear4"])
def test_the_largest_motion_is_checked_at_growing_intervals(name: str, reach: float):
    """The interval is a radian or a step at first, and then a 32nd of the steps."""
    chain = Chain(grains=5, diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-9), duration=1e-5, samples=2)
    step = reach / scene.highest_frequency * (0.2 if name != "dop853" else 1.0)
    steps = 500
    scene = scene.replace(duration=steps * step)
    run = NativeStepper(ChainBatch([scene]), METHODS[name], Steps(steps, 1, step, False), {})
    fields = np.zeros((2, 1, 2, 5))
    due = 0
    each = max(1, int(1 / (step * scene.highest_frequency)))
    bursts = 64 if name == "verlet" else 1  # Number of steps that are made at a time.
    for made in range(1, steps + 1):
        if made >= due:
            due = made + each + made // 32
        if made % bursts == 0 or made == steps:
            run.fill(*fields, 0, 1, made - int(run.steps[0]))
            assert run.watched["next_look"][0] == due
