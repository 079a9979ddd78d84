"""Predictability horizon from the growth of a small change: law and measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..engines.base import Proposal
from ..engines.native import Native
from ..engines.stepping.rounding import separate
from ..errors import InputError, RunFailed
from ..integrators.methods import BY_NAME
from ..scene.scene import Scene
from ..util.arrays import Array


@dataclass(frozen=True)
class MeasuredGrowth:
    """Range of columns for which `growth_rate` was measured.

    The measurement is analysis/calibration/predictability.py.

    Attributes
    ----------
    opening : float
        Strike number above which many contacts open.
    flying : float
        Largest ratio of the strike number to the number of grains. Above it the top grain flies
        away with most of the energy.
    fewest : int
        Smallest number of grains.
    most : int
        Largest number of grains.
    """

    opening: float = 30.0
    flying: float = 50.0
    fewest: int = 6
    most: int = 40


MEASURED = MeasuredGrowth()
# Change at t = 0 that grows like all rounding errors of a run; the measured median is 1e-14, the
# range 1e-15.4 to 1e-12.4 (analysis/calibration/amplified_rounding.py).
SEED = 1e-14
CHANGE = 10 * SEED  # Initial change whose growth is measured.


def reflection_time(scene: Scene) -> float:
    """Return the time of a strong pulse from the top to the floor and back, s.

    A grain with the velocity v0 in a chain without load excites a solitary wave that travels
    0.907470 (K/m)^(2/5) (0.681632 v0)^(1/5) grains per second; A. Chatterjee, Phys. Rev. E 59, 5912
    (1999), and values computed for this package (analysis/calibration/predictability.py).

    Parameters
    ----------
    scene : Scene
        A scene with an impulse on a chain with exponent 1.5.

    Returns
    -------
    float
        Time, s.

    Raises
    ------
    InputError
        If the exponent is not 1.5 or the excitation is not an impulse.
    """
    if scene.chain.law.power != 1.5 or not scene.strike_velocity:
        message = "must be an impulse on a chain with exponent 1.5"
        raise InputError.at("excitation", message)
    chain = scene.chain
    gamma = float(chain.contact_constants.mean() / chain.masses.mean())
    speed = 0.907470 * gamma**0.4 * (0.681632 * abs(scene.strike_velocity)) ** 0.2
    return 2 * chain.grains / speed


def growth_rate(scene: Scene) -> float:
    """Predict the Lyapunov exponent of a column struck at the top, in decades per second.

    The measured growth during one reflection time is 0.9 (1 - exp(-N / 20)) decades for N grains,
    within a factor of 1.5. It depends on neither strike nor gravity for N = 6 ... 40, strike
    numbers from 30 to 50 times N, and gravity from 0.1 to 100 g
    (analysis/calibration/predictability.py).
    A weaker strike opens few contacts. After a stronger strike the top grain flies away with most
    of the energy.

    Parameters
    ----------
    scene : Scene
        A scene for which `amplifies` is true.

    Returns
    -------
    float
        Lyapunov exponent, decades per second.
    """
    return 0.9 * (1 - math.exp(-scene.chain.grains / 20)) / reflection_time(scene)


def amplifies(scene: Scene) -> bool:
    """Return whether `growth_rate` applies: a strike on a short chain opens contacts.

    Parameters
    ----------
    scene : Scene
        The scene to check.

    Returns
    -------
    bool
    """
    grains = scene.chain.grains
    if not scene.excitation.strikes_top or scene.chain.law.power != 1.5:
        return False
    opens = MEASURED.opening < scene.strike_number < MEASURED.flying * grains
    return opens and MEASURED.fewest <= grains <= MEASURED.most


def predicted_time(scene: Scene, tolerance: float) -> float:
    """Predict the predictability horizon from `growth_rate`, s; it may exceed the duration.

    Parameters
    ----------
    scene : Scene
        A scene for which `amplifies` is true.
    tolerance : float
        Largest relative error of a predicted motion.

    Returns
    -------
    float
        Time from t = 0, s.
    """
    return math.log10(tolerance / SEED) / growth_rate(scene)


def growth(
    scene: Scene, perturbation: float = CHANGE, accuracy: float = 1e-11
) -> tuple[Array, Array]:
    """Measure the growth of a small change at t = 0 by two native runs with the same steps.

    The change increases and reduces the velocities of grains alternately, by a fraction of the
    largest velocity. Without initial velocities it shifts the grains instead. A force or drive is
    scaled.

    Parameters
    ----------
    scene : Scene
        The scene to run.
    perturbation : float
        Relative size of the change.
    accuracy : float
        Tolerance of the two runs.

    Returns
    -------
    time : (T,) array
        Times, s.
    distance : (T,) array
        Distance of the two runs, relative to the largest value: the larger of the distances of
        displacements and velocities.

    Raises
    ------
    ToleranceNotMet
        If rounding errors alone exceed `accuracy`, even without growth.
    """
    method = "dop853" if scene.chain.damped else "rkn6"
    proposal = Native(method).propose(scene.reached, accuracy)
    return scene.time, divergence(scene, proposal, perturbation)


def divergence(scene: Scene, proposal: Proposal, change: float) -> Array:
    """Return the relative distance between a run and a perturbed run at every sample, (T,).

    Both runs use the integrator and the steps of the proposal. Their distance is therefore due to
    the change, to rounding, and to the amplification of both.

    Parameters
    ----------
    scene : Scene
        The scene to run.
    proposal : Proposal
        A proposal of the native engine.
    change : float
        Relative size of the perturbation.

    Returns
    -------
    (T,) array
        Distance relative to the largest value: the larger of the distances of displacements and
        velocities.

    Raises
    ------
    RunFailed
        If a run breaks down.
    """
    distance = separate(
        scene.reached, (change,), BY_NAME[proposal.integrator], proposal.steps.sampled
    )[0]
    if not np.isfinite(distance).all():
        raise RunFailed("a run with a small initial perturbation broke down: use a shorter step")
    return distance


def predictability_time(scene: Scene, tolerance: float) -> float:
    """Measure the predictability horizon in double precision, s; infinite beyond the duration.

    Rounding errors grow like a change of 1e-14 at t = 0, within a factor of 30. At four decades per
    millisecond, as in columns of glass beads of 1 mm, this factor corresponds to 0.4 ms.

    Parameters
    ----------
    scene : Scene
        The scene to run.
    tolerance : float
        Largest relative error of a predicted motion.

    Returns
    -------
    float
        Time from t = 0, s; infinite if the whole run is predictable.
    """
    return predictability_time_of(*growth(scene, CHANGE), tolerance)


def predictability_time_of(times: Array, apart: Array, tolerance: float) -> float:
    """Return the predictability horizon from a growth measured for the default change, s.

    Parameters
    ----------
    times : (T,) array
        Times, s, as returned by `growth`.
    apart : (T,) array
        Distances of the two runs, as returned by `growth`.
    tolerance : float
        Largest relative error of a predicted motion.

    Returns
    -------
    float
        Time from t = 0, s; infinite if the whole run is predictable.
    """
    beyond = np.flatnonzero(apart > tolerance * CHANGE / SEED)
    return float(times[beyond[0]]) if beyond.size else math.inf
