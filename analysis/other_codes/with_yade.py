"""Yade, a discrete element code: leapfrog, Hertz contacts without damping and friction.

One process of Yade answers all steps of a problem; its time is that of the processor, which on an
idle machine is that of the clock.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import weakref
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import dem
import numpy as np
from problem import Answer, Code, Problem

from lmpchain import RunFailed

YADE = shutil.which("yade")
if not YADE:
    raise ImportError("there is no program yade here", name="yade")
SCRIPT = Path(__file__).with_name("column_in_yade.py")


class Column:
    """A problem in a Yade process, which ends with this object.

    Velocities half a step before the start are those of the start: grains must be struck at rest.
    """

    def __init__(self, problem: Problem):
        chain = problem.scene.chain
        u, v = problem.scene.initial()
        if u.any():
            raise RunFailed("Yade gets velocities half a step early: strike grains at rest here")
        self._problem = problem
        self._at_rest = dem.heights(problem.scene)
        self._folder = TemporaryDirectory()
        np.savez(
            Path(self._folder.name, "column.npz"),
            z=self._at_rest - u,
            vz=-v,
            diameter=chain.diameters,
            mass=chain.masses,
            modulus=chain.material.youngs_modulus,
            ratio=chain.material.poissons_ratio,
            gravity=chain.gravity,
        )

    @cached_property
    def _process(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [YADE, "-n", "-x", "-j", "1", str(SCRIPT), self._folder.name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        # Yade exits at the end of its input.
        weakref.finalize(self, process.communicate)
        return process

    def solve(self, step: float) -> Answer:
        """Return the final state; velocities are the means of two half steps."""
        steps = round(self._problem.scene.duration / step)
        self._process.stdin.write(f"{steps} {step!r}\n")
        self._process.stdin.flush()
        said = []
        for line in self._process.stdout:
            said.append(line)
            if line.strip() == "end.npz":
                break
        else:
            raise RunFailed(f"yade failed: {''.join(said)[-2000:]}")
        end = np.load(Path(self._folder.name, "end.npz"))
        return Answer(self._at_rest - end["z"], -end["vz"], float(end["seconds"]), steps)


def codes(problem: Problem) -> list[Code]:
    """Return Yade as a code."""
    about = subprocess.run([YADE, "--version"], capture_output=True, text=True).stdout
    version = re.search(r"\d{4}\.\d+\w*", about)
    column = Column(problem)
    solve = partial(_solve, column)
    return [Code("Yade Hertz", version[0] if version else "unknown", dem.steps(problem), solve)]


def _solve(column: Column, _: Problem, step: float) -> Answer:
    return column.solve(step)
