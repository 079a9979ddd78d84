"""Error estimates of runs of one or a few steps."""

import warnings
from contextlib import suppress

import numpy as np
import pytest
from helpers.example_scenes import random_scene, scene_of
from helpers.independent_integrators import distance, extended_reference
from helpers.largest_motion import true_error
from helpers.whole_runs import blocks_of

from lmpchain import Chain, Impulse, RunFailed, Scene, simulate
from lmpchain.engines import Native
from lmpchain.engines.stepping.auxiliary_runs import AuxiliarySteps
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.steps import Steps


def check(seed: int) -> None:
    """Compare a run with the reference, at a tolerance or at a given step."""
    rng = np.random.default_rng([2026, seed])
    scene = random_scene(rng)
    # A sample takes 0.2 to 5 radians of the fastest motion.
    samples = int(rng.choice([2, 2, 2, 3, 4, 6]))
    duration = (samples - 1) * 10 ** rng.uniform(-0.7, 0.7) / scene.highest_frequency
    scene = scene.replace(duration=min(duration, scene.duration), samples=samples)
    integrator = str(rng.choice(list(METHODS)))
    tolerance = float(10 ** rng.uniform(-9, -1.5))
    steps = int(rng.integers(1, 12))
    if METHODS[integrator].order <= 4:
        tolerance = max(tolerance, 1e-5)
    step = scene.duration / (scene.samples - 1) / steps
    fixed = (
        rng.random() < 0.5
        and step * scene.highest_frequency < 0.9 * METHODS[integrator].stability_limit
    )
    with warnings.catch_warnings(action="ignore"):
        t = simulate(scene, Native(integrator, step if fixed else None), tolerance, on_miss="warn")
    true, own = true_error(t, scene)
    estimate = t.error_estimate.total
    said = (
        f"seed {seed}, {integrator}, {t.cost.steps} steps: true {true:.2e}, estimate {estimate:.2e}"
    )
    assert estimate >= (true - own) / 3 - 1e-15, said
    assert fixed or estimate > tolerance or true <= tolerance + own, said


@pytest.mark.parametrize("seed", range(12))
def test_short_runs(seed):
    check(seed)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(12, 1500))
def test_many_short_runs(seed):
    check(seed)


def test_one_step():
    """The auxiliary run must have a different step; 1.6e-5 was once estimated as 1e-15."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=0.1)
    scene = scene_of(chain, Impulse(velocity=1e-3), 1 / chain.band_edge, 2)
    t = simulate(scene, "native", 1e-2)
    true, _ = true_error(t, scene)
    assert t.cost.steps == 1
    assert 1e-6 < true < 3 * t.error_estimate.total < 0.03


@pytest.mark.parametrize("steps", [*range(1, 11), 15, 16, 17, 24])
@pytest.mark.parametrize("samples", [2, 3, 12])
def test_auxiliary_runs_differ_from_the_main_run_and_each_other(steps, samples):
    """For any number of steps, the estimate is within a factor of three of the true error."""
    chain = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=0.1, exponent=1.0)
    scene = scene_of(chain, Impulse(velocity=1e-3), 2.9 / chain.band_edge, samples)
    for integrator in ("verlet", "rkn4", "dop853"):
        step = scene.duration / (samples - 1) / steps
        if step * chain.band_edge > 0.9 * METHODS[integrator].stability_limit:
            continue
        t = simulate(scene, Native(integrator, step))
        phase = chain.band_edge * scene.time
        speed = np.abs(t.velocity[:, 0] / 1e-3 - np.cos(phase)).max()
        true = max(
            speed, np.abs(t.displacement[:, 0] * chain.band_edge / 1e-3 - np.sin(phase)).max()
        )
        assert t.cost.steps == steps * (samples - 1)
        assert t.error_estimate.solver > true / 2 - 1e-15


def test_adaptive_steps_end_after_a_breakdown():
    """Grains thrown at each other ever faster would require ever shorter steps.

    A run that does not break down says how far off it is.
    """
    diameters = [
        0.005193770218387011, 0.00423413056826046, 0.0038987219159366308, 0.0031985482555149693,
        0.004402414507304734, 0.004439272661335074, 0.005101144042289529, 0.005052169823236045,
        0.00389580675678367, 0.004839438043639775, 0.0051150367614991, 0.0037009743144796664,
    ]  # fmt: skip
    chain = Chain(
        grains=12, diameter=diameters, gravity=26.13332937185664, exponent=2.5,
        top_load=0.0927680953941959,
        top="wall", bottom="wall",
    )  # fmt: skip
    scene = scene_of(chain, Impulse(velocity=2.9797464221365813), 0.000458478080663487, 11)
    engine = Native("rkn4")
    truth = extended_reference(scene)
    for steps in (1, 2, 4):
        step = scene.duration / (scene.samples - 1) / steps
        candidate = engine.propose(scene, 1e-5).with_steps(Steps(steps, 1, step))
        run = engine.start([scene], candidate)
        with suppress(RunFailed):
            (u,), (v,) = blocks_of(run)
            assert run.errors()[0].total > distance((u, v), truth) > 0


@pytest.mark.parametrize(
    ("integrator", "velocity"), [("rkn4", 1e-6), ("rkn4", 1e-3), ("rkn6", 1e-4), ("rkn6", 1e-3)]
)
def test_an_unstable_auxiliary_run_is_replaced_by_one_at_half_the_step(
    integrator: str, velocity: float
):
    method = METHODS[integrator]
    chain = Chain(grains=60, diameter=1e-3)
    step = 0.6 * method.stability_limit / chain.band_edge
    scene = Scene(chain=chain, excitation=Impulse(velocity=velocity), duration=20 * step, samples=2)
    given = Native(integrator, step=step)
    (companion,) = AuxiliarySteps(method, [scene], given.propose(scene, 1e-6).steps).schedules
    assert companion.step == pytest.approx(step / 2, rel=1e-9)
    t = simulate(scene, given)
    true, own = true_error(t, scene)
    assert own < 0.01 * true < 0.01 * t.error_estimate.total < 0.3
