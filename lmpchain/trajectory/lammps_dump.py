"""Displacements and velocities from LAMMPS dumps, of `lmpchain deck` or of a user's own deck."""

from __future__ import annotations

import gzip
import sys
import zlib
from collections.abc import Iterator, Sequence
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError, short, shown
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import check_readable
from .record import Cost, ErrorEstimate, Record

BEGIN = b"ITEM: TIMESTEP"
HEADER = 9  # lines above the atoms of a frame
# largest difference of the first frame from the initial state, over the largest value in the dump
SAME = 1e-6
FEWEST_LEVELS = 100  # of height that a displacement must span
BLOCK = 1 << 20  # bytes
AXES = ("x", "y", "z")
COLUMNS = "dump custom ... id x y z vz v_phi, with dump_modify format float %.17g"


def is_dump(path: str | PathLike[str]) -> bool:
    """Say whether a file, possibly compressed by gzip, is a LAMMPS dump."""
    path = Path(path)
    try:
        check_readable(path, sys.maxsize)  # reading a pipe would block
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
    chain = scene.chain
    rest = None if equilibrium is None else _checked(equilibrium, chain.grains)
    if axis not in (None, *AXES):
        raise InputError.at(
            "axis", f"must be x, y or z, along which the column stands (got {shown(axis)})"
        )
    columns = _columns(path, scene)
    heights = [key for key in AXES if key in columns] or [f"{key}u" for key in AXES]
    given = [
        *heights,
        *(f"v{key}" for key in AXES if f"v{key}" in columns),
        *(["v_phi"] if "v_phi" in columns else []),
    ]
    steps, data = read_frames(path, columns, given, chain.grains, most=2 * scene.samples)
    if len(steps) != scene.samples:
        cure = "set the samples of the scene so, or run LAMMPS to its end"
        raise InputError.at(
            name, f"has {len(steps)} whole frames, the scene {scene.samples} samples: {cure}"
        )
    if not all(np.isfinite(values).all() for values in data.values()):
        raise InputError.at(
            name, "holds numbers that are not finite: the run broke down; use a shorter step"
        )
    axis = axis or _axis(name, [data[key][0] for key in heights])
    if f"v{axis}" not in data:
        raise InputError.at(
            name, f"has no column v{axis}, though the column stands along {axis}: {COLUMNS}"
        )
    apart = np.diff(steps)
    if (apart <= 0).any() or (apart != apart[0]).any():
        raise InputError.at(
            name, "its frames are not equally far apart: dump every so many steps, from the start"
        )
    z = data[heights[AXES.index(axis)]]
    vz = data[f"v{axis}"]
    origin = "heights less those at first" if rest is None else "heights less those given"
    misfits = []
    for down in [-1.0] if "v_phi" in data and axis == "z" else _ways_down(scene, z[0], rest):
        order = np.argsort(down * z[0], kind="stable")
        velocity = down * vz[:, order]
        if "v_phi" in data:
            displacement = data["v_phi"][:, order]
            origin = "v_phi"
        else:
            displacement = down * (z[:, order] - (z[0, order] if rest is None else rest))
            if rest is None:
                displacement += scene.initial()[0]
        misfits.append(_misfit(scene, displacement, velocity, 1e-15 * np.abs(z).max()))
        if not misfits[-1]:
            break
    else:
        raise InputError.at(name, f"{misfits[0]}: give the scene that the dump was made for")
    mover = order[int(np.abs(velocity).sum(0).argmax())]
    told = data["v_phi"] if origin == "v_phi" else z
    if origin != "v_phi":
        _check_digits(name, z[:, mover])
    chosen = scene.recorded - 1
    total = int(steps[-1] - steps[0])
    return Record(
        scene=scene,
        engine="lammps",
        equation=1,
        time=scene.time,
        grains=scene.recorded,
        displacement=displacement[:, chosen].copy(),
        velocity=velocity[:, chosen].copy(),
        error_estimate=ErrorEstimate(0.0, float("inf")),
        cost=Cost(0.0, 0.0, 0.0, total, total, chain.grains, "unknown", scene.duration / total, 1),
        provenance={
            "dump": name,
            "displacement": origin,
            "column": f"along {axis}, {axis} points {'up' if down < 0 else 'down'}",
            "precision": _precision(told[:, mover], vz[:, mover], displacement, velocity),
        },
    )


def _axis(name: str, first: Sequence[Array]) -> str:
    """Return the axis along which the column stands: on which the grains of the first frame lie apart."""
    spread = [float(np.ptp(along)) for along in first]
    longest = int(np.argmax(spread))
    if not spread[longest] > 2 * sorted(spread)[-2]:
        raise InputError.at(
            "axis",
            f"{name}: its grains stand along none of x, y and z: name the axis of the column",
        )
    return AXES[longest]


def _precision(told: Array, speeds: Array, displacement: Array, velocity: Array) -> str:
    """Say what the digits of the dump leave unknown, from the numbers of the grain that moves most."""
    parts = []
    for what, unit, values, motion in (
        ("displacement", "m", told, displacement),
        ("velocity", "m/s", speeds, velocity),
    ):
        within = _last_digit(values) / 2
        largest = float(np.abs(motion).max())
        parts.append(
            f"{what} within {within:.2g} {unit}, {within / (largest or np.inf):.1g} of the largest"
        )
    return "; ".join(parts)


def _checked(equilibrium: Sequence[float] | Array, grains: int) -> Array:
    """Return the heights at rest as (N,) numbers."""
    try:
        rest = np.asarray(equilibrium, dtype=float)
    except (TypeError, ValueError):
        rest = np.empty(0)
    if rest.shape != (grains,) or not np.isfinite(rest).all():
        raise InputError.at(
            "equilibrium", f"must be the heights at rest of the {grains} grains, m, from the top"
        )
    return rest


def _ways_down(scene: Scene, z: Array, rest: Array | None) -> list[float]:
    """Return whether z points up (-1) or down (1), the likelier first; `z` is the first frame, (N,) m.

    The overlaps say so, as they grow with the weight above: the gaps between centres, less what
    grains, overlaps and the start of the scene make of them, must be alike.
    """
    if rest is not None:
        return [1.0 if rest[-1] > rest[0] else -1.0]
    chain = scene.chain
    known = chain.contact_lengths[1:-1] - chain.equilibrium_overlap + np.diff(scene.initial()[0])
    return sorted((-1.0, 1.0), key=lambda down: float(np.ptp(np.diff(np.sort(down * z)) - known)))


def _misfit(scene: Scene, displacement: Array, velocity: Array, rounding: float) -> str:
    """Return how the first frame differs from the initial state of the scene, or nothing.

    The `rounding` is that of the heights, m.
    """
    u, v = scene.initial()
    for what, unit, values, start, slack in (
        ("velocity", "m/s", velocity, v, 0.0),
        ("displacement", "m", displacement, u, rounding),
    ):
        off = np.abs(values[0] - start)
        if (off > SAME * np.abs(values).max() + slack).any():
            n = int(off.argmax())
            return (
                f"grain {n + 1} begins with a {what} of {values[0, n]:.6g} {unit}, in the scene "
                f"{start[n]:.6g}"
            )
    return ""


def _columns(path: Path, scene: Scene) -> list[str]:
    """Return the names of the columns, after checking that the dump fits the chain."""
    name = str(path)
    grains = scene.chain.grains
    if not path.is_file():
        raise InputError.at(
            name, ("is a folder; name the dump in it" if path.is_dir() else "there is no such file")
        )
    if not is_dump(path):
        raise InputError.at(
            name, "is no LAMMPS dump in text: write one with lmpchain deck, or by dump custom"
        )
    try:
        with _open(path) as opened:
            head = [opened.readline().decode(errors="replace").strip() for _ in range(HEADER)]
            last = b""
            for block in iter(lambda: opened.read(BLOCK), b""):
                last = block[-1:]
    except (OSError, EOFError, zlib.error) as error:
        raise InputError.at(name, f"cannot be read as a dump: {error}; write it anew") from None
    if not head[3].isdigit() or not head[8].startswith("ITEM: ATOMS"):
        what = (
            "is cut short, or has lines that a plain dump custom has not, as of dump_modify "
            "units or time"
        )
        raise InputError.at(name, f"{what}: write it anew")
    if last != b"\n":
        raise InputError.at(name, "is cut short within a line: run LAMMPS to its end")
    if int(head[3]) != grains:
        raise InputError.at(
            name, f"has {head[3]} atoms, the scene {grains} grains: give the scene it was made for"
        )
    columns = head[8].split()[2:]
    unwrapped = not set(AXES) <= set(columns) and {"xu", "yu", "zu"} <= set(columns)
    wanted = ("id", "xu", "yu", "zu") if unwrapped else ("id", *AXES)
    missing = [key for key in wanted if key not in columns]
    if not {"vx", "vy", "vz"} & set(columns):
        missing.append("vz")
    if missing:
        raise InputError.at(name, f"has no column {', '.join(missing)}: {COLUMNS}")
    return [key for key in columns if key not in AXES] if unwrapped else columns


def read_frames(
    path: Path, columns: list[str], wanted: list[str], grains: int, most: int
) -> tuple[np.ndarray, dict[str, Array]]:
    """Return step numbers, (T,), and these columns ordered by atom number, (T, N) each.

    A run that was stopped and started again writes frames twice, and one that was killed leaves
    half a frame: of each step, the frame that was written last is taken, and what is not whole is
    left out.
    """
    places = [columns.index(key) for key in ("id", *wanted)]
    frames: dict[int, Array] = {}
    try:
        with _open(path) as opened:
            for body in _whole_frames(opened, grains):
                frames.pop(int(body[0]), None)
                atoms = np.loadtxt(body[HEADER - 1 :], usecols=places, ndmin=2, comments=None)
                if len(atoms) != grains:
                    raise ValueError(f"an atom has no line at step {int(body[0])}")
                frames[int(body[0])] = _sorted(atoms)
                if len(frames) > most:
                    raise ValueError(f"it has more than {most} frames")
    except (ValueError, OverflowError, OSError, EOFError, zlib.error) as error:
        raise InputError.at(
            str(path), f"cannot be read as a dump: {short(error)}; write it anew"
        ) from None
    steps = np.array(sorted(frames))
    rows = np.array([frames[step] for step in steps]).reshape(len(steps), len(wanted), grains)
    return steps, dict(zip(wanted, rows.transpose(1, 0, 2), strict=True))


def _whole_frames(opened: IO[bytes], grains: int) -> Iterator[list[bytes]]:
    """Yield the lines of every whole frame, without the first; of one that was cut short, nothing."""
    while line := opened.readline():
        if BEGIN not in line:
            continue
        body = list(islice(opened, HEADER - 1 + grains))
        headed = len(body) >= HEADER - 1 and not any(BEGIN in at for at in body[: HEADER - 1])
        if headed and body[2].strip().isdigit() and int(body[2]) != grains:
            raise ValueError(
                "the number of atoms changes at step "
                f"{short(body[0].decode(errors='replace').strip())}"
            )
        if again := next((number for number, at in enumerate(body, 1) if BEGIN in at), 0):
            next_one = body[again - 1][body[again - 1].index(BEGIN) :]
            opened.seek(opened.tell() - len(next_one) - sum(map(len, body[again:])))
        elif len(body) == HEADER - 1 + grains:
            if not body[HEADER - 2].startswith(b"ITEM: ATOMS"):
                raise ValueError("its frames are not alike")
            yield body


def _sorted(atoms: Array) -> Array:
    """Return the columns of a frame, behind that of the numbers, in their order; (N, C) to (C-1, N)."""
    numbers = atoms[:, 0]
    order = np.argsort(numbers)
    if (np.diff(numbers[order]) <= 0).any():
        raise ValueError("two atoms have the same number")
    return atoms[order, 1:].T


def _last_digit(values: Array) -> float:
    """Return how large a step of the last digit is with which the largest of some numbers was written."""
    largest = float(np.abs(values).max())
    digits = next(
        (d for d in range(1, 17) if all(float(f"{z:.{d - 1}e}") == z for z in values.tolist())), 0
    )
    return float(
        10.0 ** (np.floor(np.log10(largest)) - digits + 1)
        if digits and largest
        else np.spacing(largest)
    )


def _check_digits(name: str, heights: Array) -> None:
    """Raise `InputError` if the dump has too few digits to resolve the motion, heights (T,) m."""
    moved = np.ptp(heights)
    digit = _last_digit(heights)
    if heights.any() and moved < FEWEST_LEVELS * digit:
        digits = round(np.log10(np.abs(heights).max() / digit) + 0.5)
        cure = (
            "write them with dump_modify format float %.17g, or dump v_phi, as lmpchain deck does"
        )
        raise InputError.at(
            name,
            f"its heights have {digits} digits, too few for displacements of {moved:.1g} m: {cure}",
        )
