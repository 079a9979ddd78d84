"""Samples inside steps are interpolated as accurately as the steps."""

from types import FunctionType
from typing import NamedTuple

import numpy as np
import pytest
from helpers.example_scenes import scene_of
from helpers.independent_integrators import distance, extended_reference

from lmpchain import Chain, Displacement, Drive, Force, Impulse, Scene, simulate
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.auxiliary_runs import AuxiliarySteps
from lmpchain.integrators.batch import ChainBatch
from lmpchain.integrators.kernels import window
from lmpchain.integrators.kernels.layout import LEAST_SHARE, PAD, STATE, SampleRow
from lmpchain.integrators.kernels.window import DenseRates
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.stepper import NativeStepper
from lmpchain.integrators.steps import Steps, clocks

# Grain 2 is fixed.
SPRING = Chain(grains=2, diameter=1e-3, gravity=0.0, top_load=10.0, exponent=1.0)
OMEGA = np.sqrt(SPRING.contact_constants[0] / SPRING.masses[0])
SPEED = 1e-3


def samples_of(
    scene: Scene, schedule: Steps, name: str = "rkn6", threads: int = 1, most: int = 2**62
):
    """Return displacements and velocities (T, N), computed in blocks of at most this many steps."""
    stepper = NativeStepper(ChainBatch([scene]), METHODS[name], schedule, {}, threads)
    u, v = np.zeros((2, 1, scene.samples, scene.chain.grains))
    u[:, 0], v[:, 0] = scene.initial()
    while stepper.sample < scene.samples - 1:
        stepper.fill(u, v, 0, scene.samples - 1, most)
    stepper.close()
    return u[0], v[0]


class Ends(NamedTuple):
    """The arguments of `fill_samples`: the state of a chain at both ends of a step."""

    history: np.ndarray
    x: np.ndarray
    v: np.ndarray
    state: np.void


# A compilation for this test would take longer than all other tests of this file.
PLAIN = {"fma": lambda a, b, c: a * b + c, "passes": window.passes.py_func}
fill_samples = FunctionType(window.fill_samples.py_func.__code__, vars(window) | PLAIN)


def test_the_error_falls_with_the_eighth_and_seventh_power_of_the_step():
    """The orders of displacement and velocity for a sine that is exact at both ends of a step."""
    steps = np.array([0.4, 0.6, 0.8, 1.2])
    errors = []
    for h in steps:
        begin, end = (
            [np.sin(t + k * np.pi / 2) for k in range(4)] for t in (0.8 - h / 2, 0.8 + h / 2)
        )
        history = np.zeros((4, 2 * PAD))
        state = np.zeros(1, STATE).view(np.recarray)[0]
        history[:, PAD] = begin
        state["done"] = h
        rows = np.repeat(np.array(end)[:, None], 2 * PAD, 1)
        ends = Ends(history, rows[0], rows[1], state)
        clock = clocks([Steps(1, 24, h, True, dense=1)], h / 24, 24).view(np.recarray)[0]
        clock["end"] = clock["length"] = h
        u, v = np.zeros((2, 25, 1))
        fill_samples(
            ends,
            clock,
            PAD,
            PAD + 1,
            DenseRates(rows[0], rows[2], rows[0], rows[3]),
            SampleRow(u, v, 0, np.zeros((0, 2))),
        )
        time = 0.8 - h / 2 + np.arange(1, 24) * h / 24
        errors.append(
            [np.abs(u[1:24, 0] - np.sin(time)).max(), np.abs(v[1:24, 0] - np.cos(time)).max()]
        )
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slopes == pytest.approx([8, 7], abs=0.05)


@pytest.mark.parametrize("top", ["free", "wall"])
def test_samples_between_steps_are_as_accurate_as_steps(top):
    chain = Chain(grains=12, diameter=1e-3, gravity=0.0, top_load=1e-3, top=top)
    scene = Scene(chain=chain, excitation=Impulse(velocity=3e-3), duration=8e-5, samples=801)
    engine = Native("rkn6")
    truth = extended_reference(scene)
    for tolerance in (1e-4, 1e-9):
        candidate = engine.propose(scene, tolerance)
        assert candidate.steps.stride > 1
        answer = simulate(scene, engine, tolerance)
        error = distance(answer, truth)
        assert error / 3 < answer.error_estimate.total <= tolerance
        assert answer.cost.steps < scene.samples


@pytest.mark.parametrize(
    "excitation",
    [
        Drive(amplitude=2e-10, frequency=3e4, cycles=1.5),
        Drive(times=np.linspace(0, 9e-5, 12), displacement=2e-10 * np.sin(np.arange(12) ** 1.3)),
        Force(amplitude=1e-6, frequency=3e4, grain=3, cycles=1.5),
    ],
    ids=["sine that ends", "spline", "force that ends"],
)
def test_steps_end_on_every_sample_with_a_forcing(excitation):
    chain = Chain(grains=12, diameter=1e-3, gravity=0.0, top_load=1e-3)
    scene = Scene(chain=chain, excitation=excitation, duration=8e-5, samples=801)
    candidate = Native("rkn6").propose(scene, 1e-4)
    assert (candidate.steps.stride, candidate.step) == (1, 8e-5 / 800)


def test_pieces_and_threads_do_not_change_the_bits():
    chain = Chain(grains=2 * LEAST_SHARE + 100, diameter=1e-3, gravity=0.0, top_load=1e-3)
    strike = Impulse(velocity=1e-2, grain=LEAST_SHARE)
    scene = Scene(chain=chain, excitation=strike, duration=40 / chain.band_edge, samples=25)
    schedule = Steps(9, 12, scene.duration / 18, True, dense=1)
    once, pieces, *shared = (
        samples_of(scene, schedule, "rkn6", *how) for how in ((1,), (1, 1), *[(2, 3)] * 8)
    )
    for number, (field, piece) in enumerate(zip(once, pieces, strict=True)):
        assert field[1:].any(1).all()
        assert np.array_equal(field, piece)
        assert all(np.array_equal(field, parts[number]) for parts in shared)


def test_auxiliary_runs_are_compared_in_every_step():
    scene = scene_of(SPRING, Impulse(velocity=SPEED), 20 / OMEGA, 1001)
    candidate = Native("rkn6").propose(scene, 1e-6)
    for schedule in AuxiliarySteps(METHODS["rkn6"], [scene], candidate.steps).schedules:
        assert schedule.dense <= schedule.stride / schedule.per_landing
        u, _ = samples_of(scene, schedule, "rkn6")
        assert u[schedule.dense : schedule.stride : schedule.dense].any(1).all()


def test_steps_land_on_samples_where_this_is_cheaper_or_safer():
    scene = scene_of(Chain(grains=30, diameter=1e-3), Impulse(velocity=1e-3), 6e-5, 1201)
    few = scene.replace(samples=21)
    vacuum = scene.replace(chain=scene.chain.replace(gravity=0.0))
    assert Native().propose(scene, 1e-6).steps.stride > 1
    for engine, other, tolerance in (
        (Native(), few, 1e-9),
        (Native(), scene, 1e-13),  # Displacements over a step are rounded.
        (Native(), vacuum, 1e-6),  # The front is too steep.
        (Native("verlet"), scene, 1e-3),
        (Native(adaptive=False), scene, 1e-6),
        (Native(step=1e-8), scene, 1e-6),
    ):
        assert engine.propose(other, tolerance).steps.stride == 1
    dense_one = Native().propose(scene, 1e-6)
    sampled = dense_one.steps.sampled
    assert (sampled.stride, sampled.step * sampled.per_landing) == (
        1,
        pytest.approx(scene.time[1], rel=1e-14),
    )


def test_rounding_of_interpolated_samples_is_estimated():
    """A velocity is a difference of displacements over a step, and sensitive for short steps."""
    chain = Chain(grains=12, diameter=1e-3, gravity=0.0, top_load=1e-3)
    strike = Displacement(displacement=chain.equilibrium_overlap[0], grain=3)
    scene = Scene(chain=chain, excitation=strike, duration=12 / chain.band_edge, samples=241)
    engine = Native("rkn6")
    candidate = engine.propose(scene, 1e-6)
    assert candidate.steps.stride > 1
    shorter = candidate.steps.shorten(50 * candidate.steps.per_landing)
    run = engine.start([scene], candidate.with_steps(shorter))
    blocks = list(run.blocks())
    u, v = (
        np.concatenate(fields, 1)[0]
        for fields in zip(*((b.displacement, b.velocity) for b in blocks), strict=True)
    )
    error = distance((u, v), extended_reference(scene))
    found = run.errors()[0]
    assert 1e-13 < error < 3 * found.roundoff
