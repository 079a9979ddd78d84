"""Derivatives by central differences of native runs, for laws by formula and grounds.

With changes h and h/2 of a parameter, central differences D(h) and D(h/2) have errors of order h^2.
Richardson's extrapolation ``(4 D(h/2) - D(h)) / 3`` is of order h^4, and ``|D(h) - D(h/2)|`` bounds
its error. All runs have the same steps, so that only the derivative of their truncation error
remains. Runs with other steps show the size of this derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, RunFailed
from ..integrators.batch import ChainBatch
from ..integrators.differentiation import AnyMethod
from ..integrators.methods import DormandPrince
from ..integrators.observed_run import schedule_of
from ..integrators.stepper import NativeStepper, room_for
from ..scene.scene import Scene
from ..util.arrays import Array
from . import parameters as params
from .parameters import changed

# Change of the phase of the fastest motion in the first difference, rad, and the largest relative
# change of a parameter there; largest change in any difference, relative to the parameter, or to
# the change of a parameter of a formula that changes the force by itself.
FIRST_PHASE = 0.1
FIRST_CHANGE = 1e-2
MAX_CHANGE = 0.1
MOST_CHANGES = 3  # Largest number of further changes.
TURN = 0.5  # Initial phase advance of the fastest motion between two evaluation times, rad.
# Largest number of steps in one call of a stepper.
UNLIMITED_STEPS = 2**62


class FixedRun(NamedTuple):
    """A native run with prescribed steps, and the motion of its observed grains.

    Attributes
    ----------
    time : (T,) array
        Times of the observations, s.
    grains : (G,) array
        Numbers of the observed grains.
    displacement, velocity : (T, G) arrays
        Displacement, m; velocity, m/s.
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
        stepper.fill(u, v, 0, looks, UNLIMITED_STEPS)
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
        Extrapolated derivatives with respect to the multiple of each direction.
    spread : (D, ...) array
        Absolute difference between the derivatives for both changes.
    rounding : float
        Rounding error of the derivatives.
    """

    slope: Array
    spread: Array
    rounding: float

    @property
    def error(self) -> float:
        """Largest error of the derivatives."""
        return float(self.spread.max(initial=0.0)) + self.rounding


def differentiate(
    scene: Scene,
    name: str,
    directions: Array,
    value: Callable[[Scene], Array],
    rounding: float,
    accuracy: float,
) -> Differences:
    """Return the derivatives of a function of the scene along directions of one parameter.

    The size of the change is chosen so that the derivatives for both changes agree within the
    accuracy.

    Parameters
    ----------
    scene : Scene
    name : str
        Name of the parameter.
    directions : (D, P) array
        Directions, in the unit of the parameter.
    value : function
        Function that returns an array for a scene.
    rounding : float
        Rounding error of a value.
    accuracy : float
        Desired error, relative to the largest derivative.
    """
    base = params.values(scene, name)

    def difference(direction: Array, part: float) -> Array:
        up, down = (
            value(changed(scene, {name: base + side * part * direction})) for side in (1, -1)
        )
        return (up - down) / (2 * part)

    def attempt(change: float) -> Differences:
        coarse, fine = (
            np.array([difference(direction, part) for direction in directions])
            for part in (change, change / 2)
        )
        spread = np.abs(fine - coarse)
        return Differences((4 * fine - coarse) / 3, spread, 2 * rounding / change)

    largest = MAX_CHANGE
    # The phase of the fastest motion changes by a part of a radian.
    change = FIRST_PHASE / max(FIRST_PHASE / FIRST_CHANGE, scene.total_phase)
    best = found = attempt(change)
    for _ in range(MOST_CHANGES):
        allowed = accuracy * float(np.abs(best.slope).max(initial=0.0))
        if best.error <= allowed or allowed == 0.0:
            break
        spread = float(found.spread.max())
        if spread > found.rounding:
            # The spread is of second order in the change.
            change *= math.sqrt(allowed / (2 * spread))
        else:
            # Rounding, which is inversely proportional to the change, causes the spread.
            change *= 2 * found.rounding / allowed
        try:
            if change > largest:
                largest = largest_change(scene, name, directions)
            change = min(change, largest)
            found = attempt(change)
        except InputError:
            # The force does not depend on the parameter, or the law does not allow the change.
            break
        best = min(best, found, key=lambda differences: differences.error)
    return best


def scales_of(scene: Scene, name: str) -> Array:
    """Return the size of every entry of a parameter, (P,), by which its changes are scaled.

    An entry of 0 gets the size of the largest entry; if all entries are 0, the size is that of
    `size_by_force`. The size is 0 for missing walls and for the motion of held grains.

    Raises
    ------
    InputError
        If all entries are 0 and the size of a change is undefined.
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
        largest = size_by_force(scene, name)
    scales = np.where(base > 0, base, largest)
    if name in ("velocity", "displacement"):
        scales[scene.chain.movable :] = 0.0
    return scales


def largest_change(scene: Scene, name: str, directions: Array) -> float:
    """Return the largest change in any difference, relative to the directions, (D, P).

    A parameter of a formula with little influence on the force may change by more than itself.
    """
    if not name.startswith("chain."):
        return MAX_CHANGE
    return MAX_CHANGE * max(1.0, size_by_force(scene, name) / float(np.abs(directions).max()))


def first_looks(scene: Scene) -> int:
    """Return the initial number of evaluation times after t = 0."""
    return max(8, math.ceil(scene.total_phase / TURN))


def size_by_force(scene: Scene, name: str) -> float:
    """Return the change of a parameter of a formula that changes the force by the force itself.

    Both are the largest ones in a run. The force of a ground is compared with the largest force of
    inertia, too, because it may be 0.

    Raises
    ------
    InputError
        If the parameter does not change the force, or belongs to no formula.
    """
    size = 0.0
    if name.startswith("chain."):
        chain = scene.chain
        law, key = params.formula_of(chain, name)
        grains = np.arange(chain.grains) + 1
        run = FixedRun.of(scene, DormandPrince(), scene.duration, first_looks(scene), grains)
        force = 0.0
        if law.of_ground:
            places = run.displacement, run.time[:, None]
            force = np.abs(chain.masses * np.gradient(run.velocity, run.time, axis=0)).max()
        else:
            numbers = np.flatnonzero(chain.contacts.exists)
            law = law.with_walls(chain.grains).of(numbers)
            closer = -np.diff(run.displacement, prepend=0.0, append=0.0)
            overlap = (chain.contacts.overlap + closer)[:, numbers]
            places = overlap, chain.contacts.constant[numbers]
        force = max(force, np.abs(law.force(*places)).max())
        slope = np.abs(law.force_slope(key, *places)).max()
        size = float(force / slope) if slope > 0 else 0.0
    if not 0 < size < math.inf:
        message = "is 0, so that the size of a change is undefined: give a value other than 0"
        raise InputError.at(name, message)
    return size
