"""Runs stopped at any block continue and end with the bits of an uninterrupted run."""

import itertools
import json
import math
import os
import random
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.child_processes import same
from helpers.example_chains import column
from helpers.example_scenes import paper, scene_of, struck

from lmpchain import (
    Chain,
    Drive,
    Force,
    Impulse,
    InputError,
    Law,
    Scene,
    Stopped,
    Trajectory,
    engines,
    laws,
    resume,
    simulate,
)
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation import run_folder
from lmpchain.simulation.run_folder import status

CHAIN = Chain(grains=200, diameter=1e-3)
STRIKE = Impulse(velocity=8.57e-3)
SCENE = Scene(chain=CHAIN, excitation=STRIKE, duration=4e-3, samples=3001)
SHORT = Scene(chain=CHAIN, excitation=STRIKE, duration=3e-4, samples=601)
BRIEF = Scene(chain=CHAIN, excitation=STRIKE, duration=3e-5, samples=301)
DRIVEN = scene_of(CHAIN, Drive(amplitude=1e-8, frequency=2e4), 3e-4, 301)
PUSHED = DRIVEN.replace(
    excitation=Force(grain=3, shape="half-sine", amplitude=1e-3, duration=1.03e-4)
)
MOVED = DRIVEN.replace(
    chain=CHAIN.replace(top="wall", top_load=0.1),
    excitation=Drive(amplitude=1e-9, frequency=2e4, cycles=2.3, grain=0),
)
# Grain 1 rises above the others, by many gauge diameters or by less than one, and falls back.
AWAY = scene_of(Chain(grains=3, diameter=1e-3), Impulse(velocity=-5e-3), 1.5e-3, 121)
APART = AWAY.replace(excitation=Impulse(velocity=-5e-4), duration=1.5e-4)
# The middle grain moves up, across the border between two ranks.
CROSSING = scene_of(
    Chain(grains=41, material="steel", diameter=5e-3, top_load=10.0),
    Impulse(velocity=-0.1, grain=21),
    1e-4,
    21,
)
LAWFUL = struck(
    column(9, top_load=0.01, law=Law("k*max(o, 0)**1.5*(1 + c*o)", k=1e9, c=1e5)), 0.2, 2e-4, 41
)
KINKED = LAWFUL.replace(
    chain=LAWFUL.chain.replace(
        law=laws.bilinear(0.3, k=1e5), damping={"viscoelastic": 1e-7, "drag": 100.0}
    )
)
STOPPED = {
    "native": (SCENE, engines.Native(step=2e-8), 1e-6),
    "several attempts": (SHORT, engines.Native(adaptive=False), 1e-4),
    "verlet": (SHORT, engines.Native(integrator="verlet", step=1e-9), 1e-6),
    "driven": (DRIVEN, engines.Native(step=2e-9), 1e-6),
    "pushed": (PUSHED, engines.Native(step=2e-8), 1e-6),
    "wall moved": (MOVED, engines.Native(integrator="gear4", step=2e-9), 1e-6),
    "lammps, pushed": (PUSHED, engines.Lammps(integrator="rkn6", step=1e-7), 1e-6),
    "lammps, wall moved": (MOVED, engines.Lammps(integrator="rkn6", step=1e-7), 1e-6),
    "modes, pushed": (PUSHED, engines.Modes(), 0.99),
    "lammps": (BRIEF, engines.Lammps(integrator="kahan-li6", step=1e-7, diameter="physical"), 1e-6),
    "lammps, gauge": (paper("weak", 301), engines.Lammps(diameter="gauge", step=4e-7), 1e-6),
    "lammps, driven": (
        DRIVEN,
        engines.Lammps(integrator="verlet", step=1e-7, diameter="physical"),
        1e-6,
    ),
    "lammps, away": (AWAY, engines.Lammps("verlet", step=2e-7, diameter="gauge"), 1e-6),
    "lammps, apart": (APART, engines.Lammps("verlet", step=2e-8, diameter="gauge"), 1e-6),
    "modes": (SHORT, engines.Modes(), 0.99),
    "chebyshev": (SHORT, engines.Chebyshev(), 0.99),
    "bessel": (paper("weak", 301), engines.Bessel(), 0.99),
    "continuum": (paper("weak", 301), engines.Continuum(), 0.99),
    "law": (LAWFUL, engines.Native(), 1e-8),
    "damped law": (KINKED, engines.Native(), 1e-8),
}

QUICK = ("lammps", "modes", "bessel", "continuum", "law", "damped law")
MARKS: dict[str, Any] = dict.fromkeys(QUICK, ()) | {"lammps, wall moved": pytest.mark.soak}


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch):
    """Make blocks of four samples in any run, so that it can be stopped early."""
    monkeypatch.setattr(stepping_run, "BLOCK_S", 1e-9)


@pytest.mark.filterwarnings("ignore:Eq. ")
@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=MARKS.get(case, pytest.mark.slow)) for case in STOPPED]
)
def test_stopped_after_every_block(case: str, tmp_path: Path):
    """The state belongs to the engine.

    At the end of its time already, a run stops as soon as it has a sample.
    """
    scene, engine, tolerance = STOPPED[case]
    rng = random.Random(case)
    stops = 0
    seen = set()
    for attempt in itertools.count():
        limit = None if stops == 4 else rng.choice([1e-9, 1e-9, 0.02])
        try:
            if attempt == 0:
                answer = simulate(scene, engine, tolerance, folder=tmp_path / "run", max_wall=limit)
            else:
                answer = resume(tmp_path / "run", max_wall=limit)
            break
        except Stopped:
            stops += 1
            said = status(tmp_path / "run")
            assert said["state"] == "stopped"
            assert said["reason"].startswith("stopped at the end of its time after")
            seen.add((said["attempt"], said["samples_done"]))
            if said["samples_done"]:
                partial = Trajectory.load(tmp_path / "run")
                assert partial.displacement.shape == (said["samples_done"], scene.recorded.size)
                assert np.isfinite(partial.velocity[:]).all()
                assert 0 < partial.error_estimate.total < np.inf
    assert len(seen) == stops >= 2, "every stop was at another place"
    assert same(answer, simulate(scene, engine, tolerance))


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """Return the folder of a run stopped twice, with two checkpoints of different samples."""
    with pytest.raises(Stopped):
        simulate(SHORT, "native", 1e-2, folder=tmp_path / "run", max_wall=1e-9)
    with pytest.raises(Stopped):
        resume(tmp_path / "run", max_wall=1e-9)
    return tmp_path / "run"


def test_a_damaged_checkpoint_is_replaced_by_the_previous_one(stopped: Path):
    newest = stopped / "checkpoint"
    done = status(stopped)["samples_done"]
    whole = newest.read_bytes()
    damages = [
        whole[: len(whole) // 2],
        whole[:10],
        b"",
        whole[:500] + bytes([whole[500] ^ 1]) + whole[501:],
    ]
    for damaged in damages:
        newest.write_bytes(damaged)
        with (
            pytest.warns(UserWarning, match="checkpoint is damaged; going on from the one before"),
            pytest.raises(Stopped),
        ):
            resume(stopped, max_wall=1e-9)
        assert status(stopped)["samples_done"] == done, "that of the one before, and a block more"
    assert same(resume(stopped), simulate(SHORT, "native", 1e-2))


def test_a_run_without_a_checkpoint_starts_again(stopped: Path):
    (stopped / "checkpoint").write_bytes(b"nothing")
    (stopped / "checkpoint-before").write_bytes(b"nothing")
    with pytest.warns(UserWarning, match="going on from the start"):
        answer = resume(stopped)
    assert same(answer, simulate(SHORT, "native", 1e-2))


def test_a_checkpoint_without_its_samples_is_not_used(stopped: Path):
    os.rename(stopped / "trajectory.zarr", stopped.parent / "elsewhere")
    with pytest.warns(UserWarning, match="going on from the start"):
        answer = resume(stopped)
    assert same(answer, simulate(SHORT, "native", 1e-2))


def test_another_version_is_named(stopped: Path):
    asked = stopped / "run.json"
    asked.write_text(asked.read_text().replace(f'"numpy": "{np.__version__}"', '"numpy": "1.0"'))
    with pytest.warns(UserWarning, match=f"numpy {np.__version__}, not 1.0"):
        resume(stopped)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["lammps", "lammps, driven"])
def test_another_number_of_ranks_gives_the_same_bits(case: str, tmp_path: Path):
    scene, engine, tolerance = STOPPED[case]
    with pytest.raises(Stopped):
        simulate(scene, engine, tolerance, folder=tmp_path / "run", max_wall=1e-9)
    with pytest.raises(InputError, match="ranks: must be at most one per grain"):
        resume(tmp_path / "run", ranks=1000)
    with pytest.raises(Stopped):
        resume(tmp_path / "run", ranks=2, max_wall=1e-9)
    answer = resume(tmp_path / "run", ranks=1)
    assert same(answer, simulate(scene, engine, tolerance))
    sessions = json.loads((tmp_path / "run" / "run.json").read_text())["sessions"]
    assert [session["ranks"] for session in sessions] == [1, 2, 1]


def on_ranks(scene: Scene, engine: engines.Lammps, ranks: list[int], folder: Path) -> Trajectory:
    """Run a scene with each number of ranks in turn, and stop each run but the last early."""
    for number, count in enumerate(ranks):
        limit = None if number == len(ranks) - 1 else 1e-9
        with nullcontext() if limit is None else pytest.raises(Stopped):
            if number == 0:
                engine.ranks = count
                answer = simulate(scene, engine, folder=folder, max_wall=limit)
            else:
                answer = resume(folder, ranks=count, max_wall=limit)
    return answer


@pytest.mark.parametrize(
    "ranks",
    [
        pytest.param([2, 2], marks=pytest.mark.slow),
        pytest.param([1, 2, 4, 2, 3, 2], marks=pytest.mark.soak),
    ],
    ids=str,
)
def test_a_grain_crosses_the_border_of_two_ranks(ranks: list[int], tmp_path: Path):
    engine = engines.Lammps("verlet", step=5e-7, diameter="physical")
    right = simulate(CROSSING, engine)
    assert same(on_ranks(CROSSING, engine, ranks, tmp_path / "run"), right)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(10))
def test_ten_stops_at_random_on_random_ranks(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    rng = random.Random(seed)

    # A session computes one block of at most 40 samples, however slow the machine is.
    def block(fit: int, *_: int) -> int:
        return 40 if fit else 4 * rng.randint(1, 10)

    monkeypatch.setattr(stepping_run, "fit_block", block)
    monkeypatch.setattr(run_folder, "INTERVALS", run_folder.INTERVALS._replace(sample_s=math.inf))
    grains = rng.randint(30, 61)
    strike = Impulse(velocity=rng.choice([-0.1, 0.1]), grain=rng.randint(1, grains - 1))
    scene = scene_of(
        CROSSING.chain.replace(grains=grains),
        rng.choice([strike, strike, Drive(amplitude=1e-5, frequency=2e3)]),
        1e-3,
        401,
    )
    engine = engines.Lammps(
        rng.choice(engines.Lammps.integrators),
        step=2.5e-6,
        diameter=rng.choice(["physical", "gauge"]),
    )
    right = simulate(scene, engine)
    ranks = [rng.randint(1, 4) for _ in range(11)]
    answer = on_ranks(scene, engine, ranks, tmp_path / "run")
    print(grains, scene.excitation, engine.integrator, engine.diameter, ranks, flush=True)
    assert same(answer, right)
