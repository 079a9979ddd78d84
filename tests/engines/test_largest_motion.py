"""Errors are relative to the largest motion at any time, not only at the samples."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from helpers import taylor_series
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of
from helpers.thinned import thinned

from lmpchain import Displacement, Drive, Impulse, Scene, simulate
from lmpchain.benchmark.comparison import error
from lmpchain.benchmark.reference import reference
from lmpchain.engines import Lammps, Native
from lmpchain.integrators.methods import METHODS

# Grain 2 is fixed, which makes an oscillator.
PAIR = column(2, gravity=0.0, top_load=10.0, exponent=1.0)
OMEGA = PAIR.band_edge
SPEED = 1e-3
LENGTH = SPEED / OMEGA


def oscillator(excitation, periods: float, samples: int) -> Scene:
    return scene_of(PAIR, excitation, periods * 2 * np.pi / OMEGA, samples)


@pytest.mark.parametrize("engine", ["native", "lammps"])
@pytest.mark.parametrize(("samples", "periods"), [(3, 2), (5, 2), (2, 7)])
def test_samples_on_the_nodes_of_an_oscillator(engine, samples, periods):
    """Samples at nodes show no displacement after a strike, and no velocity after a release.

    Both are known exactly.
    """
    for excitation in (Impulse(velocity=SPEED), Displacement(displacement=LENGTH)):
        scene = oscillator(excitation, periods, samples)
        phase = OMEGA * scene.time
        struck = excitation.kind == "impulse"
        t = simulate(scene, engine)
        u, v = (np.sin(phase), np.cos(phase)) if struck else (np.cos(phase), -np.sin(phase))
        true = max(
            np.abs(t.displacement[:, 0] / LENGTH - u).max(),
            np.abs(t.velocity[:, 0] / SPEED - v).max(),
        )
        assert true / 3 - 1e-12 < t.error_estimate.total <= 1e-6
        assert error(t, reference(scene)) == pytest.approx(true, rel=2e-3, abs=1e-12)


@pytest.mark.parametrize("frequency", thinned([0.31, 0.1], 2))
def test_a_drive_sampled_at_its_period(frequency):
    """A stroboscopic (Poincare) section of a driven chain is a valid run."""
    chain = column(6)
    drive = Drive(amplitude=1e-10, frequency=frequency * chain.band_edge / (2 * np.pi))
    scene = scene_of(chain, drive, 6 / drive.frequency, 7)
    t = simulate(scene, "native", 1e-7)
    truth = reference(scene)
    assert np.abs(t.displacement[:, 0]).max() < 1e-9 * drive.amplitude  # All samples are at nodes.
    true = error(t, truth)
    assert true / 3 < t.error_estimate.total <= 1e-7
    assert truth.largest[0] >= drive.amplitude * (1 - 1e-3)


COLUMN = column(6)
SLOW = Drive(amplitude=1e-10, frequency=0.2 * COLUMN.band_edge / (2 * np.pi))
MOTIONS = {
    "oscillator": oscillator(Impulse(velocity=SPEED), 2, 3),
    "released": oscillator(Displacement(displacement=LENGTH), 2, 3),
    "driven": scene_of(COLUMN, SLOW, 5 / SLOW.frequency, 6),
    "strong": paper("fig1", samples=3),
}


@cache
def largest(scene: str) -> np.ndarray:
    """Return the largest displacement and velocity, (2,) m and m/s."""
    return np.array(taylor_series.reference(MOTIONS[scene], 1e-16)[0].largest)


@pytest.mark.parametrize(("integrator", "scene"), thinned(product(METHODS, MOTIONS), 3))
def test_the_largest_motion_is_found(integrator, scene):
    """No sample shows the largest motion; without checks between steps, 5 % would be missed.

    Known to 1e-3.
    """
    chosen = MOTIONS[scene]
    engine = Native(integrator, adaptive=integrator != "rkn6")
    tolerance = 1e-4 if METHODS[integrator].order <= 4 else 1e-8
    candidate = engine.propose(chosen, tolerance)
    run = engine.start([chosen], candidate)
    for _ in run.blocks():
        pass
    ratio = run.monitor.peaks[0] / largest(scene)
    reach = candidate.step * chosen.highest_frequency
    assert reach < 1.6
    assert (ratio > 0.995 * np.cos(max(reach, 0.6) / 2)).all()
    assert (ratio < 1.001 + 2 * run.errors()[0].truncation).all()


def test_the_largest_motion_of_a_lammps_run_is_that_of_its_native_twin():
    scene = oscillator(Impulse(velocity=SPEED), 2, 3)
    engine = Lammps()
    run = engine.start([scene], engine.propose(scene, 1e-7))
    try:
        for _ in run.blocks():
            pass
        assert run.monitor.peaks[0] == pytest.approx([LENGTH, SPEED], rel=0.04)
    finally:
        run.close()
