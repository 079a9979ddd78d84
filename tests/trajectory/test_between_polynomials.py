"""Polynomials between samples against those they come from, SciPy's, and plain sums of forces."""

import math

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import KroghInterpolator

from lmpchain.trajectory.between import gathering, hermite
from lmpchain.trajectory.between.derivatives import HIDDEN, KINK, STILL, derivatives, largest

RNG = np.random.default_rng(8)
KINDS = hermite.VELOCITY, hermite.DISPLACEMENT, hermite.RAISED
H = 0.7
SHAPE = 140 * Polynomial([0, 0, 0, 1]) * Polynomial([1, -1]) ** 3  # of a misfit: its integral is 1
DENSE = np.linspace(0, 1, 2001)


@pytest.fixture(autouse=True)
def _same_draws_in_any_order():
    RNG.bit_generator.state = np.random.default_rng(8).bit_generator.state


def path_of(values: np.ndarray, kind: int, ceiling: np.ndarray | None = None) -> hermite.Path:
    """Return the second of two grains between its samples, from u, v, a, j and off (5, T)."""
    motion = np.stack((RNG.normal(size=values.shape), values), axis=1)
    limits = np.zeros((1, 0)) if ceiling is None else np.stack((0 * ceiling, ceiling))
    reach, error = np.empty((2, values.shape[1] - 1))
    rooms = np.full(8, 9.0), np.zeros(8), np.zeros(4)
    return hermite.path(motion, 1, H, kind, limits, reach, error, *rooms)


def quintic(values: np.ndarray, i: int) -> Polynomial:
    """Return the velocity in an interval, over s from 0 to 1, from v, a and j at both ends."""
    scale = H ** np.arange(3)
    ends = values[1:4, i] * scale, values[1:4, i + 1] * scale
    return _power(ends)


def _power(ends: tuple[np.ndarray, np.ndarray]) -> Polynomial:
    """Return a quintic from values and two derivatives at 0 and 1, by a linear system."""
    powers = np.arange(6)
    rows, right = [], []
    for place, known in zip((0.0, 1.0), ends, strict=True):
        for order in range(3):
            factor = [math.perm(k, order) for k in powers]
            rows.append(
                factor * np.where(powers >= order, place ** np.maximum(powers - order, 0), 0)
            )
            right.append(known[order])
    return Polynomial(np.linalg.solve(np.array(rows), right))


def misfit(values: np.ndarray, i: int) -> float:
    """Return by how much the quintic misses the way, over h."""
    return (values[0, i + 1] - values[0, i]) / H - quintic(values, i).integ()(1.0)


def between(values: np.ndarray, i: int, kind: int) -> Polynomial:
    """Return what is looked at in an interval."""
    velocity = quintic(values, i) + misfit(values, i) * SHAPE
    return velocity if kind == hermite.VELOCITY else values[0, i] + H * velocity.integ()


def errors(values: np.ndarray, kind: int) -> np.ndarray:
    """Return how far off the polynomials may be, (T-1,)."""
    pushed = np.abs(_power((np.array([0, 1.0, 0]), np.array([0, -1.0, 0])))(DENSE)).max()
    count = values.shape[1] - 1
    most = SHAPE(0.5)
    alone = np.array(
        [
            hermite.SAFETY * most * abs(misfit(values, i)) + pushed * H * values[4, i : i + 2].max()
            for i in range(count)
        ]
    )
    around = np.maximum(np.maximum(alone, np.append(alone[1:], 0)), np.append(0, alone[:-1]))
    return around if kind == hermite.VELOCITY else around * H / most


@pytest.mark.parametrize("kind", KINDS)
def test_a_velocity_of_degree_six_is_exact_between_samples(kind: int):
    position = Polynomial(RNG.normal(size=8))
    t = H * np.arange(4)
    values = np.array([*(position.deriv(k)(t) if k else position(t) for k in range(4)), 0 * t])
    p = path_of(values, kind)
    looked_at = position.deriv() if kind == hermite.VELOCITY else position
    for i in range(3):
        hermite.polynomial(p, i)
        exact = looked_at(Polynomial([t[i], H]))
        coefficients = np.append(exact.coef, 0)[:8]
        np.testing.assert_allclose(
            p.c, coefficients, rtol=0, atol=1e-12 * np.abs(coefficients).max()
        )
        hermite.derive(p)
        np.testing.assert_allclose(p.d[:7], Polynomial(p.c).deriv().coef, rtol=1e-14, atol=0)
        for s in (0.0, 0.3, 1.0):
            assert hermite.value(p.c, s) == pytest.approx(exact(s), rel=1e-11)
            assert hermite.slope(p.c, s) == pytest.approx(exact.deriv()(s), rel=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_errors_follow_from_the_misfit_of_the_way_and_of_the_acceleration(kind: int):
    for _ in range(5):
        values = RNG.normal(size=(5, 6)) * [[1], [1], [1], [1], [0.1]]
        values[4] = np.abs(values[4])
        p = path_of(values, kind)
        np.testing.assert_allclose(p.error, errors(values, kind), rtol=1e-11, atol=0)
        for i in range(5):
            hermite.polynomial(p, i)
            exact = between(values, i, kind)
            np.testing.assert_allclose(
                p.c[: exact.coef.size], exact.coef, rtol=0, atol=1e-11 * np.abs(p.c).max()
            )
            size = exact(DENSE) if kind == hermite.RAISED else np.abs(exact(DENSE))
            assert size.max() <= p.reach[i] * (1 + 1e-12)


def test_the_quick_bound_is_one_and_close_for_each_term():
    """A velocity alone, an acceleration, a jerk, and a misfit, each with what the others make 0."""
    zero, one = np.zeros(5), np.array([0, 1.0, 0, 0, 0])
    speed, acceleration, jerk, way = np.arange(1, 5)
    half = 0.5 * H
    for row, u, v, bound, loose in (
        (speed, [0, half, 2 * half, 2 * half, 2 * half], one, 1.0, 1e-12),
        (acceleration, [0, H * H / 10, 0, 0, 0], zero, 5 / 16 * H, 1e-12),
        (jerk, [0, 0, 0, 0, 0], zero, H * H / 32, 0.15),
        (way, [0, 1.0, 1, 1, 1], zero, SHAPE(0.5) / H, 1e-12),
    ):
        values = np.zeros((5, 5))
        values[0], values[1] = u, v
        if row in (acceleration, jerk):
            values[row] = one
            for i in range(4):
                values[0, i + 1] = values[0, i] + H * quintic(values, i).integ()(1.0)
        if row == speed:
            for i in range(4):
                values[0, i + 1] = values[0, i] + H * quintic(values, i).integ()(1.0)
        p = path_of(values, hermite.VELOCITY)
        assert bound * (1 - 1e-12) <= p.reach[0] <= bound * (1 + loose)
        moved = path_of(values, hermite.DISPLACEMENT)
        ends = np.abs(values[0, :2]).max()
        assert moved.reach[0] == pytest.approx(ends + H * p.reach[0] / 2, rel=1e-12)
        values[0] -= 3
        raised = path_of(values, hermite.RAISED)
        assert raised.reach[0] == pytest.approx(values[0, :2].max() + H * p.reach[0] / 2, rel=1e-12)
        assert p.reach[-1] <= 1e-15 or row == speed


def test_factors_of_errors_are_those_of_the_shape_of_a_misfit():
    assert SHAPE(0.5) == hermite.BUMP
    assert np.abs(SHAPE.deriv()(DENSE)).max() == pytest.approx(hermite.STEEPEST, rel=2e-3)
    assert 2 * np.abs(SHAPE.deriv(2)(DENSE)).max() == pytest.approx(hermite.CURVED, rel=1e-6)
    pushed = _power((np.array([0, 1.0, 0]), np.array([0, -1.0, 0])))
    assert pushed(DENSE).max() == pytest.approx(hermite.SWING, rel=1e-6)


def test_a_curvature_is_sure_beyond_the_errors_and_rounding():
    p = path_of(np.zeros((5, 4)), hermite.VELOCITY)
    curve = Polynomial([1.0, 0.3, -2.0, 0.7, 0.1, -0.4, 0.2])
    p.c[:7] = curve.coef
    p.c[7] = 0.0
    ratio = (
        2 * 52.5 / SHAPE(0.5)
    )  # of the largest curvature of a misfit, twice, and the largest misfit
    for s in (0.0, 0.4, 1.0):
        bend = abs(curve.deriv(2)(s))
        assert hermite.sure_bend(p, s, 0.0, 0.01) == pytest.approx(bend - ratio * 0.01, rel=1e-12)
    p.c[:] = 0.0
    for size, sure in ((0.95e-9, False), (1.05e-9, True)):  # of a value of 1: less is rounding
        p.c[2] = size / 2
        assert (hermite.sure_bend(p, 0.5, 1.0, 0.0) > 0) == sure


def test_the_largest_of_values_counts_both_ends_and_signs():
    values = np.array([-5.0, 1.0, 3.0])
    assert hermite.highest(values, hermite.VELOCITY) == 5.0
    assert hermite.highest(values[::-1].copy(), hermite.DISPLACEMENT) == 5.0
    assert hermite.highest(values, hermite.RAISED) == 3.0
    assert hermite.highest(-values, hermite.RAISED) == 5.0
    assert hermite.highest(np.array([1.0, 4.0, 2.0]), hermite.VELOCITY) == 4.0


@pytest.mark.parametrize(
    "places",
    [[], [0.1], [0.9], [0.5], [0.2, 0.6], [0.1, 0.4, 0.8], [0.05, 0.45, 0.55, 0.95], [0.25, 0.75]],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_every_turn_of_a_polynomial_is_found_in_order(places: list[float], sign: int):
    p = path_of(np.zeros((5, 4)), hermite.VELOCITY)
    turning = (
        math.prod((Polynomial([-place, 1]) for place in places), start=Polynomial([1.3, -0.4]))
        * sign
    )
    curve = turning.integ() + 0.2
    p.c[:] = 0.0
    p.c[: curve.coef.size] = curve.coef
    assert hermite.turns(p) == len(places)
    assert p.places[: len(places)] == pytest.approx(places, rel=0, abs=2e-11)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("curve", "level", "ends", "place"),
    [
        (Polynomial([0, 1, 0, 2.0]), 0.5, (0.0, 1.0), 0.38545849852963),
        (Polynomial([-0.3, 1]) ** 3, 0.0, (0.0, 1.0), 0.3),
        (Polynomial([-0.3, 1]) ** 5, 0.2**5, (0.1, 0.9), 0.5),
        (Polynomial([0, 0, 1.0]), 0.81, (0.5, 1.0), 0.9),
        (Polynomial([0, 0, 0, 0, 0, 0, 1.0]), 1e-6, (0.0, 1.0), 0.1),
    ],
)
def test_a_level_is_found_to_all_digits(
    curve: Polynomial, level: float, ends: tuple[float, float], place: float, sign: int
):
    c = np.zeros(8)
    c[: curve.coef.size] = sign * curve.coef
    multiple = 1e-4 if level == 0.0 else 1e-12  # of a root of third order
    assert hermite.root(c, sign * level, *ends) == pytest.approx(place, rel=0, abs=multiple)


# --- accelerations and jerks


def forces_of(
    r: np.ndarray, closing: np.ndarray, contacts: np.ndarray, exponent: float, linear: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return changes of the forces of contacts (T, N+1) and their rates, in longer numbers."""
    constant, force, overlap = contacts.astype(np.longdouble)
    if linear:
        stiffness = constant * exponent * (overlap ** (exponent - 1) if exponent > 1 else 1)
        stiffness = np.where((force > 0) | (exponent == 1), stiffness, 0)
        return stiffness * r, stiffness * closing
    depth = np.maximum(overlap + r, 0)
    rate = np.where(depth > 0, exponent * constant * depth ** (exponent - 1) * closing, 0)
    return constant * depth**exponent - force, rate


def unsure_of(y: np.ndarray, climb: np.ndarray, rate: np.ndarray, mass: float) -> np.ndarray:
    """Return how far off a force may be at samples, (T,): at both ends of an interval with a kink."""
    off = np.zeros(y.size)
    for i in range(1, y.size):
        before, now = y[i - 1], y[i]
        crosses = (before > 0) != (now > 0)
        visits = False
        if not crosses and climb[i - 1] != climb[i]:
            when = (now - H * climb[i] - before) / (H * climb[i - 1] - H * climb[i])
            visits = 0 < when < 1 and (before + H * climb[i - 1] * when > 0) != (before > 0)
        if not (crosses or visits):
            continue
        jump = KINK * H * abs(rate[i] - rate[i - 1])
        deeper = (now > 0 and climb[i] < 0) or (before > 0 and climb[i - 1] > 0)
        if deeper if crosses else now <= 0:  # it collides in between
            jump = max(jump, HIDDEN * mass * abs(climb[i] - climb[i - 1]) / H)
        off[i - 1 : i + 1] = np.maximum(off[i - 1 : i + 1], jump)
    return off


def chain_contacts(exponent: float, pressed: list[bool], exists: list[bool]) -> np.ndarray:
    """Return constants, forces and overlaps at rest of contacts, (3, N+1)."""
    count = len(pressed)
    overlap = np.where(np.array(pressed) & exists, RNG.uniform(0.5, 1.5, count), 0.0)
    constant = np.where(exists, RNG.uniform(1, 2, count), 0.0)
    return np.array([constant, constant * overlap**exponent, overlap])


ENDS = {
    "walls": ([True] * 6, [True] * 6),
    "a free top": ([False, *[True] * 5], [False, *[True] * 5]),
    "a wall that just touches": ([False, *[True] * 5], [True] * 6),
    "the vacuum": ([False] * 6, [False, *[True] * 4, False]),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("strength", [0.2, 2.0])
def test_accelerations_and_jerks_are_those_of_the_forces(
    end: str, exponent: float, linear: bool, strength: float
):
    """Five grains in another order of columns, with one more that is not asked for."""
    contacts = chain_contacts(exponent, *ENDS[end])
    u, v = strength * RNG.normal(size=(2, 9, 6))
    u[:2], v[:2] = 0.0, 0.0  # some contacts rest for a while
    columns = np.array([3, 0, 5, 1, 4])
    inverse_mass = RNG.uniform(0.5, 2, 5)
    sides = np.array([[STILL, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, STILL]])
    sizes, moves, _ = largest(u, v)
    assert moves.all()
    motion, quiet = derivatives(
        u, v, columns, sizes, (0.0, 0.0), np.arange(1, 6), sides, contacts, inverse_mass, exponent, linear, H,
        np.ones(6, bool),
    )  # fmt: skip
    assert not quiet.any()
    x, w = u[:, columns], v[:, columns]
    assert np.array_equal(motion[0], x.T)
    assert np.array_equal(motion[1], w.T)
    r, closing = (-np.diff(y, axis=1, prepend=0, append=0) for y in (x, w))
    force, rate = forces_of(r, closing, contacts, exponent, linear)
    for row, exact in ((2, force), (3, rate)):
        expected = (-np.diff(exact, axis=1) * inverse_mass).T.astype(float)
        np.testing.assert_allclose(motion[row], expected, rtol=1e-12, atol=1e-13)
    mass = 1 / (np.append(0, inverse_mass) + np.append(inverse_mass, 0))
    unsure = np.zeros((9, 6))
    for n in range(6):
        felt = contacts[0, n] > 0 and not linear
        if felt:
            unsure[:, n] = unsure_of(
                contacts[2, n] + r[:, n], closing[:, n], rate[:, n].astype(float), mass[n]
            )
    expected = np.maximum(unsure[:, :-1], unsure[:, 1:]) * inverse_mass
    np.testing.assert_allclose(motion[4], expected.T, rtol=1e-11, atol=0)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
def test_a_weak_wave_keeps_its_digits(exponent: float):
    """Of an overlap it moves a hundred-millionth, where a difference of forces would lose 8 digits."""
    contacts = chain_contacts(exponent, [True] * 3, [True] * 3)
    u, v = 1e-8 * RNG.normal(size=(2, 5, 2))
    motion, _ = derivatives(
        u, v, np.arange(2), largest(u, v)[0], (0.0, 0.0), np.array([1, 2]),
        np.array([[STILL, 0, 1], [0, 1, STILL]]), contacts, np.ones(2), exponent, False, H, np.ones(2, bool),
    )  # fmt: skip
    _, force, overlap = contacts
    s = -np.diff(u, axis=1, prepend=0, append=0) / overlap
    change = force * exponent * s * (1 + (exponent - 1) / 2 * s)
    np.testing.assert_allclose(
        motion[2].T, -np.diff(change, axis=1), rtol=0, atol=1e-15 * np.abs(change).max()
    )


def test_accelerations_of_unknown_forces_follow_from_three_samples():
    for samples in (4, 7):
        u, v = RNG.normal(size=(2, samples, 1))
        motion, _ = derivatives(
            u, v, np.zeros(1, int), largest(u, v)[0], (0.0, 0.0), np.ones(1, int), np.array([[STILL, 0, STILL]]),
            np.ones((3, 2)), np.ones(1), 1.5, False, H, np.zeros(1, bool),
        )  # fmt: skip
        t, last = H * np.arange(samples), samples - 1
        quintics = {}
        for k in range(1, last):
            rows = np.repeat(np.arange(k - 1, k + 2), 2)
            known = np.where(np.arange(6) % 2, v[rows, 0], u[rows, 0])
            quintics[k] = KroghInterpolator(t[rows], known)
        for i in range(samples):
            k = min(max(i, 1), last - 1)
            a, j = (float(quintics[k].derivative(t[i], order)) for order in (2, 3))
            assert motion[2, 0, i] == pytest.approx(a, rel=1e-11)
            assert motion[3, 0, i] == pytest.approx(j, rel=1e-11)
            beside = [
                float(quintics[q].derivative(t[i], 2))
                for q in (max(k - 1, 1), min(k + 1, last - 1))
            ]
            assert motion[4, 0, i] == pytest.approx(
                np.abs(np.array(beside) - a).max(), rel=1e-10, abs=1e-12
            )


def test_three_samples_say_nothing_of_an_acceleration():
    u, v = RNG.normal(size=(2, 3, 1))
    motion, _ = derivatives(
        u, v, np.zeros(1, int), largest(u, v)[0], (0.0, 0.0), np.ones(1, int), np.array([[STILL, 0, STILL]]),
        np.ones((3, 2)), np.ones(1), 1.5, False, H, np.zeros(1, bool),
    )  # fmt: skip
    assert not motion[2:4].any()
    assert np.isinf(motion[4]).all()


def test_what_moves_less_than_the_errors_is_quiet():
    u = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.5, 2.0], [-1.0, 0.3, 0.5, 0.0]])
    v = np.array([[0.0, 0.0, 0.0, 0.0], [3.0, 3.5, 3.0, 0.1], [1.0, 2.0, -3.0, 0.0]])
    sizes, _, most = largest(u, v)
    sides = np.array([[STILL, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, STILL]])
    motion, quiet = derivatives(
        u, v, np.arange(4), sizes, (1.0, 3.0), np.arange(1, 5), sides, np.ones((3, 5)), np.ones(4), 1.5, False, H,
        np.array([True, False, False, True]),
    )  # fmt: skip
    assert quiet.tolist() == [True, False, True, False]
    assert not motion[2:, [0, 2]].any()
    assert motion[2:4, 3].any()
    assert most == (2.0, 3.5)


def test_the_largest_sizes_and_what_moves():
    u, v = RNG.normal(size=(2, 20, 19))
    u[:, 3], v[:, 3] = 0.0, -0.0
    u[:, 4], v[:, 5] = 0.0, 0.0
    u[:, 6], v[:, 6] = 0.0, 0.0
    u[7, 6] = -5e-324
    sizes, moves, most = largest(u, v)
    assert np.array_equal(sizes, [np.abs(u).max(0), np.abs(v).max(0)])
    assert np.flatnonzero(~moves).tolist() == [3]
    assert most == (np.abs(u).max(), np.abs(v).max())
    v[3, 8] = np.nan
    assert np.isnan(largest(u, v)[2][1])
    motion, _ = derivatives(
        u, u, np.arange(19), sizes, (9.0, 9.0), np.arange(1, 20), np.zeros((19, 3), int), np.ones((3, 20)),
        np.ones(19), 1.5, False, H, np.zeros(19, bool),
    )  # fmt: skip
    assert np.array_equal(motion[0], u.T)


# --- the same as it is gathered


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("kind", ["plain", "pushed", "driven", "wall"])
def test_the_motion_around_an_interval_is_that_of_the_forces(
    exponent: float, linear: bool, kind: str
):
    contacts = chain_contacts(exponent, [True, True, False, True, True], [True] * 5)
    contacts[:, 4] = 0.0  # nothing below
    u, v = 1.5 * RNG.normal(size=(2, 6, 4))
    inverse_mass = np.array([1.3, 0.4, 0.8, 0.0])
    constant, force, overlap = contacts
    closed = force > 0
    scales = np.array([1 / np.where(closed, overlap, 1), np.where(closed, force, constant), closed])
    if linear and exponent > 1:
        scales[1, ~closed] = 0.0
    wall = RNG.normal(size=(4, 6)) if kind == "wall" else np.zeros((4, 6))
    given = np.abs(RNG.normal(size=(3, 6)))
    pushed = {"pushed": 1, "driven": 0}.get(kind, -1)
    forces = gathering.Forces(
        scales, inverse_mass, exponent, linear, wall, given, pushed, kind == "driven"
    )
    rows = slice(1, 5)
    bodies = [np.concatenate((w[rows, None], x[rows], np.zeros((4, 1))), axis=1)
              for w, x in zip(wall, (u, v), strict=False)]  # fmt: skip
    r, closing = (-np.diff(y, axis=1) for y in bodies)
    change, rate = forces_of(r, closing, contacts, exponent, linear)
    change, rate = change.astype(float), rate.astype(float)
    shut = overlap + r > 0
    for n in range(-1, 5):
        out = np.full((5, 4), 7.0)
        gathering._motion(u, v, 1, 4, n, H, forces, out)
        if n == 4:
            assert not out.any()
            continue
        off = np.zeros(4)
        imposed = (kind == "wall" and n < 0) or n == pushed
        if n < 0:
            expected = wall[:, rows]
        else:
            a, j = ((q[:, n] - q[:, n + 1]) * inverse_mass[n] for q in (change, rate))
            if kind == "driven" and n == 0:
                a, j = given[:2, rows]
            elif n == pushed:
                a, j = a + given[0, rows], j + given[1, rows]
            expected = np.array([u[rows, n], v[rows, n], a, j])
            for side in (n, n + 1):
                if (
                    constant[side] == 0
                    or linear
                    or inverse_mass[n] == 0
                    or (kind == "driven" and n == 0)
                ):
                    continue
                for i in range(1, 4):
                    if shut[i, side] != shut[i - 1, side]:
                        jump = KINK * H * inverse_mass[n] * abs(rate[i, side] - rate[i - 1, side])
                        off[i - 1 : i + 1] = np.maximum(off[i - 1 : i + 1], jump)
        if imposed or n < 0:
            unsure = given[2, rows][:3]
            off[:3] = np.maximum(off[:3], unsure)
            off[1:] = np.maximum(off[1:], unsure)
        np.testing.assert_allclose(out[:4], expected, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(out[4], off, rtol=1e-12, atol=0)
