"""The motion of a chain over a period by a symplectic splitting, and its tangent map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..integrators.batch import ChainBatch
from ..integrators.kernels.layout import PAD, Links
from ..integrators.kernels.tangent import Deviations, Held, Motion, Steps, march
from ..integrators.splittings import KAHAN_LI8
from ..scene.excitation import Drive, Profile
from ..scene.scene import Scene
from ..util.arrays import Array

METHOD = KAHAN_LI8


class Passage(NamedTuple):
    """Motion of a chain over K steps.

    Attributes
    ----------
    displacement, velocity : (K+1, N) arrays
        States between the steps, m and m/s.
    deviation : (2, M, C) array
        Deviations at the end.
    """

    displacement: Array
    velocity: Array
    deviation: Array


@dataclass(frozen=True, eq=False)
class Flow:
    """Eq. (1) in canonical variables, for the M grains that are free.

    ``q = sqrt(m) phi`` and ``p = sqrt(m) phi' / rate``, so that tangent maps are symplectic.

    Parameters
    ----------
    chain : Chain
    rate : float
        rad/s, of the order of the frequencies of the orbit.
    drive : Drive, optional
        Harmonic; its frequency follows the period.
    cycles : int
        Of the drive in a period.

    Raises
    ------
    InputError
        If nothing keeps the chain together, or the drive is not harmonic or not one of this chain.
    """

    chain: Chain
    rate: float
    drive: Drive | None = None
    cycles: int = 1

    def __post_init__(self) -> None:
        chain = self.chain
        chain.refuse_damping("an orbit")
        drive = self.drive
        if drive is not None:
            if drive.times is not None or getattr(drive, "cycles", None) is not None:
                message = "must be a sine that never ends: give amplitude and frequency alone"
                raise InputError.at("drive", message)
            if faults := list(drive.faults(chain, 1.0)):
                raise InputError([(f"drive.{key}", message) for key, message in faults])
        elif not chain.linearisable and self._flies_apart:
            message = "flies apart: use a top load, gravity, or walls at both ends"
            raise InputError.at("chain", message)

    @property
    def _flies_apart(self) -> bool:
        """Whether grains that only touch have an end where no wall holds them."""
        chain = self.chain
        return chain.top == "free" or (chain.bottom == "free" and not chain.compressed)

    @cached_property
    def _kernel_arrays(self) -> tuple[Links, Array]:
        """Contacts, and inverse masses of all bodies, 1/kg, for the compiled loop."""
        rest = Profile(velocity=np.zeros(self.chain.grains))
        # scales of a chain at rest divide by 0, but are not used
        with np.errstate(all="ignore"):
            scene = Scene(chain=self.chain, excitation=rest, duration=1.0, samples=2)
            batch = ChainBatch([scene], "exact")
        inverse_mass = batch.inverse_mass[0]
        # a grain that the drive holds does not give way
        inverse_mass[PAD : PAD + self.held] = 0.0
        return batch.links, inverse_mass

    @cached_property
    def weight(self) -> Array:
        """Roots of the masses of the free grains, (M,)."""
        return np.sqrt(self.chain.masses[self.free])

    @property
    def held(self) -> int:
        """Grains at the top that the drive holds: 1 or 0."""
        return int(self.drive is not None and getattr(self.drive, "grain", 1) == 1)

    @property
    def free(self) -> slice:
        """The grains that move by themselves."""
        return slice(self.held, self.chain.movable)

    @property
    def size(self) -> int:
        """Number of grains that move by themselves, M."""
        return self.chain.movable - self.held

    def canonical(self, displacement: Array, velocity: Array) -> Array:
        """Return (..., 2, M) canonical variables of states (..., N)."""
        q = self.weight * displacement[..., self.free]
        p = self.weight / self.rate * velocity[..., self.free]
        return np.stack((q, p), -2)

    def physical(self, state: Array) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain, (N,) each, at t = 0.

        A driven grain has none.
        """
        u, v = np.zeros((2, self.chain.grains))
        u[self.free] = state[0] / self.weight
        v[self.free] = state[1] / self.weight * self.rate
        return u, v

    def run(
        self,
        state: Array,
        period: float,
        mesh: Array,
        deviation: Array | None = None,
        stretch: int = 0,
    ) -> Passage:
        """Advance a state (2, M) from t = 0 by steps that are fractions (K,) of a period.

        Parameters
        ----------
        deviation : (2, M, C) array, optional
            Deviations that are carried along.
        stretch : int
            Number of them, the last, that are derivatives by log(period).
        """
        grains = self.chain.grains
        begin = np.zeros((2, self.size, 0)) if deviation is None else deviation
        links, inverse_mass = self._kernel_arrays
        rows = np.zeros((2, inverse_mass.size))
        rows[:, PAD : PAD + grains] = self.physical(state)
        columns = np.zeros((2, grains, begin.shape[2]))
        scale = np.stack((self.weight, self.weight / self.rate))[..., None]
        columns[:, self.free] = begin / scale
        # columns that are derivatives by log(period) grow with every step
        longer = np.zeros(begin.shape[2])
        longer[longer.size - stretch :] = 1.0
        nodes = np.zeros((2, mesh.size + 1, grains))
        motion = Motion(rows[0], rows[1])
        deviations = Deviations(columns[0], columns[1], longer)
        steps = Steps(np.array(METHOD.kicks), np.array(METHOD.drifts), mesh * period)
        held = Held(PAD - 1 + self.held, self._path(mesh))
        march(links, inverse_mass, motion, deviations, steps, held, nodes)
        if self.held and self.drive is not None:
            turns = 2 * np.pi * self.cycles * np.concatenate(([0.0], np.cumsum(mesh)))
            rate = 2 * np.pi * self.cycles / period
            nodes[1, :, 0] = self.drive.amplitude * rate * np.cos(turns)
        return Passage(nodes[0], nodes[1], columns[:, self.free] * scale)

    def _path(self, mesh: Array) -> Array:
        """Return the position of the drive at every evaluation of the force, m."""
        if self.drive is None:
            return np.zeros(0)
        begin = np.cumsum(mesh) - mesh
        stages = begin[:, None] + mesh[:, None] * np.array([0.0, *METHOD.reach[:-1]])
        # whole turns are left out: a sine of few radians is the most accurate
        turns = self.cycles * np.append(stages.ravel(), mesh.sum())
        return self.drive.amplitude * np.sin(2 * np.pi * (turns - np.round(turns)))

    def direction(self, state: Array) -> Array:
        """Return the rate of change of a state (2, M) at t = 0, over `rate`."""
        u, _ = self.physical(state)
        force = self.chain.contacts.force_change(self.chain.contacts.closer(u))
        pull = (force[:-1] - force[1:])[self.free] / self.weight / self.rate**2
        return np.stack((state[1], pull))

    def energy(self, state: Array) -> tuple[float, Array]:
        """Return the energy above rest, J, and its gradient (2, M)."""
        q_rate, p_rate = self.direction(state)
        energy = float(self.chain.excess_energy(*self.physical(state)))
        return energy, self.rate**2 * np.stack((-p_rate, q_rate))
