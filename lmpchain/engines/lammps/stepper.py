"""A column inside a LAMMPS instance, moved forward by `run`."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import InputError, RunFailed
from ...fields import Array
from ..splittings import Splitting
from . import deck
from .column import Column
from .library import open_lammps


class LammpsStepper:
    """One chain in LAMMPS.

    Parameters
    ----------
    column : Column
    splitting : Splitting
    step : float
        s.
    state : mapping
        Empty, or what `state` returned.
    keep : Path, optional
        Folder for the deck, the data file, the log and a dump of `samples` + 1 samples, `every` steps apart.
    """

    def __init__(
        self,
        column: Column,
        splitting: Splitting,
        step: float,
        state: Mapping[str, Array],
        *,
        every: int,
        samples: int,
        keep: Path | None = None,
    ):
        self._column, self._splitting, self._step = column, splitting, step
        with tempfile.TemporaryDirectory(prefix="lmpchain-") as scratch:
            folder = Path(scratch) if keep is None else keep
            deck.write_data(column, folder / "column.data")
            self._lammps = open_lammps("none" if keep is None else _word(keep / "log.lammps"))
            try:
                self._commands(deck.setup(column, _word(folder / "column.data"), step, splitting))
                if keep is not None:
                    deck.write_deck(column, keep, step, splitting, every, samples)
                    dump = _word(keep / "column.lammpstrj")
                    self._commands(deck.dump(dump, every * max(1, len(splitting.substeps))))
                self._prepare(state)
            except BaseException:
                self._lammps.close()
                raise
        self._look()

    def _prepare(self, state: Mapping[str, Array]) -> None:
        """Put a kept state in place before the first forces are computed, and keep views of the arrays."""
        grains = self._column.chain.grains
        arrays = self._lammps.numpy
        if state:
            arrays.extract_atom("x")[:grains, 2] = state["z"]
            arrays.extract_atom("v")[:grains, 2] = state["vz"]
        self._commands("run 0 post no")
        if self._lammps.get_natoms() != grains:
            raise RunFailed(f"LAMMPS has lost grains: {self._lammps.get_natoms():.0f} of {grains} are left")
        if not np.array_equal(arrays.extract_atom("id")[:grains], np.arange(1, grains + 1)):
            raise RunFailed("LAMMPS does not keep the grains in order; this version cannot be used")
        self._x, self._v, self._f = (arrays.extract_atom(name)[:grains] for name in "xvf")
        self._z, self._vz = self._x[:, 2], self._v[:, 2]
        moving = slice(0, self._column.chain.movable)
        self._vz_moving, self._fz_moving = self._v[moving, 2], self._f[moving, 2]
        self._inverse_mass = 1 / arrays.extract_atom("rmass")[moving]
        self._kick = np.empty(self._column.chain.movable)

    def _commands(self, text: str) -> None:
        try:
            self._lammps.commands_string(text)
        except Exception as error:  # LAMMPS raises nothing narrower
            raise RunFailed(f"LAMMPS stopped: {error}") from None

    def advance(self, steps: int) -> None:
        """Move forward by `steps` steps."""
        if self._splitting.order == 2:
            self._commands(f"run {steps} pre no post no")
        elif self._splitting.substeps:
            self._compose(steps)
        else:
            self._split(steps)
        self._look()

    def _compose(self, steps: int) -> None:
        """Velocity Verlet steps of different lengths, the kicks in LAMMPS."""
        command = self._lammps.command
        lengths = [f"timestep {part * self._step!r}" for part in self._splitting.substeps]
        for _ in range(steps):
            for length in lengths:
                command(length)
                command("run 1 pre no post no")

    def _split(self, steps: int) -> None:
        """Drifts and forces in LAMMPS (fix nve/noforce), kicks here, on its own arrays."""
        command, v, f, kick = self._lammps.command, self._vz_moving, self._fz_moving, self._kick
        lengths = [f"timestep {a * self._step!r}" for a in self._splitting.drifts]
        weights = [self._inverse_mass * (b * self._step) for b in self._splitting.kicks]
        for _ in range(steps):
            for length, weight in zip(lengths, weights, strict=False):
                v += np.multiply(f, weight, out=kick)
                command(length)
                command("run 1 pre no post no")
            # the last kick stays apart from the next step's first: chunks of any length give the same bits
            v += np.multiply(f, weights[-1], out=kick)

    def _look(self) -> None:
        """Take displacements and velocities, and check what LAMMPS itself does not check here."""
        overlap_limit = 0.5 * self._column.diameters[1:]
        spacing = self._z[:-1] - self._z[1:]
        if not (spacing > overlap_limit).all():
            what = "heights are no longer numbers" if np.isnan(spacing).any() else "a grain has passed into another"
            raise RunFailed(f"LAMMPS: {what}; use a shorter step")
        if self._x[:, :2].any():
            raise RunFailed("LAMMPS: the column has buckled sideways; use the physical diameter")
        self.u = (self._column.heights - self._z)[None]
        self.v = -self._vz[None]

    def lowest(self) -> Array:
        """Leave the watch for openings to the native twin."""
        return np.array([np.inf])

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits: heights as LAMMPS holds them."""
        return {"z": self._z.copy(), "vz": self._vz.copy()}

    def close(self) -> None:
        """End the LAMMPS instance."""
        self._lammps.close()


def _word(path: Path) -> str:
    """Return a path that is safe inside a LAMMPS command."""
    text = str(path.absolute())
    if any(character in "\"'$&#{}" or ord(character) < 32 for character in text):
        raise InputError([(text, "has a character that LAMMPS commands cannot hold: use a plainer folder name")])
    return text
