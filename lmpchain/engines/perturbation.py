"""The divergence of two native runs that begin a last digit apart: a finite-time Lyapunov exponent."""

from __future__ import annotations

import numpy as np

from ..scene.base import Excitation
from ..scene.excitation import Profile
from ..scene.scene import Scene
from ..util.arrays import Array
from .base import Candidate
from .native import Native

LAST_DIGIT = 1e-15  # of the largest velocity: a few units in the last place of a double


def perturbed(scene: Scene, change: float) -> Scene:
    """Return the scene with every velocity changed by a fraction of the largest, alternating in sign.

    Of the largest displacement where nothing is struck; what does work becomes so much stronger.
    """
    excitation: Excitation
    if scene.excitation.does_work:
        excitation = scene.excitation.scaled(1 + change)
    else:
        u, v = (x.copy() for x in scene.initial())
        turns = np.where(np.arange(u.size) % 2, -1.0, 1.0) * (np.arange(u.size) < scene.chain.movable)
        moved = v if v.any() else u
        moved += change * np.abs(moved).max() * turns
        excitation = Profile(displacement=u, velocity=v)
    return scene.replace(excitation=excitation)


def divergence(scene: Scene, candidate: Candidate, change: float) -> Array:
    """Return the relative distance of a run and a perturbed one at every sample, (T,).

    Both are run in displacements with the integrator and the steps of the candidate, so what these leave out is the
    same in both. What remains is the change, rounding, and what the scene makes of them.

    Raises
    ------
    RunFailed
        If a run breaks down.
    """
    part = scene.light_cone.scene.replace(grains="all")
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
