"""The error of an answer from how it differs from runs at longer steps, by the order of the method."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..util.arrays import Array

SAFETY = 2.0  # factor on the Richardson estimate; analysis/calibration/richardson_estimate.py


def extrapolate(
    order: int, smooth: bool, coarse: Array | None, fine: Array, ratios: Sequence[float] = (2.0, 4.0)
) -> Array:
    """Return the Richardson estimate of the error at step h from runs at 4h, 2h and h, or from h and 2h.

    `ratios` are those of the steps, where they are not 2 and 4 because steps must end at the last sample.

    Where contacts open or nearly so, a high order falls to about 2.5, unless steps are adaptive, with a coefficient
    that depends on where in a step the opening falls: the error at h can then be as large as the difference.
    On random chains the estimate is between 1 and 5 times the true error while
    the order holds and rarely below it elsewhere.
    """
    if coarse is None:
        return fine
    if not smooth:
        return 1.5 * np.maximum(fine, coarse / 4)
    first, second = ratios
    doublings = math.log2(second / first)
    ratio = coarse / np.maximum(fine, 1e-300)
    ratio = np.minimum(np.maximum(ratio, 1.5**doublings), (second / first) ** order)
    gain = ratio ** (math.log2(first) / doublings)  # error at the longer step over that at h
    return SAFETY * np.maximum(fine / (gain - 1), coarse / (second**order - first**order))
