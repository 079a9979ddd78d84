"""Arrays of physical quantities, and the precision of their numbers."""

import math
from decimal import Decimal
from numbers import Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, shown

Array = NDArray[np.float64]
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])
EPSILON = float(np.finfo(float).eps)  # Spacing of doubles near 1.
SMALLEST = float(np.nextafter(0.0, 1.0))  # Smallest positive double.
# Bits of a double without the sign bit. The bits of positive doubles are ordered like the numbers.
MAGNITUDE = (1 << 63) - 1
# Data types that numpy would convert to numbers.
NO_NUMBERS = {
    "b": "truth values: give 0 and 1 if these are meant",
    "S": "text: read it with float first",
    "U": "text: read it with float first",
    "T": "text: read it with float first",
    "M": "dates: give the seconds since the strike",
    "m": "time spans: give seconds",
    "c": "complex numbers: give their real parts or their magnitudes",
}


def last_digit(size: float) -> float:
    """Return the unit in the last place (ulp) of a number; above EPSILON for the smallest doubles.

    Examples
    --------
    >>> last_digit(3.0) == last_digit(1e-300) == EPSILON, last_digit(5e-324)
    (True, 1.0)
    """
    return max(EPSILON, math.ulp(size) / size)


def numbers(value: Any, key: str = "") -> Array:
    """Return numbers in SI units as an array of float64, without a copy if possible.

    NumPy alone would convert text, truth values and dates to numbers, and drop masks and units.

    Raises
    ------
    InputError
        If the values are not numbers. The message begins with `key`.

    Examples
    --------
    >>> numbers([1, 2.5]).tolist()
    [1.0, 2.5]
    >>> numbers(["1", "2"], "force")
    Traceback (most recent call last):
    lmpchain.errors.InputError: force: must be numbers, not text: read it with float first
    """
    if type(value) is np.ndarray and value.dtype == float:
        return value
    if type(value) in (float, np.float64):
        return np.asarray(value)
    if reason := objection(value):
        raise InputError.at(key, reason)
    try:
        return np.asarray(value, dtype=float)
    except OverflowError:
        raise InputError.at(key, "must be numbers below 1.8e308") from None
    except (TypeError, ValueError):
        raise InputError.at(key, "must be numbers, in rows of equal length") from None


def whole_numbers(value: Any, key: str = "") -> NDArray[np.int64]:
    """Return integers as an array of int64; raise `InputError` for other values."""
    array = numbers(value, key)
    if not (np.isfinite(array) & (array == np.round(array))).all():
        raise InputError.at(key, "must be whole numbers")
    return array.astype(np.int64)


def plain(value: Any) -> Any:
    """Return a NumPy number as a Python number, and other values unchanged.

    Examples
    --------
    >>> plain(np.float64(2.0)), plain("a")
    (2.0, 'a')
    """
    # NumPy treats time spans as integers, and would drop their unit.
    is_number = isinstance(value, np.generic) and value.dtype.kind in "biuf"
    return value.item() if is_number else value


def check_flags(**flags: Any) -> None:
    """Raise `InputError` unless each value is True or False, because the text "no" is truthy."""
    faults = [
        (key, f"must be True or False (got {shown(flag)})")
        for key, flag in flags.items()
        if not isinstance(flag, bool | np.bool_)
    ]
    if faults:
        raise InputError(faults)


def objection(value: Any) -> str:
    """Return the reason why a value is not a number in SI units, with a remedy; "" if it is."""
    if isinstance(value, list | tuple):
        # Python numbers, possibly millions, need no check.
        others = (objection(item) for item in value if type(item) not in (int, float))
        return next(filter(None, others), "")
    # The unit attribute is `units` in pint, unyt and xarray, and `unit` in astropy.
    unit = getattr(value, "units", None) or getattr(value, "unit", None)
    if unit is not None:
        return f"has a unit of its own, {unit}: convert it to SI units and give the numbers alone"
    if np.ma.is_masked(value):
        return "has masked entries: leave them out"
    array = np.asarray(value)
    if array.dtype.kind in NO_NUMBERS:
        return f"must be numbers, not {NO_NUMBERS[array.dtype.kind]}"
    if array.dtype.kind == "O" and array.ndim:
        return objection(array.ravel().tolist())
    is_number = array.dtype.kind in "iuf" or isinstance(value, Real | Decimal)
    return "" if is_number else f"must be numbers (got {shown(value)})"


def read_only(array: AnyArray) -> AnyArray:
    """Make an array read-only and return it; return a number unchanged.

    Examples
    --------
    >>> read_only(np.zeros(3)).flags.writeable
    False
    """
    if isinstance(array, np.ndarray):
        array.flags.writeable = False
    return array


def as_slice(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return consecutive indices as a slice, other indices unchanged.

    Indexing with a slice gives a view instead of a copy.

    Examples
    --------
    >>> as_slice(np.array([1, 2])), as_slice(np.array([2, 1]))
    (slice(1, 3, None), array([2, 1]))
    """
    if indices.size and np.array_equal(indices, np.arange(indices[0], indices[0] + indices.size)):
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
