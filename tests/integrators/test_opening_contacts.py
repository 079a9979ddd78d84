"""Contacts that open and close: steps that shorten there reach the last digits, and leave no other trace."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.example_scenes import paper
from helpers.independent_integrators import extended_reference, relative_error

from lmpchain import engines, simulate
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
