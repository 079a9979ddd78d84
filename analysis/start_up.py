"""Waiting times before a computation: compilation, once per machine, and start of commands.

Processor time of whole processes, s, the least of repeats; what is compiled goes into a cache of
its own, which is empty for each repeat. Writes tables/start_up.md and, of the stages of a run with
the native engine, tables/stages.md, both of which docs/speed.md shows.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from figures import TABLES, write_table

SCENE = Path(__file__).parent / "scenes" / "fig5_1g.toml"
COMMANDS = {
    "`lmpchain run`, native": ["run", str(SCENE), "--engine", "native", "-o", "run.nc"],
    "`lmpchain compare`, all engines": ["compare", str(SCENE), "-o", "compare.png"],
    "`lmpchain plan`": ["plan", str(SCENE)],
}
# The timed process imports libraries one by one, then simulates the paper's scene.
STAGES = f"""
import json
import time
import warnings
warnings.simplefilter("ignore")
began = time.process_time()
import numba
numba_s = time.process_time() - began
import pydantic
from lmpchain.scene.scene import Scene
scenes_s = time.process_time() - began - numba_s

from numba.core import codegen, event

class Stopwatch(event.Listener):
    depth = 0
    seconds = 0.0
    def on_start(self, event):
        if self.depth == 0:
            self.began = time.process_time()
        self.depth += 1
    def on_end(self, event):
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.process_time() - self.began

def timed(library, name, stopwatch):
    work = getattr(library, name)
    def work_timed(*arguments):
        stopwatch.on_start(None)
        try:
            return work(*arguments)
        finally:
            stopwatch.on_end(None)
    setattr(library, name, work_timed)

kept = Stopwatch()
event.register("numba:compiler_lock", kept)
llvm = Stopwatch()
timed(codegen.CPUCodeLibrary, "add_llvm_module", llvm)
timed(codegen.CPUCodeLibrary, "_optimize_final_module", llvm)
timed(codegen.JITCodeLibrary, "_finalize_specific", llvm)
from lmpchain.cli import main
try:
    main(["run", {str(SCENE)!r}, "--engine", "native", "-o", "run.nc"])
finally:
    print(json.dumps([numba_s, scenes_s, llvm.seconds, kept.seconds, time.process_time() - began]))
"""
ROWS = (
    "numba, before it compiles anything",
    "models of scenes (Pydantic)",
    "LLVM",
    "the rest of numba's compilation, or reading what it has kept",
    "all else",
)


def processor_time(arguments: list[str], cache: Path) -> float:
    """Return the CPU time of a command with this cache folder, s."""
    # Python stores the byte code of modules, as it does for users.
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


def stages(cache: Path) -> list[float]:
    """Return the CPU times of the stages in a new process, s."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", STAGES],
            cwd=folder,
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
            check=True,
            capture_output=True,
            text=True,
        )
    numba_s, scenes_s, llvm_s, kept_s, all_s = json.loads(done.stdout.splitlines()[-1])
    return [numba_s, scenes_s, llvm_s, kept_s - llvm_s, all_s - numba_s - scenes_s - kept_s]


def time_commands(first: int, warm: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of commands, each with this number of repeats."""
    for name, arguments in COMMANDS.items():
        compiled_s = []
        for _ in range(first):
            with tempfile.TemporaryDirectory() as cache:
                compiled_s.append(processor_time(arguments, Path(cache)))
        with tempfile.TemporaryDirectory() as cache:
            processor_time(arguments, Path(cache))
            later_s = [processor_time(arguments, Path(cache)) for _ in range(warm)]
        yield name, f"{min(compiled_s):.1f}", f"{min(later_s):.2f}"


def time_stages(first: int, warm: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of stages."""
    compiled_s = []
    later_s = []
    for _ in range(first):
        with tempfile.TemporaryDirectory() as cache:
            compiled_s.append(stages(Path(cache)))
            later_s += [stages(Path(cache)) for _ in range(warm)]
    # The fastest whole process is used, so that its stages add up.
    columns = [min(repeats, key=sum) for repeats in (compiled_s, later_s)]
    for stage, *spent_s in zip(ROWS, *columns, strict=True):
        yield stage, *(f"{each:.2f}" for each in spent_s)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=3, help="repeats of what compiles")
    parser.add_argument("--warm", type=int, default=10, help="repeats of what has been compiled")
    given = parser.parse_args()
    repeats = given.first, given.warm
    columns = "first on a machine", "later"
    commands = time_commands(*repeats)
    write_table(TABLES / "start_up.md", ("processor time, s", *columns), commands)
    what = "stage of a run, native: processor time, s"
    write_table(TABLES / "stages.md", (what, *columns), time_stages(*repeats))


if __name__ == "__main__":
    main()
