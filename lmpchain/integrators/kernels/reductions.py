"""Largest motion of a solution, and its distance from other runs, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import MAGNITUDE, Array
from ...util.compilation import Ingredient
from .compiling import bits, compiled_filler, number

SOUND, TOO_FAST, NOT_A_NUMBER = range(3)
_in_order = numba.njit(error_model="numpy", pipeline_class=Ingredient)
# The order of summation is free, so that several numbers are added at a time.
_in_any_order = numba.njit(
    error_model="numpy", fastmath={"nsz", "reassoc"}, pipeline_class=Ingredient
)


@_in_order
def _farthest(a, b):
    """Return the largest distance between elements of a and b, or NaN if any element is NaN.

    The elements are compared by their bit patterns, because the bit pattern of NaN is larger than
    the bit patterns of all positive numbers.
    """
    largest = 0
    for n in range(a.size):
        largest = max(bits(a[n] - b[n]) & MAGNITUDE, largest)
    return number(largest)


@_in_order
def _largest(a):
    """Return the largest magnitude in an array, or NaN if any element is NaN; see `_farthest`."""
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
    """Compute the extremes of a solution, and the differences between runs.

    Parameters
    ----------
    u : (R, B, N) array
        Displacements in R chains at B samples, m.
    v : (R, B, N) array
        Velocities in R chains at B samples, m/s.
    runs : tuple
        Displacements and velocities of S auxiliary runs, (S, R, B, N) arrays; the number of the run
        with which each run is compared, (S,), 0 for the solution and n for auxiliary run n; and the
        number of samples between two comparisons of each run, (S,).
    begin : int
        Number of the first of the B samples.
    masses : (R, N) array
        Masses of the grains, kg.
    allowed : (R,) array
        Upper bound on twice the kinetic energy, J.
    differences : (S, T, R, 2) array
        Filled with the largest differences in displacement, m, and in velocity, m/s, over all
        grains at the landings of the auxiliary runs; NaN if a value is NaN.
    peaks : (R, 2) array
        Largest displacement, m, and speed, m/s, so far; updated.

    Returns
    -------
    int
        `SOUND`, `TOO_FAST` if any sample exceeds the allowed energy, or `NOT_A_NUMBER` if a
        displacement or velocity is not finite. The largest verdict of all samples is returned.
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
            # Contacts never store less energy than at rest, so a larger kinetic energy shows a
            # breakdown.
            if energy > allowed[real]:
                verdict = max(verdict, TOO_FAST)
            peaks[real, 0] = max(peaks[real, 0], farthest)
            peaks[real, 1] = max(peaks[real, 1], _largest(w))
            for run in range(against.size):
                # All runs start from the same state, and an auxiliary run may skip samples.
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
