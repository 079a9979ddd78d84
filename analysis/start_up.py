"""What a user waits for before anything is computed: compiling, once for a machine, and commands.

Processor time of whole processes, s, the least of repeats; what is compiled goes into a cache of
its own, which is empty for each repeat. Writes tables/start_up.md, which docs/speed.md shows.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

TABLE = Path(__file__).parent / "tables" / "start_up.md"
SCENE = Path(__file__).parent / "scenes" / "fig5_1g.toml"
COMMANDS = {
    "`lmpchain run`, native": ["run", str(SCENE), "--engine", "native", "-o", "run.nc"],
    "`lmpchain compare`, all engines": ["compare", str(SCENE), "-o", "compare.png"],
    "`lmpchain plan`": ["plan", str(SCENE)],
}


def processor_time(arguments: list[str], cache: Path) -> float:
    """Return what a command takes with this folder of compiled code, s."""
    # Python keeps the modules that it has read, as it does for users
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "lmpchain.cli", *arguments],
            cwd=folder,
            env=environment | {"NUMBA_CACHE_DIR": str(cache)},
            check=True,
            capture_output=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=3, help="repeats of what compiles")
    parser.add_argument("--warm", type=int, default=10, help="repeats of what has been compiled")
    given = parser.parse_args()
    lines = ["| processor time, s | first on a machine | later |", "|---|---|---|"]
    for name, arguments in COMMANDS.items():
        first = []
        for _ in range(given.first):
            with tempfile.TemporaryDirectory() as cache:
                first.append(processor_time(arguments, Path(cache)))
        with tempfile.TemporaryDirectory() as cache:
            processor_time(arguments, Path(cache))
            later = [processor_time(arguments, Path(cache)) for _ in range(given.warm)]
        lines.append(f"| {name} | {min(first):.1f} | {min(later):.2f} |")
    text = "\n".join(lines)
    print(text)
    TABLE.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
