"""Grains and forces of a LAMMPS run, read from its files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..util.arrays import Array
from .lammps_text import InputLine


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
    """A fix with the numbers of the atoms of its group."""

    line: InputLine
    style: str
    words: list[str]
    members: frozenset[int]


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
    """Forces and grains at one time of the input."""

    atoms: dict[int, RunAtom] = field(default_factory=dict)
    last_number: int = 0
    type_masses: dict[int, float] = field(default_factory=dict)
    fixes: dict[str, RunFix] = field(default_factory=dict)
    pair: tuple[InputLine, list[str]] | None = None
    pair_coefficients: list[RunPair] = field(default_factory=list)
    bond: tuple[InputLine, list[str]] | None = None
    bond_coefficients: dict[int, tuple[InputLine, list[str]]] = field(default_factory=dict)
    bonds: list[RunBond] = field(default_factory=list)
    step: float | None = None
