"""Base of differentiable runs: prescribed steps, observed grains, imposed motions and forces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from ..scene.acting import Drive, Force
from ..scene.scene import Scene
from ..scene.waveform import curve_through
from ..util.arrays import Array
from ..util.lazy import cached_property
from .batch import ChainBatch
from .kernels.adjoint import ImposedPath
from .kernels.layout import ALONE, PAD, Chains
from .kernels.sample_loop import Looks
from .stepper import NativeStepper
from .steps import Method, Steps


def hold_steps(
    scene: Scene, step: float | list[Array], looks: int
) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Return the steps of a run: K steps, with observations after some of the steps.

    Parameters
    ----------
    scene : Scene
        Scene of the run.
    step : float or list of `looks` arrays
        Longest length of equal steps, s, or the steps between successive observations, s.
    looks : int
        Number of observations after t = 0.

    Returns
    -------
    time : (looks+1,) array
        Times of the observations, from 0 to the duration, s.
    lengths : (K,) array
        Length of each step, s.
    begins : (K,) array
        Time at which each step begins, s.
    before : (looks+1,) array
        Number of steps before each observation.
    """
    time = np.linspace(0.0, scene.duration, looks + 1)
    if isinstance(step, list):
        lengths = np.concatenate(step)
        counts = [len(of_part) for of_part in step]
        pairs = zip(time, step, strict=False)
        begins = np.concatenate([t + np.cumsum(of_part) - of_part for t, of_part in pairs])
    else:
        count = max(1, math.ceil(scene.duration / looks / step * (1 - 1e-12)))
        lengths = np.full(looks * count, scene.duration / (looks * count))
        counts = [count] * looks
        begins = np.arange(looks * count) * lengths[0]
    return time, lengths, begins, np.concatenate(([0], np.cumsum(counts)))


def schedule_of(scene: Scene, step: float, looks: int, adaptive: bool) -> Steps:
    """Return steps up to this length, s, that end at `looks` equally spaced observations."""
    interval = scene.duration / looks
    count = max(1, math.ceil(interval / step * (1 - 1e-12)))
    return Steps.spread(interval, count, adaptive=adaptive)


def adaptive_steps(scene: Scene, method: Method, step: float, looks: int) -> list[Array]:
    """Return the adaptive steps of a run, which are shorter near openings of contacts.

    Parameters
    ----------
    scene : Scene
        Scene of the run.
    method : Splitting
        Integration method of order above 2.
    step : float
        Longest step, s.
    looks : int
        Number of equal parts of the duration; a step ends at the end of each part.

    Returns
    -------
    list of `looks` arrays
        Lengths of the steps in each part, s.
    """
    schedule = schedule_of(scene, step, looks, True)
    run = NativeStepper(ChainBatch([scene.replace(samples=looks + 1)]), method, schedule, {})
    u, v = np.empty((2, 1, 2, scene.chain.grains))
    steps: list[Array] = []
    for look in range(looks):
        times = [0.0]
        while run.sample == look:
            run.fill(u, v, look, look + 1, 1)
            times.append(float(run.watched["done"][0]))
        times[-1] = scene.duration / looks
        steps.append(np.diff(times))
    return steps


class ImposedCourse:
    """A motion or a force over time as a function of amplitude and frequency, or of its samples.

    Attributes
    ----------
    waveform : Waveform
        Imposed displacement, m, or force, N, as a function of time.
    frequency : float
        Frequency of a sine, Hz.
    excitation : Drive or Force
        Excitation that imposes the motion or force.
    size : int
        Number P of parameters: 2 for the amplitude and frequency of a sine, 1 for the speed of a
        piston, else the number of samples.
    """

    def __init__(self, excitation: Drive | Force):
        self.waveform = excitation.waveform
        self.frequency = excitation.frequency
        self.excitation = excitation
        self.size = excitation.numbers.size

    @cached_property
    def _basis(self) -> Any:
        """The spline basis: for each sample, a curve that is 1 there and 0 at all others."""
        drive = self.excitation
        if drive.times is None:
            # The motion of a piston for a speed of 1.
            unit = drive.replace(velocity=1.0).waveform.spline
            return PPoly(unit.c[..., None], unit.x)
        return curve_through(drive.times, np.eye(self.size), drive.interpolation, drive.holds)

    def _pieces(self, time: Array, order: int) -> tuple[NDArray[np.intp], Array]:
        """Return the piece of the spline at each time, and factors of its coefficients, (4, T)."""
        knots = self._basis.x
        piece = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, knots.size - 2)
        s = time - knots[piece]
        ones = np.ones_like(s)
        return piece, np.array(
            [s**3, s**2, s, ones] if order == 0 else [3 * s**2, 2 * s, ones, 0 * s]
        )

    def _sine(self, time: Array, order: int) -> Array:
        """Return the derivatives by amplitude and frequency, (2, ...)."""
        wave = self.waveform
        # The derivative of A sin(w t) by w is its rate times t / w.
        by_frequency = time * wave.at(time, order + 1) + (wave.at(time, 1) if order else 0.0)
        return np.array(
            [
                replace(wave, amplitude=1.0).at(time, order),
                by_frequency / (self.frequency or np.inf),
            ]
        )

    def pull(self, time: Array, weight: Array, order: int) -> Array:
        """Return the derivatives (P,) of a weighted sum of values, or of rates (order 1)."""
        time = time.ravel()
        weight = weight.ravel()
        if self.waveform.spline is None:
            return self._sine(time, order) @ weight
        piece, powers = self._pieces(time, order)
        # Pieces are summed first, because the number of coefficients is the square of that of
        # samples.
        count = self._basis.x.size - 1
        by_piece = np.array([np.bincount(piece, weight * power, count) for power in powers])
        return np.tensordot(by_piece, self._basis.c, 2)

    def push(self, time: Array, change: Array, order: int) -> Array:
        """Return the changes (D, ...) of values, or of rates (order 1), for changes (D, P)."""
        if self.waveform.spline is None:
            return np.tensordot(change, self._sine(time, order), 1)
        piece, powers = self._pieces(time, order)
        # Shape (D, 4, P-1).
        coefficients = np.tensordot(change, self._basis.c, (1, 2))
        return np.einsum("k...,dk...->d...", powers, coefficients[:, :, piece])


def acting(scene: Scene) -> ImposedCourse | None:
    """Return the motion or force imposed after t = 0, or None."""
    excitation = scene.excitation
    return ImposedCourse(excitation) if isinstance(excitation, (Drive, Force)) else None


class ObservedRun:
    """A chain in the memory layout of a run with prescribed steps, and its observed grains.

    See `adjoint.DifferentiableRun` for the parameters and attributes. The attributes `steps` and
    `imposed` are the number of steps and the imposed motion or force, which may be None.
    """

    _times: Callable[..., Array]  # Function that returns the times of rows, s.

    def __init__(
        self,
        scene: Scene,
        step: float | list[Array],
        looks: int,
        grains: NDArray[np.intp],
    ):
        self.scene = scene
        self.grains = np.asarray(grains)
        self.time, self._lengths, self._begins, self._before = hold_steps(scene, step, looks)
        self.step = float(self._lengths.max())
        self.steps = self._lengths.size
        self.imposed = acting(scene)
        self._driven = self.imposed is not None and bool(scene.excitation.driven)
        batch = ChainBatch([scene])
        u, v = batch.initial
        self._x, self._v, self._state = batch.place(u[None], v[None])
        nothing = np.zeros((1, 0, self._x.shape[1]))
        self._chains = Chains(batch.arrays, self._x, self._v, nothing, self._state, ALONE)
        self._arrays = batch.arrays
        self._mobility = batch.arrays.inverse_mass[0]
        bodies = self.grains + (PAD - 1)
        self._looks = Looks(bodies, np.zeros((2, looks + 1, self.grains.size)))

    @property
    def displacement(self) -> Array:
        """Displacement of the observed grains, (looks+1, G) m."""
        return self._looks.values[0]

    @property
    def velocity(self) -> Array:
        """Velocity of the observed grains, (looks+1, G) m/s."""
        return self._looks.values[1]

    def _path(self, *rows: Any) -> ImposedPath:
        """Return the imposed motion or force at the row times."""
        if self.imposed is None:
            return ImposedPath(0, np.empty(0), np.empty(0))
        body = int(self._arrays.wave["body"][0])
        imposed = self.imposed.waveform.at(self._times(*rows))
        return ImposedPath(body, imposed, np.zeros(imposed.size))

    def _fill_motion_of_driven(self, values: Array) -> None:
        """Fill the observed motion of a driven grain, whose velocity the loops do not compute."""
        if self.imposed and self._driven:
            for order in (0, 1):
                motion = self.imposed.waveform.at(self.time, order)
                values[order][:, self.grains == 1] = motion[:, None]

    def _fill_change_of_driven(self, values: Array, drive: Array) -> None:
        """Fill the changes of the observed motion of a driven grain for changes (D, P)."""
        if self.imposed and self._driven:
            for order in (0, 1):
                motion = self.imposed.push(self.time, drive, order)
                values[:, order][:, :, self.grains == 1] = motion[..., None]
