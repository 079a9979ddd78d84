"""Protocol of the methods of time integration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .steps import Steps

if TYPE_CHECKING:  # Numba is not imported at run time.
    from .batch import ChainBatch


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
