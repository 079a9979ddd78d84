"""LAMMPS with default settings: `pair_style granular`, velocity Verlet, the program `lmp`."""

from __future__ import annotations

import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path

import dem
from problem import Code, Problem

LMP = str(Path(sys.executable).with_name("lmp"))
DECK = """
units si
atom_style sphere
boundary f f f
newton {newton}
comm_modify vel yes
{settings}
read_data column.data
{pair}
group mobile id 1:{{mobile}}
fix motion mobile {motion}
fix weight mobile gravity {{gravity:.17g}} vector 0 0 -1
thermo 1000000
timestep {{step:.17g}}
run {{steps}}
write_dump all custom end id z vz modify sort id format float %.17g
"""


def granular(problem: Problem) -> str:
    """Return the commands for Hertz contacts of one material, without damping and friction."""
    glass = problem.scene.chain.material
    contact = f"hertz/material {glass.youngs_modulus!r} 0.0 {glass.poissons_ratio!r}"
    return (
        f"pair_style granular\npair_coeff * * {contact} tangential linear_nohistory 0.0 0.0 "
        "damping velocity"
    )


def deck(pair: str, settings: str = "", newton: str = "off", motion: str = "nve/sphere") -> str:
    """Return a deck for `dem.solve`, by default with default settings."""
    return DECK.format(pair=pair, settings=settings, newton=newton, motion=motion)


def codes(problem: Problem) -> list[Code]:
    """Return LAMMPS with default settings."""
    solve = partial(dem.solve, [LMP], deck(granular(problem)))
    return [Code("LAMMPS granular", version("lammps"), dem.steps(problem), solve)]
