"""Arrays: slices, magnitudes, and conversion of numbers."""

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pandas
import pytest
import xarray

from lmpchain.errors import InputError
from lmpchain.util.arrays import (
    EPSILON,
    MAGNITUDE,
    as_slice,
    check_flags,
    numbers,
    read_only,
    whole_numbers,
)


def test_consecutive_indices_are_a_slice():
    for first, count in ((0, 1), (0, 5), (7, 2), (7, 30)):
        assert as_slice(np.arange(first, first + count)) == slice(first, first + count)
    for others in ([], [1, 3], [2, 1], [1, 1], [1, 2, 4], [0, 2, 1]):
        indices = np.array(others, dtype=int)
        assert as_slice(indices) is indices


def test_magnitudes_of_doubles_are_ordered_like_their_bits():
    values = np.array([0.0, -0.0, 1.0, -1.5, 3e-310, -(2.0**900), np.inf, -np.inf])
    bits = values.view(np.int64) & MAGNITUDE
    assert np.array_equal(bits.view(float), np.abs(values))
    assert np.array_equal(np.argsort(bits, kind="stable"), np.argsort(abs(values), kind="stable"))
    assert 1.0 + EPSILON > 1.0
    assert 1.0 + EPSILON / 2 == 1.0


def test_only_arrays_are_made_read_only():
    array = np.zeros(2)
    assert read_only(array) is array
    assert not array.flags.writeable
    assert read_only(2.5) == 2.5


class WithUnit(float):
    """A number with a unit, as in pint and astropy."""

    units = "centimetre"


class ColumnWithUnit(np.ndarray):
    """An array with a unit, as in astropy and unyt."""

    unit = "cm"


# NumPy converts each of these to numbers without a warning.
NO_NUMBERS: dict[str, Any] = {
    "masked": np.ma.array([0.0, 1.0], mask=[True, False]),
    "masked entry": [0.0, np.ma.masked],
    "text": np.array(["0", "1"]),
    "bytes": np.array([b"0", b"1"]),
    "list of text": [0.0, "1"],
    "text in objects": np.array([0.0, "1"], dtype=object),
    "truth": np.array([False, True]),
    "truth among numbers": [0.0, True],
    "dates": np.array(["1970-01-01", "1970-01-02"], dtype="M8[s]"),
    "spans": np.array([0, 1], dtype="m8[us]"),
    "span in a list": [0.0, np.timedelta64(1, "us")],
    "complex": np.array([0.0, 1j]),
    "unit of xarray": xarray.DataArray([0.0, 1.0], attrs={"units": "cm"}),
    "unit of an array": np.zeros(2).view(ColumnWithUnit),
    "unit of an entry": [0.0, WithUnit(1.0)],
    "rows of two lengths": [[0.0, 1.0], [2.0]],
    "None": [0.0, None],
    "huge": [0.0, 10**400],
}


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_values_other_than_numbers_are_rejected(kind: str):
    with pytest.raises(InputError, match=r"^force: (must be|has a unit|has masked)"):
        numbers(NO_NUMBERS[kind], "force")


@pytest.mark.parametrize(
    "value",
    [
        [0, 1],
        (0.0, 1),
        range(2),
        np.array([0, 1], dtype="u1"),
        np.array([0, 1], dtype=np.longdouble),
        np.ma.array([0.0, 1.0], mask=False),
        xarray.DataArray([0.0, 1.0]),
        pandas.Series([0, 1]),
        [Fraction(0), Decimal(1)],
        [np.float32(0.0), np.int8(1)],
    ],
)
def test_numbers_of_every_kind_are_read(value: Any):
    array = numbers(value)
    assert array.dtype == float
    assert array.tolist() == [0.0, 1.0]


def test_integers_and_flags_are_checked():
    assert whole_numbers([1.0, 2]).tolist() == [1, 2]
    for wrong in ([1.5], [np.nan], ["1"], [True]):
        with pytest.raises(InputError, match=r"^grain: must be"):
            whole_numbers(wrong, "grain")
    check_flags(adaptive=True, events=np.bool_(False))
    with pytest.raises(InputError, match=r"^adaptive: must be True or False \(got 'no'\)$"):
        check_flags(adaptive="no")
