"""The numbers behind the live view of a page: the velocities of the grains that move, in 16 bits."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any

import numpy as np

from ..measure.recorded import leaves_rest
from ..measure.spectrum import travel_time
from ..trajectory.picture import MOVING, scale
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, as_slice
from ..util.plotting import thin_rows

# shown; of more, every so many
MOST_TIMES = 240
MOST_GRAINS = 160
MARGIN = 4  # grains at rest on either side of those that move
FULL = 2**15 - 1


def moving_part(trajectory: Trajectory) -> Trajectory:
    """Return the grains that ever leave rest and a few beside them; pictures show no others."""
    u = np.asarray(trajectory.displacement)
    v = np.asarray(trajectory.velocity)
    there = trajectory.grains[leaves_rest(u, v)]
    if not there.size:
        return trajectory
    near = (trajectory.grains >= there.min() - MARGIN) & (trajectory.grains <= there.max() + MARGIN)
    columns = as_slice(np.flatnonzero(near))
    grains = trajectory.grains[columns]
    scene = trajectory.scene.replace(grains=grains.tolist())
    return replace(
        trajectory, scene=scene, grains=grains, displacement=u[:, columns], velocity=v[:, columns]
    )


def moving(trajectory: Trajectory) -> tuple[int, int]:
    """Return the first and the last grain to show: those that move, and a few beside them."""
    largest = np.abs(trajectory.velocity).max(0)
    there = trajectory.grains[largest > MOVING * largest.max(initial=0.0)]
    if not there.size:
        return int(trajectory.grains.min()), int(trajectory.grains.max())
    first = trajectory.grains.min()
    last = trajectory.grains.max()
    return max(int(there.min()) - MARGIN, int(first)), min(int(there.max()) + MARGIN, int(last))


def numbers(trajectory: Trajectory) -> dict[str, Any]:
    """Return what the script of the page draws, in plain numbers and text."""
    trajectory = moving_part(trajectory)
    first, last = moving(trajectory)
    order = np.argsort(trajectory.grains)
    grains = trajectory.grains[order]
    shown = order[(grains >= first) & (grains <= last)]
    rows = np.unique(np.linspace(0, trajectory.time.size - 1, MOST_TIMES).round().astype(int))
    velocity: Array = np.nan_to_num(np.asarray(trajectory.velocity)[rows][:, shown])
    kept, drawn = thin_rows(trajectory.grains[shown], velocity.T, MOST_GRAINS)
    largest = float(np.abs(drawn).max(initial=0.0)) or 1.0
    data = np.round(drawn.T / largest * FULL).astype("<i2")
    return {
        "time": trajectory.time[rows].tolist(),
        "grains": kept.tolist(),
        "largest": largest,
        "limit": scale(velocity),
        "data": base64.b64encode(data.tobytes()).decode("ascii"),
        "law": _law(trajectory, kept),
    }


def _law(trajectory: Trajectory, grains: np.ndarray) -> list[float]:
    """Return when a long weak wave reaches each grain, s; nothing where there is no such wave."""
    chain = trajectory.scene.chain
    source = getattr(trajectory.scene.excitation, "grain", None)
    if not chain.compressed or source is None:
        return []
    return [float(t) for t in travel_time(chain, max(1, source))[grains - 1]]
