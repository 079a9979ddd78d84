"""Runs as processes of their own, and what they must end with."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from lmpchain import Scene, Trajectory
from lmpchain.simulation.run_folder import status
from lmpchain.util import mpi

COMMAND = [sys.executable, "-m", "lmpchain.cli"]


def start(*words: object, ranks: int = 1, **options) -> subprocess.Popen[str]:
    """Start a command of lmpchain, under mpirun if there are several ranks."""
    under = [mpi.launcher(), "-n", str(ranks)] if ranks > 1 else []
    command = [*under, *COMMAND, *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options)


def finish(*words: object, ranks: int = 1, **options) -> tuple[int, str]:
    """Run a command of lmpchain; return its exit code and what it said."""
    process = start(*words, ranks=ranks, **options)
    said, _ = process.communicate(timeout=300)
    return process.returncode, said


def at_work(folder: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a run has kept some samples."""
    while process.poll() is None:
        if (folder / "scene.toml").exists() and status(folder)["samples_done"]:
            return
        time.sleep(0.02)
    raise AssertionError("it ended too early")


def until(condition: Callable[[], bool], within: float = 60) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + within
    while not condition():
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.02)


def same(answer: Trajectory, truth: Trajectory) -> bool:
    """Say whether two answers agree to the last bit."""
    names = ("time", "displacement", "velocity", "grains")
    bits = all(getattr(answer, name)[:].tobytes() == getattr(truth, name)[:].tobytes() for name in names)
    return bits and answer.error_estimate == truth.error_estimate and answer.scene == truth.scene


def write(scene: Scene, folder: Path) -> Path:
    """Write a scene file."""
    scene.to_toml(folder / "in.toml")
    return folder / "in.toml"


def processes(mark: str) -> list[int]:
    """Return the processes that have this in their environment."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and mark.encode() in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue
    return [pid for pid in found if pid != os.getpid()]
