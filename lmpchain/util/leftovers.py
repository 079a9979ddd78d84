"""What a kill would leave behind on the machine: shared memory, and ranks without a launcher."""

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

SHARED, NAMES = Path("/dev/shm"), "mpich_shm_"
OLD_S = 60.0  # by then every process of a run has attached to its shared memory
PR_SET_PDEATHSIG = 1  # of linux/prctl.h


def unname_shared_memory() -> None:
    """Remove the name of the shared memory of MPI, which lives on without as long as a process uses it.

    Only once all processes that share it have attached to it. MPICH itself removes it at the end, which a kill takes
    away.
    """
    for name in _used([Path("/proc/self")]):
        (SHARED / name).unlink(missing_ok=True)


@cache
def sweep_shared_memory() -> None:
    """Remove the shared memory that runs of this user have left which were killed as MPI started."""
    left = []
    for path in SHARED.glob(f"{NAMES}*"):
        with suppress(OSError):  # gone by now
            about = path.stat()
            if about.st_uid == os.getuid() and about.st_mtime < time.time() - OLD_S:
                left.append(path)
    if left:
        used = _used(path for path in Path("/proc").iterdir() if path.name.isdigit())
        for path in left:
            if path.name not in used:
                path.unlink(missing_ok=True)


def _used(processes: Iterable[Path]) -> set[str]:
    """Return the names of the shared memory that these processes have attached to."""
    names = set()
    for process in processes:
        with suppress(OSError):  # ended by now, or that of another user
            lines = (process / "maps").read_text().splitlines()
            names |= {Path(line.split(maxsplit=5)[-1]).name for line in lines if f"{SHARED / NAMES}" in line}
    return names


def end_with_parent() -> None:
    """Have the kernel end this process as soon as the one that started it is gone, whatever it waits for."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(ctypes.c_int(PR_SET_PDEATHSIG), ctypes.c_ulong(signal.SIGKILL))
