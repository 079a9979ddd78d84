"""Which bodies beside each recorded grain were recorded, too, or stand still."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .derivatives import STILL, UNKNOWN


class Around(NamedTuple):
    """What lies beside G grains of a chain of N.

    Columns of all bodies, (N+2,), and of those at and beside each grain, (G, 3); whether all forces on it follow from
    what was recorded, (G,); whether all grains that move were.
    """

    column: NDArray[np.intp]
    sides: NDArray[np.intp]
    known: NDArray[np.bool_]
    whole: bool


@lru_cache(maxsize=4)  # scenes of a sweep are alike
def around(size: int, movable: int, above: bool, below: bool, recorded: bytes) -> Around:
    """Return what lies around these grains of a chain of this size, with or without contacts at its ends."""
    grains = np.frombuffer(recorded, dtype=int)
    column, contacts = columns(size, movable, grains), grains[:, None] + np.array([-1, 0])
    sides = column[grains[:, None] + np.array([-1, 0, 1])]
    nothing = (not above) & (contacts == 0) | (not below) & (contacts == size)
    known = ((sides[:, ::2] != UNKNOWN) | nothing).all(1) | (grains > movable)
    return Around(column, sides, known, not (column[1 : movable + 1] == UNKNOWN).any())


def columns(size: int, movable: int, grains: np.ndarray) -> NDArray[np.intp]:
    """Return the recorded column of each body, (N+2,), or a mark if it stands still or is unknown.

    Parameters
    ----------
    size, movable : int
        Number of grains, and of those that move.
    grains : (G,) array of int
        Those that were recorded.

    Returns
    -------
    (N+2,) array of int
    """
    column = np.full(size + 2, UNKNOWN)
    column[[0, -1]] = STILL
    column[movable + 1 :] = STILL
    column[grains] = np.arange(grains.size)
    return column
