"""Step halving until the differences between results show sufficient accuracy.

Richardson's formula: with steps h and q h a method of order p gives answers that differ by

    x(q h) - x(h) = (q^p - 1) C h^p + ...,    so    |x(h) - x| = |x(q h) - x(h)| / |q^p - 1|.

This module does not divide the difference by |q^p - 1|, because the order is lower than p if a
contact opens. The error estimate is the difference times `SAFETY`.

Sources: L. F. Richardson, Phil. Trans. R. Soc. A 210, 307 (1911); E. Hairer, S. P. Norsett and
G. Wanner, Solving Ordinary Differential Equations I, section II.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

Answer = TypeVar("Answer")

# Safety factor on the difference between two results; see analysis/calibration/halved_steps.py.
SAFETY = 2.5


class HalvedAnswer(NamedTuple, Generic[Answer]):
    """A result with steps of one length, and its error.

    Attributes
    ----------
    answer : any
        Result of the computation with these steps.
    excess : float
        Ratio of the estimated error, which is `SAFETY` times a difference, to the allowed error.
    """

    answer: Answer
    excess: float


def halve(solve: Callable[[int], HalvedAnswer[Answer]], most: int) -> HalvedAnswer[Answer]:
    """Halve the steps until the error is allowed, and return the most accurate result.

    If rounding errors or chaos dominate, the error of the returned result may exceed the allowed
    error.

    Parameters
    ----------
    solve : function
        Function that returns the result for a number of halvings of the first step, from 0.
    most : int
        Largest number of calls of `solve`.

    Examples
    --------
    >>> halve(lambda halvings: HalvedAnswer(0.5**halvings, 100 * 0.25**halvings), 12)
    HalvedAnswer(answer=0.0625, excess=0.390625)
    """
    best = attempt = solve(0)
    for halvings in range(1, most):
        if attempt.excess <= 1:
            break
        attempt = solve(halvings)
        # Rounding may make the last result worse than an earlier one.
        best = min(best, attempt, key=lambda attempt: attempt.excess)
    return best
