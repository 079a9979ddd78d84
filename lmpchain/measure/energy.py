"""Energy of grains and contacts; balance of energy and momentum."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline, make_interp_spline

from ..chain import ground
from ..chain.damping import viscous_force
from ..errors import InputError
from ..trajectory.gathered import ENERGIES
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish
from ..util.tabular import NamedColumn, Tabular, number_columns
from .bodies import known_contacts, motion, motion_of_all
from .motion import Motion, motion_of

if TYPE_CHECKING:
    from ..chain.chain import Chain
    from ..scene.base import Push
    from ..scene.scene import Scene

__dir__ = listed(__name__)

# Gauss-Legendre quadrature between kinks, exact up to degree 9.
MOST_TURN = 1000.0  # Largest phase between samples, rad.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, eq=False, repr=False)
class EnergyLedger(Shown, Tabular):
    """Energies relative to the chain at rest, J, and momenta, N s, over time.

    The terms add up as ``kinetic + contact + ground + gravity + load = total``. For a weak wave,
    `contact` and `gravity` are far larger than `total` and nearly cancel. `total`, `kinetic` and
    `drive` are computed without this cancellation.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    kinetic : (T,) array
        Kinetic energy of all grains, including a driven one.
    contact : (T,) array
        Elastic energy K overlap^(delta+1) / (delta+1) of all contacts minus its value at rest.
    ground : (T,) array
        Work against the ground; 0 at rest and without a ground.
    gravity : (T,) array
        Potential energy of the weight, 0 at rest.
    load : (T,) array
        Potential energy of the constant forces on a free top, a moving wall or a driven base, 0 at
        rest.
    total : (T,) array
        Total energy above rest, as `Chain.excess_energy`.
    drive : (T,) array
        Work of a force or driver since t = 0 without the work of the load: the integral of (drive
        force - top load) times the velocity of the driven grain or wall.
    dissipated : (T,) array
        Energy dissipated by viscous contacts and drag since t = 0; see `losses` for each of them.
        In a chain with damping, the native engine and LAMMPS accumulate `dissipated` and `drive` at
        every step. The linear engines integrate both along their solutions.
    momentum : (T,) array
        Momentum of all grains, positive downward.
    impulse : (T,) array
        Impulse of the external forces since t = 0, without impulses that balance at rest. External
        forces are those of force, driver, walls, a fixed grain, ground and drag.
    drive_error, impulse_error, dissipated_error : float
        Uncertainties of these terms, J and N s, including the error of the trajectory if it is
        known. For an integral over samples, the uncertainty is the shift when every second sample
        is used. If forces are smooth and well sampled, the true error is about 1/15 of this shift.
        The uncertainty is infinite for fewer than three samples, or if samples are farther apart
        than half a period of the fastest motion.
    balanced : tuple of str
        Terms among `drive`, `dissipated` and `impulse` that were computed from the balance of
        energy or momentum, because this is more accurate than the integral over the samples. The
        drift of this balance is then 0 and does not check the trajectory.
    """

    _units: ClassVar[dict[str, str]] = {
        "time": "s",
        "kinetic": "J",
        "contact": "J",
        "ground": "J",
        "gravity": "J",
        "load": "J",
        "total": "J",
        "drive": "J",
        "dissipated": "J",
        "momentum": "N s",
        "impulse": "N s",
    }

    time: Array
    kinetic: Array
    contact: Array
    ground: Array
    gravity: Array
    load: Array
    total: Array
    drive: Array
    dissipated: Array
    momentum: Array
    impulse: Array
    drive_error: float
    impulse_error: float
    dissipated_error: float
    balanced: tuple[str, ...] = ()

    @property
    def drift(self) -> Array:
        """Return the energy change beyond work and dissipation, (T,) J; 0 for the exact motion.

        If `balanced` contains `drive` or `dissipated`, the drift is 0 for any motion.
        """
        return self.total - self.total[0] - self.drive + self.dissipated

    @property
    def momentum_drift(self) -> Array:
        """Return the momentum change that is not caused by external forces, (T,) N s.

        If `balanced` contains `impulse`, the drift is 0 for any motion.
        """
        return self.momentum - self.momentum[0] - self.impulse

    def virial_ratio(self, start: float = 0.0, end: float | None = None) -> float:
        """Return the ratio of mean kinetic to mean total energy from `start` to `end`, s.

        In a sonic vacuum between walls the ratio tends to (delta + 1) / (delta + 3), or 5/9 for
        Hertz contacts; the deviation decays as 1 / time (Slepyan, arXiv:1410.8301). In a weak wave
        the ratio tends to 1/2. It is NaN without energy.

        Raises
        ------
        InputError
            If `start` and `end` are not within the run, one after the other.
        """
        last = float(self.time[-1])
        end = last if end is None else end
        if not self.time[0] <= start < end <= last:
            raise InputError.at(
                "end", f"must be after start, both within 0 to {last:.4g} s (got {start} to {end})"
            )
        kinetic, total = (
            CubicSpline(self.time, x).integrate(start, end) for x in (self.kinetic, self.total)
        )
        return float(kinetic / total) if total else np.nan

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw total, kinetic and potential energy and the work of a driver; return the axes."""
        ax = chart(ax, "time [s]", "energy above rest [J]")
        ax.plot(self.time, self.total, label="total")
        ax.plot(self.time, self.kinetic, label="kinetic")
        ax.plot(self.time, self.total - self.kinetic, label="potential")
        if self.dissipated.any():
            ax.plot(self.time, self.dissipated, label="dissipated")
        if self.drive.any():
            work = self.total[0] + self.drive
            ax.plot(self.time, work, "k--", lw=1, label="given by strike and driver")
        largest = np.abs(self.total).max() or 1.0
        title = f"Drift: at most {np.abs(self.drift).max() / largest:.1e} of the largest total"
        return finish(ax, title, below=0.2, ncols=2)


@dataclass(frozen=True, eq=False, repr=False)
class EnergyLosses(Shown, Tabular):
    """Energy dissipated by viscous contacts and drag since t = 0, J.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    of_contact : (T, N+1) array
        Energy dissipated by each contact: the integral of A dF/dt do/dt with the viscous time A,
        the elastic force F and the overlap o. Contact n is below grain n; contacts 0 and N are
        those with the walls.
    of_grain : (T, N) array
        Energy dissipated by the drag on each grain: the integral of m gamma v^2; 0 for a driven
        grain.
    error : float
        Uncertainty of the sum, J, because the powers are known only at the samples: the shift when
        every second sample is used, plus the effect of the error of the trajectory. It is at least
        the distance from `EnergyLedger.dissipated`, and infinite for fewer than three samples.
    """

    time: Array
    of_contact: Array
    of_grain: Array
    error: float

    @property
    def total(self) -> Array:
        """Energy dissipated by all contacts and grains, (T,) J."""
        return self.of_contact.sum(1) + self.of_grain.sum(1)

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        contacts = self.of_contact.shape[1]
        yield from number_columns("of_contact", "J", range(contacts), self.of_contact)
        yield from number_columns("of_grain", "J", range(1, contacts), self.of_grain)


@dataclass(frozen=True, eq=False, repr=False)
class EnergyShares(Shown, Tabular):
    """Energies above rest of the G recorded grains and the C contacts between them, J.

    The sum over all grains and contacts is `EnergyLedger.total`. The energy of a contact is its
    elastic energy minus the work that load and weight do when it yields; it is never negative.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    grain : (G,) array
        Numbers of the grains.
    contact : (C,) array
        Numbers of the contacts; contact n is below grain n, and contacts 0 and N are those with the
        walls.
    kinetic : (T, G) array
        Kinetic energy of each grain.
    elastic : (T, C) array
        Energy of each contact.
    of_grain : (T, G) array
        Energy assigned to each grain: its kinetic energy, the energy of the ground under it, half
        of its contacts with other grains, and all of its contacts with walls. It is NaN if a
        neighbour was not recorded.
    kinetic_error, elastic_error, of_grain_error : arrays like these three
        Uncertainty of each value due to the error of the trajectory, if it is known.
    """

    time: Array
    grain: NDArray[np.intp]
    contact: NDArray[np.intp]
    kinetic: Array
    elastic: Array
    of_grain: Array
    kinetic_error: Array
    elastic_error: Array
    of_grain_error: Array

    def part(self, first: int, last: int) -> Array:
        """Return the energy of the grains from `first` to `last`, the sum of `of_grain`, (T,) J.

        Raises
        ------
        InputError
            If one of these grains was not recorded.
        """
        grains = np.arange(first, last + 1)
        if not grains.size or not np.isin(grains, self.grain).all():
            raise InputError.at(
                "part", f"must be a range of recorded grains, first to last (got {first} to {last})"
            )
        return self.of_grain[:, np.isin(self.grain, grains)].sum(1)

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        yield from number_columns("kinetic", "J", self.grain, self.kinetic)
        yield from number_columns("elastic_contact", "J", self.contact, self.elastic)
        yield from number_columns("of_grain", "J", self.grain, self.of_grain)


def shares(trajectory: Trajectory | Motion) -> EnergyShares:
    """Return the energy of each recorded grain and of each contact between them over time.

    Parameters
    ----------
    trajectory : Trajectory or Motion

    Returns
    -------
    EnergyShares

    Raises
    ------
    InputError
        If no two neighbouring grains were recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=2e-5, samples=3)
    >>> energy = shares(lmpchain.simulate(scene, engine="native", tolerance=1e-9))
    >>> (energy.part(1, 20) / scene.energy).round(8).tolist()
    [1.0, 1.0, 1.0]
    """
    chain = trajectory.scene.chain
    chain.refuse_moving_ground("the balance of energy")
    grain = trajectory.grains
    between = trajectory if isinstance(trajectory, Motion) else motion_of(trajectory)
    off = between.known_error("displacement")
    fast = between.known_error("velocity")
    contact = known_contacts(trajectory)
    u, _ = motion(trajectory, np.stack([contact, contact + 1]))
    contacts = chain.contacts.of(contact)
    closer = u[:, 0] - u[:, 1]
    speed = np.abs(trajectory.velocity)
    # Largest force in excess of the force at rest, within the error.
    force = np.maximum(
        np.abs(contacts.force_change(closer - 2 * off)),
        np.abs(contacts.force_change(closer + 2 * off)),
    )
    mass = chain.masses[grain - 1]
    kinetic = mass * speed**2 / 2
    kinetic_error = mass * fast * (speed + fast / 2)
    elastic = contacts.energy(closer)
    elastic_error = 2 * off * force
    pull = _ground_of(chain, trajectory.displacement, off, grain)
    return EnergyShares(
        time=trajectory.time,
        grain=grain,
        contact=contact,
        kinetic=kinetic,
        elastic=elastic,
        of_grain=kinetic + pull.energy + _share_out(chain, contact, elastic, grain),
        kinetic_error=kinetic_error,
        elastic_error=elastic_error,
        of_grain_error=kinetic_error
        + pull.energy_error
        + _share_out(chain, contact, elastic_error, grain),
    )


class _Pieces(NamedTuple):
    """Integrals over the intervals that the waveform alone determines, (T-1,); NaN elsewhere.

    Attributes
    ----------
    work : (T-1,) array
        Integrals of the power of the applied force or driver, J.
    push : (T-1,) array
        Integrals of the applied force or driver force, N s.
    top, bottom : (T-1,) arrays
        Integrals of the forces of the walls, N s.
    """

    work: Array
    push: Array
    top: Array
    bottom: Array


class _Forces(NamedTuple):
    """Contact forces at the samples, (T, N+1) each, with their errors by the trajectory.

    Attributes
    ----------
    force : array
        Force minus the force at rest, N.
    rate : array
        Rate of change of the elastic part, N/s.
    largest : array
        Largest magnitude of the elastic part within the error, N.
    doubt : array
        Error of the force, N.
    power, power_doubt : arrays
        Power dissipated by each viscous contact, and its error, W.
    """

    force: Array
    rate: Array
    largest: Array
    doubt: Array
    power: Array
    power_doubt: Array


class _GroundPull(NamedTuple):
    """Force and energy of the ground at the samples, with their errors, (T, G) N and J each."""

    force: Array
    doubt: Array
    energy: Array
    energy_error: Array


def _ground_of(
    chain: Chain, u: Array, off: float, grains: NDArray[np.intp] | None = None
) -> _GroundPull:
    """Return what the ground does to these grains, (G,) of (T, G) displacements; by default all."""
    law = chain.ground
    if law is None:
        return _GroundPull(*np.zeros((4, 1, 1)))
    if grains is not None:
        law = law.of_grains(grains)
    force = law.force(u, 0.0)
    ends = [law.force(u + side, 0.0) for side in (-off, off)]
    doubt = np.maximum(*(np.abs(end - force) for end in ends))
    return _GroundPull(force, doubt, ground.energy(law, u), off * (np.abs(force) + doubt))


def _share_out(
    chain: Chain, contact: NDArray[np.intp], energy: Array, grain: NDArray[np.intp]
) -> Array:
    """Return the fraction of contact energy assigned to grains, (T, G): half, or 1 at walls."""
    # A contact that does not exist has no energy; the energy of an unrecorded contact is unknown.
    shares = np.where(chain.contacts.exists, np.nan, 0.0) + np.zeros((len(energy), 1))
    shares[:, contact] = energy
    shares[:, 1:-1] /= 2
    return shares[:, grain - 1] + shares[:, grain]


def ledger(trajectory: Trajectory) -> EnergyLedger:
    """Return the energy and momentum balance of a trajectory over time.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, in which all grains that move were recorded.

    Returns
    -------
    EnergyLedger

    Raises
    ------
    InputError
        If a grain that moves was not recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=2e-5)
    >>> energy = ledger(lmpchain.simulate(scene, engine="native", tolerance=1e-9))
    >>> bool(abs(energy.drift).max() < 1e-8 * energy.total[0])
    True
    """
    trajectory.scene.chain.refuse_moving_ground("the balance of energy")
    scene, u, v = motion_of_all(trajectory)
    chain = scene.chain
    time = trajectory.time
    walls = _positions_of_walls(scene, time)
    closer = chain.contacts.closer(u, *walls)
    known = motion_of(trajectory)
    off = known.known_error("displacement")
    fast = known.known_error("velocity")
    closing = chain.contacts.closer(v, *_positions_of_walls(scene, time, 1))
    contacts = _forces(chain, closer, closing, 2 * off, 2 * fast)
    force, rate, doubt = contacts.force, contacts.rate, contacts.doubt
    losses = _sum_losses(scene, time, contacts, v, fast)
    elastic = chain.contacts.energy(closer).sum(1)
    pull = _ground_of(chain, u, off)
    total = (chain.masses * v**2).sum(1) / 2 + elastic  # As in Chain.excess_energy.
    total = total + pull.energy.sum(1)
    # The error of the trajectory propagates to the energies.
    total_error = chain.masses * fast * (np.abs(v) + fast / 2)
    total_error = total_error.sum(1) + 2 * off * np.abs(contacts.largest).sum(1)
    total_error += pull.energy_error.sum(1)

    def integral(value: Array, slope: Array, known: Array | None = None) -> tuple[Array, float]:
        # The samples do not determine the rates of viscous forces.
        return _integral(scene, time, value, None if chain.damped else slope, known)

    momentum = v @ chain.masses
    drive, impulse = np.zeros((2, time.size))
    drive_error = impulse_error = 0.0
    if chain.damped:
        impulse, impulse_error = _integral(scene, time, -(v @ _drag(scene)))
        impulse_error += _area(time, fast * _drag(scene).sum())
    push_from, push_rate = force, rate
    if chain.ground is not None:
        pull_rate = chain.ground.stiffness(u, 0.0) * v
        given, error = integral(-pull.force.sum(1), -pull_rate.sum(1))
        impulse = impulse + given
        impulse_error += error + _area(time, pull.doubt.sum(1))
        push_from = ground.join_contacts(force, pull.force)
        push_rate = ground.join_contacts(rate, pull_rate)
    push = scene.excitation.push(chain, time, push_from, push_rate, v)
    pieces = _known_pieces(scene, time, push, u, v) if push else None
    if chain.top == "wall":
        given, error = integral(force[:, 0], rate[:, 0], pieces.top if pieces else None)
        impulse = impulse + given
        impulse_error += error + _area(time, doubt[:, 0])
    if push and pieces:
        speed = push.speed
        power = push.force * speed
        change = push.rate * speed + push.force * push.acceleration
        work, drive_error = integral(power, change, pieces.work)
        drive = work + push.inertia / 2 * (speed**2 - speed[0] ** 2)
        # An applied force is exact, and so is the speed of a driven body.
        driven = _doubt_of_driver(scene, doubt, pull.doubt)
        moves = scene.drive is not None
        drive_error += _area(time, np.abs(speed) * driven if moves else np.abs(push.force) * fast)
        if push.on_grain:
            push_impulse, error = integral(push.force, push.rate, pieces.push)
            impulse = impulse + push_impulse + push.inertia * (speed - speed[0])
            impulse_error += error + _area(time, driven if moves else 0.0)
    if _carries(scene):
        of_bottom = force[:, chain.movable], rate[:, chain.movable]
        bottom, error = integral(*of_bottom, pieces.bottom if pieces else None)
        impulse = impulse - bottom
        impulse_error += error + _area(time, doubt[:, chain.movable])
    terms = {
        "drive": (drive, drive_error),
        "dissipated": (losses.total, losses.error),
        "impulse": (impulse, impulse_error),
    }
    changes = {
        "drive": (1.0, total, total_error, "dissipated"),
        "dissipated": (-1.0, total, total_error, "drive"),
        "impulse": (1.0, momentum, fast * chain.masses.sum(), ""),
    }
    terms, balanced = _close(trajectory, terms, changes)
    return EnergyLedger(
        time=time,
        kinetic=v**2 @ chain.masses / 2,
        contact=elastic + closer @ chain.contacts.force,
        ground=pull.energy.sum(1) + np.zeros(time.size),
        gravity=-chain.gravity * (u @ chain.masses),
        load=-_work_at_ends(scene, time, u, walls[0]),
        total=total,
        drive=terms["drive"][0],
        dissipated=terms["dissipated"][0],
        momentum=momentum,
        impulse=terms["impulse"][0],
        drive_error=terms["drive"][1],
        impulse_error=terms["impulse"][1],
        dissipated_error=terms["dissipated"][1],
        balanced=tuple(balanced),
    )


def _close(
    trajectory: Trajectory,
    sampled: dict[str, tuple[Array, float]],
    changes: dict[str, tuple[float, Array, Any, str]],
) -> tuple[dict[str, tuple[Array, float]], list[str]]:
    """Return the best values of terms, their errors, and the terms that a balance gives.

    `sampled` maps the name of each term to its integral over the samples and the error. `changes`
    maps the name to four entries: the sign of the term in its balance, the balanced energy or
    momentum, the error of the latter, and the name of the other term.
    """
    summed = _find_sums(trajectory)
    terms = sampled | summed
    balanced: list[str] = []
    if not math.isfinite(trajectory.error_estimate.total):
        return terms, balanced
    for name, (sign, value, value_error, other) in changes.items():
        rest, rest_error = terms.get(other, (0.0, 0.0))
        error = float(np.max(value_error)) + rest_error
        # A term with error 0 does not exchange energy, and needs no balance.
        if name not in summed and other not in balanced and error < terms[name][1]:
            terms[name] = sign * (value - value[0]) + rest, error
            balanced.append(name)
    return terms, balanced


def _find_sums(trajectory: Trajectory) -> dict[str, tuple[Array, float]]:
    """Return the energies that were accumulated during the run, with their errors, by name."""
    gathered = trajectory.gathered
    return {
        name: (np.array(gathered[name]), float(gathered[f"{name}_error"]))
        for name in ENERGIES
        if name in gathered and gathered[name].shape == trajectory.time.shape
    }


def _area(time: Array, size: Array | float) -> float:
    """Return the time integral of an error, (T,) or a number, over samples; 0 for one sample."""
    return float(np.trapezoid(np.broadcast_to(size, time.shape), time))


def _doubt_of_driver(scene: Scene, doubt: Array, of_ground: Array) -> Array:
    """Return the error of the force on the driven body, (T,) N, from contacts and ground."""
    if scene.excitation.from_below:
        return doubt[:, scene.chain.movable]
    if scene.excitation.driven:
        return np.asarray(doubt[:, :2].sum(1) + of_ground[:, 0])
    return doubt[:, 0]


def _carries(scene: Scene) -> bool:
    """Return whether a body that is not one of the grains that move carries the lowest of them.

    A driven last grain counts as one of the grains that move.
    """
    chain = scene.chain
    return chain.bottom == "wall" or (chain.bottom == "fixed" and not scene.excitation.from_below)


def _work_at_ends(scene: Scene, time: Array, u: Array, top: Array | None) -> Array:
    """Return the work of the top load and of the support of a driven base at rest, (T,) J.

    `top` is the position of the top wall, (T,) m, or None if the wall does not move.
    """
    chain = scene.chain
    work = chain.constant_load * u[:, chain.load_grain - 1]
    if top is not None:
        work = work + chain.wall_load * top
    if scene.drive is not None and scene.drive.from_below:
        support = chain.contacts.force[chain.movable] + chain.held_weight
        work = work - support * scene.drive.motion(time)[0]
    return work


def losses(trajectory: Trajectory) -> EnergyLosses:
    """Return the energy that each viscous contact and the drag on each grain dissipate.

    Parameters
    ----------
    trajectory : Trajectory
        Run in which all grains that move were recorded.

    Returns
    -------
    EnergyLosses

    Raises
    ------
    InputError
        If a grain that moves was not recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3, damping={"viscoelastic": 1e-7})
    >>> strike = lmpchain.Impulse(velocity=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=5e-5)
    >>> lost = losses(lmpchain.simulate(scene, engine="native", tolerance=1e-9))
    >>> f"{lost.of_contact[-1].sum() / scene.energy:.3f} of the strike"
    '0.148 of the strike'
    """
    scene, u, v = motion_of_all(trajectory)
    chain = scene.chain
    time = trajectory.time
    motion = motion_of(trajectory)
    doubts = (2 * motion.known_error(field) for field in ("displacement", "velocity"))
    closer, closing = (
        chain.contacts.closer(x, *_positions_of_walls(scene, time, order))
        for order, x in enumerate((u, v))
    )
    contacts = _forces(chain, closer, closing, *doubts)
    lost = _sum_losses(scene, time, contacts, v, motion.known_error("velocity"))
    if not chain.damped or chain.ground_in_time:
        return lost
    balance = ledger(trajectory)
    distance = float(np.abs(lost.total - balance.dissipated).max()) + balance.dissipated_error
    known = distance if math.isfinite(distance) else 0.0
    return replace(lost, error=max(lost.error, known))


def _sum_losses(
    scene: Scene, time: Array, contacts: _Forces, v: Array, fast: float
) -> EnergyLosses:
    """Return the energies dissipated by contacts and grains; `fast` is the speed error, m/s."""
    drag = _drag(scene)
    if not scene.chain.damped:
        return EnergyLosses(time, np.zeros(contacts.power.shape), np.zeros(v.shape), 0.0)
    taken, error = _integral(scene, time, np.hstack((contacts.power, drag * v**2)))
    doubt = contacts.power_doubt.sum(1) + (drag * fast * (2 * np.abs(v) + fast)).sum(1)
    count = scene.chain.grains + 1
    return EnergyLosses(time, taken[:, :count], taken[:, count:], error + _area(time, doubt))


def _drag(scene: Scene) -> Array:
    """Return m gamma of every grain that is not driven, (N,) kg/s."""
    drag = scene.chain.masses * scene.chain.drag
    drag[: scene.excitation.driven] = 0.0
    if scene.excitation.from_below and scene.chain.bottom == "fixed":
        drag[-1] = 0.0
    return drag


def _forces(chain: Chain, closer: Array, closing: Array, off: float, fast: float) -> _Forces:
    """Return contact forces, given the errors of approaches and of their rates, m and m/s."""
    contacts = chain.contacts
    overlap = contacts.overlap + closer
    # The chain rule is dF/dt = (dF/do) do/dt. An open contact has neither force nor rate.
    stiffness = contacts.stiffness_at(np.maximum(overlap, 0.0))
    rate = np.where(overlap > 0, stiffness * closing, 0.0)

    elastic = contacts.force_change(closer)
    ends = [contacts.force_change(closer + nearer) for nearer in (-off, off)]
    largest = np.maximum(*map(np.abs, ends))
    doubt = np.maximum(*(np.abs(end - elastic) for end in ends))
    if not chain.damped:
        nothing = np.broadcast_to(0.0, closer.shape)
        return _Forces(elastic, rate, largest, doubt, nothing, nothing)
    viscous = viscous_force(contacts, chain.contact_viscosity, overlap, closing)
    power = viscous * closing
    force = elastic + viscous
    power_doubt = np.zeros(closer.shape)
    for (nearer, end), faster in product(zip((-off, off), ends, strict=True), (-fast, fast)):
        moved = overlap + nearer, closing + faster
        other = viscous_force(contacts, chain.contact_viscosity, *moved)
        doubt = np.maximum(doubt, np.abs(end + other - force))
        power_doubt = np.maximum(power_doubt, np.abs(other * moved[1] - power))
    return _Forces(force, rate, largest, doubt, power, power_doubt)


def _known_pieces(scene: Scene, time: Array, push: Push, u: Array, v: Array) -> _Pieces:
    """Return the integrals of an applied force over intervals that a cubic cannot represent.

    For an applied force these are all intervals. For a driver they are the intervals in which its
    motion has a kink, which a comparison with every second sample does not reveal. The waveform is
    known at all times, and only the remaining smooth factor of the integrand is interpolated: the
    displacement of the neighbouring body, or the speed of the grain without the part P/m that is
    due to the impulse P of the force F on the mass m:

        int F v dt = [P^2 / 2m] + int F (v - P/m) dt
    """
    wave = scene.excitation.waveform
    assert wave
    moves = scene.drive is not None
    unknown = np.full(time.size - 1, np.nan)
    kinks = np.array(wave.kinks)
    kinks = kinks[(kinks > 0) & (kinks <= time[-1])]
    # The slope at a kink is the right-hand one, so an interval that ends there has a kink.
    known = (np.diff(np.searchsorted(kinks, time, side="right")) > 0) | (not moves)
    # Viscous forces on a driven body do not follow from displacements alone.
    pieces = _Pieces(unknown, unknown, unknown, unknown)
    if not known.any() or (moves and scene.chain.damped):
        return pieces
    turn = min(wave.fastest * time[-1] / (time.size - 1), MOST_TURN)
    count = 1 if moves else math.ceil(turn)
    between = np.interp(np.arange(count * (time.size - 1)) / count, np.arange(time.size), time)
    edges = np.unique(np.concatenate((time, between, kinks)))
    half = np.diff(edges)[:, None] / 2
    x = edges[:-1, None] + half * (1 + NODES)
    begin = np.searchsorted(edges, time[:-1])

    def integrate(values: Array) -> Array:
        return np.where(known, np.add.reduceat((half * values) @ WEIGHTS, begin), np.nan)

    contacts = scene.chain.contacts
    if scene.excitation.from_below:
        last = scene.chain.movable
        above = CubicHermiteSpline(time, u[:, last - 1], v[:, last - 1])(x)
        force = contacts.of(last).force_change(above - wave.at(x))
        impulse = integrate(force)
        return pieces._replace(
            work=-integrate(force * wave.at(x, 1)), push=-impulse, bottom=impulse
        )
    if scene.excitation.wall:
        below = CubicHermiteSpline(time, u[:, 0], v[:, 0])(x)
        force = contacts.of(0).force_change(wave.at(x) - below)
        return pieces._replace(work=integrate(force * wave.at(x, 1)), top=integrate(force))
    if scene.excitation.driven:
        below = CubicHermiteSpline(time, u[:, 1], v[:, 1])(x)
        above = contacts.of(0).force_change(-wave.at(x))
        force = contacts.of(1).force_change(wave.at(x) - below) - above
        if scene.chain.ground is not None:
            force += scene.chain.ground.of_grains([1]).force(wave.at(x), 0.0)
        work = integrate(force * wave.at(x, 1))
        return pieces._replace(work=work, push=integrate(force), top=integrate(above))
    mass = scene.chain.masses[scene.excitation.acts_on - 1]
    impulse = wave.integral(time)
    speed = push.speed - impulse / mass
    slope = push.acceleration - push.force / mass
    if scene.chain.damped:
        slope = CubicSpline(time, speed)(time, 1)
    others = integrate(wave.at(x) * CubicHermiteSpline(time, speed, slope)(x))
    work = np.diff(impulse**2) / (2 * mass) + others
    return pieces._replace(work=work, push=np.diff(impulse))


def _integral(
    scene: Scene,
    time: Array,
    value: Array,
    slope: Array | None = None,
    known: Array | None = None,
) -> tuple[Array, float]:
    """Return the running integral of samples, (T, ...), and its shift with every second sample.

    The shift is replaced by infinity if samples are farther apart than half a period of the fastest
    motion, because it then does not show the error. Without slopes, a spline of degree 7 is
    integrated. `known` gives the integrals over intervals in which the waveform determines them,
    (T-1,), and NaN for the other intervals; the shift is at least the change that they cause.
    """
    smooth = _integrate(time, value, slope)
    fine = smooth
    if known is not None and np.isfinite(known).any():
        pieces = np.where(np.isfinite(known), known, np.diff(smooth))
        fine = np.append(0.0, np.cumsum(pieces))
    coarse = _integrate(time[::2], value[::2], None if slope is None else slope[::2])
    # The largest shift of the sum of all integrals.
    shifts = (
        np.abs(x).reshape(len(x), -1).sum(1).max() for x in (fine[::2] - coarse, fine - smooth)
    )
    unresolved = scene.highest_frequency * np.diff(time).max(initial=0.0) > math.pi
    return fine, math.inf if unresolved else float(max(shifts))


def _integrate(time: Array, value: Array, slope: Array | None) -> Array:
    """Return the integral of an interpolant up to each sample; infinite for one sample."""
    if len(time) < 2:
        return np.full((1, *value.shape[1:]), np.inf)
    if slope is None:
        # The degree of the spline is odd, and lower for few samples.
        degree = min(7, (len(time) - 2) // 2 * 2 + 1)
        curve = make_interp_spline(time, value, degree)
    else:
        # The error of cubic Hermite pieces is about 1/15 of the shift with every second sample.
        curve = CubicHermiteSpline(time, value, slope)
    return np.asarray(curve.antiderivative()(time))


def _positions_of_walls(
    scene: Scene, time: Array, order: int = 0
) -> tuple[Array | None, Array | None]:
    """Return the positions of the top wall and of the bottom wall, (T,) m; None of one at rest.

    If `order` is 1, return the velocities of the walls instead, m/s.
    """
    excitation = scene.excitation
    top = excitation.wall
    base = excitation.waveform if excitation.from_below and scene.chain.bottom == "wall" else None
    return (top.at(time, order) if top else None, base.at(time, order) if base else None)
