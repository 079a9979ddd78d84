"""The maximum of a recorded signal, also between its samples."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]


def find_peak(time: Array, values: Array, top: int | None = None) -> tuple[float, float]:
    """Return the time and size of the maximum of values (T,), near the sample `top` if given."""
    top = int(values.argmax()) if top is None else top
    assert 12 <= top < len(time) - 12, "the peak must lie well inside the recording"
    near = slice(top - 12, top + 13)
    spline = make_interp_spline(time[near] - time[top], values[near], k=5)
    slope = spline.derivative()
    curvature = spline.derivative(2)
    t = 0.0
    for _ in range(20):
        t -= float(slope(t) / curvature(t))
    assert abs(t) <= time[1] - time[0]
    return float(time[top] + t), float(spline(t))
