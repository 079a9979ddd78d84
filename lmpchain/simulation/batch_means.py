"""Confidence intervals of time averages, from the means of correlated batches.

The variance of the mean over a long time T is s / T. Here s is the integral of the covariance over
all lags, which is the spectrum at frequency 0. Cosines of the time with few half periods measure
the spectrum near 0: their amplitudes in the means of batches are independent normal numbers of
variance s. Student's t distribution with as many degrees of freedom therefore gives the interval:
U. K. Mueller, Journal of Econometrics 141, 1331 (2007); E. Lazarus, D. J. Lewis, J. H. Stock and
M. W. Watson, Journal of Business and Economic Statistics 36, 541 (2018). If the correlation time is
c, this variance is too small by a fraction of about (c / period)^2, whereas the spread of a few
long batches is too small by about c / (length of a batch). The correlation of neighbouring batches
shows c: D. S. Steiger and J. R. Wilson, Management Science 48, 1569 (2002).
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
        Numbers of cosines that are tried, including the constant one. Fewer cosines give a wider
        interval.
    finer : int
        Number of stretches in half a period of the fastest cosine, of which neighbours are
        compared.
    resemblance : float
        Largest allowed correlation of neighbouring stretches. Above it the cosines are too fast.
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
        The average over all copies and stretches.
    error : float
        Standard error of the mean; infinite if the correlation time is too long.
    half_width : float
        Half-width of the 95 % confidence interval.
    batches : int
        Number of independent amplitudes, of all cosines and copies; 0 if there is no interval.
    resemblance : float
        Correlation of neighbouring stretches, each of which is an eighth of half a period of the
        fastest cosine.
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
        A disturbance of the means that is known up to a factor, such as the drift of the energy.
        Its best fit is subtracted.

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

    If stretches of length b have the correlation r, the correlation time is c = 2 b r. For an
    exponential correlation, the spectrum at angular frequency w is s / (1 + (c w)^2). Cosines with
    at least f stretches in half a period average the spectrum up to the frequency pi / (b f).
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
