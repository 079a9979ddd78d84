"""Steps of a run by a splitting as rows, each a kick and a drift, and its observations, compiled.

The last kick of a step and the first kick of the next step form one row, unless grains are observed
between them. An observation is called a look.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import Ingredient, compiled_once

# Multiplications and additions may be fused, because derivatives, unlike runs, need not have the
# same bits for every partition of a chain. See `compiling` about numba's runtime.
OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"nnan", "ninf", "nsz", "contract"},
    "_nrt": False,
}
loop = numba.njit(**OPTIONS, pipeline_class=Ingredient)
compiled_gradient = partial(
    compiled_once, "gradients of the native engine", 30, nogil=True, **OPTIONS
)


class Course(NamedTuple):
    """Steps of a run, and the number of steps before each observation.

    Attributes
    ----------
    kicks : (S+1,) array
        Lengths of the kicks of a step, as fractions of the step.
    drifts : (S,) array
        Lengths of the drifts of a step, as fractions of the step.
    lengths : (K,) array
        Lengths of all steps, s.
    begun : (looks+1,) array
        Number of steps before each observation.
    """

    kicks: Array
    drifts: Array
    lengths: Array
    begun: NDArray[np.int64]


class Stretch(NamedTuple):
    """`size` consecutive rows, which begin `row` rows after observation number `look`."""

    look: int
    row: int
    size: int


class Looks(NamedTuple):
    """Observed bodies (G,), and a displacement and a velocity of each, (2, looks+1, G).

    Attributes
    ----------
    bodies : (G,) array
        Index of each observed body in a row of bodies.
    values : (2, looks+1, G) or (D, 2, looks+1, G) array
        Displacements, m, and velocities, m/s; or derivatives with respect to these values; or
        changes of these values in D directions.
    """

    bodies: NDArray[np.int64]
    values: Array


@loop
def fill_rows(steps, look, row, kick, drift):
    """Compute kick and drift (Q,), s, of the rows that begin `row` rows after an observation."""
    kicks, drifts, lengths, begun = steps
    stages = drifts.size
    step = begun[look] + row // stages
    stage = row % stages
    for n in range(kick.size):
        # The last kick before an observation forms a row of its own.
        if step == begun[look + 1]:
            kick[n] = kicks[stages] * lengths[step - 1]
            drift[n] = 0.0
            return
        kick[n] = kicks[stage] * lengths[step]
        drift[n] = drifts[stage] * lengths[step]
        if stage == 0 and step > begun[look]:
            kick[n] += kicks[stages] * lengths[step - 1]
        stage += 1
        if stage == stages:
            step += 1
            stage = 0


@loop
def drift_before(steps, look, row):
    """Return the drift, s, of the row before row number `row` after an observation.

    The result is 0 if row number `row` directly follows the observation.
    """
    if row == 0:
        return 0.0
    stages = steps.drifts.size
    step = steps.begun[look] + (row - 1) // stages
    return steps.drifts[(row - 1) % stages] * steps.lengths[step]


@loop
def count_rows(steps, look):
    """Return the number of rows from one observation to the next."""
    return steps.drifts.size * (steps.begun[look + 1] - steps.begun[look]) + 1
