"""Largest motion of an answer, and its distance from other runs, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import MAGNITUDE, Array
from ...util.compilation import Ingredient
from .compiling import bits, compiled_filler, number

SOUND, TOO_FAST, NOT_A_NUMBER = range(3)
_in_order = numba.njit(error_model="numpy", pipeline_class=Ingredient)
# a sum of many numbers in any order, that is several at a time
_in_any_order = numba.njit(
    error_model="numpy", fastmath={"nsz", "reassoc"}, pipeline_class=Ingredient
)


@_in_order
def _farthest(a, b):
    """Return the largest distance of a and b; no number if any is none.

    The bits of what is no number are above all others.
    """
    largest = 0
    for n in range(a.size):
        largest = max(bits(a[n] - b[n]) & MAGNITUDE, largest)
    return number(largest)


@_in_order
def _largest(a):
    """Return the largest size of a number; no number if any is none, see `_farthest`."""
    largest = 0
    for n in range(a.size):
        largest = max(bits(a[n]) & MAGNITUDE, largest)
    return number(largest)


@_in_any_order
def _kinetic(v, masses):
    """Return twice the kinetic energy, J."""
    total = 0.0
    for n in range(v.size):
        total += masses[n] * v[n] * v[n]
    return total


@compiled_filler(nogil=True)
def compare(
    u: Array,
    v: Array,
    runs: tuple[Array, Array, NDArray[np.int64], NDArray[np.int64]],
    begin: int,
    masses: Array,
    allowed: Array,
    differences: Array,
    peaks: Array,
) -> int:
    """Measure an answer, and how far other runs are from it or from each other.

    Parameters
    ----------
    u, v : (R, B, N) arrays
        Displacement and velocity of R chains.
    runs : tuple
        Displacements and velocities of S other runs, (S, R, B, N) arrays from the same sample on;
        from which run each is measured, (S,), 0 for the answer, 1 for the first of these; and
        after how many samples each stops, besides the last one, (S,).
    begin : int
        Number of the first sample.
    masses : (R, N) array
    allowed : (R,) array
        Bound on twice the kinetic energy, J.
    differences : (S, T, R, 2) array
        Takes the largest differences over the grains where the others stop; no number where that
        is none.
    peaks : (R, 2) array
        Takes the largest displacement and speed, where they are larger than what it holds.

    Returns
    -------
    int
        `SOUND`, `TOO_FAST` if any sample has more energy than there is, or `NOT_A_NUMBER` if a
        displacement or velocity is none; the last of these.
    """
    displacements, velocities, against, strides = runs
    final = differences.shape[1] - 1
    verdict = SOUND
    for real in range(u.shape[0]):
        for index in range(u.shape[1]):
            sample = begin + index
            x = u[real, index]
            w = v[real, index]
            energy = _kinetic(w, masses[real])
            farthest = _largest(x)
            if not (np.isfinite(energy) and np.isfinite(farthest)):
                verdict = NOT_A_NUMBER
                continue
            # contacts never hold less than at rest: so much speed is that of a run that breaks down
            if energy > allowed[real]:
                verdict = max(verdict, TOO_FAST)
            peaks[real, 0] = max(peaks[real, 0], farthest)
            peaks[real, 1] = max(peaks[real, 1], _largest(w))
            for run in range(against.size):
                # all begin alike, and some pass over samples
                if sample == 0 or (sample % strides[run] and sample < final):
                    continue
                a = x
                b = w
                other = against[run] - 1
                if other >= 0:
                    a = displacements[other, real, index]
                    b = velocities[other, real, index]
                y = displacements[run, real, index]
                s = velocities[run, real, index]
                differences[run, sample, real, 0] = _farthest(a, y)
                differences[run, sample, real, 1] = _farthest(b, s)
    return verdict
