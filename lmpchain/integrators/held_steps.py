"""The adaptive steps that a run takes, to be held while derivatives are taken."""

from __future__ import annotations

import math

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from .batch import ChainBatch
from .method import Method
from .stepper import NativeStepper
from .steps import Steps


def schedule_of(scene: Scene, step: float, looks: int, adaptive: bool) -> Steps:
    """Return the schedule of steps up to this length, s, that end on so many looks."""
    interval = scene.duration / looks
    count = max(1, math.ceil(interval / step * (1 - 1e-12)))
    return Steps.spread(interval, count, adaptive=adaptive)


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
    schedule = schedule_of(scene, step, looks, True)
    run = NativeStepper(ChainBatch([scene.replace(samples=looks + 1)]), method, schedule, {})
    u, v = np.empty((2, 1, 2, scene.chain.grains))
    steps: list[Array] = []
    for look in range(looks):
        times = [0.0]
        while run.sample == look:
            run.fill(u, v, look, look + 1, 1)
            times.append(float(run.watched["done"][0]))
        times[-1] = scene.duration / looks
        steps.append(np.diff(times))
    return steps
