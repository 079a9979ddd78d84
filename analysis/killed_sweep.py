"""A large sweep that is killed repeatedly ends with the bytes of an undisturbed one.

Arrival times and largest velocities of random columns like the paper's are kept, as in
`sweep_speed.py`. The process that leads is killed when as many shards are written as chance says;
the memory of every process is watched. Each folder is hashed and removed; 10^6 scenes take some
4 GB meanwhile, so name a folder with room for them.
"""

import argparse
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

SWEEP = """
keep = ["arrival_time", "peak_velocity"]
[scene.chain]
grains = 120
diameter = 1e-3
[scene.excitation]
kind = "impulse"
velocity = 8.57e-4
[scene.recording]
duration = 1e-4
[disorder]
m = 20
seed = 1
realisations = {scenes}
"""
LOOK_S = 0.2  # Time between two checks of a sweep, s.


def shards(folder: Path) -> int:
    """Return the number of complete shards of a sweep."""
    return sum(1 for _ in folder.glob("*/results.zarr/reason/c/*"))


def digests(folder: Path) -> dict[str, str]:
    """Return the hash of every file except locks, by name."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != ".lock":
            with open(path, "rb") as opened:
                found[str(path.relative_to(folder))] = hashlib.file_digest(
                    opened, "sha256"
                ).hexdigest()
    return found


def swept(
    source: Path, folder: Path, workers: int, until: int | None = None
) -> tuple[bool, dict[int, int]]:
    """Run a sweep and kill its leading process once this number of shards is complete.

    Returns whether it came to its end, and the most memory that any of its processes has had, MB,
    by the shards done.
    """
    command = [
        sys.executable,
        "-m",
        "lmpchain.cli",
        "sweep",
        source,
        "-o",
        folder,
        "--workers",
        str(workers),
    ]
    process = psutil.Popen([*map(str, command)], stdout=subprocess.DEVNULL)
    memory: dict[int, int] = {}
    family: list[psutil.Process] = []
    while process.poll() is None:
        done = shards(folder)
        try:
            family = [process, *process.children(recursive=True)]
            memory[done] = max(
                memory.get(done, 0), *(each.memory_info().rss >> 20 for each in family)
            )
        except psutil.NoSuchProcess:  # The process is ending.
            pass
        if until is not None and done >= until:
            os.kill(process.pid, signal.SIGKILL)
        time.sleep(LOOK_S)
    psutil.wait_procs(family)  # Workers end with the leading process.
    if process.returncode not in (0, -signal.SIGKILL):
        raise SystemExit(f"the sweep ended with the code {process.returncode}")
    return process.returncode == 0, memory


def main() -> None:
    """Print the results of the kills, and the memory used."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=20_000)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument(
        "--workers",
        type=int,
        default=2,
        help="of the sweep that is killed; the other one has one more",
    )
    parser.add_argument(
        "--folder", type=Path, help="where there is room; by default that of temporary files"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        source = Path(name, "sweep.toml")
        out = Path(name, "out")
        source.write_text(SWEEP.format(scenes=arguments.scenes), encoding="utf-8")
        began = time.perf_counter()
        _, memory = swept(source, out, arguments.workers + 1)
        seconds = time.perf_counter() - began
        found = digests(out)
        total = shards(out)
        rate = f"{seconds:.0f} s, {arguments.scenes / seconds:.0f} scenes a second"
        print(
            f"{arguments.scenes} scenes on {arguments.workers + 1} workers: {rate}, in "
            f"{len(found)} files"
        )
        halves = [
            max((mb for n, mb in memory.items() if (2 * n < total) == first), default=0)
            for first in (True, False)
        ]
        print(
            f"most memory of a process, MB: {halves[0]} in the first half, {halves[1]} in the "
            "second",
            flush=True,
        )
        shutil.rmtree(out)
        kills = 0
        for moment in sorted(rng.randrange(total) for _ in range(arguments.kills)):
            ended, _ = swept(source, out, arguments.workers, moment)
            kills += not ended
            print(
                f"killed at {shards(out)} of {total} shards" if not ended else "it was at its end",
                flush=True,
            )
        swept(source, out, arguments.workers)
        again = digests(out)
    unlike = sorted(key for key in found.keys() | again.keys() if found.get(key) != again.get(key))
    if unlike:
        raise SystemExit(f"{len(unlike)} files differ: {', '.join(unlike[:5])}")
    print(f"{kills} kills, {arguments.workers} workers: the same bytes in all {len(again)} files")


if __name__ == "__main__":
    main()
