"""Velocity Verlet with forces that depend on velocities, as LAMMPS has it."""

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
class DampedVerlet:
    """Velocity Verlet whose forces see the velocity v + lead h a, predicted from the last step.

    The lead is 1/2 in `fix nve` of LAMMPS: the forces at the end of a step see the velocity of its
    middle, and the order is 1. With a lead of 1, as in `fix mvv/dpd 1.0`, the order is 2.
    """

    name: str
    order: int
    lead: float
    error_constant: float
    reference: str
    evaluations: int = 1
    spread: float = 1.0
    adaptive: bool = False
    interpolates: bool = False

    @property
    def stability_limit(self) -> float:
        """Largest omega h of a lossless oscillator.

        Damping lowers it: at the largest h, (omega h)^2 + 4 lead (A omega^2 + gamma) h = 4.
        """
        return VERLET.stability_limit

    def growth(self, reach: float) -> float:
        """Return the growth of a lossless oscillator in a step at omega h = reach."""
        return VERLET.growth(reach)

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains by steps of these schedules."""
        from .kernels.damped_verlet import make_work, march

        return March(march, make_work, (self.lead,), history=2)


MODIFIED = DampedVerlet(
    "modified-verlet",
    2,
    1.0,
    VERLET.error_constant,
    "Groot and Warren, J. Chem. Phys. 107, 4423 (1997), lambda = 1; LAMMPS, fix mvv/dpd 1.0",
)
LAGGED = DampedVerlet(
    "lagged-verlet",
    1,
    0.5,
    # Forces that are h / 2 late slow a motion down: its phase shifts by omega h / 4 while it lasts.
    0.25,
    "LAMMPS, fix nve with velocity-dependent pair forces",
)
