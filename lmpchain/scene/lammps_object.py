"""The grains of a LAMMPS instance that runs in this process."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, shown
from ..util.units import read_units
from .lammps_input import OBSERVERS
from .lammps_state import RunGrains

ARGUMENT = "lmp"
FIX = re.compile(r"Fix\[.*?\]:\s*(\S+),\s*style = (\S+),\s*group = (\S+)")
SUFFIX = re.compile(r"/(omp|kk|opt|gpu|intel)$")  # Accelerated variants of a style.
MOVING = ("nve", "nve/sphere")
# Pair styles of Hertz's law; granular may have another law, which only an input shows.
HERTZIAN = ("granular", "gran/hertz/history")
# Fixes of a column whose effect is visible in its overlaps.
UNDERSTOOD = (*MOVING, "freeze", "gravity", "enforce2d", "DUMMY", *OBSERVERS)


class _NamedFix(NamedTuple):
    """A fix of an instance, with its style and its group."""

    style: str
    group: str


def grains_of(
    lmp: Any, units: str | Sequence[float] | None = None, read: bool = False
) -> RunGrains:
    """Return the current grains of an instance.

    Parameters
    ----------
    lmp : lammps.lammps
        The instance, which must run on one rank.
    units : str or (length, time, mass), optional
        Unit style of LAMMPS, or its units in m, s and kg, as in `Trajectory.from_dump`.
    read : bool
        Whether an input file is given, from which the effect of the fixes is read.

    Raises
    ------
    InputError
        If the instance has no grains or several ranks, or forces whose effect only an input file
        can show.
    """
    if not hasattr(lmp, "extract_atom") or not hasattr(lmp, "numpy"):
        raise InputError.at(ARGUMENT, f"must be a lammps.lammps object (got {shown(lmp)})")
    said = lmp.extract_global("units") or ""
    scale = read_units(units, said)
    count = int(lmp.get_natoms())
    if count != lmp.extract_global("nlocal"):
        raise InputError.at(
            ARGUMENT, "has its grains on several ranks: use an instance of one rank"
        )
    if not count:
        raise InputError.at(ARGUMENT, "has no grains: create them first")

    def column(name: str) -> Any:
        values = lmp.numpy.extract_atom(name)
        return None if values is None else np.array(values[:count], dtype=float)

    fixes = list(_fixes(lmp))
    if not read:
        _check_forces(lmp, fixes)
    numbers = column("id")
    order = np.argsort(numbers)
    positions = scale.length * column("x")[order]
    radii, masses = column("radius"), column("rmass")
    unknown = np.full(count, math.nan)
    low, high, *_, periodic, _ = lmp.extract_box()
    sides = scale.length * (np.array(high) - np.array(low))
    return RunGrains(
        source=ARGUMENT,
        numbers=numbers[order].astype(int),
        types=column("type")[order].astype(int),
        positions=positions,
        velocities=scale.velocity * column("v")[order],
        diameters=unknown if radii is None else 2 * scale.length * radii[order],
        masses=unknown if masses is None else scale.mass * masses[order],
        slack=4 * float(np.spacing(np.abs(positions).max())),
        held=None if read else _held(lmp, fixes, column("mask")[order].astype(int)),
        acting=frozenset(fix.style for fix in fixes),
        period=np.where(np.array(periodic, dtype=bool), sides, math.inf),
    )


def _check_forces(lmp: Any, fixes: Sequence[_NamedFix]) -> None:
    """Raise `InputError` for forces and fixes whose effect is not accessible from LAMMPS."""
    strange = [f"fix {fix.style}" for fix in fixes if fix.style not in UNDERSTOOD]
    for kind, known in (("pair_style", HERTZIAN), ("bond_style", ())):
        style = lmp.extract_global(kind)
        if style and style not in (*known, "none", "zero"):
            strange.append(f"{kind} {style}")
    if strange:
        raise InputError.at(
            ARGUMENT,
            f"has {', '.join(strange)}, whose effect cannot be read from LAMMPS: name the input "
            "file, input=...",
        )


def _held(lmp: Any, fixes: Sequence[_NamedFix], masks: np.ndarray) -> np.ndarray:
    """Return a mask of grains that no fix moves, (N,) bool."""
    groups = lmp.available_ids("group")
    moving = np.zeros(len(masks), dtype=bool)
    frozen = moving.copy()
    for fix in fixes:
        among = (masks & (1 << groups.index(fix.group))) != 0
        if fix.style in MOVING:
            moving |= among
        elif fix.style == "freeze":
            frozen |= among
    # Frozen grains have no force, in whatever order the fixes were defined.
    moving &= ~frozen
    if not moving.any():
        raise InputError.at(ARGUMENT, "has no fix nve or nve/sphere: nothing moves")
    return ~moving


def _fixes(lmp: Any) -> Iterator[_NamedFix]:
    """Yield the fixes of an instance, which LAMMPS lists only in a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fixes"
        lmp.command(f"info fixes out overwrite {path}")
        for _, style, group in FIX.findall(path.read_text(encoding="utf-8")):
            yield _NamedFix(SUFFIX.sub("", style), group)
