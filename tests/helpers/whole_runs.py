"""The blocks of an engine's run, joined into arrays."""

import numpy as np

from lmpchain.engines.base import Run
from lmpchain.util.arrays import Array


def blocks_of(run: Run) -> tuple[Array, Array]:
    """Return the displacements and velocities of a batch, (R, T, G), and close the run."""
    try:
        blocks = list(run.blocks())
        return tuple(
            np.concatenate([getattr(b, k) for b in blocks], axis=1)
            for k in ("displacement", "velocity")
        )
    finally:
        run.close()
