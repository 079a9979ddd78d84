"""The type of arrays that hold physical quantities, and the precision of their numbers."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])
EPSILON = float(np.finfo(float).eps)  # spacing of the doubles at 1


def read_only(array: AnyArray) -> AnyArray:
    """Return the same array, which can no longer be written to; a number stays what it is.

    Examples
    --------
    >>> read_only(np.zeros(3)).flags.writeable
    False
    """
    if isinstance(array, np.ndarray):
        array.flags.writeable = False
    return array
