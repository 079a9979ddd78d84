"""The motion of a chain over a period by a symplectic splitting, and its tangent map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError, shown
from ..integrators.batch import ChainBatch
from ..integrators.kernels.layout import PAD, BatchArrays
from ..integrators.kernels.tangent import BodyRow, Deviations, Held, TangentSteps, march
from ..integrators.methods import KAHAN_LI8
from ..scene.excitation import Drive, Force, Profile
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.lazy import cached_property

METHOD = KAHAN_LI8


class Passage(NamedTuple):
    """Motion of a chain over K steps.

    Attributes
    ----------
    displacement, velocity : (K+1, N) arrays
        States between the steps, m and m/s.
    wall : (2, K+1) array
        Displacement and velocity of the top wall, m and m/s.
    end : (2, M) array
        Last state in canonical variables.
    deviation : (2, M, C) array
        Deviations at the end, in canonical variables.
    """

    displacement: Array
    velocity: Array
    wall: Array
    end: Array
    deviation: Array


@dataclass(frozen=True, eq=False)
class Flow:
    """Eq. (1) in canonical variables for the M free grains.

    The variables are ``q = sqrt(m) phi`` and ``p = sqrt(m) phi' / rate``, so that tangent maps are
    symplectic. A damped chain, or one with a force on a grain, requires `damped_flow.DampedFlow`.

    Parameters
    ----------
    chain : Chain
    rate : float
        Frequency of the order of the frequencies of the orbit, rad/s.
    drive : Drive or Force, optional
        Harmonic drive, whose frequency is replaced by `cycles` divided by the period.
    cycles : int
        Number of cycles of the drive in a period.

    Raises
    ------
    InputError
        If the chain flies apart, has a force from the ground, or is damped without a drive, or if
        the drive is not harmonic or does not suit the chain.
    """

    chain: Chain
    rate: float
    drive: Drive | Force | None = None
    cycles: int = 1

    def __post_init__(self) -> None:
        chain = self.chain
        drive = self.drive
        # The compiled loop has no force from the ground.
        chain.refuse_ground("an orbit or its tangent map")
        if drive is not None:
            check_sine(drive)
            if faults := list(drive.faults(chain, 1.0)):
                raise InputError([(f"drive.{key}", message) for key, message in faults])
        elif chain.damped:
            cure = "give a drive, or leave damping out, as chain.replace(damping=None) does"
            fault = "damping brings an orbit without a drive to rest"
            raise InputError.at("chain.damping", f"{fault}: {cure}")
        elif not chain.linearisable and self._flies_apart:
            message = "flies apart: use a top load, gravity, or walls at both ends"
            raise InputError.at("chain", message)

    @property
    def _flies_apart(self) -> bool:
        """Return whether grains that only touch are at an end without a wall."""
        chain = self.chain
        return chain.top == "free" or (chain.bottom == "free" and not chain.compressed)

    @cached_property
    def _kernel_arrays(self) -> tuple[BatchArrays, Array]:
        """Contacts, and inverse masses of all bodies, 1/kg, for the compiled loop."""
        rest = Profile(velocity=np.zeros(self.chain.grains))
        # The scales of a chain at rest divide by 0, but are not used.
        with np.errstate(all="ignore"):
            scene = Scene(chain=self.chain, excitation=rest, duration=1.0, samples=2)
            batch = ChainBatch([scene], "exact")
        inverse_mass = batch.arrays.inverse_mass[0]
        # A grain held by the drive does not react to forces.
        inverse_mass[PAD : PAD + self.held] = 0.0
        return batch.arrays, inverse_mass

    @cached_property
    def weight(self) -> Array:
        """Roots of the masses of the free grains, (M,)."""
        return np.sqrt(self.chain.masses[self.free])

    @property
    def held(self) -> int:
        """Number of grains held by the drive at the top: 1 or 0."""
        return int(isinstance(self.drive, Drive) and self.drive.grain == 1)

    @property
    def symplectic(self) -> bool:
        """Whether tangent maps are symplectic, because nothing dissipates energy."""
        return not self.chain.damped

    @property
    def free(self) -> slice:
        """Slice of the grains that move freely."""
        return slice(self.held, self.chain.movable)

    @property
    def size(self) -> int:
        """Number M of grains that move freely."""
        return self.chain.movable - self.held

    @property
    def units(self) -> Array:
        """Ratios of canonical variables to displacements and velocities, (2, M)."""
        return np.stack((self.weight, self.weight / self.rate))

    def canonical(self, displacement: Array, velocity: Array) -> Array:
        """Return (..., 2, M) canonical variables of states (..., N)."""
        return np.stack((displacement[..., self.free], velocity[..., self.free]), -2) * self.units

    def physical(self, state: Array) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain, (N,) each, at t = 0.

        Both are 0 for a driven grain.
        """
        return self._rows(state)

    def deviation(self, state: Array, change: Array) -> tuple[Array, Array]:
        """Return changes of displacement and velocity (N,) for a small change of a state (2, M)."""
        return self._rows(change)

    def _rows(self, state: Array) -> tuple[Array, Array]:
        """Return the two rows (N,) that the compiled loop advances."""
        u, v = np.zeros((2, self.chain.grains))
        u[self.free], v[self.free] = state / self.units
        return u, v

    def run(
        self,
        state: Array,
        period: float,
        mesh: Array,
        deviation: Array | None = None,
        stretch: int = 0,
    ) -> Passage:
        """Advance a state (2, M) from t = 0 by steps that are given as fractions (K,) of a period.

        Parameters
        ----------
        deviation : (2, M, C) array, optional
            Deviations that are advanced together with the state.
        stretch : int
            Number of deviations, counted from the last, that are derivatives by log(period).
        """
        grains = self.chain.grains
        begin = np.zeros((2, self.size, 0)) if deviation is None else deviation
        rows = np.zeros((2, self._kernel_arrays[1].size))
        rows[:, PAD : PAD + grains] = self._rows(state)
        columns = np.zeros((2, grains, begin.shape[2]))
        columns[:, self.free] = begin / self.units[..., None]
        # Columns of derivatives by log(period) grow with every step.
        longer = np.zeros(begin.shape[2])
        longer[longer.size - stretch :] = 1.0
        nodes = np.zeros((2, mesh.size + 1, grains))
        motion = BodyRow(rows[0], rows[1])
        self._march(motion, Deviations(columns[0], columns[1], longer), mesh, period, nodes)
        end = nodes[:, -1, self.free] * self.units
        wall = np.zeros((2, mesh.size + 1))
        if isinstance(self.drive, Drive):
            share = np.concatenate(([0.0], np.cumsum(mesh)))
            rate = 2 * np.pi * self.cycles / period
            driven = nodes[:, :, 0] if self.held else wall
            driven[0] = self._imposed(share)
            driven[1] = self.drive.amplitude * rate * np.cos(2 * np.pi * self.cycles * share)
        self._complete(nodes, wall)
        changed = columns[:, self.free] * self.units[..., None]
        return Passage(nodes[0], nodes[1], wall, end, changed)

    def _march(
        self, motion: BodyRow, deviations: Deviations, mesh: Array, period: float, nodes: Array
    ) -> None:
        """Advance a motion and its deviations, and fill nodes (2, K+1, N) between the steps."""
        arrays, inverse_mass = self._kernel_arrays
        steps = TangentSteps(np.array(METHOD.kicks), np.array(METHOD.drifts), mesh * period)
        path = np.zeros(0)
        if self.drive is not None:
            begin = np.cumsum(mesh) - mesh
            stages = begin[:, None] + mesh[:, None] * np.array([0.0, *METHOD.reach[:-1]])
            path = self._imposed(np.append(stages.ravel(), mesh.sum()))
        march(
            arrays, inverse_mass, motion, deviations, steps, Held(PAD - 1 + self.held, path), nodes
        )

    def _complete(self, nodes: Array, wall: Array) -> None:
        """Convert the rows of the compiled loop to displacements and velocities, (2, K+1, N)."""

    def _imposed(self, share: Array) -> Array:
        """Return the motion (m) or the force (N) of the drive at fractions of the period."""
        if self.drive is None:
            return np.zeros(0)
        # Whole cycles are subtracted, because the sine of a small phase is the most accurate.
        turns = self.cycles * share
        return np.asarray(self.drive.amplitude * np.sin(2 * np.pi * (turns - np.round(turns))))

    def direction(self, state: Array) -> Array:
        """Return the rate of change of a state (2, M) at t = 0, divided by `rate`."""
        u, _ = self.physical(state)
        force = self.chain.contacts.force_change(self.chain.contacts.closer(u))
        pull = (force[:-1] - force[1:])[self.free] / self.weight / self.rate**2
        return np.stack((state[1], pull))

    def energy(self, state: Array) -> tuple[float, Array]:
        """Return the energy above rest, J, and its gradient (2, M)."""
        q_rate, p_rate = self.direction(state)
        energy = float(self.chain.excess_energy(*self.physical(state)))
        return energy, self.rate**2 * np.stack((-p_rate, q_rate))


def check_sine(drive: Any) -> None:
    """Raise `InputError` unless a motion or force is a sine without end."""
    if not isinstance(drive, Drive | Force):
        raise InputError.at("drive", f"must be a Drive or a Force (got {shown(drive)})")
    if drive.from_below:
        message = 'must act on the top: orbits of a chain with end = "bottom" are not computed'
        raise InputError.at("drive", message)
    if drive.frequency is None or drive.cycles is not None:
        message = "must be a sine that never ends: give amplitude and frequency alone"
        raise InputError.at("drive", message)
