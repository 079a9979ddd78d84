"""Solitary waves of the lattice: equation of motion, conservation laws, limits and refusals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.example_chains import column
from scipy.integrate import quad
from scipy.optimize import brentq

from lmpchain import Chain, InputError
from lmpchain.theory import soliton, soliton_series
from lmpchain.theory.soliton import Soliton, solve

VACUUM = [{"delta": delta, "velocity": 0.7} for delta in (1.2, 1.5, 3.0)]
LOADED = [
    {"delta": delta, "speed": speed} for delta, speed in ((1.5, 1.01), (1.5, 8.0), (3.0, 1.2))
]


@cache
def solved(**options: float) -> Soliton:
    return solve(**options)


@pytest.fixture
def wave(request: pytest.FixtureRequest) -> Soliton:
    return solved(**request.param)


def waves(cases: list[dict[str, float]]) -> pytest.MarkDecorator:
    """Pass the waves of some options to a test."""
    return pytest.mark.parametrize("wave", cases, ids=str, indirect=True)


each = waves(VACUUM + LOADED)


def excess(wave: Soliton, overlap: np.ndarray) -> np.ndarray:
    """Return the force of a contact, written independently."""
    return (
        np.expm1(wave.delta * np.log1p(overlap)) / wave.delta
        if wave.loaded
        else overlap**wave.delta
    )


@each
def test_integrals_of_velocity(wave: Soliton):
    """Displacement is the integral of the velocity; momentum is c times a grain's displacement."""
    x = 0.3
    moved, _ = quad(
        lambda y: float(wave.velocity(y)) / wave.speed,
        x,
        wave.reach,
        epsabs=0,
        epsrel=1e-12,
        limit=200,
    )
    assert float(wave.displacement(x)) == pytest.approx(moved, rel=1e-11)
    assert wave.momentum == pytest.approx(
        wave.speed * float(wave.displacement(-2 * wave.reach)), rel=1e-12
    )
    assert wave.overlap(x) == pytest.approx(
        wave.displacement(x - 0.5) - wave.displacement(x + 0.5), rel=1e-9
    )


@each
def test_energy_and_momentum_are_constant_in_time(wave: Soliton):
    for shift in (0.13, 0.5):
        n = np.arange(-100, 101) + shift
        r = wave.overlap(n + 0.5)
        power = wave.delta + 1
        contact = (
            (((1 + r) ** power - 1) / power - r) / wave.delta if wave.loaded else r**power / power
        )
        assert wave.energy == pytest.approx((wave.velocity(n) ** 2 / 2 + contact).sum(), rel=1e-10)
        assert wave.momentum == pytest.approx(wave.velocity(n).sum(), rel=1e-12)


@waves(LOADED[::2])
def test_exponential_tail(wave: Soliton):
    """sinh(kappa/2) = c kappa/2 for linear waves far from the middle."""
    kappa = -np.log(float(wave.overlap(wave.reach - 0.5) / wave.overlap(wave.reach - 1.5)))
    assert np.sinh(kappa / 2) / (kappa / 2) == pytest.approx(wave.speed, rel=1e-9)


@waves(VACUUM)
def test_double_exponential_tail(wave: Soliton):
    """log r(x + 1) / log r(x) tends to delta, with the correction of the equation."""
    x = 0.8 * wave.reach
    log = np.log([float(wave.overlap(x + s)) for s in (-1e-4, 0, 1e-4)])
    first = (log[2] - log[0]) / 2e-4
    second = (log[2] - 2 * log[1] + log[0]) / 1e-8
    r = np.exp(log[1])
    force = [excess(wave, wave.overlap(x + s)) for s in (-1, 0, 1)]
    assert wave.speed**2 * r * (second + first**2) == pytest.approx(
        force[0] - 2 * force[1] + force[2], rel=1e-5
    )
    assert 0 < wave.overlap(wave.reach) < 1e-18
    assert wave.overlap(np.array([1.5, 3.0]) * wave.reach)[1] == 0.0


def test_weak_waves_agree_with_kdv_theory():
    """Relative errors of overlap and speed are of first order in the excess speed."""
    x = np.linspace(0, 60, 61)
    off = []
    for e in (4e-4, 1e-4):
        wave = solve(speed=1 + e)
        off.append(
            np.abs(wave.overlap(x) - soliton.kdv_overlap(x, 1 + e)).max() / float(wave.overlap(0.0))
        )
    assert np.log(off[0] / off[1]) / np.log(4) == pytest.approx(1, abs=0.05)
    assert float(solve(speed=1.001).overlap(0.0)) * 0.5 / 6 == pytest.approx(1.001 - 1, rel=2e-3)


def test_strong_waves_agree_with_the_sonic_vacuum():
    """V = G F^(1/6) for the largest force and the speed."""
    vacuum = solve(velocity=1.0)
    strong = solve(speed=100.0)
    unit = vacuum.speed / float(vacuum.force(0.0)) ** (1 / 6)
    force = float((1 + strong.overlap(0.0)) ** 1.5)
    assert strong.speed * np.sqrt(1.5) / force ** (1 / 6) == pytest.approx(unit, rel=1e-5)
    assert strong.width == pytest.approx(vacuum.width, rel=1e-4)


def test_long_waves_published():
    """Nesterenko's cos^4 and Coste's formula are written out."""
    x = np.linspace(-2, 2, 9)
    assert soliton.nesterenko_overlap(x, 0.9) == pytest.approx(
        (1.25 * 0.81) ** 2 * np.cos(np.sqrt(10) / 5 * x) ** 4
    )
    assert soliton.nesterenko_overlap(2.6, 0.9) == 0
    assert soliton.nesterenko_speed(1.0) == pytest.approx(0.914610, abs=1e-6)
    f = np.array([1.001, 1.2, 3.0, 100.0])
    coste = np.sqrt(4 / 15 * (3 + 2 * f ** (5 / 3) - 5 * f ** (2 / 3))) / (f ** (2 / 3) - 1)
    assert soliton.coste_speed(f) == pytest.approx(coste, rel=1e-9)


def test_struck_is_the_inverse_of_solve():
    for speed, delta in ((1.002, 1.5), (1.2, 3.0)):
        wave = solve(speed=speed, delta=delta)
        struck = soliton.struck(float(wave.velocity(0.0)), delta)
        assert struck.speed == pytest.approx(speed, rel=1e-12)


@pytest.mark.parametrize("downward", [True, False])
@pytest.mark.parametrize("load", [0.0, 2.0])
def test_on_a_chain(load: float, downward: bool):
    """Profile, energy and momentum are in SI units; the fixed bottom grain does not move."""
    chain = column(120, gravity=0.0, top_load=load, material="steel", bottom="fixed")
    wave = solve(speed=1.3) if load else solve(velocity=0.02)
    profile = wave.on(chain, 60.3, downward)
    u, v = profile.initial(chain)
    length = chain.length_scale if load else (chain.masses[0] / chain.contact_constants[0]) ** 0.4
    unit = chain.length_scale / chain.time_scale if load else 1.0
    sign = 1 if downward else -1
    x = sign * (np.arange(1, 120) - 60.3)
    largest = float(wave.displacement(-100.0))
    moved = wave.displacement(x) if downward else largest - wave.displacement(x)
    assert u == pytest.approx(np.append(length * moved, 0), rel=0, abs=1e-12 * length * largest)
    velocity = np.append(sign * unit * wave.velocity(x), 0)
    assert v == pytest.approx(velocity, rel=1e-12, abs=1e-300)
    assert chain.masses @ v == pytest.approx(
        sign * chain.masses[0] * unit * wave.momentum, rel=1e-12
    )
    assert chain.excess_energy(u, v) == pytest.approx(
        chain.masses[0] * unit**2 * wave.energy, rel=1e-9
    )


@waves(VACUUM[:1] + LOADED[:1])
def test_picture(wave: Soliton):
    (axes,) = wave.plot().figure.axes
    x = axes.lines[0].get_xdata()
    half = min(wave.reach, 3.2 * wave.width)
    # The middle of equally spaced points is 0 up to a rounding error of half the range.
    assert x[[0, 200, 400]] == pytest.approx([-half, 0, half], rel=1e-14, abs=1e-14 * half)
    assert x.size == 401
    limit = soliton.kdv_overlap if wave.loaded else soliton.nesterenko_overlap
    formula = limit(x, wave.speed, wave.delta)
    for line, name in zip(axes.lines, ("overlap", "velocity", "displacement"), strict=False):
        values = getattr(wave, name)(x)
        assert line.get_ydata() == pytest.approx(values / values.max(), rel=1e-14)
        assert line.get_label() == f"{name}, at most {values.max():.5g}"
    assert axes.lines[3].get_ydata() == pytest.approx(
        formula / wave.overlap(0.0), rel=1e-12, abs=1e-15
    )
    assert axes.lines[3].get_linestyle() == "--"
    assert (
        axes.lines[3].get_label()
        == f"overlap, {'Korteweg-de Vries' if wave.loaded else 'Nesterenko'}"
    )
    assert len(axes.lines) == len(axes.get_legend().get_texts()) == 4
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x − ct (grains)", "over the largest value")
    times = " times sound" if wave.loaded else ""
    assert axes.get_title("left") == f"δ = {wave.delta:g}, speed {wave.speed:.7g}{times}"


@pytest.mark.parametrize("delta", [1.2, 1.5, 3.0])
def test_explicit_approximations(delta: float):
    x = np.array([-0.9, 0.0, 0.4, 1.3])
    c = 0.8
    v = np.array([1e-3, 1.0, 7.0])
    q = (delta - 1) * np.sqrt(6 / (delta * (delta + 1)))
    cosine = np.where(np.abs(q * x) < np.pi / 2, np.cos(q * x), 0.0)
    overlap = ((delta + 1) * c**2 / 2) ** (1 / (delta - 1)) * cosine ** (2 / (delta - 1))
    assert soliton.nesterenko_overlap(x, c, delta) == pytest.approx(overlap, rel=1e-12)
    end = np.pi / 2 / q
    assert soliton.nesterenko_overlap(np.array([0.99, 1.01, 1.9]) * end, c, delta)[1:].tolist() == [
        0,
        0,
    ]
    speed = (2 / (delta + 1)) ** (1 / (delta + 1)) * v ** ((delta - 1) / (delta + 1))
    assert soliton.nesterenko_speed(v, delta) == pytest.approx(speed, rel=1e-13)
    sech = 2 / (np.exp(np.sqrt(0.3) * x) + np.exp(-np.sqrt(0.3) * x))
    assert soliton.kdv_overlap(x, 1.05, delta) == pytest.approx(
        0.3 / (delta - 1) * sech**2, rel=1e-12
    )
    energy, _ = quad(lambda r: ((1 + r) ** delta - 1) / delta, 0, 2.0, epsabs=0, epsrel=1e-13)
    assert soliton.coste_speed(3.0**delta, delta) == pytest.approx(
        np.sqrt(2 * energy) / 2, rel=1e-12
    )


def test_displacement_published():
    """Sen et al. (2008): f = 2.39536 x + 0.268529 x^3 + 0.0061347 x^5, within 3e-4 of the wave."""
    x = np.linspace(-3, 3, 13)
    f = 2.39536 * x + 0.268529 * x**3 + 0.0061347 * x**5
    assert soliton.sen_displacement(x) == pytest.approx(1 / (1 + np.exp(f)), rel=1e-9, abs=1e-16)
    wave = solved(**VACUUM[1])
    share = wave.displacement(x) / wave.displacement(-9.0)
    assert share == pytest.approx(soliton.sen_displacement(x), rel=0, abs=3e-4)


@each
def test_residual_between_the_points(wave: Soliton):
    """c^2 r = integral of (1 - |s|) N(r(x + s)): the stated residual is the largest one."""
    s, weight = np.polynomial.legendre.leggauss(120)
    s = np.concatenate((s - 1, s + 1)) / 2
    weight = np.tile(weight, 2) / 2
    x = np.linspace(0, wave.reach, 97)
    overlap = wave.overlap(x)
    integral = (
        excess(wave, wave.overlap(x[:, None] + s)) @ (weight * (1 - np.abs(s))) / wave.speed**2
    )
    off = np.abs(integral - overlap)
    assert off.max() < 1e-12 * overlap.max()
    assert (off / overlap).max() < 1e-7
    assert 0 < wave.residual < 1e-13


@pytest.mark.parametrize(
    ("arguments", "solutions", "terms"),
    [
        ((1.5, None), 16, 48),
        ((1.2, None), 16, 48),
        ((3.0, None), 29, 72),
        ((1.5, 1.2), 9, 108),
        ((1.5, 100.0), 7, 48),
        ((1.5, 1.001), 6, 72),
        ((1.5, 1.3, 0.5), 14, 48),
    ],
)
def test_the_number_of_linear_systems_of_a_search(
    arguments, solutions: int, terms: int, monkeypatch
):
    """Correct derivatives and enough coefficients let Newton's method end soon."""
    systems = []
    solve_linear = np.linalg.solve

    def counted(matrix, right):
        systems.append(right.size)
        return solve_linear(matrix, right)

    monkeypatch.setattr(soliton_series.np.linalg, "solve", counted)
    series = soliton_series.solve_series.__wrapped__(*arguments)
    assert len(systems) <= solutions
    assert series.coefficients.size == terms


def test_an_unresolvable_wave_is_reported(monkeypatch):
    short = replace(soliton_series.RESOLUTION, most_terms=60)
    monkeypatch.setattr(soliton_series, "RESOLUTION", short)
    for arguments, key in (((1.5, 1.2), "speed"), ((3.0, None), "delta")):
        with pytest.raises(InputError, match=f"^{key}: its wave is too wide or too sharp"):
            soliton_series.solve_series.__wrapped__(*arguments)


def test_positions_at_which_a_wave_fits_a_chain():
    """The wave extends to 1e-10 of its largest overlap, and one grain more, on both sides."""
    wave = solved(**VACUUM[1])
    far = 1 + brentq(lambda x: float(wave.overlap(x) / wave.overlap(0.0)) - 1e-10, 1, wave.reach)
    chain = Chain(**CHAIN)
    low, high = 1 + far, 39 - far  # Grain 40 is fixed.
    for grain in (low + 1e-6, high - 1e-6):
        assert wave.on(chain, grain).velocity.max() > 0
    for grain in (low - 1e-3, high + 1e-3):
        with pytest.raises(InputError, match=rf"^grain: must lie from {low:.1f} to {high:.1f} for"):
            wave.on(chain, grain)
    first = int(20 - far)
    last = int(np.ceil(20 + far))
    masses = chain.masses
    for odd, number in ((first, 0), (last, 0), (first - 1, 1), (last + 1, 1)):
        uneven = masses * np.where(np.arange(1, 41) == odd, 1 + 2e-9, 1.0)
        slightly = masses * np.where(np.arange(1, 41) == odd, 1 + 0.9e-9, 1.0)
        wave.on(Chain(**CHAIN, masses=slightly), 20)
        if number:
            wave.on(Chain(**CHAIN, masses=uneven), 20)
            continue
        with pytest.raises(
            InputError, match=f"^chain: must be uniform from grain {first} to {last}, where"
        ):
            wave.on(Chain(**CHAIN, masses=uneven), 20)
    for odd, number in ((first, 0), (last - 1, 0), (first - 1, 1), (last, 1)):
        factors = np.where(np.arange(1, 40) == odd, 1 + 2e-9, 1.0)
        uneven = Chain(**CHAIN, contact_constants=chain.contact_constants * factors)
        if number:
            wave.on(uneven, 20)
            continue
        with pytest.raises(InputError, match=r"^chain: must be uniform from grain"):
            wave.on(uneven, 20)


CHAIN = {"grains": 40, "diameter": 1e-3, "gravity": 0.0}


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: solve(delta=1.0, velocity=1.0), "delta"),
        (lambda: solve(), "speed"),
        (lambda: solve(speed=1.2, velocity=1.0), "speed"),
        (lambda: solve(speed=1.0), "speed"),
        (lambda: solve(velocity=0.0), "velocity"),
        (lambda: solve(delta=50.0, velocity=1.0), "delta"),
        (lambda: solve(velocity=np.inf), "velocity"),
        (lambda: solve(speed=np.inf), "speed"),
        (lambda: solve(delta=6.1, velocity=1.0), "delta"),
        (lambda: soliton.struck(-1.0), "velocity"),
        (lambda: soliton.struck(np.inf), "velocity"),
        (lambda: soliton.struck(5e-4), "velocity"),
        (lambda: soliton.struck(1e-300), "velocity"),
        (lambda: soliton.struck(0.1, 1.0), "delta"),
        (lambda: soliton.struck(0.1, np.nan), "delta"),
        (lambda: soliton.coste_speed(1.0), "force"),
        (lambda: soliton.coste_speed(np.inf), "force"),
        (lambda: soliton.coste_speed(2.0, 1.0), "delta"),
        (lambda: soliton.nesterenko_speed(-1.0), "velocity"),
        (lambda: soliton.nesterenko_speed(np.nan), "velocity"),
        (lambda: soliton.nesterenko_speed(1.0, -1.0), "delta"),
        (lambda: soliton.nesterenko_overlap(np.nan, 1.0), "x"),
        (lambda: soliton.nesterenko_overlap(1.0, 0.0), "speed"),
        (lambda: soliton.nesterenko_overlap(1.0, 1.0, 1.0), "delta"),
        (lambda: soliton.sen_displacement(np.nan), "x"),
        (lambda: soliton.kdv_overlap(np.inf, 1.1), "x"),
        (lambda: soliton.kdv_overlap(1.0, 0.9), "speed"),
        (lambda: soliton.kdv_overlap(1.0, 1.1, np.inf), "delta"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN, exponent=2.0), 20), "chain"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN, top_load=1.0), 20), "top_load"),
        (lambda: solve(speed=2.0).on(Chain(**CHAIN), 20), "top_load"),
        (lambda: solve(velocity=1.0).on(column(40), 20), "gravity"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN), 2), "grain"),
        (
            lambda: solve(velocity=1.0).on(
                Chain(**CHAIN, impurity=[{"grain": 21, "diameter": 2e-3}]), 20
            ),
            "chain",
        ),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: "):
        call()
