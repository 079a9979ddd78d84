"""Errors relative to the largest motion at any time of the run."""

from collections.abc import Callable

import numpy as np

from lmpchain import Scene, Trajectory

from .independent_integrators import Reference, extended_reference

BETWEEN = 12  # Number of evaluations of the motion between two samples.


def true_error(
    t: Trajectory, scene: Scene, integrate: Callable[[Scene], Reference] = extended_reference
) -> tuple[float, float]:
    """Return the error of a trajectory as the package defines it, and that of the reference."""
    finer = (scene.samples - 1) * BETWEEN + 1
    u, v, own = integrate(Scene(**scene.given() | {"samples": finer, "grains": "all"}))
    pairs = ((t.displacement, u), (t.velocity, v))
    columns = scene.recorded - 1
    scale = (np.abs(true).max() or 1.0 for _, true in pairs)
    errors = (
        np.abs(x[:] - true[::BETWEEN, columns]).max() / s
        for (x, true), s in zip(pairs, scale, strict=True)
    )
    return float(max(errors)), own
