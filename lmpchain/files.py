"""Files that are either whole or not there."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from .errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path to write to; move it to `path` when all went well, remove it when not.

    What is moved is on the disk, and so is its name. Raises `OSError` as it comes.
    """
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.partial{path.suffix}")
    try:
        yield aside
        _to_disk(aside)
        os.replace(aside, path)
        _to_disk(path.parent)
    finally:
        aside.unlink(missing_ok=True)


def _to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def write_aside(path: str | PathLike[str]) -> Iterator[Path]:
    """Do as `replacing` does, for a path that a user gave.

    Raises
    ------
    InputError
        If `path` cannot be written.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            raise InputError([(str(path), "is a folder or a device; name a file")])
        with replacing(path) as aside:
            yield aside
    except (OSError, RuntimeError) as error:  # HDF5 reports a full disk as either
        reason = getattr(error, "strerror", None) or error
        raise InputError([(str(path), f"cannot be written: {reason}")]) from error


def make_folder(path: str | PathLike[str]) -> Path:
    """Make a folder unless it is there; raises `InputError` if it cannot be made."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError([(str(path), f"is no folder and cannot be made one: {error.strerror}")]) from None
    return path
