"""Numbers of the live view of a page: velocities of the grains that move, in 16 bits."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..measure.recorded import leaves_rest
from ..measure.spectrum import travel_time
from ..trajectory.picture import MOVING, scale
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, as_slice
from ..util.plotting import thin_rows


class ViewSizes(NamedTuple):
    """Sizes of the live view.

    Attributes
    ----------
    times, grains : int
        Most rows of both; of more, some are shown.
    margin : int
        Grains at rest that are shown on either side of those that move.
    """

    times: int = 240
    grains: int = 160
    margin: int = 4


VIEW = ViewSizes()


def crop(trajectory: Trajectory) -> Trajectory:
    """Return the grains that ever leave rest and a few beside them; pictures show no others."""
    u = np.asarray(trajectory.displacement)
    v = np.asarray(trajectory.velocity)
    grains = trajectory.grains
    moving = grains[leaves_rest(u, v)]
    if not moving.size:
        return trajectory
    first = moving.min() - VIEW.margin
    last = moving.max() + VIEW.margin
    columns = as_slice(np.flatnonzero((grains >= first) & (grains <= last)))
    grains = grains[columns]
    # the scene says which grains were recorded, and must agree with the columns
    scene = trajectory.scene.replace(grains=grains.tolist())
    return replace(
        trajectory, scene=scene, grains=grains, displacement=u[:, columns], velocity=v[:, columns]
    )


def extent(trajectory: Trajectory) -> tuple[int, int]:
    """Return the first and the last grain to show: those that move, and a few beside them."""
    largest = np.abs(trajectory.velocity).max(0)
    first = int(trajectory.grains.min())
    last = int(trajectory.grains.max())
    moving = trajectory.grains[largest > MOVING * largest.max(initial=0.0)]
    if not moving.size:
        return first, last
    return max(int(moving.min()) - VIEW.margin, first), min(int(moving.max()) + VIEW.margin, last)


def numbers(trajectory: Trajectory) -> dict[str, Any]:
    """Return the numbers for the script of the page."""
    trajectory = crop(trajectory)
    first, last = extent(trajectory)
    order = np.argsort(trajectory.grains)
    grains = trajectory.grains[order]
    columns = order[(grains >= first) & (grains <= last)]
    rows = np.unique(np.linspace(0, trajectory.time.size - 1, VIEW.times).round().astype(int))
    # NaN has no place among integers
    velocity: Array = np.nan_to_num(np.asarray(trajectory.velocity)[rows][:, columns])
    grains, drawn = thin_rows(trajectory.grains[columns], velocity.T, VIEW.grains)
    largest = float(np.abs(drawn).max(initial=0.0)) or 1.0
    # 16 bits have more levels than a screen
    data = np.round(drawn.T / largest * np.iinfo(np.int16).max).astype("<i2")
    return {
        "time": trajectory.time[rows].tolist(),
        "grains": grains.tolist(),
        "largest": largest,
        "limit": scale(velocity),
        "data": base64.b64encode(data.tobytes()).decode("ascii"),
        "law": _law(trajectory, grains),
    }


def _law(trajectory: Trajectory, grains: np.ndarray) -> list[float]:
    """Return the arrival times of a long weak wave at grains, s; nothing without such a wave."""
    chain = trajectory.scene.chain
    source = getattr(trajectory.scene.excitation, "grain", None)
    if not chain.linearisable or source is None:
        return []
    return travel_time(chain, max(1, source))[grains - 1].tolist()
