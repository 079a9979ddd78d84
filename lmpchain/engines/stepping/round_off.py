"""Rounding of a native run, as measured by analysis/calibration/roundoff.py."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...scene.scene import Scene
from ...util.arrays import EPSILON


@dataclass(frozen=True)
class Rounding:
    """Last digits that a native run loses.

    Attributes
    ----------
    phase : float
        Of the phase of the fastest motion, a radian: masses, stiffnesses and fractions of a step
        are rounded.
    drift : float
        Of a motion, an evaluation of the force: in free flight equal steps round to one side.
    plain : float
        Of the force at rest, a step: the plain form of the force subtracts it.
    interpolated : float
        Of a displacement, a mean step: velocities between steps are differences of displacements.
    reduced : float
        Of the velocity at which damping alone would move displacements: that of a damped chain is a
        sum of it and of the reduced one.
    """

    phase: float = 1.5
    drift: float = 0.125
    plain: float = 0.9
    interpolated: float = 8.0
    reduced: float = 8.0


ROUNDING = Rounding()


def accumulate(evaluations: float, flights: float = 0.0) -> float:
    """Return the last digits that the rounding of so many evaluations of the force adds up to.

    While grains touch, it is a random walk of n evaluations, sqrt(n). A grain that is pushed for a
    time t/k and flies freely for t has only the velocity of sqrt(n/k) evaluations off, but comes k
    times as far with it: sqrt(n k). One that flies for the whole run by steps of one length is
    rounded to the same side by all of them: drift n, or n/k of a grain that flies so far in a kth
    of the time.

    Parameters
    ----------
    evaluations : float
        n.
    flights : float
        k, how far the fastest grain would come in the whole run, over the largest displacement; 0
        where no contact opens.
    """
    if not flights:
        return math.sqrt(evaluations)
    return max(math.sqrt(evaluations * flights), drift(evaluations, flights))


def drift(evaluations: float, flights: float) -> float:
    """Return the last digits that steps of one length lose to one side; see `accumulate`."""
    return ROUNDING.drift * evaluations / flights if flights else 0.0


def native_floor(evaluations: float, radians: float, flights: float = 0.0) -> float:
    """Return the round-off of a native run, relative to the largest motion.

    Parameters
    ----------
    evaluations : float
        Of the force.
    radians : float
        Phase of the fastest motion.
    flights : float
        See `accumulate`.
    """
    walk = accumulate(evaluations, flights)
    return EPSILON * (2 + walk + ROUNDING.phase * radians)


def plain_loss(scene: Scene, steps: float) -> float:
    """Return the velocity that the plain form of the force loses in so many steps, m/s.

    The last digit of the force at rest is an acceleration a = 0.9 EPSILON F_n / m; at every step it
    goes either way, which makes a sqrt(duration h) of the velocity.
    """
    return ROUNDING.plain * EPSILON * scene.chain.load_over_mass * scene.duration / math.sqrt(steps)


def interpolation_loss(steps: float, flights: float = 1.0) -> float:
    """Return the round-off of velocities of interpolated samples, over the largest velocity.

    `flights` is how far the fastest grain would come in the whole run, over the largest
    displacement.
    """
    return ROUNDING.interpolated * EPSILON * steps / flights


def reduced_loss(scene: Scene, displacement: float, closer: float) -> float:
    """Return the velocity that a damped chain loses by cancellation, m/s.

    Its velocity is v = w + b(x) - gamma x, see `chain.damping`. In a slow motion v is small, and
    the rounding errors of w, b and gamma x are not.

    Parameters
    ----------
    scene : Scene
    displacement : float
        Largest displacement, m.
    closer : float
        Largest approach of two grains beyond that at rest, m.
    """
    chain = scene.chain
    stiffness = chain.contacts.stiffness_bound(chain.contacts.overlap + max(closer, 0.0))
    viscous = chain.contact_viscosity * stiffness
    rates = (viscous[:-1] + viscous[1:]) / chain.masses + chain.drag
    return ROUNDING.reduced * EPSILON * float(rates[: chain.movable].max()) * displacement


def rounded_energy(scene: Scene, evaluations: float) -> float:
    """Return the energy that contacts gain by the rounding of heights, J: the last digit walks."""
    height = scene.chain.diameters.sum() + np.abs(scene.initial()[0]).max()
    closer = np.full(scene.chain.grains + 1, EPSILON * accumulate(evaluations) * height)
    return float(scene.chain.contacts.energy(closer).sum())
