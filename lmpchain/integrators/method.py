"""Interface of the methods of time integration, and their properties."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .steps import Steps

if TYPE_CHECKING:  # numba, which it imports, is not needed to know a method
    from .batch import ChainBatch


class March(NamedTuple):
    """The compiled march of a method for a batch of chains.

    Attributes
    ----------
    run : function
        See `kernels.sample_loop`.
    make_work : function
        Returns what a thread works in, of its chains and the method.
    method : tuple
        Coefficients, and what depends on schedules and chains, as `run` takes them.
    history : int
        Values a grain that it keeps of earlier steps.
    shared : bool
        Whether threads can share a chain.
    by_step : function, optional
        The same, noting the steps of a chain; see `kernels.dop853.march_by_step`.
    """

    run: Callable[..., int]
    make_work: Callable[..., tuple[Any, ...]]
    method: tuple[Any, ...]
    history: int = 0
    shared: bool = False
    by_step: Callable[..., int] | None = None


class Method(Protocol):
    """A method of time integration: its order, cost and stability, and its compiled march."""

    @property
    def name(self) -> str:
        """The name by which it is requested, and which answers state."""

    @property
    def order(self) -> int:
        """Order of convergence while no contact opens."""

    @property
    def evaluations(self) -> int:
        """Force evaluations a step."""

    @property
    def spread(self) -> float:
        """Amplification, per step, of independent errors of the force evaluations (1: none).

        analysis/calibration/roundoff.py.
        """

    @property
    def damping(self) -> tuple[bool, ...]:
        """Which chains it moves: False stands for those without damping, True for damped ones."""

    @property
    def error_constant(self) -> float:
        """Relative error at omega h = 1 for omega T = 60.

        analysis/calibration/error_constants.py.
        """

    @property
    def reference(self) -> str:
        """Where it comes from."""

    @property
    def adaptive(self) -> bool:
        """Whether its steps can be shorter where a contact is about to open or has just closed."""

    @property
    def interpolates(self) -> bool:
        """Whether samples between its steps can be interpolated."""

    @property
    def stability_limit(self) -> float:
        """Largest omega h for which a harmonic oscillator stays bounded, or hardly grows."""

    def growth(self, reach: float) -> float:
        """Return the factor by which an oscillator grows a step, or shrinks, at omega h = reach."""

    def march(self, batch: ChainBatch, schedules: Sequence[Steps]) -> March:
        """Return the compiled march of a batch of chains by these schedules, of one kind."""


def first_growth(growth: Callable[[float], float], more: float) -> float:
    """Return the first omega h, by thousandths, at which an oscillator grows by `more` a step."""
    grid = np.arange(1, 10000) / 1000
    return float(next(y for y in grid if growth(y) > 1 + more))
