"""Comparisons of LAMMPS with the native engine, of decks with the library, of stopped runs."""

import filecmp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.standalone_lammps import lmp, read_dump
from helpers.stopped_runs import stop_three_times

from lmpchain import Scene, simulate
from lmpchain.engines import Lammps, Native
from lmpchain.engines.lammps.export import write_deck


def check_agreement(
    scene: Scene, step: float, integrator: str = "verlet", within: float = 1e-3
) -> None:
    """Check that both engines agree at the same steps, but for the rounding of heights."""
    native = simulate(scene, Native(integrator=integrator, step=step))
    ours = simulate(scene, Lammps(integrator, step=step, diameter="gauge"))
    assert native.cost.steps == ours.cost.steps
    assert np.abs(native.velocity - ours.velocity).max() < 1e-10 * np.abs(native.velocity).max()
    expected = native.error_estimate.solver
    assert ours.error_estimate.solver == pytest.approx(expected, rel=within, abs=1e-10)


def check_deck(scene: Scene, folder: Path, **options: Any) -> None:
    """Check that a deck alone gives the files and the motion of the library."""
    options = {"integrator": "verlet", "diameter": "physical"} | options
    write_deck(scene, folder / "deck", **options)
    lmp(folder / "deck", "-screen", "none")
    t = simulate(scene, Lammps(**options, keep=folder / "library"))
    for name in ("column.lammpstrj", "in.column"):
        assert filecmp.cmp(folder / "deck" / name, folder / "library" / name, shallow=False)
    u, v = read_dump(folder / "deck" / "column.lammpstrj")
    assert np.array_equal(u[1:], t.displacement[1:])
    assert np.array_equal(v, t.velocity)
    assert np.abs(u).max() > 0
    # A dump contains heights, including the initial ones.
    assert u[0] == pytest.approx(t.displacement[0], rel=0, abs=1e-17)


def check_resumed(
    scene: Scene, engine: Lammps, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that a run that stops three times gives the bits of a whole run."""
    whole = simulate(scene, engine)
    answer = stop_three_times(scene, engine, folder, monkeypatch)
    for field in ("displacement", "velocity"):
        assert np.array_equal(getattr(answer, field)[:], getattr(whole, field))
