"""Arrays that hold physical quantities, and the precision of their numbers."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])
EPSILON = float(np.finfo(float).eps)  # spacing of the doubles at 1
# the bits of a double without its sign; those of positive ones compare like the numbers
MAGNITUDE = (1 << 63) - 1


def read_only(array: AnyArray) -> AnyArray:
    """Forbid that an array is written to, and return it; a number is returned as it is.

    Examples
    --------
    >>> read_only(np.zeros(3)).flags.writeable
    False
    """
    if isinstance(array, np.ndarray):
        array.flags.writeable = False
    return array


def as_slice(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return indices that follow one another as a slice, others as they are.

    Of a slice numpy makes a view and no copy.

    Examples
    --------
    >>> as_slice(np.array([1, 2])), as_slice(np.array([2, 1]))
    (slice(1, 3, None), array([2, 1]))
    """
    if indices.size and np.array_equal(indices, np.arange(indices[0], indices[0] + indices.size)):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
