"""The adaptive steps that a run takes, to be held while derivatives are taken."""

from __future__ import annotations

import math

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from .batch import ChainBatch
from .method import Method
from .step_schedule import StepSchedule
from .stepper import NativeStepper

ROOM = 1024  # steps that are noted at a time


def adaptive_steps(scene: Scene, method: Method, step: float, looks: int) -> list[Array]:
    """Return the steps of a run that shortens them where contacts open or close.

    Parameters
    ----------
    scene : Scene
    method : Splitting
        Of an order above 2.
    step : float
        The longest one, s.
    looks : int
        Equal parts of the duration, at whose ends a step ends.

    Returns
    -------
    list of `looks` arrays
        s; those of each part add up to it.
    """
    scene = scene.replace(samples=looks + 1)
    interval = scene.duration / looks
    count = max(1, math.ceil(interval / step * (1 - 1e-12)))
    run = NativeStepper(
        ChainBatch([scene]), method, StepSchedule(count, 1, interval / count, True), {}
    )
    u, v = np.empty((2, 1, 2, scene.chain.grains))
    steps: list[Array] = []
    ends = np.empty(ROOM)
    for look in range(looks):
        times = [0.0]
        while run.sample == look:
            made = run.fill_by_step(u, v, look, look + 1, ends)
            times += ends[:made].tolist()
        times[-1] = interval
        steps.append(np.diff(times))
    return steps
