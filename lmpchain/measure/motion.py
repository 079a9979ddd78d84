"""The motion between samples, and the largest values that it reaches there."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.between import extremes
from ..trajectory.between.derivatives import STILL, UNKNOWN, derivatives, largest
from ..trajectory.between.hermite import DISPLACEMENT, RAISED, VELOCITY
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from .recorded import Field, around, check_field

__dir__ = listed(__name__)

KINDS = {"velocity": VELOCITY, "displacement": DISPLACEMENT}
# omega h up to which no motion hides between two samples; analysis/calibration/between_samples.py
RESOLVED = 2.0
RESOLVED_BY_DIFFERENCES = 0.7  # the same where accelerations come from the samples


class Peaks(NamedTuple):
    """The largest displacement or speed that each of G grains reaches at any time.

    Attributes
    ----------
    grain : (G,) array
        Their numbers.
    value, error : (G,) arrays
        Its size, m/s or m, and how far that may be off: by sampling, and by the error of the trajectory where it is
        known.
    """

    grain: np.ndarray
    value: Array
    error: Array


class Motion:
    """The motion of grains at the samples and between them.

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
    scene, grains, displacement, velocity
        As given.
    step : float
        Time between two samples, s.
    """

    def __init__(
        self,
        scene: Scene,
        equation: int,
        grains: np.ndarray,
        displacement: Array,
        velocity: Array,
        error: float,
    ):
        self.scene, self._equation, self._error = (
            scene,
            equation,
            error if math.isfinite(error) else 0.0,
        )
        self.displacement, self.velocity, self.grains = displacement, velocity, grains
        self.step = scene.duration / (scene.samples - 1)
        # as the compiled loops take them
        self._fields = [np.ascontiguousarray(x, float) for x in (displacement, velocity)]
        self._sizes, moves, self.sampled = largest(*self._fields)
        chain = scene.chain
        ends = bool(chain.contacts.exists[0]), bool(chain.contacts.exists[-1])
        recorded = np.asarray(grains, dtype=int)
        self._around = around(
            chain.grains, chain.movable, *ends, recorded.tobytes(), moves.tobytes()
        )
        self._tops: dict[str, Array] = {}  # what `fronts` has found of peaks on the way

    @property
    def time(self) -> Array:
        """Sampled times, (T,) s."""
        return self.scene.time

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Whether the forces of its contacts are known, and all that act on it, of each grain, (G,)."""
        grains, chain, excitation = self.grains, self.scene.chain, self.scene.excitation
        held = grains > chain.movable
        if self._equation not in (1, 3):
            return held
        if not excitation.does_work:
            return self._around.known
        first, last = excitation.reach(chain)
        return np.asarray((self._around.known & ((grains < first) | (grains > last))) | held)

    @cached_property
    def _values(self) -> tuple[Array, NDArray[np.bool_]]:
        """What `derivatives.derivatives` returns of the grains that move, and which are quiet, (M,)."""
        chain, around = self.scene.chain, self._around
        own, inverse_mass = chain.contacts, 1 / chain.masses
        inverse_mass[chain.movable :] = 0.0
        contacts = np.array([own.constant, own.force, own.overlap])
        errors = (0.0, 0.0) if self.ceiling.size else self._known_errors
        found: tuple[Array, NDArray[np.bool_]] = derivatives(
            *self._fields, around.moves, self._sizes, errors, around.moving, around.sides, contacts, inverse_mass,
            chain.exponent, self._equation == 3, self.step, self._known,
        )  # fmt: skip
        return found

    def peaks(self, field: Field) -> Peaks:
        """Return the largest displacement or speed of every grain."""
        found = self._tops.get(field)
        if found is None:
            about = self.step, KINDS[field], self.ceiling, self.known_error(field)
            found = extremes.peaks(*self._values, self._around.moves, self.grains.size, *about)
        return Peaks(self.grains, found[:, 0], found[:, 1])

    def largest_wall_force(self) -> tuple[float, float]:
        """Return the largest force at any time on what holds the bottom, N, and how far that may be off.

        Raises
        ------
        InputError
            If nothing stands still at the bottom, or a grain that touches it was not recorded.
        """
        chain = self.scene.chain
        if chain.bottom == "free":
            raise InputError([("end", "there is no wall at the end 'bottom' of this chain")])
        contact = chain.grains - (chain.bottom == "fixed")
        weight = float(chain.masses[-1] * chain.gravity) if chain.bottom == "fixed" else 0.0
        closer, error = self.closest(contact)
        these = chain.contacts.of(np.array([contact]))
        force, most = (
            float(these.force_at(these.overlap + r)[0]) for r in (closer, closer + error)
        )
        return force + weight, max(
            most - force, force - float(these.force_at(these.overlap + closer - error)[0])
        )

    def closest(self, contact: int) -> tuple[float, float]:
        """Return by how much a contact is closer than at rest at most, m, and the error of that."""
        values = np.zeros((5, 1, self.displacement.shape[0]))
        hidden = np.zeros(self.displacement.shape[0] - 1) if self.ceiling.size else np.zeros(0)
        for column, sign in zip(self._around.place[[contact, contact + 1]], (1, -1), strict=True):
            if column == UNKNOWN:
                raise InputError([("grains", f"the grains of contact {contact} must be recorded")])
            if column != STILL:
                values[:4, 0] += sign * self._values[0][:4, column]
                values[4, 0] += self._values[0][4, column]
                if hidden.size:
                    limits = self.ceiling[column]
                    hidden += np.where(limits < 0, 0.0, limits)
        if hidden.size:
            hidden[hidden == 0] = -1.0
        one, known = (
            (np.zeros(1, dtype=bool), np.zeros(1, dtype=int), 1),
            2 * self.known_error("displacement"),
        )
        value, error = extremes.peaks(values, *one, self.step, RAISED, hidden[None], known)[
            0
        ].tolist()
        return value, error

    def fronts(
        self, field: Field, fraction: float, certain: float | None = None, width: bool = True
    ) -> Array:
        """Return time, height and width of the front, and their errors, (G, 6); see `front.track`."""
        known, frequency = self.known_error(field), self.scene.highest_frequency
        fall = known if certain is None else certain
        found: Array
        found, self._tops[field] = extremes.fronts(
            *self._values, self._around.moves, self.grains.size, self.step, KINDS[field], self.ceiling, fraction, known,
            fall, frequency, width,
        )  # fmt: skip
        return found

    def rows(self, grains: np.ndarray) -> NDArray[np.intp]:
        """Return where in the results these grains stand."""
        return self._around.column[grains]

    def known_error(self, field: Field) -> float:
        """Return how far any value may be off by the error of the trajectory."""
        return self._known_errors[field == "velocity"]

    @cached_property
    def _known_errors(self) -> tuple[float, ...]:
        return tuple(self._error * most for most in self._largest)

    @property
    def _largest(self) -> tuple[float, float]:
        """What displacement, m, and velocity, m/s, no grain exceeds at any time: what errors are relative to.

        A motion without frequencies above omega is at most ``1 / cos(omega h / 2)`` times its largest sample.
        Where that does not hold, or not all grains are recorded, it follows from the energy if that is known.
        """
        scene, chain = self.scene, self.scene.chain
        u, v = (
            max(most, at_first) for most, at_first in zip(self.sampled, scene.imposed, strict=True)
        )
        swift, whole = scene.highest_frequency * self.step, self._around.whole
        if (
            (whole and swift <= RESOLVED)
            or scene.excitation.does_work
            or self._equation not in (1, 3)
        ):
            more = 1 / math.cos(min(swift, RESOLVED) / 2)
            return more * u, more * v
        fastest = max(v, math.sqrt(2 * scene.energy / chain.masses[: chain.movable].min()))
        farthest = u + fastest * (self.step / 2 if whole else scene.duration)
        if (
            self._equation == 3 or scene.largest_strain < 1
        ):  # no contact opens: each holds its share of the energy
            pressed, softness = chain.contacts.pressed, np.zeros(chain.grains + 1)
            np.divide(1.0, chain.contacts.stiffness, where=pressed, out=softness)
            held = (chain.exponent + 1) * scene.energy * softness[1:].sum()
            farthest = min(farthest, math.sqrt(held)) if softness[-2:].any() else farthest
        return max(u, farthest), fastest

    @cached_property
    def ceiling(self) -> Array:
        """Bounds on the speed between samples of each grain that moves, (M, T-1) m/s.

        They are -1 where nothing hides; the shape is (1, 0) if nothing hides anywhere.
        """
        swift = self.scene.highest_frequency * self.step
        if swift <= RESOLVED_BY_DIFFERENCES or (swift <= RESOLVED and self._known.all()):
            return np.zeros((1, 0))
        known = self._known[self._around.moves]
        if swift <= RESOLVED:
            limits = np.full((known.size, self.displacement.shape[0] - 1), -1.0)
            limits[~known] = self._speed_limit()[0][~known]
            return limits
        limits, frequency = self._speed_limit()
        allowed = np.where(known, RESOLVED, RESOLVED_BY_DIFFERENCES)
        return np.where(frequency * self.step <= allowed[:, None], -1.0, limits)

    def _speed_limit(self) -> tuple[Array, Array]:
        """Return bounds on speed and frequency of M grains between samples, (M, T-1) m/s and rad/s.

        No grain can have more than the energy that was within reach of it at the sample before.
        """
        scene, chain, count = self.scene, self.scene.chain, self.displacement.shape[0] - 1
        if (
            scene.excitation.does_work
            or self._equation not in (1, 3)
            or not self._around.moving.size
        ):
            return tuple(np.full((2, self._around.moving.size, count), np.inf))
        near = math.ceil(scene.highest_frequency * self.step / 2) + 2
        first, last = (
            max(self._around.moving.min() - 2, 1),
            min(self._around.moving.max() + 2, chain.grains),
        )
        size, here = last - first + 1, self._around.moving - first
        masses, contacts = (
            chain.masses[first - 1 : last],
            chain.contacts.of(slice(first - 1, last + 1)),
        )
        linear = self._equation == 3
        if not self._around.whole:
            within = np.full((count, size), scene.energy)
        else:
            u, v = (np.zeros((count + 1, size)) for _ in range(2))
            u[:, here], v[:, here] = (field[:, self._around.moves] for field in self._fields)
            r = contacts.closer(u)
            held = contacts.stiffness * r**2 / 2 if linear else contacts.energy(r)
            energy = masses * v**2 / 2 + held[:, 1:] + held[:, :-1]  # each contact twice: a bound
            total = np.concatenate((np.zeros((count + 1, 1)), np.cumsum(energy, axis=1)), axis=1)
            n = np.arange(size)
            around = total[:, np.minimum(n + near + 1, size)] - total[:, np.maximum(n - near, 0)]
            within = np.maximum(around[:-1], 0.0)
        speed = np.sqrt(2 * within / masses)
        shared = np.maximum(np.pad(within, ((0, 0), (1, 0))), np.pad(within, ((0, 0), (0, 1))))
        stiffness = (
            contacts.stiffness if linear else contacts.stiffness_at(contacts.overlap_bound(shared))
        )
        square = np.broadcast_to((stiffness[..., 1:] + stiffness[..., :-1]) / masses, within.shape)
        edged = np.pad(square, ((0, 0), (1, 1)))
        square = np.maximum(np.maximum(edged[:, :-2], edged[:, 2:]), square)
        return speed[:, here].T, np.sqrt(square[:, here]).T


def motion_of(trajectory: Trajectory) -> Motion:
    """Return the motion of a trajectory; without an error, nothing is known of its equation.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    Motion
    """
    error = trajectory.error_estimate
    equation = trajectory.equation if math.isfinite(error.solver) else 0
    u, v = np.asarray(trajectory.displacement), np.asarray(trajectory.velocity)
    return Motion(trajectory.scene, equation, trajectory.grains, u, v, error.total)


def peaks(trajectory: Trajectory, field: Field = "velocity") -> Peaks:
    """Return the largest displacement or speed that every recorded grain reaches at any time.

    Parameters
    ----------
    trajectory : Trajectory
    field : "velocity" or "displacement"

    Returns
    -------
    Peaks
        Grains, values and how far off these may be.

    Raises
    ------
    InputError
        If there is no such field.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=2e-5, samples=9)
    >>> sparse, dense = (peaks(lmpchain.simulate(scene.replace(samples=n), "native")) for n in (9, 129))
    >>> bool((abs(sparse.value - dense.value) <= sparse.error + dense.error).all())
    True
    """
    check_field(field)
    return motion_of(trajectory).peaks(field)


def _within(found: Array, known: float) -> tuple[Array, Array]:
    """Return values and their errors from values and the bounds between which they lie, (G, 3)."""
    value, low, high = found.T
    return value, np.maximum(high - value, value - low) + known
