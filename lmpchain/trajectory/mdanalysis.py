"""Trajectories as MDAnalysis universes, read on demand."""

from __future__ import annotations

from typing import Any

import numpy as np
from MDAnalysis import Universe
from MDAnalysis.coordinates.base import ProtoReader
from MDAnalysis.coordinates.timestep import Timestep

from .record import Record


class SampleReader(ProtoReader):
    """Reader that passes the samples of a trajectory to MDAnalysis on demand.

    Parameters
    ----------
    record : Record
        Trajectory to read. Only one sample at a time is read, so that its arrays may be on disk.
    """

    def __init__(self, record: Record):
        super().__init__()
        self._run = record
        self.filename = None
        self.n_frames, self.n_atoms = record.displacement.shape
        self._rest = -record.scene.chain.depths[record.grains - 1]
        self._reopen()
        self._read_next_timestep()

    def _reopen(self) -> None:
        interval = self._run.scene.sampling_interval
        self.ts = Timestep(self.n_atoms, dt=interval, velocities=True)
        self.ts.positions[:] = self.ts.velocities[:] = 0.0
        self.ts.frame = -1

    def _read_next_timestep(self, ts: Timestep | None = None) -> Timestep:
        if self.ts.frame + 1 >= self.n_frames:
            raise EOFError
        return self._read_frame(self.ts.frame + 1)

    def _read_frame(self, frame: int) -> Timestep:
        ts = self.ts
        run = self._run
        ts.frame = frame
        ts.time = float(run.time[frame])
        ts.data["displacement"] = np.array(run.displacement[frame])
        ts.data["velocity"] = np.array(run.velocity[frame])
        ts.positions[:, 2] = self._rest - ts.data["displacement"]
        ts.velocities[:, 2] = -ts.data["velocity"]
        return ts

    def copy(self) -> SampleReader:
        """Return another reader of the same trajectory at the same sample."""
        reader = SampleReader(self._run)
        reader.add_transformations(*self.transformations)
        reader.ts = self.ts.copy()
        return reader

    def close(self) -> None:
        """Do nothing, because no file is open."""


def make_universe(record: Record) -> Universe:
    """Return the trajectory as a Universe; see `lmpchain.Trajectory.universe`."""
    chain = record.scene.chain
    indices = record.grains - 1
    universe: Any = Universe.empty(indices.size)
    universe.add_TopologyAttr("ids", record.grains)
    universe.add_TopologyAttr("masses", chain.masses[indices])
    universe.add_TopologyAttr("radii", chain.diameters[indices] / 2)
    universe.trajectory = SampleReader(record)
    return universe
