"""Leftovers of killed runs: files of MPI, and ranks without a launcher."""

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

SHARED_MEMORY = Path("/dev/shm")
MPICH = "mpich_shm_"  # begins the names of its shared memory
TEMPORARY = Path("/tmp")  # MPICH does not look at TMPDIR
OLD_S = 60.0  # by then every rank of a run has started


def unname_shared_memory() -> None:
    """Remove the name of MPI's shared memory, which stays usable for attached processes.

    Call this only after all processes have attached to it. MPICH itself removes the name at the
    end of a run, but not after a kill.
    """
    for name in _names_in_use([Path("/proc/self")]):
        if name.startswith(MPICH):
            (SHARED_MEMORY / name).unlink(missing_ok=True)


@cache
def remove_leftovers() -> None:
    """Remove leftovers of killed MPI runs of this user: shared memory, files of its launcher.

    A rank that starts later than `OLD_S` after its launcher finds out by itself what that file
    says.
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
        # Shared memory that a living process has mapped stays, whatever its age.
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
