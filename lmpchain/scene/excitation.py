"""Excitations at t = 0: an impulse or a displacement of one grain; all excitations by name."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..chain.chain import Chain
from ..util.arrays import Array
from ..util.validation import Real
from .acting import Drive as Drive
from .acting import Force as Force
from .base import Excitation, Number, OneGrain
from .packet import Packet as Packet
from .profile import Profile as Profile
from .riemann import Riemann as Riemann


class Impulse(OneGrain):
    """A velocity given to one grain, m/s, positive downward.

    Examples
    --------
    >>> Impulse(velocity=8.57e-4).grain
    1
    """

    kind: ClassVar[str] = "impulse"
    strength: ClassVar[tuple[str, ...]] = ("velocity",)
    velocity: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return np.zeros(chain.grains), self.at_grain(chain, self.velocity)

    def strongest(self, chain: Chain) -> tuple[float, float]:
        """Return the largest displacement, 0 m, and speed of the struck grain, m/s."""
        return 0.0, abs(self.velocity)

    def energy(self, chain: Chain) -> float:
        """Return the kinetic energy of the struck grain, J."""
        return 0.5 * chain.masses.item(self.grain - 1) * self.velocity**2

    @property
    def strike_velocity(self) -> float:
        """Velocity of the struck grain, m/s."""
        return self.velocity

    @property
    def strikes_top(self) -> bool:
        """Whether grain 1 is struck."""
        return self.grain == 1

    @property
    def label(self) -> str:
        """Name and strength of the excitation in words."""
        size = abs(self.velocity)
        factor, unit = (
            (1.0, "m/s") if size >= 1 else (1e3, "mm/s") if size >= 1e-5 else (1e6, "µm/s")
        )
        return f"an {self.kind} of {self.velocity * factor:g} {unit}"


class Displacement(OneGrain):
    """One grain displaced from its equilibrium and released, m, positive downward."""

    kind: ClassVar[str] = "displacement"
    strength: ClassVar[tuple[str, ...]] = ("displacement",)
    displacement: Real
    grain: Number = 1

    def initial(self, chain: Chain) -> tuple[Array, Array]:
        """Return displacement and velocity of every grain at t = 0."""
        return self.at_grain(chain, self.displacement), np.zeros(chain.grains)


EXCITATIONS: dict[str, type[Excitation]] = {
    e.kind: e for e in (Impulse, Displacement, Profile, Packet, Riemann, Drive, Force)
}
