"""Motion of any bodies of a chain: recorded grains, held grains, and walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.accumulator import STILL, UNKNOWN
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from .motion import Motion
from .recorded import columns, leaves_rest

__dir__ = listed(__name__)


def known_contacts(trajectory: Trajectory | Motion) -> np.ndarray:
    """Return the numbers of the contacts whose two bodies were recorded or are at rest.

    Parameters
    ----------
    trajectory : Trajectory or Motion

    Returns
    -------
    (C,) array of int

    Raises
    ------
    InputError
        If no two neighbouring grains were recorded.
    """
    chain = trajectory.scene.chain
    recorded = columns(chain.grains, chain.movable, trajectory.grains) != UNKNOWN
    chosen = np.flatnonzero(recorded[:-1] & recorded[1:] & chain.contacts.exists)
    if not chosen.size:
        raise InputError.at(
            "grains",
            "no two neighbouring grains were recorded, so no contact is known: record both",
        )
    return chosen


def motion(trajectory: Trajectory | Motion, bodies: np.ndarray) -> tuple[Array, Array]:
    """Return the displacements (m) and velocities (m/s) of grains or walls, (T, B) each.

    Parameters
    ----------
    trajectory : Trajectory or Motion
    bodies : (B,) array of int
        Numbers of the grains; the walls have the numbers 0 and N + 1.

    Returns
    -------
    two (T, B) arrays

    Raises
    ------
    InputError
        If a grain that can move was not recorded.
    """
    column = _columns_of(trajectory, bodies)
    u = trajectory.displacement[:, column]
    v = trajectory.velocity[:, column]
    # The index that marks a body at rest is also valid: it is the last column.
    u[:, column == STILL] = v[:, column == STILL] = 0.0
    drive = trajectory.scene.drive
    # Grain 1 is recorded like other grains.
    if drive is not None and not drive.driven:
        driven = bodies == drive.body(trajectory.scene.chain)
        displacement, velocity = drive.motion(trajectory.time)
        u[:, driven] = displacement[:, None]
        v[:, driven] = velocity[:, None]
    return u, v


def motion_of_all(trajectory: Trajectory) -> tuple[Scene, Array, Array]:
    """Return the scene and the motion, m and m/s, of the grains down to the last moving one.

    The returned scene ends two grains below the last grain that moves or that a force acts on, or
    at the end of the chain.

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
    scene = trajectory.scene
    u = np.asarray(trajectory.displacement)
    v = np.asarray(trajectory.velocity)
    _columns_of(trajectory, np.arange(1, scene.chain.grains + 1))
    # A force may act on a grain that has not moved yet.
    last = 2 + max(
        scene.excitation.reach(scene.chain)[1],
        int(trajectory.grains[leaves_rest(u, v)].max(initial=1)),
    )
    scene = scene.part(1, last) if last < scene.chain.grains else scene
    return scene, *motion(trajectory, np.arange(1, scene.chain.grains + 1))


def _columns_of(trajectory: Trajectory | Motion, bodies: np.ndarray) -> NDArray[np.intp]:
    """Return columns of bodies, or their marks; raise `InputError` for an unrecorded body."""
    chain = trajectory.scene.chain
    column = columns(chain.grains, chain.movable, trajectory.grains)[bodies]
    missing = np.unique(bodies[column == UNKNOWN])
    if missing.size:
        numbers = ", ".join(map(str, missing[:8])) + ", ..." * (missing.size > 8)
        raise InputError.at(
            "grains", f"some grains that are needed were not recorded; record these too: {numbers}"
        )
    return column
