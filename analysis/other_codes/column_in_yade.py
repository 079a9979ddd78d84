"""A column in Yade's own Python: `yade -n -x -j 1 column_in_yade.py FOLDER`.

The folder holds `column.npz`, which `with_yade.py` writes. Each line of the input names a number of
steps and their length, s; the answer goes to `end.npz`, and a line with its name to the output.
"""

import sys
import time
from pathlib import Path

import numpy as np
from yade import (
    Bo1_Sphere_Aabb,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_FrictMat_FrictMat_MindlinPhys,
    Law2_ScGeom_MindlinPhys_Mindlin,
    NewtonIntegrator,
    O,
    utils,
)


def build(column, step):
    """Make the scene: Hertz contacts without damping and friction; the last grain is fixed."""
    O.reset()
    glass = FrictMat(
        young=float(column["modulus"]), poisson=float(column["ratio"]), frictionAngle=0.0
    )
    O.materials.append(glass)
    last = column["z"].size - 1
    rows = np.column_stack([column[name] for name in ("z", "vz", "diameter", "mass")]).tolist()
    for number, (z, vz, diameter, mass) in enumerate(rows):
        body = utils.sphere((0, 0, z), diameter / 2, material=glass, fixed=number == last)
        body.state.mass = mass
        body.state.vel = (0, 0, vz)
        O.bodies.append(body)
    O.engines = [
        ForceResetter(),
        InsertionSortCollider([Bo1_Sphere_Aabb()]),
        InteractionLoop(
            [Ig2_Sphere_Sphere_ScGeom()],
            [Ip2_FrictMat_FrictMat_MindlinPhys()],
            [Law2_ScGeom_MindlinPhys_Mindlin()],
        ),
        NewtonIntegrator(damping=0.0, gravity=(0, 0, -float(column["gravity"]))),
    ]
    O.dt = step


def heights():
    """Return heights and upward velocities, (N,) m and m/s."""
    states = [body.state for body in O.bodies]
    return np.array([(state.pos[2], state.vel[2]) for state in states]).T


def solve(column, steps, step):
    """Return final heights and velocities, and the CPU time of all steps, s."""
    build(column, step)
    # Contacts are detected in the first step, which counts as set-up and is not timed.
    O.run(1, True)
    began = time.process_time()
    O.run(steps - 1, True)
    seconds = (time.process_time() - began) * steps / (steps - 1)
    z, before = heights()
    # Velocities are stored half a step before and half a step after the positions.
    O.run(1, True)
    _, after = heights()
    return {"z": z, "vz": (before + after) / 2, "seconds": seconds}


def main():
    """Process requests until the input ends."""
    folder = Path(sys.argv[-1])
    column = dict(np.load(folder / "column.npz"))
    for line in sys.stdin:
        steps, step = line.split()
        np.savez(folder / "end.npz", **solve(column, int(steps), float(step)))
        print("end.npz", flush=True)


main()
