"""Reading what LAMMPS dumped: displacements and velocities of the grains of a scene."""

from __future__ import annotations

import warnings
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .engines.base import Cost
from .errors import InputError
from .fields import Array
from .scene import Scene

if TYPE_CHECKING:
    from .trajectory import Trajectory

BEGIN = "ITEM: TIMESTEP"
HEADER = 9  # lines above the atoms of a frame
SAME = 1e-6  # how far, relative to the largest, the first frame may be from the start of the scene
FEWEST_LEVELS = 100  # that heights must resolve in a displacement


def is_dump(path: str | PathLike[str]) -> bool:
    """Say whether a file begins as a LAMMPS dump does."""
    try:
        with open(path, "rb") as opened:
            return opened.read(len(BEGIN)) == BEGIN.encode()
    except OSError:
        return False


def read(path: str | PathLike[str], scene: Scene) -> Trajectory:
    """Read a dump as the answer of LAMMPS to a scene; see `lmpchain.Trajectory.from_dump`.

    Raises
    ------
    InputError
        If it cannot be read, or is not of this scene.
    """
    from .trajectory import ErrorEstimate, Trajectory

    path = Path(path)
    name, columns = str(path), _columns(path, scene)
    kept: list[str] = [column for column in ("v_phi", "z", "vz") if column in columns]
    steps, data = _frames(path, kept)
    chain = scene.chain
    if len(steps) != scene.samples:
        cure = "set the samples of the scene so, or run LAMMPS to its end"
        raise InputError([(name, f"has {len(steps)} whole frames, the scene {scene.samples} samples: {cure}")])
    apart = np.diff(steps)
    if (apart <= 0).any() or (apart != apart[0]).any():
        raise InputError([(name, "its frames are not equally far apart: dump every so many steps, from the start")])
    if not all(np.isfinite(values).all() for values in data.values()):
        raise InputError([(name, "holds numbers that are not finite: the run broke down; use a shorter step")])
    u, v = scene.initial()
    velocity = -data["vz"]
    displacement = data["v_phi"] if "v_phi" in data else u + data["z"][0] - data["z"]
    grain = np.arange(1, chain.grains + 1)
    height = 1e-15 * np.abs(data["z"]).max()
    for what, values, start, unit in (("velocity", velocity, v, "m/s"), ("displacement", displacement, u, "m")):
        off = np.abs(values[0] - start)
        if (off > SAME * np.abs(start).max() + (height if what == "displacement" else 0.0)).any():
            n = int(off.argmax())
            found = f"grain {grain[n]} begins with a {what} of {values[0, n]:.6g} {unit}, in the scene {start[n]:.6g}"
            raise InputError([(name, f"{found}: give the scene that the dump was made for")])
    if "v_phi" not in data:
        mover = int(np.abs(velocity).sum(0).argmax())
        _check_digits(name, data["z"][:, mover])
    chosen = scene.recorded - 1
    total = int(steps[-1] - steps[0])
    return Trajectory(
        scene=scene,
        engine="lammps",
        equation=1,
        time=scene.time,
        grains=scene.recorded,
        displacement=displacement[:, chosen].copy(),
        velocity=velocity[:, chosen].copy(),
        error_estimate=ErrorEstimate(0.0, float("inf")),
        cost=Cost(0.0, 0.0, 0.0, total, total, chain.grains, "unknown", scene.duration / total, 1),
        provenance={"dump": name, "displacement": "v_phi" if "v_phi" in data else "heights less those at first"},
    )


def _columns(path: Path, scene: Scene) -> list[str]:
    """Return the names of the columns, once it is clear that the dump is of such a chain."""
    name, grains = str(path), scene.chain.grains
    if not path.is_file():
        raise InputError([(name, "is a folder; name the dump in it" if path.is_dir() else "there is no such file")])
    if not is_dump(path):
        raise InputError([(name, "is no LAMMPS dump in text: write one with lmpchain deck, or by dump custom")])
    with open(path, encoding="utf-8", errors="replace") as opened:
        head = [opened.readline().strip() for _ in range(HEADER)]
    if not head[3].isdigit() or not head[8].startswith("ITEM: ATOMS"):
        raise InputError([(name, "is cut short, or has lines that no plain dump custom has: write it anew")])
    with open(path, "rb") as opened:
        opened.seek(-1, 2)
        if opened.read() != b"\n":
            raise InputError([(name, "is cut short within a line: run LAMMPS to its end")])
    if int(head[3]) != grains:
        raise InputError([(name, f"has {head[3]} atoms, the scene {grains} grains: give the scene it was made for")])
    columns = head[8].split()[2:]
    if missing := [key for key in ("id", "x", "y", "z", "vz") if key not in columns]:
        cure = "dump custom ... id x y z vz v_phi, with dump_modify format float %.17g"
        raise InputError([(name, f"has no column {', '.join(missing)}: {cure}")])
    return columns


def _frames(path: Path, columns: list[str]) -> tuple[np.ndarray, dict[str, Array]]:
    """Return the numbers of the steps, (T,), and these columns in the order of the grains, (T, N) each.

    MDAnalysis holds positions in single precision, but columns that are asked for by name in double.
    """
    from MDAnalysis.coordinates.LAMMPS import DumpReader

    try:
        with warnings.catch_warnings(action="ignore"), DumpReader(str(path), additional_columns=columns) as dump:
            steps, rows = [], []
            for frame in dump:
                steps.append(int(frame.data["step"]))
                rows.append([frame.data[column].copy() for column in columns])
    except Exception as error:  # whatever damaged lines make the reader raise
        reason = f"cannot be read as a dump: {error}; write it anew"
        raise InputError([(str(path), reason)]) from None
    return np.array(steps), dict(zip(columns, np.array(rows).transpose(1, 0, 2), strict=True))


def _check_digits(name: str, heights: Array) -> None:
    """Raise `InputError` if the heights of a grain that moves, (T,) m, were written with too few digits to show it."""
    largest, moved = np.abs(heights).max(), np.ptp(heights)
    digits = next((d for d in range(1, 17) if all(float(f"{z:.{d - 1}e}") == z for z in heights.tolist())), 17)
    if largest and moved < FEWEST_LEVELS * 10.0 ** (np.floor(np.log10(largest)) - digits + 1):
        cure = "write them with dump_modify format float %.17g, or dump v_phi, as lmpchain deck does"
        raise InputError(
            [(name, f"its heights have {digits} digits, too few for displacements of {moved:.1g} m: {cure}")]
        )
