"""True and estimated errors of both engines on the paper's scenes.

    python analysis/accuracy.py

The reference is a Taylor series of order 32 in extended precision (`lmpchain.benchmark.reference`),
error some 5e-16. Writes tables/accuracy.md, which docs/accuracy.md shows.
"""

from collections.abc import Iterator

from figures import HERE, TABLES, write_table

import lmpchain
from lmpchain.benchmark.comparison import error
from lmpchain.benchmark.reference import reference

SCENES = {
    "weak, 1e-6 m/s": "weak",
    "Fig. 5 at 10 g": "fig5_10g",
    "Fig. 5 at g": "fig5_1g",
    "Fig. 5 at g / 10": "fig5_0.1g",
    "Fig. 1 (strong)": "fig1",
}
RUNS = (("native", 1e-6), ("native", 1e-9), ("lammps", 1e-6))


def measure() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table."""
    for name, file in SCENES.items():
        scene = lmpchain.Scene.from_toml(HERE / "scenes" / f"{file}.toml")
        solution = reference(scene)
        for engine, tolerance in RUNS:
            t = lmpchain.simulate(scene, engine, tolerance)
            off = error(t, solution)
            known = f"{off:.0e}" if off > solution.error else f"below {solution.error:.0e}"
            yield name, f"{engine}, {tolerance:.0e}", known, f"{t.error_estimate.total:.0e}"


if __name__ == "__main__":
    columns = ("scene, 120 beads, 100 µs", "engine, tolerance", "true error", "estimate")
    write_table(TABLES / "accuracy.md", columns, measure())
