"""LAMMPS dumps as stored in a file: frames, with their times, boxes and columns."""

from __future__ import annotations

import gzip
import re
import sys
import zlib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, short
from ..util.arrays import Array
from ..util.files import check_readable, expanded
from ..util.units import STYLES, Units, read_units
from .other_formats import describe_other_format

BEGIN = b"ITEM: TIMESTEP"
# These lines of `dump_modify units` and `dump_modify time` precede a frame.
UNITS = b"ITEM: UNITS"
TIME = b"ITEM: TIME"
# Lines between the first line of a frame and its atoms.
STEP = 0
COUNT_LABEL = 1
COUNT = 2
BOX = 3
SIDES = slice(4, 7)
ATOMS = 7
HEADER = 8
LABELS = {COUNT_LABEL: b"ITEM: NUMBER OF ATOMS", BOX: b"ITEM: BOX BOUNDS", ATOMS: b"ITEM: ATOMS"}
LONGEST_LINE = 2**14  # Bytes; a small file could unpack to a line that fills the memory.
MOST_ATOMS = 2.0**53  # Numbers of atoms above this value are not exact in doubles.
COUNT_DIGITS = re.compile(rb"\d{1,18}")
AXES = ("x", "y", "z")
UNWRAPPED = ("xu", "yu", "zu")
IMAGES = ("ix", "iy", "iz")
MOTION = ("vx", "vy", "vz", "v_phi")
CLOCK = "v_time"  # Used by our decks, because MDAnalysis cannot read ITEM: TIME.
GRAINS = ("radius", "diameter", "mass")
TYPE = "type"
COLUMNS = "dump custom ... id x y z vz v_phi, with dump_modify format float %.17g"


class Frames(NamedTuple):
    """The T frames of a dump of N atoms, ordered by step.

    Attributes
    ----------
    numbers : (N,) array
        Numbers of the atoms.
    steps : (T,) array
        Numbers of the time steps.
    times : (T,) array
        Times, s; NaN if the dump does not contain them.
    sides : (T, 3) array
        Lengths of the box along x, y and z, m.
    periodic : (3,) array of bool
        Whether the box repeats along x, y and z.
    columns : dict
        Columns of the dump by name, (T, N) arrays ordered by atom number, in the units of the dump.
    units : Units
        Units of the columns.
    """

    numbers: np.ndarray
    steps: np.ndarray
    times: Array
    sides: Array
    periodic: NDArray[np.bool_]
    columns: dict[str, Array]
    units: Units

    def in_si(self) -> dict[str, Array]:
        """Return the columns in SI units."""
        return {name: values * self._unit(name) for name, values in self.columns.items()}

    def _unit(self, column: str) -> float:
        """Return the unit of a column in SI."""
        units = self.units
        if column in ("vx", "vy", "vz"):
            return units.velocity
        if column in (*IMAGES, TYPE):
            return 1.0
        return {CLOCK: units.time, "mass": units.mass}.get(column, units.length)

    @property
    def position_columns(self) -> tuple[str, ...]:
        """Return the names of the columns with positions along x, y and z."""
        return UNWRAPPED if UNWRAPPED[0] in self.columns else AXES

    def positions(self, axis: str) -> Array:
        """Return positions along an axis, (T, N) m, without periodic wrapping."""
        number = AXES.index(axis)
        written = self.units.length * self.columns[self.position_columns[number]]
        images = self.columns.get(IMAGES[number])
        if images is None or self.position_columns == UNWRAPPED:
            return written
        return written + images * self.sides[:, number, None]


class _Frame(NamedTuple):
    """Lines of one frame after the first line, and its time, s."""

    time: float
    lines: list[bytes]


def is_dump(path: str | PathLike[str]) -> bool:
    """Return whether a file, possibly compressed by gzip, is a LAMMPS dump."""
    path = expanded(path)
    try:
        # Reading a pipe would block.
        check_readable(path, sys.maxsize)
        with _open(path) as opened:
            return opened.read(len(BEGIN)).startswith((UNITS, TIME))
    except (OSError, EOFError, ValueError, zlib.error):
        return False


def read_frames(
    path: Path, grains: int, most: int, units: str | Sequence[float] | None = None
) -> Frames:
    """Read the frames of a dump; raise `InputError` if the number of grains differs.

    A run that was stopped and restarted may write the frame of a step twice; the last one is used.
    Incomplete frames, which a killed run leaves, are ignored. If a dump has more than `most`
    frames, `InputError` is raised.
    """
    name = str(path)
    if not path.is_file():
        raise InputError.at(
            name,
            "is a folder; name the dump in it" if path.is_dir() else "there is no such file",
        )
    if not is_dump(path):
        fault = "is not a LAMMPS dump in text: write one with lmpchain deck, or by dump custom"
        raise InputError.at(name, describe_other_format(path) or fault)
    try:
        with _open(path) as opened:
            scales: list[Units] = []
            whole = _whole_frames(name, opened, grains, units, scales)
            frames = _gather(name, whole, grains, most)
    except InputError:
        raise
    except (ValueError, OverflowError, OSError, EOFError, zlib.error) as error:
        raise InputError.at(
            name, f"cannot be read as a dump: {short(error)}; write it anew"
        ) from None
    if len(set(scales)) > 1:
        raise InputError.at(name, "ITEM: UNITS is not the same in all frames: write it anew")
    scale = scales[0] if scales else read_units(units)
    return frames._replace(
        units=scale, times=scale.time * frames.times, sides=scale.length * frames.sides
    )


def count_atoms(path: Path) -> int:
    """Return the number of atoms in the first frame of a dump; 0 if it is not stated."""
    with _open(path) as opened:
        for _ in range(HEADER):
            if opened.readline(LONGEST_LINE).startswith(LABELS[COUNT_LABEL]):
                return max(0, _count(opened.readline(LONGEST_LINE)))
    return 0


def _open(path: Path) -> IO[bytes]:
    opener: Any = gzip.open if path.suffix == ".gz" else open
    return opener(path, "rb")


def _lines(name: str, opened: IO[bytes]) -> Iterator[bytes]:
    """Yield the lines of a dump with their ends; raise `InputError` if it has no lines."""
    while line := opened.readline(LONGEST_LINE):
        if not line.endswith(b"\n"):
            if len(line) == LONGEST_LINE:
                raise InputError.at(
                    name, f"has a line of more than {LONGEST_LINE} characters: write it anew"
                )
            raise InputError.at(name, "is cut short within a line: run LAMMPS to its end")
        yield line


def _count(text: bytes) -> int:
    """Return a number of atoms or steps, or -1 if the line is not a number."""
    return int(text) if COUNT_DIGITS.fullmatch(text.strip()) else -1


def _text(line: bytes) -> str:
    """Return a line in readable form for a message."""
    return short(line.decode(errors="replace").strip())


def _whole_frames(
    name: str,
    opened: IO[bytes],
    grains: int,
    units: str | Sequence[float] | None,
    scales: list[Units],
) -> Iterator[_Frame]:
    """Yield each whole frame, skipping truncated ones; append units of frames to `scales`."""
    lines = _lines(name, opened)
    time = np.nan
    frame = _Frame(time, [])
    for line in lines:
        # If a run was killed within a line, the next frame begins in the middle of the line.
        if BEGIN in line:
            if _is_whole(name, frame, grains):
                yield frame
            frame = _Frame(time, [])
            time = np.nan
        elif UNITS in line:
            scales.append(read_units(units, _text(next(lines, b""))))
        elif TIME in line:
            time = _time(name, next(lines, b""))
        elif len(frame.lines) < HEADER + grains:
            frame.lines.append(line)
    if _is_whole(name, frame, grains):
        yield frame


def _time(name: str, line: bytes) -> float:
    try:
        return float(line)
    except ValueError:
        raise InputError.at(
            name, f"ITEM: TIME must be a number of seconds (got {_text(line)}): write it anew"
        ) from None


def _is_whole(name: str, frame: _Frame, grains: int) -> bool:
    """Return whether a frame is complete; raise `InputError` if it has other columns."""
    lines = frame.lines
    if len(lines) < HEADER:
        return False
    for row, label in LABELS.items():
        if not lines[row].startswith(label):
            raise InputError.at(
                name,
                f"has no line {label.decode()} where dump custom writes it, at step "
                f"{_text(lines[STEP])}: write it anew, by dump custom",
            )
    for row, label in ((STEP, BEGIN), (COUNT, LABELS[COUNT_LABEL])):
        if _count(lines[row]) < 0:
            raise InputError.at(
                name,
                f"{label.decode()} must be a whole number (got {_text(lines[row])}): write it anew",
            )
    atoms = _count(lines[COUNT])
    if atoms != grains:
        raise InputError.at(
            name,
            f"has {atoms} atoms, but the scene has {grains} grains (step {_count(lines[STEP])}): "
            "give the scene that the dump was made for",
        )
    return len(lines) == HEADER + grains


def _gather(name: str, frames: Iterator[_Frame], grains: int, most: int) -> Frames:
    """Return the frames of a dump as arrays, the last one of each step."""
    rows: dict[int, Array] = {}
    times: dict[int, float] = {}
    sides: dict[int, Array] = {}
    header: list[str] = []
    for frame in frames:
        lines = frame.lines
        step = _count(lines[STEP])
        words = lines[ATOMS].decode(errors="replace").split()[2:]
        if not rows:
            header = words
            periodic = _periodic(lines[BOX])
            names = _needed(name, header, lines[HEADER].split())
            indices = [header.index(key) for key in names]
        if words != header:
            raise InputError.at(
                name,
                f"ITEM: ATOMS names other columns at step {step} than in the first frame: dump the "
                "same columns in all frames",
            )
        atoms = np.loadtxt(lines[HEADER:], usecols=indices, ndmin=2, comments=None)
        if len(atoms) != grains:
            raise ValueError(f"an atom has no line at step {step}")
        # A restarted run writes some frames again; the last one is used.
        rows[step] = _sort(atoms)
        numbers = np.sort(atoms[:, 0])
        times[step] = frame.time
        sides[step] = _box_sides(name, lines)
        if len(rows) > most:
            raise ValueError(f"it has more than {most} frames")
    if not rows:
        raise InputError.at(
            name, "is cut short in its first frame: run LAMMPS to its end, or write it anew"
        )
    steps = np.array(sorted(rows))
    values = np.array([rows[step] for step in steps]).transpose(1, 0, 2)
    columns = dict(zip(names[1:], values, strict=True))
    clock = np.array([times[step] for step in steps])
    if CLOCK in columns and np.isnan(clock).all():
        clock = columns[CLOCK][:, 0]
    return Frames(
        numbers=numbers.astype(int),
        steps=steps,
        times=clock,
        sides=np.array([sides[step] for step in steps]),
        periodic=periodic,
        columns=columns,
        units=STYLES["si"],
    )


def _needed(name: str, columns: Sequence[str], row: Sequence[bytes]) -> list[str]:
    """Return the columns of a dump to read, the atom numbers first, from the first row."""
    # Periodic boxes wrap x, y and z, but not xu, yu and zu.
    unwrapped = set(UNWRAPPED) <= set(columns)
    positions = UNWRAPPED if unwrapped else AXES
    missing = [key for key in ("id", *positions) if key not in columns]
    if not {"vx", "vy", "vz"} & set(columns):
        missing.append("vz")
    if missing:
        raise InputError.at(name, f"has no column {', '.join(missing)}: {COLUMNS}")
    # Types may be written as labels.
    labelled = not dict(zip(columns, row, strict=False)).get(TYPE, b"").isdigit()
    types = () if labelled else (TYPE,)
    optional = (*MOTION, *GRAINS, *types, CLOCK, *(() if unwrapped else IMAGES))
    return ["id", *positions, *(key for key in optional if key in columns)]


def _periodic(line: bytes) -> NDArray[np.bool_]:
    """Return whether the box repeats along x, y and z, from the line above its bounds."""
    # A tilted box has its tilts before these words.
    words = line.split()[-3:]
    return np.array([word == b"pp" for word in words])


def _box_sides(name: str, lines: Sequence[bytes]) -> Array:
    """Return the lengths of the box along x, y and z, (3,) m."""
    try:
        bounds = np.array([line.split() for line in lines[SIDES]], float)
    except ValueError:
        bounds = np.empty((0, 0))
    # The bounds of a tilted box differ from those at which positions are wrapped.
    if bounds.shape not in ((3, 2), (3, 3)) or bounds[:, 2:].any():
        raise InputError.at(
            name,
            "ITEM: BOX BOUNDS must have two numbers in each line, as for a rectangular box: run "
            "LAMMPS in such a box",
        )
    return np.asarray(bounds[:, 1] - bounds[:, 0])


def _sort(atoms: Array) -> Array:
    """Return the columns of a frame after the atom numbers, sorted by them, (C-1, N)."""
    numbers = atoms[:, 0]
    if not (np.abs(numbers) < MOST_ATOMS).all():
        raise ValueError("an atom has no valid number")
    order = np.argsort(numbers)
    if (np.diff(numbers[order]) <= 0).any():
        raise ValueError("two atoms have the same number")
    return atoms[order, 1:].T
