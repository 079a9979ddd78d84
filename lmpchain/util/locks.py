"""Locks of folders, so that one process at a time works in a folder."""

from __future__ import annotations

import errno
import fcntl
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from .files import check_readable

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK = ".lock"
LARGEST = 1000  # bytes
# Process and machine, if the file system has no locks and the file itself is the lock.
HELD = re.compile(rb"(\d+\n.*)?", re.DOTALL)


# Errors of file systems without `flock`, such as network file systems.
UNSUPPORTED = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)


def is_lock(path: Path) -> bool:
    """Return whether a file may be a lock of lmpchain, without content of the user."""
    try:
        check_readable(path, LARGEST)
        return not path.is_symlink() and HELD.fullmatch(path.read_bytes()) is not None
    except FileNotFoundError:
        return True
    except OSError:
        return False


def take_lock(folder: Path, patience_s: float = 0.0) -> BaseFileLock | None:
    """Return the lock of a folder once it is free; None if another process keeps it.

    Raises
    ------
    InputError
        If a file, link or device of that name is not lmpchain's: a lock would empty it.
    """
    from filelock import FileLock, SoftFileLock, Timeout

    path = folder / LOCK
    if not is_lock(path):
        raise InputError.at(
            str(path), "is not lmpchain's, but a link, a device or a file with content: move it"
        )
    lock = (FileLock if has_locks(folder) else SoftFileLock)(path, timeout=patience_s)
    try:
        lock.acquire()
    except Timeout:
        return None
    return lock


def has_locks(folder: Path) -> bool:
    """Return whether the file system of a folder supports `flock`."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in UNSUPPORTED
    finally:
        os.close(descriptor)
    return True


def describe_holder(folder: Path) -> str:
    """Return the process that holds the lock of a folder in words, if the lock names it.

    Only locks on file systems without `flock` name it, and they outlive a killed process.
    """
    try:
        number, host, *_ = (folder / LOCK).read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return "another process"
    return f"process {number} on {host} (if it has ended, remove {folder / LOCK})"
