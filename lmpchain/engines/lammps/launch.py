"""Choice of the communicator of a LAMMPS run."""

from __future__ import annotations

from ...errors import InputError
from ...util import mpi
from .communicators import MpiRanks, Serial
from .subprocess_ranks import SubprocessRanks

Communicator = Serial | MpiRanks | SubprocessRanks


def gather(ranks: int | None, log: str) -> Communicator:
    """Return the ranks of a surrounding mpirun, ranks started for the run, or this process.

    Raises
    ------
    InputError
        If they are not to be had.
    EngineUnavailable
        If MPI does not work here.
    """
    world = mpi.current_world()
    if mpi.count_processes() > 1 and ranks not in (None, 1 if world is None else world.size):
        raise InputError.at(
            "ranks",
            f"mpirun has started {mpi.count_processes()} processes; leave the number of ranks out",
        )
    if world:
        return MpiRanks(world, log)
    if ranks is None or ranks == 1:
        return Serial(log)
    return SubprocessRanks(ranks, log)
