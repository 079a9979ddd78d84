"""Grains of a LAMMPS run from its data files, with the gravity and load that they imply."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, shown
from ..util.arrays import Array
from .lammps_text import InputLine, Variables


@dataclass
class RunGrains:
    """Grains of a run at the start of its scene, in SI units, by atom number.

    Attributes
    ----------
    source : str
        Name of the file, or of the object, from which the grains were read.
    numbers : (N,) int array
        Atom numbers.
    types : (N,) int array
        Atom types.
    positions : (N, 3) array
        Positions, m.
    velocities : (N, 3) array
        Velocities, m/s.
    diameters : (N,) array
        Diameters, m; NaN if unknown.
    masses : (N,) array
        Masses, kg; NaN if unknown.
    slack : float
        Rounding error of a distance between two grains, m.
    digits_lost : bool
        Whether positions have fewer digits than double precision.
    held : (N,) bool array or None
        Mask of the grains that do not move; None if unknown.
    acting : set of str, or None
        Styles of the fixes that act; None if unknown.
    period : (3,) array
        Lengths of the box along x, y and z in its periodic directions, m; infinite in the others.
    duration : float
        Duration of the run, s; NaN if unknown.
    likely_step : float
        Time step at which the displacements between frames agree with the velocities, s; 0 if
        unknown.
    samples : int
        Number of frames of the run; 0 if unknown.
    steps : (first, last) or None
        Numbers of the steps of the first and the last frame of a dump.
    """

    source: str
    numbers: np.ndarray
    types: np.ndarray
    positions: Array
    velocities: Array
    diameters: Array
    masses: Array
    slack: float
    digits_lost: bool = False
    held: np.ndarray | None = None
    acting: frozenset[str] | None = None
    period: Array = field(default_factory=lambda: np.full(3, math.inf))
    duration: float = math.nan
    likely_step: float = 0.0
    samples: int = 0
    steps: tuple[int, int] | None = None


@dataclass
class RunAtom:
    """A grain during the parsing of commands, in the units of the input.

    Attributes
    ----------
    kind : int
        Type of the atom.
    x : list of three numbers
        Position.
    v : list of three numbers
        Velocity.
    diameter : float
        Diameter; 0 for a point particle.
    mass : float
        Mass; NaN for a point particle, which has the mass of its type.
    """

    kind: int
    x: list[float]
    v: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    diameter: float = 0.0
    mass: float = math.nan


class RunFix(NamedTuple):
    """A fix with the name of its group."""

    line: InputLine
    style: str
    words: list[str]
    group: str


class RunBond(NamedTuple):
    """A bond between two atoms, with its type."""

    kind: int
    first: int
    second: int


class RunPair(NamedTuple):
    """A pair_coeff command for two ranges of types."""

    line: InputLine
    first: range
    second: range
    words: list[str]


@dataclass
class RunState:
    """Forces, groups and grains at one time of the input; unknown groups are None."""

    atoms: dict[int, RunAtom] = field(default_factory=dict)
    groups: dict[str, frozenset[int] | None] = field(default_factory=dict)
    last_number: int = 0
    type_masses: dict[int, float] = field(default_factory=dict)
    fixes: dict[str, RunFix] = field(default_factory=dict)
    pair: tuple[InputLine, list[str]] | None = None
    pair_coefficients: list[RunPair] = field(default_factory=list)
    bond: tuple[InputLine, list[str]] | None = None
    bond_coefficients: dict[int, tuple[InputLine, list[str]]] = field(default_factory=dict)
    bonds: list[RunBond] = field(default_factory=list)
    step: float | None = None


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


CERTAIN = 3.0  # Number of standard errors above which a value is certain.
GRAVITIES = (9.81, 9.80665, 9.8)  # Usual values of gravity in inputs, m/s2.
NEAR = 1e-5  # Relative difference from a usual gravity, caused by residual motion.
# Forces over the largest one below which gravity and load are taken to be 0.
LEAST_WEIGHT = 1e-7
LEAST_LOAD = 1e-9
HARDEST = 1e30  # Stiffness limit, N.
BISECTIONS = 2000


class Line(NamedTuple):
    """A straight line through points, with the standard error of its slope."""

    slope: float
    error: float


def fit_line(x: Array, y: Array, errors: Array) -> Line:
    """Return the line with the best fit to at least two points with these errors."""
    share = (errors.min() / errors) ** 2
    mean_x = float((share * x).sum() / share.sum())
    mean_y = float((share * y).sum() / share.sum())
    spread = float((share * (x - mean_x) ** 2).sum())
    if not spread > 0:
        return Line(0.0, math.inf)
    slope = float((share * (x - mean_x) * (y - mean_y)).sum()) / spread
    rest = y - mean_y - slope * (x - mean_x)
    scatter = float((share * rest**2).sum()) / max(1, x.size - 2)
    return Line(slope, math.sqrt(max(scatter, float(errors.min()) ** 2) / spread))


def gravity_of(line: Line, weights: Array, forces: Array) -> float:
    """Return gravity from the increase of forces with the mass above, m/s2; 0 if uncertain.

    A usual value such as 9.81 is returned if it differs by less than the error.
    """
    size = abs(line.slope)
    share = size * float(weights.max() - weights.min()) / max(float(forces.max()), 1e-300)
    if size <= CERTAIN * line.error or share < LEAST_WEIGHT:
        return 0.0
    usual = (g for g in GRAVITIES if abs(size - g) <= CERTAIN * line.error + NEAR * g)
    return next(usual, size)


def mean_load(rest: Array, errors: Array, largest: float) -> float:
    """Return the mean of forces minus weights, N; 0 if it is uncertain or negligible."""
    share = 1 / errors**2
    load = float((share * rest).sum() / share.sum())
    spread = float((share * (rest - load) ** 2).sum()) / max(1, rest.size - 1)
    error = math.sqrt(max(1.0, spread) / float(share.sum()))
    return 0.0 if abs(load) <= max(CERTAIN * error, LEAST_LOAD * largest) else load


def load_between(excess: Callable[[float], float]) -> float:
    """Return the load at which an increasing excess of overlaps is 0; infinite without a root.

    The excess must be below 0 at zero load.
    """
    low, high = 0.0, 1.0
    while excess(high) < 0:
        high *= 4
        if high > HARDEST:
            return math.inf
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return high
