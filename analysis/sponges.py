"""Grading of the drag of absorbing boundaries: largest reflection in the middle of the bands.

    python analysis/sponges.py [--powers]

Writes tables/sponges.md, which docs/scenes.md shows: what `patterns.absorbing` gives back, a row a
chain and a column a length. With --powers it prints what each power would give, with the strength
that is best for it; `patterns.absorbing` takes the best of the powers in `chain.sponge.GRADING`.
"""

import argparse
import dataclasses
import warnings
from collections.abc import Iterator

import numpy as np
from figures import TABLES, write_table

from lmpchain.chain import Chain, patterns, sponge

PRESSED = {"gravity": 0.0, "top_load": 20.0, "bottom": "wall", "diameter": 1e-2}
CHAINS = {
    "uniform, to a wall": Chain(grains=20, material="steel", **PRESSED),
    "uniform, to a held grain": Chain(grains=20, material="steel", **PRESSED | {"bottom": "fixed"}),
    "steel and PTFE by turns": Chain(grains=20, material=["steel", "ptfe"] * 10, **PRESSED),
    "steel and aluminium by turns": Chain(
        grains=20, material=["steel", "aluminium"] * 10, **PRESSED
    ),
    "three diameters by turns": Chain(
        grains=21, material="steel", **PRESSED | {"diameter": [1e-2, 1.5e-2, 8e-3] * 7}
    ),
}
LENGTHS = (60, 90, 120, 200)
POWERS = (1, 2, 3, 4, 5)


def reflected(chain: Chain, grains: int, powers: tuple[int, ...]) -> float:
    """Return the largest amplitude reflected by an absorbing boundary of n grains."""
    kept = sponge.GRADING
    sponge.GRADING = dataclasses.replace(kept, powers=powers)
    try:
        absorbs = patterns.absorbing(chain, bottom=grains)
    finally:
        sponge.GRADING = kept
    ending = sponge.layer(absorbs, "bottom", grains, sponge.period(chain, "bottom"))
    drag = absorbs.drag[: absorbs.movable][-ending.masses.size :]
    return float(np.abs(sponge.reflection(ending, drag, ending.middle)).max())


def measure(powers: tuple[int, ...]) -> Iterator[tuple[str, ...]]:
    """Yield a row of amplitudes per chain, with the best of these powers."""
    for name, chain in CHAINS.items():
        yield name, *(f"{reflected(chain, grains, powers):.0e}" for grains in LENGTHS)


def main() -> None:
    """Write the table of reflections, or print a table for each power of the grading."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--powers", action="store_true")
    warnings.simplefilter("ignore")
    if not parser.parse_args().powers:
        columns = ("grains", *map(str, LENGTHS))
        return write_table(TABLES / "sponges.md", columns, measure(sponge.GRADING.powers))
    for power in POWERS:
        for row in measure((power,)):
            print(f"x^{power}", *row, sep=" | ")


if __name__ == "__main__":
    main()
