"""Intervals of time averages from the means of batches, whose neighbours resemble each other.

A time is cut into batches so long that their means are as good as independent; Student's t with
their spread then gives the interval of the average. The mean of a batch of length b varies by

    b Var = s (1 - c / b + ...)      s = sum over all lags of the covariance,

so that batches which are too short, not longer than the time c over which a motion remembers, give
intervals which are too narrow. The correlation of neighbours among shorter batches shows c: D. S.
Steiger and J. R. Wilson, Management Science 48, 1569 (2002); G. S. Fishman, Discrete-Event
Simulation (2001), chapter 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from ..util.arrays import Array


@dataclass(frozen=True)
class Batching:
    """How batches are chosen; analysis/calibration/batch_means.py.

    Attributes
    ----------
    counts : tuple of int
        Batches of a copy that are tried, many first: few are longer, and cost width.
    finer : int
        Stretches of a batch, whose neighbours are compared.
    resemblance : float
        Largest correlation of neighbouring stretches: beyond it batches of them are too short.
    """

    counts: tuple[int, ...] = (32, 16, 8)
    finer: int = 8
    resemblance: float = 0.27

    @property
    def stretches(self) -> int:
        """Stretches of the time of a copy, which are averaged one by one."""
        return self.counts[0] * self.finer


BATCHING = Batching()
LEVEL = 0.95  # of the intervals


class Estimate(NamedTuple):
    """An average over time and how well it is known.

    Attributes
    ----------
    mean : float
    error : float
        Its standard error; infinite if the batches resemble each other however long they are.
    half_width : float
        Of its interval of 95 % confidence.
    batches : int
        Whose means make the interval; 0 if none do.
    resemblance : float
        Correlation of neighbouring stretches, an eighth of a batch each.
    """

    mean: float
    error: float
    half_width: float
    batches: int
    resemblance: float


def estimate(means: Array, known: Array | None = None) -> Estimate:
    """Return the average of the means of stretches of some time, with its interval.

    Parameters
    ----------
    means : (R, S) array
        Of S = `BATCHING.stretches` of equal length, one after the other, in each of R copies.
    known : (R, S) array, optional
        What shifts them by some factor, and is not to count: an error of the energy, which walks.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(3).normal(3.0, 1.0, (1, BATCHING.stretches))
    >>> average = estimate(noise)
    >>> average.batches, abs(average.mean - 3.0) < average.half_width
    (32, True)
    """
    from scipy.stats import t

    copies = len(means)
    mean = float(means.mean())
    lost = 1
    if known is not None and known.any():
        shift = known - known.mean()
        means = means - shift * ((shift * means).sum() / (shift**2).sum())
        lost = 2
    resemblance = math.nan
    for count in BATCHING.counts:
        # of ever longer stretches: those that remember a little for long show it late
        resemblances = {
            finer: correlation_of_neighbours(means.reshape(copies, count * finer, -1).mean(-1))
            for finer in (BATCHING.finer, BATCHING.finer // 2, BATCHING.finer // 4)
        }
        resemblance = resemblances[BATCHING.finer]
        if resemblance > BATCHING.resemblance:
            continue
        batches = means.reshape(copies, count, -1).mean(-1)
        error = math.sqrt(_widening(resemblances) * batches.var(ddof=lost) / batches.size)
        # correlations of so many stretches are off by chance: without that, too narrow
        doubted = {
            finer: each + 1 / math.sqrt(copies * count * finer)
            for finer, each in resemblances.items()
        }
        wider = math.sqrt(_widening(doubted) / _widening(resemblances))
        student = float(t.ppf((1 + LEVEL) / 2, batches.size - lost))
        return Estimate(mean, error, wider * student * error, batches.size, resemblance)
    return Estimate(mean, math.inf, math.inf, 0, resemblance)


def _widening(resemblances: dict[int, float]) -> float:
    """Return by what factor the variance of batches is too small, from correlations of stretches.

    It is 1 + c / b, where stretches of this correlation are about c / (2 resemblance) long.
    """
    return 1 + max(0.0, *(2 * each / finer for finer, each in resemblances.items()))


def correlation_of_neighbours(means: Array) -> float:
    """Return the correlation of neighbours in rows of means, (R, B); 0 if all are equal."""
    deviation = means - means.mean()
    square = float((deviation**2).mean())
    if not square:
        return 0.0
    # the mean of the same numbers is taken off, which makes it too small by 1 / size
    return float((deviation[:, 1:] * deviation[:, :-1]).mean()) / square + 1 / means.size
