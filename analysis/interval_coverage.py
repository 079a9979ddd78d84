"""Coverage of intervals of time averages: beads between walls with random strikes.

    python analysis/interval_coverage.py

The kinetic energy of one bead is on average its share of that of the ensemble of constant energy,
as in `averages.py`, whose chains these are, and which draws those of 24 beads; energies of the
whole chain follow Beta's distribution, and directions of the velocities are all alike. Writes
tables/coverage.md and tables/coverage_of_quantities.md, which docs/averages.md shows.
"""

import math
import warnings
from collections.abc import Iterator

import numpy as np
from averages import NAME, average, beads, ensemble
from figures import TABLES, write_table
from scipy import stats

from lmpchain import averages

CASES = (  # Number of beads, and duration, s.
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
# Number of beads in the table of quantities.
BEADS = 38
TOLERANCES = (1e-3, 2e-5)
FEWER = 300


def cover(grains: int, time: float) -> tuple[float, float]:
    """Return the percentages of covering intervals, and of chains with an interval."""
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


def laws(grains: int) -> dict[str, tuple[float, float]]:
    """Return the mean and variance of quantities in the ensemble, relative to the total energy."""
    whole = ensemble(grains)
    bead = stats.beta(0.5, grains / 2 - 0.5 + grains / 2.5)
    # Variance of the sum of fourth powers of a random direction.
    square = (105 + 9 * (grains - 1)) / ((grains + 2) * (grains + 4) * (grains + 6))
    return {
        NAME: (whole.mean(), whole.var()),
        "potential_energy": (1 - whole.mean(), whole.var()),
        f"{NAME}:{BEAD}": (bead.mean(), bead.var()),
        "equipartition": (1.0, ((grains + 2) / 3) ** 2 * square - 1),
    }


def measure_quantities() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of quantities."""
    exact = laws(BEADS)
    for tolerance in TOLERANCES:
        answers = []
        for seed in range(FEWER):
            scene = beads(BEADS, seed)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                answer = averages(scene, list(exact), time=0.1, tolerance=tolerance)
            answers.append((scene.energy, answer))
        for name, (mean, variance) in exact.items():
            covers = []
            for energy, answer in answers:
                unit = 1.0 if name == "equipartition" else energy
                low, high = answer.interval[name]
                least, most = answer.variance_interval[name]
                if math.isfinite(high - low + most):
                    covers.append((low < mean * unit < high, least < variance * unit**2 < most))
            rates = 100 * np.mean(covers, axis=0)
            known = 100 * len(covers) / FEWER
            yield name, f"{tolerance:g}", *(f"{rate:.1f}" for rate in (*rates, known))


if __name__ == "__main__":
    columns = ("beads", "time", "intervals that cover, %", "chains that have an interval, %")
    write_table(TABLES / "coverage.md", columns, measure())
    columns = (
        "quantity",
        "tolerance",
        "means that are covered, %",
        "variances, %",
        "chains that have both intervals, %",
    )
    write_table(TABLES / "coverage_of_quantities.md", columns, measure_quantities())
