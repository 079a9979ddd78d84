"""What rounding makes of a native run, as measured by analysis/calibration/roundoff.py."""

from __future__ import annotations

import math

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import EPSILON

PHASE_ULPS = 1.5  # of the phase of the fastest motion, by which rounding shifts it
DISPLACED = 0.05  # part of omega x_max / v_max by which the rounding of displacements exceeds that of velocities
DRIFTED = 0.125  # last digits of a displacement that an evaluation loses in free flight at steps of one length
PLAIN = 0.9  # last digits of the force at rest that the plain form loses in a step
# last digits of a displacement, over a mean step, that the velocity of an interpolated sample loses;
# analysis/calibration/long_steps.py
INTERPOLATED = 8.0


def native_floor(
    evaluations: float, radians: float, displaced: float = 0.0, straight: bool = False
) -> float:
    """Return the round-off of the native integration, relative to the largest motion.

    A random walk of half-ulps, more where displacements are large against v / omega (`displaced` times), for a stiff
    contact makes a velocity of their last digit; and the phase (in `radians` of the fastest motion), which the rounding
    of masses, stiffnesses and fractions of a step shifts in proportion to the time: by 0.1 to 4 ulps of it.
    `straight` says that grains may fly freely at steps of one length: these round to the same side then, which adds up
    for as long as the flight to the largest displacement takes.
    """
    walk = math.sqrt(evaluations) * max(1.0, DISPLACED * displaced)
    if straight:
        walk = max(walk, DRIFTED * evaluations * min(displaced / radians, 1.0))
    return EPSILON * (2 + walk + PHASE_ULPS * radians)


def plain_loss(scene: Scene, steps: float) -> float:
    """Return the velocity that the plain form of the force loses in so many steps, m/s.

    That is the last digit of what the contacts carry at rest, at every step: an acceleration of 0.9 EPSILON F_n/m,
    which walks to that times sqrt(duration h) in the velocity.
    """
    return PLAIN * EPSILON * scene.chain.load_over_mass * scene.duration / math.sqrt(steps)


def between_loss(steps: float, travelled: float) -> float:
    """Return what the velocities of interpolated samples lose in so many steps, over the largest one.

    They follow from differences of displacements over a step. `travelled` is the largest displacement over how far the
    fastest grain would come in the whole run; near contacts that open steps are shorter than the mean.
    """
    return INTERPOLATED * EPSILON * steps * travelled


def rounded_energy(scene: Scene, evaluations: float) -> float:
    """Return the energy that contacts gain by rounding where heights are held, J: their last digit walks."""
    height = scene.chain.diameters.sum() + np.abs(scene.initial()[0]).max()
    closer = np.full(scene.chain.grains + 1, EPSILON * math.sqrt(evaluations) * height)
    return float(scene.chain.contacts.energy(closer).sum())
