"""Atomic writing of files, locks of folders, checks of files, and hashes of their content."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import platform
import re
import secrets
import stat
import sys
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, shown

if TYPE_CHECKING:
    from filelock import BaseFileLock

SEAL = b"lmpchain sha256 "
UNSEALED = "it ends without the seal of lmpchain: copy it again, or save it anew"
SEALED = "seal"  # Key of the hash of a JSON file, which identifies files of lmpchain.
# Extended attribute with the size and the modification time of a file as written by lmpchain.
WRITTEN = "user.lmpchain.written"
LARGEST_JSON = 2**30  # Largest size of a file that describes a store, a run or a sweep, bytes.


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path; rename it to `path` on success, remove it on failure.

    The file and its name are flushed to the disk. Any `OSError` is raised unchanged. Temporary
    files of killed processes are removed by the next process that writes to the same folder.
    """
    _sweep(path.parent.absolute())
    # The name contains the writer, so that leftovers of killed processes can be identified.
    writer = f"{platform.node()}-{os.getpid()}"
    aside = path.with_name(f".{path.stem}.{writer}-{secrets.token_hex(4)}.partial{path.suffix}")
    try:
        yield aside
        # Flush the content before the name: after a power cut the name must not refer to an empty
        # file.
        _to_disk(aside)
        os.replace(aside, path)
        _to_disk(path.parent)
    finally:
        aside.unlink(missing_ok=True)


@cache
def _sweep(folder: Path) -> None:
    """Remove unfinished files of killed processes of this machine."""
    pattern = re.compile(
        rf"\..*\.{re.escape(platform.node())}-(\d+)-[0-9a-f]{{8}}\.partial", re.DOTALL
    )
    for entry in folder.iterdir():
        writer = pattern.match(entry.name)
        if writer and not Path("/proc", writer[1]).exists():
            entry.unlink(missing_ok=True)


def is_aside(name: str, final: str) -> bool:
    """Return whether a file is a temporary file of `replacing`."""
    final_path = Path(final)
    stem = re.escape(final_path.stem)
    pattern = rf"\.{stem}\..+-\d+-[0-9a-f]{{8}}\.partial{re.escape(final_path.suffix)}"
    return re.fullmatch(pattern, name) is not None


def _to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_to_disk(paths: Iterable[Path]) -> None:
    """Flush files, and their names in their folders, to the disk."""
    paths = list(paths)
    for path in (*paths, *{path.parent for path in paths}):
        _to_disk(path)


def check_readable(path: Path, largest: int) -> None:
    """Raise `OSError` unless a path is a regular file within a size limit, bytes."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is not a file, but a folder, a device or a pipe")
    if status.st_size > largest:
        raise OSError(errno.EFBIG, f"is larger than {largest / 2**20:.0f} MB")


def check_tree(folder: Path) -> None:
    """Raise `OSError` unless a folder contains only folders and regular files, without links."""
    if folder.is_symlink():
        raise OSError(errno.EINVAL, f"{folder.name} is a link; name what it points to")
    for at, folders, files in os.walk(folder):
        for name in (*folders, *files):
            try:
                mode = os.lstat(os.path.join(at, name)).st_mode
            except FileNotFoundError:
                # A running process has just renamed the file.
                continue
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise OSError(
                    errno.EINVAL,
                    f"{name} in it is a link, a device or a pipe, which lmpchain never writes",
                )


def is_foreign(path: Path) -> bool:
    """Return whether a file exists that lmpchain did not write, or that was changed since.

    A link is foreign, because a user made it. An empty file is not, because nothing is lost if it
    is replaced. On file systems without extended attributes, only files with a seal are recognised
    as files of lmpchain.
    """
    if not os.path.lexists(path):
        return False
    if path.is_symlink():
        return True
    if path.stat().st_size == 0:
        return False
    try:
        return os.getxattr(path, WRITTEN) != _written(path)
    except (OSError, AttributeError):
        return not _is_sealed(path)


def _written(path: Path) -> bytes:
    """Return the value of the attribute `WRITTEN` for the current state of a file."""
    status = path.stat()
    return f"{status.st_size} {status.st_mtime_ns}".encode()


def _is_sealed(path: Path) -> bool:
    try:
        check_seal(path)
    except (OSError, ValueError):
        return False
    return True


def check_not_foreign(path: Path, overwrite: bool) -> None:
    """Raise `InputError` if a file is foreign, unless `overwrite` allows its replacement."""
    if not overwrite and is_foreign(path):
        cure = "name another file, or pass overwrite=True to replace it"
        raise InputError.at(str(path), f"is a file that lmpchain did not write: {cure}")


@contextmanager
def write_aside(path: str | PathLike[str], overwrite: bool = False) -> Iterator[Path]:
    """Write a user's file atomically, as `replacing` does, and mark it as written by lmpchain.

    Raises
    ------
    InputError
        If `path` cannot be written, or if it is a foreign file and `overwrite` is false.
    """
    path = expanded(path)
    try:
        if path.exists() and not path.is_file():
            raise InputError.at(str(path), "is a folder or a device; name a file")
        check_not_foreign(path, overwrite)
        with replacing(path) as aside:
            yield aside
            with suppress(OSError, AttributeError):
                os.setxattr(aside, WRITTEN, _written(aside))
    except (OSError, RuntimeError) as error:
        # HDF5 reports a full disk with either error.
        reason = getattr(error, "strerror", None) or error
        raise InputError.at(str(path), f"cannot be written: {reason}") from error


def seal(content: Any) -> bytes:
    """Return the seal to append to a file: a hash of its content, which HDF5 ignores."""
    return SEAL + hashlib.sha256(content).digest()


def check_seal(path: Path) -> None:
    """Raise `ValueError` unless the content of a file matches the seal at its end.

    Files without a valid seal must not be opened by HDF5, which may search damaged files endlessly
    and cannot be interrupted.
    """
    length = len(seal(b""))
    # An empty file cannot be mapped.
    if path.stat().st_size < length:
        raise ValueError(UNSEALED)
    # The file is mapped, because it may exceed the memory.
    content = np.memmap(path, np.uint8, "r")
    end = content[-length:].tobytes()
    if not end.startswith(SEAL):
        raise ValueError(UNSEALED)
    if end != seal(content[:-length]):
        raise ValueError("it was changed after it was written: copy it again, or save it anew")


def sealed_json(record: Mapping[str, Any]) -> str:
    """Return a record as JSON with a seal, which identifies a file of lmpchain."""
    rest = {key: value for key, value in record.items() if key != SEALED}
    return json.dumps(rest | {SEALED: _json_seal(rest)}, indent=2, allow_nan=False) + "\n"


def read_sealed_json(path: Path) -> dict[str, Any] | None:
    """Return the record of a JSON file; None unless lmpchain wrote the file."""
    try:
        check_readable(path, LARGEST_JSON)
        record = dict(json.loads(path.read_bytes()))
        return record if record.pop(SEALED) == _json_seal(record) else None
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def _json_seal(record: Mapping[str, Any]) -> str:
    # Numbers and texts that were read are written in the same form.
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def unpack(content: bytes | memoryview) -> dict[str, np.ndarray]:
    """Return the arrays of a `numpy.savez` file; raise an error unless they are plain."""
    with zipfile.ZipFile(BytesIO(content)) as packed:
        items = packed.infolist()
        return {item.filename.removesuffix(".npy"): _plain_array(packed, item) for item in items}


def unpack_one(path: Path, name: str) -> np.ndarray:
    """Return one array of a `numpy.savez` file, checked as in `unpack`."""
    check_readable(path, sys.maxsize)
    with zipfile.ZipFile(path) as packed:
        return _plain_array(packed, packed.getinfo(f"{name}.npy"))


def _plain_array(packed: zipfile.ZipFile, item: zipfile.ZipInfo) -> np.ndarray:
    # A small file could unpack to more than the memory.
    if item.compress_type != zipfile.ZIP_STORED:
        raise ValueError("it contains compressed arrays")
    data = BytesIO(packed.read(item))
    np.lib.format.read_magic(data)
    shape, columns_first, dtype = np.lib.format.read_array_header_1_0(data)
    if dtype.hasobject or columns_first:
        raise ValueError("it contains arrays that are not plain")
    return np.frombuffer(data.read(), dtype).reshape(shape).copy()


def expanded(name: str | PathLike[str]) -> Path:
    """Return a name as a path, with a leading ~ or ~user replaced as in a shell."""
    path = Path(name)
    try:
        return path.expanduser()
    # There is no such user, so the name itself begins with ~.
    except RuntimeError:
        return path


def path_of(name: Any, key: str = "folder") -> Path:
    """Return a name as a path; raise `InputError` if it is not a valid name."""
    if not isinstance(name, str | PathLike) or not str(name):
        raise InputError.at(key, f"must be a name in quotes (got {shown(name)})")
    path = expanded(name)
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        # The name may have 300 letters, or a zero byte.
        reason = getattr(error, "strerror", None) or error
        raise InputError.at(key, f"{shown(str(path))} cannot be used: {reason}") from None
    return path


def make_folder(name: str | PathLike[str]) -> Path:
    """Create a folder unless it exists; raise `InputError` if this is impossible."""
    path = path_of(name)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError.at(
            str(path), f"is not a folder and cannot be made one: {error.strerror}"
        ) from None
    return path


LOCK = ".lock"
LARGEST = 1000  # Bytes.
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
        If a file, link or device with the name of the lock was not made by lmpchain, because a lock
        would delete its content.
    """
    from filelock import FileLock, SoftFileLock, Timeout

    path = folder / LOCK
    if not is_lock(path):
        raise InputError.at(
            str(path), "is not a lock of lmpchain, but a link, a device or a file of yours: move it"
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
    """Return the process that holds a folder's lock as text, if the lock names it.

    Only a lock on a file system without `flock` names the process. Such a lock remains if the
    process is killed.
    """
    try:
        number, host, *_ = (folder / LOCK).read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return "another process"
    return f"process {number} on {host} (if it has ended, remove {folder / LOCK})"
