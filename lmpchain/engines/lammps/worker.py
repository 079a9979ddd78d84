"""One MPI rank of LAMMPS with its own grains; all ranks do the same in the same order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...errors import EngineUnavailable, RunFailed
from ...integrators.kernels.layout import RESOLUTION
from ...integrators.splittings import Splitting
from ...scene.waveform import Waveform
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
    pieces : tuple of (end, commands)
        Of a spline.
    rest : float
        Height at which grain 1 rests, m.
    wave : Waveform or None
        What is imposed: a force if it is `pushed`, or the motion of grain 1 if that is `driven`,
        else of the top wall.
    driven : bool
    pushed : int or None
        The grain, counted from 0, that a force kicks from outside.
    """

    grains: int
    first: int
    last: int
    splitting: Splitting
    step: float
    done: int
    pieces: tuple[tuple[float, list[str]], ...]
    rest: float
    wave: Waveform | None
    driven: bool
    pushed: int | None

    @property
    def walled(self) -> bool:
        """Whether the top wall is put where it is from outside."""
        return (
            bool(self.wave) and self.splitting.order > 2 and not self.driven and self.pushed is None
        )

    def parts(self, index: int) -> list[tuple[float, Array]]:
        """Return length and times of drifts of a step, or of its two parts if what is imposed ends in it."""
        reach = np.array([0.0, *self.splitting.reach])
        h = self.step
        end = self.wave.end if self.wave and self.wave.spline is None else np.inf
        begin = index * h
        left = end - index * h
        if not RESOLUTION * h < left < (1 - RESOLUTION) * h:
            return [(h, (index + reach) * h)]
        return [(left, begin + left * reach), (h - left, begin + left + (h - left) * reach)]


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
        self._plan = plan
        self._done = plan.done
        self._piece = 0
        arrays = self._lammps.numpy
        here = self._lammps.extract_global("nlocal")
        if self._lammps.get_natoms() != plan.grains:  # all ranks see this
            raise RunFailed(
                f"LAMMPS has lost grains: {self._lammps.get_natoms():.0f} of {plan.grains} are left"
            )
        ids = arrays.extract_atom("id")[:here] if here else np.empty(0, int)
        self._start = start = int(ids[0]) - 1 if here else 0
        if not np.array_equal(ids, np.arange(start + 1, start + here + 1)):
            raise EngineUnavailable("LAMMPS does not keep the grains in order: use another version")
        if kept and here:
            for name, values in zip("xv", kept, strict=True):
                arrays.extract_atom(name)[:here, 2] = values[start : start + here]
        if plan.walled:
            self._move_wall(plan.done * plan.step)
        # with the piece of the last step
        elif plan.done and plan.pieces and plan.splitting.order == 2:
            self._put_in_force(
                next(
                    k for k, (end, _) in enumerate(plan.pieces) if int(end / plan.step) >= plan.done
                )
            )
        self._lammps.command("run 0 post no")
        self._x, self._v, self._f = (
            arrays.extract_atom(name)[:here] if here else np.empty((0, 3)) for name in "xvf"
        )
        moving = slice(*(min(max(edge - start, 0), here) for edge in (plan.first, plan.last)))
        self._vz = self._v[moving, 2]
        self._fz = self._f[moving, 2]
        self._inverse_mass = (
            1 / arrays.extract_atom("rmass")[:here][moving] if here else np.empty(0)
        )
        self._kick = np.empty_like(self._inverse_mass)
        place = -1 if plan.pushed is None else plan.pushed - max(plan.first, start)
        self._pushed = place if 0 <= place < self._vz.size else None
        return self._share()

    def advance(self, steps: int) -> LocalState:
        """Move forward by `steps` steps."""
        splitting = self._plan.splitting
        if splitting.order == 2:
            self._run(steps)
        else:
            from_outside = not splitting.substeps or self._plan.pushed is not None
            self._split(splitting.kicks if from_outside else (), steps)
        self._done += steps
        return self._share()

    def _run(self, steps: int) -> None:
        """Velocity Verlet, interrupted only where one cubic piece of a drive gives way to the next."""
        now = self._done
        last = self._done + steps
        for index, (end, _) in enumerate(self._plan.pieces):
            until = min(last, int(end / self._plan.step))
            if until > now:
                self._put_in_force(index)
                self._lammps.command(f"run {until - now} pre no post no")
                now = until
        if last > now:
            self._lammps.command(f"run {last - now} pre no post no")

    def _split(self, kicks: tuple[float, ...], steps: int) -> None:
        """Steps of several drifts, each a run: with LAMMPS's own kicks, or with these, on its own arrays."""
        command = self._lammps.command
        plan = self._plan
        at_work = plan.driven and self._start == 0 and self._x.size
        for index in range(self._done, self._done + steps):
            for h, times in plan.parts(index):
                imposed = plan.wave.at(times) if plan.wave else times
                for part, drift in enumerate(a * h for a in plan.splitting.drifts):
                    if kicks:
                        self._give(kicks[part] * h, imposed[part])
                    if at_work:  # the speed that takes it where it should be
                        self._v[0, 2] = (plan.rest - imposed[part + 1] - self._x[0, 2]) / drift
                    if plan.walled:
                        self._move_wall(times[part + 1])
                    command(f"timestep {drift!r}")
                    command("run 1 pre no post no")
                # this kick stays apart from the next step's first: chunks of any length give the
                # same bits
                if kicks:
                    self._give(kicks[-1] * h, imposed[-1])
        if at_work:
            assert plan.wave
            self._v[0, 2] = -plan.wave.at((self._done + steps) * plan.step, 1)

    def _give(self, length: float, force: float) -> None:
        """Kick all grains for this time, s, by the forces of LAMMPS, and one by a force from outside, N."""
        self._vz += np.multiply(self._fz, self._inverse_mass * length, out=self._kick)
        if self._pushed is not None:
            self._vz[self._pushed] -= length * self._inverse_mass[self._pushed] * force

    def _move_wall(self, t: float) -> None:
        """Put the top wall where it is at this time."""
        assert self._plan.wave
        self._lammps.set_internal_variable("wall_at", float(-self._plan.wave.at(t)))

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
