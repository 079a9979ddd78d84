"""Cost of the native trials that find the LAMMPS step, relative to the LAMMPS runs.

    python analysis/lammps_attempts.py [--repeats 3]

Processor time of `simulate` with LAMMPS to a tolerance, the least of some repeats in one process,
and of the trials in it; and how many attempts were run. Writes tables/lammps_attempts.md, which
docs/speed.md shows.
"""

import argparse
import time
import warnings
from collections.abc import Iterator

from figures import TABLES, write_table
from lost_attempts import agitated
from start_up import SCENE

from lmpchain import Scene, simulate
from lmpchain.engines import Lammps

COLUMNS = ("scene", "tolerance", "native trials, s", "all, s", "trials / all", "attempts in LAMMPS")


class Timed(Lammps):
    """LAMMPS engine with the time of its trials, s, and the number of started runs."""

    trials_s = 0.0
    started = 0

    def propose(self, *arguments):
        """Find a step."""
        began = time.process_time()
        candidate = super().propose(*arguments)
        self.trials_s = time.process_time() - began
        return candidate

    def start(self, *arguments):
        """Start a run."""
        self.started += 1
        return super().start(*arguments)


def spend(scene: Scene, tolerance: float) -> tuple[float, float, int]:
    """Return the CPU time of the trials and in total, s, and the number of runs."""
    engine = Timed()
    began = time.process_time()
    simulate(scene, engine, tolerance)
    return engine.trials_s, time.process_time() - began, engine.started


def measure(count: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table, each with this number of repeats."""
    paper = Scene.from_toml(SCENE)
    cases = [
        ("the paper's", paper, 1e-3),
        ("the paper's", paper, 1e-6),
        ("300 grains that all move, 0.5 ms", agitated(300).replace(duration=5e-4), 1e-3),
    ]
    spend(paper, 1e-3)  # This call compiles, and loads LAMMPS.
    for name, scene, tolerance in cases:
        repeats = [spend(scene, tolerance) for _ in range(count)]
        trials_s = min(repeat[0] for repeat in repeats)
        all_s = min(repeat[1] for repeat in repeats)
        spent = f"{trials_s:.2g}", f"{all_s:.2g}", f"{trials_s / all_s:.3f}"
        yield name, f"{tolerance:.0e}", *spent, str(repeats[0][2])


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    write_table(TABLES / "lammps_attempts.md", COLUMNS, measure(given.repeats))


if __name__ == "__main__":
    main()
