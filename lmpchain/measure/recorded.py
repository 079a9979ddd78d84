"""Recorded grains: the columns of their motion, and checks of the number of samples."""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, shown
from ..trajectory.accumulator import STILL, UNKNOWN, Field
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array

FEWEST_SAMPLES = 16  # Smallest number of samples for a front or a spectrum.


def columns(size: int, movable: int, grains: np.ndarray) -> NDArray[np.intp]:
    """Return the recorded column of each body, (N+2,), or a mark if the body is still or unknown.

    Parameters
    ----------
    size : int
        Number of grains.
    movable : int
        Number of grains that can move.
    grains : (G,) array of int
        Numbers of the recorded grains.

    Returns
    -------
    (N+2,) array of int
    """
    column = np.full(size + 2, UNKNOWN)
    # Top wall; the bodies after it are held grains and the bottom wall.
    column[0] = STILL
    column[movable + 1 :] = STILL
    column[grains] = np.arange(grains.size)
    return column


def leaves_rest(displacement: Array, velocity: Array) -> NDArray[np.bool_]:
    """Return which grains ever leave rest, (G,).

    Parameters
    ----------
    displacement, velocity : (T, G) arrays
        Motion of the grains, m and m/s.
    """
    # The motion is exactly 0, because engines leave grains at rest until a wave arrives.
    return np.logical_or(displacement.any(axis=0), velocity.any(axis=0))


def check_field(field: Field) -> None:
    """Check that a field of the motion exists.

    Parameters
    ----------
    field : {"velocity", "displacement"}

    Raises
    ------
    InputError
        If the field does not exist.
    """
    if field not in get_args(Field):
        raise InputError.at("field", f'must be "velocity" or "displacement" (got {shown(field)})')


def check(trajectory: Trajectory, field: Field) -> None:
    """Check that a trajectory has enough samples for fronts and spectra, and that the field exists.

    Parameters
    ----------
    trajectory : Trajectory
    field : {"velocity", "displacement"}

    Raises
    ------
    InputError
        If there are fewer than 16 samples, or the field does not exist.
    """
    check_field(field)
    if trajectory.time.size < FEWEST_SAMPLES:
        raise InputError.at(
            "samples", f"must be {FEWEST_SAMPLES} or more: record more often or for longer"
        )
