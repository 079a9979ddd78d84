"""Extended XYZ, a text format of trajectories for OVITO, ASE and other programs."""

from __future__ import annotations

from os import PathLike

import numpy as np

from ..util.files import write_aside
from .record import Record

# OVITO reads velocities from velo, and ASE from momenta and masses.
PROPERTIES = (
    "species:S:1:pos:R:3:velo:R:3:id:I:1:radius:R:1:masses:R:1:displacement:R:1:momenta:R:3"
)


def write_extxyz(record: Record, path: str | PathLike[str], overwrite: bool = False) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.to_extxyz`."""
    chain = record.scene.chain
    grains = record.grains
    rest = -chain.depths[grains - 1]
    radii = chain.diameters[grains - 1] / 2
    # Viewers need a box: a column with a grain of room around it.
    side = 2 * float(radii.max())
    low = float(rest.min()) - side
    high = float(rest.max()) + side
    box = (
        f'Lattice="{2 * side} 0 0 0 {2 * side} 0 0 0 {high - low}" Origin="{-side} {-side} {low}" '
        f'pbc="F F F" Properties={PROPERTIES}'
    )
    masses = chain.masses[grains - 1]
    named = list(zip(grains.tolist(), radii.tolist(), masses.tolist(), strict=True))
    with write_aside(path, overwrite) as aside, open(aside, "w", encoding="ascii") as out:
        for sample, time in enumerate(record.time.tolist()):
            u = np.asarray(record.displacement[sample])
            v = np.asarray(record.velocity[sample])
            columns = (rest - u, 0.0 - v, u, 0.0 - masses * v)
            rows = zip(*(column.tolist() for column in columns), named, strict=True)
            out.write(f"{grains.size}\n{box} Time={time}\n")
            out.writelines(
                f"X 0 0 {z} 0 0 {vz} {id} {radius} {mass} {moved} 0 0 {pz}\n"
                for z, vz, moved, pz, (id, radius, mass) in rows
            )
