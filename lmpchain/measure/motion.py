"""Motion between samples, and the largest values between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.accumulator import FRACTION, KINDS, Accumulator, Field
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import cached_property, listed
from .recorded import UNKNOWN, check_field, columns

__dir__ = listed(__name__)

# Largest phase omega h for which no motion is missed between two samples, and the same for
# accelerations computed from the samples; see analysis/calibration/between_samples.py.
RESOLVED = 2.0
RESOLVED_BY_DIFFERENCES = 0.7
# Remedy if the force on a held last grain is requested, but that grain is driven.
OF_DRIVER = "the last grain is driven: use measure.contact.drive_force, which includes its inertia"


class Peaks(NamedTuple):
    """The largest displacement or speed that each of G grains reaches at any time.

    Attributes
    ----------
    grain : (G,) array
        Numbers of the grains.
    value : (G,) array
        Largest size at any time, m/s or m.
    error : (G,) array
        Uncertainty of the value by sampling and by the error of the trajectory, if it is known.
    """

    grain: np.ndarray
    value: Array
    error: Array


class Motion:
    """The motion of grains at the samples and between them.

    The acceleration and jerk of a grain are computed from Eq. (1) or (3) if the trajectory obeys
    one of them and the neighbours of the grain are known. Otherwise they are computed from three
    neighbouring samples.

    Parameters
    ----------
    scene : Scene
    equation : int
        Number in the paper of the equation that the motion obeys; 0 if it is not known.
    grains : (G,) array
        Numbers of the recorded grains.
    displacement, velocity : (T, G) arrays
        Motion of these grains, m and m/s.
    error : float
        Relative error of the trajectory, as `ErrorEstimate.total`; an unknown error counts as 0.

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
        self.scene = scene
        self.grains = grains
        self.displacement = displacement
        self.velocity = velocity
        self.step = scene.sampling_interval
        self._equation = equation
        self._error = error if math.isfinite(error) else 0.0
        # Largest size of each grain at the samples; `abs` would copy the fields.
        self._sizes = np.array([np.maximum(x.max(0), -x.min(0)) for x in (displacement, velocity)])
        self.sampled: tuple[float, float] = tuple(self._sizes.max(1).tolist())
        self._column = columns(scene.chain.grains, scene.chain.movable, np.asarray(grains, int))
        # Largest sizes and maxima of a field, and the smallest relative height of its fronts.
        self._accumulators: dict[str, tuple[float, Accumulator]] = {}

    @property
    def time(self) -> Array:
        """Sampled times, (T,) s."""
        return self.scene.time

    @cached_property
    def _lawful(self) -> NDArray[np.bool_]:
        """Whether the equation of motion determines the acceleration of each body, (N+2,)."""
        chain = self.scene.chain
        # The rates of viscous forces need more derivatives than the samples provide, and the force
        # from the ground may depend on the time.
        known = self._equation in (1, 3) and chain.conservative
        lawful = np.full(self._column.size, known)
        if known and not self._all_recorded:
            # Beyond an end without a wall no neighbour moves.
            recorded = self._column != UNKNOWN
            lawful[1:-1] = recorded[:-2] & recorded[2:]
        lawful[0] = True
        # Bodies at rest.
        lawful[chain.movable + 1 :] = True
        return lawful

    @cached_property
    def _all_recorded(self) -> bool:
        """Whether all grains that can move were recorded."""
        return not (self._column[1 : self.scene.chain.movable + 1] == UNKNOWN).any()

    @cached_property
    def _moves(self) -> NDArray[np.intp]:
        """Columns of the grains that move by more than the error of the trajectory."""
        errors = np.array(self._errors)[:, None]
        return np.flatnonzero((self._sizes > errors).any(0))

    @cached_property
    def _moving(self) -> NDArray[np.intp]:
        """Numbers of the grains that move by more than the error of the trajectory."""
        return np.asarray(self.grains, int)[self._moves]

    def _accumulate(
        self, field: Field | None, fraction: float, contacts: Sequence[int], ceiling: Array
    ) -> Accumulator:
        """Accumulate largest sizes and maxima of a field of moving grains or of contacts."""
        bodies = [*contacts, *(n + 1 for n in contacts)]
        grains = self._moving if field else self._moving[np.isin(self._moving, bodies)]
        # Only the columns of these grains, their neighbours and the bodies of the contacts are
        # read.
        bodies += grains.tolist()
        near = self._column[max(min(bodies, default=1) - 1, 0) : max(bodies, default=1) + 2]
        read = [column for column in near.tolist() if column >= 0] or [0]
        part = slice(min(read), max(read) + 1)
        column = self._column - part.start
        column[column >= part.stop - part.start] = UNKNOWN
        motion = (self.scene, self._equation == 3, column, self._lawful, grains)
        fields = (field,) if field else ()
        accumulator = Accumulator(*motion, fields, field, contacts, ceiling)
        # A maximum below half of the smallest front cannot be a front, whatever the errors are.
        sizes = self._sizes[KINDS[field], self._moves] - self.known_error(field) if field else ()
        levels = np.maximum(fraction / 2 * np.array(sizes), 0.0)
        accumulator.take_all(self.displacement[:, part], self.velocity[:, part], levels)
        return accumulator

    def _accumulator_of(self, field: Field, fraction: float) -> Accumulator:
        """Return largest sizes and maxima of the moving grains, once for each field."""
        known = self._accumulators.get(field)
        if known is None or known[0] != fraction:
            known = fraction, self._accumulate(field, fraction, (), self.ceiling)
            self._accumulators[field] = known
        return known[1]

    def peaks(self, field: Field) -> Peaks:
        """Return the largest displacement or speed of every grain."""
        trajectory_error = self.known_error(field)
        value = self._sizes[KINDS[field]].copy()
        # For a grain that moves by less than the error, only this bound is available.
        error = value + trajectory_error
        largest = self._accumulator_of(field, FRACTION).largest(field, trajectory_error)
        value[self._moves], error[self._moves] = largest
        return Peaks(self.grains, value, error)

    def largest_wall_force(self) -> tuple[float, float]:
        """Return the largest force on the bottom support at any time, N, and its error.

        Raises
        ------
        InputError
            If the bottom is free, its "fixed" grain is driven, the grain that touches it was not
            recorded, or contacts are viscous or soften.
        """
        chain = self.scene.chain
        if chain.bottom == "free":
            raise InputError.at("end", "there is no wall at the end 'bottom' of this chain")
        if self.scene.excitation.from_below and chain.bottom == "fixed":
            raise InputError.at("end", OF_DRIVER)
        if not chain.strongest_when_closest:
            viscous = chain.damping.longest_time > 0
            key, kind = ("damping.viscoelastic", "viscous") if viscous else ("law", "softening")
            cure = f'add "peak_force:{chain.movable}" to the quantities of the scene'
            fault = f"the largest force of a {kind} contact is not at its closest approach: {cure}"
            raise InputError.at(f"chain.{key}", f"{fault}, or use wall_force")
        # A fixed grain N replaces the wall, and its own weight adds to the force.
        closer, error = self.closest(chain.movable)
        law = chain.contacts.of(np.array([chain.movable]))
        low, force, high = (
            float(law.force_at(law.overlap + r)[0])
            for r in (closer - error, closer, closer + error)
        )
        return force + chain.held_weight, max(high - force, force - low)

    def closest(self, contact: int) -> tuple[float, float]:
        """Return the closest approach of a contact beyond that at rest, m, and its error."""
        bodies = np.array([contact, contact + 1])
        if (self._column[bodies] == UNKNOWN).any():
            raise InputError.at("grains", f"the grains of contact {contact} must be recorded")
        limits = np.zeros(0)
        if self.ceiling.size:
            either = self.ceiling[np.isin(self._moving, bodies)]
            # The two bodies may move in opposite directions.
            limits = np.where((either < 0).all(0), -1.0, np.maximum(either, 0.0).sum(0))
        accumulator = self._accumulate(None, 0.0, [contact], limits[None])
        value, error = accumulator.closest(0, 2 * self.known_error("displacement"))
        return float(value[0]), float(error[0])

    def fronts(
        self, field: Field, fraction: float, fall: float | None = None, width: bool = True
    ) -> Array:
        """Return the time, height and width of the front and their errors, (G, 6).

        See `front.track`. After the front the motion must fall by at least `fall`, by default the
        error of the field.
        """
        error = self.known_error(field)
        rows = np.full((self.grains.size, 6), np.nan)
        least = error if fall is None else fall
        rows[self._moves] = self._accumulator_of(field, fraction).fronts(
            fraction, error, least, width
        )
        return rows

    def rows(self, grains: np.ndarray) -> NDArray[np.intp]:
        """Return the indices of these grains in the results."""
        return self._column[grains]

    def known_error(self, field: Field) -> float:
        """Return the uncertainty of any value due to the error of the trajectory."""
        return self._errors[field == "velocity"]

    @cached_property
    def _errors(self) -> tuple[float, ...]:
        return tuple(self._error * bound for bound in self._bounds)

    @property
    def _bounds(self) -> tuple[float, float]:
        """Bounds on displacement, m, and velocity, m/s, of any grain at any time.

        Relative errors refer to these bounds. A motion without frequencies above omega is at most
        ``1 / cos(omega h / 2)`` times its largest sample, with the sampling interval h. If samples
        are too far apart, or not all grains are recorded, the bounds are computed from the energy
        if it is known.
        """
        scene = self.scene
        chain = scene.chain
        u, v = np.maximum(self.sampled, scene.imposed).tolist()
        angle = scene.sampling_phase
        resolved = self._all_recorded and angle <= RESOLVED
        if resolved or not self._energy_bounds:
            factor = 1 / math.cos(min(angle, RESOLVED) / 2)
            return factor * u, factor * v
        # All energy could be in the lightest grain.
        fastest = max(v, math.sqrt(2 * scene.energy / chain.masses[: chain.movable].min()))
        # Largest distance from the nearest sample, or from rest.
        farthest = u + fastest * (self.step / 2 if self._all_recorded else scene.duration)
        # No contact opens, so that each contact contains its part of the energy.
        if self._equation == 3 or scene.largest_strain < 1:
            # The energy of a relative change r of an overlap o is at least (r / o)^2 times the
            # energy of an opening, or k r^2 / 2.
            contacts = chain.contacts
            opening = np.minimum(
                contacts.energy(-contacts.overlap), contacts.stiffness * contacts.overlap**2 / 2
            )
            softness = np.zeros(chain.grains + 1)
            np.divide(contacts.overlap**2, opening, where=contacts.pressed, out=softness)
            square = scene.energy * softness[1:].sum()
            # Without a support at the bottom, the chain may fall as a whole.
            farthest = min(farthest, math.sqrt(square)) if softness[-2:].any() else farthest
        return max(u, farthest), fastest

    @property
    def _energy_bounds(self) -> bool:
        """Whether the energy bounds the motion: no external work, and a known equation."""
        return not self.scene.excitation.does_work and self._equation in (1, 3)

    @cached_property
    def ceiling(self) -> Array:
        """Upper bounds on the speed between samples of each moving grain, (M, T-1) m/s.

        The bound is -1 where the samples miss no motion; the shape is (1, 0) if they miss none
        anywhere.
        """
        angle = self.scene.sampling_phase
        if angle <= RESOLVED_BY_DIFFERENCES or (angle <= RESOLVED and self._lawful.all()):
            return np.zeros((1, 0))
        lawful = self._lawful[self._moving]
        speed, frequency = self._speed_limit()
        if angle <= RESOLVED:
            # No grain has a higher frequency than the scene.
            return np.where(lawful[:, None], -1.0, speed)
        allowed = np.where(lawful, RESOLVED, RESOLVED_BY_DIFFERENCES)
        return np.where(frequency * self.step <= allowed[:, None], -1.0, speed)

    def _speed_limit(self) -> tuple[Array, Array]:
        """Return bounds on speed and frequency of M grains between samples, (M, T-1) m/s and rad/s.

        A grain cannot have more energy than there was within its reach at the previous sample.
        """
        scene = self.scene
        chain = scene.chain
        intervals = self.displacement.shape[0] - 1
        if not self._energy_bounds or not self._moving.size:
            return tuple(np.full((2, self._moving.size, intervals), np.inf))
        # These are the moving grains and their neighbours; all others are at rest.
        first = max(self._moving.min() - 2, 1)
        last = min(self._moving.max() + 2, chain.grains)
        masses = chain.masses[first - 1 : last]
        contacts = chain.contacts.of(slice(first - 1, last + 1))
        columns = self._moving - first
        linear = self._equation == 3
        if not self._all_recorded:
            energy = np.full((intervals, masses.size), scene.energy)
        else:
            u = np.zeros((intervals + 1, masses.size))
            v = np.zeros_like(u)
            u[:, columns] = self.displacement[:, self._moves]
            v[:, columns] = self.velocity[:, self._moves]
            closer = contacts.closer(u)
            elastic = contacts.stiffness * closer**2 / 2 if linear else contacts.energy(closer)
            # The energy of each contact counts for both grains, which gives an upper bound.
            of_grains = masses * v**2 / 2 + elastic[:, 1:] + elastic[:, :-1]
            # A wave passes fewer than omega h / 2 grains in an interval.
            reach = math.ceil(scene.sampling_phase / 2) + 2
            sums = np.pad(np.cumsum(of_grains, axis=1), ((0, 0), (1, 0)))
            n = np.arange(masses.size)
            above = sums[:, np.maximum(n - reach, 0)]
            around = sums[:, np.minimum(n + reach + 1, masses.size)] - above
            energy = np.maximum(around[:-1], 0.0)
        speed = np.sqrt(2 * energy / masses)
        stiffness = contacts.stiffness
        if not linear:
            # A contact can have the energy within reach of either grain.
            above = np.pad(energy, ((0, 0), (1, 0)))
            below = np.pad(energy, ((0, 0), (0, 1)))
            stiffness = contacts.stiffness_bound(contacts.overlap_bound(np.maximum(above, below)))
        square = np.broadcast_to((stiffness[..., 1:] + stiffness[..., :-1]) / masses, energy.shape)
        # The frequency of a grain is at most the highest of the grain and its neighbours.
        edged = np.pad(square, ((0, 0), (1, 1)))
        square = np.maximum(np.maximum(edged[:, :-2], edged[:, 2:]), square)
        return speed[:, columns].T, np.sqrt(square[:, columns]).T


def motion_of(trajectory: Trajectory) -> Motion:
    """Return the motion of a trajectory; the equation is used only if the error is estimated.

    Parameters
    ----------
    trajectory : Trajectory

    Returns
    -------
    Motion
    """
    error = trajectory.error_estimate
    equation = trajectory.equation if math.isfinite(error.solver) else 0
    return Motion(
        trajectory.scene,
        equation,
        trajectory.grains,
        # Stored arrays are read once, here.
        np.asarray(trajectory.displacement),
        np.asarray(trajectory.velocity),
        error.total,
    )


def peaks(trajectory: Trajectory, field: Field = "velocity") -> Peaks:
    """Return the largest displacement or speed that every recorded grain reaches at any time.

    Parameters
    ----------
    trajectory : Trajectory
    field : "velocity" or "displacement"

    Returns
    -------
    Peaks
        Grains, values and their errors.

    Raises
    ------
    InputError
        If the field does not exist.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=2e-5, samples=9)
    >>> sparse = peaks(lmpchain.simulate(scene, "native"))
    >>> dense = peaks(lmpchain.simulate(scene.replace(samples=129), "native"))
    >>> bool((abs(sparse.value - dense.value) <= sparse.error + dense.error).all())
    True
    """
    check_field(field)
    return motion_of(trajectory).peaks(field)
