"""Shocks and rarefactions over x / t, against the simple wave of gas dynamics."""

from functools import cache

import numpy as np
import pytest
from helpers.example_chains import column
from helpers.example_scenes import run, scene_of
from helpers.thinned import thinned

from lmpchain import Drive, Riemann, Trajectory, simulate
from lmpchain.measure import self_similar


@cache
def rarefaction(exponent: float, grain: int, share: float) -> Trajectory:
    """Simulate a step to a smaller overlap, until waves from the ends arrive."""
    chain = column(2 * grain, gravity=0.0, top_load=1.0, top="free", exponent=exponent)
    less = -share * chain.equilibrium_overlap[0] / 1e-3
    step = Riemann(velocity=(0, 0), strain=(less, 0), grain=grain)
    duration = 0.9 * grain * chain.time_scale
    return simulate(scene_of(chain, step, duration, 601), "native", 1e-6)


@pytest.mark.parametrize(
    ("exponent", "share"), thinned([(1.5, 0.3), (1.3, 0.5), (2.5, 0.4), (1.5, 0.8), (2.0, 0.6)], 3)
)
def test_a_rarefaction_approaches_the_simple_wave(exponent: float, share: float) -> None:
    """Within the fan the overlap scales as (x / c t)^(2 / (delta - 1)); errors cover the rest."""
    t = rarefaction(exponent, 250, share)
    chain = t.scene.chain
    seen = self_similar.view(t)
    rest = chain.equilibrium_overlap[0]
    sound = np.sqrt(
        exponent * chain.contact_constants[0] * rest ** (exponent - 1) / chain.masses[0]
    )
    fan = rest * (seen.speed / sound) ** (2 / (exponent - 1))
    inside = (seen.limit < 0.999 * rest) & (seen.limit > 1.001 * seen.shock.behind.overlap)
    assert inside.sum() > 10
    assert seen.limit[inside] == pytest.approx(fan[inside], rel=1e-9)
    off = np.abs(seen.overlap - seen.limit)
    assert (off[-1] <= seen.error).mean() > 0.97
    # The error is the largest change since the first profile within 3 % of the leading speed.
    change = np.abs(seen.overlap[-1] - seen.overlap[0])
    apart = np.abs(seen.speed[:, None] - seen.speed) / seen.shock.leading.speed
    least, most = (np.where(apart < reach, change, 0.0).max(1) for reach in (0.027, 0.031))
    assert ((least <= seen.error) & (seen.error <= most)).all()
    # The stated error is of the order of the departure, not of the wave.
    jump = rest - seen.shock.behind.overlap
    assert np.median(seen.error) < 0.15 * jump
    # The profile approaches its limit at each moment.
    assert (np.diff(off.mean(1)) < 0).all()


def test_an_upward_wave_is_the_mirror_image() -> None:
    """The same step, mirrored, gives the same profile."""
    t = rarefaction(1.5, 250, 0.3)
    chain = t.scene.chain
    less = -0.3 * chain.equilibrium_overlap[0] / 1e-3
    step = Riemann(velocity=(0, 0), strain=(0, less), grain=249)
    mirrored = simulate(t.scene.replace(excitation=step), "native", 1e-6)
    down = self_similar.view(t)
    *_, limit, leading, trailing = down.plot().lines
    assert limit.get_label() == "simple wave"
    assert np.array_equal(limit.get_ydata(), down.limit, equal_nan=True)
    edges = [down.shock.leading.speed, down.shock.trailing.speed]
    assert [line.get_xdata()[0] for line in (leading, trailing)] == edges
    up = self_similar.view(mirrored, "up")
    assert up.shock.kind == "rarefaction"
    assert up.speed == pytest.approx(down.speed, rel=1e-2)
    jump = chain.equilibrium_overlap[0] - down.shock.behind.overlap
    for name in ("overlap", "limit", "error"):
        one, other = (getattr(each, name) for each in (up, down))
        assert np.abs(one - other).mean() < 0.07 * jump


def test_a_dispersive_shock_keeps_its_edges_but_has_no_limit() -> None:
    """Profiles at all moments lie between the edges; pictures have labels."""
    chain = column(300, gravity=0.0, top_load=1.0, top="wall")
    speed = 0.3 * chain.equilibrium_overlap[0] / chain.time_scale
    piston = Drive(shape="piston", velocity=float(speed), rise=1e-6, grain=0)
    seen = self_similar.view(run(chain, piston, 270 * chain.time_scale, 1201, 1e-6))
    shock = seen.shock
    assert shock.kind == "dispersive shock"
    assert np.isnan(seen.limit).all()
    jump = shock.behind.overlap - shock.ahead.overlap
    ahead = seen.speed > 1.08 * shock.leading.speed
    behind = (seen.speed < 0.8 * shock.trailing.speed) & (seen.speed > 0.1 * shock.trailing.speed)
    assert np.abs(seen.overlap[:, ahead] - shock.ahead.overlap).max() < 0.02 * jump
    assert np.abs(seen.overlap[-1, behind] - shock.behind.overlap).max() < 0.2 * jump
    # The wave begins halfway through the rise of the piston.
    start = 0.5e-6
    ages = np.array([0.4, 0.6, 0.8, 1.0])
    assert seen.moment == pytest.approx(start + ages * (shock.time - start), rel=2e-3)
    axes = seen.plot()
    assert axes.get_xlabel() == "distance over time (grains/s)"
    assert axes.get_ylabel() == "overlap"
    *profiles, leading, trailing = axes.lines
    for line, overlap in zip(profiles, seen.overlap, strict=True):
        assert np.array_equal(line.get_xydata().T, [seen.speed, overlap])
    for line, edge in ((leading, shock.leading), (trailing, shock.trailing)):
        assert line.get_xdata() == [edge.speed, edge.speed]
    # A contact is at its distance over the age of the wave.
    row = np.abs(shock.moment - seen.moment[1]).argmin()
    speeds = (shock.contact - 1) / (shock.moment[row] - start)
    inside = speeds < seen.speed[-1]
    values = np.interp(speeds[inside], seen.speed, seen.overlap[1])
    assert values == pytest.approx(shock.overlap_then[row][inside], abs=0.1 * jump)
