"""Accumulated forces of viscous contacts against dense Taylor series."""

import numpy as np
import pytest
from helpers import taylor_series

from lmpchain import Chain, Damping, Drive, Impulse, Scene, simulate, sweep
from lmpchain.simulation.accumulation import Gatherer

CHAIN = Chain(
    grains=6, diameter=1e-3, top_load=0.02, bottom="wall", damping=Damping(viscoelastic=1e-7)
)
STRUCK = Scene(chain=CHAIN, excitation=Impulse(velocity=0.05), duration=2e-5, samples=3)
SCENES = {
    "struck": STRUCK,
    "weak": STRUCK.replace(excitation=Impulse(velocity=1e-5)),
    "opening": STRUCK.replace(excitation=Impulse(velocity=-0.1)),
    "vacuum": STRUCK.replace(chain=CHAIN.replace(top_load=0, gravity=0)),
    "dashpots": STRUCK.replace(
        chain=CHAIN.replace(damping={"viscoelastic": np.linspace(1e-6, 2e-6, 5), "drag": 1e4})
    ),
    "springs": STRUCK.replace(chain=CHAIN.replace(exponent=1.0)),
    "driven wall": STRUCK.replace(
        chain=CHAIN.replace(top="wall", exponent=2.0),
        excitation=Drive(grain=0, amplitude=1e-7, frequency=3e5),
    ),
}


def forces(scene: Scene, contact: int, samples: int) -> np.ndarray:
    """Return K (1 + A d/dt) o^delta at this number of times."""
    chain = scene.chain
    run = taylor_series.solve(scene.replace(samples=samples, quantities=None), 1e-18)
    u, v = (np.pad(x, ((0, 0), (1, 1))) for x in (run.displacement, run.velocity))
    if scene.drive is not None and scene.drive.grain == 0:
        time = np.linspace(0, scene.duration, samples)
        u[:, 0], v[:, 0] = scene.drive.motion(time)
    law = chain.contacts
    overlap = np.maximum(law.overlap[contact] + u[:, contact] - u[:, contact + 1], 0)
    delta = chain.exponent
    viscous = chain.contact_viscosity[contact] * delta * overlap ** (delta - 1)
    closing = np.where(overlap > 0, v[:, contact] - v[:, contact + 1], 0)
    return law.constant[contact] * (overlap**delta + viscous * closing)


def peak(force: np.ndarray) -> float:
    at = int(force.argmax())
    if not 0 < at < force.size - 1:
        return float(force[at])
    below, top, above = force[at - 1 : at + 2]
    return float(top + (above - below) ** 2 / (8 * (2 * top - above - below)))


@pytest.mark.parametrize("name", SCENES)
def test_forces_of_viscous_contacts_are_right_within_their_errors(name: str):
    scene = SCENES[name]
    numbers = [0, 3] if name == "driven wall" else [1, 6]
    asked = [f"{kind}:{number}" for kind in ("peak_force", "force") for number in numbers]
    gathered = simulate(scene.replace(quantities=asked), "native", 1e-9).gathered
    for number in numbers:
        true = forces(scene, number, gathered["fine_time"].size)
        error = gathered[f"force:{number}_error"]
        assert (np.abs(gathered[f"force:{number}"] - true) <= error).all()
        top = peak(forces(scene, number, 20_001))
        found = gathered[f"peak_force:{number}"]
        error = gathered[f"peak_force:{number}_error"]
        # The force added by the wave; without a wave it is a rounding error.
        added = top - scene.chain.contacts.force[number]
        assert abs(found - top) <= error + 1e-12 * top
        assert error <= 1e-4 * added + 1e-10 * top


@pytest.mark.parametrize("size", [1, 2, 5, 1000])
def test_blocks_of_any_size_and_resumed_runs_give_the_same_bits(size: int):
    scene = STRUCK.replace(quantities=["peak_force:2", "force:2"])
    fine = simulate(scene.fine, "native", 1e-8)
    asked = scene, scene.fine, 0, False
    whole = Gatherer(*asked, {})
    whole.take(0, fine.displacement, fine.velocity)
    pieces = Gatherer(*asked, {})
    pieces.take(0, fine.displacement[:0], fine.velocity[:0])  # A block without samples.
    for first in range(0, fine.time.size, size):
        rows = slice(first, first + size)
        pieces.take(first, fine.displacement[rows], fine.velocity[rows])
        pieces = Gatherer(*asked, pieces.state())
    for name, values in whole.results(1e-8).items():
        np.testing.assert_array_equal(pieces.results(1e-8)[name], values)
    for name in ("trace", "rate", "largest"):
        with pytest.raises(ValueError, match="the saved state does not match this run"):
            Gatherer(*asked, whole.state() | {name: np.zeros((1, 2))})


def test_sweeps_store_the_largest_force_on_a_wall(tmp_path):
    results = sweep(
        {
            "keep": ["wall_force", "peak_force:3"],
            "scene": STRUCK.replace(samples=11).to_dict(),
            "grid": {"chain.damping.viscoelastic": [0.0, 1e-7]},
        },
        tmp_path / "results",
    ).load()
    for row, viscoelastic in enumerate((0.0, 1e-7)):
        chain = CHAIN.replace(damping={"viscoelastic": viscoelastic})
        scene = STRUCK.replace(chain=chain)
        for name, number in (("wall_force", 6), ("peak_force_3", 3)):
            top = peak(forces(scene, number, 20_001))
            assert results[name].values.ravel()[row] == pytest.approx(top, rel=1e-5)
