"""Contacts that open and close: steps that shorten there reach the last digits, and leave no other trace."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.example_scenes import paper
from helpers.independent_integrators import extended_reference, relative_error

from lmpchain import Chain, Impulse, Scene, engines, simulate
from lmpchain.engines import error_estimate


@pytest.mark.parametrize("name", ["fig5 g", "fig1"])
def test_digits_cost_no_more_than_order_6_asks_for(name: str):
    """The force evaluations grow no faster than tolerance^(-1/6)."""
    tolerances = 10.0 ** -np.arange(5, 12.5, 0.5)
    costs = [simulate(paper(name, 2), "native", tolerance=x).cost.force_evaluations for x in tolerances]
    assert -np.polyfit(np.log(tolerances), np.log(costs), 1)[0] < 1 / 6 + 0.01


@pytest.mark.parametrize("name", ["fig5 g", "fig1"])
def test_the_last_digits_are_reached(name: str):
    scene = paper(name, 2)
    u, v, own = extended_reference(scene)
    t = simulate(scene, "native", tolerance=3e-13)
    assert relative_error(t.displacement, t.velocity, u, v) < 3e-13 + 3 * own


@pytest.mark.parametrize("integrator", ["rkn6", "dop853"])
def test_a_restart_goes_on_with_the_same_bits(integrator: str, monkeypatch: pytest.MonkeyPatch):
    """Where the length of steps follows from the motion, too."""
    scene = paper("fig1", samples=21)
    engine = engines.Native(integrator=integrator)
    candidate = engine.candidate(scene, 1e-9)
    assert candidate.adaptive
    whole = engine.start([scene], candidate)
    truth = np.concatenate([block.velocity for block in whole.blocks()], axis=1)
    monkeypatch.setattr(error_estimate, "BLOCK_BYTES", 1)  # four samples a block
    monkeypatch.setattr(error_estimate, "PIECE_S", 1e-5)
    pieces, state = [], None
    while not pieces or pieces[-1].samples.stop < scene.samples:
        run = engine.start([scene], candidate, state)
        pieces.append(next(block for block in run.blocks() if block.velocity.size))
        state = run.state()
        run.close()
    assert len(pieces) == 5
    assert np.array_equal(np.concatenate([block.velocity for block in pieces], axis=1), truth)
    assert run.errors()[0].total == whole.errors()[0].total


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("integrator", engines.Native.integrators[1:])
def test_a_grain_that_another_leaves_stays_at_rest(integrator: str, exponent: float):
    """Whatever the method knows of the time before the strike, grains that only touch part without a force."""
    chain = Chain(grains=4, material="steel", diameter=5e-3, gravity=0.0, bottom="free", exponent=exponent)
    scene = Scene(chain=chain, excitation=Impulse(velocity=0.1, grain=2), duration=1e-6, samples=11)
    duration = 1 / scene.highest_frequency
    t = simulate(scene.replace(duration=duration), engines.Native(integrator=integrator, step=duration / 10))
    assert not t.displacement[:, 0].any()
    assert not t.velocity[:, 0].any()
    assert t.velocity[-1, 2] > 0


def test_a_wall_that_a_grain_only_touches_leaves_no_trace_as_they_part():
    """Gear's start looks a step back or ahead: behind lies an overlap that never was."""
    chain = Chain(grains=4, material="steel", diameter=5e-3, gravity=9.81, top="wall")
    ends = []
    for top in ("wall", "free"):
        scene = Scene(chain=chain.replace(top=top), excitation=Impulse(velocity=0.1), duration=2e-6, samples=11)
        ends.append(simulate(scene, engines.Native(integrator="gear4", step=2e-7)))
    assert np.array_equal(*(t.displacement for t in ends))
    assert np.array_equal(*(t.velocity for t in ends))
