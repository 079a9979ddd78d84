"""Measured edges in the integrable limits: Toda's chain, and the KdV equation of weak waves."""

from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from lmpchain import Chain, Drive, Scene, simulate
from lmpchain.measure import shock
from lmpchain.theory.shock import Medium, State
from tests.helpers import toda_chain

LEVEL = {"material": "steel", "diameter": 9.5e-3, "gravity": 0.0, "top_load": 10.0}
CHAIN = Chain(grains=30, top="wall", bottom="wall", **LEVEL)
OVERLAP = float(CHAIN.contacts.overlap[1])
SOUND = float(np.sqrt(CHAIN.contacts.stiffness[1] / CHAIN.masses[1]))
LENGTH = OVERLAP / (CHAIN.exponent - 1)  # F' / F'', the unit of a Toda chain.


@cache
def toda(piston: float, grains: int) -> shock.Shock:
    """Measure the shock of a Toda chain, converted to a run of a granular chain."""
    duration = 0.97 * grains / toda_chain.exact(piston).leading
    time, x, v = toda_chain.integrate(piston, grains, duration, int(5 * duration))
    drive = Drive(shape="piston", velocity=piston * LENGTH * SOUND, rise=1e-9 / SOUND, grain=0)
    trajectory = SimpleNamespace(
        scene=SimpleNamespace(chain=CHAIN.replace(grains=grains), excitation=drive),
        time=time / SOUND,
        displacement=LENGTH * x,
        velocity=LENGTH * SOUND * v,
        grains=np.arange(1, grains + 1),
    )
    return shock.find(trajectory)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("piston", [0.6, 1.2])
def test_edges_of_a_toda_chain_tend_to_the_exact_ones_like_one_over_time(piston: float):
    """The leading soliton lags by 3 / (4 kappa) log t, so the errors fall with 1 / t."""
    exact = toda_chain.exact(piston)
    sizes = np.array([150, 300])
    waves = [toda(piston, grains) for grains in sizes]
    speed = np.array([wave.leading.speed / SOUND for wave in waves])
    height = np.array([wave.leading.height / LENGTH for wave in waves])
    for measured, limit in ((speed, exact.leading), (height, exact.height)):
        assert (measured < limit).all()
        slope = np.diff(np.log(limit - measured)) / np.diff(np.log(sizes))
        assert slope == pytest.approx(-1, abs=0.05)
    # The fit to the last third of the way, 2/3 to 1, changes the lag by 9/5 of log 3/2 over 1/3.
    lag = 0.75 / exact.width * exact.leading * 1.2
    assert (exact.leading - speed[1]) * sizes[1] == pytest.approx(lag, rel=0.1)
    # A slower soliton is lower; its speed is sinh(kappa) / kappa, its height 2 log cosh(kappa).
    slower = (np.cosh(exact.width) - exact.leading) / exact.width
    lower = 2 * np.tanh(exact.width)
    deficit = lag * lower / slower
    assert (exact.height - height[1]) * sizes[1] == pytest.approx(deficit, rel=0.07)
    for wave in waves:
        assert abs(wave.leading.speed / SOUND - exact.leading) < 3 * wave.leading.error / SOUND
        assert abs(wave.trailing.speed / SOUND - exact.trailing) < wave.trailing.error / SOUND
        assert wave.behind.overlap - OVERLAP == pytest.approx(LENGTH * exact.plateau, rel=1e-4)
        # The means of 1/t over the middle and the last third of the way differ by 0.71 of the last.
        missing = LENGTH * exact.height - wave.leading.height
        assert wave.leading.height_error == pytest.approx(0.71 * missing, rel=0.12)
    assert waves[1].trailing.error < 0.11 * SOUND
    # The prediction for a granular chain with the same first two terms is the same.
    theory = waves[0].predictions["toda"]
    assert theory.leading == pytest.approx(SOUND * exact.leading, rel=1e-4)
    assert theory.trailing == pytest.approx(SOUND * exact.trailing, rel=1e-4)
    assert theory.height == pytest.approx(LENGTH * exact.height, rel=1e-4)


def test_edges_of_a_young_toda_chain():
    """After 150 grains the errors show the lag of the leading soliton, and cover the others."""
    piston = 0.6
    exact = toda_chain.exact(piston)
    wave = toda(piston, 150)
    speed, error = wave.leading.speed / SOUND, wave.leading.error / SOUND
    lag = 0.75 / exact.width * exact.leading * 1.2
    assert (exact.leading - speed) * 150 == pytest.approx(lag, rel=0.15)
    # Both errors are 0.71 of the distance to the limit, apart from higher orders.
    missing = LENGTH * exact.height - wave.leading.height
    assert wave.leading.height_error == pytest.approx(0.71 * missing, rel=0.12)
    assert error == pytest.approx(0.71 * (exact.leading - speed), rel=0.13)
    assert abs(wave.trailing.speed / SOUND - exact.trailing) < wave.trailing.error / SOUND < 0.2
    assert wave.leading.velocity == pytest.approx(2 * piston * LENGTH * SOUND, rel=0.1)
    # The plateau has the velocity of the piston, and a jump between both conserves mass.
    away = abs(wave.behind.overlap - OVERLAP - LENGTH * exact.plateau)
    assert away < wave.behind_error.overlap < 0.05 * LENGTH * exact.plateau
    assert wave.behind.velocity == pytest.approx(piston * LENGTH * SOUND, rel=1e-3)
    assert wave.mass_speed == pytest.approx(piston / exact.plateau * SOUND, rel=2e-3)
    # A sudden push starts at 0, and the wave is as wide as its edges are apart.
    assert abs(wave.start) < 1e-6 / SOUND
    apart = (wave.leading.speed - wave.trailing.speed) * wave.time
    assert wave.thickness == pytest.approx(apart, rel=1e-6)


class Excess(NamedTuple):
    """Mach number minus 1 of a leading edge: measured in a long run, and in two theories."""

    run: float
    kdv: float
    whitham: float


def weak(size: float) -> Excess:
    """Return the excess for a piston that increases the overlap by a factor 1 + 4 `size`.

    The runs end at 90 and 180 KdV times, from which the 1 / t error is extrapolated.
    """
    gas = Medium(1.5, float(CHAIN.contacts.constant[1]), float(CHAIN.masses[1]))
    velocity = gas.invariant((1 + 4 * size) * OVERLAP) - gas.invariant(OVERLAP)
    drive = Drive(shape="piston", velocity=velocity, rise=1 / SOUND, grain=0)
    speeds = []
    for age in (90, 180):
        time = age / (2 * np.sqrt(size)) ** 3
        chain = CHAIN.replace(grains=int(time * (1 + 2 * size / 3)) + 10)
        samples = int(1.6 * time)
        scene = Scene(chain=chain, excitation=drive, duration=time / SOUND, samples=samples)
        speeds.append(shock.find(simulate(scene, "native", 1e-6)).leading.speed / SOUND)
    behind = (1 + 4 * size) * OVERLAP
    theories = (law(State(0.0, OVERLAP), behind).leading for law in (gas.kdv, gas.dispersive))
    kdv, whitham = (speed / SOUND - 1 for speed in theories)
    return Excess(2 * speeds[1] - speeds[0] - 1, kdv, whitham)


@pytest.mark.soak
def test_kdv_is_wrong_by_the_square_of_the_amplitude():
    """The deviation (KdV - leading edge) / e^2 tends to 49/45 as e falls, as in Whitham's theory.

    c_b / c_a = (1 + 4 e)^(1/4) = 1 + e - 3/2 e^2, and sinh(q/2) / (q/2) of cosh(q/2) = 2 c_b / c_a
    - 1 is 1 + 2/3 (c_b / c_a - 1) - 4/45 (c_b / c_a - 1)^2.
    """
    sizes = np.array([0.04, 0.08, 0.16])
    waves = [weak(size) for size in sizes]
    off = np.array([wave.kdv - wave.run for wave in waves])
    theory = np.array([wave.kdv - wave.whitham for wave in waves])
    slopes, expected = (np.diff(np.log(x)) / np.diff(np.log(sizes)) for x in (off, theory))
    np.testing.assert_allclose(slopes, expected, atol=0.05)
    limit = np.polyfit(sizes, off / sizes**2, 2)[-1]
    assert limit == pytest.approx(49 / 45, rel=0.05)
