"""Error estimates of damped springs against exact solutions, in formerly underestimated cases."""

import numpy as np
import pytest
from helpers.taylor_series import reference

from lmpchain import Chain, Force, Impulse, Scene, Trajectory, simulate
from lmpchain.engines import Native


def spring(viscous: float, drag: float) -> Chain:
    """Return one grain on a spring with A omega and gamma / omega."""
    chain = Chain(grains=2, diameter=1e-3, exponent=1.0, gravity=0.0, top_load=1.0)
    omega = chain.band_edge
    return chain.replace(damping={"viscoelastic": viscous / omega, "drag": drag * omega})


def true_error(run: Trajectory) -> float:
    """Return the error of a run, relative to the largest motion at any time."""
    true, doubt = reference(run.scene, 1e-18)
    error = true.error(run.displacement, run.velocity)
    assert doubt < error / 10
    return error


def strike(viscous: float, drag: float, reach: float) -> Scene:
    """Return a struck spring; `reach` is the step relative to the stable one, at 3 per sample."""
    chain = spring(viscous, drag)
    duration = 20 * reach / chain.fastest_rate
    return Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=duration, samples=11)


def push(viscous: float, drag: float, part: float) -> Scene:
    """Return a spring pushed by a half-sine for this fraction of the duration."""
    chain = spring(viscous, drag)
    duration = 40 / chain.fastest_rate
    force = Force(amplitude=1e-6, shape="half-sine", duration=part * duration)
    return Scene(chain=chain, excitation=force, duration=duration, samples=3)


def creep(viscous: float, drag: float, radians: float) -> Scene:
    """Return a slowly loaded spring, whose velocity is far below drag times displacement."""
    chain = spring(viscous, drag)
    duration = radians / chain.band_edge
    force = Force(amplitude=1e-3, frequency=0.08 / duration)
    return Scene(chain=chain, excitation=force, duration=duration, samples=11)


@pytest.mark.parametrize(
    ("scene", "tolerance"),
    [
        # The errors of a single auxiliary run at longer steps cancel.
        (strike(1.5, 1.5, 1.5), 1e-3),
        (strike(1.5, 1.5, 1.53), 1e-3),
        # The end of the push cuts the step before the sample at a different fraction than in
        # auxiliary runs.
        (push(0.5, 1.0, 0.4625), 1e-9),
        (push(0.0, 1.0, 0.475), 1e-9),
        # All runs make one step from the end of the push to the sample.
        (push(0.0, 1.0, 0.4875), 1e-9),
        # Reduced velocities cancel.
        (creep(0.0, 5.0, 100.0), 1e-9),
        (creep(0.0, 10.0, 100.0), 1e-9),
    ],
)
def test_estimates_are_at_least_a_third_of_the_error(scene: Scene, tolerance: float):
    run = simulate(scene, "native", tolerance)
    assert true_error(run) < min(tolerance, 3 * run.error_estimate.total)
    # The estimates are not far above the error either.
    assert run.error_estimate.total < 300 * true_error(run)


@pytest.mark.parametrize(
    ("viscous", "radians", "force"),
    [
        # Critical damping, whose two rates must be separated by rounding only.
        (2.0 - 2e-11, 10.0, {}),
        (2.0 - 2e-11, 10.0, {"frequency": 1.0}),
        # The two exponentials of a slow or recent force cancel.
        (0.06, 0.18, {"frequency": 0.004}),
        (0.12, 6.0, {"frequency": 0.0013}),
        (0.0015, 147.0, {"shape": "half-sine", "duration": 565.5}),
    ],
)
def test_rounding_of_damped_modes_is_within_the_estimate(viscous, radians, force):
    chain = spring(viscous, 0.0)
    omega = chain.band_edge
    units = {"frequency": omega / (2 * np.pi), "duration": 1 / omega}
    force = {key: value * units.get(key, 1) for key, value in force.items()}
    excitation = Force(amplitude=1e-3, **force) if force else Impulse(velocity=1e-6)
    scene = Scene(chain=chain, excitation=excitation, duration=radians / omega, samples=12)
    run = simulate(scene, "modes", 1e-10)
    assert true_error(run) < 3 * run.error_estimate.total
    assert run.error_estimate.total < 300 * true_error(run)


@pytest.mark.parametrize(("viscoelastic", "drag"), [(1e-6, 1e6), (5e-6, 1e6), (5e-6, 3e6)])
def test_estimates_refer_to_the_motion_itself_while_a_force_is_still_weak(viscoelastic, drag):
    """A burst that has hardly begun moves grains by far less than its amplitude."""
    damping = {"viscoelastic": viscoelastic, "drag": drag}
    chain = Chain(grains=3, diameter=1e-3, top_load=0.1, damping=damping)
    burst = Force(amplitude=1e-3, frequency=10.0, cycles=10)
    scene = Scene(chain=chain, excitation=burst, duration=3e-5, samples=6)
    step = 1.5e-6 if viscoelastic == 1e-6 else 5e-7
    t = simulate(scene, Native(step=step, integrator="dop853"))
    error = true_error(t)
    assert error / 3 < t.error_estimate.solver < 30 * error
