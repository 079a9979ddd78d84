"""CPU time of a column in LAMMPS by the package, relative to `lmp` with the same deck.

Set-up is what a run of a single step takes, less that step; the loop is what all further ones take.
`lmp` reads the deck that the package wrote, without its dump. The step is given, and the loop of
the package holds the native runs that show the error. Both take turns; each number is the least of
several runs, and memory is what the largest of these takes beyond its libraries.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

import lmpchain
from lmpchain.benchmark.curves import machine
from lmpchain.engines.lammps.export import write_deck
from lmpchain.util.files import write_aside

KEPT = Path(__file__).with_suffix(".json")
STEP = 1e-7  # Seconds.
WARM_UP = 10  # Number of grains of a run that loads libraries.
COLUMNS = {100_000: 400, 1_000_000: 60}  # Number of steps by number of grains.


class Cost(NamedTuple):
    """CPU time of a run, s, and its memory, bytes."""

    seconds: float
    memory: float


def scene(grains: int, steps: int) -> lmpchain.Scene:
    """Return a column in which every grain moves from the start."""
    chain = lmpchain.Chain(grains=grains, material="glass", diameter=1e-3)
    velocity = np.random.default_rng(1).uniform(-1e-4, 1e-4, grains)
    # Grain N is fixed.
    velocity[-1] = 0.0
    return lmpchain.Scene(
        chain=chain,
        excitation=lmpchain.Profile(velocity=velocity),
        duration=steps * STEP,
        samples=2,
    )


def inside(grains: int, steps: int) -> Cost:
    """Run by the package in a separate process, whose memory is measured."""
    warnings.simplefilter("ignore")
    engine = lmpchain.engines.Lammps("verlet", step=STEP, diameter="physical")
    lmpchain.simulate(scene(WARM_UP, 1), engine)
    given = scene(grains, steps)
    before = resource.getrusage(resource.RUSAGE_SELF)
    lmpchain.simulate(given, engine)
    after = resource.getrusage(resource.RUSAGE_SELF)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    memory = 1024.0 * (after.ru_maxrss - before.ru_maxrss)
    return Cost(seconds, memory)


def alone(folder: str, steps: int) -> Cost:
    """Run `lmp` as the only child of a separate process."""
    lmp = shutil.which("lmp") or str(Path(sys.executable).with_name("lmp"))
    command = [lmp, "-in", "in.nodump", "-screen", "none", "-log", "none", "-var", "every"]
    subprocess.run([*command, str(steps)], cwd=folder, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Cost(used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss)


def in_process(function, *arguments) -> Cost:
    """Return the result of a function that runs in a new process."""
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh) as pool:
        return pool.submit(function, *arguments).result()


def measure(grains: int, steps: int, runs: int) -> dict[str, float]:
    """Return times of set-up and loop of both, s, and memory, bytes per grain."""
    least = {}
    with tempfile.TemporaryDirectory() as folder:
        deck = write_deck(scene(grains, steps), folder, step=STEP).read_text()
        lines = [line for line in deck.splitlines() if not line.startswith("dump")]
        Path(folder, "in.nodump").write_text("\n".join(lines))
        ways = {"lmp": (alone, folder), "lmpchain": (inside, grains)}
        for _ in range(runs):
            for name, (function, first) in ways.items():
                for count in (1, 1 + steps):
                    cost = in_process(function, first, count)
                    before = least.get((name, count), cost)
                    least[name, count] = Cost(*np.minimum(cost, before).tolist())
    row: dict[str, float] = {"grains": grains, "steps": steps}
    for name in ways:
        loop_s = least[name, 1 + steps].seconds - least[name, 1].seconds
        row |= {
            f"{name} setup_s": least[name, 1].seconds - loop_s / steps,
            f"{name} loop_s": loop_s,
            f"{name} bytes a grain": least[name, 1 + steps].memory / grains,
        }
    return row


def line(row: dict[str, float]) -> str:
    """Return a row of the table."""
    cells = []
    for what, unit in (("setup_s", "s"), ("loop_s", "s"), ("bytes a grain", "bytes")):
        ours, theirs = row[f"lmpchain {what}"], row[f"lmp {what}"]
        digits = 0 if unit == "bytes" else 2
        numbers = f"{ours:,.{digits}f} {unit}, {theirs:,.{digits}f} {unit}"
        cells.append(f"{numbers}: {ours / theirs:.2f}")
    setup, loop, memory = cells
    return f"| {row['grains']:,} | {setup} | {row['steps']} | {loop} | {memory} |"


def main() -> None:
    """Measure, print the table and store the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    given = parser.parse_args()
    rows = []
    print("| grains | set-up | steps | loop | memory a grain |\n" + "|---" * 5 + "|")
    for grains, steps in COLUMNS.items():
        rows.append(measure(grains, steps, given.runs))
        print(line(rows[-1]), flush=True)
    with write_aside(KEPT, overwrite=True) as aside:
        load = os.getloadavg()[0]
        kept = {"machine": f"{machine()}, load {load:.1f}", "rows": rows}
        aside.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
