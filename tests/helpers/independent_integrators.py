"""The reference motion as ``(u, v, error)``, and the distance of two motions.

Displacement (T, N) m and velocity (T, N) m/s are those of every grain at the recorded times,
positive downward; `helpers.taylor_series` computes them from Eq. (1) alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from helpers.forcing import Array
from helpers.taylor_series import reference
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lmpchain import Scene

Reference = tuple[NDArray[np.float64], NDArray[np.float64], float]


def relative_error(u: Array, v: Array, u_ref: Array, v_ref: Array) -> float:
    """Return the larger of the relative errors max|x - x_ref| / max|x_ref| of both fields."""
    pairs = ((u, u_ref), (v, v_ref))
    return max(float(np.abs(np.asarray(x) - ref).max() / np.abs(ref).max()) for x, ref in pairs)


def extended_reference(scene: Scene, tolerance: float = 1e-19) -> Reference:
    """Integrate with Taylor series in extended precision, to this error tolerance per step.

    The error given is the distance to a looser solution of another order; see `taylor_series`.
    """
    found, error = reference(scene, tolerance)
    return found.displacement, found.velocity, error
