"""Rounding of native runs, and its amplification by a scene.

Reflections through opening contacts make much of a last digit (a finite-time Lyapunov exponent
above 0), and no step can give it back. Native runs that begin a little apart show by how much.
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


def flown(scene: Scene, displacement: float, velocity: float) -> float:
    """Return how far a grain of the largest velocity would come, over the largest displacement."""
    return velocity * scene.duration / displacement


def free_flights(scene: Scene, displacement: float, velocity: float) -> float:
    """Return the same where contacts open: no grain turns faster than the fastest motion."""
    return max(min(flown(scene, displacement, velocity), scene.total_phase), 1.0)


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
    pieces = 1 if enough == math.inf else 50
    count = max(1, min(scene.samples // pieces, 2**24 // (64 * grains)))
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
            stepper.fill(displacement, velocity, first, final, 10**6)
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
