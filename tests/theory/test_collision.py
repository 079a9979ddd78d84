"""Shifts of colliding solitary waves against Toda's chain, integrated by SciPy, and in limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lmpchain import InputError
from lmpchain.theory.collision import decay, kdv, toda


@pytest.mark.parametrize("speed", [1 + 1e-9, 1.001, 1.5, 40.0, 9e5])
def test_the_decay_solves_its_equation(speed: float) -> None:
    half = decay(speed) / 2
    assert np.sinh(half) / half == pytest.approx(speed, rel=1e-12)
    assert decay(1 + 1e-9) == pytest.approx(np.sqrt(24e-9), rel=1e-6)


@pytest.mark.parametrize("head_on", [True, False])
def test_waves_of_todas_chain_are_shifted(head_on: bool) -> None:
    """Solitons of two speeds pass each other in x_n'' = exp(-r_(n-1)) - exp(-r_n)."""
    speeds = np.array([1.9, -1.5]) if head_on else np.array([2.2, 1.3])
    start = np.array([20.0, 70.0]) if head_on else np.array([15.0, 30.0])
    rates = np.array([decay(abs(c)) for c in speeds])
    grain = np.arange(160.0)

    def overlap(t: float, which: int) -> np.ndarray:
        """Return minus the stretch of every spring by a soliton alone."""
        phase = rates[which] * (grain - start[which] - speeds[which] * t)
        return np.log1p(np.sinh(rates[which] / 2) ** 2 / np.cosh(phase / 2) ** 2)

    def velocity(which: int) -> np.ndarray:
        """Return the velocities, which are minus the sums of the rates of the stretches."""
        step = 1e-4
        change = (overlap(step, which) - overlap(-step, which)) / (2 * step)
        return -np.append(0.0, np.cumsum(change)[:-1])

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        r, v = np.split(y, 2)
        force = np.exp(-r)
        return np.concatenate((np.append(np.diff(v), -v[-1]), np.append(0.0, force[:-1]) - force))

    stretch = -sum(overlap(0.0, which) for which in (0, 1))
    y = np.concatenate((stretch, sum(velocity(which) for which in (0, 1))))
    end = 24.0 if head_on else 45.0
    found = -solve_ivp(rate, (0, end), y, "DOP853", [end], rtol=1e-9, atol=1e-11).y[:160, -1]
    for which in (0, 1):
        shift = toda(abs(speeds[which]), abs(speeds[1 - which]), head_on)
        place = start[which] + speeds[which] * end + np.sign(speeds[which]) * shift
        near = np.abs(grain - place) < 6
        phase = rates[which] * (grain - place)
        exact = np.log1p(np.sinh(rates[which] / 2) ** 2 / np.cosh(phase / 2) ** 2)
        assert np.abs(found - exact)[near].max() < 1e-3 * exact.max(), which


def test_weak_waves_of_equal_direction_have_the_shifts_of_both_laws() -> None:
    for weak in (1e-4, 1e-6):
        for fast, slow in ((3.0, 1.0), (1.0, 3.0)):
            pair = 1 + weak * fast, 1 + weak * slow
            assert kdv(*pair) == pytest.approx(toda(*pair, False), rel=3 * weak)
            assert np.sign(kdv(*pair)) == np.sign(fast - slow)


def test_waves_that_do_not_meet_are_refused() -> None:
    for law in (lambda a, b: toda(a, b, False), kdv):
        with pytest.raises(InputError, match=r"^other: must differ from speed"):
            law(1.2, 1.2)
        for pair in ((1.0, 1.2), (1.2, 0.9), (np.inf, 1.2)):
            with pytest.raises(InputError, match=r"^speed: must be above 1, that of sound \(got"):
                law(*pair)
