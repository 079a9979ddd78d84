"""How often intervals of averages cover what they should: beads between walls, struck at random.

    python analysis/interval_coverage.py

The kinetic energy of one bead is on average its share of that of the ensemble of constant energy,
as in `averages.py`, whose chains these are, and which draws those of 24 beads. Writes
tables/coverage.md, which docs/averages.md shows.
"""

import math
from collections.abc import Iterator

import numpy as np
from averages import NAME, average, beads
from figures import TABLES, write_table

CASES = (  # beads; time of motion, s
    (10, 0.1),
    (10, 0.02),
    (10, 0.005),
    (10, 0.002),
    (10, 0.001),
    (10, 0.0005),
    (5, 0.05),
    (5, 0.01),
)
CHAINS = 1000
BEAD = 3


def cover(grains: int, time: float) -> tuple[float, float]:
    """Return how many intervals cover, and how many chains have one, both in per cent."""
    name = f"{NAME}:{BEAD}"
    covers = []
    for seed in range(CHAINS):
        scene = beads(grains, seed)
        low, high = average(scene, name, time).interval[name]
        if math.isfinite(high):
            covers.append(low < 5 / 9 * scene.energy / grains < high)
    return 100 * float(np.mean(covers)), 100 * len(covers) / CHAINS


def measure() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table."""
    for grains, time in CASES:
        covering, known = cover(grains, time)
        yield str(grains), f"{1e3 * time:g} ms", f"{covering:.1f}", f"{known:.1f}"


if __name__ == "__main__":
    columns = ("beads", "time", "intervals that cover, %", "chains that have an interval, %")
    write_table(TABLES / "coverage.md", columns, measure())
