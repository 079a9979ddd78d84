"""The reference motion as ``(u, v, error)``, and the distance of two motions.

Displacement (T, N) m and velocity (T, N) m/s are those of every grain at the recorded times,
positive downward; `helpers.taylor_series` computes them from Eq. (1) alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from helpers.forcing import Array
from helpers.taylor_series import reference
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lmpchain import Scene

Reference = tuple[NDArray[np.float64], NDArray[np.float64], float]


def distance(found: Any, true: Any, scale: Sequence[float] | None = None) -> float:
    """Return the larger of the relative distances of displacements and velocities of two motions.

    A motion has these fields, or is a sequence that begins with them. The distances are relative
    to the largest values of the second motion, or to those in `scale`.
    """
    pairs = list(zip(_fields(found), _fields(true), strict=True))
    scale = [np.abs(ref).max() for _, ref in pairs] if scale is None else scale
    return max(
        float(np.abs(np.asarray(x) - ref).max() / size)
        for (x, ref), size in zip(pairs, scale, strict=True)
    )


def _fields(motion: Any) -> tuple[Array, Array]:
    if hasattr(motion, "displacement"):
        return motion.displacement, motion.velocity
    return motion[0], motion[1]


def extended_reference(scene: Scene, tolerance: float = 1e-19) -> Reference:
    """Integrate with Taylor series in extended precision, to this error tolerance per step.

    The error given is the distance to a looser solution of another order; see `taylor_series`.
    """
    found, error = reference(scene, tolerance)
    return found.displacement, found.velocity, error
