"""The energies of grains, contacts and parts of a chain sum up to the total energy."""

import numpy as np
import pytest
from helpers.example_chains import WALLED, column
from helpers.example_scenes import scene_of

from lmpchain import Drive, Force, Impulse, simulate, sweep
from lmpchain.measure import energy

LOADED = column(9, gravity=0.0, top_load=1e-2, top="wall", bottom="wall")
ACTED = {
    "struck": Impulse(velocity=1e-3, grain=3),
    "pushed": Force(grain=2, shape="half-sine", amplitude=1e-2, duration=5e-6),
    "a wall that moves": Drive(amplitude=1e-8, frequency=1e5, cycles=2, grain=0),
}


@pytest.mark.parametrize("name", WALLED)
def test_shares_add_up_within_their_errors(name: str):
    """Shares sum up to the total of the ledger; errors cover the deviation from a better run."""
    chain = WALLED[name]
    scene = scene_of(chain, Impulse(velocity=1e-2, grain=chain.movable), 2e-5, 21)
    t, accurate = (simulate(scene, "native", tolerance) for tolerance in (1e-3, 1e-9))
    found, better = energy.shares(t), energy.shares(accurate)
    assert min(found.kinetic.min(), found.elastic.min()) >= 0
    total = found.kinetic.sum(1) + found.elastic.sum(1)
    for all_parts in (found.of_grain.sum(1), energy.ledger(t).total, found.part(1, chain.grains)):
        assert all_parts == pytest.approx(total, rel=1e-13)
    assert better.of_grain.sum(1) == pytest.approx(scene.energy, rel=1e-8)
    error = found.kinetic_error.sum(1) + found.elastic_error.sum(1)
    assert (np.abs(total - scene.energy) <= error).all()
    for field in ("kinetic", "elastic", "of_grain"):
        off = np.abs(getattr(found, field) - getattr(better, field))
        said = getattr(found, f"{field}_error")
        assert (off <= said + getattr(better, f"{field}_error")).all()
    assert 0 < error.max() < 0.02 * scene.energy


@pytest.mark.parametrize("kind", ACTED)
def test_energy_that_flows_into_a_part(kind: str):
    """The energy of grains 5 to 9 changes by the power of contact 4: force times mean velocity."""
    scene = scene_of(LOADED, ACTED[kind], 3e-5, 3001)
    t = simulate(scene, "native", 1e-10)
    part = energy.shares(t).part(5, 9)
    change = LOADED.contacts.of(4).force_change(t.displacement[:, 3] - t.displacement[:, 4])
    power = change * (t.velocity[:, 3] + t.velocity[:, 4]) / 2
    flown = np.append(0, np.cumsum((power[1:] + power[:-1]) / 2)) * (scene.duration / 3000)
    assert part - part[0] == pytest.approx(flown, rel=0, abs=3e-4 * part.max())
    assert part.max() > 0.1 * energy.ledger(t).total.max()


def test_the_energy_of_grains_does_not_depend_on_other_recorded_grains(tmp_path):
    scene = scene_of(LOADED, ACTED["struck"], 2e-5, 11, grains="3:6").to_dict()
    kept = {}
    for number, keep in enumerate((["energy"], ["energy", "peak_velocity", "grain_energy"])):
        grid = {"excitation.velocity": [1e-3, 2e-3]}
        kept[number] = sweep(
            {"scene": scene, "keep": keep, "engine": "native", "grid": grid}, tmp_path / str(number)
        )
    assert kept[1]["energy"].to_numpy() == pytest.approx(kept[0]["energy"].to_numpy(), rel=1e-12)
    assert np.isfinite(kept[1]["grain_energy"].to_numpy()).all()
