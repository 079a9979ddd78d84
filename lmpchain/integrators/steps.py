"""Protocol of the methods of time integration, and the steps of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ..util.arrays import EPSILON, Array
from .kernels.layout import Shortening

if TYPE_CHECKING:
    from .batch import ChainBatch

# Auxiliary runs with at least this number of steps between two samples land on every sample. A
# landing then changes their steps little, and a collision may be visible in a single sample; see
# analysis/calibration/richardson_estimate.py.
MANY_STEPS = 32


class Steps(NamedTuple):
    """The steps of a run from one recorded sample on which a step ends to the next.

    A landing is a sample on which a step ends.

    Attributes
    ----------
    per_landing : int
        Number of steps from one landing to the next, if all steps are equal.
    stride : int
        Number of samples from one landing to the next.
    step : float
        Largest step size, s.
    adaptive : bool
        Whether steps are shorter when a contact is about to open or has just closed.
    ratio : float
        Ratio of the step to the step of the main run.
    coarse_openings : bool
        Whether steps near openings are so long that the method has a lower order there.
    dense : int
        Every `dense`-th sample between two landings is interpolated; 0 if none is.
    """

    per_landing: int
    stride: int
    step: float
    adaptive: bool = False
    ratio: float = 1.0
    coarse_openings: bool = False
    dense: int = 0

    @classmethod
    def spread(
        cls,
        interval: float,
        per_landing: int,
        stride: int = 1,
        adaptive: bool = False,
        coarse_openings: bool = False,
    ) -> Steps:
        """Return `per_landing` steps per landing interval; samples are `interval` s apart."""
        step = interval * stride / per_landing
        dense = int(stride > 1)
        return cls(per_landing, stride, step, adaptive, 1.0, coarse_openings, dense)

    @property
    def sampled(self) -> Steps:
        """Steps of about the same length that land on every sample."""
        steps = math.ceil(self.per_landing / self.stride)
        ratio = self.per_landing / (self.stride * steps)
        return self._replace(per_landing=steps, stride=1, step=self.step * ratio, dense=0)

    def shorten(self, per_landing: int) -> Steps:
        """Return steps with this number per landing interval, not coarse near openings."""
        step = self.step * (self.per_landing / per_landing)
        return self._replace(per_landing=per_landing, step=step, coarse_openings=False)

    def longer(self, ratio: float) -> Steps:
        """Return the steps of an auxiliary run, longer by this ratio.

        If the main run interpolates samples, the auxiliary run interpolates only every 4th or every
        2nd sample if its steps are long, because these samples are only compared. Otherwise it
        lands on every sample if the main run has `MANY_STEPS` steps a sample. With fewer steps, the
        distance of its landings is a multiple of a sample that its longer steps divide.
        """
        steps = math.ceil(self.per_landing / ratio)
        longer = self._replace(
            per_landing=steps, step=self.step * self.per_landing / steps, ratio=ratio
        )
        if self.stride > 1:
            # Each step must pass at least one interpolated sample.
            samples = ratio * self.stride / self.per_landing
            return longer._replace(dense=next(n for n in (4, 2, 1) if n == 1 or samples >= n))
        if self.per_landing >= MANY_STEPS:
            return longer
        # In lowest terms, landings are as close as integer numbers of longer steps allow.
        numerator, denominator = ratio.as_integer_ratio()
        common = math.gcd(denominator * self.per_landing, numerator)
        return longer._replace(
            per_landing=denominator * self.per_landing // common,
            stride=numerator // common,
            step=self.step * ratio,
        )

    @property
    def halved(self) -> Steps:
        """The steps of an auxiliary run at half the step."""
        return self._replace(
            per_landing=2 * self.per_landing, step=self.step / 2, ratio=self.ratio / 2
        )

    @property
    def filled(self) -> int:
        """Number of samples from one available sample to the next, by landing or interpolation."""
        return self.dense or self.stride

    def total(self, samples: int) -> int:
        """Return the number of steps from sample 0 to this sample if all steps are equal."""
        # Rounding up in integers ensures that a run is never a step short.
        return -(-self.per_landing * samples // self.stride)

    def longest_between(self, begin: Array, end: Array) -> Array:
        """Return the longest step between two kinks, (C,) s, at which steps end as at landings.

        `begin` and `end` are the times of the two kinks, (C,) s. The steps between a kink and a
        landing are equal, and as few as the largest step size allows.
        """
        landing = self.per_landing * self.step
        first = np.minimum(np.ceil(begin / landing) * landing, end)
        last = np.maximum(np.floor(end / landing) * landing, first)
        lengths = np.array([first - begin, last - first, end - last])
        return (lengths / np.maximum(np.ceil(lengths / self.step - 1e-9), 1)).max(0)


# Row of the compiled loops: the fields of `Steps`, the time between two samples in s and the number
# of the last sample. The loops fill in the current landing: its start and end, s, its length, s,
# and its steps and their length, s, if all are equal.
CLOCK = np.dtype(
    [
        *((name, {int: "i8", float: "f8", bool: "?"}[kind])
          for name, kind in get_type_hints(Steps).items()),
        ("interval", "f8"), ("final", "i8"),
        ("begin", "f8"), ("end", "f8"), ("length", "f8"), ("steps", "i8"), ("equal_step", "f8"),
    ],
    align=True,
)  # fmt: skip


def clocks(schedules: Sequence[Steps], interval: float, final: int) -> NDArray[Any]:
    """Return rows of the compiled loops for each of these steps, (F,) of CLOCK."""
    landing = (0.0, 0.0, 0.0, 0, 0.0)
    return np.array([(*steps, interval, final, *landing) for steps in schedules], CLOCK)


@dataclass(frozen=True)
class OpeningSteps:
    """Lengths of steps near an opening (see analysis/calibration/adaptive_steps.py).

    The longest step is h, and a shortened step is h'.

    Attributes
    ----------
    shortened : float
        Ratio h' / h at the time 1 / omega from the opening of the most important contact. It is so
        small that the shorter steps have no larger errors than the other steps.
    coarse : float
        Ratio h' / h at the same time if steps near openings are coarse.
    crossing : float
        Value of omega h' / (omega h)^((order + 1) / (delta + 1)) for the step h' that crosses an
        opening, at delta = 1.5. For other exponents delta, the step has the same error.
    least_crossing : float
        Smallest phase step omega h' across an opening, over the (delta + 1)th root of EPSILON. The
        error of a shorter step is below rounding.
    """

    shortened: float = 0.2
    coarse: float = 0.4
    crossing: float = 0.03
    least_crossing: float = 0.1


OPENING_STEPS = OpeningSteps()


def shorten_steps(order: int, batch: ChainBatch, schedules: Sequence[Steps]) -> Shortening:
    """Return the lengths of steps near openings for schedules of one type."""
    steps = OPENING_STEPS
    # The error of a step across an opening is proportional to its length to the power delta + 1.
    falls = 1 / (batch.opening_power + 1)
    shortened = steps.coarse if schedules[0].coarse_openings else steps.shortened
    power = (order + 1) * falls
    crossing = steps.crossing ** (2.5 * falls)
    least = steps.least_crossing * EPSILON**falls

    def nearness(reach: float, least: float) -> float:
        """Return the nearness at which a step crosses an opening; other steps have this reach."""
        crosses = max(crossing * reach**power, least)
        return (shortened * reach / crosses) ** (14 / 9)

    # Powers of Python numbers have the same bits on every processor.
    omegas = batch.arrays.omega.tolist()
    nearest = [[nearness(s.step * omega, least * s.ratio) for omega in omegas] for s in schedules]
    return Shortening(
        shortened=shortened,
        close=shortened ** (-14 / 3),
        nearest=np.array(nearest),
    )


class March(NamedTuple):
    """The compiled march of a method for a batch of chains.

    Attributes
    ----------
    run : function
        Compiled loop, see `kernels.sample_loop`.
    make_work : function
        Function that allocates the scratch arrays of one thread for its chains and the method.
    method : tuple
        Coefficients of the method, and arrays that depend on steps and chains; an argument of
        `run`.
    history : int
        Number of stored values of each grain from earlier steps.
    shared : bool
        Whether several threads can divide one chain among them.
    by_step : function, optional
        Compiled loop that records the steps of a chain; see `kernels.dop853.march_by_step`.
    """

    run: Callable[..., int]
    make_work: Callable[..., tuple[Any, ...]]
    method: tuple[Any, ...]
    history: int = 0
    shared: bool = False
    by_step: Callable[..., int] | None = None


class Method(Protocol):
    """A method of time integration: order, cost and stability, and its compiled march."""

    @property
    def name(self) -> str:
        """Name of the method in options and in results."""

    @property
    def order(self) -> int:
        """Order of convergence while no contact opens."""

    @property
    def evaluations(self) -> int:
        """Number of force evaluations in a step."""

    @property
    def spread(self) -> float:
        """Amplification of independent errors of the force evaluations in a step (1: none).

        The value is measured by analysis/calibration/roundoff.py.
        """

    @property
    def damping(self) -> tuple[bool, ...]:
        """Whether the method solves damped chains (True) or chains without damping (False)."""

    @property
    def error_constant(self) -> float:
        """Relative error at omega h = 1 for omega T = 60.

        The value is measured by analysis/calibration/error_constants.py.
        """

    @property
    def reference(self) -> str:
        """Source of the method."""

    @property
    def adaptive(self) -> bool:
        """Whether its steps can be shorter near the opening or closing of a contact."""

    @property
    def interpolates(self) -> bool:
        """Whether samples between its steps can be interpolated."""

    @property
    def stability_limit(self) -> float:
        """Largest omega h for which a harmonic oscillator stays bounded, or hardly grows."""

    def growth(self, reach: float) -> float:
        """Return the growth factor of an oscillator in a step at omega h = reach."""

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains for this type of steps."""


def first_growth(growth: Callable[[float], float], more: float) -> float:
    """Return the smallest omega h, in steps of 0.001, with a growth above 1 + `more` per step."""
    grid = np.arange(1, 10000) / 1000
    return float(next(y for y in grid if growth(y) > 1 + more))
