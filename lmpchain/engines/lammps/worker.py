"""One MPI rank of LAMMPS with its own grains; all ranks do the same in the same order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...integrators.splittings import Splitting
from ...scene.excitation import Drive
from ...util.arrays import Array
from .library import open_lammps


@dataclass(frozen=True)
class StepPlan:
    """How to move a column forward.

    Attributes
    ----------
    grains : int
    first, last : int
        Grains first ... last - 1, counted from 0, move by the equation of motion.
    splitting : Splitting
    step : float
        s.
    done : int
        Steps of before.
    drive : Drive or None
        The motion of grain 1.
    pieces : tuple of (end, commands)
        Of a sampled drive.
    rest : float
        Height at which grain 1 rests, m.
    """

    grains: int
    first: int
    last: int
    splitting: Splitting
    step: float
    done: int
    drive: Drive | None
    pieces: tuple[tuple[float, list[str]], ...]
    rest: float


class LocalState(NamedTuple):
    """What one rank holds: grains from `start`, counted from 0, and whether they are still on the axis."""

    start: int
    z: Array
    vz: Array
    straight: bool


class Worker:
    """A LAMMPS instance that shares a column with those of the other ranks.

    Parameters
    ----------
    world : mpi4py communicator or None
        None for a LAMMPS alone.
    log : str
        File for LAMMPS's log, or "none".
    """

    def __init__(self, world: Any, log: str):
        self._lammps = open_lammps(log, world)

    def commands(self, text: str) -> None:
        """Execute commands."""
        self._lammps.commands_string(text)

    def begin(self, plan: StepPlan, kept: tuple[Array, Array] | None) -> LocalState:
        """Put kept heights and velocities in place, compute the first forces, and keep views of the arrays."""
        self._plan, self._done, self._piece = plan, plan.done, 0
        arrays, here = self._lammps.numpy, self._lammps.extract_global("nlocal")
        if self._lammps.get_natoms() != plan.grains:  # all ranks see this: an error as LAMMPS itself raises them
            raise Exception(f"LAMMPS has lost grains: {self._lammps.get_natoms():.0f} of {plan.grains} are left")
        ids = arrays.extract_atom("id")[:here] if here else np.empty(0, int)
        self._start = start = int(ids[0]) - 1 if here else 0
        if not np.array_equal(ids, np.arange(start + 1, start + here + 1)):
            raise RuntimeError("LAMMPS does not keep the grains in order; this version cannot be used")
        if kept and here:
            for name, values in zip("xv", kept, strict=True):
                arrays.extract_atom(name)[:here, 2] = values[start : start + here]
        self._lammps.command("run 0 post no")
        self._x, self._v, self._f = (arrays.extract_atom(name)[:here] if here else np.empty((0, 3)) for name in "xvf")
        moving = slice(*(min(max(edge - start, 0), here) for edge in (plan.first, plan.last)))
        self._vz, self._fz = self._v[moving, 2], self._f[moving, 2]
        self._inverse_mass = 1 / arrays.extract_atom("rmass")[:here][moving] if here else np.empty(0)
        self._kick = np.empty_like(self._inverse_mass)
        return self._share()

    def advance(self, steps: int) -> LocalState:
        """Move forward by `steps` steps."""
        splitting = self._plan.splitting
        if splitting.order == 2:
            self._run(steps)
        else:
            kicks = () if splitting.substeps else splitting.kicks
            self._split([b * self._plan.step for b in kicks], steps)
        self._done += steps
        return self._share()

    def _run(self, steps: int) -> None:
        """Velocity Verlet, interrupted only where one cubic piece of a drive gives way to the next."""
        now, last = self._done, self._done + steps
        for index, (end, _) in enumerate(self._plan.pieces):
            until = min(last, int(end / self._plan.step))
            if until > now:
                self._put_in_force(index)
                self._lammps.command(f"run {until - now} pre no post no")
                now = until
        if last > now:
            self._lammps.command(f"run {last - now} pre no post no")

    def _split(self, kicks: list[float], steps: int) -> None:
        """Steps of several drifts, each a run: with LAMMPS's own kicks, or with these, on its own arrays."""
        command, plan = self._lammps.command, self._plan
        drifts = [a * plan.step for a in plan.splitting.drifts]
        lengths = [f"timestep {drift!r}" for drift in drifts]
        weights = [self._inverse_mass * b for b in kicks]
        v, f, kick = self._vz, self._fz, self._kick
        driven = plan.drive if self._start == 0 and self._x.size else None
        if driven:
            index = self._done + np.arange(steps)[:, None]
            goals = plan.rest - driven.motion((index + np.array(plan.splitting.reach)) * plan.step)[0]
        for step in range(steps):
            for part, length in enumerate(lengths):
                if weights:
                    v += np.multiply(f, weights[part], out=kick)
                if driven:  # the speed that takes it where it should be
                    self._v[0, 2] = (goals[step, part] - self._x[0, 2]) / drifts[part]
                command(length)
                command("run 1 pre no post no")
            if weights:  # this kick stays apart from the next step's first: chunks of any length give the same bits
                v += np.multiply(f, weights[-1], out=kick)
        if driven:
            self._v[0, 2] = -driven.motion((self._done + steps) * plan.step)[1]

    def _put_in_force(self, index: int) -> None:
        if index != self._piece:
            self.commands("\n".join(self._plan.pieces[index][1]))
            self._piece = index

    def _share(self) -> LocalState:
        return LocalState(self._start, self._x[:, 2], self._v[:, 2], not self._x[:, :2].any())

    def close(self) -> None:
        """End the instance."""
        self._lammps.close()


def deck_steps(splitting: Splitting) -> int:
    """Return how many steps of LAMMPS make one of the splitting."""
    return 1 if splitting.order == 2 else len(splitting.drifts)
