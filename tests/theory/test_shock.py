"""Closed forms of shocks agree with each other, and with KdV theory for weak shocks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from lmpchain import InputError
from lmpchain.theory.shock import Medium, State

GAS = Medium(exponent=1.5, constant=2.0, mass=0.3)
AHEAD = State(0.1, 0.7)


def test_simple_waves_follow_the_characteristics() -> None:
    """J is the integral of the sound speed over the overlap, and `driven` is its inverse."""
    behind = GAS.behind(AHEAD, 1.3)
    overlaps = np.linspace(AHEAD.overlap, behind.overlap, 20001)
    integral = np.trapezoid([GAS.sound(x) for x in overlaps], overlaps)
    assert integral == pytest.approx(1.3 - AHEAD.velocity, rel=1e-8)


def test_steady_shock_conserves_mass_and_momentum() -> None:
    """Inflow equals outflow, with and without a load; in the latter case K R^(delta+1) = m v^2."""
    for ahead in (AHEAD, State(0.1, 0.0)):
        behind, speed = GAS.rankine_hugoniot(ahead, 1.3)
        rise = GAS.force(behind.overlap) - GAS.force(ahead.overlap)
        assert speed * (behind.overlap - ahead.overlap) == pytest.approx(1.2, rel=1e-12)
        assert GAS.mass * speed * 1.2 == pytest.approx(rise, rel=1e-12)
    assert behind.overlap == pytest.approx((0.3 * 1.2**2 / 2.0) ** 0.4, rel=1e-12)


def test_a_step_gives_the_state_of_both_waves() -> None:
    """The state between two waves is behind one wave and behind the mirrored other one."""
    left = State(0.4, 0.9)
    middle = GAS.between(left, AHEAD)
    assert GAS.behind(AHEAD, middle.velocity).overlap == pytest.approx(middle.overlap, rel=1e-12)
    mirrored = GAS.behind(State(-0.4, 0.9), -middle.velocity)
    assert mirrored.overlap == pytest.approx(middle.overlap, rel=1e-12)


def test_edges_solve_els_equations() -> None:
    """The closed forms agree with the numerical solution of El's equations for w = 2 c sin(k/2)."""
    behind = 1.4 * AHEAD.overlap

    def rate(overlap: float, slope: float) -> float:
        return slope * (GAS.exponent - 1) / 2 / overlap

    def linear(overlap: float, k: np.ndarray) -> np.ndarray:
        return rate(overlap, 1.0) * 2 / np.tan(k / 4)

    def solitary(overlap: float, q: np.ndarray) -> np.ndarray:
        return -rate(overlap, 1.0) * 2 / np.tanh(q / 4)

    step = 1e-9 * AHEAD.overlap
    start = [4 * np.sqrt(rate(AHEAD.overlap, step))]
    options = {"rtol": 1e-11, "atol": 1e-13}
    k = solve_ivp(linear, (AHEAD.overlap + step, behind), start, **options).y[0, -1]
    start = [4 * np.sqrt(rate(behind, step))]
    q = solve_ivp(solitary, (behind - step, AHEAD.overlap), start, **options).y[0, -1]
    edges = GAS.dispersive(AHEAD, behind)
    assert edges.trailing == pytest.approx(GAS.sound(behind) * np.cos(k / 2), rel=1e-7)
    leading = GAS.sound(AHEAD.overlap) * np.sinh(q / 2) / (q / 2)
    assert edges.leading == pytest.approx(leading, rel=1e-7)


@pytest.mark.parametrize("law", ["dispersive", "toda"])
@pytest.mark.parametrize("exponent", [1.3, 2.6])
def test_weak_shocks_agree_with_kdv_theory(law: str, exponent: float) -> None:
    """The differences of both edges scale with the square of the jump."""
    gas = Medium(exponent, 2.0, 0.3)
    jumps = 0.04 * AHEAD.overlap / 2.0 ** np.arange(4)
    for number in range(2):
        differences = [
            abs(getattr(gas, law)(AHEAD, AHEAD.overlap + jump)[number] - limit[number])
            for jump in jumps
            if (limit := gas.kdv(AHEAD, AHEAD.overlap + jump))
        ]
        slopes = np.diff(np.log2(differences))
        assert slopes == pytest.approx(-2.0, abs=0.05)
    heights = gas.dispersive(AHEAD, AHEAD.overlap + jumps[0]).height
    assert heights == pytest.approx(2 * jumps[0], rel=0.04)


def test_the_leading_wave_of_a_toda_shock_is_its_soliton() -> None:
    """A soliton of speed c sinh(q) / q compresses a contact by 2 / b log(cosh(q))."""
    length = AHEAD.overlap / (GAS.exponent - 1)
    for jump in (0.1, 1.0, 3.0):
        edges = GAS.toda(AHEAD, AHEAD.overlap + jump)
        ratio = edges.leading / GAS.sound(AHEAD.overlap)
        q = brentq(lambda q, ratio=ratio: np.sinh(q) / q - ratio, 1e-6, 20.0)
        assert edges.height == pytest.approx(2 * length * np.log(np.cosh(q)), rel=1e-9)


def test_no_trailing_edge_behind_strong_shocks_and_in_a_vacuum() -> None:
    """If sound is twice as fast behind as ahead, the wave train extends to the piston."""
    assert GAS.dispersive(AHEAD, 15.9 * AHEAD.overlap).trailing > 0
    assert np.isnan(GAS.dispersive(AHEAD, 16.1 * AHEAD.overlap).trailing)
    assert np.isnan(GAS.kdv(AHEAD, 5.1 * AHEAD.overlap).trailing)
    for law in (GAS.dispersive, GAS.toda, GAS.kdv):
        assert np.isnan(law(State(0.0, 0.0), 1.0)).all()


def test_contacts_open_behind_a_fast_withdrawal() -> None:
    """Grains fly at the velocity that corresponds to the whole overlap; the trailing edge stays."""
    escape, _ = quad(lambda x: np.sqrt(1.5 * 2.0 * np.sqrt(x) / 0.3), 0.0, AHEAD.overlap)
    for velocity in (AHEAD.velocity - 1.001 * escape, -1e9):
        behind = GAS.behind(AHEAD, velocity)
        assert behind.velocity == pytest.approx(AHEAD.velocity - escape, rel=1e-9)
        assert behind.overlap == 0
    edges = GAS.rarefaction(AHEAD, behind.overlap)
    assert edges[1:] == (0.0, -AHEAD.overlap)
    assert np.isnan(GAS.between(State(AHEAD.velocity - 2.1 * escape, 0.7), AHEAD).velocity)
    middle = GAS.between(State(AHEAD.velocity - 1.9 * escape, 0.7), AHEAD)
    # The remaining J is 1 - 0.95 of it, and J scales with the power 5/4 of the overlap.
    assert middle.overlap == pytest.approx(0.7 * 0.05**0.8, rel=1e-9)


@pytest.mark.parametrize("overlap", [-1e-9, np.nan, np.inf])
def test_overlaps_of_gaps_are_rejected(overlap: float) -> None:
    """No power of a negative overlap is taken, ahead or behind."""
    gap = State(0.0, overlap)
    for law in (
        lambda: GAS.force(overlap),
        lambda: GAS.sound(overlap),
        lambda: GAS.invariant(overlap),
        lambda: GAS.behind(gap, 1.0),
        lambda: GAS.between(gap, AHEAD),
        lambda: GAS.rankine_hugoniot(gap, 1.0),
        lambda: GAS.rarefaction(AHEAD, overlap),
        lambda: GAS.dispersive(gap, 1.0),
        lambda: GAS.toda(gap, 1.0),
        lambda: GAS.kdv(gap, 1.0),
        lambda: GAS.thickness(gap, 1.0, 1e-3),
    ):
        with pytest.raises(InputError, match="overlap: "):
            law()


def test_thickness_is_that_of_the_profile_of_burgers() -> None:
    """The profile is a tanh, whose jump over its steepest slope is 8 nu over the jump of speeds."""
    for constant in (2.0, 8.0):
        gas = replace(GAS, constant=constant)
        low, high = gas.sound(0.7), gas.sound(0.75)
        nu = 1e-3 * low**2 / 2
        x = np.linspace(-1e-3, 1e-3, 3) * nu / (high - low)
        speeds = (high - low) / 2 * np.tanh(-(high - low) * x / (4 * nu))
        steepest = -np.gradient(speeds, x)[1]
        found = gas.thickness(State(0.0, 0.7), 0.75, 1e-3)
        assert found == pytest.approx((high - low) / steepest, rel=1e-6)


def test_waves_of_the_wrong_type_are_rejected() -> None:
    """A shock does not expand the chain, a rarefaction does not compress it."""
    less = 0.5 * AHEAD.overlap
    laws = (GAS.dispersive, GAS.toda, GAS.kdv, lambda *pair: GAS.thickness(*pair, 1e-3))
    for law in laws:
        with pytest.raises(InputError, match=r"overlap: must .* otherwise there is no shock"):
            law(AHEAD, less)
    with pytest.raises(InputError, match="overlap: must not exceed the overlap ahead"):
        GAS.rarefaction(AHEAD, 2 * AHEAD.overlap)


def test_linear_chains_and_pulling_pistons_are_rejected() -> None:
    """Springs and a pulling piston make no shock."""
    with pytest.raises(InputError, match="exponent: must be above 1"):
        Medium(1.0, 2.0, 0.3)
    for velocity, message in ((0.05, "must exceed"), (np.inf, "must be finite")):
        with pytest.raises(InputError, match=f"velocity: {message}"):
            GAS.rankine_hugoniot(AHEAD, velocity)
