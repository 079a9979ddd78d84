"""Data files of LAMMPS: sections Atoms, Velocities, Masses, Bonds and Bond Coeffs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ..errors import InputError, shown
from .lammps_state import RunAtom, RunBond, RunState
from .lammps_text import InputLine, Variables

HEADER_LINES = 40
TEXT = Variables()  # A data file has no variables.
# Columns of a row of Atoms between number, type and position, by atom style.
ATOM_COLUMNS = {
    "sphere": ("diameter", "density"),
    "bond": ("molecule",),
    "molecular": ("molecule",),
    "atomic": (),
}


def is_data(text: str) -> bool:
    """Return whether a text is a data file, which counts atoms in its header."""
    head = text[: 2**14].split("\n")[1:HEADER_LINES]
    return any(re.fullmatch(r"\s*\d+\s+atoms\s*", line.partition("#")[0]) for line in head)


def read_data(path: Path, text: str, styles: Sequence[str], state: RunState, placed: bool) -> None:
    """Read a data file into the state of a run.

    Parameters
    ----------
    path : Path
        Path of the data file, for messages.
    text : str
        Text of the data file.
    styles : list of str
        Atom styles of the input; empty without an input.
    state : RunState
        State to which the grains, masses and bonds of the file are added.
    placed : bool
        Whether a dump supplies the positions and velocities, which are then not read.

    Raises
    ------
    InputError
        If a section or a row cannot be read.
    """
    reader = _DataReader(state, styles, placed)
    readers: dict[str, Callable[[InputLine, list[str], str], None]] = {
        "Atoms": reader.atom,
        "Velocities": reader.velocity,
        "Masses": reader.mass,
        "Bonds": reader.bond,
        "Bond Coeffs": reader.coefficient,
    }
    for section, style, rows in _sections(path, text):
        if section not in readers:
            raise InputError.at(str(path), f"has a section {shown(section)}, which is not read")
        for line in rows:
            if words := TEXT.words(line):
                readers[section](line, words, style)


class _DataReader:
    """Readers of the rows of each section."""

    def __init__(self, state: RunState, styles: Sequence[str], placed: bool):
        self.state = state
        self.styles = styles
        self.placed = placed

    def atom(self, line: InputLine, words: list[str], style: str) -> None:
        """Read a row of Atoms."""
        atoms = self.state.atoms
        n, made = _read_atom(line, words, style, self.styles)
        if self.placed:
            if n in atoms:
                made.x = atoms[n].x
                atoms[n] = made
        elif n in atoms:
            raise line.refuse(f"defines grain {n} a second time")
        else:
            self.state.last_number = max(self.state.last_number, n)
            atoms[n] = made

    def velocity(self, line: InputLine, words: list[str], _: str) -> None:
        """Read a row of Velocities."""
        n, *values = (TEXT.number(word, line) for word in words)
        if len(values) not in (3, 6) or any(values[3:]):
            raise line.refuse("must have a number and three velocities, without a rotation")
        if self.placed:
            return
        if n not in self.state.atoms:
            raise line.refuse("names a grain that does not exist")
        self.state.atoms[int(n)].v = values[:3]

    def mass(self, line: InputLine, words: list[str], _: str) -> None:
        """Read a row of Masses."""
        kind = TEXT.whole(words[0], line)
        self.state.type_masses[kind] = TEXT.number(TEXT.word(line, words, 1), line)

    def bond(self, line: InputLine, words: list[str], _: str) -> None:
        """Read a row of Bonds."""
        if len(words) != 4:
            raise line.refuse("must have a number, a type and two atoms")
        self.state.bonds.append(RunBond(*(TEXT.whole(word, line) for word in words[1:])))

    def coefficient(self, line: InputLine, words: list[str], _: str) -> None:
        """Read a row of Bond Coeffs."""
        self.state.bond_coefficients[TEXT.whole(words[0], line)] = (line, words[1:])


def _read_atom(
    line: InputLine, words: list[str], style: str, styles: Sequence[str]
) -> tuple[int, RunAtom]:
    """Return the number and grain of a row of Atoms."""
    if style == "hybrid" and not styles:
        raise line.refuse("has a hybrid atom style: name the input that reads this file")
    known = (styles or ["sphere"]) if style in ("", "hybrid") else [style]
    if set(known) - ATOM_COLUMNS.keys():
        raise line.refuse(f"has the atom style {shown(style)}: use sphere or bond")
    own = [column for each in known for column in ATOM_COLUMNS[each]]
    if len(known) > 1:
        # In a hybrid style the position comes first.
        order = ["number", "kind", "x", "y", "z", *own]
    elif known == ["sphere"]:
        order = ["number", "kind", *own, "x", "y", "z"]
    else:
        order = ["number", *own, "kind", "x", "y", "z"]
    values = [TEXT.number(word, line) for word in words]
    if len(values) not in (len(order), len(order) + 3):
        raise line.refuse(f"must have {', '.join(order)}, and three image flags or none")
    if any(values[len(order) :]):
        raise line.refuse("has image flags: write unwrapped positions")
    row = dict(zip(order, values, strict=False))
    d = row.get("diameter", 0.0)
    mass = math.pi / 6 * d**3 * row["density"] if d else math.nan
    place = [row[axis] for axis in "xyz"]
    return int(row["number"]), RunAtom(int(row["kind"]), place, diameter=d, mass=mass)


def _sections(path: Path, text: str) -> Iterator[tuple[str, str, list[InputLine]]]:
    """Yield the name, atom style and rows of every section of a data file."""
    title = style = ""
    rows: list[InputLine] = []
    for count, raw in enumerate(text.split("\n")[1:], 2):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        if line[0].isalpha():
            if title:
                yield title, style, rows
            title, rows = line, []
            style = raw.partition("#")[2].strip()
        elif title:
            rows.append(InputLine(str(path), count, line))
    if not title:
        raise InputError.at(str(path), "has no section Atoms")
    yield title, style, rows
