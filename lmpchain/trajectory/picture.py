"""The space-time picture of a trajectory."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from ..util.arrays import Array, as_slice
from ..util.plotting import Axes, chart, draw_map, thin_rows
from .record import Record

UNITS_OF_FIELDS = {"velocity": "m/s", "displacement": "m"}
MOVING = 1e-3  # Fraction of the largest motion below which a grain counts as at rest.


def draw_motion(
    trajectory: Record, field: Literal["velocity", "displacement"], ax: Axes | None
) -> Axes:
    """Draw the motion over time and depth; see `Trajectory.plot`."""
    from matplotlib.ticker import MaxNLocator

    ax = chart(ax, "time [s]", "grain, from the top")
    order = as_slice(np.argsort(trajectory.grains))
    # A picture has fewer columns than the trajectory has samples.
    stride = -(-trajectory.time.size // 4000)
    time = trajectory.time[::stride]
    motion = np.asarray(getattr(trajectory, field)[::stride])[:, order]
    rows, drawn = thin_rows(trajectory.grains[order], motion.T)
    limit = scale(motion)
    label = f"{field}, downward [{UNITS_OF_FIELDS[field]}]"
    colours: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    draw_map(ax, time, rows, drawn, label, extend="both", **colours)
    ax.set(xlim=time[[0, -1]], ylim=ax.get_ylim()[::-1])
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return ax


def scale(motion: Array) -> float:
    """Return the median peak of the moving grains, at which colours saturate."""
    largest = np.abs(motion).max(0)
    return float(np.median(largest[largest > MOVING * largest.max()])) if largest.any() else 1.0
