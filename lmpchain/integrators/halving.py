"""Shorter steps until an answer is accurate enough, as answers with other steps show.

Richardson's formula: with steps h and q h a method of order p gives answers that differ by

    x(q h) - x(h) = (q^p - 1) C h^p + ...,    so    |x(h) - x| = |x(q h) - x(h)| / |q^p - 1|.

Here nothing is divided: where a contact opens the force is not smooth, and the order is lost. The
difference itself, times `SAFETY`, is the bound. L. F. Richardson, Phil. Trans. R. Soc. A 210, 307
(1911); E. Hairer, S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, section
II.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

Answer = TypeVar("Answer")

# factor on the difference to answers with other steps; analysis/calibration/halved_steps.py
SAFETY = 2.5


class HalvedAnswer(NamedTuple, Generic[Answer]):
    """An answer with steps of one length, and how accurate it is.

    Attributes
    ----------
    answer : any
    excess : float
        Its error, `SAFETY` times a difference, over the error that is allowed.
    """

    answer: Answer
    excess: float


def halve(solve: Callable[[int], HalvedAnswer[Answer]], most: int) -> HalvedAnswer[Answer]:
    """Return the most accurate answer as steps are halved until its error is allowed.

    It ends there, or after a number of answers, when round-off or chaos leaves a larger error.

    Parameters
    ----------
    solve : function
        Of how many times the first steps are halved, from 0.
    most : int
        Most answers.

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
        # round-off may make the last one worse than those before
        best = min(best, attempt, key=lambda attempt: attempt.excess)
    return best
