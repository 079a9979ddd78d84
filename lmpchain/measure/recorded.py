"""What was recorded: of which grains, whether enough, and which bodies beside each of them are known."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, shown
from ..trajectory.between.derivatives import STILL, UNKNOWN
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array

Field = Literal["velocity", "displacement"]
FEWEST_SAMPLES = 16  # least for tracking a front or a spectrum


class Around(NamedTuple):
    """What lies beside G recorded grains of a chain of N, of which M ever move.

    Columns and numbers of the grains that move, (M,); recorded columns of all bodies, (N+2,); where these stand among
    the columns of grains that move, (N+2,), and so of the bodies at and beside each of these, (M, 3); whether all
    forces on a recorded grain follow from what was recorded, (G,); whether all grains that can move were.
    """

    moves: NDArray[np.intp]
    moving: NDArray[np.intp]
    column: NDArray[np.intp]
    place: NDArray[np.intp]
    sides: NDArray[np.intp]
    known: NDArray[np.bool_]
    whole: bool


@lru_cache(maxsize=8)  # scenes of a sweep are alike
def around(
    size: int, movable: int, above: bool, below: bool, recorded: bytes, moves: bytes
) -> Around:
    """Return what lies around these grains of a chain of this size, with or without contacts at its ends."""
    grains, moving = np.frombuffer(recorded, dtype=int), np.frombuffer(moves, dtype=bool)
    column, contacts = columns(size, movable, grains), grains[:, None] + np.array([-1, 0])
    nothing = (not above) & (contacts == 0) | (not below) & (contacts == size)
    beside = column[grains[:, None] + np.array([-1, 1])]
    known = ((beside != UNKNOWN) | nothing).all(1) | (grains > movable)
    place = column.copy()
    place[grains] = np.where(moving, np.cumsum(moving) - 1, STILL)
    sides = place[grains[moving][:, None] + np.array([-1, 0, 1])]
    whole = not (column[1 : movable + 1] == UNKNOWN).any()
    return Around(np.flatnonzero(moving), grains[moving], column, place, sides, known, whole)


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


def leaves_rest(displacement: Array, velocity: Array) -> NDArray[np.bool_]:
    """Return which grains ever leave rest, (G,).

    Of a long chain most do not, and need not be looked at.

    Parameters
    ----------
    displacement, velocity : (T, G) arrays
    """
    for sampled in (slice(-1, None), slice(None)):  # in the end: what has moved is seldom at rest
        moves = np.logical_or(
            displacement[sampled].any(axis=0), velocity[sampled].any(axis=0), dtype=bool
        )
        if moves.all():
            break
    return moves


def check_field(field: Field) -> None:
    """Check that there is such a field.

    Parameters
    ----------
    field : {"velocity", "displacement"}

    Raises
    ------
    InputError
        If there is not.
    """
    if field not in get_args(Field):
        raise InputError([("field", f'must be "velocity" or "displacement" (got {shown(field)})')])


def check(trajectory: Trajectory, field: Field) -> None:
    """Check that a trajectory has samples enough for fronts and spectra, and such a field.

    Parameters
    ----------
    trajectory : Trajectory
    field : {"velocity", "displacement"}

    Raises
    ------
    InputError
        If it has not.
    """
    check_field(field)
    if trajectory.time.size < FEWEST_SAMPLES:
        raise InputError(
            [("samples", f"must be {FEWEST_SAMPLES} or more: record more often or for longer")]
        )
