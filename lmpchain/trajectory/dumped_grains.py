"""The grains of a LAMMPS dump without a known scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene.lammps_column import RunOptions, Understood, infer_scene
from ..scene.lammps_input import LammpsInput, units_of
from ..scene.lammps_state import RunGrains
from ..util.arrays import Array
from ..util.files import expanded
from .dump_frames import AXES, TYPE, Frames, count_atoms, is_dump, read_frames
from .lammps_dump import last_digit

MOST_FRAMES = 10**6
FULL_DIGITS = 4.0  # Error in units in the last place up to which a number has full precision.
STARTED = 1e-6  # Fraction of the largest velocity below which nothing moves in the first frame.


def scene_of_run(
    paths: Sequence[str | PathLike[str]],
    options: RunOptions | None = None,
    units: str | Sequence[float] | None = None,
) -> Understood:
    """Return the fields of the scene of a LAMMPS run, and the findings about the run.

    Parameters
    ----------
    paths : list of paths
        A dump, an input file or a data file; or an input file and its dump.
    options : RunOptions, optional
        Options of the run, which complete or replace values from the files.
    units : str or (length, time, mass), optional
        Unit style of LAMMPS, or its units, as in `Trajectory.from_dump`.

    Raises
    ------
    InputError
        If the files cannot be interpreted, or if values are missing.
    """
    dumps, inputs = _sorted_files(paths)
    # A dump that does not name its units uses those of its input.
    own = units if units is not None or not inputs else units_of(inputs[0])
    grains = read_grains(dumps[0], own) if dumps else None
    source = LammpsInput(inputs[0], grains, units) if inputs else None
    if grains is None or source is not None:
        assert source is not None
        grains = source.grains()
    return infer_scene(grains, source, options)


def _sorted_files(paths: Sequence[str | PathLike[str]]) -> tuple[list[Path], list[Path]]:
    """Return the dump and the input or data file among these files, at most one of each."""
    files = [expanded(path) for path in paths]
    for file in files:
        if not file.is_file():
            why = "is a folder; name a file in it" if file.is_dir() else "there is no such file"
            raise InputError.at(str(file), why)
    dumps = [file for file in files if is_dump(file)]
    inputs = [file for file in files if file not in dumps]
    if len(dumps) > 1 or len(inputs) > 1:
        raise InputError.at("from", "must be a dump, an input or data file, or one of each")
    return dumps, inputs


def read_grains(path: Path, units: str | Sequence[float] | None = None) -> RunGrains:
    """Return the grains of a dump's first frame, and findings from its other frames."""
    name = str(path)
    count = count_atoms(path)
    if not count:
        raise InputError.at(name, "has no atoms in its first frame: dump the grains")
    frames = read_frames(path, count, most=MOST_FRAMES, units=units)
    steps = frames.steps
    if len(steps) < 2:
        raise InputError.at(name, "has only one frame, and so no duration: dump two or more")
    if np.ptp(np.diff(steps)):
        raise InputError.at(
            name, "its frames are not equally far apart: dump every N steps, from the start"
        )
    columns = frames.in_si()
    missing = [f"v{axis}" for axis in AXES if f"v{axis}" not in columns]
    positions = np.stack([frames.positions(axis) for axis in AXES], axis=-1)
    zero = np.zeros(positions.shape[:2])
    velocities = np.stack([columns.get(f"v{axis}", zero) for axis in AXES], axis=-1)
    if not all(np.isfinite(values).all() for values in frames.columns.values()):
        raise InputError.at(
            name, "contains numbers that are not finite, from a breakdown: use a shorter step"
        )
    along = int(np.argmax(np.ptp(positions[0], axis=0)))
    if f"v{AXES[along]}" in missing:
        raise InputError.at(name, f"has no column v{AXES[along]}, the velocity along the chain")
    _check_motion(name, positions, velocities, along)
    unknown = np.full((1, count), math.nan)
    diameters = columns.get("diameter", 2 * columns.get("radius", unknown))[0]
    masses = columns.get("mass", unknown)[0]
    types = frames.columns[TYPE][0] if TYPE in frames.columns else np.zeros(count)
    # Positions of the first frame may be round numbers; those of later frames are not.
    written = frames.columns[frames.position_columns[along]]
    digit = frames.units.length * last_digit(written.ravel())
    spacing = float(np.spacing(np.abs(positions[0, :, along]).max()))
    times = frames.times
    return RunGrains(
        source=name,
        numbers=frames.numbers,
        types=types.astype(int),
        positions=positions[0],
        velocities=velocities[0],
        diameters=diameters.copy(),
        masses=masses.copy(),
        slack=2 * digit + 4 * spacing,
        digits_lost=digit > FULL_DIGITS * spacing,
        held=_held(positions[..., along]),
        period=np.where(frames.periodic, frames.sides[0], math.inf),
        duration=float(times[-1] - times[0]) if np.isfinite(times).all() else math.nan,
        likely_step=_likely_step(frames, positions[..., along], velocities[..., along]),
        samples=len(steps),
        steps=(int(steps[0]), int(steps[-1])),
    )


def _check_motion(name: str, positions: Array, velocities: Array, along: int) -> None:
    """Raise `InputError` unless the motion begins in the first frame, and is along the column."""
    speed = np.abs(velocities[..., along]).max(1)
    if speed[0] <= STARTED * speed.max() and speed.max() > 0:
        raise InputError.at(
            name,
            "grains move, but not in the first frame: begin the dump at the strike, after the "
            "command velocity; write a drive or a force in [excitation] of a scene",
        )
    across = [axis for axis in range(3) if axis != along]
    sideways = np.abs(positions[..., across] - positions[0][:, across]).max(axis=(0, 2))
    moved = np.abs(positions[..., along] - positions[0, :, along]).max()
    slack = 4 * np.spacing(np.abs(positions[..., across]).max())
    if sideways.max() > 1e-6 * moved + slack:
        raise InputError.at(
            name,
            f"a grain moves sideways by {sideways.max():.3g} m: the column buckles or rotates, but "
            "a scene has motion along the column only",
        )


def _held(z: Array) -> np.ndarray:
    """Return a mask of grains that never move although a neighbour does, from positions (T, N)."""
    moved = np.abs(z - z[0]).max(0)
    order = np.argsort(z[0])
    held = np.zeros(len(order), dtype=bool)
    for end, neighbour in ((order[0], order[1]), (order[-1], order[-2])):
        held[end] = moved[end] == 0 and moved[neighbour] > 0
    # If no wave arrives at either end, the one farther from the strike is held.
    if not held.any():
        still = [end for end in (order[0], order[-1]) if moved[end] == 0]
        if len(still) == 1:
            held[still[0]] = True
        elif still:
            peak = int(np.flatnonzero(order == moved.argmax())[0])
            held[order[-1] if peak < len(order) / 2 else order[0]] = True
    return held


def _likely_step(frames: Frames, z: Array, v: Array) -> float:
    """Return the time step at which positions and velocities agree, s; 0 if unknown."""
    rates = (v[1:] + v[:-1]) / 2 * np.diff(frames.steps)[:, None]
    size = float(np.square(rates).sum())
    step = float((np.diff(z, axis=0) * rates).sum()) / size if size > 0 else 0.0
    return step if step > 0 else 0.0
