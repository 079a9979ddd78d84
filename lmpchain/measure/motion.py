"""The motion between samples, and the largest values that it reaches there."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.scene import Scene
from ..trajectory.between.derivatives import (
    UNKNOWN,
    Block,
    by_body,
    derive,
    imposed_on,
    law_of,
)
from ..trajectory.between.fronts import Rules, fronts
from ..trajectory.between.hermite import DISPLACEMENT, VELOCITY
from ..trajectory.between.maxima import (
    Largest,
    Log,
    Window,
    approach,
    events_of,
    lowest,
    reduce,
)
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from .recorded import Field, check_field, columns

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
        sizes = np.array([np.maximum(x.max(0), -x.min(0)) for x in (displacement, velocity)])
        self.sampled: tuple[float, float] = tuple(sizes.max(1).tolist())
        self._column = columns(scene.chain.grains, scene.chain.movable, np.asarray(grains, int))
        self._sizes = sizes

    @property
    def time(self) -> Array:
        """Sampled times, (T,) s."""
        return self.scene.time

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Whether the chain gives the acceleration of each body, (N+2,)."""
        chain = self.scene.chain
        known = np.ones(self._column.size, dtype=bool)
        if self._equation in (1, 3):
            seen = self._column != UNKNOWN
            exists = chain.contacts.exists
            known[1:-1] = (seen[:-2] | ~exists[:-1]) & (seen[2:] | ~exists[1:])
        else:
            known[1:-1] = False
        known[chain.movable + 1 :] = True
        return known

    @property
    def _whole(self) -> bool:
        """Whether all grains that can move were recorded."""
        return not (self._column[1 : self.scene.chain.movable + 1] == UNKNOWN).any()

    @cached_property
    def _block(self) -> Block:
        """All samples."""
        law = law_of(self.scene.chain, self._equation == 3)
        imposed = imposed_on(self.scene, self.step, 0, self.scene.samples)
        u, v = (by_body(np.asarray(x, float)) for x in (self.displacement, self.velocity))
        return Block(u, v, self._column, self._known, self.step, law, imposed)

    @cached_property
    def _moves(self) -> NDArray[np.intp]:
        """Columns of the grains that move by more than the error of the trajectory."""
        known = np.array(self._known_errors)[:, None]
        return np.flatnonzero((self._sizes > known).any(0))

    @property
    def _moving(self) -> NDArray[np.intp]:
        """Numbers of these grains."""
        return np.asarray(self.grains, int)[self._moves]

    @property
    def _window(self) -> Window:
        """All intervals."""
        return Window(0, 0, self.displacement.shape[0] - 1)

    @cached_property
    def _derived(self) -> Array:
        """Accelerations, jerks and errors of the accelerations of the grains that move."""
        derived: Array = derive(self._block, self._moving)
        return derived

    @cached_property
    def _largest_sizes(self) -> dict[Field, Largest]:
        """Largest sizes of the grains that move."""
        far, fast = (lowest(self._moving.size) for _ in range(2))
        nothing = events_of(np.zeros(0))
        reduce(
            self._block, self._moving, self._derived, self.ceiling, self._window, (far, fast),
            nothing, Log(nothing, 0),
        )  # fmt: skip
        return {"displacement": far, "velocity": fast}

    def peaks(self, field: Field) -> Peaks:
        """Return the largest displacement or speed of every grain."""
        known = self.known_error(field)
        value = self._sizes[int(field == "velocity")].copy()
        error = value + known
        value[self._moves], error[self._moves] = self._largest_sizes[field].estimate(known)
        return Peaks(self.grains, value, error)

    def largest_wall_force(self) -> tuple[float, float]:
        """Return the largest force at any time on what holds the bottom, N, and how far that may be off.

        Raises
        ------
        InputError
            If nothing stands still at the bottom, or a grain that touches it was not recorded.
        """
        chain = self.scene.chain
        if chain.bottom == "free":
            raise InputError.at("end", "there is no wall at the end 'bottom' of this chain")
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
        bodies = np.array([contact, contact + 1])
        if (self._column[bodies] == UNKNOWN).any():
            raise InputError.at("grains", f"the grains of contact {contact} must be recorded")
        limits = np.zeros(0)
        if self.ceiling.size:
            either = self.ceiling[np.isin(self._moving, bodies)]
            limits = np.where((either < 0).all(0), -1.0, np.maximum(either, 0.0).sum(0))
        place = np.full(self._column.size, -1)
        place[self._moving] = np.arange(self._moving.size)
        above, below = place[bodies].tolist()
        closest = lowest(1, -np.inf)
        approach(self._block, contact, self._derived, (above, below), limits, self._window, closest)
        value, error = closest.estimate(2 * self.known_error("displacement"))
        return float(value[0]), float(error[0])

    def fronts(
        self, field: Field, fraction: float, certain: float | None = None, width: bool = True
    ) -> Array:
        """Return time, height and width of the front, and their errors, (G, 6); see `front.track`."""
        known = self.known_error(field)
        rules = Rules(
            float(fraction), known, float(known if certain is None else certain),
            self.scene.highest_frequency, self.step, self.step * self._window.end,
        )  # fmt: skip
        rows = np.full((self.grains.size, 6), np.nan)
        rows[self._moves] = fronts(
            self._block, self._moving, self._derived, self.ceiling, KINDS[field], width, rules
        )
        return rows

    def rows(self, grains: np.ndarray) -> NDArray[np.intp]:
        """Return where in the results these grains stand."""
        return self._column[grains]

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
        swift, whole = scene.highest_frequency * self.step, self._whole
        if (
            (whole and swift <= RESOLVED)
            or scene.excitation.does_work
            or self._equation not in (1, 3)
        ):
            more = 1 / math.cos(min(swift, RESOLVED) / 2)
            return more * u, more * v
        fastest = max(v, math.sqrt(2 * scene.energy / chain.masses[: chain.movable].min()))
        farthest = u + fastest * (self.step / 2 if whole else scene.duration)
        # no contact opens: each holds its share of the energy
        if self._equation == 3 or scene.largest_strain < 1:
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
        known = self._known[self._moving]
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
        if scene.excitation.does_work or self._equation not in (1, 3) or not self._moving.size:
            return tuple(np.full((2, self._moving.size, count), np.inf))
        near = math.ceil(scene.highest_frequency * self.step / 2) + 2
        first, last = (
            max(self._moving.min() - 2, 1),
            min(self._moving.max() + 2, chain.grains),
        )
        size, here = last - first + 1, self._moving - first
        masses, contacts = (
            chain.masses[first - 1 : last],
            chain.contacts.of(slice(first - 1, last + 1)),
        )
        linear = self._equation == 3
        if not self._whole:
            within = np.full((count, size), scene.energy)
        else:
            u, v = (np.zeros((count + 1, size)) for _ in range(2))
            u[:, here], v[:, here] = (x[:, self._moves] for x in (self.displacement, self.velocity))
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
