"""The error of an answer from how it differs from runs at longer steps, by the order of the method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

SAFETY = 2.0  # factor on the Richardson estimate; analysis/calibration/richardson_estimate.py
SMALL = 0.01  # difference up to which the order is trusted of two runs alone: phases that are far off lose it


def extrapolate(
    order: int,
    smooth: bool,
    coarse: float | None,
    fine: float,
    ratios: Sequence[float] = (2.0, 4.0),
    settled: bool = False,
    confirmed: bool = False,
) -> float:
    """Return the Richardson estimate of the error at step h from runs at 4h, 2h and h, or from 2h and h.

    `fine` is how far the last two are apart, `coarse` how far the first two are, if there are three. `ratios` are those
    of the steps, where they are not 2 and 4. Where the force is `settled` as a smooth function of time, two runs alone
    show the error, for longer steps are further off than by the order, up to those that are unstable. The coarse
    difference alone bounds the error, too, unless that is `confirmed` by one more run.

    Where contacts open or nearly so, a high order falls to about 2.5, unless steps are adaptive, with a coefficient
    that depends on where in a step the opening falls: the error at h can then be as large as the difference.
    On random chains the estimate is between 1 and 5 times the true error while
    the order holds and rarely below it elsewhere.
    """
    if coarse is None or fine == math.inf:
        return SAFETY * fine / (ratios[0] ** order - 1) if settled and fine <= SMALL else fine
    if not smooth:
        return 1.5 * max(fine, coarse / 4)
    least, most, power, spread = _law(order, *ratios)
    gain = (
        min(max(coarse / max(fine, 1e-300), least), most) ** power
    )  # error at the longer step over that at h
    return max(SAFETY * fine / (gain - 1), 0.0 if confirmed else coarse / spread)


@lru_cache
def _law(order: int, first: float, second: float) -> tuple[float, float, float, float]:
    """Return least and most of coarse / fine, the power of it that is the gain, and coarse / error."""
    doublings = math.log2(second / first)
    return (
        1.5**doublings,
        (second / first) ** order,
        math.log2(first) / doublings,
        second**order - first**order,
    )
