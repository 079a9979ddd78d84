"""Methods of time integration by name: kick-drift splittings, DOP853, Gear, lagged velocity Verlet.

One step of a splitting of length h is: kick b_1 h, drift a_1 h, kick b_2 h, ... drift a_S h, kick
b_(S+1) h. A kick of length t adds the acceleration times t to the velocities, and a drift adds the
velocity times t to the displacements. All splittings are explicit and symplectic, and
time-reversible because they are symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..util.arrays import Array
from ..util.lazy import cached_property
from .kernels.layout import SplittingStages
from .steps import March, Method, Steps, first_growth, shorten_steps

if TYPE_CHECKING:
    from ..chain.chain import Chain
    from .batch import ChainBatch


@dataclass(frozen=True)
class Splitting:
    """A symmetric kick-drift splitting.

    Attributes
    ----------
    name : str
        Name of the method in options and in results.
    order : int
        Order of convergence while no contact opens.
    kicks : tuple of float
        Lengths b_1 ... b_(S+1) of the kicks, as fractions of the step.
    drifts : tuple of float
        Lengths a_1 ... a_S of the drifts, as fractions of the step.
    error_constant : float
        Relative error at ``omega h = 1`` in the paper's scene, where ``omega T`` is 60 (measured by
        analysis/calibration/error_constants.py).
    reference : str
        Source of the coefficients.
    substeps : tuple of float
        Lengths of the velocity Verlet steps of a composition, as fractions of the step; empty for
        other splittings.
    damping : tuple of bool
        Whether the method solves damped chains (True) or chains without damping (False). Velocity
        Verlet solves damped chains with a lead of 1, see `methods.LaggedVerlet`; this is the method
        of Groot and Warren, J. Chem. Phys. 107, 4423 (1997), with lambda = 1, and of
        `fix mvv/dpd 1.0` in LAMMPS.
    """

    name: str
    order: int
    kicks: tuple[float, ...]
    drifts: tuple[float, ...]
    error_constant: float
    reference: str
    substeps: tuple[float, ...] = ()
    damping: tuple[bool, ...] = (False,)
    spread: ClassVar[float] = 1.0

    @cached_property
    def evaluations(self) -> int:
        """Number of force evaluations per step; the last kick shares one with the next step."""
        return len(self.drifts)

    @cached_property
    def _stages(self) -> SplittingStages:
        return SplittingStages(np.array(self.kicks), np.array(self.drifts), np.cumsum(self.drifts))

    @cached_property
    def reach(self) -> tuple[float, ...]:
        """Ends of the drifts, as fractions of the step."""
        return (*np.cumsum(self.drifts[:-1]).tolist(), 1.0)

    @cached_property
    def stability_limit(self) -> float:
        """Largest omega h for which a harmonic oscillator stays bounded."""
        grid = np.linspace(0, 8, 80001)[1:]
        stable = np.abs(self._half_trace(grid)) <= 1 + 1e-12
        return float(grid[np.argmin(stable) - 1]) if not stable.all() else float(grid[-1])

    @cached_property
    def adaptive(self) -> bool:
        """Whether steps can be shortened near openings; methods of order 2 do not need it."""
        return self.order > 2

    @property
    def interpolates(self) -> bool:
        """Whether samples between steps can be interpolated."""
        return self.adaptive

    def growth(self, reach: float) -> float:
        """Return the growth of x'' = -omega^2 x in a step at omega h = reach: 1 if stable."""
        half = abs(float(self._half_trace(np.array(reach))))
        return half + float(np.sqrt(half**2 - 1)) if half > 1 else 1.0

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains for these step schedules."""
        from .kernels import adaptive_splitting, damped_verlet, splitting

        if batch.scenes[0].chain.damped:
            return March(damped_verlet.march, damped_verlet.make_work, (1.0,), history=2)
        schedule = schedules[0]
        # Only the adaptive march interpolates samples between steps.
        if not (schedule.adaptive or schedule.dense > 0):
            return March(splitting.march, splitting.make_work, self._stages, shared=True)
        assert not (schedule.dense and batch.arrays.acts), "see kernels.dense_output"
        openings = shorten_steps(self.order, batch, schedules)
        # `kernels.dense_output` keeps u, v, a and j of the beginning of a step.
        history = 4 if schedule.dense else 0
        method = self._stages, openings
        march = adaptive_splitting.march
        return March(march, adaptive_splitting.make_work, method, history, shared=True)

    def _half_trace(self, frequency: Array) -> Array:
        """Half the trace of the one-step matrix of x'' = -omega^2 x at h = 1."""
        square = frequency**2
        # Motions from the initial states (1, 0) and (0, 1). If |half the trace| > 1, one of them
        # grows.
        x = np.array([np.ones_like(square), np.zeros_like(square)])
        v = np.array([np.zeros_like(square), np.ones_like(square)])
        for b, a in zip(self.kicks, (*self.drifts, 0.0), strict=True):
            v = v - b * square * x
            x = x + a * v
        return (x[0] + v[1]) / 2


def _symmetric(half: list[float], count: int) -> tuple[float, ...]:
    """Return `count` symmetric coefficients of sum 1 from the first half without its last one."""
    if count % 2:
        middle = 1 - 2 * sum(half)
        return (*half, middle, *reversed(half))
    half = [*half, 0.5 - sum(half)]
    return (*half, *reversed(half))


def _composition(substeps: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return kicks and drifts of successive velocity Verlet steps of these lengths."""
    padded = (0.0, *substeps, 0.0)
    # Each kick joins half a kick of the step that ends and half a kick of the step that begins.
    kicks = tuple((ending + beginning) / 2 for ending, beginning in pairwise(padded))
    return kicks, substeps


VERLET = Splitting(
    "verlet",
    2,
    (0.5, 0.5),
    (1.0,),
    0.3,
    "velocity Verlet; Swope et al., J. Chem. Phys. 76, 637 (1982)",
    damping=(False, True),
)

_KL6 = _symmetric(
    [
        0.39216144400731413928,
        0.33259913678935943860,
        -0.70624617255763935981,
        0.08221359629355080023,
    ],
    9,
)
KAHAN_LI6 = Splitting(
    "kahan-li6",
    6,
    *_composition(_KL6),
    5e-6,
    "s9odr6a of Kahan and Li, Math. Comp. 66, 1089 (1997)",
    _KL6,
)

RKN6 = Splitting(
    "rkn6",
    6,
    _symmetric(
        [
            0.0414649985182624,
            0.198128671918067,
            -0.0400061921041533,
            0.0752539843015807,
            -0.0115113874206879,
        ],
        12,
    ),
    _symmetric(
        [
            0.123229775946271,
            0.290553797799558,
            -0.127049212625417,
            -0.246331761062075,
            0.357208872795928,
        ],
        11,
    ),
    2e-8,
    "SRKN_11^b of Blanes and Moan, J. Comput. Appl. Math. 142, 313 (2002)",
)

RKN4 = Splitting(
    "rkn4",
    4,
    _symmetric([0.0829844064174052, 0.396309801498368, -0.0390563049223486], 7),
    _symmetric([0.245298957184271, 0.604872665711080], 6),
    2e-6,
    "SRKN_6^b of Blanes and Moan, J. Comput. Appl. Math. 142, 313 (2002)",
)

_KL8 = _symmetric(
    [
        0.13020248308889008087881763, 0.56116298177510838456196441, -0.38947496264484728640807860,
        0.15884190655515560089621075, -0.39590389413323757733623154, 0.18453964097831570709183254,
        0.25837438768632204729397911, 0.29501172360931029887096624,
    ], 17,
)  # fmt: skip
KAHAN_LI8 = Splitting(
    "kahan-li8",
    8,
    *_composition(_KL8),
    1e-8,
    "s17odr8a of Kahan and Li, Math. Comp. 66, 1089 (1997)",
    _KL8,
)

SPLITTINGS = {s.name: s for s in (VERLET, RKN4, RKN6, KAHAN_LI6, KAHAN_LI8)}


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
