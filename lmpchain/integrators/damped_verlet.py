"""Velocity Verlet with forces of damping that see velocities half a step late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .method import March
from .splittings import VERLET
from .steps import Steps

if TYPE_CHECKING:
    from .batch import ChainBatch


@dataclass(frozen=True)
class LaggedVerlet:
    """Velocity Verlet of damped chains as `fix nve` of LAMMPS has it.

    Forces see the velocity v + lead h a, predicted from the last step. With a lead of 1/2 the
    forces at the end of a step see the velocity of its middle, and the order is 1. "verlet" has a
    lead of 1 in damped chains, and the order 2.
    """

    name: str = "lagged-verlet"
    order: int = 1
    # Forces that are h / 2 late slow a motion down: its phase shifts by omega h / 4 while it lasts.
    error_constant: float = 0.25
    reference: str = "LAMMPS, fix nve with velocity-dependent pair forces"
    evaluations: int = 1
    spread: float = 1.0
    damping: tuple[bool, ...] = (True,)
    adaptive: bool = False
    interpolates: bool = False

    @property
    def stability_limit(self) -> float:
        """Largest omega h of a lossless oscillator.

        Damping lowers it: at the largest h, (omega h)^2 + 2 (A omega^2 + gamma) h = 4.
        """
        return VERLET.stability_limit

    def growth(self, reach: float) -> float:
        """Return the growth of a lossless oscillator in a step at omega h = reach."""
        return VERLET.growth(reach)

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains by steps of these schedules."""
        from .kernels.damped_verlet import make_work, march

        return March(march, make_work, (0.5,), history=2)


LAGGED = LaggedVerlet()
