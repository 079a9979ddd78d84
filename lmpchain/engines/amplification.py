"""How much of a last digit a scene makes: native runs that begin one apart."""

from __future__ import annotations

import math

import numpy as np

from ..integrators.batch import ChainBatch
from ..integrators.methods import METHODS
from ..integrators.step_schedule import StepSchedule
from ..integrators.stepper import NativeStepper
from ..scene.excitation import Profile
from ..scene.scene import Scene
from ..util.arrays import EPSILON, Array
from .round_off import DRIFTED

LAST_DIGIT = 1e-15  # of the largest velocity: a few units in the last place of a double
# analysis/calibration/amplified_rounding.py
# omega h of the runs with verlet, and their steps over those of the answer: what a change grows to does not ask for
# accurate steps, but for stable ones, also where the frequency is not known beforehand
COARSE, LONGER = 0.25, 4
DRAWS = (
    1.0,
    -1.0,
    0.5,
)  # changes that are tried, in last digits: what becomes of one scatters by ten
BROKEN = 4.0  # two runs that keep to the largest motion are never so far apart; runs that broke down say nothing
BLOCK_BYTES, BURST = (
    2**24,
    10**6,
)  # of samples held at a time; steps between two opportunities to stop


def perturbed(scene: Scene, change: float) -> Scene:
    """Return the scene with every velocity changed by a fraction of the largest, alternating in sign.

    Of the largest displacement where nothing is struck; what does work becomes so much stronger.
    """
    if scene.excitation.does_work:
        return scene.replace(excitation=scene.excitation.scaled(1 + change))
    u, v = _nearby(scene, change)
    return scene.replace(excitation=Profile(displacement=u, velocity=v))


def _nearby(scene: Scene, change: float) -> tuple[Array, Array]:
    """Return displacement and velocity (N,) at t = 0 of that scene, where nothing does work."""
    u, v = (x.copy() for x in scene.initial())
    turns = np.where(np.arange(u.size) % 2, -1.0, 1.0) * (np.arange(u.size) < scene.chain.movable)
    moved = v if v.any() else u
    moved += change * np.abs(moved).max() * turns
    return u, v


def _all(scene: Scene) -> ChainBatch:
    """Return the chain of a scene and those that begin some last digits apart."""
    changes = [draw * LAST_DIGIT for draw in DRAWS]
    if scene.excitation.does_work:
        return ChainBatch([scene, *(perturbed(scene, change) for change in changes)])
    near = (_nearby(scene, change) for change in changes)
    u, v = (np.array(fields) for fields in zip(scene.initial(), *near, strict=True))
    return ChainBatch([scene] * (1 + len(changes)), initial=(u, v))


def walked(evaluations: float, alike: bool = False) -> float:
    """Return how many last digits the rounding of so many evaluations of the force makes, at least one.

    It walks; where `alike`, at steps of one length, it may go to one side.
    """
    digits = math.sqrt(evaluations)
    return max(
        1.0, EPSILON / LAST_DIGIT * (max(digits, DRIFTED * evaluations) if alike else digits)
    )


def amplified_digit(scene: Scene, largest: Array, steps_made: float) -> float:
    """Return how far a last digit at t = 0 takes runs apart at most, over the largest motion.

    That is given, (2,) m and m/s. The runs are coarse, at a fraction of the cost of the answer with its steps.
    """
    interval = scene.duration / (scene.samples - 1)
    steps = math.ceil(
        max(interval * scene.highest_frequency / COARSE, steps_made / (scene.samples - 1) / LONGER)
    )
    stepper = NativeStepper(
        _all(scene), METHODS["verlet"], StepSchedule(steps, 1, interval / steps, False), {}
    )
    count = max(1, min(scene.samples, BLOCK_BYTES // (64 * scene.chain.grains)))
    u, v = np.zeros((2, 1 + len(DRAWS), count, scene.chain.grains))
    most = np.zeros(len(DRAWS))
    for first in range(1, scene.samples, count):
        until = min(first + count, scene.samples) - 1
        while stepper.sample < until:
            stepper.fill(u, v, first, until, BURST)
        for field, scale in zip((u, v), largest, strict=True):
            part = field[:, : until + 1 - first]
            most = np.fmax(most, np.abs(part[1:] - part[0]).max((1, 2)) / scale)
    return float(most.max(where=most <= BROKEN, initial=0.0))
