"""Laws and grounds that are linear between kinks, against solutions by modes from kink to kink."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import lmpchain
from lmpchain import Chain, Impulse, InputError, Law, Scene

N = 6
K = 1e3
STEEP = 2e3
PLACES = np.linspace(0.5e-7, 3e-7, N - 1)
SPEED = 0.02
LAW = Law("k*o + q*max(o - e, 0)", k=K, q=STEEP, e=PLACES.tolist())
CHAIN = Chain(grains=N, diameter=1e-3, gravity=0.0, law=LAW)
MASS = float(CHAIN.masses[0])
# Overlaps of the displacements of the grains that move.
CLOSER = np.eye(N - 1) - np.eye(N - 1, k=1)


class Piece:
    """The motion from a time on while these contacts are beyond their kinks."""

    def __init__(self, begin: float, above: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
        self.begin = begin
        self.above = above
        stiffness = CLOSER.T @ np.diag(K + STEEP * above) @ CLOSER
        self.centre = np.linalg.solve(stiffness, CLOSER.T @ (STEEP * above * PLACES))
        squares, self.modes = np.linalg.eigh(stiffness / MASS)
        self.w = np.sqrt(squares)
        self.a = self.modes.T @ (x - self.centre)
        self.b = self.modes.T @ v / self.w

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements and velocities at a time."""
        c, s = np.cos(self.w * (t - self.begin)), np.sin(self.w * (t - self.begin))
        x = self.centre + self.modes @ (self.a * c + self.b * s)
        return x, self.modes @ (self.w * (self.b * c - self.a * s))

    def beyond(self, t: float) -> np.ndarray:
        """Return the distances of all contacts from their kinks."""
        return CLOSER @ self.at(t)[0] - PLACES


def exact(times: np.ndarray) -> tuple[np.ndarray, int]:
    """Return velocities (T, N-1) after a strike on grain 1, and how many kinks are passed."""
    start = np.zeros(N - 1)
    piece = Piece(0.0, start > 0, start, SPEED * np.eye(N - 1)[0])
    grid = 0.01 * np.sqrt(MASS / K)
    found = []
    now, passed = 0.0, 0
    for time in times:
        while now < time:
            until = min(now + grid, time)
            crossed = np.flatnonzero((piece.beyond(until) >= 0) != piece.above)
            if crossed.size:
                roots = [
                    brentq(lambda t, n, on: on.beyond(t)[n], now, until, (n, piece), xtol=1e-20)
                    for n in crossed
                ]
                first = int(np.argmin(roots))
                above = piece.above.copy()
                above[crossed[first]] ^= True
                # A place just behind the kink, so that the root is not found again.
                until = roots[first] * (1 + 4e-16)
                piece = Piece(until, above, *piece.at(until))
                passed += 1
            now = until
        found.append(piece.at(time)[1])
    return np.array(found), passed


def test_a_kink_of_its_own_in_each_contact_keeps_the_order() -> None:
    scene = Scene(chain=CHAIN, excitation=Impulse(velocity=SPEED), duration=4e-4, samples=21)
    true, passed = exact(scene.time)
    assert passed > 10
    steps = []
    for tolerance in (1e-7, 1e-9, 1e-11):
        run = lmpchain.simulate(scene, "native", tolerance)
        off = np.abs(run.velocity[:, :-1] - true).max() / SPEED
        assert off <= run.error_estimate.total <= tolerance
        steps.append(run.cost.steps)
    # A method of order 1 would need 10,000 times as many steps; one of order 6 needs 4.6 times.
    assert steps[-1] < 10 * steps[0]


@pytest.mark.parametrize("law", [Law("k*max(u, 0)", k=5e3), Law("k*(abs(u) + u)/2", k=5e3)])
def test_the_period_on_a_one_sided_ground(law: Law) -> None:
    """A spring with another one on one side: T = pi sqrt(m) (1/sqrt(k1 + k2) + 1/sqrt(k1))."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, law=Law("k*o", k=K), ground=law)
    period = np.pi * np.sqrt(chain.masses[0]) * (1 / np.sqrt(K + 5e3) + 1 / np.sqrt(K))
    strike = Impulse(velocity=SPEED)
    scene = Scene(chain=chain, excitation=strike, duration=10 * period, samples=11)
    run = lmpchain.simulate(scene, "native", 1e-10)
    assert np.abs(run.velocity[:, 0] / SPEED - 1).max() < 1e-10
    # The displacement is the speed times the error of the period.
    largest = SPEED * np.sqrt(chain.masses[0] / K)
    assert np.abs(run.displacement[:, 0]).max() < 1e-9 * largest
    assert run.error_estimate.total < 1e-10


def ground_run(places: Any, tolerance: float) -> lmpchain.Trajectory:
    ground = Law("k*u + q*(max(u - e, 0) + min(u + e, 0))", k=K, q=STEEP, e=places)
    chain = Chain(grains=3, diameter=1e-3, gravity=0.0, law=Law("k*o", k=K), ground=ground)
    strike = Impulse(velocity=SPEED)
    scene = Scene(chain=chain, excitation=strike, duration=4e-4, samples=21)
    return lmpchain.simulate(scene, "native", tolerance)


def test_stops_of_the_ground_at_a_place_a_grain_keep_the_order() -> None:
    coarse, fine, finest = (ground_run([2e-7, 3e-7, 1e-7], t) for t in (1e-7, 1e-9, 1e-11))
    for run in (coarse, fine):
        assert np.abs(run.velocity - finest.velocity).max() / SPEED <= run.error_estimate.total
    assert finest.cost.steps < 10 * coarse.cost.steps
    # The places of the kinks matter.
    other = ground_run(2e-7, 1e-7)
    assert np.abs(other.velocity - finest.velocity).max() > 0.01 * SPEED


def test_kinks_of_a_ground_that_move_are_refused() -> None:
    law = Law("k*max(u - a*sin(w*t), 0)", k=K, a=1e-7, w=1e5)
    with pytest.raises(InputError, match="of the displacement u alone"):
        Chain(grains=3, diameter=1e-3, ground=law)
    with pytest.raises(InputError, match="not linear in u"):
        Chain(grains=3, diameter=1e-3, ground=Law("k*max(u**3, 0)", k=K))


def test_linear_theory_refuses_a_kink_at_rest() -> None:
    chain = Chain(grains=3, diameter=1e-3, top_load=1.0, ground=Law("k*max(u, 0)", k=K))
    with pytest.raises(InputError, match="kink at rest"):
        lmpchain.theory.modes.eigenmodes(chain)
