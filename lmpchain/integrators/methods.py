"""Registry of the methods of time integration, with DOP853, Gear and lagged velocity Verlet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..util.arrays import Array
from ..util.lazy import cached_property
from .splittings import SPLITTINGS, VERLET
from .steps import March, Method, Steps, first_growth, shorten_steps

if TYPE_CHECKING:
    from ..chain.chain import Chain
    from .batch import ChainBatch


@dataclass(frozen=True)
class DormandPrince:
    """DOP853 for x'' = a(x), with the coefficients of SciPy."""

    name: str = "dop853"
    order: int = 8
    evaluations: int = 12
    error_constant: float = 1e-9
    reference: str = (
        "Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.5"
    )
    damping: tuple[bool, ...] = (False, True)
    adaptive: bool = True
    interpolates: bool = False

    @cached_property
    def tables(self) -> tuple[Array, Array, Array, Array]:
        """Nodes, inner weights squared, weights, and inner weights; see `kernels.dop853`."""
        from scipy.integrate import DOP853

        # The product a @ a integrates twice, from accelerations to displacements.
        a = DOP853.A[:12, :12]
        b = DOP853.B
        return DOP853.C[:12], a @ a, np.array([b @ a, b]), np.array(a)

    @cached_property
    def spread(self) -> float:
        """Root of the sum of squared weights, some of which are large."""
        return float(np.linalg.norm(self.tables[2][1]))

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x stays bounded."""
        return first_growth(self.growth, 1e-12)

    def growth(self, reach: float) -> float:
        """Return the growth factor of x'' = -omega^2 x in a step; below 1 up to the limit."""
        from scipy.integrate import DOP853

        # The stability function at i omega h.
        a = DOP853.A[:12, :12]
        slopes = np.linalg.solve(np.eye(12) - 1j * reach * a, np.ones(12))
        return float(abs(1 + 1j * reach * DOP853.B @ slopes))

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains with these step schedules."""
        from .kernels.dop853 import make_work, march, march_by_step

        openings = shorten_steps(self.order, batch, schedules)
        method = self.tables, openings, schedules[0].adaptive
        return March(march, make_work, method, by_step=march_by_step)


@dataclass(frozen=True)
class LaggedVerlet:
    """Velocity Verlet for damped chains as in `fix nve` of LAMMPS.

    Forces depend on the predicted velocity v + lead h a, with v and a at the start of the step.
    With a lead of 1/2, the forces at the end of a step use the velocity of the middle of the step,
    and the order is 1. In damped chains, "verlet" has a lead of 1 and the order 2.
    """

    name: str = "lagged-verlet"
    order: int = 1
    # The delay of the forces by h / 2 slows the motion down: its phase shifts by omega h / 4.
    error_constant: float = 0.25
    reference: str = "LAMMPS, fix nve with velocity-dependent pair forces"
    evaluations: int = 1
    spread: float = 1.0
    damping: tuple[bool, ...] = (True,)
    adaptive: bool = False
    interpolates: bool = False

    @property
    def stability_limit(self) -> float:
        """Largest stable omega h of an undamped oscillator.

        Damping lowers the limit. The largest stable h then satisfies
        (omega h)^2 + 2 (A omega^2 + gamma) h = 4.
        """
        return VERLET.stability_limit

    def growth(self, reach: float) -> float:
        """Return the growth of an undamped oscillator in a step at omega h = reach."""
        return VERLET.growth(reach)

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains for these step schedules."""
        from .kernels.damped_verlet import make_work, march

        return March(march, make_work, (0.5,), history=2)


@dataclass(frozen=True)
class Gear:
    """Gear's predictor-corrector of order 4, the method of the paper: five values per grain."""

    name: str = "gear4"
    order: int = 4
    evaluations: int = 1
    spread: float = 1.0
    error_constant: float = 1e-3
    reference: str = (
        "Gear, Numerical Initial Value Problems in Ordinary Differential Equations (1971), "
        "chapter 9"
    )
    damping: tuple[bool, ...] = (False,)
    adaptive: bool = False
    interpolates: bool = False
    corrections: tuple[float, ...] = (19 / 120, 3 / 4, 1.0, 1 / 2, 1 / 12)

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which x'' = -omega^2 x grows by less than a hundredth in a step."""
        return first_growth(self.growth, 1e-2)

    def growth(self, reach: float) -> float:
        """Return the growth factor of x'' = -omega^2 x in a step, which is always above 1."""
        # Taylor series of x, h x', h^2 x'' / 2 ... have binomial coefficients.
        predict = np.array(
            [[1, 1, 1, 1, 1], [0, 1, 2, 3, 4], [0, 0, 1, 3, 6], [0, 0, 0, 1, 4], [0, 0, 0, 0, 1.0]]
        )
        off = -0.5 * reach**2 * predict[0] - predict[2]
        return float(np.abs(np.linalg.eigvals(predict + np.outer(self.corrections, off))).max())

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains for these step schedules."""
        from .kernels.gear import make_work, march

        return March(march, make_work, (np.array(self.corrections),), history=3)


LAGGED = LaggedVerlet()
_ALL: tuple[Method, ...] = (*SPLITTINGS.values(), DormandPrince(), Gear(), LAGGED)
BY_NAME = {method.name: method for method in _ALL}
_OF_CHAINS = {
    damped: {method.name: method for method in _ALL if damped in method.damping}
    for damped in (False, True)
}
METHODS = _OF_CHAINS[False]


def methods_of(chain: Chain) -> dict[str, Method]:
    """Return the methods for a chain, by name: with damping, or without."""
    return _OF_CHAINS[chain.damped]
