"""Steps of a run by a splitting as rows, each a kick and a drift, and its looks, compiled.

The last kick of a step and the first of the next are one row, but where grains are looked at
between them.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import Ingredient, compiled_once

# multiplications and additions may be fused: unlike those of a run, bits of derivatives need not
# agree between loops that share a chain out in other ways. Without numba's runtime, see
# `compiling`.
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
    """Steps of a run, and how many of them are made before each look.

    Attributes
    ----------
    kicks, drifts : (S+1,) and (S,) arrays
        Fractions of a step.
    lengths : (K,) array
        Of all steps, s.
    begun : (looks+1,) array
        Steps before each look.
    """

    kicks: Array
    drifts: Array
    lengths: Array
    begun: NDArray[np.int64]


class Stretch(NamedTuple):
    """Some `size` rows, from that of number `row` after a look on."""

    look: int
    row: int
    size: int


class Looks(NamedTuple):
    """Bodies (G,) that are looked at, and a displacement and a velocity of each, (2, looks+1, G).

    Or derivatives with respect to these, or (D, 2, looks+1, G) changes of them.
    """

    bodies: NDArray[np.int64]
    values: Array


@loop
def fill_rows(steps, look, row, kick, drift):
    """Fill kick and drift (Q,), s, of the rows from that of this number after a look on."""
    kicks, drifts, lengths, begun = steps
    stages = drifts.size
    step = begun[look] + row // stages
    stage = row % stages
    for n in range(kick.size):
        # the last kick before a look stands alone
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
    """Return the drift, s, of the row before that of this number after a look; 0 right after it."""
    if row == 0:
        return 0.0
    stages = steps.drifts.size
    step = steps.begun[look] + (row - 1) // stages
    return steps.drifts[(row - 1) % stages] * steps.lengths[step]


@loop
def count_rows(steps, look):
    """Return the number of rows from a look to the next."""
    return steps.drifts.size * (steps.begun[look + 1] - steps.begun[look]) + 1
