"""Derivatives by central differences of native runs, for laws by formula and grounds.

With changes h and h/2 of a parameter, central differences D(h) and D(h/2) have errors of order h^2.
Richardson's extrapolation ``(4 D(h/2) - D(h)) / 3`` is of order h^4, and ``|D(h) - D(h/2)|`` bounds
its error. All runs have the same steps, so that their truncation errors cancel up to the derivative
of this error, which runs at other steps show.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, RunFailed
from ..integrators.batch import ChainBatch
from ..integrators.differentiation import AnyMethod
from ..integrators.observed_run import schedule_of
from ..integrators.stepper import NativeStepper, room_for
from ..scene.scene import Scene
from ..util.arrays import Array
from . import parameters as params
from .changes import changed

# Largest and smallest change of the phase of the fastest motion, or relative change of another
# quantity, by a difference, rad.
MAX_CHANGE = 1e-2
MIN_CHANGE = 1e-6
# Largest number of steps in one call of a stepper.
MOST_STEPS = 2**62


class FixedRun(NamedTuple):
    """A native run with prescribed steps, and the motion of its observed grains.

    Attributes
    ----------
    time : (T,) array
        Times of the observations, s.
    grains : (G,) array
        Numbers of the observed grains.
    displacement, velocity : (T, G) arrays
        Motion, m and m/s.
    step : float
        Longest step, s.
    steps : int
        Number of steps.
    """

    time: Array
    grains: NDArray[np.intp]
    displacement: Array
    velocity: Array
    step: float
    steps: int

    @classmethod
    def of(
        cls,
        scene: Scene,
        method: AnyMethod,
        step: float,
        looks: int,
        grains: NDArray[np.intp],
        adaptive: bool = False,
    ) -> FixedRun:
        """Return a run with steps of at most this length, s; see `DifferentiableRun`.

        Raises
        ------
        RunFailed
            If the motion breaks down.
        """
        observed = scene.replace(samples=looks + 1, grains="all")
        schedule = schedule_of(observed, step, looks, adaptive)
        batch = ChainBatch([observed])
        stepper = NativeStepper(batch, method, schedule, {})
        u, v = room_for(1, looks + 1, scene.chain.grains)
        u[:, 0], v[:, 0] = batch.initial
        stepper.fill(u, v, 0, looks, MOST_STEPS)
        columns = grains - 1
        run = cls(
            observed.time,
            grains,
            u[0][:, columns],
            v[0][:, columns],
            schedule.step,
            int(stepper.steps[0]),
        )
        if not np.isfinite(run.velocity).all():
            message = f"the motion breaks down with steps of {run.step:.3g} s: use shorter ones"
            raise RunFailed(message)
        return run


class Differences(NamedTuple):
    """Derivatives of a function along D directions of a parameter, (D, ...).

    Attributes
    ----------
    slope : (D, ...) array
        Extrapolated derivatives, per length of the direction.
    spread : (D, ...) array
        Absolute difference between the derivatives by both changes.
    """

    slope: Array
    spread: Array


def differentiate(
    scene: Scene,
    name: str,
    directions: Array,
    value: Callable[[Scene], Array],
    change: float,
) -> Differences:
    """Return the derivatives of a function of the scene along directions of one parameter.

    Parameters
    ----------
    scene : Scene
    name : str
        Name of the parameter.
    directions : (D, P) array
        Directions, in the unit of the parameter.
    value : function
        Returns an array for a scene.
    change : float
        The larger of the two changes, as a part of a direction.
    """
    base = params.values(scene, name)

    def difference(direction: Array, part: float) -> Array:
        up, down = (
            value(changed(scene, {name: base + side * part * direction})) for side in (1, -1)
        )
        return (up - down) / (2 * part)

    coarse, fine = (
        np.array([difference(direction, part) for direction in directions])
        for part in (change, change / 2)
    )
    return Differences((4 * fine - coarse) / 3, np.abs(fine - coarse))


def scales_of(scene: Scene, name: str) -> Array:
    """Return the size of every entry of a parameter, (P,), which is that of its changes.

    An entry of 0 has the size of the largest one. Missing walls and the motion of grains that are
    held have the size 0.

    Raises
    ------
    InputError
        If all entries are 0, because no size of a change follows.
    """
    base = np.abs(params.values(scene, name))
    if name == "wall_constants":
        return base
    largest = float(base.max())
    if name == "velocity":
        largest = max(largest, scene.strike_velocity)
    if name == "displacement":
        largest = max(largest, scene.strike_velocity / scene.highest_frequency)
    if largest == 0:
        message = "is 0, from which no size of a change follows: give a value other than 0"
        raise InputError.at(name, message)
    scales = np.where(base > 0, base, largest)
    if name in ("velocity", "displacement"):
        scales[scene.chain.movable :] = 0.0
    return scales


def change_for(scene: Scene, largest: float) -> float:
    """Return the relative change of a parameter for this largest change of the phase, rad."""
    return max(largest, MIN_CHANGE) / max(1.0, scene.total_phase)
