"""How the drag of an absorbing end should grow: largest reflection in the middle of the bands.

    python analysis/sponges.py

Each power has the strength that is best for it. A row a chain and a length; the last column is what
`patterns.absorbing` takes, the best of the powers in `chain.sponge.GRADING`.
"""

import dataclasses
import warnings

import numpy as np

from lmpchain.chain import Chain, patterns, sponge

PRESSED = {"gravity": 0.0, "top_load": 20.0, "bottom": "wall", "diameter": 1e-2}
CHAINS = {
    "uniform": Chain(grains=20, material="steel", **PRESSED),
    "uniform, held": Chain(grains=20, material="steel", **PRESSED | {"bottom": "fixed"}),
    "steel and PTFE": Chain(grains=20, material=["steel", "ptfe"] * 10, **PRESSED),
    "steel and aluminium": Chain(grains=20, material=["steel", "aluminium"] * 10, **PRESSED),
    "three diameters": Chain(
        grains=21, material="steel", **PRESSED | {"diameter": [1e-2, 1.5e-2, 8e-3] * 7}
    ),
}
POWERS = (1, 2, 3, 4, 5)


def reflected(chain: Chain, grains: int, powers: tuple[int, ...]) -> float:
    """Return the largest amplitude that a sponge of so many grains gives back."""
    kept = sponge.GRADING
    sponge.GRADING = dataclasses.replace(kept, powers=powers)
    try:
        absorbs = patterns.absorbing(chain, bottom=grains)
    finally:
        sponge.GRADING = kept
    ending = sponge.layer(absorbs, "bottom", grains, sponge.period(chain, "bottom"))
    drag = absorbs.drag[: absorbs.movable][-ending.masses.size :]
    return float(np.abs(sponge.reflection(ending, drag, ending.middle)).max())


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    print(f"{'chain':20} grains " + "".join(f"     x^{power}" for power in POWERS) + "    taken")
    for name, chain in CHAINS.items():
        for grains in (30, 60, 90, 120, 200):
            each = [reflected(chain, grains, (power,)) for power in POWERS]
            row = [*each, reflected(chain, grains, sponge.GRADING.powers)]
            print(f"{name:20} {grains:6} " + "".join(f"{value:8.0e}" for value in row))


if __name__ == "__main__":
    main()
