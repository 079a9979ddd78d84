"""LAMMPS input from the templates: what the library runs, and decks that run by themselves."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files import write_aside
from ...rendering import render
from ..splittings import Splitting
from . import drive
from .column import Column
from .rank import deck_steps


def setup(column: Column, data: str, step: float, splitting: Splitting, done: int = 0) -> str:
    """Return the commands that make the column from a data file, ready for `run`, after `done` steps of before."""
    return render("setup.column", data=f'"{data}"', **_shared(column, step, splitting, done))


def write_deck(column: Column, folder: Path, step: float, splitting: Splitting, every: int, samples: int) -> Path:
    """Write `in.column`, which runs by itself: `every` steps between two of `samples` + 1 samples."""
    if splitting.order > 2 and column.scene.drive:
        raise InputError([("integrator", "a deck can carry a drive with verlet only; use that")])
    text = render(
        "in.column",
        **_shared(column, step, splitting),
        every=every,
        samples=samples,
        integrator=splitting.name,
        stride=f"$(v_every*{len(splitting.substeps)})" if splitting.substeps else "${every}",
        substeps=splitting.substeps,
    )
    path = folder / "in.column"
    with write_aside(path) as aside:
        aside.write_text(text, encoding="ascii")
    return path


def dump(path: str, every: int) -> str:
    """Return the commands that dump every `every`-th step, as in a deck that runs by itself."""
    return render("dump.column", path=f'"{path}"', every=every)


def carries(splitting: Splitting) -> bool:
    """Say whether a deck can carry this splitting: its kicks must be LAMMPS's own."""
    return splitting.order == 2 or bool(splitting.substeps)


def check_carried(splitting: Splitting, key: str) -> None:
    """Raise `InputError` under this key if a deck cannot carry the splitting."""
    if not carries(splitting):
        raise InputError([(key, f"a deck cannot carry the kicks of {splitting.name}; use verlet or kahan-li6")])


def write_data(column: Column, path: str | PathLike[str]) -> None:
    """Write the data file of a column."""
    z, speeds = column.start
    if column.strike:  # the deck strikes, so that the speed can be set on the command line
        speeds = 0.0 * speeds
    rows = zip(column.types, column.diameters.tolist(), column.densities.tolist(), z.tolist(), strict=True)
    text = render("column.data", column=column, rows=rows, speeds=speeds.tolist(), heights=column.heights.tolist())
    with write_aside(path) as aside:
        aside.write_text(text, encoding="ascii")


def _shared(column: Column, step: float, splitting: Splitting, done: int = 0) -> dict[str, Any]:
    """Return what both templates need to know."""
    scene = column.scene
    return {
        "column": column,
        "step": step,
        # velocity Verlet and its compositions kick in LAMMPS; for others the kicks come from outside
        "fix": "nve" if carries(splitting) else "nve/noforce",
        "first_step": done * deck_steps(splitting),
        "drive": scene.drive,
        "moves": splitting.order == 2,  # fix move wants steps of one length; else the speeds come from outside
        "formulas": drive.formulas(scene.drive) if scene.drive else (),
        "pieces": drive.pieces(scene.drive, scene.duration),
    }
