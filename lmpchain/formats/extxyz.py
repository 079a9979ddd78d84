"""Extended XYZ, the text form of a trajectory that OVITO, ASE and others read."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..files import write_aside

if TYPE_CHECKING:
    from ..trajectory import Trajectory

PROPERTIES = "species:S:1:pos:R:3:velo:R:3:id:I:1:radius:R:1:displacement:R:1"


def write(trajectory: Trajectory, path: str | PathLike[str]) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.to_extxyz`."""
    chain, grains = trajectory.scene.chain, trajectory.grains
    rest, radii = -chain.depths[grains - 1], chain.diameters[grains - 1] / 2
    side = 2 * float(radii.max())
    low, high = float(rest.min()) - side, float(rest.max()) + side
    box = (
        f'Lattice="{2 * side} 0 0 0 {2 * side} 0 0 0 {high - low}" Origin="{-side} {-side} {low}" '
        f'pbc="F F F" Properties={PROPERTIES}'
    )
    named = list(zip(grains.tolist(), radii.tolist(), strict=True))
    with write_aside(path) as aside, open(aside, "w", encoding="ascii") as out:
        for sample, time in enumerate(trajectory.time.tolist()):
            u, v = np.asarray(trajectory.displacement[sample]), np.asarray(trajectory.velocity[sample])
            rows = zip((rest - u).tolist(), (0.0 - v).tolist(), named, u.tolist(), strict=True)
            out.write(f"{grains.size}\n{box} Time={time}\n")
            out.writelines(f"X 0 0 {z} 0 0 {vz} {id} {radius} {moved}\n" for z, vz, (id, radius), moved in rows)
