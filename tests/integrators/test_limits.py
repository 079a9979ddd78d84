"""What an answer cannot exceed, in compiled loops, is what the contacts say of the chain."""

import numpy as np
import pytest
from helpers.example_chains import CHAINS

from lmpchain import Chain, Impulse, RunFailed, Scene
from lmpchain.chain.contacts import together
from lmpchain.engines.native import Native
from lmpchain.integrators.kernels.reductions import MOST, limits


@pytest.mark.parametrize("name", CHAINS)
def test_no_overlap_exceeds_the_bound_of_the_contacts(name: str):
    chains, energies = [CHAINS[name], CHAINS[name]], np.array([1e-12, np.inf])
    own = together([chain.contacts for chain in chains])
    weight, units = np.array([chain.masses.sum() for chain in chains]), np.array([[1e-9, 0.0], [1e-9, 2.0]])
    most, room = limits(energies, weight, units, own.overlap, own.stiffness, own.constant, own.exponent)
    assert most.tolist() == [3e-12, MOST]
    expected = [chain.contacts.overlap_bound(energy).max() for chain, energy in zip(chains, most, strict=True)]
    np.testing.assert_allclose(room, expected, rtol=1e-12)


def test_slow_motion_that_nothing_puts_in_is_allowed():
    chain = Chain(grains=5, diameter=1e-3)
    own, speed = together([chain.contacts]), 3.0
    most, _ = limits(
        np.zeros(1), np.ones(1), np.array([[1e-9, speed]]), own.overlap, own.stiffness, own.constant, own.exponent
    )
    assert most[0] == pytest.approx((1e-3 * speed) ** 2, rel=1e-14)


@pytest.mark.parametrize("name", CHAINS)
def test_the_largest_strain_is_that_of_the_bound_on_overlaps(name: str):
    contacts = CHAINS[name].contacts
    for energy in (0.0, 1e-15, 1e-6, np.inf):
        strain = contacts.largest_strain(energy)
        if not (contacts.pressed == contacts.exists).all():
            assert strain == np.inf
            continue
        there = contacts.pressed
        closer = (contacts.overlap_bound(energy) - contacts.overlap)[there] / contacts.overlap[there]
        assert strain == pytest.approx(1.05 * closer.max(), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("steps", "lost"), [(1, "answer"), (12, "companion"), (64, "nothing")])
def test_grains_that_come_too_close_are_told_where_answers_are_compared(steps: int, lost: str):
    """Steps that are far too long let grains through each other; if those of a companion do, the error is infinite."""
    chain = Chain(grains=9, diameter=1e-3, gravity=0.0, bottom="wall")
    scene = Scene(chain=chain, excitation=Impulse(velocity=1.862e-3), duration=4.5e-4, samples=9)
    engine = Native("rkn4", adaptive=False)
    step = scene.duration / 8 / steps
    run = engine.start([scene], engine.candidate(scene, 1e-3).sampled._replace(step=step, steps_per_landing=steps))
    if lost == "answer":
        with pytest.raises(RunFailed, match="grains overlap more than all the energy there is allows"):
            list(run.blocks())
        return
    list(run.blocks())
    assert (run.errors()[0].truncation == np.inf) == (lost == "companion")
