"""The scene of short sweeps, a long sweep for interruptions, and its state from outside."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from lmpchain import InputError, load_sweep

# The scene of short sweeps.
SCENE: dict[str, Any] = {
    "chain": {"grains": 6, "material": "glass", "diameter": 1e-3},
    "excitation": {"kind": "impulse", "velocity": 1e-4},
    "recording": {"duration": 5e-6, "samples": 3},
}


def long_sweep(folder: Path, count: int) -> Path:
    """Write a sweep of this number of scenes, with about forty scenes in a task."""
    path = folder / "sweep.toml"
    path.write_text(
        f"""
        keep = ["velocity", "peak_velocity"]
        [scene.chain]
        grains = 120
        diameter = 1e-3
        [scene.excitation]
        kind = "impulse"
        velocity = 8.57e-4
        [scene.recording]
        duration = 1e-4
        samples = 801
        grains = [1, 10, 20]
        [disorder]
        m = 20
        seed = 1
        realisations = {count}
        """
    )
    return path


def done(folder: Path) -> int:
    """Return the number of finished scenes of a sweep; -1 before its start."""
    with suppress(InputError):
        return int((load_sweep(folder).reason != "not done").sum())
    return -1


def contents(folder: Path) -> dict[str, bytes]:
    """Return the contents of a folder by file, without locks."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
