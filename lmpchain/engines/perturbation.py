"""The divergence of two native runs that begin a last digit apart: a finite-time Lyapunov exponent."""

from __future__ import annotations

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from .amplification import perturbed
from .base import Candidate
from .native import Native


def divergence(scene: Scene, candidate: Candidate, change: float) -> Array:
    """Return the relative distance of a run and a perturbed one at every sample, (T,).

    Both are run in displacements with the integrator and the steps of the candidate, so what these leave out is the
    same in both. What remains is the change, rounding, and what the scene makes of them.

    Raises
    ------
    RunFailed
        If a run breaks down.
    """
    part = scene.reached.replace(grains="all")
    run = Native().start([part, perturbed(part, change)], candidate)
    apart = np.zeros((2, scene.samples))
    try:
        for block in run.blocks():
            for kind, field in enumerate((block.displacement, block.velocity)):
                apart[kind, block.samples] = np.abs(field[1] - field[0]).max(axis=1)
    finally:
        run.close()
    peaks = run.peaks[0]
    return (apart / np.where(peaks > 0, peaks, 1.0)[:, None]).max(axis=0)
