"""Date and command of a saved run, from its files."""

from __future__ import annotations

import json
from contextlib import suppress
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path

from ..util.files import check_readable, check_seal, expanded

NOT_RECORDED = {"date": "not recorded", "command": "not recorded"}


def origin(path: str | PathLike[str] | None) -> dict[str, str]:
    """Return the date and command of a saved run; the date of the file if none is stored."""
    answer = dict(NOT_RECORDED)
    if path is None:
        return answer
    path = expanded(path)
    with suppress(OSError, ValueError):
        written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        answer["date"] = f"{_in_minutes(written)} (file)"
    # The file may have any content.
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        date, command = _of_folder(path) if path.is_dir() else _of_file(path)
        answer = {"date": _in_minutes(datetime.fromisoformat(date)), "command": command}
    return answer


def _of_folder(path: Path) -> tuple[str, str]:
    # The limit in bytes exceeds the length of any such file.
    check_readable(path / "run.json", 2**24)
    first = json.loads((path / "run.json").read_bytes())["sessions"][0]
    return str(first["began"]), str(first["command"])


def _of_file(path: Path) -> tuple[str, str]:
    """Return the date and command from the attribute `history` of a NetCDF file."""
    import h5py

    check_seal(path)
    with h5py.File(path, "r") as file:
        date, _, command = str(file.attrs["history"]).partition(" ")
    return date, command


def _in_minutes(date: datetime) -> str:
    return f"{date.astimezone(UTC).isoformat(' ', 'minutes')[:16]} UTC"
