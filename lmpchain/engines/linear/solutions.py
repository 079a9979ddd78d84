"""Solutions of the linearised chain, Eq. (3), by Chebyshev polynomials or modes, with energies."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ...chain.ground import join_contacts
from ...integrators.kernels.chebyshev import Propagator
from ...scene.scene import Scene
from ...util.arrays import Array
from ..base import ErrorBudget


class LinearSolution(Protocol):
    """A solution of the linearised chain."""

    @property
    def work(self) -> int:
        """Number of polynomials or modes computed so far, which determines the cost."""

    def at(self, times: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        """Return the displacement and velocity, (T, N) m and m/s, and reach, (T, 2).

        The reach at each time is the index, from 0, of the first grain that may move, and the index
        after the last one. The times of successive calls must increase.
        """

    def state(self) -> dict[str, Array]:
        """Return the arrays from which `LinearEngine.solve` continues."""


class ChebyshevSolution:
    """Solution by the propagator from each time to the next."""

    def __init__(self, scene: Scene, state: Mapping[str, Array]):
        chain = scene.chain
        drive = scene.drive
        stiffness = chain.contacts.stiffness
        mobility = 1 / chain.masses
        mobility[chain.movable :] = 0.0
        mobility[: scene.excitation.driven] = 0.0
        u, v = (np.array(state[key]) for key in "uv") if state else scene.initial()
        self._walls = int(scene.excitation.wall is not None)
        # A moving wall is one more body at the top.
        if scene.excitation.wall:
            stiffness = np.append(0.0, stiffness)
            mobility = np.append(0.0, mobility)
            if not state:
                u = np.append(0.0, u)
                v = np.append(scene.excitation.wall.at(0.0, 1), v)
        self._chain = Propagator(stiffness, mobility, drive.waveform.omega if drive else 0.0, u, v)
        self._time = float(state.get("time", 0.0))

    @property
    def work(self) -> int:
        """Number of polynomials computed so far, each by one product with the chain's matrix."""
        return self._chain.terms

    def at(self, times: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        """Return the displacement, velocity and reach, as `LinearSolution.at` does."""
        before = self._time
        self._time = float(times[-1])
        u, v, reach = self._chain.advance(times - before)
        return u[:, self._walls :], v[:, self._walls :], np.maximum(reach - self._walls, 0)

    def state(self) -> dict[str, Array]:
        """Return the displacement and velocity, and their time."""
        return {"u": self._chain.u.copy(), "v": self._chain.v.copy(), "time": np.array(self._time)}


class ModalSolution:
    """Sum over eigenmodes, with the response to a motion or force that is a sum of sines."""

    def __init__(self, scene: Scene):
        from ...theory.modes import between, damped

        chain = scene.chain
        excitation = scene.excitation
        first = excitation.driven
        last = chain.movable
        stiffness = chain.contacts.stiffness
        ground = chain.ground_stiffness[first:last]
        modes = between(stiffness[first : last + 1], chain.masses[first:last], ground)
        self._modes = damped(modes, chain)
        u, v = scene.initial()
        self._initial = u[first:last], v[first:last]
        self._wave = excitation.waveform
        self._drive = scene.drive if first else None
        if scene.drive:
            # A driven grain acts through the contact below it; a force acts directly.
            self._pull = stiffness[first] * self._modes.shape[0]
            self._viscosity = float(chain.contact_viscosity[first])
        else:
            self._viscosity = 0.0
            self._pull = self._modes.shape[excitation.acts_on - 1]
        self._held = chain.grains - last

    @property
    def work(self) -> int:
        """Number of modes."""
        return self._modes.frequency.size

    def at(self, times: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        """Return the displacement, velocity and reach as `LinearSolution.at` does, at any times."""
        u, v = self._modes.response(times, *self._initial)
        top = np.empty((2, times.size, 0))
        if self._wave:
            forced = self._force(times[:, None])
            u = u + forced[0] @ self._modes.shape.T
            v = v + forced[1] @ self._modes.shape.T
        if self._drive:
            top = np.array(self._drive.motion(times))[..., None]
        rest = np.zeros((times.size, self._held))
        u = np.hstack((top[0], u, rest))
        v = np.hstack((top[1], v, rest))
        return u, v, np.tile((0, u.shape[1]), (times.size, 1))

    def _force(self, t: Array) -> tuple[Array, Array]:
        """Solve ``q'' + w^2 q = f(t)`` from rest, (T, M): response to sines, then free motion."""
        assert self._wave
        end = self._wave.end
        q, p = np.sum(
            [self._by_sine(np.minimum(t, end), *sine) for sine in self._wave.sines], axis=0
        )
        if np.isinf(end):
            return q, p
        # After the end of the forcing the modes oscillate freely.
        return self._modes.free(np.maximum(t - end, 0.0), q, p)

    def _by_sine(self, t: Array, amplitude: float, omega: float) -> tuple[Array, Array]:
        """Solve ``q'' + w^2 q = f sin(W t)`` from rest, (T, M), also for w = W and short t."""
        # Importing scipy.special takes longer than many runs.
        from scipy.special import spherical_jn

        if self._modes.decay is not None:
            return self._by_sine_of_damped(t, amplitude, omega)
        w = self._modes.frequency
        drive = abs(omega)
        m = (w + drive) / 2 * t
        h = (w - drive) / 2 * t
        f = self._pull * np.copysign(amplitude, amplitude * omega) / (w + drive)
        # The expression sin(m) cos(h) - m cos(m) sin(h) / h cancels for short t; spherical Bessel
        # functions do not.
        q = f / w * m * (m * spherical_jn(1, m) * np.cos(h) - h * spherical_jn(1, h) * np.cos(m))
        return q, f * drive * np.sin(m) * t * np.sinc(h / np.pi)

    def _by_sine_of_damped(self, t: Array, amplitude: float, omega: float) -> tuple[Array, Array]:
        """Return the forced motion of damped modes, by the response of their exponentials.

        A driven grain also exerts a force by its velocity, through the viscosity of its contact.
        """
        turn = 1j * omega
        push = amplitude * (1 + turn * self._viscosity)
        slow, fast = self._modes.exponents
        # Decaying exponentials do not overflow.
        force = push * np.exp(turn * t)
        by_slow = force * np.expm1((slow - turn) * t) / (slow - turn)
        by_fast = force * np.expm1((fast - turn) * t) / (fast - turn)
        apart = slow - fast
        q = ((by_slow - by_fast) / apart).imag
        p = ((slow * by_slow - fast * by_fast) / apart).imag
        # Both terms cancel near critical damping. The steady motion plus the free motion that makes
        # it start from rest does not, because such a mode has no resonance.
        near = np.abs(apart) < self._modes.frequency
        if not near.any():
            return self._pull * q, self._pull * p
        size = np.where(near, push / ((slow - turn) * (fast - turn)), 0.0)
        steady = size * np.exp(turn * t)
        free = self._modes.free(t, -size.imag, -(turn * size).imag)
        q = np.where(near, steady.imag + free[0], q)
        p = np.where(near, (turn * steady).imag + free[1], p)
        return self._pull * q, self._pull * p

    def state(self) -> dict[str, Array]:
        """Return an empty state, because the modes give the solution at any time."""
        return {}


GAUSS_NODES, _WEIGHTS = legendre.leggauss(32)
# Matrix from values at the nodes to coefficients of the Legendre series (32,).
PROJECT = (np.arange(32) + 0.5)[:, None] * _WEIGHTS * legendre.legvander(GAUSS_NODES, 31).T
# Largest number of halvings of a panel; an overdamped mode decays within a small part of a panel.
HALVINGS = 12


def sum_energies(
    scene: Scene,
    solve: Callable[[], LinearSolution],
    budget: ErrorBudget,
    scale: Array,
    most: int,
) -> dict[str, Array]:
    """Return the dissipated energy and the work at the samples, (T,) J, with their errors.

    Parameters
    ----------
    scene : Scene
    solve : callable
        Function that returns the solution, started at t = 0.
    budget : ErrorBudget
        Estimated error of the solution.
    scale : (2,) array
        Largest displacement, m, and velocity, m/s.
    most : int
        Largest number of evaluations.

    Returns
    -------
    dict of arrays
        Energies and their errors by name. The dict is empty without damping, because the energy
        balance then gives the work, and if the quadrature needs more than `most` evaluations.
    """
    excitation = scene.excitation
    left = most // GAUSS_NODES.size
    # A product of two oscillations over a panel of 10 rad is a Legendre series of 32 terms up to
    # rounding.
    count = math.ceil(scene.linear_frequency * scene.duration / 10.0)
    if not scene.chain.damped or count > left:
        return {}
    kinks = excitation.waveform.kinks if excitation.waveform else ()
    edges = np.linspace(0.0, scene.duration, count + 1)
    edges = np.union1d(edges, [t for t in kinks if 0 < t < scene.duration])
    begin, width = edges[:-1], np.diff(edges)
    accepted = []
    largest = np.zeros(2)
    for halvings in range(HALVINGS + 1):
        left -= begin.size
        if left < 0:
            return {}
        times = begin[:, None] + width[:, None] / 2 * (1 + GAUSS_NODES)
        powers = _powers(scene, solve(), times.ravel(), budget.total * scale)
        series = PROJECT @ powers.reshape(*times.shape, 4)
        largest = np.maximum(largest, np.abs(powers[:, :2]).max(0))
        tails = np.abs(series[:, -2:, :2]).max(1)
        poor = (tails > 10 * budget.solver * largest).any(1) & (halvings < HALVINGS)
        accepted.append((begin[~poor], width[~poor], series[~poor], tails[~poor]))
        if not poor.any():
            break
        width = np.repeat(width[poor] / 2, 2)
        begin = np.repeat(begin[poor], 2)
        begin[1::2] += width[1::2]
    begin, width, series, tails = map(np.concatenate, zip(*accepted, strict=True))
    order = np.argsort(begin)
    panel = np.searchsorted(begin[order], scene.time, side="right") - 1
    position = 2 * (scene.time - begin[order][panel]) / width[order][panel] - 1
    errors = width @ (2 * tails + series[:, 0, 2:])
    energies = {}
    for column, name in enumerate(("dissipated", "drive")):
        if column and not excitation.does_work:
            continue
        integral = legendre.legint(series[order, :, column].T, lbnd=-1) * width[order] / 2
        before = np.cumsum(integral.sum(0)) - integral.sum(0)
        within = legendre.legval(position, integral[:, panel], tensor=False)
        energies[name] = before[panel] + within
        energies[f"{name}_error"] = np.array(errors[column])
    if excitation.driven and excitation.waveform:
        # The force on a driven grain includes the force that accelerates the grain itself.
        speed = excitation.waveform.at(scene.time, 1)
        energies["drive"] += scene.chain.masses[0] / 2 * (speed**2 - speed[0] ** 2)
    return energies


def _powers(scene: Scene, solution: LinearSolution, times: Array, off: Array) -> Array:
    """Return the powers of damping and of the forcing, and their errors, (T, 4) W.

    `off` is the error of the displacement, m, and of the velocity, m/s, of the solution.
    """
    chain = scene.chain
    excitation = scene.excitation
    wall = excitation.wall
    moved = (wall.at(times), wall.at(times, 1)) if wall else (None, None)
    u, v, _ = solution.at(times)
    closing = chain.contacts.closer(v, moved[1])
    stiffness = chain.contacts.stiffness
    viscosity = stiffness * chain.contact_viscosity
    drag = chain.masses * chain.drag
    drag[: excitation.driven] = 0.0
    closing_off, fast = 2 * off[1], off[1]
    lost = closing**2 @ viscosity + v**2 @ drag
    lost_off = (2 * np.abs(closing) + closing_off) @ viscosity * closing_off
    lost_off += (2 * np.abs(v) + fast) @ drag * fast
    force = stiffness * chain.contacts.closer(u, moved[0]) + viscosity * closing
    if chain.ground is not None:
        force = join_contacts(force, chain.ground_stiffness * u)
    push = excitation.push(chain, times, force, np.zeros(force.shape), v)
    if push is None:
        return np.stack([lost, np.zeros(lost.shape), lost_off, np.zeros(lost.shape)], axis=1)
    given_off = np.abs(push.force) * fast
    if excitation.driven or wall:
        touched = slice(0, 1 + excitation.driven)
        force_off = stiffness[touched].sum() * 2 * off[0] + viscosity[touched].sum() * closing_off
        if excitation.driven:
            force_off += chain.ground_stiffness[0] * off[0]
        given_off = np.abs(push.speed) * force_off
    return np.stack([lost, push.force * push.speed, lost_off, given_off], axis=1)
