"""How large answers are and how far two are apart, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import MAGNITUDE, Array
from ...util.compilation import compiled_once
from .contact_forces import NEWS, bits, number

SOUND, TOO_CLOSE, TOO_FAST, NO_NUMBERS = range(4)
_exact = numba.njit(error_model="numpy")
_total = numba.njit(error_model="numpy", fastmath={"nsz", "reassoc"})


@_exact
def _farthest(a, b):
    """Return the largest distance of a and b; no number, whose bits are above all others, if any is none."""
    most = 0
    for n in range(a.size):
        most = max(bits(a[n] - b[n]) & MAGNITUDE, most)
    return number(most)


@_total
def _kinetic(v, masses):
    total = 0.0
    for n in range(v.size):
        total += masses[n] * v[n] * v[n]
    return total


@_exact
def may_give_way(closer, most, overlap, stiffness, constant, exponent):
    """Say whether grains may be so much closer than at rest where there is twice this energy at most, J.

    Of contacts at rest, (N+1,); it is said by the first that may: see `Contacts.overlap_bound`.
    """
    power = exponent + 1.0
    for n in range(overlap.size):
        if constant[n] > 0.0:
            gives = (power * most / constant[n]) ** (1.0 / power)
            if stiffness[n] > 0.0:
                gives = min(gives, np.sqrt(2.0 * most / stiffness[n]))
            if closer <= overlap[n] + gives:
                return True
    return closer <= 0.0


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def compared(
    u: Array,
    v: Array,
    others_u: Array,
    others_v: Array,
    against: NDArray[np.int64],
    strides: NDArray[np.int64],
    masses: Array,
    begin: int,
    differences: Array,
    peaks: Array,
    allowed: Array,
    state: Array,
    overlap: Array,
    stiffness: Array,
    constant: Array,
    exponent: float,
    furthest: float,
) -> int:
    """Measure an answer and how far others are from it or from each other.

    Parameters
    ----------
    u, v : (R, T, N) arrays
        Fields of R chains.
    others_u, others_v : (S, R, B, N) arrays
        The same of others; their first samples are those of the answer.
    against, strides : (S,) arrays
        From which each of the others is measured: 0 is the answer, 1 the first of the others; and after how many
        samples each stops, besides the last one.
    masses : (R, N) array
    begin : int
        Number of the first sample.
    differences : (S, samples, R, 2) array
        Takes the largest differences over the grains where the others stop; no number where that is none.
    peaks : (R, 2) array
        Takes the largest displacement and speed, where they are larger than what it holds.
    allowed : (R,) array
        What twice the kinetic energy cannot exceed, J.
    state : (F R,) array of `layout.STATE`
        That of R chains by F schedules.
    overlap, stiffness, constant, exponent : (R, N+1) arrays and float
        Of the contacts at rest.
    furthest : float
        How close grains may come whatever energy there is, m.

    Returns
    -------
    int
        `SOUND`, `TOO_CLOSE` if grains have come closer than the energy allows, `TOO_FAST` if any sample has more of it,
        `NO_NUMBERS` if a displacement or velocity is none; the last of these.
    """
    others, final, batch = others_u.shape[0], differences.shape[1] - 1, u.shape[0]
    nothing, verdict = np.zeros(u.shape[2]), SOUND
    for row in range(len(state)):
        real, closer = row % batch, state[row].largest_approach
        contacts = overlap[real], stiffness[real], constant[real], exponent
        if not (closer <= furthest and may_give_way(closer, allowed[real], *contacts)):
            verdict = TOO_CLOSE
    for real in range(batch):
        for sample in range(u.shape[1]):
            x, w, at = u[real, sample], v[real, sample], begin + sample
            now, far = _kinetic(w, masses[real]), _farthest(x, nothing)
            if not (np.isfinite(now) and np.isfinite(far)):
                verdict = NO_NUMBERS
                continue
            if now > allowed[real]:
                verdict = max(verdict, TOO_FAST)
            peaks[real, 0], peaks[real, 1] = (
                max(peaks[real, 0], far),
                max(peaks[real, 1], _farthest(w, nothing)),
            )
            for other in range(others):
                if at == 0 or (at % strides[other] and at < final):  # all begin alike
                    continue
                a, b, one = x, w, against[other] - 1
                if one >= 0:
                    a, b = others_u[one, real, sample], others_v[one, real, sample]
                y, s = others_u[other, real, sample], others_v[other, real, sample]
                differences[other, at, real, 0] = _farthest(a, y)
                differences[other, at, real, 1] = _farthest(b, s)
    return verdict


@compiled_once(*NEWS, nogil=True, error_model="numpy")
def in_parts(
    differences: Array, peaks: Array, instead: Array, scale: Array, units: Array, state: Array
) -> tuple[Array, Array]:
    """Express differences as parts of the largest motion; what is no number is infinite.

    Parameters
    ----------
    differences : (S, T, R, 2) array
        Of S others, in displacements and velocities.
    peaks, instead : (R, 2) arrays
        That of the samples, and what is to take its place; no rows if nothing is.
    scale, units : (R, 2) arrays
        See `ChainBatch`: where nothing is set in motion, errors are relative to the units.
    state : (F R,) array of `layout.STATE`
        That of R chains by F schedules, the motion of the first of which counts.

    Returns
    -------
    told : (R, 3 + S, 2) array
        Smallest r / eps of any contact by any schedule, and steps by the first one; what parts are of (1 if nothing
        moves); the first over the second of these (0 if nothing moves), and nothing; the largest parts of all samples.
    every : (R, T) array
        Largest parts of all others and both fields.
    """
    others, samples, batch, fields = differences.shape
    told, every = np.zeros((batch, 3 + others, fields)), np.zeros((batch, samples))
    for row in range(len(state)):
        told[row % batch, 0, 0] = min(told[row % batch, 0, 0], state[row].least_strain)
    for real in range(batch):
        told[real, 0, 1], over, largest = state[real].steps, told[real, 1], told[real, 3:]
        seen = state[real].largest_displacement, state[real].largest_speed
        for field in range(fields):
            size = max(peaks[real, field], seen[field])
            if scale[real, 1] == 0.0:
                size = units[real, field]
            elif real < len(instead):
                size = instead[real, field]
            over[field] = size if size > 0.0 else 1.0
        if max(peaks[real, 1], state[real].largest_speed) > 0.0:
            told[real, 2, 0] = over[0] / over[1]
        for sample in range(samples):
            for field in range(fields):
                most = 0.0
                for other in range(others):
                    apart = differences[other, sample, real, field]
                    apart = np.inf if np.isnan(apart) else apart
                    most, largest[other, field] = (
                        max(most, apart),
                        max(largest[other, field], apart),
                    )
                every[real, sample] = max(every[real, sample], most / over[field])
        for other in range(others):
            for field in range(fields):
                largest[other, field] /= over[field]
    return told, every
