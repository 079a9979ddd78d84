"""A column for a discrete element code: data file, deck, run, log and final state."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from problem import Answer, Problem

from lmpchain import RunFailed, Scene
from lmpchain.util.arrays import Array

LOOP_TIME = re.compile(r"^Loop time of (\S+)", re.MULTILINE)
CPU_USE = re.compile(r"^(\S+)% CPU use", re.MULTILINE)


def heights(scene: Scene) -> Array:
    """Return the heights at rest, (N,) m: sums in extended precision, with grain 1 at 0."""
    d = scene.chain.diameters.astype(np.longdouble)
    return np.append(
        0.0, -np.cumsum((d[:-1] + d[1:]) / 2 - scene.chain.equilibrium_overlap)
    ).astype(float)


def write_data(scene: Scene, path: Path) -> None:
    """Write a data file (LAMMPS: atom_style sphere, LIGGGHTS: atom_style granular)."""
    chain = scene.chain
    u, v = scene.initial()
    z = heights(scene) - u
    d = chain.diameters
    density = chain.masses / (np.pi / 6 * d**3)
    side = d.max()
    box = ("x", -side, side), ("y", -side, side), ("z", z.min() - side, z.max() + side)
    grains = range(chain.grains)
    lines = [
        *("A column", "", f"{chain.grains} atoms", "1 atom types"),
        *(f"{low:.17g} {high:.17g} {axis}lo {axis}hi" for axis, low, high in box),
        *(
            "",
            "Atoms",
            "",
            *(f"{n + 1} 1 {d[n]:.17g} {density[n]:.17g} 0 0 {z[n]:.17g}" for n in grains),
        ),
        *("", "Velocities", "", *(f"{n + 1} 0 0 {-v[n]:.17g} 0 0 0" for n in grains), ""),
    ]
    path.write_text("\n".join(lines), encoding="ascii")


def run(command: list[str], deck: str, scene: Scene) -> tuple[Array, Array, float]:
    """Run a deck, which reads `column.data` and writes `end` with id, z and vz in order.

    Returns
    -------
    heights (N,) m, upward velocities (N,) m/s, loop time of its own log, s, of the processor
    where it tells that
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_data(scene, folder / "column.data")
        (folder / "in.column").write_text(deck, encoding="ascii")
        done = subprocess.run(
            [*command, "-in", "in.column", "-log", "log"],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        log = (folder / "log").read_text() if (folder / "log").exists() else ""
        if done.returncode or "ERROR" in log:
            raise RunFailed(f"{command[0]} failed: {(log + done.stdout + done.stderr)[-2000:]}")
        _, z, v = np.loadtxt(folder / "end", skiprows=9).T
        (seconds,) = LOOP_TIME.findall(log)
        used = CPU_USE.findall(log)
        return z, v, float(seconds) * float(used[0] if used else 100.0) / 100.0


def solve(command: list[str], deck: str, problem: Problem, step: float) -> Answer:
    """Run a deck of velocity Verlet with the fields steps, step, gravity and mobile."""
    chain = problem.scene.chain
    steps = round(problem.scene.duration / step)
    text = deck.format(steps=steps, step=step, gravity=chain.gravity, mobile=chain.movable)
    z, v, seconds = run(command, text, problem.scene)
    return Answer(heights(problem.scene) - z, -v, seconds, steps)


def steps(problem: Problem) -> list[float]:
    """Return steps that divide the duration, s, longest first."""
    return [
        problem.scene.duration / count for count in (int(100 * 2 ** (k / 2)) for k in range(21))
    ]
