"""LAMMPS dumps, of `lmpchain deck` or other decks: displacements, velocities, and grains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, shown
from ..scene.lammps_column import RunOptions, Understood, infer_scene
from ..scene.lammps_input import LammpsInput, units_of
from ..scene.lammps_state import RunGrains
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import path_of
from .dump_checks import (
    CHECKS,
    DumpedMotion,
    FirstFrame,
    check_course,
    check_frames,
    check_grains,
    check_jumps,
    drawn_diameter,
    find_misfit,
)
from .dump_frames import AXES, COLUMNS, TYPE, Frames, count_atoms, is_dump, read_frames
from .record import Cost, ErrorEstimate, Record


class _Column(NamedTuple):
    """Positions and velocities along the axis of the column, (T, N) each, by atom number.

    Attributes
    ----------
    z : (T, N) array
        Positions, m.
    vz : (T, N) array
        Velocities, m/s.
    v_phi : (T, N) array or None
        Displacements, m; None if the dump does not contain them.
    slack : float
        Rounding error of the distance between two grains, m.
    """

    z: Array
    vz: Array
    v_phi: Array | None
    slack: float


def read_dump(
    path: str | PathLike[str],
    scene: Scene,
    equilibrium: Sequence[float] | Array | None = None,
    axis: str | None = None,
    units: str | Sequence[float] | None = None,
) -> Record:
    """Read a LAMMPS dump as the trajectory of a scene; see `lmpchain.Trajectory.from_dump`.

    Raises
    ------
    InputError
        If the dump cannot be read, or does not belong to the scene.
    """
    path = path_of(path, "path")
    name = str(path)
    if axis not in (None, *AXES):
        raise InputError.at(
            "axis", f"must be x, y or z, the axis of the column (got {shown(axis)})"
        )
    rest = None if equilibrium is None else _check_rest(equilibrium, scene.chain.grains)
    frames = read_frames(path, scene.chain.grains, most=2 * scene.samples, units=units)
    check_frames(name, scene, frames)
    axis = axis or _find_axis(name, frames)
    check_jumps(name, frames, axis)
    columns = frames.in_si()
    if f"v{axis}" not in columns:
        raise InputError.at(
            name, f"has no column v{axis}, but its grains are in line along {axis}: {COLUMNS}"
        )
    # The numbers of the file are used, because sums with box lengths have different digits.
    written = frames.columns[frames.position_columns[AXES.index(axis)]]
    length, *_, velocity = frames.units
    z = frames.positions(axis)
    v_phi = columns.get("v_phi")
    spacing = float(np.spacing(np.abs(z[0]).max()))
    rounding = 2 * length * last_digit(written[0]) + 4 * spacing
    column = _Column(z, columns[f"v{axis}"], v_phi, rounding)
    # A deck of lmpchain writes v_phi, and its z points up.
    directions = [-1.0] if v_phi is not None and axis == "z" else _directions(scene, z[0], rest)
    motion, first = _orient(name, scene, directions, column, rest)
    check_grains(name, scene, columns, motion.order, drawn_diameter(scene, motion, first))
    mover = motion.order[int(np.abs(motion.velocity).sum(0).argmax())]
    if v_phi is None:
        _check_digits(name, written[:, mover], length, float(np.ptp(z[:, mover])))
        origin = f"heights minus {'first' if rest is None else 'given'} heights"
    else:
        origin = "v_phi"
    speeds = frames.columns[f"v{axis}"][:, mover]
    numbers = (written if v_phi is None else frames.columns["v_phi"])[:, mover]
    total = int(frames.steps[-1] - frames.steps[0])
    # Grains far from z = 0 have a coarser last digit than the grain with the largest motion.
    digit = length * last_digit(numbers)
    if v_phi is None:
        digit = max(digit, rounding / 2)
    speed_digit = velocity * last_digit(speeds)
    check_course(name, scene, motion, total, digit, spacing)
    recorded = scene.recorded - 1
    return Record(
        scene=scene,
        engine="lammps",
        equation=1,
        time=scene.time.copy(),
        grains=scene.recorded.copy(),
        displacement=motion.displacement[:, recorded].copy(),
        velocity=motion.velocity[:, recorded].copy(),
        error_estimate=ErrorEstimate(0.0, float("inf")),
        cost=Cost(
            integration_s=0.0,
            estimate_s=0.0,
            setup_s=0.0,
            steps=total,
            force_evaluations=total,
            active_grains=scene.chain.grains,
            integrator="unknown",
            step_s=scene.duration / total,
            ranks=1,
        ),
        provenance={
            "dump": name,
            "displacement": origin,
            "column": f"along {axis}, {axis} points {'up' if motion.down < 0 else 'down'}",
            "precision": _describe_precision(length * last_digit(numbers), speed_digit, motion),
            "displacement_digit": repr(digit),
            "velocity_digit": repr(speed_digit),
        },
    )


def _orient(
    name: str, scene: Scene, directions: Sequence[float], column: _Column, rest: Array | None
) -> tuple[DumpedMotion, FirstFrame]:
    """Return the motion along the first direction that agrees with the initial state."""
    z, vz, v_phi, slack = column
    faults = []
    for down in directions:
        # Grains are numbered from the top, independent of the atom numbers.
        order = np.argsort(down * z[0], kind="stable")
        if v_phi is not None:
            displacement = v_phi[:, order]
        elif rest is not None:
            displacement = down * (z[:, order] - rest)
        else:
            displacement = down * (z[:, order] - z[0, order])
            # The first frame is not at rest if the scene begins with a displacement.
            displacement += scene.initial()[0]
        motion = DumpedMotion(down, order, displacement, down * vz[:, order])
        first = FirstFrame(down * z[0, order], slack, v_phi is not None)
        fault = find_misfit(scene, motion, first)
        if not fault:
            return motion, first
        faults.append(fault)
    raise InputError.at(name, faults[0])


def _find_axis(name: str, frames: Frames) -> str:
    """Return the axis along which the grains of the first frame are far apart."""
    spread = [float(np.ptp(frames.positions(axis)[0])) for axis in AXES]
    longest = int(np.argmax(spread))
    # An inclined column has no axis.
    if not spread[longest] > 2 * sorted(spread)[-2]:
        raise InputError.at(
            "axis",
            f"{name}: its grains are not in line along x, y or z: give the axis of the column",
        )
    return AXES[longest]


def _describe_precision(digit: float, speed_digit: float, motion: DumpedMotion) -> str:
    """Return the precision of a dump as text, given its last digits, m and m/s."""
    texts = []
    for quantity, unit, last, values in (
        ("displacement", "m", digit, motion.displacement),
        ("velocity", "m/s", speed_digit, motion.velocity),
    ):
        half = last / 2
        largest = float(np.abs(values).max())
        share = half / (largest or np.inf)
        texts.append(f"{quantity} within {half:.2g} {unit}, {share:.1g} of the largest")
    return "; ".join(texts)


def _check_rest(equilibrium: Sequence[float] | Array, grains: int) -> Array:
    """Return the heights at rest as (N,) numbers; raise `InputError` if they are invalid."""
    try:
        rest = np.asarray(equilibrium, dtype=float)
    except (TypeError, ValueError):
        rest = np.empty(0)
    if rest.shape != (grains,) or not np.isfinite(rest).all():
        raise InputError.at(
            "equilibrium", f"must be the heights at rest of the {grains} grains, m, from the top"
        )
    return rest


def _directions(scene: Scene, z: Array, rest: Array | None) -> list[float]:
    """Return the directions -1 (z points up) and 1 (down), the likelier one first.

    The overlaps decide, because they increase with the weight above. The differences between the
    measured distances of centres and those of the first sample of the scene vary least along the
    column in the right direction. The velocity of a single grain decides later.
    """
    if z.size == 1:
        return [-1.0, 1.0]
    if rest is not None:
        return [1.0 if rest[-1] > rest[0] else -1.0]
    chain = scene.chain
    gaps = chain.contact_lengths[1:-1] - chain.equilibrium_overlap + np.diff(scene.initial()[0])
    return sorted((-1.0, 1.0), key=lambda down: float(np.ptp(np.diff(np.sort(down * z)) - gaps)))


def last_digit(values: Array) -> float:
    """Return the size of the last digit of the largest number.

    If all numbers are in single precision, the spacing of single precision is returned, even if
    more digits were written.
    """
    largest = float(np.abs(values).max())
    numbers = values.tolist()
    for digits in range(1, 17):
        if largest and all(float(f"{number:.{digits - 1}e}") == number for number in numbers):
            return float(10.0 ** (np.floor(np.log10(largest)) - digits + 1))
    single = values.astype(np.float32)
    return float(np.spacing(np.abs(single).max() if (single == values).all() else largest))


def _check_digits(name: str, heights: Array, unit: float, motion: float) -> None:
    """Raise `InputError` if the digits of heights, (T,), are too few to resolve a motion, m.

    `unit` is the unit of the heights, m.
    """
    digit = last_digit(heights)
    if heights.any() and motion < CHECKS.levels * unit * digit:
        digits = round(np.log10(np.abs(heights).max() / digit) + 0.5)
        cure = "write them with dump_modify format float %.17g, or dump v_phi"
        raise InputError.at(
            name,
            f"its heights have {digits} digits, too few for displacements of {motion:.1g} m: "
            f"{cure}, as lmpchain deck does",
        )


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
    files = [path_of(path, "from") for path in paths]
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
    if count == 1:
        raise InputError.at(name, "has 1 grain: a column has two or more")
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
