"""Locks of folders: one process at a time works in one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .files import check_readable

if TYPE_CHECKING:
    from filelock import FileLock

LOCK = ".lock"
LARGEST = 1000  # bytes
# process and machine, where the file system has no locks and the file itself is one
HELD = re.compile(rb"(\d+\n.*)?", re.DOTALL)


def is_lock(path: Path) -> bool:
    """Return whether a file may be a lock of lmpchain, which holds nothing of a user's own."""
    try:
        check_readable(path, LARGEST)
        return not path.is_symlink() and HELD.fullmatch(path.read_bytes()) is not None
    except FileNotFoundError:
        return True
    except OSError:
        return False


def take_lock(folder: Path, patience_s: float = 0.0) -> FileLock | None:
    """Return the lock of a folder once it is free, None if another process keeps it.

    Raises
    ------
    InputError
        If a file, link or device of that name is not lmpchain's: a lock would empty it.
    """
    from filelock import FileLock, Timeout

    path = folder / LOCK
    if not is_lock(path):
        raise InputError.at(
            str(path), "is not lmpchain's, but a link, a device or a file with content: move it"
        )
    lock = FileLock(path, timeout=patience_s)
    try:
        lock.acquire()
    except Timeout:
        return None
    return lock
