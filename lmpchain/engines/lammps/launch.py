"""The ranks that a LAMMPS run was asked to use."""

from __future__ import annotations

from ...errors import InputError
from ...util import mpi
from .communicators import Communicator, MpiRanks, Serial
from .subprocess_ranks import SubprocessRanks


def gather(ranks: int | None, log: str) -> Communicator:
    """Return the communicator: the ranks of a surrounding mpirun, some started for it, or this process.

    Raises
    ------
    InputError
        If they are not to be had.
    EngineUnavailable
        If MPI does not work here.
    """
    world = mpi.joined()
    if mpi.launched() > 1 and ranks not in (None, 1 if world is None else world.size):
        raise InputError.at(
            "ranks", f"mpirun has started {mpi.launched()} processes; leave the number of ranks out"
        )
    if world:
        return MpiRanks(world, log)
    if ranks is None or ranks == 1:
        return Serial(log)
    return SubprocessRanks(ranks, log)
