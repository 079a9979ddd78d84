"""Files of a run folder: those that lmpchain wrote, known by their seals, and their removal."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from os import PathLike
from pathlib import Path

from .. import engines
from ..errors import InputError, short
from ..trajectory import zarr_store as store
from ..util.files import is_aside, path_of, read_sealed_json, replacing
from ..util.locks import LOCK, describe_holder, is_lock, take_lock
from ..util.provenance import checksum, checksums
from . import checkpoints
from .task import AT_WORK, RUN, SCENE, STATUS, check_run, is_run, is_sealed, resume_command

SUMS = "SHA256SUMS"
SUM = re.compile(r"([0-9a-f]{64})  (.+)")  # a line of it
# files of the Zarr store: descriptions and chunks, also half written ones
IN_STORE = re.compile(
    rf"{re.escape(store.NAME)}/"
    r"(([^/]+/)?zarr(\.json|\.[0-9a-f]{32}\.partial)|[^/]+/c(/\d+)+(\.[0-9a-f]{32}\.partial)?)"
)
FOLDER_IN_STORE = re.compile(rf"{re.escape(store.NAME)}(/[^/]+(/c(/\d+)*)?)?")
NAMED = 5  # files that an error line names


def check_new(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder that is to be made; raises `InputError` if it cannot be."""
    path = path_of(folder)
    if path.exists() and not path.is_dir():
        raise InputError.at(str(folder), "is a file; choose another name for the run folder")
    if is_run(path) and is_sealed(path):
        cure = f"go on with it, {resume_command(folder)}, or choose another folder"
        raise InputError.at(str(folder), f"holds a run already: {cure}")
    # what is left of a run that was killed before it wrote its scene does no harm
    if foreign := strangers(path):
        raise InputError.at(
            str(folder),
            f"is neither empty nor a run folder: {_in_words(foreign)} {_are(foreign)} not "
            "lmpchain's, or changed since; choose another",
        )
    return path


def check_replaceable(folder: str | PathLike[str]) -> Path:
    """Return the path of a run folder; raises `InputError` if it holds anything else."""
    path = check_run(folder)
    if foreign := strangers(path):
        raise InputError.at(
            str(folder),
            f"is not replaced: {_in_words(foreign)} there {_are(foreign)} not lmpchain's, or "
            "changed since; move them away, or name another folder",
        )
    return path


def _in_words(paths: list[Path]) -> str:
    names = [short(path) for path in paths[:NAMED]]
    return ", ".join(names) + (f" and {len(paths) - NAMED} more" if len(paths) > NAMED else "")


def _are(paths: list[Path]) -> str:
    return "are" if len(paths) > 1 else "is"


def strangers(folder: Path) -> list[Path]:
    """Return what is in a folder, below it, and not as lmpchain writes it to a run folder."""
    sums = _read_sums(folder)
    return [
        path.relative_to(folder)
        for path in sorted(folder.rglob("*"))
        if not _is_own(folder, path.relative_to(folder), sums)
    ]


def _is_own(folder: Path, name: Path, sums: dict[str, str]) -> bool:
    """Return whether lmpchain wrote a file, or made a folder, and it is as it was."""
    path = folder / name
    text = name.as_posix()
    if path.is_symlink() or not (path.is_dir() or path.is_file()):
        return False
    if path.is_dir():
        parents = {Path(file).parent for file in _inputs()}
        return FOLDER_IN_STORE.fullmatch(text) is not None or name in parents
    # zarr has hashes of its own in them
    if IN_STORE.fullmatch(text) or _is_aside(name):
        return True
    if text in (RUN, STATUS):
        return read_sealed_json(path) is not None
    if text == SCENE:
        return is_sealed(folder)
    if text == SUMS:
        return bool(sums)
    if text in checkpoints.NAMES:
        return checkpoints.is_intact(path)
    if text == LOCK:
        return is_lock(path)
    if text in sums:
        return text in _names() and checksum(path) == sums[text]
    # a log grows until the run is finished
    return text in _logs()


def _is_aside(name: Path) -> bool:
    finals = (Path(final) for final in _names())
    return any(name.parent == final.parent and is_aside(name.name, final.name) for final in finals)


def _inputs() -> set[str]:
    return {name for engine in engines.names() for name in engines.get(engine).inputs}


def _logs() -> set[str]:
    return {name for engine in engines.names() for name in engines.get(engine).logs}


def _names() -> set[str]:
    """Return the names that files of a run folder may have, but for those of the store."""
    return {SCENE, RUN, STATUS, SUMS, *checkpoints.NAMES, *_inputs(), *_logs()}


def _read_sums(folder: Path) -> dict[str, str]:
    """Return the hashes that a run folder lists, by name; none of a file that is another's."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return {}
    matches = [SUM.fullmatch(line) for line in lines]
    return {match[2]: match[1] for match in matches if match} if all(matches) else {}


def write_sums(folder: Path, finished: bool) -> None:
    """Write the hashes of what is final: the engine's input, and in the end all but the status."""
    names = _inputs()
    if finished:
        names |= _names() - {STATUS, SUMS, *checkpoints.NAMES}
    by_name = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    paths = [
        path
        for name, path in by_name.items()
        if name in names or (finished and IN_STORE.fullmatch(name))
    ]
    if paths:
        with replacing(folder / SUMS) as aside:
            aside.write_text(checksums(folder, paths), encoding="utf-8")


def half_written(folder: Path) -> Iterator[Path]:
    """Yield files of a run folder that a process was writing as it was killed."""
    for path in folder.rglob("*.partial*"):
        name = path.relative_to(folder)
        if (name.suffix == ".partial" and IN_STORE.fullmatch(name.as_posix())) or _is_aside(name):
            yield path


def clear(folder: Path) -> None:
    """Remove what lmpchain wrote to a run folder; the folder stays, and what is not lmpchain's."""
    sums = _read_sums(folder)
    present = [path.relative_to(folder) for path in sorted(folder.rglob("*"))]
    own = [name for name in present if _is_own(folder, name, sums)]
    # the task goes last: a kill on the way leaves a run folder, which can be replaced again
    last = [Path(name) for name in (SCENE, RUN, LOCK)]
    files = [name for name in own if not (folder / name).is_dir() and name not in last]
    for name in (*files, *(name for name in last if name in own)):
        (folder / name).unlink(missing_ok=True)
    for name in reversed(own):
        if (folder / name).is_dir():
            # a file that came meanwhile keeps it
            with suppress(OSError):
                (folder / name).rmdir()


def remove(folder: Path) -> None:
    """Remove a run from its folder, which stays.

    Raises
    ------
    InputError
        If another process is at work there, or it holds what lmpchain did not write.
    """
    check_replaceable(folder)
    lock = take_lock(folder)
    if lock is None:
        raise InputError.at(str(folder), AT_WORK.format(holder=describe_holder(Path(folder))))
    try:
        # under its lock, so that no process writes to it meanwhile
        clear(folder)
    finally:
        lock.release()
