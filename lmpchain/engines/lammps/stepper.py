"""A column in LAMMPS, moved forward by `run`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import InputError, RunFailed
from ...integrators.splittings import Splitting
from ...util.arrays import Array
from . import deck, drive
from .column import Column
from .communicators import Communicator
from .worker import LocalState, StepPlan


class LammpsStepper:
    """One chain in LAMMPS, which stops at every sample.

    Parameters
    ----------
    column : Column
    splitting : Splitting
    step : float
        s.
    state : mapping
        Empty, or what `state` returned.
    communicator : Communicator
        The ranks; closed with the stepper.
    every : int
        Steps from one sample to the next.
    keep : Path, optional
        Folder for the deck, the data file and a dump of the samples.
    """

    stride = 1

    def __init__(
        self,
        column: Column,
        splitting: Splitting,
        step: float,
        state: Mapping[str, Array],
        communicator: Communicator,
        *,
        every: int,
        keep: Path | None = None,
    ):
        self._column = column
        self._communicator = communicator
        self._every = every
        self._done = int(state.get("done", 0))
        scene = column.scene
        first, last = column.mobile
        pieces = tuple(drive.pieces(scene.excitation, scene.duration))
        pushed = (
            scene.excitation.reach(scene.chain)[0] - 1
            if deck.kicked_by_force(scene, splitting)
            else None
        )
        plan = StepPlan(
            scene.chain.grains,
            first - 1,
            last,
            splitting,
            step,
            self._done,
            pieces,
            column.heights[0],
            scene.excitation.waveform,
            bool(scene.excitation.driven),
            pushed,
        )
        try:
            with deck.data_file(column, keep) as data:
                communicator.ask(
                    "commands", deck.setup(column, word(data), step, splitting, self._done)
                )
            if keep is not None:
                deck.write_deck(column, keep, step, splitting)
                dump = word(keep / "column.lammpstrj")
                communicator.ask("commands", deck.dump(dump, every * deck.deck_steps(splitting)))
            self._take(
                communicator.ask("begin", plan, (state["z"], state["vz"]) if state else None)
            )
            self._check()
        except BaseException:
            communicator.close()
            raise

    def fill(self, u: Array, v: Array, offset: int, until: int, max_steps: int) -> int:
        """Step to the sample `until`, or by `max_steps`; samples from `offset` on go into u, v (1, B, N)."""
        made = 0
        while made < max_steps and self.sample < until:
            steps = min(max_steps - made, self._every - self._done % self._every)
            self._take(self._communicator.ask("advance", steps))
            self._done += steps
            made += steps
            if self._done % self._every == 0:
                self._check()
                u[0, self.sample - offset] = self._column.heights - self._z
                v[0, self.sample - offset] = -self._vz
        return made

    @property
    def sample(self) -> int:
        """The last sample that it has reached."""
        return self._done // self._every

    @property
    def steps(self) -> Array:
        """Steps made, (1,)."""
        return np.array([self._done])

    def _take(self, shares: list[LocalState]) -> None:
        """Put the shares of the ranks together, unless they are no numbers."""
        self._z, self._vz = (shares[0].z, shares[0].vz) if len(shares) == 1 else _together(shares)
        if np.isnan(self._z).any():
            raise RunFailed("LAMMPS: heights are no longer numbers; use a shorter step")
        if not all(share.straight for share in shares):
            raise RunFailed("LAMMPS: the column has buckled sideways; use the physical diameter")

    def _check(self) -> None:
        """Check what LAMMPS itself does not: at samples only, as pauses between them fall anywhere."""
        if not (self._z[:-1] - self._z[1:] > 0.5 * self._column.diameters[1:]).all():
            raise RunFailed("LAMMPS: a grain has passed into another; use a shorter step")

    @property
    def ranks(self) -> int:
        """How many processes share the column."""
        return self._communicator.ranks

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits: heights as LAMMPS holds them."""
        return {"z": self._z.copy(), "vz": self._vz.copy(), "done": np.array(self._done)}

    def close(self) -> None:
        """End the LAMMPS instances."""
        self._communicator.close()


def _together(shares: list[LocalState]) -> tuple[Array, Array]:
    """Return heights and velocities of all grains, from the top."""
    ordered = sorted((share for share in shares if share.z.size), key=lambda share: share.start)
    return np.concatenate([share.z for share in ordered]), np.concatenate(
        [share.vz for share in ordered]
    )


def word(path: Path) -> str:
    """Return a path that is safe inside a LAMMPS command."""
    text = str(path.absolute())
    if not text.isascii() or any(
        character in "\"'$&#{}*%" or ord(character) < 32 for character in text
    ):
        raise InputError.at(
            text, "has a character that LAMMPS commands cannot hold: use a plainer folder name"
        )
    return text
