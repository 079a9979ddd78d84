"""When, by which command and to which tolerance a saved run was made, as far as it says so."""

from __future__ import annotations

import json
from contextlib import suppress
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path

from ..util.files import LARGEST_JSON, check_readable

UNKNOWN = {"date": "not recorded", "command": "not recorded"}


def origin(path: str | PathLike[str] | None) -> dict[str, str]:
    """Return date and command of a saved run, a file or a folder; the date of a file that does not say."""
    found = dict(UNKNOWN)
    if path is None:
        return found
    path = Path(path)
    with suppress(OSError, ValueError):
        found["date"] = (
            f"{datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(' ', 'minutes')[:16]} "
            "UTC (file)"
        )
    # whatever else it may hold
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        date, command = _of_folder(path) if path.is_dir() else _of_file(path)
        found |= {"date": date, "command": command}
    return found


def _of_folder(path: Path) -> tuple[str, str]:
    check_readable(path / "run.json", LARGEST_JSON)
    first = json.loads((path / "run.json").read_bytes())["sessions"][0]
    return _readable(str(first["began"])), str(first["command"])


def _of_file(path: Path) -> tuple[str, str]:
    """Return what the attribute `history` of a NetCDF file says."""
    import h5py

    with h5py.File(path, "r") as file:
        date, _, command = str(file.attrs["history"]).partition(" ")
    return _readable(date), command


def _readable(date: str) -> str:
    return f"{datetime.fromisoformat(date).astimezone(UTC).isoformat(' ', 'minutes')[:16]} UTC"
