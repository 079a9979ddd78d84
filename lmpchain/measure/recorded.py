"""What is known of the motion of any body: recorded, at rest, or not known; and which grains ever move."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from .derivatives import STILL, UNKNOWN

if TYPE_CHECKING:
    from .motion import Motion


class Around(NamedTuple):
    """What lies beside G recorded grains of a chain of N, of which M ever move.

    Recorded columns of all bodies, (N+2,); where these stand among the columns of grains that move, (N+2,), and so of
    the bodies at and beside each of these, (M, 3); whether all forces on a recorded grain follow from what was
    recorded, (G,); whether all grains that can move were.
    """

    column: NDArray[np.intp]
    place: NDArray[np.intp]
    sides: NDArray[np.intp]
    known: NDArray[np.bool_]
    whole: bool


@lru_cache(maxsize=4)  # scenes of a sweep are alike
def around(size: int, movable: int, above: bool, below: bool, recorded: bytes, moves: bytes) -> Around:
    """Return what lies around these grains of a chain of this size, with or without contacts at its ends."""
    grains, moving = np.frombuffer(recorded, dtype=int), np.frombuffer(moves, dtype=bool)
    column, contacts = columns(size, movable, grains), grains[:, None] + np.array([-1, 0])
    nothing = (not above) & (contacts == 0) | (not below) & (contacts == size)
    beside = column[grains[:, None] + np.array([-1, 1])]
    known = ((beside != UNKNOWN) | nothing).all(1) | (grains > movable)
    place = column.copy()
    place[grains] = np.where(moving, np.cumsum(moving) - 1, STILL)
    sides = place[grains[moving][:, None] + np.array([-1, 0, 1])]
    return Around(column, place, sides, known, not (column[1 : movable + 1] == UNKNOWN).any())


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
    """Return which grains ever leave rest, (G,): of a long chain most do not, and need not be looked at.

    Parameters
    ----------
    displacement, velocity : (T, G) arrays
    """
    return np.logical_or(displacement.any(axis=0), velocity.any(axis=0), dtype=bool)


def known_contacts(trajectory: Trajectory | Motion) -> np.ndarray:
    """Return the numbers of contacts whose two bodies were recorded or stand still, if there are any.

    Parameters
    ----------
    trajectory : Trajectory or Motion

    Returns
    -------
    (C,) array of int

    Raises
    ------
    InputError
        If no two neighbours were recorded.
    """
    known = columns(trajectory.scene.chain.grains, trajectory.scene.chain.movable, trajectory.grains) != UNKNOWN
    chosen = np.flatnonzero(known[:-1] & known[1:] & trajectory.scene.chain.contacts.exists)
    if not chosen.size:
        raise InputError([("grains", "no two neighbours were recorded, so no contact is known: record both")])
    return chosen


def motion(trajectory: Trajectory | Motion, bodies: np.ndarray) -> tuple[Array, Array]:
    """Return displacement, m, and velocity, m/s, of grains or walls (0 and N + 1), (T, ...) each.

    Parameters
    ----------
    trajectory : Trajectory or Motion
    bodies : (B,) array of int
        Grains, or walls: 0 and N + 1.

    Returns
    -------
    two (T, B) arrays

    Raises
    ------
    InputError
        If one of them was not recorded and is not held.
    """
    column = _found(trajectory, bodies)
    u, v = trajectory.displacement[:, column], trajectory.velocity[:, column]
    u[:, column == STILL] = v[:, column == STILL] = 0.0
    if wall := trajectory.scene.excitation.wall:
        u[:, bodies == 0], v[:, bodies == 0] = (wall.at(trajectory.time, order)[:, None] for order in (0, 1))
    return u, v


def motion_of_all(trajectory: Trajectory) -> tuple[Scene, Array, Array]:
    """Return the scene, and displacement, m, and velocity, m/s, of its grains, down to the last one that ever moves.

    Two grains at rest below that one belong to it, too, if there are any: the last of them is held for good.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    Scene and two (T, N) arrays

    Raises
    ------
    InputError
        If a grain that can move was not recorded.
    """
    scene, u, v = trajectory.scene, np.asarray(trajectory.displacement), np.asarray(trajectory.velocity)
    _found(trajectory, np.arange(1, scene.chain.grains + 1))
    last = 2 + max(scene.excitation.reach(scene.chain)[1], int(trajectory.grains[leaves_rest(u, v)].max(initial=1)))
    scene = scene.part(1, last) if last < scene.chain.grains else scene
    return scene, *motion(trajectory, np.arange(1, scene.chain.grains + 1))


def _found(trajectory: Trajectory | Motion, bodies: np.ndarray) -> NDArray[np.intp]:
    """Return the columns of bodies, or marks; raise InputError if one of them was not recorded and is not held."""
    column = columns(trajectory.scene.chain.grains, trajectory.scene.chain.movable, trajectory.grains)[bodies]
    missing = np.unique(bodies[column == UNKNOWN])
    if missing.size:
        some = ", ".join(map(str, missing[:8])) + ", ..." * (missing.size > 8)
        raise InputError([("grains", f"this takes grains that were not recorded; record these too: {some}")])
    return column
