"""Lengths of steps near contacts that open or close, by method and schedule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..util.arrays import EPSILON
from .kernels.layout import Shortening
from .steps import Steps

if TYPE_CHECKING:
    from .batch import ChainBatch


@dataclass(frozen=True)
class OpeningSteps:
    """Lengths of steps near an opening; analysis/calibration/adaptive_steps.py.

    Attributes
    ----------
    shortened : float
        h' / h at the time 1 / omega from the opening of the contact that matters most: small enough
        that these steps leave as little error as the others.
    coarse : float
        The same of coarse ones, where samples hold steps short and that does not matter.
    crossing : float
        omega h' / (omega h)^((order + 1) / (delta + 1)) of the step that crosses the opening, for
        delta = 1.5; for other exponents the step that leaves the same error.
    least_crossing : float
        omega h' over the (delta + 1)th root of EPSILON: what a shorter step would gain is
        round-off.
    """

    shortened: float = 0.2
    coarse: float = 0.4
    crossing: float = 0.03
    least_crossing: float = 0.1


OPENING_STEPS = OpeningSteps()


def shorten_steps(order: int, batch: ChainBatch, schedules: Sequence[Steps]) -> Shortening:
    """Return the lengths of steps near openings, of these schedules of one kind."""
    steps = OPENING_STEPS
    # a step across an opening is wrong by its length to the power delta + 1
    falls = 1 / (batch.opening_power + 1)
    shortened = steps.coarse if schedules[0].coarse_openings else steps.shortened
    power = (order + 1) * falls
    crossing = steps.crossing ** (2.5 * falls)
    least = steps.least_crossing * EPSILON**falls

    def nearness(reach: float, least: float) -> float:
        """Return that of the step that crosses an opening, omega h of others being `reach`."""
        crosses = max(crossing * reach**power, least)
        return (shortened * reach / crosses) ** (14 / 9)

    # of numbers of Python, whose powers have the same bits on every processor
    omegas = batch.arrays.omega.tolist()
    nearest = [[nearness(s.step * omega, least * s.ratio) for omega in omegas] for s in schedules]
    return Shortening(
        shortened=shortened,
        close=shortened ** (-14 / 3),
        nearest=np.array(nearest),
    )
