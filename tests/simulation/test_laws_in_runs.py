"""Native runs of laws by formula: on threads, in batches, sweeps, and files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child_processes import same
from helpers.example_chains import column
from helpers.example_scenes import struck
from helpers.thinned import thinned

import lmpchain
from lmpchain import Damping, Law, Scene, laws, simulate, simulate_many
from lmpchain.engines import Native
from lmpchain.engines.stepping.time_stepping import kind

N = 9
HARDER = Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e5)
KINKED = Law("k*(max(o, 0) + r*min(o, 0))", k=1e5, r=0.3)


def hit(law: Law, **options: Any) -> Scene:
    chain = column(**{"grains": N, "top_load": 0.01, "law": law} | options)
    return struck(chain, 0.2, 2e-4, 41)


def test_a_saved_run_and_its_scene_are_read(tmp_path: Path) -> None:
    parameters = np.linspace(1e4, 1e5, N - 1).tolist()
    scene = hit(HARDER.replace(c=parameters))
    run = simulate(scene, "native", 1e-6)
    run.save(tmp_path / "run.nc")
    again = lmpchain.Trajectory.load(tmp_path / "run.nc")
    assert again.scene == scene
    assert again.scene.chain.law.given["c"] == tuple(parameters)
    assert same(again, run)
    scene.to_toml(tmp_path / "scene.toml")
    assert Scene.from_toml(tmp_path / "scene.toml") == scene


BATCHES = {
    "parameters": [hit(HARDER.replace(c=c)) for c in (0.0, 1e5, 1e6)],
    "constants": [hit(HARDER.replace(k=k)) for k in (1e9, 2e9)],
    "one for each contact": [
        hit(HARDER.replace(c=c)) for c in (1e5, np.linspace(1e4, 1e6, N - 1).tolist())
    ],
    "pulls": [
        hit(laws.toda(b=b, k=1e5), gravity=0.0, top_load=0.0, top="wall", bottom="wall")
        for b in (1e5, 2e5, 4e5)
    ],
    "kinks of their own": [hit(KINKED.replace(r=r)) for r in (0.3, 0.6)]
    + [hit(Law("k*(o + max(o - e, 0))", k=1e5, e=e)) for e in (1e-7, 6e-7)],
    "damped": [hit(KINKED.replace(r=r), damping=Damping(viscoelastic=1e-7)) for r in (0.3, 0.6)],
}


@pytest.mark.parametrize("name", thinned(BATCHES, 2))
def test_every_scene_of_a_batch_has_its_own_parameters(name: str) -> None:
    scenes = BATCHES[name]
    answers = simulate_many(scenes, tolerance=1e-9)
    finals = []
    for scene, found in zip(scenes, answers, strict=True):
        alone = simulate(scene, "native", tolerance=1e-9)
        size = np.abs(alone.velocity).max()
        allowed = alone.error_estimate.total + found.error_estimate.total + 1e-13
        assert np.abs(alone.velocity - found.velocity).max() <= allowed * size
        assert found.error_estimate.total <= 1e-9
        finals.append(found.velocity[-1])
    # The scenes differ by far more than the tolerance.
    assert np.abs(np.diff(finals, axis=0)).max(axis=1).min() > 1e-5


def test_scenes_with_other_parameters_form_one_batch() -> None:
    for name in ("parameters", "constants", "one for each contact", "pulls", "damped"):
        assert len({kind(scene) for scene in BATCHES[name]}) == 1
    assert len({kind(scene) for scene in BATCHES["kinks of their own"]}) == 2


@pytest.mark.parametrize("law", [HARDER, KINKED], ids=["harder", "kinked"])
def test_threads_do_not_change_the_bits(law: Law) -> None:
    scene = hit(law, grains=600)
    one, two = (simulate(scene, Native(threads=threads), tolerance=1e-6) for threads in (1, 2))
    assert same(one, two)


def test_a_sweep_varies_a_parameter(tmp_path: Path) -> None:
    scene = hit(HARDER)
    values = [1e4, 1e5, 1e6]
    table = lmpchain.sweep(
        {"scene": scene.to_dict(), "grid": {"chain.law.c": values}, "keep": ["peak_velocity"]},
        tmp_path / "sweep",
    )
    assert (table.reason == "").all()
    assert table["chain.law.c"].to_numpy().tolist() == values
