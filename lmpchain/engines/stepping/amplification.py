"""Amplification of small changes by a scene: native runs that begin a little apart.

Reflections through opening contacts make much of a last digit (a finite-time Lyapunov exponent
above 0), and no step can give it back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...integrators.batch import ChainBatch
from ...integrators.method import Method
from ...integrators.methods import methods_of
from ...integrators.stepper import NativeStepper
from ...integrators.steps import Steps
from ...scene.excitation import Profile
from ...scene.scene import Scene
from ...util.arrays import EPSILON, Array
from .round_off import accumulate

BLOCK_BYTES = 2**24  # of samples held at a time
PIECES = 50  # into which a scene is cut that need not be followed to its end
BURST = 10**6  # steps between two opportunities to stop


@dataclass(frozen=True)
class DigitGrowth:
    """How the growth of a last digit is measured; analysis/calibration/amplified_rounding.py.

    Attributes
    ----------
    digit : float
        A last digit, relative to the largest motion: a few units in the last place of a double.
    changes : tuple of float
        Changes at t = 0 that are tried, in last digits: what becomes of one alone scatters by ten.
    repeats : tuple of float
        Changes, in units of the last place of 1, of the runs that show the rounding of an answer:
        they round in other ways, while the changes themselves count for less.
    reach : float
        omega h of these runs with velocity Verlet: growth asks for stable steps, not for accurate
        ones.
    shorter : float
        How many times shorter they are once more where a run breaks down.
    rate : float
        Exponent a radian of the fastest motion that no scene exceeds: where that leaves a digit
        below all that counts, nothing is measured.
    broken : float
        Relative distance beyond which a run broke down, for two that keep to the largest motion are
        never so far apart.
    safety : float
        Factor on the distance of runs with the steps of an answer, which scatters.
    pessimism : float
        How many times too large the product of walk and growth may be: up to there such runs tell
        whether a tolerance is met.
    """

    digit: float = 1e-15
    changes: tuple[float, ...] = (1.0, -1.0, 0.5)
    repeats: tuple[float, ...] = (1.0, -1.0, 0.5, -0.5)
    reach: float = 0.2
    shorter: float = 4.0
    rate: float = 0.06
    broken: float = 4.0
    safety: float = 2.0
    pessimism: float = 1e3


GROWTH = DigitGrowth()


def perturb(scene: Scene, change: float) -> Scene:
    """Return the scene with velocities changed by a fraction of the largest, up and down in turn.

    Of the largest displacement where nothing is struck; what does work becomes so much stronger.
    """
    if scene.excitation.does_work:
        return scene.replace(excitation=scene.excitation.scaled(1 + change))
    displacement, velocity = np.array(scene.initial())
    turns = np.where(np.arange(displacement.size) % 2, -1.0, 1.0)
    turns[scene.chain.movable :] = 0.0
    field = velocity if velocity.any() else displacement
    field += change * np.abs(field).max() * turns
    return scene.replace(excitation=Profile(displacement=displacement, velocity=velocity))


def separate(
    scene: Scene,
    changes: Sequence[float],
    method: Method,
    schedule: Steps,
    enough: float = math.inf,
) -> Array:
    """Return how far runs that begin a small change apart come from the unchanged one.

    Parameters
    ----------
    scene : Scene
    changes : sequence of C float
        See `perturb`.
    method, schedule
        Of all runs, which land on every sample; what these leave out is the same in all.
    enough : float
        Distance beyond which they need not be followed: it stays as it is then.

    Returns
    -------
    (C, T) array
        The larger of the distances in displacement and velocity, over the largest motion.
    """
    batch = ChainBatch([scene, *(perturb(scene, change) for change in changes)])
    stepper = NativeStepper(batch, method, schedule, {})
    grains = scene.chain.grains
    pieces = 1 if enough == math.inf else PIECES
    count = max(1, min(scene.samples // pieces, BLOCK_BYTES // (64 * grains)))
    fields = np.zeros((2, 1 + len(changes), count, grains))
    displacement, velocity = fields
    # no step leads to sample 0
    fields[:, :, 0] = batch.initial
    distances = np.zeros((2, len(changes), scene.samples))
    for first in range(0, scene.samples, count):
        largest = stepper.largest()[0]
        scale = np.where(largest > 0, largest, 1.0)
        if first and (distances[:, :, first - 1].max(1) > enough * scale).any():
            distances[:, :, first:] = distances[:, :, first - 1 : first]
            break
        final = min(first + count, scene.samples) - 1
        while stepper.sample < final:
            stepper.fill(displacement, velocity, first, final, BURST)
        samples = fields[:, :, : final + 1 - first]
        distances[:, :, first : final + 1] = np.abs(samples[:, 1:] - samples[:, :1]).max(-1)
    largest = stepper.largest()[0]
    scale = np.where(largest > 0, largest, 1.0)
    return (distances / scale[:, None, None]).max(0)


def could_grow(scene: Scene, evaluations: float) -> float:
    """Return a bound on `amplify_rounding`, from the phase of the fastest motion alone."""
    exponent = GROWTH.rate * scene.total_phase
    digits = count_digits(evaluations)
    return GROWTH.digit * digits * math.exp(min(exponent, 99.0))  # more than any scene has room for


def amplify_rounding(scene: Scene, evaluations: float) -> Array:
    """Return the amplified rounding of so many evaluations of the force at each sample, (T,).

    Relative to the largest motion. The runs that show it take a fraction of the time of an answer.
    """
    return count_digits(evaluations) * grow_digit(scene)


def grow_digit(scene: Scene, enough: float = math.inf) -> Array:
    """Return what becomes of a last digit at each sample, (T,), followed until it is `enough`."""
    changes = (GROWTH.digit * np.array(GROWTH.changes)).tolist()
    method = methods_of(scene.chain.damped)["verlet"]
    for reach in (GROWTH.reach, GROWTH.reach / GROWTH.shorter):
        steps = math.ceil(scene.sampling_phase / reach)
        schedule = Steps.spread(scene.sampling_interval, steps)
        distances = separate(scene, changes, method, schedule, enough)
        # steps too long for contacts that are pressed so much stiffer show no growth but their own
        if distances.max() <= GROWTH.broken:
            break
    # a run that broke down says nothing of the growth in the others
    followed = distances.max(1) <= GROWTH.broken
    return distances.max(0, where=followed[:, None], initial=0.0)


def repeat_rounding(scene: Scene, method: Method, steps: Steps) -> Array:
    """Return the rounding of an answer at each sample, (T,), as runs with its steps show it.

    They begin a last digit apart, and round in other ways from there on. They take several times
    the time of the answer.
    """
    changes = EPSILON * np.array(GROWTH.repeats)
    distances = separate(scene, changes.tolist(), method, steps.sampled)
    return GROWTH.safety * distances.max(0)


def count_digits(evaluations: float) -> float:
    """Return the rounding of so many evaluations of the force in last digits, at least one."""
    return max(1.0, EPSILON / GROWTH.digit * accumulate(evaluations))
