"""How large answers are and how far two are apart, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .contact_forces import NEWS

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
def compared(u: Array, v: Array, against: NDArray[np.int64], masses: Array, count: int) -> tuple[Array, Array, Array]:
    """Measure the first samples of an answer and how far others are from it or from each other.

    Parameters
    ----------
    u, v : (S, R, B, N) arrays
        Fields of S answers of R chains; the first is that in question.
    against : (S-1,) array
        From which of them each of the others is measured.
    masses : (R, N) array
    count : int
        Of the B samples.

    Returns
    -------
    peaks : (R, 2) array
        Largest displacement and speed.
    energy : (R,) array
        Twice the largest kinetic energy of any sample; infinite if any displacement or velocity is no number.
    differences : (S-1, count, R, 2) array
        Largest differences over the grains; no number where that is none.
    """
    others, batch = u.shape[0] - 1, u.shape[1]
    peaks, energy = np.zeros((batch, 2)), np.zeros(batch)
    differences = np.empty((others, count, batch, 2))
    nothing = np.zeros(u.shape[3])
    for real in range(batch):
        for sample in range(count):
            x, w = u[0, real, sample], v[0, real, sample]
            peaks[real, 0] = max(peaks[real, 0], _farthest(x, nothing))
            peaks[real, 1] = max(peaks[real, 1], _farthest(w, nothing))
            now = _kinetic(w, masses[real]) + 0.0 * _sum(x, nothing)
            energy[real] = max(energy[real], now) if np.isfinite(now) else np.inf
            for other in range(others):
                for kind, field in enumerate((u, v)):
                    a, b = field[against[other], real, sample], field[other + 1, real, sample]
                    differences[other, sample, real, kind] = _farthest(a, b) + 0.0 * _sum(a, b)
    return peaks, energy, differences
