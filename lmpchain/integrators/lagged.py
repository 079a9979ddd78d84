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
class LaggedVerlet:
    """Velocity Verlet of a chain that loses energy: its forces see velocities half a step old."""

    name: str = "lagged-verlet"
    order: int = 1
    evaluations: int = 1
    spread: float = 1.0
    # forces that are h / 2 late slow a motion down; while it lasts, its phase shifts by omega h / 4
    error_constant: float = 0.25
    reference: str = "LAMMPS, fix nve/sphere with velocity-dependent pair forces"
    adaptive: bool = False
    interpolates: bool = False

    @property
    def stability_limit(self) -> float:
        """Largest omega h of a lossless oscillator; `Chain.damping_reach` bounds it further."""
        return VERLET.stability_limit

    def growth(self, reach: float) -> float:
        """Return the growth of a lossless oscillator in a step at omega h = reach."""
        return VERLET.growth(reach)

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains by steps of these schedules."""
        from .kernels.lagged import make_work, march

        return March(march, make_work, (), history=1)
