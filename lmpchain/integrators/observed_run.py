"""What all runs with derivatives share: given steps, and grains that are looked at."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scene.acting import Drive, Force
from ..scene.scene import Scene
from ..util.arrays import Array
from .batch import ChainBatch
from .imposed import ImposedCourse
from .kernels.adjoint import ImposedPath
from .kernels.course import Looks
from .kernels.layout import ALONE, PAD, Chains


class HeldSteps(NamedTuple):
    """Steps that a run is to take.

    Attributes
    ----------
    time : (looks+1,) array
        When grains are looked at, s; from 0 to the duration.
    lengths, begins : (K,) arrays
        s.
    before : (looks+1,) array
        How many steps are made before each look.
    """

    time: Array
    lengths: Array
    begins: Array
    before: NDArray[np.intp]


def hold_steps(scene: Scene, step: float | list[Array], looks: int) -> HeldSteps:
    """Return the steps of a run, as `ObservedRun` takes them."""
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
    return HeldSteps(time, lengths, begins, np.concatenate(([0], np.cumsum(counts))))


def acting(scene: Scene) -> ImposedCourse | None:
    """Return the motion or force that is imposed after t = 0, if any is."""
    excitation = scene.excitation
    return ImposedCourse(excitation) if isinstance(excitation, (Drive, Force)) else None


class ObservedRun:
    """A chain laid out for a run by given steps, and what is seen of it.

    Parameters and attributes are those of `adjoint.DifferentiableRun`.
    """

    _times: Callable[..., Array]  # of rows as a class counts them, s

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
        """Displacement of the grains looked at, (looks+1, G) m."""
        return self._looks.values[0]

    @property
    def velocity(self) -> Array:
        """Velocity of the grains looked at, (looks+1, G) m/s."""
        return self._looks.values[1]

    def _path(self, *rows: Any) -> ImposedPath:
        """Return the imposed motion or force in rows that `_times` knows, or none."""
        if self.imposed is None:
            return ImposedPath(0, np.empty(0), np.empty(0))
        body = int(self._arrays.wave["body"][0])
        imposed = self.imposed.waveform.at(self._times(*rows))
        return ImposedPath(body, imposed, np.zeros(imposed.size))

    def _fill_motion_of_driven(self, values: Array) -> None:
        """Fill what is seen of a driven grain, whose velocity the loops leave out."""
        if self.imposed and self._driven:
            for order in (0, 1):
                motion = self.imposed.waveform.at(self.time, order)
                values[order][:, self.grains == 1] = motion[:, None]

    def _fill_change_of_driven(self, values: Array, drive: Array) -> None:
        """Fill by how much what is seen of a driven grain changes with its drive (D, P)."""
        if self.imposed and self._driven:
            for order in (0, 1):
                motion = self.imposed.push(self.time, drive, order)
                values[:, order][:, :, self.grains == 1] = motion[..., None]
