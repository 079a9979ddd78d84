"""Runs of decks by the stand-alone LAMMPS, and its dumps."""

import shutil
import subprocess
import sys
from pathlib import Path

import MDAnalysis
import numpy as np
from helpers.example_scenes import scene_of

from lmpchain import Chain, Impulse, Scene


def lmp(folder: Path, *options: str) -> str:
    """Run the stand-alone LAMMPS on the deck of a folder."""
    program = shutil.which("lmp") or str(Path(sys.executable).with_name("lmp"))
    done = subprocess.run(
        [program, "-in", "in.column", *options],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def read_dump(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement (T, N) m and velocity (T, N) m/s, downward, as MDAnalysis reads them."""
    dump = MDAnalysis.Universe(
        str(path),
        format="LAMMPSDUMP",
        topology_format="LAMMPSDUMP",
        additional_columns=["v_phi", "vz"],
    )
    frames = [(ts.data["v_phi"].copy(), -ts.data["vz"].copy()) for ts in dump.trajectory]
    u, v = zip(*frames, strict=True)
    return np.array(u), np.array(v)


def small(excitation=None, **chain) -> Scene:
    made = Chain(**({"grains": 25, "material": "glass", "diameter": 1e-3} | chain))
    return scene_of(made, excitation or Impulse(velocity=8.57e-4), 2e-5, 6)
