"""Confidence intervals of time averages, from the means of correlated batches.

The variance of the mean over a long time is s over that time, where s, the sum of the covariance
over all lags, is the spectrum at frequency 0. Cosines of the time with few half periods measure the
spectrum near 0: their amplitudes in the means of batches are independent normal numbers of variance
s, so that Student's t with as many degrees of freedom gives the interval: U. K. Mueller, Journal of
Econometrics 141, 1331 (2007); E. Lazarus, D. J. Lewis, J. H. Stock and M. W. Watson, Journal of
Business and Economic Statistics 36, 541 (2018). With a correlation time c they are too small by the
square of c over the period, whereas the spread of a few long batches is too small by c over a
batch. The correlation of neighbours shows c: D. S. Steiger and J. R. Wilson, Management Science 48,
1569 (2002).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from ..util.arrays import Array


@dataclass(frozen=True)
class Batching:
    """Numbers of batches and cosines (see analysis/calibration/batch_means.py).

    Attributes
    ----------
    stretches : int
        Number of batches of each copy.
    cosines : tuple of int
        Numbers of cosines that are tried, the constant one included. Fewer cosines give a wider
        interval.
    finer : int
        Stretches whose neighbours are compared, in half a period of the fastest cosine.
    resemblance : float
        Largest correlation of neighbouring stretches. Beyond it the cosines are too fast.
    """

    stretches: int = 256
    cosines: tuple[int, ...] = (16, 8, 4)
    finer: int = 8
    resemblance: float = 0.5


BATCHING = Batching()
LEVEL = 0.95  # Confidence level of the intervals.


class Estimate(NamedTuple):
    """An average over time with its confidence interval.

    Attributes
    ----------
    mean : float
    error : float
        Standard error of the mean; infinite if the correlation time is too long.
    half_width : float
        Half-width of the 95 % confidence interval.
    batches : int
        Number of independent amplitudes, the cosines of all copies; 0 without an interval.
    resemblance : float
        Correlation of neighbouring stretches, an eighth of half a period of the fastest cosine.
    """

    mean: float
    error: float
    half_width: float
    batches: int
    resemblance: float


def estimate(means: Array, known: Array | None = None) -> Estimate:
    """Return the average of the means of successive time intervals, with its confidence interval.

    Parameters
    ----------
    means : (R, S) array
        Means over S = `BATCHING.stretches` stretches of equal length in each of R copies.
    known : (R, S) array, optional
        A known disturbance, up to a factor, which is removed: the drift of the energy.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(3).normal(3.0, 1.0, (1, BATCHING.stretches))
    >>> average = estimate(noise)
    >>> average.batches, abs(average.mean - 3.0) < average.half_width
    (16, True)
    """
    from scipy.fft import dct
    from scipy.stats import t

    copies = len(means)
    mean = float(means.mean())
    lost = 1
    if known is not None and known.any():
        shift = known - known.mean()
        means = means - shift * ((shift * means).sum() / (shift**2).sum())
        lost = 2
    amplitudes = dct(means - means.mean(), norm="ortho")
    resemblance = math.nan
    for count in BATCHING.cosines:
        # Longer stretches reveal a weak correlation over a long time.
        resemblances = {
            finer: correlation_of_neighbours(means.reshape(copies, count * finer, -1).mean(-1))
            for finer in (BATCHING.finer, BATCHING.finer // 2)
        }
        resemblance = resemblances[BATCHING.finer]
        if resemblance > BATCHING.resemblance:
            continue
        independent = copies * count
        variance = float((amplitudes[:, :count] ** 2).sum()) / (independent - lost)
        error = math.sqrt(_widening(resemblances) * variance / means.size)
        student = float(t.ppf((1 + LEVEL) / 2, independent - lost))
        return Estimate(mean, error, student * error, independent, resemblance)
    return Estimate(mean, math.inf, math.inf, 0, resemblance)


def _widening(resemblances: dict[int, float]) -> float:
    """Return the factor by which the variance of the cosines is too small.

    The correlation time c of stretches of length b is 2 b times their correlation. With an
    exponential correlation, the spectrum at angular frequency w is s / (1 + (c w)^2), and cosines
    of at least f stretches in half a period average it up to pi / (b f).
    """
    slowest = max(0.0, *(each / finer for finer, each in resemblances.items()))
    return 1 + (2 * math.pi * slowest) ** 2 / 3


def correlation_of_neighbours(means: Array) -> float:
    """Return the correlation of neighbours in rows of means, (R, B); 0 if all are equal."""
    deviation = means - means.mean()
    square = float((deviation**2).mean())
    if not square:
        return 0.0
    # Subtracting the mean of the same numbers lowers the correlation by 1 / size.
    return float((deviation[:, 1:] * deviation[:, :-1]).mean()) / square + 1 / means.size
