"""Displacements and velocities from LAMMPS dumps, of `lmpchain deck` or of a user's own deck."""

from __future__ import annotations

import gzip
import itertools
import sys
import zlib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from ..errors import InputError, short, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import check_readable
from .record import Cost, ErrorEstimate, Record

BEGIN = b"ITEM: TIMESTEP"
HEADER = 9  # lines above the atoms of a frame
AXES = ("x", "y", "z")
UNWRAPPED = ("xu", "yu", "zu")
COLUMNS = "dump custom ... id x y z vz v_phi, with dump_modify format float %.17g"


class DumpChecks(NamedTuple):
    """Limits within which a dump fits a scene.

    Attributes
    ----------
    start : float
        Largest difference of the first frame from the initial state, over the largest value in the
        dump.
    levels : int
        Least number of steps of the last digit of a height that the motion must span.
    """

    start: float = 1e-6
    levels: int = 100


CHECKS = DumpChecks()


class _Motion(NamedTuple):
    """Motion of the grains in their order from the top.

    Attributes
    ----------
    down : float
        1 if the axis of the column points down, -1 if up.
    order : (N,) array
        Columns of the dump in the order of the grains.
    displacement, velocity : (T, N) arrays
        m and m/s.
    """

    down: float
    order: np.ndarray
    displacement: Array
    velocity: Array


def is_dump(path: str | PathLike[str]) -> bool:
    """Return whether a file, possibly compressed by gzip, is a LAMMPS dump."""
    path = Path(path)
    try:
        # reading a pipe would block
        check_readable(path, sys.maxsize)
        with _open(path) as opened:
            return opened.read(len(BEGIN)) == BEGIN
    except (OSError, EOFError, ValueError, zlib.error):
        return False


def _open(path: Path) -> IO[bytes]:
    opener: Any = gzip.open if path.suffix == ".gz" else open
    return opener(path, "rb")


def read(
    path: str | PathLike[str],
    scene: Scene,
    equilibrium: Sequence[float] | Array | None = None,
    axis: str | None = None,
) -> Record:
    """Read a LAMMPS dump as the trajectory of a scene; see `lmpchain.Trajectory.from_dump`.

    Raises
    ------
    InputError
        If it cannot be read, or is not of this scene.
    """
    path = Path(path)
    name = str(path)
    if axis not in (None, *AXES):
        raise InputError.at(
            "axis", f"must be x, y or z, along which the column stands (got {shown(axis)})"
        )
    rest = None if equilibrium is None else _check_rest(equilibrium, scene.chain.grains)
    columns = _read_columns(path, scene.chain.grains)
    steps, data = _read_samples(path, columns, scene)
    heights = [data[key] for key in _position_columns(columns)]
    axis = axis or _find_axis(name, [height[0] for height in heights])
    if f"v{axis}" not in data:
        raise InputError.at(
            name, f"has no column v{axis}, though the column stands along {axis}: {COLUMNS}"
        )
    z = heights[AXES.index(axis)]
    vz = data[f"v{axis}"]
    v_phi = data.get("v_phi")
    # lmpchain deck writes v_phi, and its z points up
    directions = [-1.0] if v_phi is not None and axis == "z" else _directions(scene, z[0], rest)
    motion = _orient(name, scene, directions, (z, vz, v_phi), rest)
    mover = motion.order[int(np.abs(motion.velocity).sum(0).argmax())]
    if v_phi is None:
        _check_digits(name, z[:, mover])
        origin = f"heights less those {'at first' if rest is None else 'given'}"
    else:
        origin = "v_phi"
    numbers = (z if v_phi is None else v_phi)[:, mover]
    recorded = scene.recorded - 1
    total = int(steps[-1] - steps[0])
    return Record(
        scene=scene,
        engine="lammps",
        equation=1,
        time=scene.time,
        grains=scene.recorded,
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
            "precision": _describe_precision(numbers, vz[:, mover], motion),
        },
    )


def _position_columns(columns: Sequence[str]) -> tuple[str, ...]:
    return AXES if "z" in columns else UNWRAPPED


def _read_samples(path: Path, columns: list[str], scene: Scene) -> tuple[np.ndarray, dict]:
    """Return step numbers, (T,), and the columns of the motion, (T, N) each, by atom number."""
    name = str(path)
    motion = ("vx", "vy", "vz", "v_phi")
    names = [*_position_columns(columns), *(key for key in motion if key in columns)]
    samples = scene.samples
    steps, data = read_frames(path, columns, names, scene.chain.grains, most=2 * samples)
    if len(steps) != samples:
        cure = "set the samples of the scene so, or run LAMMPS to its end"
        raise InputError.at(
            name, f"has {len(steps)} whole frames, the scene {samples} samples: {cure}"
        )
    if not all(np.isfinite(values).all() for values in data.values()):
        raise InputError.at(
            name, "holds numbers that are not finite: the run broke down; use a shorter step"
        )
    intervals = np.diff(steps)
    if (intervals <= 0).any() or (intervals != intervals[0]).any():
        raise InputError.at(
            name, "its frames are not equally far apart: dump every so many steps, from the start"
        )
    return steps, data


def _orient(
    name: str,
    scene: Scene,
    directions: Sequence[float],
    columns: tuple[Array, Array, Array | None],
    rest: Array | None,
) -> _Motion:
    """Return the motion along the first of the directions that fits the start of the scene.

    The columns are z, vz and, where there is one, v_phi, (T, N) each by atom number.
    """
    z, vz, v_phi = columns
    faults = []
    for down in directions:
        # grains are numbered from the top, whatever the numbers of the atoms
        order = np.argsort(down * z[0], kind="stable")
        if v_phi is not None:
            displacement = v_phi[:, order]
        elif rest is not None:
            displacement = down * (z[:, order] - rest)
        else:
            displacement = down * (z[:, order] - z[0, order])
            # the first frame is not at rest if the scene begins with a displacement
            displacement += scene.initial()[0]
        motion = _Motion(down, order, displacement, down * vz[:, order])
        fault = _find_misfit(scene, motion, rounding=1e-15 * np.abs(z).max())
        if not fault:
            return motion
        faults.append(fault)
    raise InputError.at(name, f"{faults[0]}: give the scene that the dump was made for")


def _find_axis(name: str, first: Sequence[Array]) -> str:
    """Return the axis on which the grains of the first frame lie far apart."""
    spread = [float(np.ptp(positions)) for positions in first]
    longest = int(np.argmax(spread))
    # a column that leans has no axis
    if not spread[longest] > 2 * sorted(spread)[-2]:
        raise InputError.at(
            "axis",
            f"{name}: its grains stand along none of x, y and z: name the axis of the column",
        )
    return AXES[longest]


def _describe_precision(heights: Array, speeds: Array, motion: _Motion) -> str:
    """Return the precision of a dump in words, from numbers of the grain that moves most."""
    texts = []
    for quantity, unit, numbers, values in (
        ("displacement", "m", heights, motion.displacement),
        ("velocity", "m/s", speeds, motion.velocity),
    ):
        half = _last_digit(numbers) / 2
        largest = float(np.abs(values).max())
        share = half / (largest or np.inf)
        texts.append(f"{quantity} within {half:.2g} {unit}, {share:.1g} of the largest")
    return "; ".join(texts)


def _check_rest(equilibrium: Sequence[float] | Array, grains: int) -> Array:
    """Return the heights at rest as (N,) numbers; raises `InputError`."""
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
    """Return -1 (z points up) and 1 (down), the likelier first; `z` is the first frame, (N,) m.

    The overlaps say so, as they grow with the weight above: the gaps between centres, less what
    grains, overlaps and the start of the scene make of them, must be alike.
    """
    if rest is not None:
        return [1.0 if rest[-1] > rest[0] else -1.0]
    chain = scene.chain
    gaps = chain.contact_lengths[1:-1] - chain.equilibrium_overlap + np.diff(scene.initial()[0])
    return sorted((-1.0, 1.0), key=lambda down: float(np.ptp(np.diff(np.sort(down * z)) - gaps)))


def _find_misfit(scene: Scene, motion: _Motion, rounding: float) -> str:
    """Return how the first frame differs from the initial state of the scene, or nothing.

    The `rounding` is that of the heights, m.
    """
    u, v = scene.initial()
    for quantity, unit, values, start, slack in (
        ("velocity", "m/s", motion.velocity, v, 0.0),
        ("displacement", "m", motion.displacement, u, rounding),
    ):
        difference = np.abs(values[0] - start)
        if (difference > CHECKS.start * np.abs(values).max() + slack).any():
            n = int(difference.argmax())
            return (
                f"grain {n + 1} begins with a {quantity} of {values[0, n]:.6g} {unit}, in the "
                f"scene {start[n]:.6g}"
            )
    return ""


def _read_columns(path: Path, grains: int) -> list[str]:
    """Return the names of the columns, after checking that the dump fits the chain."""
    name = str(path)
    head, last = _read_ends(path)
    if not head[3].isdigit() or not head[8].startswith("ITEM: ATOMS"):
        fault = "is cut short, or has lines that a plain dump custom has not"
        raise InputError.at(name, f"{fault}, as of dump_modify units or time: write it anew")
    if last != b"\n":
        raise InputError.at(name, "is cut short within a line: run LAMMPS to its end")
    if int(head[3]) != grains:
        raise InputError.at(
            name, f"has {head[3]} atoms, the scene {grains} grains: give the scene it was made for"
        )
    columns = head[8].split()[2:]
    # periodic boxes wrap x, y and z; xu, yu and zu go on
    unwrapped = not set(AXES) <= set(columns) and set(UNWRAPPED) <= set(columns)
    if unwrapped:
        columns = [key for key in columns if key not in AXES]
    positions = UNWRAPPED if unwrapped else AXES
    missing = [key for key in ("id", *positions) if key not in columns]
    if not {"vx", "vy", "vz"} & set(columns):
        missing.append("vz")
    if missing:
        raise InputError.at(name, f"has no column {', '.join(missing)}: {COLUMNS}")
    return columns


def _read_ends(path: Path) -> tuple[list[str], bytes]:
    """Return the lines above the first atoms, and the last byte; raises `InputError`."""
    name = str(path)
    if not path.is_file():
        raise InputError.at(
            name,
            "is a folder; name the dump in it" if path.is_dir() else "there is no such file",
        )
    if not is_dump(path):
        raise InputError.at(
            name, "is no LAMMPS dump in text: write one with lmpchain deck, or by dump custom"
        )
    last = b""
    try:
        with _open(path) as opened:
            head = [opened.readline().decode(errors="replace").strip() for _ in range(HEADER)]
            for block in iter(lambda: opened.read(2**20), b""):
                last = block[-1:]
    except (OSError, EOFError, zlib.error) as error:
        raise InputError.at(name, f"cannot be read as a dump: {error}; write it anew") from None
    return head, last


def read_frames(
    path: Path, columns: list[str], names: list[str], grains: int, most: int
) -> tuple[np.ndarray, dict[str, Array]]:
    """Return step numbers, (T,), and columns by name, ordered by atom number, (T, N) each.

    A run that was stopped and started again writes frames twice, and one that was killed leaves
    half a frame: of each step, the frame that was written last is taken, and what is not whole is
    left out.
    """
    indices = [columns.index(key) for key in ("id", *names)]
    frames: dict[int, Array] = {}
    try:
        with _open(path) as opened:
            for body in _whole_frames(opened, grains):
                step = int(body[0])
                # a restarted run writes frames again: the last one counts
                frames.pop(step, None)
                atoms = np.loadtxt(body[HEADER - 1 :], usecols=indices, ndmin=2, comments=None)
                if len(atoms) != grains:
                    raise ValueError(f"an atom has no line at step {step}")
                frames[step] = _sort(atoms)
                if len(frames) > most:
                    raise ValueError(f"it has more than {most} frames")
    except (ValueError, OverflowError, OSError, EOFError, zlib.error) as error:
        raise InputError.at(
            str(path), f"cannot be read as a dump: {short(error)}; write it anew"
        ) from None
    steps = np.array(sorted(frames))
    rows = np.array([frames[step] for step in steps]).reshape(len(steps), len(names), grains)
    return steps, dict(zip(names, rows.transpose(1, 0, 2), strict=True))


def _whole_frames(opened: IO[bytes], grains: int) -> Iterator[list[bytes]]:
    """Yield the lines of each whole frame, without the first; frames cut short are left out."""
    lines: Iterator[bytes] = iter(opened)
    while line := next(lines, b""):
        # where a run was killed within a line, the next frame begins in the middle of it
        if BEGIN not in line:
            continue
        body = list(itertools.islice(lines, HEADER - 1 + grains))
        begins = next((number for number, line in enumerate(body) if BEGIN in line), len(body))
        if begins >= HEADER - 1 and body[2].strip().isdigit() and int(body[2]) != grains:
            step = short(body[0].decode(errors="replace").strip())
            raise ValueError(f"the number of atoms changes at step {step}")
        if begins < len(body):
            # another frame begins before this one ends: go on with that
            lines = itertools.chain(body[begins:], lines)
        elif len(body) == HEADER - 1 + grains:
            if not body[HEADER - 2].startswith(b"ITEM: ATOMS"):
                raise ValueError("its frames are not alike")
            yield body


def _sort(atoms: Array) -> Array:
    """Return the columns of a frame behind that of the atom numbers, in their order, (C-1, N)."""
    numbers = atoms[:, 0]
    order = np.argsort(numbers)
    if (np.diff(numbers[order]) <= 0).any():
        raise ValueError("two atoms have the same number")
    return atoms[order, 1:].T


def _last_digit(values: Array) -> float:
    """Return the step of the last digit with which the largest of some numbers was written."""
    largest = float(np.abs(values).max())
    numbers = values.tolist()
    for digits in range(1, 17):
        if largest and all(float(f"{number:.{digits - 1}e}") == number for number in numbers):
            return float(10.0 ** (np.floor(np.log10(largest)) - digits + 1))
    return float(np.spacing(largest))


def _check_digits(name: str, heights: Array) -> None:
    """Raise `InputError` if the digits of heights, (T,) m, are too few to resolve the motion."""
    motion = np.ptp(heights)
    digit = _last_digit(heights)
    if heights.any() and motion < CHECKS.levels * digit:
        digits = round(np.log10(np.abs(heights).max() / digit) + 0.5)
        cure = "write them with dump_modify format float %.17g, or dump v_phi"
        raise InputError.at(
            name,
            f"its heights have {digits} digits, too few for displacements of {motion:.1g} m: "
            f"{cure}, as lmpchain deck does",
        )
