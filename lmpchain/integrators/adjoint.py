"""Exact derivatives of a run by a kick-drift splitting: its discrete adjoint and its tangent.

The run is a chain of kicks and drifts, and the adjoint takes derivatives with respect to what was seen of it back
through them, one by one: the result is the derivative of the numbers that the run gives, to round-off, and so that of
the solution up to the error of the steps. A contact that opens or closes is no exception for delta > 1, where its force
and stiffness are continuous. For delta = 1 the stiffness jumps: what is returned is the derivative with every contact
open or closed where the run found it so, which is that of the run unless an evaluation falls on the very opening, and
converges to that of the solution with the step, at first order only.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene.excitation import Drive
from ..scene.scene import Scene
from ..util.arrays import Array
from .kernels import adjoint as kernels
from .splittings import Splitting

LEG = 64  # steps between two completed kicks at most
ROOM = 2**20  # bytes that keep what is between two checkpoints, about what stays in the cache
CHECKPOINTS = 2**29  # bytes of all checkpoints


class Inputs(NamedTuple):
    """What a motion depends on: derivatives by it, or directions (D, ...) in which it changes.

    Attributes
    ----------
    masses : (N,) array
        kg, with the forces at rest as they are.
    constants : (N+1,) array
        K_n of all contacts, those with walls included, with the forces at rest as they are.
    forces : (N+1,) array
        What every contact carries at rest, N; nothing where that is nothing.
    displacement, velocity : (N,) arrays
        Of every grain at t = 0, m and m/s.
    drive : (P,) array
        Amplitude and frequency of a harmonic drive, or the displacements of a sampled one.
    """

    masses: Array
    constants: Array
    forces: Array
    displacement: Array
    velocity: Array
    drive: Array

    def __add__(self, other: Any) -> Inputs:
        return Inputs(*(mine + its for mine, its in zip(self, other, strict=True)))


class DifferentiableRun:
    """A run by steps of one length with its exact derivatives.

    Parameters
    ----------
    scene : Scene
        Struck, displaced or with grain 1 driven.
    method : Splitting
    step : float
        s; the largest step up to it that divides the time between two looks is used.
    looks : int
        Equal parts of the duration, at whose ends grains are looked at.
    grains : (G,) array
        Numbers of the grains that are looked at.

    Attributes
    ----------
    time : (looks+1,) array
        When grains are looked at, s; from 0 to the duration.
    step : float
        Of the steps taken, s.
    displacement, velocity : (looks+1, G) arrays
        m and m/s.

    Raises
    ------
    InputError
        If something acts on the chain that its derivatives are not known of.
    """

    def __init__(self, scene: Scene, method: Splitting, step: float, looks: int, grains: NDArray[np.intp]):
        self.scene, self.grains = scene, np.asarray(grains)
        self.time = np.linspace(0.0, scene.duration, looks + 1)
        steps = max(1, math.ceil(scene.duration / looks / step * (1 - 1e-12)))
        bytes_a_step = 16 * (scene.chain.grains + 1) * method.evaluations
        self._every = -(-steps // min(LEG, max(1, ROOM // bytes_a_step)))  # legs a look
        steps = -(-steps // self._every)
        self.step = scene.duration / (looks * self._every * steps)
        self.steps, self._legs = looks * self._every * steps, looks * self._every
        inner = np.tile(method.kicks[:-1], steps)
        inner[len(method.drifts) :: len(method.drifts)] += method.kicks[-1]
        self._kicks = np.append(inner, method.kicks[-1]) * self.step
        self._drifts = np.append(np.tile(method.drifts, steps), 0.0) * self.step
        self._reach = np.append(0.0, np.cumsum(self._drifts[:-1]))  # time of a row from the begin of its leg
        self.drive = _drive(scene)
        self._read(scene)
        rows = self._kicks.size
        least = math.ceil(self._legs * 16 * scene.chain.grains / CHECKPOINTS)
        self._span = min(self._legs, max(1, least, ROOM // (16 * rows * (scene.chain.grains + 1))))  # legs a segment
        self._looks = np.zeros((2, looks + 1, self.grains.size))
        self._run()

    def _read(self, scene: Scene) -> None:
        """Lay out the chain for the compiled loops."""
        chain, contacts = scene.chain, scene.chain.contacts
        pressed = contacts.pressed
        length = np.where(pressed, contacts.overlap, 1.0)
        strength = np.where(pressed, contacts.force, contacts.constant)
        self._pressed = pressed[:2].astype(float)
        touches = np.concatenate((self._pressed[:1], np.full(chain.grains, self._pressed[1])))
        self._table = np.array([np.where(contacts.exists, 1 / length, 0.0), strength])
        self._stiff = chain.exponent * self._table[0] * strength * np.array([touches, np.ones(touches.size)])
        self._inverse_mass = 1 / chain.masses
        self._inverse_mass[chain.movable :] = 0.0
        self._inverse_mass[: self.drive is not None] = 0.0
        self._law = kernels.HERTZ if chain.exponent == 1.5 else kernels.OTHER
        self._less = chain.exponent - 1

    def _run(self) -> None:
        """Move on to the end, with checkpoints at the begin of every segment."""
        u, v = self.scene.initial()
        x, v = np.concatenate(([0.0], u, [0.0])), np.array(v, dtype=float)
        v[: self.drive is not None] = 0.0
        self._looks[0, 0], self._looks[1, 0] = u[self.grains - 1], v[self.grains - 1]
        self._kept = []
        self._room = np.empty((2, self._kicks.size * self._span, x.size - 1))
        for first in range(0, self._legs, self._span):
            self._kept.append((x.copy(), v.copy()))
            self._forward(first, x, v, self._looks, self._legs > self._span)
        if self.drive is not None:
            own = self.grains == 1
            for order in (0, 1):
                self._looks[order][:, own] = self.drive.motion(self.time)[order][:, None]

    def _forward(self, first: int, x: Array, v: Array, looks: Array, forget: bool) -> None:
        """Move x and v through the segment that begins with this leg."""
        legs = min(self._span, self._legs - first)
        room = self._room[:, :1] if forget else self._room
        kernels.forward(
            self._law, x, v, self._table, self._inverse_mass, self._pressed, self._less, self._kicks, self._drifts,
            self._path(first, legs), legs, *room, (self.grains - 1, self._every, first, looks),
        )  # fmt: skip

    def _times(self, first: int, legs: int) -> Array:
        """Return the times of all rows of some legs, (legs, R) s."""
        return (first + np.arange(legs))[:, None] * (self.scene.duration / self._legs) + self._reach

    def _path(self, first: int, legs: int) -> Array:
        """Return where grain 1 is driven in every row of some legs, (legs, R) m, or nothing."""
        return np.empty((0, 0)) if self.drive is None else self.drive.motion(self._times(first, legs))[0]

    @property
    def displacement(self) -> Array:
        """Displacement of the grains looked at, (looks+1, G) m."""
        return self._looks[0]

    @property
    def velocity(self) -> Array:
        """Velocity of the grains looked at, (looks+1, G) m/s."""
        return self._looks[1]

    def pull(self, displacement: Array, velocity: Array) -> Inputs:
        """Return the derivatives of an answer by all inputs, from those by what was seen.

        Parameters
        ----------
        displacement, velocity : (looks+1, G) arrays
            Derivatives of the answer with respect to each displacement, 1/m, and velocity, s/m, looked at.
        """
        chain, grains = self.scene.chain, self.scene.chain.grains
        looks = np.array([displacement, velocity], dtype=float)
        x, v, w = np.zeros(grains), np.zeros(grains), np.zeros(grains + 2)
        sums = np.zeros(grains + 1), np.zeros(grains + 1), np.zeros(grains)
        by_drive = np.zeros(0 if self.drive is None else self.imposed.size)
        if self.drive is not None:
            own = looks[..., self.grains == 1].sum(-1)
            by_drive += self.imposed.pull(self.time, own[1], 1) + self.imposed.pull(self.time[:1], own[0, :1], 0)
            looks[1][:, self.grains == 1] = 0.0
        aside = np.empty_like(looks)
        for first in reversed(range(0, self._legs, self._span)):
            legs = min(self._span, self._legs - first)
            if self._legs > self._span:
                again = self._kept[first // self._span]
                self._forward(first, again[0].copy(), again[1].copy(), aside, False)
            on_path = np.empty((0, 0) if self.drive is None else (legs, self._kicks.size))
            kernels.backward(
                x, v, w, self._stiff, self._inverse_mass, self._kicks, self._drifts, on_path, legs, *self._room,
                (self.grains - 1, self._every, first, looks), sums,
            )  # fmt: skip
            if self.drive is not None:
                by_drive += self.imposed.pull(self._times(first, legs), on_path, 0)
        np.add.at(x, self.grains - 1, looks[0, 0])
        np.add.at(v, self.grains - 1, looks[1, 0])
        contacts, (by_power, by_force, by_mass) = chain.contacts, sums
        held = self._inverse_mass == 0
        x[held], v[held] = 0.0, 0.0
        constant = np.where(contacts.exists, contacts.constant, 1.0)
        return Inputs(
            -by_mass / chain.masses, np.where(contacts.exists, by_force - contacts.force * by_power, 0.0) / constant,
            np.where(contacts.pressed, by_power, 0.0), x, v, by_drive,
        )  # fmt: skip

    def push(self, change: Inputs) -> tuple[Array, Array]:
        """Return how displacement and velocity looked at change, (D, looks+1, G), in D directions."""
        chain, contacts = self.scene.chain, self.scene.chain.contacts
        dx = np.pad(np.array(change.displacement, dtype=float), ((0, 0), (1, 1)))
        dv = np.array(change.velocity, dtype=float)
        held = self._inverse_mass == 0
        dx[:, 1:-1][:, held], dv[:, held] = 0.0, 0.0
        looks = np.zeros((dx.shape[0], *self._looks.shape))
        looks[:, 0, 0], looks[:, 1, 0] = dx[:, self.grains], dv[:, self.grains - 1]
        forces = np.where(contacts.pressed, change.forces, 0.0)
        fixed = self._stiff, contacts.constant, contacts.force, change.masses / chain.masses, change.constants, forces
        x, v = (start.copy() for start in self._kept[0])
        work = np.empty((5, chain.grains + 1))
        for first in range(0, self._legs, self._span):
            legs = min(self._span, self._legs - first)
            by_path = np.empty((0, 0, 0))
            if self.drive is not None:
                by_path = self.imposed.push(self._times(first, legs), change.drive, 0)
            kernels.tangent(
                self._law, x, v, work, self._table, self._inverse_mass, self._pressed, self._less, self._kicks,
                self._drifts, self._path(first, legs), legs, (*fixed, by_path), dx, dv,
                (self.grains - 1, self._every, first, looks),
            )  # fmt: skip
        if self.drive is not None:
            own = self.grains == 1
            for order in (0, 1):
                looks[:, order][:, :, own] = self.imposed.push(self.time, change.drive, order)[..., None]
        return looks[:, 0], looks[:, 1]

    @cached_property
    def imposed(self) -> ImposedMotion:
        """How the motion of a driven grain depends on amplitude and frequency, or on its samples."""
        assert self.drive is not None
        return ImposedMotion(self.drive)


class ImposedMotion:
    """The motion of a driven grain as a function of amplitude and frequency, or of its samples."""

    def __init__(self, drive: Drive):
        self.drive = drive
        self.size = 2 if drive.times is None else len(drive.times)

    @cached_property
    def _basis(self) -> Any:
        """The spline through 1 at one sample and 0 at the others, for each of them."""
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.drive.times, np.eye(self.size))

    def _pieces(self, time: Array, order: int) -> tuple[NDArray[np.intp], Array]:
        """Return the piece of the spline at each time, and what multiplies its four coefficients, (4, T)."""
        knots = self._basis.x
        piece = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, knots.size - 2)
        s = time - knots[piece]
        one = np.ones_like(s)
        return piece, np.array([s**3, s**2, s, one] if order == 0 else [3 * s**2, 2 * s, one, 0 * s])

    def _harmonic(self, time: Array, order: int) -> Array:
        """Return derivatives with respect to amplitude and frequency, (2, ...)."""
        size, omega = self.drive.amplitude, 2 * np.pi * self.drive.frequency
        sine, cosine, turn = np.sin(omega * time), np.cos(omega * time), 2 * np.pi * size
        if order == 0:
            return np.array([sine, turn * time * cosine])
        return np.array([omega * cosine, turn * (cosine - omega * time * sine)])

    def pull(self, time: Array, weight: Array, order: int) -> Array:
        """Return derivatives (P,) of the sum of weight times displacement (order 0) or velocity (1) at times."""
        time, weight = time.ravel(), weight.ravel()
        if self.drive.times is None:
            return self._harmonic(time, order) @ weight
        piece, powers = self._pieces(time, order)
        count = self.size - 1
        gathered = np.array([np.bincount(piece, weight * power, count) for power in powers])
        return np.tensordot(gathered, self._basis.c, 2)

    def push(self, time: Array, change: Array, order: int) -> Array:
        """Return the change (D, ...) of displacement (order 0) or velocity (1) at times, for changes (D, P)."""
        if self.drive.times is None:
            return np.tensordot(change, self._harmonic(time, order), 1)
        piece, powers = self._pieces(time, order)
        coefficients = np.tensordot(change, self._basis.c, (1, 2))  # (D, 4, P-1)
        return np.einsum("k...,dk...->d...", powers, coefficients[:, :, piece])


def _drive(scene: Scene) -> Drive | None:
    """Return the motion of grain 1 if it is driven; the one place that knows what may act after t = 0."""
    drive = scene.drive
    if scene.excitation.does_work and drive is None:
        kind = scene.excitation.kind
        raise InputError([("excitation", f"derivatives of a {kind} are not known: use initial data or a drive")])
    if drive and (drive.grain != 1 or drive.cycles is not None):
        raise InputError([("excitation", "derivatives are known of a drive of grain 1 by a sine or along points only")])
    return drive
