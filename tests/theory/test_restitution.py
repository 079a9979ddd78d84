"""Restitution of two spheres against the motion, the series, and linear springs."""

import math

import numpy as np
import pytest
from helpers.faults import faults
from scipy.integrate import solve_ivp

from lmpchain import Damping, InputError
from lmpchain.chain.materials import GLASS, MATERIALS
from lmpchain.theory import restitution

STEEL = MATERIALS["steel"]
SPHERES = {"material": ("steel", GLASS), "diameter": (1e-2, 4e-3)}


def pair() -> tuple[float, float]:
    """Return K and the reduced mass of these spheres."""
    compliance = sum((1 - m.poissons_ratio**2) / m.youngs_modulus for m in (STEEL, GLASS))
    radius = 1 / (1 / 5e-3 + 1 / 2e-3)
    masses = math.pi / 6 * np.array([STEEL.density * 1e-6, GLASS.density * 6.4e-8])
    return 4 / 3 / compliance * math.sqrt(radius), 1 / (1 / masses).sum()


def rebound(x: complex) -> complex:
    """Return the restitution from the velocity form, x = 1.5 A (K/m)^(2/5) v^(1/5).

    With the root s of the overlap, and a time that runs by dt / s, all is a polynomial: no square
    root spoils the beginning and the end.
    """

    def move(_, state):
        s, v = state
        return v / 2, -(s**4) - x * s * s * v

    def apart(_, state):
        return state[0].real

    apart.terminal = True
    apart.direction = -1
    options = {"rtol": 1e-13, "atol": 1e-16, "method": "DOP853"}
    start = np.array([0.0, 1.0], type(x))
    s, v = solve_ivp(move, (0.0, 1e5), start, events=apart, **options).y[:, -1]

    def leave(left, state):
        r = s * left
        return 2 * s * (-(r**4) - x * r * r * state) / state

    # For complex x, only the real part of s vanishes there.
    return -solve_ivp(leave, (1.0, 0.0), [v], **options).y[0, -1]


@pytest.mark.parametrize("viscoelastic", [1e-9, 1e-8, 1e-7, 1e-6, 1e-5])
def test_four_decades_of_viscosity_and_speed(viscoelastic):
    constant, mass = pair()
    speeds = np.array([1e-3, 1e-2, 0.1, 1.0, 10.0])
    e = restitution.coefficient(speeds, viscoelastic, **SPHERES)
    x = 1.5 * viscoelastic * (constant / mass) ** 0.4 * speeds**0.2
    assert e == pytest.approx([rebound(float(value)) for value in x], abs=1e-9)
    # The series within its range.
    by_series = restitution.series(speeds, viscoelastic, **SPHERES)
    converges = x < 1
    assert (abs(by_series - e) <= 0.0489 * x**9 + 1e-11)[converges].all()
    two_terms = restitution.series(speeds, viscoelastic, **SPHERES, terms=2)
    assert (abs(two_terms - e) <= 0.523 * x**3 + 1e-11)[converges].all()


def test_coefficients_of_the_series():
    """The reference is Cauchy's integral over a circle, with another form of the equations."""
    radius = 0.45
    circle = radius * np.exp(2j * np.pi * np.arange(32) / 32)
    values = np.array([rebound(complex(x)) for x in circle])
    found = np.fft.fft(values).real / 32 / radius ** np.arange(32)
    assert found[:9] == pytest.approx(restitution.COEFFICIENTS, abs=1e-10)
    # First order: the energy loss along the elastic motion, an integral in closed form.
    first = 2 * 1.25**0.6 / 2.5 * math.gamma(0.6) * math.gamma(1.5) / math.gamma(2.1)
    assert -found[1] == pytest.approx(first, abs=1e-11)


@pytest.mark.parametrize("ratio", [1e-4, 1e-2, 0.3, 0.9, 0.99])
def test_springs_have_the_restitution_of_a_damped_oscillator(ratio):
    mass = STEEL.density * math.pi / 6 * 1e-6
    modulus = STEEL.youngs_modulus / (1 - STEEL.poissons_ratio**2) / 2
    constant = 4 / 3 * modulus * math.sqrt(2.5e-3) * math.sqrt(1e-2)
    omega = math.sqrt(constant / (mass / 2))
    e = restitution.coefficient([0.1, 7.0], 2 * ratio / omega, "steel", 1e-2, exponent=1.0)
    exact = math.exp(-math.pi * ratio / math.sqrt(1 - ratio**2))
    assert e == pytest.approx([exact, exact], rel=1e-12)


def test_it_inverts_the_fit_of_damping():
    damping = Damping.from_restitution(0.93, velocity=0.3, material="steel", diameter=1e-2)
    e = restitution.coefficient(0.3, damping.viscoelastic, "steel", 1e-2)
    assert e == pytest.approx(0.93, abs=1e-12)
    assert restitution.coefficient([0.3, 1.0], 0.0, "steel", 1e-2).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("velocity", 0.0),
        ("velocity", math.inf),
        ("viscoelastic", math.inf),
        ("viscoelastic", -1e-6),
        ("viscoelastic", [1e-6, 2e-6, 3e-6]),
        ("material", "stel"),
        ("material", ["steel", "steel", "steel"]),
        ("diameter", [1e-2, 0.0]),
        ("diameter", [1e-2, math.inf]),
        ("diameter", [1e-2] * 3),
        ("exponent", 0.5),
        ("exponent", math.inf),
        ("exponent", "1.5"),
    ],
)
def test_invalid_collisions(key, value):
    options = {"velocity": [1.0, 2.0], "viscoelastic": 1e-6, "material": "steel", "diameter": 1e-2}
    assert faults(restitution.coefficient, **options | {key: value})[0][0] == key


@pytest.mark.parametrize("terms", [0, 9, 2.5])
def test_the_series_has_eight_terms(terms):
    with pytest.raises(InputError, match="terms: must be 1 to 8"):
        restitution.series(1.0, 1e-6, "steel", 1e-2, terms=terms)


def test_velocities_and_viscosities_are_combined_like_arrays():
    """Every pair has the restitution of its own collision, and terms may be a float."""
    speeds = np.array([[0.1], [1.0]])
    times = np.array([1e-7, 1e-6, 2e-6])
    for law, options in ((restitution.coefficient, {}), (restitution.series, {"terms": 3.0})):
        together = law(speeds, times, "steel", 1e-2, **options)
        alone = [[law(v, a, "steel", 1e-2, **options) for a in times] for v in speeds[:, 0]]
        assert together.tolist() == np.array(alone).tolist()
    # The loss of slow spheres tends to 0, and squares of their velocities may underflow.
    slow = restitution.coefficient(1e-200, 1e-6, "steel", 1e-2)
    assert slow == pytest.approx(1.0, abs=1e-11)
