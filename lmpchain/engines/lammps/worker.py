"""One MPI rank of LAMMPS with its own grains; all ranks execute the same calls in order."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from ...errors import EngineUnavailable, RunFailed
from ...integrators.kernels.layout import RESOLUTION
from ...integrators.methods import Splitting
from ...scene.waveform import Waveform
from ...util.arrays import Array
from .library import check_packages, close_lammps, open_lammps


@dataclass(frozen=True)
class StepPlan:
    """Plan of the steps of a column: method, step, and imposed motion or force.

    Attributes
    ----------
    grains : int
        Number of grains.
    first, last : int
        Index of the first grain that moves by the equation of motion, from 0; index after the last
        such grain.
    splitting : Splitting
        Method of time integration.
    step : float
        Time step, s.
    done : int
        Number of earlier steps.
    pieces : tuple of (end, commands)
        Pieces of a spline, each with its end time, s, and its LAMMPS commands.
    rest : float
        Height of grain 1 at rest, m.
    wave : Waveform or None
        Forcing: the force on the grain `pushed`, the motion of grain 1 if `driven`, or otherwise
        the motion of the top wall.
    driven : bool
        Whether the motion of grain 1 is prescribed.
    pushed : int or None
        Index of the grain, from 0, on which an external force acts.
    timed : bool
        Whether the force from the ground depends on the time.
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
    timed: bool

    @property
    def tells_time(self) -> bool:
        """Whether the time is put in from outside: drifts of a splitting are no steps of it."""
        return self.timed and self.splitting.order > 2

    @property
    def walled(self) -> bool:
        """Whether the top wall is moved from outside LAMMPS."""
        imposed = bool(self.wave) and self.splitting.order > 2
        return imposed and not self.driven and self.pushed is None

    def intervals(self, index: int) -> list[tuple[float, Array]]:
        """Return the length and drift times of a step, split where the waveform ends within it."""
        # Imposed values are needed at the ends of the drifts.
        reach = np.array([0.0, *self.splitting.reach])
        h = self.step
        end = self.wave.end if self.wave else np.inf
        begin = index * h
        first = end - index * h
        if not RESOLUTION * h < first < (1 - RESOLUTION) * h:
            return [(h, (index + reach) * h)]
        second = h - first
        return [(first, begin + first * reach), (second, begin + first + second * reach)]


class LocalState(NamedTuple):
    """Heights, velocities and forces of grains from `start`, and whether they are on the axis."""

    start: int
    z: Array
    vz: Array
    fz: Array
    straight: bool


class Worker:
    """One instance of LAMMPS; all workers together integrate one column.

    Parameters
    ----------
    world : mpi4py communicator or None
        Communicator of all workers; None for a single worker.
    log : str
        File for the log of LAMMPS, or "none".
    """

    def __init__(self, world: Any, log: str):
        self._lammps = open_lammps(log, world)

    def require(self, packages: tuple[str, ...]) -> None:
        """Raise `EngineUnavailable` if LAMMPS lacks one of these packages."""
        check_packages(self._lammps, *packages)

    def commands(self, text: str) -> None:
        """Execute LAMMPS commands."""
        self._lammps.commands_string(text)

    def begin(self, plan: StepPlan, state: tuple[Array, ...], include: str = "") -> None:
        """Compute the first forces, set the state, and create views of the arrays.

        The state consists of heights, velocities and, if the run is resumed, forces; it is empty if
        LAMMPS has read it from the data file. Stored forces replace the first forces, because with
        damping they depend on the velocities of the previous half step. The commands of the user,
        `include`, are executed after the state is set.
        """
        self._plan = plan
        self._done = plan.done
        self._piece = 0
        if state:
            # With damping, the first forces depend on the velocities.
            self._set("v", state[1])
        if plan.tells_time:
            self._lammps.set_internal_variable("now_at", plan.done * plan.step)
        if plan.walled:
            self._move_wall(plan.done * plan.step)
        elif plan.done and plan.pieces and plan.splitting.order == 2:
            # The first forces belong to the end of the last step, within its piece of the spline.
            ends = [int(end / plan.step) for end, _ in plan.pieces]
            later = (k for k, end in enumerate(ends) if end >= plan.done)
            self._use_piece(next(later, len(ends) - 1))
        # This command assigns the grains to ranks and lists their neighbours. It uses the heights
        # of the data file at t = 0 even if the run is resumed, because a grain may have crossed the
        # border between two ranks, left the box, or moved away from its neighbour.
        self._set_up(state)
        if include:
            self.commands(include)
            self._set_up(state)

    def _set_up(self, state: tuple[Array, ...]) -> None:
        """Let LAMMPS prepare a run, create views of its arrays, and set the state."""
        self._lammps.command("run 0 post no")
        self._view_arrays()
        for name, values in zip("xvf", state, strict=False):
            self._set(name, values)

    def _set(self, name: str, values: Array) -> None:
        """Set the z components of a LAMMPS array to the values of this rank's grains."""
        if count := self._lammps.extract_setting("nlocal"):
            arrays = self._lammps.numpy
            ids = arrays.extract_atom("id")[:count]
            arrays.extract_atom(name)[:count, 2] = values[ids - 1]

    def _view_arrays(self) -> None:
        """Create views of the LAMMPS arrays; a rank without grains has none."""
        plan = self._plan
        total = self._lammps.get_natoms()
        if total != plan.grains:
            # All ranks see this result, so all raise.
            raise RunFailed(f"LAMMPS has lost grains: {total:.0f} of {plan.grains} are left")
        arrays = self._lammps.numpy
        count = self._lammps.extract_setting("nlocal")
        self._ids = arrays.extract_atom("id")[:count] if count else np.empty(0, int)
        self._start = int(self._ids[0]) - 1 if count else 0
        self._order = np.arange(count) + self._start + 1
        self._check_order()
        self._x, self._v, self._f = (
            arrays.extract_atom(name)[:count] if count else np.empty((0, 3)) for name in "xvf"
        )
        mass = arrays.extract_atom("rmass")[:count] if count else np.empty(0)
        edges = (plan.first - self._start, plan.last - self._start)
        moving = slice(*np.clip(edges, 0, count).tolist())
        self._vz = self._v[moving, 2]
        self._fz = self._f[moving, 2]
        self._inverse_mass = 1 / mass[moving]
        self._kick = np.empty_like(self._inverse_mass)
        row = -1 if plan.pushed is None else plan.pushed - max(plan.first, self._start)
        self._pushed = row if 0 <= row < self._vz.size else None

    def _check_order(self) -> None:
        """Raise `EngineUnavailable` unless this rank has its grains in order."""
        count = self._lammps.extract_setting("nlocal")
        if count != self._ids.size or (self._ids != self._order).any():
            raise EngineUnavailable(
                "LAMMPS has changed the order of the grains: leave out commands of your own that "
                "sort or balance the grains or renew neighbour lists; without any, use another "
                "version of LAMMPS"
            )

    def advance(self, steps: int) -> None:
        """Advance by `steps` steps."""
        splitting = self._plan.splitting
        if splitting.order == 2:
            # Velocity Verlet is the built-in integrator of LAMMPS.
            self._run(steps)
        else:
            outside = not splitting.substeps or self._plan.pushed is not None
            self._split(splitting.kicks if outside else (), steps)
        self._done += steps

    def _run(self, steps: int) -> None:
        """Run velocity Verlet, with stops only at the ends of cubic pieces of a drive."""
        done = self._done
        last = self._done + steps
        pieces = self._plan.pieces
        # A measured trace may have a million pieces.
        first = bisect_right(pieces, done * self._plan.step, key=itemgetter(0))
        for index in range(first, len(pieces)):
            if done == last:
                break
            end, _ = pieces[index]
            until = min(last, int(end / self._plan.step))
            if until > done:
                self._use_piece(index)
                self._lammps.command(f"run {until - done} pre no post no")
                done = until
        if last > done:
            self._lammps.command(f"run {last - done} pre no post no")

    def _split(self, kicks: tuple[float, ...], steps: int) -> None:
        """Run steps of several drifts, with kicks by LAMMPS or by this function on its arrays."""
        command = self._lammps.command
        plan = self._plan
        drives = plan.driven and self._start == 0 and self._x.size
        for index in range(self._done, self._done + steps):
            for h, times in plan.intervals(index):
                imposed = plan.wave.at(times) if plan.wave else times
                for n, drift in enumerate(a * h for a in plan.splitting.drifts):
                    if kicks:
                        self._kick_grains(kicks[n] * h, imposed[n])
                    if drives:
                        # The velocity is set such that the drift ends at the imposed height.
                        self._v[0, 2] = (plan.rest - imposed[n + 1] - self._x[0, 2]) / drift
                    if plan.walled:
                        self._move_wall(times[n + 1])
                    if plan.tells_time:
                        self._lammps.set_internal_variable("now_at", float(times[n + 1]))
                    command(f"timestep {drift!r}")
                    command("run 1 pre no post no")
                # The last kick is not merged with the first kick of the next step, so that chunks
                # of any length give the same bits.
                if kicks:
                    self._kick_grains(kicks[-1] * h, imposed[-1])
        if drives:
            assert plan.wave
            self._v[0, 2] = -plan.wave.at((self._done + steps) * plan.step, 1)

    def _kick_grains(self, length: float, force: float) -> None:
        """Kick all grains by the LAMMPS forces, and one grain by a force, N, for a time, s."""
        # The array is reused because this function runs once per stage.
        self._vz += np.multiply(self._fz, self._inverse_mass * length, out=self._kick)
        if self._pushed is not None:
            self._vz[self._pushed] -= length * self._inverse_mass[self._pushed] * force

    def _move_wall(self, t: float) -> None:
        """Move the top wall to its height at a time, s."""
        assert self._plan.wave
        self._lammps.set_internal_variable("wall_at", float(-self._plan.wave.at(t)))

    def _use_piece(self, index: int) -> None:
        if index != self._piece:
            self.commands("\n".join(self._plan.pieces[index][1]))
            self._piece = index

    def share(self) -> LocalState:
        """Return the motion of this rank's grains."""
        self._check_order()
        # A column that buckles leaves the axis, so that x or y is no longer exactly 0.
        straight = not self._x[:, :2].any()
        return LocalState(self._start, self._x[:, 2], self._v[:, 2], self._f[:, 2], straight)

    def close(self) -> None:
        """End the instance."""
        close_lammps(self._lammps)


def deck_steps(splitting: Splitting) -> int:
    """Return the number of LAMMPS steps in one step of the splitting."""
    return 1 if splitting.order == 2 else len(splitting.drifts)
