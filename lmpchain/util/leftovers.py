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
    """Remove the name of the shared memory of MPI, which lasts without as long as it is used.

    Only once all processes that share it have attached to it. MPICH itself removes it at the end,
    which a kill takes away.
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
                # gone by now
                status = path.lstat()
                if status.st_uid == os.getuid() and status.st_mtime < time.time() - OLD_S:
                    leftovers.append(path)
    if leftovers:
        # what a living process has mapped stays, however old
        used = _names_in_use(path for path in Path("/proc").iterdir() if path.name.isdigit())
        for path in leftovers:
            if path.name not in used:
                path.unlink(missing_ok=True)


def _names_in_use(processes: Iterable[Path]) -> set[str]:
    """Return the names of the shared memory that these processes have attached to."""
    names = set()
    for process in processes:
        with suppress(OSError):
            # ended by now, or that of another user
            lines = (process / "maps").read_text().splitlines()
            names |= {
                Path(line.split(maxsplit=5)[-1]).name
                for line in lines
                if f"{SHARED_MEMORY}/" in line
            }
    return names


def end_with_parent() -> None:
    """Have the kernel end this process as soon as its parent is gone."""
    # PR_SET_PDEATHSIG of linux/prctl.h
    death_signal = 1
    # elsewhere a kill of the launcher leaves ranks behind
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(ctypes.c_int(death_signal), ctypes.c_ulong(signal.SIGKILL))
