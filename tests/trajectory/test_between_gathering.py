"""Largest values and maxima accumulated by interval, compared with roots of polynomials."""

import numpy as np
import pytest
from helpers.between_samples import followed, two
from numpy.polynomial import Polynomial

from lmpchain.trajectory.between import hermite, maxima
from lmpchain.trajectory.between.derivatives import (
    ChainForces,
    ImposedSamples,
    SampledBlock,
    derive,
)

RNG = np.random.default_rng(21)
H = 0.125
SAMPLES = 9
FINAL = SAMPLES - 1
# Velocity change between samples due to an error of the acceleration, in intervals.
PUSHED = 5 / 16
STEEP, BENT = 7.514 / 2.1875, 2 * 52.5 / 2.1875  # Slope and curvature of an error curve.


@pytest.fixture(autouse=True)
def _same_draws_in_any_order():
    RNG.bit_generator.state = np.random.default_rng(21).bit_generator.state


class Gathered:
    """Accumulated values of a moving wall and of a grain with a given acceleration."""

    def __init__(self, position: np.ndarray, wall: np.ndarray, off: float = 0.0, low: float = 0.0):
        """Store samples of u, v, a, j (4, T) of both bodies."""
        self.position = position
        self.wall = wall
        self.off = off
        self.far, self.fast = np.full((2, 3, 1), low)
        self.closest = np.full((3, 1), -np.inf)
        self.latest = maxima.events_of(position[1, :1])
        self.log = maxima.events_of(np.zeros(0))

    def take(self, begin: int, end: int) -> None:
        """Add some intervals, with no more samples than these need."""
        base = max(begin - 1, 0)
        stop = min(end + 2, SAMPLES)
        u, v, a, j = self.position[:, base:stop].copy()
        doubt = np.full(u.size, self.off)
        wall = np.ascontiguousarray(self.wall[:, base:stop])
        imposed = ImposedSamples(wall, np.array([a, j]), doubt, 1, True)
        law = ChainForces(np.zeros((3, 2)), np.ones(1), 1.5, False)
        columns = np.array([-1, 0, -1])
        known = np.ones(3, bool)
        block = SampledBlock(u[None], v[None], columns, known, H, law, imposed)
        grains = np.array([1])
        window = maxima.Window(base, begin - base, end - base)
        derived = derive(block, grains)
        kinds = (hermite.DISPLACEMENT, hermite.VELOCITY)
        self.log = maxima.reduce(
            block,
            maxima.table_of(grains, kinds, [0]),
            derived,
            np.zeros((1, 0)),
            window,
            (self.far, self.fast, self.closest),
            hermite.VELOCITY,
            self.latest,
            self.log,
        )

    def maxima(self) -> np.ndarray:
        """Return the maxima that exceed all earlier ones, and the last one."""
        logged = self.log[self.log["kind"] == maxima.MAXIMUM]
        return np.concatenate([logged, self.latest])


def samples_of(curve: Polynomial) -> np.ndarray:
    t = H * np.arange(SAMPLES)
    return np.array([curve.deriv(k)(t) if k else curve(t) for k in range(4)])


def wavy() -> Polynomial:
    """Return a polynomial of degree 6 that turns several times from t = 0 to 1."""
    return Polynomial.fit(np.linspace(0, 1, 7), RNG.normal(size=7), 6).convert()


def largest(curve: Polynomial, signed: bool = False) -> float:
    flat = curve.deriv().roots()
    flat = flat[np.abs(flat.imag) < 1e-9].real
    values = curve(np.concatenate(([0, 1], flat[(flat > 0) & (flat < 1)])))
    return float((values if signed else np.abs(values)).max())


@pytest.mark.parametrize("parts", [(FINAL,), (1, 3, 4, FINAL), tuple(range(1, SAMPLES))])
@pytest.mark.parametrize("off", [0.0, 0.5])
def test_largest_values_do_not_depend_on_the_order_of_intervals(parts: tuple[int, ...], off: float):
    """The approach of the wall to the grain has a sign, and both errors add up."""
    for _ in range(8):
        position = wavy()
        wall = wavy()
        kept = Gathered(samples_of(position), samples_of(wall), off)
        begin = 0
        for end in parts:
            kept.take(begin, end)
            begin = end
        allowed = PUSHED * H * off
        relative = largest(wall - position, signed=True)
        for tops, top, error, at_samples in (
            (kept.fast, largest(position.deriv()), allowed, np.abs(samples_of(position)[1])),
            (kept.far, largest(position), allowed * H / 2.1875, np.abs(samples_of(position)[0])),
        ):
            best, low, high = (float(each[0]) for each in tops)
            assert max(best, low) == pytest.approx(top, rel=1e-11)
            assert low == pytest.approx(max(at_samples.max(), top - error), rel=1e-11)
            assert max(high, best, low) == pytest.approx(
                top + error if high > low else top, rel=1e-11
            )
            assert high > 0 or not off
    best, low, high = (float(each[0]) for each in kept.closest)
    ends = (samples_of(wall) - samples_of(position))[0].max()
    # The wall has the same error as the grain, from the same place.
    allowed = 2 * PUSHED * H * off * H / 2.1875
    assert best == pytest.approx(relative, rel=1e-10)
    assert high == pytest.approx(relative + allowed, rel=1e-6)
    assert low == pytest.approx(max(ends, relative - allowed), rel=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("middle", [0.437, 0.48, 0.5, 0.55])
def test_a_peak_slightly_above_the_last_is_not_missed(middle: float, sign: int):
    """A parabola exceeds its samples by at most an eighth of a second difference."""
    curve = sign * (1 - 3 * (Polynomial([-middle, 1])) ** 2)
    for low, seen in ((1 - 1e-9, True), (1 + 1e-9, False)):
        kept = Gathered(samples_of(curve.integ()), np.zeros((4, SAMPLES)), low=low)
        kept.take(0, FINAL)
        assert (max(kept.fast[maxima.VALUE, 0], kept.fast[maxima.HIGH, 0]) > low) == seen
        assert kept.fast[maxima.VALUE, 0] <= 1 + 1e-12 or not seen


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("off", [0.0, 1e-3])
@pytest.mark.parametrize("parts", [(FINAL,), (1, 3, 4, 6, FINAL)])
def test_maxima_before_larger_ones_are_logged(sign: int, off: float, parts: tuple[int, ...]):
    first = 0.22
    second = 0.83
    speed, dip = two(first, second, 0.6)
    kept = Gathered(samples_of(sign * speed.integ()), np.zeros((4, SAMPLES)), off)
    begin = 0
    for end in parts:
        kept.take(begin, end)
        begin = end
    allowed = PUSHED * H * off
    t = H * np.arange(SAMPLES)
    assert len(kept.maxima()) == 2
    for named, when, end, least in zip(
        kept.maxima(), (first, second), (second, 1.01), (speed(dip), speed(1.0)), strict=True
    ):
        assert named["when"] == pytest.approx(when, rel=1e-9)
        assert named["height"] == pytest.approx(sign * speed(when), rel=1e-11)
        assert named["off"] == pytest.approx(allowed, rel=1e-6, abs=1e-13)
        assert named["tilt"] == pytest.approx(STEEP * allowed / H, rel=2e-3, abs=1e-11)
        bend = abs(speed.deriv(2)(when)) - BENT * allowed / H**2
        assert named["bend"] == pytest.approx(bend, rel=1e-6)
        since = speed(t[(t > when) & (t < end)]).min()
        assert least * (1 - 1e-9) <= named["since"] <= since * (1 + 1e-9)
        later = t[(t > when) & (speed(t) >= speed(when) - 2 * allowed) & (t < when + 0.3)]
        assert named["until"] == pytest.approx(later.max() if later.size else when, rel=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_constant_speed_is_reached_at_its_beginning(sign: int):
    """In free flight the time of the maximum is the beginning: the speed rises to 1 and stays."""
    v = np.array([0, 0.3, 0.9, 1, 1, 1, 1, 1, 1.0])
    u = np.append(0, np.cumsum(H * (v[1:] + v[:-1]) / 2))
    kept = Gathered(sign * np.array([u, v, 0 * v, 0 * v]), np.zeros((4, SAMPLES)))
    kept.take(0, FINAL)
    (last,) = kept.maxima()
    assert last["height"] == pytest.approx(sign, rel=1e-12)
    assert last["when"] == pytest.approx(3 * H, rel=1e-9)
    assert last["bend"] == 0
    assert last["until"] == pytest.approx(1.0, rel=1e-12)
    assert last["since"] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_second_flight_at_the_same_speed_is_another_maximum(sign: int):
    """The speed falls between the flights, and rises again to almost the same speed."""
    v = np.array([0, 0.3, 1, 1, 0.5, 1 - 1e-4, 1, 1, 1.0])
    u = np.append(0, np.cumsum(H * (v[1:] + v[:-1]) / 2))
    off = 1e-3 / (PUSHED * H)  # The errors exceed the difference of 1e-4.
    kept = Gathered(sign * np.array([u, v, 0 * v, 0 * v]), np.zeros((4, SAMPLES)), off)
    kept.take(0, FINAL)
    first, second = kept.maxima()
    assert (first["when"], second["when"]) == pytest.approx((2 * H, 6 * H), rel=1e-9)
    assert (first["since"], second["since"]) == pytest.approx((0.5, 1.0), rel=1e-9)
    assert second["off"] == pytest.approx(1e-3, rel=1e-6)


def test_maxima_are_logged_in_the_order_in_which_they_exceed_all_before():
    """The log has all turning points of random polynomials that exceed all earlier values.

    A search above a level gives the same maxima, without those below the level.
    """
    counts = set()
    for _ in range(200):
        position = wavy()
        speed = position.deriv()
        kept = Gathered(samples_of(position), np.zeros((4, SAMPLES)))
        kept.take(0, 4)
        kept.take(4, FINAL)
        flat = speed.deriv().roots()
        flat = np.sort(flat[np.abs(flat.imag) < 1e-9].real)
        places = np.array([0.0, *flat[(flat > 0) & (flat < 1)], 1.0])
        sizes = np.abs(speed(places))
        rises = (sizes[1:] >= sizes[:-1]) & (speed(places[1:]) * speed(places[:-1]) > 0)
        tops = [k for k in range(places.size) if k + 1 == places.size or not rises[k]]
        tops = [k for k in tops if sizes[k] > sizes[[q for q in tops if q < k]].max(initial=0.0)]
        counts.add(len(tops))
        entries = np.column_stack([kept.maxima()["when"], kept.maxima()["height"]])
        expected = np.column_stack([places[tops], speed(places[tops])])
        np.testing.assert_allclose(entries, expected, rtol=1e-7, atol=1e-9)
        level = sizes.max() / 2
        motion = np.vstack([samples_of(position), np.zeros(SAMPLES)])
        _, latest, log = followed(motion, hermite.VELOCITY, H, None, level)
        log = np.concatenate([log[log["kind"] == maxima.MAXIMUM], latest])
        entries = np.column_stack([log["when"], log["height"]])[np.abs(log["height"]) >= level]
        expected = expected[np.abs(expected[:, 1]) >= level]
        np.testing.assert_allclose(entries, expected, rtol=1e-7, atol=1e-9)
    assert len(counts) > 2
