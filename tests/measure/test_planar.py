"""Waves of dispersive shocks beside orbits of a planar ODE, against exact solitary waves."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.example_scenes import run
from helpers.thinned import thinned
from scipy.interpolate import BSpline, PPoly, make_interp_spline
from scipy.optimize import brentq

from lmpchain import Chain, Drive, InputError, Riemann, Trajectory
from lmpchain.measure import planar, shock
from lmpchain.theory.soliton import solve


@cache
def shock_of(exponent: float, strength: float, grains: int = 300) -> Trajectory:
    """Simulate the dispersive shock of a piston; its speed is in overlaps per unit of time."""
    chain = Chain(
        grains=grains, diameter=1e-3, gravity=0.0, top_load=1.0, top="wall", exponent=exponent
    )
    speed = strength * float(chain.equilibrium_overlap[0]) / chain.time_scale
    piston = Drive(shape="piston", velocity=speed, rise=1e-6, grain=0)
    duration = 0.9 * grains * chain.time_scale
    return run(chain, piston, duration, 4 * grains + 1, 1e-6)


@cache
def waves_of(exponent: float, strength: float) -> planar.PlanarOrbits:
    """Return the waves of this shock beside their orbits."""
    return planar.orbits(shock_of(exponent, strength))


def by_quadrature(
    law: tuple[float, float], inertia: float, ends: tuple[float, float], of_forces: bool = False
) -> tuple[float, float]:
    """Return the spacing and the mean overlap of a closed orbit from its first integral.

    The law is F = K r^delta, as (K, delta); the inertia is m c^2.
    """
    constant, delta = law
    low, high = constant * np.array(ends) ** delta if of_forces else ends
    # The variable y has y'' = 12 (sign y + factor y^power) + constant.
    sign, factor, power = 1, -constant / inertia, delta
    if of_forces:
        sign, factor, power = -1, inertia / constant ** (1 / delta), 1 / delta

    def potential(y: Any) -> Any:
        return 12 * (sign * y**2 / 2 + factor * y ** (power + 1) / (power + 1))

    slope = (potential(high) - potential(low)) / (high - low)
    # The angle removes the singularities at the ends, so that midpoints converge exponentially.
    angle = (np.arange(1000) + 0.5) * np.pi / 1000
    y = (high + low) / 2 + (high - low) / 2 * np.cos(angle)
    square = 2 * (potential(y) - potential(low) - slope * (y - low))
    weight = (high - low) / 2 * np.sin(angle) / np.sqrt(square) * np.pi / 1000
    overlap = (y / constant) ** (1 / delta) if of_forces else y
    return 2 * weight.sum(), weight @ overlap / weight.sum()


@pytest.mark.parametrize(
    ("exponent", "strength"),
    thinned([(1.5, 0.1), (1.3, 0.6), (3.0, 0.3), (1.5, 0.6), (2.0, 0.3)], 4),
)
def test_orbits_have_the_spacing_and_mean_of_the_waves(exponent: float, strength: float) -> None:
    waves = waves_of(exponent, strength)
    assert len(waves.orbits) >= 4
    off = np.abs(waves.orbit_spacing - waves.spacing)
    assert (off <= waves.spacing_error + waves.orbit_spacing_error).mean() >= 0.9
    off = np.abs(waves.orbit_mean - waves.mean)
    assert (off <= waves.mean_error + waves.orbit_mean_error).mean() >= 0.9
    chain = shock_of(exponent, strength).scene.chain
    for k, ends in enumerate(zip(waves.trough, waves.crest, strict=True)):
        law = chain.contact_constants[0], exponent
        inertia = chain.masses[0] * waves.phase_speed[k] ** 2
        first, second = (by_quadrature(law, inertia, ends, forces) for forces in (False, True))
        assert (waves.orbit_spacing[k], waves.orbit_mean[k]) == pytest.approx(first, rel=1e-5)
        errors = waves.orbit_spacing_error[k], waves.orbit_mean_error[k]
        assert errors == pytest.approx(np.abs(np.subtract(first, second)), rel=1e-3)
    # The errors are small enough for a meaningful comparison.
    assert np.median(waves.orbit_spacing_error / waves.orbit_spacing) < 0.12
    assert np.median(waves.spacing_error / waves.spacing) < 0.08
    jump = waves.crest[0] - waves.trough[0]
    assert np.median(waves.mean_error) < 0.06 * jump
    assert (np.diff(waves.self_similar) < 0).all()
    seen = shock.find(shock_of(exponent, strength))
    # Lower waves are left out.
    assert (waves.crest - waves.trough > 0.05 * (seen.behind.overlap - seen.ahead.overlap)).all()


def test_the_picture_shows_six_orbits_with_their_waves() -> None:
    """Orbits run from crest to trough and back, the first to the last of the wave."""
    waves = waves_of(1.5, 0.1)
    axes = waves.plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("overlap", "change of overlap a grain")
    lines, dots = axes.lines[::2], axes.lines[1::2]
    assert len(lines) == len(dots) == 6
    chosen = [0, len(waves.orbits) - 1]
    for number, line, dot in zip(chosen, (lines[0], lines[-1]), (dots[0], dots[-1]), strict=True):
        orbit = waves.orbits[number]
        assert line.get_label() == f"x/t = {waves.self_similar[number]:.4g} grains/s"
        assert line.get_xdata() == pytest.approx([*orbit.overlap, *orbit.overlap[::-1]])
        assert line.get_ydata() == pytest.approx([*orbit.slope, *-orbit.slope[::-1]])
        assert dot.get_color() == line.get_color()
        # A measured wave is near its orbit.
        assert np.ptp(dot.get_xdata()) == pytest.approx(np.ptp(orbit.overlap), rel=0.3)
        steepest = np.abs(dot.get_ydata()).max()
        assert steepest == pytest.approx(np.abs(orbit.slope).max(), rel=0.15)


def test_waves_are_measured_from_crest_to_crest() -> None:
    """Distances, speeds, crests and means agree with quintic splines through the overlaps."""
    t = shock_of(1.5, 0.1)
    waves = waves_of(1.5, 0.1)
    rest = t.scene.chain.equilibrium_overlap
    overlap = rest + t.displacement[:, :-1] - t.displacement[:, 1:]

    def crests_at(contact: int) -> tuple[BSpline, np.ndarray]:
        curve = make_interp_spline(t.time, overlap[:, contact - 1], 5)
        turns = PPoly.from_spline(curve.derivative()).roots(extrapolate=False)
        tops = turns[curve(turns, 2) < 0]
        return curve, tops[curve(tops).argmax() :]

    number = waves.contact
    curve, times = crests_at(number)
    count = len(waves.orbits)
    begin, end = times[:count], times[1 : count + 1]
    # A sudden piston of the same final speed would have begun half of its rise later.
    age = (begin + end) / 2 - t.scene.excitation.rise / 2
    assert waves.self_similar == pytest.approx((number - 1) / age, rel=1e-3)
    near, far = (
        2 * way / np.subtract(*(crests_at(number + side)[1][: count + 1] for side in (way, -way)))
        for way in (2, 4)
    )
    speed = (near[1:] + near[:-1]) / 2
    assert waves.phase_speed == pytest.approx(speed, rel=1e-3)
    assert waves.spacing == pytest.approx(waves.phase_speed * (end - begin), rel=1e-4)
    heights = curve(times)
    change = np.abs(np.diff(heights))[:count]
    size = (heights[1 : count + 1] + heights[:count]) / 2
    trough = [curve(np.linspace(*ends, 400)).min() for ends in zip(begin, end, strict=True)]
    mean = [curve.integrate(*ends) for ends in zip(begin, end, strict=True)] / (end - begin)
    for found, true in ((waves.crest, size), (waves.trough, trough), (waves.mean, mean)):
        assert found == pytest.approx(np.array(true), rel=1e-4)
    assert waves.mean_error == pytest.approx(change, rel=0.05)
    spread = np.abs((far[1:] + far[:-1]) / 2 - speed) + np.abs(far[:-1] - speed)
    spread = spread / speed + change / (size - trough) / 2
    assert waves.spacing_error == pytest.approx(spread * waves.spacing, rel=0.02)
    for orbit, low, high in zip(waves.orbits, waves.trough, waves.crest, strict=True):
        assert orbit.overlap[[0, -1]] == pytest.approx([high, low], rel=1e-9)
        assert np.gradient(orbit.overlap, orbit.place)[5:-5] == pytest.approx(
            orbit.slope[5:-5], rel=2e-2
        )


@pytest.mark.parametrize("exponent", [1.5, 2.0])
@pytest.mark.parametrize(("speed", "share"), [(1.01, 0.01), (1.03, 0.03), (1.1, 0.1)])
def test_the_homoclinic_orbit_approaches_the_solitary_wave(
    exponent: float, speed: float, share: float
) -> None:
    """The outermost orbit ends at the overlap ahead; exact waves have nearly its size."""
    inertia = exponent * speed**2

    def energy(top: float) -> float:
        """Return the integral of the bend from the saddle at 1 to a crest."""
        height = top - 1
        power = (top ** (exponent + 1) - 1) / (exponent + 1) - height
        return inertia * height**2 / 2 - power

    crest = brentq(energy, 1 + 1e-3, 4.0)
    exact = solve(exponent, speed=speed)
    assert crest - 1 == pytest.approx(float(exact.overlap(0.0)), rel=2 * share)
    low = 1 + 1e-4 * (crest - 1)
    spacing, mean = by_quadrature((1.0, exponent), inertia, (low, crest))
    area = np.trapezoid(exact.overlap(np.linspace(-60, 60, 6001)), dx=0.02)
    assert spacing * (mean - low) == pytest.approx(area, rel=2 * share)


def test_weak_orbits_are_harmonic() -> None:
    """Small orbits about r have 4 sin^2(k / 2) = k^2 (1 - k^2 / 12 ...) of the lattice."""
    # The force 2 r^1.5 and the mass 6 give a speed of sound of 1 at the overlap 4.
    for speed in (0.99, 0.95):
        near, far = (
            by_quadrature((2.0, 1.5), 6 * speed**2, (4 - 4e-3, 4 + 4e-3), forces)
            for forces in (False, True)
        )
        assert near == pytest.approx((2 * np.pi / np.sqrt(12 * (speed**-2 - 1)), 4.0), rel=1e-3)
        assert far == pytest.approx((2 * np.pi / np.sqrt(12 * (1 - speed**2)), 4.0), rel=1e-3)
        # The wavenumber k of the lattice has the phase speed sin(k / 2) / (k / 2).
        k = brentq(lambda k, speed=speed: np.sin(k / 2) - speed * k / 2, 1e-3, np.pi)
        assert near[0] < 2 * np.pi / k < far[0]


def test_waves_of_a_step_are_measured_at_seven_tenths_of_their_way() -> None:
    chain = Chain(grains=300, diameter=1e-3, gravity=0.0, top_load=1.0, top="free")
    speed = 0.6 * float(chain.equilibrium_overlap[0]) / chain.time_scale
    step = Riemann(velocity=(speed, 0), strain=(0, 0), grain=120)
    t = run(chain, step, 100 * chain.time_scale, 801, 1e-6)
    seen = shock.find(t)
    # The front is the last contact beyond half of the jump.
    half = (seen.behind.overlap + seen.ahead.overlap) / 2
    front = 1 + int(np.flatnonzero(seen.overlap > half)[-1])
    assert planar.orbits(t).contact == pytest.approx(120 + 0.7 * (front - 120), abs=2)


def test_only_dispersive_shocks_have_orbits() -> None:
    chain = Chain(grains=300, diameter=1e-3, gravity=0.0, top_load=1.0, top="free")
    less = -0.5 * float(chain.equilibrium_overlap[0]) / 1e-3
    step = Riemann(velocity=(0, 0), strain=(less, 0), grain=150)
    t = run(chain, step, 120 * chain.time_scale, 401, 1e-6)
    with pytest.raises(InputError, match="not of a rarefaction"):
        planar.orbits(t)
