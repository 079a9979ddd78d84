"""Contact openings: shorter steps there reach full accuracy, and change nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.convergence import slope
from helpers.example_scenes import paper, scene_of
from helpers.independent_integrators import distance, extended_reference
from helpers.thinned import thinned
from helpers.whole_runs import blocks_of

from lmpchain import Chain, Impulse, Profile, Scene, engines, simulate
from lmpchain.engines import Native
from lmpchain.engines.stepping import step_choice
from lmpchain.engines.stepping import time_stepping as stepping_run


@pytest.mark.parametrize("name", ["fig5 g", "fig1"])
def test_accuracy_costs_as_expected_for_order_6(name: str):
    """The force evaluations grow no faster than tolerance^(-1/6)."""
    tolerances = 10.0 ** -np.arange(5, 12.5, 0.5)
    costs = [
        simulate(paper(name, 2), "native", tolerance=x).cost.force_evaluations for x in tolerances
    ]
    assert -slope(tolerances, costs) < 1 / 6 + 0.01


@pytest.mark.parametrize("name", ["fig5 g", "fig1"])
def test_full_accuracy_is_reached(name: str):
    scene = paper(name, 2).replace(duration=5e-5)
    u, v, own = extended_reference(scene)
    t = simulate(scene, "native", tolerance=3e-13)
    assert distance(t, (u, v)) < 3e-13 + 3 * own


@pytest.mark.parametrize("integrator", ["rkn6", "dop853"])
def test_a_restart_continues_with_the_same_bits(integrator: str, monkeypatch: pytest.MonkeyPatch):
    """The step lengths depend on the motion as well."""
    scene = paper("fig1", samples=61)
    engine = engines.Native(integrator=integrator)
    candidate = engine.propose(scene, 1e-9)
    assert candidate.steps.adaptive
    whole = engine.start([scene], candidate)
    truth = np.concatenate([block.velocity for block in whole.blocks()], axis=1)
    monkeypatch.setattr(stepping_run, "BLOCK_BYTES", 1)  # Few samples per block.
    monkeypatch.setattr(stepping_run, "PIECE_S", 1e-5)
    pieces = []
    state = None
    while not pieces or pieces[-1].samples.stop < scene.samples:
        run = engine.start([scene], candidate, state)
        pieces.append(next(block for block in run.blocks() if block.velocity.size))
        state = run.state()
        run.close()
    assert len(pieces) >= 5
    assert np.array_equal(np.concatenate([block.velocity for block in pieces], axis=1), truth)
    assert run.errors()[0].total == whole.errors()[0].total


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("integrator", engines.Native.integrators[1:])
def test_a_grain_that_another_leaves_remains_at_rest(integrator: str, exponent: float):
    """Grains that only touch separate without a force, even if a method uses times before t = 0."""
    chain = Chain(
        grains=4, material="steel", diameter=5e-3, gravity=0.0, bottom="free", exponent=exponent
    )
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1, grain=2), duration=1e-6, samples=11)
    duration = 1 / scene.highest_frequency
    t = simulate(
        scene.replace(duration=duration), engines.Native(integrator=integrator, step=duration / 10)
    )
    assert not t.displacement[:, 0].any()
    assert not t.velocity[:, 0].any()
    assert t.velocity[-1, 2] > 0


def test_a_wall_that_only_touches_has_no_effect_after_separation():
    """Gear's start uses one step backward, with an overlap that never occurs in the motion."""
    chain = Chain(grains=4, material="steel", diameter=5e-3, gravity=9.81, top="wall")
    ends = []
    for top in ("wall", "free"):
        scene = scene_of(chain.replace(top=top), Impulse(velocity=0.1), 2e-6, 11)
        ends.append(simulate(scene, engines.Native(integrator="gear4", step=2e-7)))
    assert np.array_equal(*(t.displacement for t in ends))
    assert np.array_equal(*(t.velocity for t in ends))


VACUUM = Chain(
    grains=3,
    diameter=[0.0012001812626771244, 0.0012802513367209123, 0.0010127062034172446],
    gravity=0.0,
    exponent=1.25,
    bottom="wall",
)
LOADED = Chain(
    grains=12,
    diameter=0.0009368922485308815,
    gravity=0.0,
    top_load=0.06545568939749505,
    bottom="wall",
)
SHAKEN = [
    -0.04487068238831758,
    -0.1851992625629299,
    0.0877566894513918,
    -0.08368754958403263,
    -0.0741312381387248,
    -0.09985996279394338,
    -0.020006704977478196,
    0.03807569029890475,
    0.14838876306193696,
    0.018253745774708785,
    0.06857513489478681,
    0.06974671625593308,
]


@pytest.mark.parametrize(
    ("scene", "steps"),
    [
        (scene_of(VACUUM, Impulse(velocity=0.0212068595), 6.2358512707e-6, 11), 2),
        (scene_of(LOADED, Profile(velocity=SHAKEN), 1.1311997779e-5, 11), 3),
    ],
    ids=["vacuum", "loaded"],
)
def test_short_steps_at_openings_restore_the_order(scene: Scene, steps: int):
    """With doubled steps near openings, full-order estimates were 0.24 and 0.88 of the error."""
    engine = Native("rkn6")
    step = scene.duration / (scene.samples - 1) / steps
    candidate = engine.propose(scene, 1e-3)
    taken = candidate.steps._replace(step=step, per_landing=steps, coarse_openings=False)
    candidate = candidate.with_steps(taken)
    run = engine.start([scene], candidate)
    (u,), (v,) = blocks_of(run)
    error = distance((u, v), extended_reference(scene))
    assert 2 * error < run.errors()[0].total < 100 * error


@pytest.mark.parametrize("name", thinned(["fig5 g", "fig1"], 2))
def test_steps_limited_by_samples_are_not_shortened_further_at_openings(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    """Equal steps cost at least a quarter less, although their error estimate has a lower order."""
    scene = paper(name, samples=301)
    engine = Native("rkn6")
    # Otherwise steps need not adapt at all.
    scene = scene.replace(excitation=scene.excitation.scaled(2.0))
    # Samples are not interpolated either.
    alone = replace(step_choice.INTERPOLATION, values=0)
    monkeypatch.setattr(step_choice, "INTERPOLATION", alone)
    candidate = engine.propose(scene, 1e-4)
    truth = extended_reference(scene)
    costs = []
    assert candidate.steps.coarse_openings
    fine = candidate.with_steps(candidate.steps._replace(coarse_openings=False))
    for proposed in (candidate, fine):
        run = engine.start([scene], proposed)
        (u,), (v,) = blocks_of(run)
        assert distance((u, v), truth) < run.errors()[0].total < 1e-4
        costs.append(run.cost().force_evaluations)
    assert costs[0] < 0.75 * costs[1]
    refined = engine.refine(candidate, run.errors()[0]._replace(truncation=2e-4, order=4.0), 1e-4)
    assert refined is not None
    assert (refined.steps.coarse_openings, refined.steps.per_landing) == (
        False,
        candidate.steps.per_landing,
    )
