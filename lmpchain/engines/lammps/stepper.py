"""Integration of a column in LAMMPS, by repeated `run` commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import InputError, RunFailed
from ...integrators.methods import Splitting
from ...integrators.steps import Steps
from ...util.arrays import Array
from . import deck
from .column import LammpsColumn, pieces
from .subprocess_ranks import Communicator
from .worker import LocalState, StepPlan

# LAMMPS packages of fix mvv/dpd, of its required pair style, and of the atom style.
PREDICTING = ("DPD-MESO", "DPD-BASIC", "SPH")
UNSEEN = 32  # Largest number of steps after which a diverged run is detected.


class LammpsStepper:
    """One chain in LAMMPS that is integrated from sample to sample.

    Parameters
    ----------
    column : Column
    splitting : Splitting
    steps : Steps
        Steps of one length that land on every sample.
    state : mapping
        State from which the run continues, as returned by the property `state`; empty at first.
    communicator : Communicator
        Communicator of the ranks, which is closed with the stepper.
    keep : Path, optional
        Folder for the deck, the data file and a dump of the samples.
    """

    stride = 1
    own_part = 1.0
    # Each step is a LAMMPS command or loop, which is slower than compiled kernels.
    guessed_rate = 1e6

    def __init__(
        self,
        column: LammpsColumn,
        splitting: Splitting,
        steps: Steps,
        state: Mapping[str, Array],
        communicator: Communicator,
        keep: Path | None = None,
    ):
        self._column = column
        self._communicator = communicator
        self._every = steps.per_landing
        self._done = int(state.get("done", 0))
        scene = column.scene
        first, last = column.mobile
        kicks = deck.kicks_by_force(scene, splitting)
        plan = StepPlan(
            grains=scene.chain.grains,
            first=first - 1,
            last=last,
            splitting=splitting,
            step=steps.step,
            done=self._done,
            pieces=tuple(pieces(scene.excitation, scene.duration)),
            rest=column.heights[0],
            wave=scene.excitation.waveform,
            driven=bool(scene.excitation.driven),
            pushed=scene.excitation.acts_on - 1 if kicks else None,
            timed=column.chain.ground_in_time,
        )
        include = ""
        if state and column.include:
            # Otherwise, the first frame or average would contain the heights of the data file.
            include = column.include
            column = replace(column, include="# these follow when the state is set")
        try:
            if column.predicts:
                communicator.ask("require", PREDICTING)
            with deck.data_file(column, keep) as data:
                setup = deck.setup(column, word(data), steps.step, splitting, self._done)
                communicator.ask("commands", setup)
            if keep is not None:
                deck.write_deck(column, keep / "in.column", steps.step, splitting)
                dump = word(keep / "column.lammpstrj")
                every = self._every * deck.deck_steps(splitting)
                communicator.ask("commands", deck.dump(dump, every))
            if state:
                start: tuple[Array, ...] = state["z"], state["vz"], state["fz"]
            else:
                start = () if deck.holds_motion(column, keep) else column.start
            communicator.ask("begin", plan, start, include)
            if state and column.formula and scene.excitation.wall is not None:
                # LAMMPS stops at a wall beyond a grain, so it moves once the heights are set.
                communicator.ask("commands", "variable wall_on internal 1.0")
            self._take()
            self._check()
        except BaseException:
            communicator.close()
            raise

    def fill(self, u: Array, v: Array, offset: int, until: int, max_steps: int) -> int:
        """Advance to the sample `until` or by `max_steps`; write samples to u, v from `offset`.

        `u` and `v` are (1, B, N) arrays, m and m/s. The number of steps is returned.
        """
        total = 0
        while total < max_steps and self.sample < until:
            # A chunk never passes the next sample, so that pauses do not change the steps.
            steps = min(max_steps - total, self._every - self._done % self._every)
            self._communicator.ask("advance", steps)
            self._done += steps
            total += steps
            sampled = self._done % self._every == 0
            # Checking the state of many grains costs a fraction of a step.
            if sampled or self._done - self._seen >= UNSEEN:
                self._take()
            if sampled:
                self._check()
                u[0, self.sample - offset] = self._column.heights - self._z
                v[0, self.sample - offset] = -self._vz
        return total

    @property
    def sample(self) -> int:
        """Number of the last sample that was reached."""
        return self._done // self._every

    @property
    def steps(self) -> Array:
        """Number of steps so far, (1,)."""
        return np.array([self._done])

    @property
    def progress(self) -> float:
        """Fraction of the steps that are done."""
        return self._done / (self._every * self._column.scene.intervals)

    def _take(self) -> None:
        """Copy the motion from all ranks; raise `RunFailed` if a value is not finite."""
        shares: list[LocalState] = self._communicator.ask("share")
        self._seen = self._done
        self._z, self._vz, self._fz = _join(shares)
        if np.isnan(self._z).any():
            raise RunFailed("LAMMPS: heights are not finite: use a shorter step")
        if not all(share.straight for share in shares):
            raise RunFailed("LAMMPS: the column has buckled sideways: use the physical diameter")

    def _check(self) -> None:
        """Raise `RunFailed` at samples if grains have passed through each other."""
        if not (self._z[:-1] - self._z[1:] > 0.5 * self._column.diameters[1:]).all():
            raise RunFailed("LAMMPS: a grain has passed through another: use a shorter step")

    @property
    def ranks(self) -> int:
        """Number of processes that share the column."""
        return self._communicator.ranks

    def state(self) -> dict[str, Array]:
        """Return heights as stored in LAMMPS, velocities, forces and steps, for resuming."""
        if self._seen < self._done:
            self._take()
        fields = {"z": self._z, "vz": self._vz, "fz": self._fz}
        return {key: field.copy() for key, field in fields.items()} | {"done": np.array(self._done)}

    def close(self) -> None:
        """End the LAMMPS instances."""
        self._communicator.close()


def _join(shares: list[LocalState]) -> tuple[Array, Array, Array]:
    """Return heights, velocities and forces of all grains, from the top, joined from all ranks."""
    if len(shares) == 1:
        return shares[0].z, shares[0].vz, shares[0].fz
    shares = sorted((share for share in shares if share.z.size), key=lambda share: share.start)
    z = np.concatenate([share.z for share in shares])
    vz = np.concatenate([share.vz for share in shares])
    fz = np.concatenate([share.fz for share in shares])
    return z, vz, fz


def word(path: Path) -> str:
    """Return a path in a form that is safe in a LAMMPS command."""
    text = str(path.absolute())
    if not (text.isascii() and text.isprintable()) or set(text) & set("\"'$&#{}*%"):
        raise InputError.at(text, "has a character that LAMMPS does not accept: rename the folder")
    return text
