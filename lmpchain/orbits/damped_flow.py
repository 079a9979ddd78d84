"""The motion of a damped, driven chain over a period by a Runge-Kutta method of order 8."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..chain.chain import Chain
from ..integrators.kernels.damped_tangent import Body, ImposedStages, RungeKutta, march
from ..integrators.kernels.layout import PAD
from ..integrators.kernels.tangent import BodyRow, Deviations
from ..integrators.methods import DormandPrince
from ..scene.excitation import Drive, Force
from ..util.arrays import Array
from .flow import Flow

NODES, _, (_, WEIGHTS), INNER = DormandPrince().tables
METHOD = RungeKutta(np.ascontiguousarray(INNER), np.ascontiguousarray(WEIGHTS))


@dataclass(frozen=True, eq=False)
class DampedFlow(Flow):
    """Eq. (1) with damping or with a force on a grain, in reduced velocities.

    The variables are ``q = sqrt(m) phi`` and ``p = sqrt(m) w / rate``, with the reduced velocity w
    of `chain.damping`. Without damping, w is the velocity itself.
    """

    def canonical(self, displacement: Array, velocity: Array) -> Array:
        """Return (..., 2, M) canonical variables of states (..., N) at t = 0."""
        return super().canonical(displacement, velocity - self._creep(displacement))

    def physical(self, state: Array) -> tuple[Array, Array]:
        """Return the displacement and velocity of every grain, (N,) each, at t = 0."""
        u, w = self._rows(state)
        return u, w + self._creep(u) * self._moves

    def deviation(self, state: Array, change: Array) -> tuple[Array, Array]:
        """Return changes of displacement and velocity (N,) for a small change of a state (2, M)."""
        du, dw = self._rows(change)
        chain = self.chain
        contacts = chain.contacts
        overlap = contacts.overlap + contacts.closer(self._rows(state)[0])
        pressed = contacts.stiffness_at(np.maximum(overlap, 0.0)) * contacts.closer(du)
        return du, dw + self._rate(pressed, du) * self._moves

    @property
    def _moves(self) -> Array:
        """1 for a grain that moves freely, 0 for others, (N,)."""
        number = np.arange(self.chain.grains)
        return ((number >= self.free.start) & (number < self.free.stop)).astype(float)

    def _creep(self, displacement: Array, wall: Array | None = None) -> Array:
        """Return the difference between velocities and reduced velocities (..., N), m/s."""
        contacts = self.chain.contacts
        force = contacts.force_change(contacts.closer(displacement, wall))
        return self._rate(force, displacement)

    def _rate(self, force: Array, displacement: Array) -> Array:
        """Return b - gamma x (..., N), m/s, for contact forces (..., N+1) and displacements."""
        chain = self.chain
        viscous = chain.contact_viscosity * force
        creep = (viscous[..., :-1] - viscous[..., 1:]) / chain.masses
        return np.asarray(creep - chain.drag * displacement)

    def _march(
        self, motion: BodyRow, deviations: Deviations, mesh: Array, period: float, nodes: Array
    ) -> None:
        arrays, inverse_mass = self._kernel_arrays
        chain = self.chain
        body = Body(inverse_mass, chain.contact_viscosity, chain.drag)
        begin = np.cumsum(mesh) - mesh
        values = self._imposed(begin[:, None] + mesh[:, None] * NODES)
        pushes = isinstance(self.drive, Force)
        place = PAD - 1 + (self.drive.grain if isinstance(self.drive, Drive | Force) else 0)
        course = ImposedStages(place, pushes, values)
        march(arrays, body, motion, deviations, METHOD, mesh * period, course, nodes)

    def _complete(self, nodes: Array, wall: Array) -> None:
        free = self.free
        creep = self._creep(nodes[0], wall[0])
        nodes[1, :, free] += creep[:, free]


def flow_of(chain: Chain, rate: float, drive: Drive | Force | None, cycles: int = 1) -> Flow:
    """Return the flow of a chain: symplectic unless the chain is damped or a force acts."""
    kind = DampedFlow if drive is not None and (chain.damped or isinstance(drive, Force)) else Flow
    return kind(chain, rate, drive, cycles)
