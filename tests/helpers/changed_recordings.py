"""Recordings with another stated error, or with only some of their samples or grains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lmpchain import Trajectory
from lmpchain.trajectory.record import ErrorEstimate

EVERY = slice(None)


def of_error(t: Trajectory, error: float = np.inf) -> Trajectory:
    """Return the samples of a run alone, with this relative error; by default it is unknown."""
    return replace(t, error_estimate=ErrorEstimate(0.0, error), gathered={})


def part_of(t: Trajectory, samples: Any = EVERY, columns: Any = EVERY) -> Trajectory:
    """Return a recording with these samples and these columns of grains."""
    return replace(
        t,
        time=t.time[samples],
        grains=t.grains[columns],
        displacement=t.displacement[samples][:, columns],
        velocity=t.velocity[samples][:, columns],
    )


def until(t: Trajectory, end: float) -> Trajectory:
    """Return the part of a recording up to a time."""
    return part_of(t, t.time <= end * (1 + 1e-9))
