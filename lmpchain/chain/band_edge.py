"""Band edges: the highest eigenfrequency of many linearised chains, compiled.

Laguerre's iteration (B. N. Parlett, Math. Comp. 18, 464, 1964) starts from an upper bound on all
eigenvalues of the dynamical matrix. It converges to the largest eigenvalue from above, with third
order. All terms of its sums are positive, so that cancellation does not occur. For 120 grains it
is ten times faster than the bisection in LAPACK, which took a sixteenth of the time of a sweep.
"""

from __future__ import annotations

import math

import numpy as np

from ..util.arrays import EPSILON, Array
from ..util.compilation import compiled_once

ITERATIONS = 200  # Upper bound on the number of iterations; about ten are needed.


def band_edges(diagonal: Array, coupling: Array) -> Array:
    """Return the square root of the largest eigenvalue of R dynamical matrices, (R,) rad/s.

    Parameters
    ----------
    diagonal, coupling : (R, M) and (R, M-1) arrays
        Diagonal and off-diagonal of `Chain.dynamical_matrix`, 1/s2.
    """
    edges = np.zeros(len(diagonal))
    _fill_edges(edges, diagonal, coupling)
    return edges


# The function needs no runtime of numba, because it allocates no arrays; it compiles faster
# without.
@compiled_once("the band edge", 2, error_model="numpy", _nrt=False)
def _fill_edges(edges, diagonal, coupling):
    """Compute the square roots of the largest eigenvalues (see `band_edges`)."""
    count, size = diagonal.shape
    for row in range(count):
        d = diagonal[row]
        e = coupling[row]
        # By Gershgorin's theorem no eigenvalue exceeds the largest row sum.
        bound = 0.0
        for n in range(size):
            neighbours = (abs(e[n - 1]) if n > 0 else 0.0) + (abs(e[n]) if n < size - 1 else 0.0)
            bound = max(bound, d[n] + neighbours)
        if not 0.0 < bound < math.inf:
            edges[row] = math.sqrt(max(bound, 0.0))
            continue
        # The shift, in units of the bound. It starts slightly above the bound, because an
        # eigenvalue may equal it.
        top = 1.0 + 4.0 * EPSILON
        previous_step = 1.0
        for _ in range(ITERATIONS):
            # The pivots of top - D give 1 / pivot, slope / pivot and - curvature / pivot. The sums
            # of 1 / (top - eigenvalue) and of its square are `first` and `second`.
            inverse = slope = bend = first = second = 0.0
            for n in range(size):
                between = e[n - 1] / bound if n > 0 else 0.0
                borrowed = between * between * inverse
                pivot = top - d[n] / bound - borrowed
                if not pivot > 0.0:
                    break
                inverse = 1.0 / pivot
                bend = borrowed * (bend + 2.0 * slope * slope) * inverse
                slope = (1.0 + borrowed * slope) * inverse
                first += slope
                second += slope * slope + bend
            # Rounding has moved the shift onto or below the eigenvalue. In a long chain the slopes
            # then grow from grain to grain.
            if not (pivot > 0.0 and second < math.inf):
                break
            spread = math.sqrt((size - 1) * max(size * second - first * first, 0.0))
            step = size / (first + spread)
            # The iteration ends when rounding errors dominate the step.
            if step <= EPSILON * top or step > previous_step:
                break
            top -= step
            previous_step = step
        edges[row] = math.sqrt(top * bound)
