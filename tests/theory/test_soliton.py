"""Solitary waves of the lattice: the equation itself, conservation laws, limits, published numbers, refusals."""

import numpy as np
import pytest
from scipy.integrate import quad

from lmpchain import Chain, InputError
from lmpchain.theory import soliton
from lmpchain.theory.soliton import Soliton, solve

VACUUM = [solve(delta=delta, velocity=0.7) for delta in (1.2, 1.5, 2.0, 3.0)]
LOADED = [solve(delta=delta, speed=speed) for delta, speed in ((1.5, 1.01), (1.5, 1.5), (1.5, 8.0), (3.0, 1.2))]
each = pytest.mark.parametrize("wave", VACUUM + LOADED, ids=lambda w: f"{w.delta}, {w.speed:.3g}")


def excess(wave: Soliton, overlap: np.ndarray) -> np.ndarray:
    """Return the force of a contact, written out."""
    return ((1 + overlap) ** wave.delta - 1) / wave.delta if wave.loaded else overlap**wave.delta


@each
def test_equation_of_motion(wave: Soliton):
    """c^2 r'' = N(x - 1) - 2 N(x) + N(x + 1), by differences of order 8 of the overlap."""
    step, x = 0.02 * wave.width, np.linspace(-1.5, 1.5, 31) * wave.width
    weights = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040 / step**2
    curvature = wave.overlap(x[:, None] + step * np.arange(-4, 5)) @ weights
    force = [excess(wave, wave.overlap(x + s)) for s in (-1, 0, 1)]
    scale = np.abs(curvature).max() * wave.speed**2
    assert wave.speed**2 * curvature == pytest.approx(force[0] - 2 * force[1] + force[2], abs=1e-8 * scale)


@each
def test_integrals_of_velocity(wave: Soliton):
    """Displacement by quadrature of the velocity; momentum c times what a grain moves."""
    x = 0.3
    moved, _ = quad(lambda y: float(wave.velocity(y)) / wave.speed, x, wave.reach, epsabs=0, epsrel=1e-12, limit=200)
    assert float(wave.displacement(x)) == pytest.approx(moved, rel=1e-11)
    assert wave.momentum == pytest.approx(wave.speed * float(wave.displacement(-2 * wave.reach)), rel=1e-12)
    assert wave.overlap(x) == pytest.approx(wave.displacement(x - 0.5) - wave.displacement(x + 0.5), rel=1e-9)


@each
def test_energy_and_momentum_are_those_at_any_instant(wave: Soliton):
    for shift in (0.13, 0.5):
        n = np.arange(-200, 201) + shift
        r = wave.overlap(n + 0.5)
        power = wave.delta + 1
        contact = (((1 + r) ** power - 1) / power - r) / wave.delta if wave.loaded else r**power / power
        assert wave.energy == pytest.approx((wave.velocity(n) ** 2 / 2 + contact).sum(), rel=1e-10)
        assert wave.momentum == pytest.approx(wave.velocity(n).sum(), rel=1e-12)


@pytest.mark.parametrize("wave", [LOADED[i] for i in (0, 1, 3)], ids=lambda w: f"{w.delta}, {w.speed:.3g}")
def test_exponential_tail(wave: Soliton):
    """sinh(kappa/2) = c kappa/2 of linear waves, far from the middle; complex roots decay nearly as slowly at 8 c."""
    kappa = -np.log(float(wave.overlap(wave.reach - 0.5) / wave.overlap(wave.reach - 1.5)))
    assert np.sinh(kappa / 2) / (kappa / 2) == pytest.approx(wave.speed, rel=1e-9)


@pytest.mark.parametrize("wave", VACUUM, ids=lambda w: f"{w.delta}")
def test_double_exponential_tail(wave: Soliton):
    """log r(x + 1) / log r(x) tends to delta, here with the curvature that the equation leaves of the overlap."""
    x = 0.8 * wave.reach
    log = np.log([float(wave.overlap(x + s)) for s in (-1e-4, 0, 1e-4)])
    first, second = (log[2] - log[0]) / 2e-4, (log[2] - 2 * log[1] + log[0]) / 1e-8
    r = np.exp(log[1])
    force = [excess(wave, wave.overlap(x + s)) for s in (-1, 0, 1)]
    assert wave.speed**2 * r * (second + first**2) == pytest.approx(force[0] - 2 * force[1] + force[2], rel=1e-5)
    assert 0 < wave.overlap(wave.reach) < 1e-18
    assert wave.overlap(np.array([1.5, 3.0]) * wave.reach)[1] == 0.0


def test_weak_waves_are_those_of_korteweg_and_de_vries():
    """Overlap and speed, relative errors of the first order in the excess of the speed."""
    x = np.linspace(0, 60, 61)
    off = []
    for e in (4e-4, 1e-4):
        wave = solve(speed=1 + e)
        off.append(np.abs(wave.overlap(x) - soliton.kdv_overlap(x, 1 + e)).max() / float(wave.overlap(0.0)))
    assert np.log(off[0] / off[1]) / np.log(4) == pytest.approx(1, abs=0.05)
    assert float(solve(speed=1.001).overlap(0.0)) * 0.5 / 6 == pytest.approx(1.001 - 1, rel=2e-3)


def test_strong_waves_are_those_of_the_sonic_vacuum():
    """V = G F^(1/6) of largest force and speed."""
    vacuum, strong = solve(velocity=1.0), solve(speed=100.0)
    unit = vacuum.speed / float(vacuum.force(0.0)) ** (1 / 6)
    force = float((1 + strong.overlap(0.0)) ** 1.5)
    assert strong.speed * np.sqrt(1.5) / force ** (1 / 6) == pytest.approx(unit, rel=1e-5)
    assert strong.width == pytest.approx(vacuum.width, rel=1e-4)


def test_long_waves_published():
    """Nesterenko's cos^4 and Coste's formula, written out."""
    x = np.linspace(-2, 2, 9)
    assert soliton.nesterenko_overlap(x, 0.9) == pytest.approx((1.25 * 0.81) ** 2 * np.cos(np.sqrt(10) / 5 * x) ** 4)
    assert soliton.nesterenko_overlap(2.6, 0.9) == 0
    assert soliton.nesterenko_speed(1.0) == pytest.approx(0.914610, abs=1e-6)
    f = np.array([1.001, 1.2, 3.0, 100.0])
    coste = np.sqrt(4 / 15 * (3 + 2 * f ** (5 / 3) - 5 * f ** (2 / 3))) / (f ** (2 / 3) - 1)
    assert soliton.coste_speed(f) == pytest.approx(coste, rel=1e-9)


def test_struck_is_solve_the_other_way():
    for speed in (1.002, 1.3, 6.0):
        wave = solve(speed=speed)
        assert soliton.struck(float(wave.velocity(0.0))).speed == pytest.approx(speed, rel=1e-12)


@pytest.mark.parametrize("downward", [True, False])
@pytest.mark.parametrize("load", [0.0, 2.0])
def test_on_a_chain(load: float, downward: bool):
    """SI units: energy and momentum of the chain, and every overlap."""
    chain = Chain(grains=120, diameter=1e-3, gravity=0.0, top_load=load, material="steel", bottom="fixed")
    wave = solve(speed=1.3) if load else solve(velocity=0.02)
    profile = wave.on(chain, 60.3, downward)
    u, v = profile.initial(chain)
    unit = chain.length_scale / chain.time_scale if load else 1.0
    sign = 1 if downward else -1
    assert v[59] == pytest.approx(sign * unit * float(wave.velocity(-0.3)), rel=1e-12)
    assert chain.masses @ v == pytest.approx(sign * chain.masses[0] * unit * wave.momentum, rel=1e-12)
    assert chain.excess_energy(u, v) == pytest.approx(chain.masses[0] * unit**2 * wave.energy, rel=1e-9)
    assert u[-1] == 0
    assert u[:2] == pytest.approx(u[0], rel=1e-9)


def test_picture():
    for wave in (VACUUM[1], LOADED[1]):
        lines = wave.plot().figure.axes[0].lines
        assert len(lines) == 4
        assert lines[0].get_ydata().max() == 1


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
        (lambda: soliton.struck(-1.0), "velocity"),
        (lambda: soliton.coste_speed(1.0), "force"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN, exponent=2.0), 20), "chain"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN, top_load=1.0), 20), "top_load"),
        (lambda: solve(speed=2.0).on(Chain(**CHAIN), 20), "top_load"),
        (lambda: solve(velocity=1.0).on(Chain(grains=40, diameter=1e-3), 20), "gravity"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN), 2), "grain"),
        (lambda: solve(velocity=1.0).on(Chain(**CHAIN, impurity=[{"grain": 21, "diameter": 2e-3}]), 20), "chain"),
    ],
)
def test_refusals(call, key: str):
    with pytest.raises(InputError, match=f"^{key}: "):
        call()
