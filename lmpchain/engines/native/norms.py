"""How large answers are and how far two are apart, compiled."""

from __future__ import annotations

import numba
import numpy as np

from ...compiling import compiled_once
from ...fields import Array
from .forces import NEWS

_maximum = numba.njit(error_model="numpy", fastmath={"nnan", "nsz"})
_total = numba.njit(error_model="numpy", fastmath={"nsz", "reassoc"})


@_maximum
def _farthest(a, b):
    most = 0.0
    for n in range(a.size):
        difference = abs(a[n] - b[n])
        most = difference if difference > most else most
    return most


@_total
def _sum(a, b):
    total = 0.0
    for n in range(a.size):
        total += a[n] - b[n]
    return total


@_total
def _kinetic(v, masses):
    total = 0.0
    for n in range(v.size):
        total += masses[n] * v[n] * v[n]
    return total


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def apart(a: Array, b: Array, count: int) -> Array:
    """Return the largest difference over the grains in the first samples of two fields (R, B, N), (R, count).

    It is NaN where that is no number.
    """
    out = np.empty((a.shape[0], count))
    for real in range(a.shape[0]):
        for sample in range(count):
            x, y = a[real, sample], b[real, sample]
            out[real, sample] = _farthest(x, y) + 0.0 * _sum(x, y)
    return out


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def largest(u: Array, v: Array, masses: Array, count: int) -> tuple[Array, Array]:
    """Return the largest displacement and speed (R, 2) in the first samples of fields (R, B, N), and the energy (R,).

    That is twice the largest kinetic energy of any sample, and no number if any displacement or velocity is none.
    """
    peaks, energy = np.zeros((u.shape[0], 2)), np.zeros(u.shape[0])
    nothing = np.zeros(u.shape[2])
    for real in range(u.shape[0]):
        for sample in range(count):
            x, w = u[real, sample], v[real, sample]
            peaks[real, 0] = max(peaks[real, 0], _farthest(x, nothing))
            peaks[real, 1] = max(peaks[real, 1], _farthest(w, nothing))
            now = _kinetic(w, masses[real]) + 0.0 * _sum(x, nothing)
            energy[real] = now if not now <= energy[real] else energy[real]
            if not np.isfinite(now):
                energy[real] = np.inf
                break
    return peaks, energy
