"""Polynomials between samples, compared with their origin, with SciPy and with sums of forces."""

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.between_samples import (
    bernstein,
    block_of,
    direct,
    path_of,
    polynomial,
    power,
    roots,
    value,
)
from helpers.example_scenes import struck
from helpers.flying_grains import unlike
from helpers.thinned import thinned
from numpy.polynomial import Polynomial
from scipy.interpolate import KroghInterpolator

from lmpchain import Law
from lmpchain.trajectory.between import hermite, maxima
from lmpchain.trajectory.between.derivatives import (
    OPENINGS,
    STILL,
    ImposedSamples,
    SampledBlock,
    by_body,
    derive,
    imposed_on,
    law_of,
)

highest = direct(hermite.highest)
sure_bend = direct(maxima.sure_bend)
fill_path = direct(maxima.fill_path)
RNG = np.random.default_rng(8)
KINDS = hermite.VELOCITY, hermite.DISPLACEMENT, hermite.RAISED
H = 0.7
UNIT = 0.01
# Shape of a misfit, whose integral is 1.
SHAPE = 140 * Polynomial([0, 0, 0, 1]) * Polynomial([1, -1]) ** 3
DENSE = np.linspace(0, 1, 2001)


@pytest.fixture(autouse=True)
def _same_draws_in_any_order():
    RNG.bit_generator.state = np.random.default_rng(8).bit_generator.state


def quintic(values: np.ndarray, i: int) -> Polynomial:
    """Return the velocity in an interval, over s from 0 to 1, from v, a and j at both ends."""
    scale = H ** np.arange(3)
    ends = values[1:4, i] * scale, values[1:4, i + 1] * scale
    return _power(ends)


def _power(ends: tuple[np.ndarray, np.ndarray]) -> Polynomial:
    """Return a quintic from values and two derivatives at 0 and 1, by a linear system."""
    powers = np.arange(6)
    rows = []
    right = []
    for place, known in zip((0.0, 1.0), ends, strict=True):
        for order in range(3):
            factor = [math.perm(k, order) for k in powers]
            rows.append(
                factor * np.where(powers >= order, place ** np.maximum(powers - order, 0), 0)
            )
            right.append(known[order])
    return Polynomial(np.linalg.solve(np.array(rows), right))


def misfit(values: np.ndarray, i: int) -> float:
    """Return the misfit of the quintic to the displacement, over h."""
    return (values[0, i + 1] - values[0, i]) / H - quintic(values, i).integ()(1.0)


def between(values: np.ndarray, i: int, kind: int) -> Polynomial:
    """Return the times in an interval at which polynomials are compared."""
    velocity = quintic(values, i) + misfit(values, i) * SHAPE
    return velocity if kind == hermite.VELOCITY else values[0, i] + H * velocity.integ()


def errors(values: np.ndarray, kind: int) -> np.ndarray:
    """Return the claimed errors of the polynomials, (T-1,)."""
    pushed = np.abs(_power((np.array([0, 1.0, 0]), np.array([0, -1.0, 0])))(DENSE)).max()
    count = values.shape[1] - 1
    most = SHAPE(0.5)
    alone = np.array(
        [
            hermite.SHAPE.safety * most * abs(misfit(values, i))
            + pushed * H * values[4, i : i + 2].max()
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
    p = path_of(values, kind, H)
    looked_at = position.deriv() if kind == hermite.VELOCITY else position
    for i in range(3):
        c, d = polynomial(p, kind, H, i)
        exact = looked_at(Polynomial([t[i], H]))
        scale = 1e-12 * np.abs(exact.coef).max()
        np.testing.assert_allclose((power(c) - exact).coef, 0, rtol=0, atol=scale)
        np.testing.assert_allclose((power(d) - exact.deriv()).coef, 0, rtol=0, atol=10 * scale)
        for s in (0.0, 0.3, 1.0):
            assert value(c, c.size, s) == pytest.approx(exact(s), rel=1e-11)
            assert value(d, d.size, s) == pytest.approx(exact.deriv()(s), rel=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_errors_follow_from_misfits_of_displacement_and_acceleration(kind: int):
    for _ in range(5):
        values = RNG.normal(size=(5, 6)) * [[1], [1], [1], [1], [0.1]]
        values[4] = np.abs(values[4])
        p = path_of(values, kind, H)
        np.testing.assert_allclose(p[hermite.ERROR, :-1], errors(values, kind), rtol=1e-11, atol=0)
        for i in range(5):
            c, _ = polynomial(p, kind, H, i)
            exact = between(values, i, kind)
            scale = 1e-11 * np.abs(exact.coef).max()
            np.testing.assert_allclose((power(c) - exact).coef, 0, rtol=0, atol=scale)
            assert np.abs(exact(DENSE)).max() <= p[hermite.REACH, i] + 1e-12 * abs(
                p[hermite.REACH, i]
            )


@pytest.mark.parametrize("kind", KINDS)
def test_the_quick_bound_is_close_where_samples_are(kind: int):
    """With 14 samples a period, the bound exceeds the largest value by 1 % at most."""
    omega = 0.45 / H
    t = H * np.arange(6)
    phase = omega * t + 0.3
    swing = [np.sin(phase + k * np.pi / 2) * omega**k for k in range(4)]
    p = path_of(np.array([*swing, 0 * t]), kind, H)
    for i in range(5):
        exact = between(np.array([*swing, 0 * t]), i, kind)(DENSE)
        top = np.abs(exact).max()
        assert top <= p[hermite.REACH, i] + 1e-12 * abs(p[hermite.REACH, i])
        assert p[hermite.REACH, i] <= top + 0.01 * omega ** (kind == hermite.VELOCITY)


def test_factors_of_errors_agree_with_the_shape_of_a_misfit():
    assert SHAPE(0.5) == hermite.SHAPE.height
    assert np.abs(SHAPE.deriv()(DENSE)).max() == pytest.approx(
        hermite.SHAPE.slope * hermite.SHAPE.height, rel=2e-3
    )
    assert 2 * np.abs(SHAPE.deriv(2)(DENSE)).max() == pytest.approx(
        hermite.SHAPE.curvature * hermite.SHAPE.height, rel=1e-6
    )
    pushed = _power((np.array([0, 1.0, 0]), np.array([0, -1.0, 0])))
    assert pushed(DENSE).max() == pytest.approx(hermite.SHAPE.push, rel=1e-6)


def test_a_curvature_is_certain_beyond_errors_and_rounding():
    curve = Polynomial([1.0, 0.3, -2.0, 0.7, 0.1, -0.4, 0.2])
    slopes = bernstein(curve.deriv(), 5)
    # The ratio of twice the largest curvature of a misfit to the largest misfit.
    ratio = 2 * 52.5 / SHAPE(0.5)
    for s in (0.0, 0.4, 1.0):
        bend = abs(curve.deriv(2)(s))
        found = sure_bend(slopes, 6, s, 0.0, 0.01, hermite.scratch())
        assert found == pytest.approx(bend - ratio * 0.01, rel=1e-12)
    # Relative to a value of 1; less is rounding.
    for size, sure in ((0.95e-9, False), (1.05e-9, True)):
        slopes = bernstein(Polynomial([0, size]), 5)
        assert (sure_bend(slopes, 6, 0.5, 1.0, 0.0, hermite.scratch()) > 0) == sure


def test_the_largest_value_includes_both_ends_and_signs():
    values = np.array([-5.0, 1.0, 3.0])
    for order, kind, top in (
        (values, hermite.VELOCITY, 5.0),
        (values[::-1].copy(), hermite.DISPLACEMENT, 5.0),
        (values, hermite.RAISED, 3.0),
        (-values, hermite.RAISED, 5.0),
        (np.array([1.0, 4.0, 2.0]), hermite.VELOCITY, 4.0),
    ):
        assert highest(order, 0, 3, kind) == top
    assert highest(values, 1, 2, hermite.RAISED) == 1.0


@pytest.mark.parametrize(
    "places",
    [[], [0.1], [0.9], [0.5], [0.2, 0.6], [0.1, 0.4, 0.8], [0.05, 0.45, 0.55, 0.95], [0.25, 0.75]],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_every_turn_of_a_polynomial_is_found_in_order(places: list[float], sign: int):
    turning = (
        math.prod((Polynomial([-place, 1]) for place in places), start=Polynomial([1.3, -0.4]))
        * sign
    )
    found = roots(bernstein(turning, 6))
    assert found.size == len(places)
    assert found == pytest.approx(places, rel=0, abs=2e-11)


def test_close_turns_beside_a_steep_jerk_are_found():
    """Among 1,000 slopes of degree 5, many have several roots in a quarter of the interval."""
    several = 0
    for _ in range(1000):
        middle = RNG.uniform(0, 1)
        width = 10 ** RNG.uniform(-1.5, 0)
        zeros = middle + width * RNG.normal(size=5)
        shape = math.prod(
            (Polynomial([-zero, 1]) for zero in zeros), start=Polynomial([RNG.normal()])
        )
        true = np.sort(zeros[(zeros > 0) & (zeros < 1)])
        if np.diff(np.sort(zeros)).min() < 3e-2 * width:
            # Closer roots are not resolved by polynomial coefficients in double precision.
            continue
        places = roots(bernstein(shape, 5))
        assert places.size == true.size
        assert places == pytest.approx(true, abs=1e-6)
        several += places.size > 2
    assert several > 100


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("curve", "level", "place"),
    [
        (Polynomial([0, 1, 0, 2.0]), 0.5, 0.38545849852963),
        (Polynomial([-0.3, 1]) ** 3, 0.0, 0.3),
        (Polynomial([-0.3, 1]) ** 5, 0.2**5, 0.5),
        (Polynomial([0, 0, 1.0]), 0.81, 0.9),
        (Polynomial([0, 0, 0, 0, 0, 0, 1.0]), 1e-6, 0.1),
    ],
)
def test_a_level_is_found_to_all_digits(curve: Polynomial, level: float, place: float, sign: int):
    multiple = 1e-4 if level == 0.0 else 1e-12  # The zero level is a root of third order.
    places = roots(bernstein(sign * (curve - level), 6))
    assert places.size == 1
    assert places[0] == pytest.approx(place, rel=0, abs=multiple)


# --- accelerations and jerks


def forces_of(
    r: np.ndarray, closing: np.ndarray, contacts: np.ndarray, exponent: float, linear: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return changes of contact forces (T, N+1) and their rates, in extended precision."""
    constant, force, overlap = contacts.astype(np.longdouble)
    if linear:
        stiffness = constant * exponent * (overlap ** (exponent - 1) if exponent > 1 else 1)
        stiffness = np.where((force > 0) | (exponent == 1), stiffness, 0)
        return stiffness * r, stiffness * closing
    depth = np.maximum(overlap + r, 0)
    rate = np.where(depth > 0, exponent * constant * depth ** (exponent - 1) * closing, 0)
    return constant * depth**exponent - force, rate


def unsure_of(y: np.ndarray, climb: np.ndarray, rate: np.ndarray, mass: float) -> np.ndarray:
    """Return the error of a force behind each sample, (T,), in an interval with a kink."""
    off = np.zeros(y.size)
    for i in range(1, y.size):
        before = y[i - 1]
        now = y[i]
        crosses = (before > 0) != (now > 0)
        visits = False
        if not crosses and climb[i - 1] != climb[i]:
            when = (now - H * climb[i] - before) / (H * climb[i - 1] - H * climb[i])
            visits = 0 < when < 1 and (before + H * climb[i - 1] * when > 0) != (before > 0)
        if not (crosses or visits):
            continue
        jump = OPENINGS.kink * H * abs(rate[i] - rate[i - 1])
        deeper = (now > 0 and climb[i] < 0) or (before > 0 and climb[i - 1] > 0)
        if deeper if crosses else now <= 0:  # The contact collides in between.
            jump = max(jump, OPENINGS.collision * mass * abs(climb[i] - climb[i - 1]) / H)
        off[i - 1] = jump
    return off


def chain_contacts(exponent: float, pressed: list[bool], exists: list[bool]) -> np.ndarray:
    """Return constants, forces and overlaps at rest of contacts, (3, N+1).

    The unit of length differs from the overlaps, so that no overlap equals its inverse.
    """
    count = len(pressed)
    overlap = UNIT * np.where(np.array(pressed) & exists, RNG.uniform(0.5, 1.5, count), 0.0)
    constant = np.where(exists, RNG.uniform(1, 2, count), 0.0) * UNIT ** (1 - exponent)
    return np.array([constant, constant * overlap**exponent, overlap])


CHAINS: list[dict[str, Any]] = [
    {"bottom": "wall"},
    {"top": "wall", "top_load": 0.0, "exponent": 2.3},
    {"gravity": 0.0, "load_grain": 3},
    {"law": Law("k*max(o, 0)**2 + b*o**3", k=[1e9, 2e9, 3e9, 4e9], b=1e15)},
]
ENDS = {
    "walls": ([True] * 6, [True] * 6),
    "a free top": ([False, *[True] * 5], [False, *[True] * 5]),
    "a wall that just touches": ([False, *[True] * 5], [True] * 6),
    "the vacuum": ([False] * 6, [False, *[True] * 4, False]),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize(
    ("exponent", "linear"), [(1.0, False), (1.5, False), (2.3, False), (1.5, True)]
)
@pytest.mark.parametrize(("far", "fast"), [(0.2, 0.2), (2.0, 10.0), (2.0, 0.1)])
def test_accelerations_and_jerks_agree_with_the_forces(
    end: str, exponent: float, linear: bool, far: float, fast: float
):
    """The columns have five grains in another order, with one more that is not requested.

    Fast grains also open or close contacts for a moment between two samples.
    """
    contacts = chain_contacts(exponent, *ENDS[end])
    u, v = UNIT * np.array([[[far]], [[fast]]]) * RNG.normal(size=(2, 9, 6))
    u[:2], v[:2] = 0.0, 0.0  # Some contacts rest for a while.
    columns = np.array([3, 0, 5, 1, 4])
    inverse_mass = RNG.uniform(0.5, 2, 5)
    block = block_of(u, v, [STILL, *columns, STILL], contacts, inverse_mass, exponent, linear, H)
    a, j, doubt = derive(block, np.arange(1, 6)).transpose(1, 0, 2)
    x = u[:, columns]
    w = v[:, columns]
    r, closing = (-np.diff(y, axis=1, prepend=0, append=0) for y in (x, w))
    force, rate = forces_of(r, closing, contacts, exponent, linear)
    for found, exact in ((a, force), (j, rate)):
        expected = (-np.diff(exact, axis=1) * inverse_mass).T.astype(float)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    mass = 1 / (np.append(0, inverse_mass) + np.append(inverse_mass, 0))
    unsure = np.zeros((9, 6))
    for n in range(6):
        felt = contacts[0, n] > 0 and not linear
        if felt:
            unsure[:, n] = unsure_of(
                contacts[2, n] + r[:, n], closing[:, n], rate[:, n].astype(float), mass[n]
            )
    expected = np.maximum(unsure[:, :-1], unsure[:, 1:]) * inverse_mass
    np.testing.assert_allclose(doubt, expected.T, rtol=1e-11, atol=0)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("options", CHAINS, ids=str)
def test_chains_have_the_forces_of_their_contacts(
    rng: np.random.Generator, options: dict[str, Any], linear: bool
):
    chain = unlike(5, **options)
    size = chain.contacts.overlap.max() or 1e-7
    u, v = size * rng.normal(size=(2, 6, 5))
    scene = struck(chain, 1e-3, 5 * H, 6)
    columns = np.array([STILL, *range(5), STILL])
    nothing = imposed_on(scene, H, 0, 6)
    lawful = np.ones(7, bool)
    law = law_of(chain, linear)
    block = SampledBlock(by_body(u), by_body(v), columns, lawful, H, law, nothing)
    found = derive(block, np.arange(1, 6))[:, 0].T
    contacts = chain.contacts
    closer = contacts.closer(u)
    change = contacts.stiffness * closer if linear else contacts.force_change(closer)
    expected = -np.diff(change, axis=1) / chain.masses
    expected[:, chain.movable :] = 0.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
def test_a_weak_wave_is_accurate(exponent: float):
    """The overlap changes by 1e-8, so that a difference of forces would lose 8 digits."""
    contacts = chain_contacts(exponent, [True] * 3, [True] * 3)
    u, v = 1e-8 * UNIT * RNG.normal(size=(2, 5, 2))
    block = block_of(u, v, [STILL, 0, 1, STILL], contacts, np.ones(2), exponent, False, H)
    a = derive(block, np.array([1, 2]))[:, 0]
    _, force, overlap = contacts
    s = -np.diff(u, axis=1, prepend=0, append=0) / overlap
    change = force * exponent * s * (1 + (exponent - 1) / 2 * s)
    np.testing.assert_allclose(
        a.T, -np.diff(change, axis=1), rtol=0, atol=1e-15 * np.abs(change).max()
    )


def test_accelerations_of_unknown_forces_follow_from_three_samples():
    for samples in (4, 7):
        u, v = RNG.normal(size=(2, samples, 1))
        block = block_of(
            u, v, [STILL, 0, STILL], np.ones((3, 2)), np.ones(1), 1.5, False, H, known=False
        )
        found, jerk, doubt = derive(block, np.ones(1, int))[0]
        unsure = np.zeros(samples)
        t = H * np.arange(samples)
        last = samples - 1
        quintics = {}
        for k in range(1, last):
            rows = np.repeat(np.arange(k - 1, k + 2), 2)
            known = np.where(np.arange(6) % 2, v[rows, 0], u[rows, 0])
            quintics[k] = KroghInterpolator(t[rows], known)
        for i in range(samples):
            k = min(max(i, 1), last - 1)
            a, j = (float(quintics[k].derivative(t[i], order)) for order in (2, 3))
            assert found[i] == pytest.approx(a, rel=1e-11)
            assert jerk[i] == pytest.approx(j, rel=1e-11)
            beside = [
                float(quintics[q].derivative(t[i], 2))
                for q in (max(k - 1, 1), min(k + 1, last - 1))
            ]
            unsure[i] = np.abs(np.array(beside) - a).max()
        expected = np.maximum(unsure[:-1], unsure[1:])
        assert doubt[:-1] == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_three_samples_give_no_acceleration():
    u, v = RNG.normal(size=(2, 3, 1))
    block = block_of(
        u, v, [STILL, 0, STILL], np.ones((3, 2)), np.ones(1), 1.5, False, H, known=False
    )
    a, j, doubt = derive(block, np.ones(1, int))[0]
    assert not a.any()
    assert not j.any()
    assert np.isinf(doubt).all()


def test_samples_body_by_body():
    field = RNG.normal(size=(5, 19))
    assert np.array_equal(by_body(field), field.T)


# --- with a forcing


@pytest.mark.parametrize(
    ("kind", "linear", "exponent"),
    thinned(product(["plain", "pushed", "driven", "wall"], [False, True], [1.0, 1.5, 2.3]), 2),
)
def test_the_motion_around_an_interval_agrees_with_the_forces(
    exponent: float, linear: bool, kind: str
):
    contacts = chain_contacts(exponent, [True, True, False, True, True], [True] * 5)
    contacts[:, 4] = 0.0  # Without a body below.
    u, v = 1.5 * UNIT * RNG.normal(size=(2, 6, 4))
    inverse_mass = np.array([1.3, 0.4, 0.8, 0.0])
    wall = RNG.normal(size=(4, 6)) if kind == "wall" else np.zeros((4, 6))
    given = np.abs(RNG.normal(size=(2, 6)))
    unsure = np.abs(RNG.normal(size=6))
    pushed = {"pushed": 2, "driven": 1}.get(kind, 0)
    imposed = ImposedSamples(wall, given, unsure, pushed, kind == "driven")
    columns = [STILL, 0, 1, 2, 3, STILL]
    block = block_of(u, v, columns, contacts, inverse_mass, exponent, linear, H, imposed=imposed)
    derived = derive(block, np.arange(1, 5))
    bodies = [np.concatenate((w[:, None], x, np.zeros((6, 1))), axis=1)
              for w, x in zip(wall, (u, v), strict=False)]  # fmt: skip
    r, closing = (-np.diff(y, axis=1) for y in bodies)
    change, rate = forces_of(r, closing, contacts, exponent, linear)
    change = change.astype(float)
    rate = rate.astype(float)
    weights = np.append(0, np.append(inverse_mass, 0))
    for n in range(6):
        path = np.zeros((8, 6))
        fill_path(path, block, derived, n, n - 1 if 0 < n < 5 else maxima.AT_REST, maxima.NONE)
        found = path[:4]
        if n == 5:
            assert not path.any()
            continue
        if n == 0:
            np.testing.assert_array_equal(found, wall)
            np.testing.assert_array_equal(path[hermite.DOUBT], unsure)
            continue
        mass = inverse_mass[n - 1]
        a, j = ((q[:, n - 1] - q[:, n]) * mass for q in (change, rate))
        off = np.zeros(6)
        for side in (n - 1, n):
            both = weights[side] + weights[side + 1]
            if contacts[0, side] > 0 and not linear and mass > 0:
                kinks = unsure_of(
                    contacts[2, side] + r[:, side], closing[:, side], rate[:, side], 1 / both
                )
                off = np.maximum(off, mass * kinks)
        if kind == "driven" and n == pushed:
            a, j, off = *given, unsure
        elif n == pushed:
            a = a + given[0]
            j = j + given[1]
            off = np.maximum(off, unsure)
        expected = np.array([u[:, n - 1], v[:, n - 1], a, j])
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(path[hermite.DOUBT, :-1], off[:-1], rtol=1e-11, atol=0)
