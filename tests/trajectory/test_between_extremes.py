"""Largest values and wave fronts of polynomials and their errors, by roots and dense evaluation."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from helpers.between_samples import (
    direct,
    followed,
    front_among,
    fronts_among,
    peak_of,
    two,
)
from numpy.polynomial import Polynomial
from scipy.optimize import brentq

from lmpchain.trajectory.between import fronts, hermite, maxima

earlier = direct(fronts._earlier)
RNG = np.random.default_rng(12)
KINDS = hermite.VELOCITY, hermite.DISPLACEMENT, hermite.RAISED
H = 0.125
SAMPLES = 9
END = H * (SAMPLES - 1)
# Velocity change between samples due to an error of the acceleration, in intervals.
PUSHED = 5 / 16
STEEP, BENT = 7.514 / 2.1875, 2 * 52.5 / 2.1875  # Slope and curvature of an error curve.
TILT_S = 0.3  # Rate of change of errors, rad/s.


@pytest.fixture(autouse=True)
def _same_draws_in_any_order():
    RNG.bit_generator.state = np.random.default_rng(12).bit_generator.state


def motion_of(position: Polynomial, off: float = 0.0) -> np.ndarray:
    """Return u, v, a, j and error of the acceleration, (5, SAMPLES)."""
    t = H * np.arange(SAMPLES)
    rows = [*(position.deriv(k)(t) if k else position(t) for k in range(4)), np.full(SAMPLES, off)]
    return np.array(rows)


def tops(position: Polynomial, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest of all values in each interval, and at the samples."""
    curve = position.deriv() if kind == hermite.VELOCITY else position
    flat = curve.deriv().roots()
    flat = flat[np.abs(flat.imag) < 1e-9].real
    t = H * np.arange(SAMPLES)
    size = (lambda y: y) if kind == hermite.RAISED else np.abs
    ends = size(curve(t))
    most = np.maximum(ends[:-1], ends[1:])
    for place in flat[(flat > 0) & (flat < END)]:
        i = int(place / H)
        most[i] = max(most[i], size(curve(place)))
    return most, ends


def peak(
    motion: np.ndarray, kind: int, known: float = 0.0, ceiling: np.ndarray | None = None
) -> tuple[float, float]:
    return peak_of(motion, kind, H, known, ceiling)


def wavy() -> Polynomial:
    """Return a polynomial of degree 6 that turns several times from t = 0 to 1."""
    return Polynomial.fit(np.linspace(0, 1, 7), RNG.normal(size=7), 6).convert()


@pytest.mark.parametrize("kind", KINDS)
def test_the_largest_value_of_a_polynomial_is_exact(kind: int):
    for _ in range(10):
        position = wavy()
        most, ends = tops(position, kind)
        value, error = peak(motion_of(position), kind, known=0.125)
        assert value == pytest.approx(most.max(), rel=1e-12)
        assert error == pytest.approx(0.125, rel=1e-6)
        off = 0.5
        allowed = PUSHED * H * off * (1 if kind == hermite.VELOCITY else H / 2.1875)
        value, error = peak(motion_of(position, off), kind)
        assert value == pytest.approx(most.max(), rel=1e-12)
        low = max(ends.max(), most.max() - allowed)  # Samples do not have this error.
        assert error == pytest.approx(max(allowed, value - low), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_hidden_maxima_are_bounded(kind: int):
    for _ in range(5):
        position = wavy()
        most, ends = tops(position, kind)
        speed = np.where(np.arange(SAMPLES - 1) % 3 == 1, 4.0 * np.abs(ends).max(), -1.0)
        seen = max(most[speed < 0].max(), ends.max())
        limit = speed
        if kind != hermite.VELOCITY:
            limit = (ends[:-1] + ends[1:] + H * speed) / 2
        high = max(seen, limit[speed >= 0].max())
        value, error = peak(motion_of(position), kind, 0.01, speed)
        assert value == pytest.approx(seen, rel=1e-12)
        assert error == pytest.approx(high - seen + 0.01, rel=1e-9)


# --- fronts


def front(
    position: Polynomial | np.ndarray,
    kind: int,
    fraction: float = 0.5,
    known: float = 0.0,
    certain: float = 0.0,
    off: float = 0.0,
    ceiling: np.ndarray | None = None,
    width: bool = True,
    frequency: float = TILT_S,
) -> np.ndarray:
    """Return the time, height and width of a front and their errors, (6,)."""
    motion = position if isinstance(position, np.ndarray) else motion_of(position, off)
    return front_among(motion, kind, H, fraction, known, certain, frequency, ceiling, width)


def position_of(curve: Polynomial, kind: int) -> Polynomial:
    """Return the displacement with this curve as speed, or the curve itself."""
    return curve.integ() if kind == hermite.VELOCITY else curve


def places(curve: Polynomial, level: float) -> np.ndarray:
    """Return the times at which the curve crosses a level, from 0 to the end."""
    roots = (curve - level).roots()
    roots = roots[np.abs(roots.imag) < 1e-7].real
    return np.sort(roots[(roots >= 0) & (roots <= END)])


def span(curve: Polynomial, level: float, top: float) -> float:
    """Return the length of the interval around a time in which the curve is above a level."""
    at = places(curve, level)
    return at[at > top].min() - at[at < top].max()


SINGLE = Polynomial([0, 0, 1]) * Polynomial([1, -1]) ** 3  # Its maximum is at 0.4.
MOTIONS = [(hermite.VELOCITY, 1.0), (hermite.DISPLACEMENT, -1.0)]


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
@pytest.mark.parametrize(("known", "off"), [(0.0, 0.0), (1e-5, 0.0), (0.0, 1e-3), (2e-5, 5e-4)])
def test_a_single_bump_is_the_front(kind: int, sign: float, known: float, off: float):
    """Errors of value and slope propagate to the time of the maximum, and to the width."""
    allowed = PUSHED * H * off * (1 if kind == hermite.VELOCITY else H / 2.1875)
    time, height, width, late, higher, wider = front(
        position_of(sign * SINGLE, kind), kind, known=known, off=off, certain=known
    )
    top = SINGLE(0.4)
    assert time == pytest.approx(0.4, rel=1e-10)
    assert height == pytest.approx(sign * top, rel=1e-12)
    assert width == pytest.approx(span(SINGLE, top / 2, 0.4), rel=1e-11)
    assert higher == pytest.approx(allowed + known, rel=1e-6, abs=1e-14)
    bend = abs(SINGLE.deriv(2)(0.4)) - BENT * allowed / H**2 - TILT_S**2 * known
    tilt = STEEP * allowed / H + TILT_S * known
    assert late == pytest.approx(tilt / bend, rel=1e-3, abs=1e-12)
    level = known + (known + allowed) / 2 + allowed
    ends = [abs(span(SINGLE, top / 2 + change, 0.4) - width) for change in (-level, level)]
    assert wider == pytest.approx(max(ends), rel=1e-6, abs=1e-12)
    without = front(position_of(sign * SINGLE, kind), kind, known=known, off=off, width=False)
    assert np.array_equal(np.isnan(without), [False, False, True, False, False, True])
    assert np.array_equal(without[[0, 1, 3, 4]], [time, height, late, higher])


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
@pytest.mark.parametrize("frequency", [40.0, 1000.0])
def test_the_time_error_of_a_front_is_limited_by_its_value(
    kind: int, sign: float, frequency: float
):
    """A fast error says nothing about the slope, so the time error follows from the value."""
    known = 1e-6
    top = SINGLE(0.4)
    late = front(
        position_of(sign * SINGLE, kind), kind, known=known, certain=known, frequency=frequency
    )[3]
    around = places(SINGLE, top - 2 * known)
    bend = abs(SINGLE.deriv(2)(0.4)) - frequency**2 * known
    slopes = frequency * known / bend if bend > 0 else math.inf
    lasts = np.abs(around - 0.4).max()
    assert late == pytest.approx(min(slopes, lasts), rel=1e-5)


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
def test_two_maxima_of_similar_height(kind: int, sign: float):
    """Either of two maxima may be the front if their ratio is uncertain.

    The first maximum is half as large as the second within the errors.
    """
    first = 0.15
    second = 0.83
    known = 1e-4
    for ratio in (0.497, 0.4999, 0.5001, 0.503):
        curve, _ = two(first, second, ratio)
        height = curve(first)
        more = curve(second)
        values = position_of(sign * curve, kind)
        time, value, _, late, higher, wider = front(values, kind, known=known, certain=known)
        place = first if ratio > 0.5 else second
        assert time == pytest.approx(place, rel=1e-9)
        assert value == pytest.approx(sign * curve(place), rel=1e-9)
        near = abs(ratio - 0.5) < 1e-3
        assert (late > 0.1) == near
        if near:
            # Both also have their own errors.
            assert 0 < late - abs(first - second) < 1e-5
            assert higher == pytest.approx(abs(height - more) + known, rel=1e-5)
            assert wider == END
        else:
            assert higher == pytest.approx(known, rel=1e-6)


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
def test_a_first_maximum_without_later_ones_may_not_be_a_front(kind: int, sign: float):
    """If the first maximum is below the fraction, there is no front.

    The largest value is at the end.
    """
    first = 0.3

    def curve(dip: float) -> Polynomial:
        shape = Polynomial.fromroots([first, dip, -1.0]).integ()
        return shape / shape(END)

    dip = brentq(lambda place: curve(place)(first) - 0.50005, 0.31, 0.75)
    known = 1e-4
    time, _, _, late, higher, _ = front(
        position_of(sign * curve(dip), kind), kind, known=known, certain=known
    )
    assert time == pytest.approx(first, rel=1e-9)
    assert late == pytest.approx(END - first, rel=1e-9)
    # The front may be on the other side of rest.
    assert higher == pytest.approx(1.0 + 0.50005, rel=1e-9)


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
@pytest.mark.parametrize("deeper", [-1.0, 1.0])
def test_a_decrease_within_the_error_is_no_front(kind: int, sign: float, deeper: float):
    """A decrease within the error is not a maximum; slightly more leaves two possible fronts."""
    first = 0.3
    second = 0.8
    curve, dip = two(first, second, 0.9)
    fall = curve(first) - curve(dip)
    known = 1e-5
    values = position_of(sign * curve, kind)
    certain = fall * (1 + deeper * 1e-3)
    time, _, _, late, _, _ = front(values, kind, 0.5, known, certain)
    assert time == pytest.approx(second if deeper > 0 else first, rel=1e-9)
    if deeper < 0:  # By 2 errors more, it is not a maximum.
        assert (late > 0.1) == (certain + 2 * known >= fall)
    far = front(values, kind, 0.5, known, fall - 2 * known * (1 + deeper * 1e-3))
    assert far[0] == pytest.approx(first, rel=1e-9)
    assert (far[3] > 0.1) == (deeper < 0)
    if deeper < 0:
        assert 0 < far[3] - (second - first) < 1e-5
        assert far[4] == pytest.approx(abs(curve(second) - curve(first)) + known, rel=1e-5)


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
def test_motions_without_a_front(kind: int, sign: float):
    rising = position_of(sign * Polynomial([0, 1.0, 0.5]), kind)
    assert np.isnan(front(rising, kind)).all()
    late = position_of(sign * (SINGLE + 0.51 * SINGLE(0.4)), kind)
    early = position_of(sign * (SINGLE + 0.49 * SINGLE(0.4)), kind)
    top = SINGLE(0.4)
    assert front(early, kind, 0.49 / 1.49 * 1.001)[0] == pytest.approx(0.4, rel=1e-9)
    assert np.isnan(front(early, kind, 0.49 / 1.49 * 0.999)).all()
    assert np.isfinite(front(late, kind, 0.51 / 1.51 * 1.001)[:2]).all()
    values = position_of(sign * SINGLE, kind)
    assert np.isnan(front(values, kind, known=1.001 * top)).all()
    assert np.isfinite(front(values, kind, known=0.999 * top)[0])
    tiny = position_of(sign * SINGLE * (2.0**-1010 / top), kind)
    assert np.isfinite(front(tiny, kind)[0])
    less = position_of(sign * SINGLE * (2.0**-1024 / top), kind)
    assert np.isnan(front(less, kind)).all()


def test_a_width_whose_ends_are_not_recorded_is_unknown():
    # The curve is 0 again at the end.
    curve = (Polynomial([0, 0, 1]) * Polynomial([3, -2]))(Polynomial([0, 1.5]))
    found = front(position_of(curve, hermite.VELOCITY), hermite.VELOCITY)
    assert found[0] == pytest.approx(2 / 3, rel=1e-9)
    assert found[2] == pytest.approx(span(curve, 0.5, 2 / 3), rel=1e-9)
    slow = SINGLE(Polynomial([0.15, 0.5]))  # It has not decreased to half by the end.
    found = front(position_of(slow, hermite.VELOCITY), hermite.VELOCITY, 0.99)
    assert found[0] == pytest.approx(0.5, rel=1e-9)
    assert np.isnan(found[[2, 5]]).all()


@pytest.mark.parametrize(("kind", "sign"), MOTIONS)
def test_hidden_maxima_make_a_front_uncertain(kind: int, sign: float):
    values = position_of(sign * SINGLE, kind)
    t = H * np.arange(SAMPLES)
    size = np.abs(SINGLE(t))
    for hidden in (1, 3, 6):
        for strong in (False, True):
            ceiling = np.full(SAMPLES - 1, -1.0)
            bound = (
                2.0 * SINGLE(0.4)
                if strong
                else max(0.4 * SINGLE(0.4), 0.51 * size[hidden : hidden + 2].sum())
            )
            ceiling[hidden] = bound
            if kind != hermite.VELOCITY:
                ceiling[hidden] = (2 * bound - size[hidden] - size[hidden + 1]) / H
            time, height, _, late, higher, wider = front(values, kind, ceiling=ceiling, width=True)
            inside = hidden == 3  # The interval with the largest value.
            high = max(bound, SINGLE(0.4) if not inside else size[3:5].max())
            assert time == pytest.approx(t[3] if inside and size[3] > size[4] else 0.4, rel=1e-9)
            assert height == pytest.approx(sign * SINGLE(time), rel=1e-9)
            if not strong or hidden == 6:
                continue
            assert higher == pytest.approx(abs(height) + high, rel=1e-9)
            assert late >= time - hidden * H
            assert wider == END
    top = SINGLE(0.4)
    # Hidden intervals, the bound on the size there, the fraction that defines the front, and the
    # time from the first hidden maximum that may be the front to the front.
    for hidden, bound, fraction, early in (
        ([1], 1.2, 0.4, 0.4 - H), ([1, 2], 1.2, 0.4, 0.4 - H), ([1], 0.8, 0.75, 0.4 - H),
        ([1], 0.8, 0.85, 0.0), ([3], 1.2, 0.4, H), ([5], 1.2, 0.4, 0.0),
    ):  # fmt: skip
        limits = np.full(SAMPLES - 1, -1.0)
        for i in hidden:
            limits[i] = bound * top
            if kind != hermite.VELOCITY:
                limits[i] = (2 * bound * top - size[i] - size[i + 1]) / H
        _, height, _, late, higher, _ = front(values, kind, fraction, ceiling=limits)
        assert late == pytest.approx(early, rel=1e-9, abs=1e-9)
        high = abs(height) + max(bound, 1.0) * top if early else 0.0
        assert higher == pytest.approx(high, rel=1e-9, abs=1e-9)


def test_a_slow_maximum_may_have_turned_earlier():
    """The maximum may be at any time with a slope within its error."""
    turning = Polynomial.fromroots([0.35, 0.35, 0.8]) * -1.0
    curve = (turning + 1e-3 * Polynomial([0.8, -1])).integ()
    low = curve(0.35)
    top = curve(brentq(turning + 1e-3 * Polynomial([0.8, -1]), 0.7, 0.9))
    for frequency, sure in ((1.0, True), (1000.0, False)):
        known = 1e-6
        values = position_of(curve, hermite.VELOCITY)
        time, _, _, late, higher, _ = front(
            values, hermite.VELOCITY, 0.3, known, known, frequency=frequency
        )
        assert time == pytest.approx(0.8, rel=1e-9)
        if sure:
            assert late < 0.05
            assert higher == pytest.approx(known, rel=1e-6)
        else:
            assert time - late == pytest.approx(0.35, abs=H / 2)
            assert time - late <= 0.35
            assert higher == pytest.approx(top - low, rel=0.05)


def bumps(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function of time with u, v, a and j, (4, ...), of three velocity pulses."""
    sizes = rng.uniform(0.3, 1, 3) * rng.choice([-1, 1], 3)
    middles = np.cumsum(rng.uniform(1.5, 4, 3)) + 4
    widths = rng.uniform(1.4, 2.5, 3)

    def motion(time: np.ndarray) -> np.ndarray:
        out = np.zeros((4, *np.shape(time)))
        for size, middle, width in zip(sizes, middles, widths, strict=True):
            s = (time - middle) / width
            factor = Polynomial([size])
            for order in range(4):
                out[order] += factor(s) * np.exp(-(s**2)) / width**order
                factor = factor.deriv() - Polynomial([0, 2.0]) * factor
        return out

    return motion


def front_of_dense(y: np.ndarray, dense: np.ndarray, fraction: float) -> np.ndarray:
    """Return the time, height and width of the front of a curve, from dense samples."""
    size = np.abs(y)
    turns = 1 + np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]))
    first = turns[size[turns] >= fraction * size.max()][0]
    low = np.sign(y[first]) * y < size[first] / 2
    width = dense[first + np.flatnonzero(low[first:])[0]] - dense[np.flatnonzero(low[:first])[-1]]
    return np.array([dense[first], y[first], width])


@pytest.mark.parametrize("kind", [hermite.VELOCITY, hermite.DISPLACEMENT])
def test_stated_errors_cover_those_of_noisy_samples(kind: int):
    """The errors cover the effect of a smooth error of the samples, and are reached by some."""
    rng = np.random.default_rng(1)
    samples = 24
    known = 1e-3
    ratios = []
    for _ in range(25):
        signal = bumps(rng)
        phase = rng.uniform(0, 2 * np.pi, 4)
        t = np.arange(float(samples))
        motion = np.zeros((5, samples))
        motion[:4] = signal(t)
        omega = 0.8
        scale = known / omega ** (kind == hermite.VELOCITY)
        for order in range(4):
            motion[order] += scale * omega**order * np.cos(omega * t + phase[0] + order * np.pi / 2)
        found = front_among(motion, kind, 1.0, 0.5, known, known, omega)
        dense = np.linspace(0, samples - 1, 9_201)
        off = np.abs(found[:3] - front_of_dense(signal(dense)[kind], dense, 0.5))
        grid = np.array([3e-3, 2e-6, 6e-3])
        assert (off <= found[3:] + grid).all()
        if found[3] < 1.0:
            ratios.append(off / (found[3:] + grid))
    assert len(ratios) > 15
    assert (np.max(ratios, axis=0) > [0.3, 0.9, 0.25]).all()


@pytest.mark.parametrize("kind", [hermite.VELOCITY, hermite.DISPLACEMENT])
def test_fronts_of_random_signals_agree_with_dense_samples(rng: np.random.Generator, kind: int):
    """Fronts and their widths agree with dense samples of random signals, alone or together.

    The front is the first maximum above a fraction of the largest. Its width spans many intervals.
    """
    clear = 0
    for step in (0.25, 0.5, 1.0):
        fraction = rng.uniform(0.2, 0.95)
        motions = np.zeros((20, 5, int(24 / step)))
        dense = np.arange(0, step * (motions.shape[2] - 1), 1e-3)
        alone = []
        for motion in motions:
            signal = bumps(rng)
            motion[:4] = signal(step * np.arange(motion.shape[1]))
            found = front_among(motion, kind, step, fraction, 0.0, 0.0, 1.0)
            off = np.abs(found[:3] - front_of_dense(signal(dense)[kind], dense, fraction))
            assert (off <= found[3:] + np.array([1.1e-3, 1e-6, 2.2e-3])).all()
            if step < 1 and found[3] < 0.05:
                clear += 1
                assert (off <= [0.01, 1e-3, 0.02]).all()
                assert (found[3:] <= [0.05, 2e-3, 0.05]).all()
            alone.append(found)
        together = fronts_among(motions, kind, step, fraction)
        assert together == pytest.approx(np.array(alone), rel=1e-12)
    assert clear > 30


def test_shoulders_of_a_rise_are_at_minima_of_the_slope():
    """The rise may have turned as long before as the slope is within its error."""
    seen = 0
    for _ in range(40):
        turning = (Polynomial([-RNG.uniform(0.1, 0.9), 1]) ** 2 + 0.01) * (
            1 + 0.2 * RNG.normal() * Polynomial([-0.5, 1])
        )
        curve = RNG.choice([-1, 1]) * (turning.integ() + 0.2)
        _, _, log = followed(motion_of(curve.integ()), hermite.VELOCITY, H, None, abs(curve(0.0)))
        slope = np.sign(curve(0.5)) * curve.deriv()
        flat = slope.deriv().roots()
        flat = flat[np.abs(flat.imag) < 1e-9].real
        flat = flat[(flat > 0) & (flat < 1) & (slope.deriv(2)(flat) > 0)]
        events = log[log["kind"] == maxima.SHOULDER]
        assert events["when"] == pytest.approx(flat, rel=1e-7)
        seen += flat.size
        for event, place in zip(events, flat, strict=True):
            assert event["height"] == pytest.approx(curve(place), rel=1e-9)
            assert event["tilt"] == pytest.approx(-slope(place), rel=1e-7)
            assert event["bend"] == pytest.approx(slope.deriv(2)(place), rel=1e-6)
            allowed = 4 * slope(place)  # Error of the slope within which the rise may turn earlier.
            rules = fronts.Rules(0.3, allowed, 0.0, 1.0, H, 1.0, 1, False)
            begin, height = earlier(log, 1.0, 0.0, 0.0, rules)
            parabola = place - np.sqrt(6 * slope(place) / slope.deriv(2)(place))
            assert begin == pytest.approx(max(parabola, 0.0), abs=1e-6)
            assert height == pytest.approx(abs(curve(place)), rel=1e-9)
            rules = fronts.Rules(0.3, 0.99 * slope(place), 0.0, 1.0, H, 1.0, 1, False)
            assert earlier(log, 1.0, 0.0, 0.0, rules) == (1.0, 0.0)
    assert seen > 20
