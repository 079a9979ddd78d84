"""Rounding errors of native runs, and their amplification by a scene.

Waves that pass again and again through opening contacts amplify rounding errors (the finite-time
Lyapunov exponent of the motion is above 0), whatever the step size. Native runs from slightly
different initial values measure the amplification.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...integrators.batch import ChainBatch
from ...integrators.methods import methods_of
from ...integrators.stepper import NativeStepper
from ...integrators.steps import Method, Steps
from ...scene.excitation import Profile
from ...scene.scene import Scene
from ...util.arrays import EPSILON, Array


@dataclass(frozen=True)
class Rounding:
    """Rounding errors of native runs, in units in the last place.

    Attributes
    ----------
    phase : float
        Phase error of the fastest motion for each radian of its phase, because masses, stiffnesses
        and fractions of a step are rounded.
    drift : float
        Rounding bias for each evaluation of the force in free flight, where equal steps round to
        one side.
    plain : float
        Error of the force for each step, in units of the force at rest: the plain form of the force
        is computed as a difference from the force at rest.
    interpolated : float
        Error of an interpolated velocity, in units of the largest displacement per mean step,
        because velocities between steps are differences of displacements.
    reduced : float
        Error of the velocity of a damped chain, in units of the largest damping rate times the
        largest displacement: `chain.damping` computes the velocity as a reduced velocity plus a
        damping term.
    """

    phase: float = 1.5
    drift: float = 0.125
    plain: float = 0.9
    interpolated: float = 8.0
    reduced: float = 8.0


ROUNDING = Rounding()


def accumulate(evaluations: float, flights: float = 0.0) -> float:
    """Return the accumulated rounding error of force evaluations, in units in the last place.

    While grains touch, the error is a random walk of n evaluations, sqrt(n). A grain that is pushed
    during the fraction 1/k of the run has a velocity error of sqrt(n/k); if it then flies freely,
    it flies k times as far, and the error of its position grows to sqrt(n k). Equal steps also
    round the position of a flying grain to one side. A flight lasts for n / k evaluations, and
    these rounding errors add up to `ROUNDING.drift` n / k.

    Parameters
    ----------
    evaluations : float
        Number n of force evaluations.
    flights : float
        Ratio k of the path of the fastest grain to the largest displacement; 0 if no contact
        opens.
    """
    if not flights:
        return math.sqrt(evaluations)
    return max(math.sqrt(evaluations * flights), drift(evaluations, flights))


def drift(evaluations: float, flights: float) -> float:
    """Return the one-sided rounding error of equal steps, in ulps; see `accumulate`."""
    return ROUNDING.drift * evaluations / flights if flights else 0.0


def flown(scene: Scene, displacement: float, velocity: float) -> float:
    """Return the path of a grain at the largest velocity over the largest displacement."""
    return velocity * scene.duration / displacement


def free_flights(scene: Scene, displacement: float, velocity: float) -> float:
    """Return the ratio `flights` of `accumulate`, if grains turn as often as the fastest motion."""
    return max(min(flown(scene, displacement, velocity), scene.total_phase), 1.0)


def native_floor(evaluations: float, radians: float, flights: float = 0.0) -> float:
    """Return the rounding error of a native run, relative to the largest motion.

    Parameters
    ----------
    evaluations : float
        Number of evaluations of the force.
    radians : float
        Phase of the fastest motion during the run, rad.
    flights : float
        Ratio of the path of the fastest grain to the largest displacement, as in `accumulate`.
    """
    walk = accumulate(evaluations, flights)
    return EPSILON * (2 + walk + ROUNDING.phase * radians)


def plain_loss(scene: Scene, steps: float) -> float:
    """Return the rounding error of the velocity by the plain form of the force, m/s.

    Rounding of the force at rest F_n adds an acceleration a = 0.9 EPSILON F_n / m of random sign in
    every step of length h. The error of the velocity is then a sqrt(duration h).
    """
    return ROUNDING.plain * EPSILON * scene.chain.load_over_mass * scene.duration / math.sqrt(steps)


def interpolation_loss(steps: float, flights: float = 1.0) -> float:
    """Return the rounding error of interpolated velocities, over the largest velocity.

    `flights` is the ratio of the path of the fastest grain to the largest displacement.
    """
    return ROUNDING.interpolated * EPSILON * steps / flights


def reduced_loss(scene: Scene, displacement: float, closer: float) -> float:
    """Return the rounding error of the velocity of a damped chain, m/s.

    The velocity is v = w + b(x) - gamma x, see `chain.damping`. In a slow motion v is much smaller
    than w, b and gamma x, and so the relative rounding error of v is large.

    Parameters
    ----------
    scene : Scene
        Scene with a damped chain.
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
    """Return the energy that contacts gain by the rounding of heights, J, as a random walk."""
    height = scene.chain.diameters.sum() + np.abs(scene.initial()[0]).max()
    closer = np.full(scene.chain.grains + 1, EPSILON * accumulate(evaluations) * height)
    return float(scene.chain.contacts.energy(closer).sum())


@dataclass(frozen=True)
class DigitGrowth:
    """Parameters of measuring amplified rounding; analysis/calibration/amplified_rounding.py.

    Attributes
    ----------
    digit : float
        Unit of a change at t = 0, relative to the largest motion: a few ulps of 1.
    changes : tuple of float
        Changes at t = 0, in units of `digit`. Several changes are tried, because the growth of a
        single one scatters by a factor of ten.
    repeats : tuple of float
        Changes at t = 0, in ulps of 1, for runs with the steps of the answer. The changes make the
        runs round differently from the answer; their sizes hardly matter.
    reach : float
        Phase step omega h of the runs that measure growth by velocity Verlet. These runs must be
        stable but need not be accurate.
    shorter : float
        Factor by which the steps of these runs are shortened once if a run breaks down.
    rate : float
        Upper bound on the growth exponent for each radian of the fastest motion. The growth is not
        measured if a change remains negligible at this rate.
    broken : float
        Distance of two runs, over the largest motion, beyond which one of them has broken down. Two
        sound runs differ by at most 2.
    safety : float
        Factor on the distances of runs with the steps of the answer, because these distances
        scatter.
    pessimism : float
        Factor by which the product of random walk and growth may exceed the amplified rounding
        error. If the product exceeds the tolerance by less than this factor, runs with the steps of
        the answer decide whether the tolerance is met.
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
    """Return the scene with velocities changed by a fraction of the largest, in alternating sign.

    If there are no initial velocities, the displacements are changed. If a force or a drive acts
    after t = 0, it is scaled by 1 + `change` instead.
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
    """Return the distances of runs with changed initial values from the unchanged run.

    Parameters
    ----------
    scene : Scene
        Scene of the unchanged run.
    changes : sequence of C float
        Relative changes of the initial values, as in `perturb`.
    method : Method
        Integration method of all runs.
    schedule : Steps
        Steps of all runs, which land on every sample, so that all truncation errors are the same.
    enough : float
        Distance at which the runs end; later samples get the last distance.

    Returns
    -------
    (C, T) array
        Larger of the distances in displacement and in velocity, over the largest motion.
    """
    batch = ChainBatch([scene, *(perturb(scene, change) for change in changes)])
    stepper = NativeStepper(batch, method, schedule, {})
    grains = scene.chain.grains
    pieces = 1 if enough == math.inf else 50
    count = max(1, min(scene.samples // pieces, 2**24 // (64 * grains)))
    fields = np.zeros((2, 1 + len(changes), count, grains))
    displacement, velocity = fields
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
            stepper.fill(displacement, velocity, first, final, 10**6)
        samples = fields[:, :, : final + 1 - first]
        distances[:, :, first : final + 1] = np.abs(samples[:, 1:] - samples[:, :1]).max(-1)
    largest = stepper.largest()[0]
    scale = np.where(largest > 0, largest, 1.0)
    return (distances / scale[:, None, None]).max(0)


def could_grow(scene: Scene, evaluations: float) -> float:
    """Return an upper bound on `amplify_rounding` from the phase of the fastest motion alone."""
    # A ground may amplify at any rate.
    rate = GROWTH.rate if scene.chain.ground is None else math.inf
    exponent = rate * scene.total_phase
    digits = count_digits(evaluations)
    # No scene amplifies an error by more than exp(99).
    return GROWTH.digit * digits * math.exp(min(exponent, 99.0))


def amplify_rounding(scene: Scene, evaluations: float) -> Array:
    """Return the amplified rounding error of force evaluations at each sample, (T,).

    The error is relative to the largest motion. The measurement takes a fraction of the time of the
    answer.
    """
    return count_digits(evaluations) * grow_digit(scene)


def grow_digit(scene: Scene, enough: float = math.inf) -> Array:
    """Return the growth of a change of 1e-15 at each sample, (T,), until it is `enough`."""
    changes = (GROWTH.digit * np.array(GROWTH.changes)).tolist()
    methods = methods_of(scene.chain)
    method = methods.get("verlet") or next(iter(methods.values()))
    for reach in (GROWTH.reach, GROWTH.reach / GROWTH.shorter):
        steps = math.ceil(scene.sampling_phase / reach)
        schedule = Steps.spread(scene.sampling_interval, steps)
        distances = separate(scene, changes, method, schedule, enough)
        # Steps that are too long for strongly pressed contacts show the growth of an instability.
        if distances.max() <= GROWTH.broken:
            break
    # Runs that broke down are left out.
    followed = distances.max(1) <= GROWTH.broken
    return distances.max(0, where=followed[:, None], initial=0.0)


def repeat_rounding(scene: Scene, method: Method, steps: Steps) -> Array:
    """Return the rounding error of an answer at each sample, (T,), from runs with its steps.

    The initial values of these runs differ by about one ulp, so that the runs round differently.
    Together the runs take several times the time of the answer.
    """
    changes = EPSILON * np.array(GROWTH.repeats)
    distances = separate(scene, changes.tolist(), method, steps.sampled)
    return GROWTH.safety * distances.max(0)


def count_digits(evaluations: float) -> float:
    """Return the rounding error of force evaluations in units of `GROWTH.digit`, at least 1."""
    return max(1.0, EPSILON / GROWTH.digit * accumulate(evaluations))
