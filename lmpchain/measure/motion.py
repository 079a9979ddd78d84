"""The motion between samples, and the largest values that it reaches there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from . import extremes
from .derivatives import STILL, UNKNOWN, derivatives
from .hermite import DISPLACEMENT, RAISED, VELOCITY
from .spectrum import Field

KINDS = {"velocity": VELOCITY, "displacement": DISPLACEMENT}
# omega h up to which no motion hides between two samples; analysis/calibration/between_samples.py
RESOLVED = 2.0
RESOLVED_BY_DIFFERENCES = 0.7  # the same where accelerations come from the samples


@dataclass(frozen=True, eq=False)
class Peaks:
    """The largest displacement or speed that each of G grains reaches at any time.

    Attributes
    ----------
    field : "velocity" or "displacement"
    grain : (G,) array
    value, error : (G,) arrays
        Its size, m/s or m, and how far that may be off: by sampling, and by the error of the trajectory where it is
        known.
    """

    field: Field
    grain: np.ndarray
    value: Array
    error: Array


class Motion:
    """Displacement, velocity, acceleration and jerk of grains at the samples, and bounds on what lies between.

    Where the equation of motion of the trajectory is Eq. (1) or (3), and the neighbours of a grain are known, they give
    its acceleration and jerk; else these follow from three neighbouring samples.

    Parameters
    ----------
    scene : Scene
    equation : int
        Number in the paper of the equation that the motion obeys; 0 if it is not known.
    grains : (G,) array
        Recorded grains.
    displacement, velocity : (T, G) arrays
        Of these.
    error : float
        Relative error of the trajectory, as `ErrorEstimate.total`; one that is not known is left out.

    Attributes
    ----------
    step : float
        Time between two samples, s.
    values : (4, G, T) array
        Displacement, velocity, acceleration and jerk, m and s.
    """

    def __init__(
        self, scene: Scene, equation: int, grains: np.ndarray, displacement: Array, velocity: Array, error: float
    ):
        self._scene, self._equation, self._error = scene, equation, error if math.isfinite(error) else 0.0
        self._u, self._v = (np.ascontiguousarray(x, dtype=float) for x in (displacement, velocity))
        self.step = scene.duration / (scene.samples - 1)
        chain, excitation = scene.chain, scene.excitation
        contacts, linear = chain.contacts, equation == 3
        self._column = columns(scene, grains)
        self._grains = grains
        bodies = grains[:, None] + np.array([-1, 0, 1])
        sides = self._column[bodies]
        between = grains[:, None] + np.array([-1, 0])  # contacts above and below
        pressed, constant = contacts.pressed, contacts.constant
        length = np.divide(1.0, contacts.overlap, out=np.ones_like(constant), where=pressed)
        loose = np.zeros_like(constant) if linear and chain.exponent > 1 else constant
        strength = np.where(pressed, contacts.force, loose)
        table = np.stack([length, strength, pressed.astype(float)], axis=1)[between]
        inverse_mass = np.where(grains <= chain.movable, 1 / chain.masses[grains - 1], 0.0)
        known = ((sides[:, [0, 2]] != UNKNOWN) | ~contacts.exists[between]).all(1) & (equation in (1, 3))
        if excitation.does_work:
            first, last = excitation.reach(chain)
            known &= (grains < first) | (grains > last)
        self._known: NDArray[np.bool_] = known | (inverse_mass == 0) & ~(grains <= chain.movable)
        self.values: Array = derivatives(
            self._u, self._v, sides, table, inverse_mass, chain.exponent, linear, self.step, self._known
        )

    def peaks(self, field: Field) -> Peaks:
        """Return the largest displacement or speed of every grain."""
        found = extremes.peaks(self.values, self.step, KINDS[field], self.ceiling)
        return Peaks(field, self._grains, *_within(found, self.known_error(field)))

    def closest(self, contact: int) -> tuple[float, float]:
        """Return by how much the overlap of a contact exceeds that at rest at most, m, and the error."""
        sides, ceiling = [], np.zeros((1, 0)) if not self.ceiling.size else np.zeros((1, self._u.shape[0] - 1))
        for grain in (contact, contact + 1):
            column = self._column[grain]
            if column == UNKNOWN:
                raise InputError([("grains", f"this takes a grain that was not recorded; record {grain} too")])
            sides.append(0.0 if column == STILL else self.values[:, column])
            if ceiling.size and column != STILL:
                limits = self.ceiling[column]
                ceiling[0] = np.where((limits < 0) | (ceiling[0] < 0), -1.0, ceiling[0] + limits)
        approach = np.ascontiguousarray((sides[0] - sides[1])[:, None])
        found = extremes.peaks(approach, self.step, RAISED, ceiling)
        value, error = _within(found, 2 * self.known_error("displacement"))
        return float(value[0]), float(error[0])

    def fronts(self, field: Field, fraction: float, certain: float) -> Array:
        """Return time, value and width of the front at every grain, and their errors, (G, 6); see `front.track`."""
        known, frequency = self.known_error(field), self._scene.highest_frequency
        found: Array = extremes.fronts(
            self.values, self.step, KINDS[field], self.ceiling, fraction, known, certain, frequency
        )
        return found[:, :6]

    def known_error(self, field: Field) -> float:
        """Return how far any value may be off by the error of the trajectory."""
        if not self._error:
            return 0.0
        imposed = self._scene.excitation.largest(self._scene.chain)[field == "velocity"]
        moved = self._v if field == "velocity" else self._u
        return self._error * max(float(np.abs(moved).max()), float(np.abs(imposed).max()))

    @cached_property
    def ceiling(self) -> Array:
        """Bounds on the speed of each grain between samples, (G, T-1) m/s; -1 where nothing hides; or (1, 0)."""
        swift = self._scene.highest_frequency * self.step
        if swift <= RESOLVED_BY_DIFFERENCES or (swift <= RESOLVED and self._known.all()):
            return np.zeros((1, 0))
        if swift <= RESOLVED:
            limits = np.full((self._grains.size, self._u.shape[0] - 1), -1.0)
            limits[~self._known] = self._speed_limit()[0][~self._known]
            return limits
        limits, frequency = self._speed_limit()
        allowed = np.where(self._known, RESOLVED, RESOLVED_BY_DIFFERENCES)
        return np.where(frequency * self.step <= allowed[:, None], -1.0, limits)

    def _speed_limit(self) -> tuple[Array, Array]:
        """Return bounds on speed and frequency of every grain between samples, (G, T-1) m/s and rad/s.

        No grain can have more than the energy that was within reach of it at the sample before.
        """
        scene, chain = self._scene, self._scene.chain
        contacts, count = chain.contacts, self._u.shape[0] - 1
        if scene.excitation.does_work or self._equation not in (1, 3):
            return np.full((2, self._grains.size, count), np.inf)
        near = math.ceil(scene.highest_frequency * self.step / 2) + 2
        if (self._column[1 : chain.movable + 1] == UNKNOWN).any():
            within = np.full((count, chain.grains), scene.energy)
        else:
            u, v = (np.zeros((count + 1, chain.grains)) for _ in range(2))
            u[:, self._grains - 1], v[:, self._grains - 1] = self._u, self._v
            r = contacts.closer(u)
            held = contacts.stiffness * r**2 / 2 if self._equation == 3 else contacts.energy(r)
            energy = chain.masses * v**2 / 2 + held[:, 1:] + held[:, :-1]  # each contact twice: a bound
            total = np.concatenate((np.zeros((count + 1, 1)), np.cumsum(energy, axis=1)), axis=1)
            n = np.arange(chain.grains)
            around = total[:, np.minimum(n + near + 1, chain.grains)] - total[:, np.maximum(n - near, 0)]
            within = np.maximum(around[:-1], 0.0)
        speed = np.sqrt(2 * within / chain.masses)
        shared = np.maximum(np.pad(within, ((0, 0), (1, 0))), np.pad(within, ((0, 0), (0, 1))))
        linear = self._equation == 3
        stiffness = contacts.stiffness if linear else contacts.stiffness_at(contacts.overlap_bound(shared))
        square = np.broadcast_to((stiffness[..., 1:] + stiffness[..., :-1]) / chain.masses, within.shape)
        edged = np.pad(square, ((0, 0), (1, 1)))
        square = np.maximum(np.maximum(edged[:, :-2], edged[:, 2:]), square)
        return speed[:, self._grains - 1].T, np.sqrt(square[:, self._grains - 1]).T


def motion_of(trajectory: Trajectory) -> Motion:
    """Return the motion of a trajectory between its samples; nothing is known of its equation without an error."""
    error = trajectory.error_estimate
    equation = trajectory.equation if math.isfinite(error.solver) else 0
    u, v = (np.asarray(x) for x in (trajectory.displacement, trajectory.velocity))
    return Motion(trajectory.scene, equation, trajectory.grains, u, v, error.total)


def peaks(trajectory: Trajectory, field: Field = "velocity") -> Peaks:
    """Return the largest displacement or speed that every recorded grain reaches, at the samples or between them.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=2e-5, samples=9)
    >>> sparse, dense = (peaks(lmpchain.simulate(scene.part(1, 20), "native")) for _ in range(2))
    >>> bool((abs(sparse.value - dense.value) <= sparse.error + dense.error).all())
    True
    """
    if field not in get_args(Field):
        raise InputError([("field", f'must be "velocity" or "displacement" (got {field!r})')])
    return motion_of(trajectory).peaks(field)


def columns(scene: Scene, grains: np.ndarray) -> NDArray[np.intp]:
    """Return the recorded column of each body, (N+2,), or a mark if it stands still or is unknown."""
    chain = scene.chain
    column = np.full(chain.grains + 2, UNKNOWN)
    column[[0, -1]] = STILL
    column[chain.movable + 1 :] = STILL
    column[grains] = np.arange(grains.size)
    return column


def _within(found: Array, known: float) -> tuple[Array, Array]:
    """Return values and their errors from values and the bounds between which they lie, (G, 3)."""
    value, low, high = found.T
    return value, np.maximum(high - value, value - low) + known
