"""Make the 80-bit references that tests compare with: `references.npz` beside this file, in a
minute or two.

python tests/data/make_references.py
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from helpers.independent_integrators import extended_reference
from helpers.stored_references import FILE, SCENES


def main() -> None:
    """Make all of them anew."""
    with ProcessPoolExecutor() as processes:
        references = dict(
            zip(SCENES, processes.map(extended_reference, SCENES.values()), strict=True)
        )
    motions = {name: np.array([u, v]) for name, (u, v, _) in references.items()}
    errors = {f"{name}: error": np.array(error) for name, (_, _, error) in references.items()}
    np.savez_compressed(FILE, allow_pickle=False, **motions, **errors)


if __name__ == "__main__":
    main()
