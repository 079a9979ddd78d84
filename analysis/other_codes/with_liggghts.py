"""LIGGGHTS, a discrete element code: velocity Verlet, Hertz contacts without dissipation."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import partial

import dem
from problem import Code, Problem

LIGGGHTS = shutil.which("liggghts")
if not LIGGGHTS:
    raise ImportError("there is no program liggghts here", name="liggghts")
DECK = """
units si
atom_style granular
boundary f f f
newton off
communicate single vel yes
hard_particles yes
neigh_modify delay 0
read_data column.data
fix one all property/global youngsModulus peratomtype {modulus!r}
fix two all property/global poissonsRatio peratomtype {ratio!r}
fix three all property/global coefficientRestitution peratomtypepair 1 1.0
pair_style gran model hertz tangential off
pair_coeff * *
group mobile id 1:{{mobile}}
fix motion mobile nve/sphere
fix weight mobile gravity {{gravity:.17g}} vector 0 0 -1
thermo 1000000
timestep {{step:.17g}}
run {{steps}}
write_dump all custom end id z vz modify sort id format "%d %.17g %.17g"
"""


def deck(problem: Problem) -> str:
    """Return a deck for `dem.solve`."""
    glass = problem.scene.chain.material
    return DECK.format(modulus=glass.youngs_modulus, ratio=glass.poissons_ratio)


def codes(problem: Problem) -> list[Code]:
    """Return LIGGGHTS."""
    about = subprocess.run([LIGGGHTS, "-h", "-log", "none"], capture_output=True, text=True).stdout
    version = re.search(r"Version LIGGGHTS-PUBLIC ([\d.]+)", about)
    solve = partial(dem.solve, [LIGGGHTS], deck(problem))
    return [Code("LIGGGHTS hertz", version[1] if version else "unknown", dem.steps(problem), solve)]
