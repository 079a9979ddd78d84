"""Floquet multipliers of tangent maps, in exact pairs if a map is symplectic, in one thread.

The multipliers of a symplectic map A come in pairs l, 1/l. The skew-Hamiltonian matrix
(A + 1/A) / 2 has the means c = (l + 1/l) / 2 of these pairs as double eigenvalues. The method of C.
Van Loan, Linear Algebra Appl. 61, 233 (1984), reduces it to a matrix that has each mean once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvals
from threadpoolctl import ThreadpoolController

from ..util.arrays import Array

P = ParamSpec("P")
Result = TypeVar("Result")


@cache
def _controller() -> ThreadpoolController:
    # The controller searches the loaded libraries, which takes 5 ms.
    return ThreadpoolController()


def in_one_thread(function: Callable[P, Result]) -> Callable[P, Result]:
    """Return a function whose linear algebra runs in one thread.

    Several threads do not accelerate the linear algebra of matrices with some hundred rows, and on
    a busy machine they wait for each other. The eigenvalues of a 99 x 99 matrix then take 240 ms
    instead of 2 ms.
    """

    @wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> Result:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone


Complex = NDArray[np.complex128]


def blocks(matrix: Array) -> tuple[Array, Array, Array, Array]:
    """Return the four (M, M) blocks of a (2M, 2M) matrix, row by row."""
    half = len(matrix) // 2
    return matrix[:half, :half], matrix[:half, half:], matrix[half:, :half], matrix[half:, half:]


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symplectic matrix."""
    a, b, c, d = blocks(matrix)
    return np.block([[d.T, -b.T], [-c.T, a.T]])


def close(half: Array) -> Array:
    """Return the tangent map (2M, 2M) of a period, given the map of half a period.

    The second half of the motion is the first one reversed in time."""
    # Momenta change their sign under time reversal.
    sign = np.repeat([1.0, -1.0], len(half) // 2)
    return sign[:, None] * inverse(half) * sign @ half


@in_one_thread
def means(matrix: Array) -> Complex:
    """Return the mean of every pair of multipliers of a symplectic matrix (2M, 2M), (M,)."""
    return eigvals(_halve((matrix + inverse(matrix)) / 2)).astype(complex)


@in_one_thread
def reversible_means(half: Array) -> Complex:
    """Return (A + 1/A) / 2 of each pair of multipliers, from the tangent map of half a period.

    The orbit is at rest at t = 0. With the blocks a, b, c, d of the map of half a period, these
    means are the eigenvalues of 1 + 2 b^T c, which acts on displacements.
    """
    _, b, c, _ = blocks(half)
    return (1 + 2 * eigvals(b.T @ c)).astype(complex)


@in_one_thread
def all_multipliers(matrix: Array) -> Complex:
    """Return the multipliers of any tangent map (2M, 2M), the largest first, (2M,)."""
    values = eigvals(matrix).astype(complex)
    # Conjugate multipliers have a fixed order.
    return values[np.lexsort((-np.angle(values), -np.abs(values).round(12)))]


def without_trivial(mean: Complex) -> Complex:
    """Return the means without the one nearest to 1, which is trivial for an undriven orbit."""
    return np.delete(mean, np.abs(mean - 1).argmin())


def multipliers(mean: Complex, trivial: bool) -> Complex:
    """Return multipliers (2M,) in pairs, largest first; a trivial pair 1 is the last."""
    # In l = c +- sqrt(c^2 - 1), the larger root and its inverse are computed without cancellation.
    root = np.sqrt(mean**2 - 1)
    large = np.where(np.abs(mean + root) >= np.abs(mean - root), mean + root, mean - root)
    on_circle = (mean.imag == 0) & (np.abs(mean.real) <= 1)
    large = np.where(on_circle, np.exp(1j * np.arccos(np.clip(mean.real, -1, 1))), large)
    order = np.lexsort((np.angle(large), -np.abs(large).round(9)))
    pairs = np.stack((large, 1 / large), 1)[order]
    return np.append(pairs.ravel(), [1.0, 1.0]) if trivial else pairs.ravel()


def _halve(matrix: Array) -> Array:
    """Return an (M, M) matrix with each double eigenvalue of a skew-Hamiltonian matrix once."""
    matrix = matrix.copy()
    size = len(matrix) // 2
    # Column by column, by orthogonal symplectic maps only.
    for j in range(size - 1):
        rows = np.arange(j + 1, size)
        _reflect(matrix, matrix[size + rows, j], rows, size)
        _rotate(matrix, j + 1, j, size)
        _reflect(matrix, matrix[rows, j], rows, size)
    return matrix[:size, :size]


def _rotate(matrix: Array, row: int, column: int, size: int) -> None:
    """Rotate a displacement and its momentum until the entry of the momentum vanishes."""
    pair = [row, size + row]
    a, b = matrix[pair, column]
    norm = np.hypot(a, b)
    if norm > 0:
        turn = np.array([[a, b], [-b, a]]) / norm
        matrix[pair] = turn @ matrix[pair]
        matrix[:, pair] = matrix[:, pair] @ turn.T


def _reflect(matrix: Array, column: Array, rows: NDArray[np.intp], size: int) -> None:
    """Reflect displacements and momenta so that only the first entry of a column remains."""
    normal = column.copy()
    # The sign avoids cancellation, because both summands have equal signs.
    normal[0] += np.copysign(np.linalg.norm(column), column[0])
    square = normal @ normal
    if not square:
        return
    for half in (rows, rows + size):
        matrix[half] -= np.outer(2 * normal / square, normal @ matrix[half])
        matrix[:, half] -= np.outer(matrix[:, half] @ normal, 2 * normal / square)
