"""Arrays: even spacing to the last bit, slices, magnitudes, and what is computed once."""

from functools import cached_property

import numpy as np
import pytest

from lmpchain.util import arrays
from lmpchain.util.arrays import EPSILON, MAGNITUDE, as_slice, evenly, read_only


@pytest.mark.parametrize("count", [2, 3, 11, 101, 9_999, 10_000, 10_001, 30_000])
def test_even_numbers_are_those_of_numpy(count: int):
    for end in (1e-4, 0.3, 1 / 3, 7.7e-5, 2.4e-4):
        values = evenly(end, count)
        assert values.tobytes() == np.linspace(0.0, end, count).tobytes()
        values[:] = 0.0  # which changes none to come
        assert evenly(end, count).tobytes() == np.linspace(0.0, end, count).tobytes()


def test_the_last_of_even_numbers_is_the_end():
    """Also where the sum of the spacings is not."""
    inexact = [
        (end, n) for n in range(2, 60) for end in (0.3, 0.7) if end / (n - 1) * (n - 1) != end
    ]
    assert inexact
    assert all(evenly(end, count)[-1] == end for end, count in inexact)


def test_what_is_kept_of_even_numbers_is_small():
    kept = []
    for count in (5_000, 10_000, 12_000, 20_000, 60_000):
        arrays._evenly.cache_clear()
        evenly(1.0, count)
        if arrays._evenly.cache_info().currsize:
            kept.append(count)
    assert kept[:1] == [5_000]
    assert 8 * kept[-1] * arrays._evenly.cache_info().maxsize < 0.35e6  # bytes


def test_indices_in_a_row_are_a_slice():
    for first, count in ((0, 1), (0, 5), (7, 2), (7, 30)):
        assert as_slice(np.arange(first, first + count)) == slice(first, first + count)
    for others in ([], [1, 3], [2, 1], [1, 1], [1, 2, 4], [0, 2, 1]):
        indices = np.array(others, dtype=int)
        assert as_slice(indices) is indices


def test_magnitudes_of_doubles_compare_like_their_bits():
    numbers = np.array([0.0, -0.0, 1.0, -1.5, 3e-310, -(2.0**900), np.inf, -np.inf])
    bits = numbers.view(np.int64) & MAGNITUDE
    assert np.array_equal(bits.view(float), np.abs(numbers))
    assert np.array_equal(np.argsort(bits, kind="stable"), np.argsort(abs(numbers), kind="stable"))
    assert 1.0 + EPSILON > 1.0
    assert 1.0 + EPSILON / 2 == 1.0


def test_only_arrays_are_made_read_only():
    array = np.zeros(2)
    assert read_only(array) is array
    assert not array.flags.writeable
    assert read_only(2.5) == 2.5


def test_a_value_is_computed_once_and_its_class_tells_of_it():
    calls = []

    class Square:
        @cached_property
        def area(self) -> float:
            """Return the area."""
            calls.append(self)
            return 4.0

    square = Square()
    assert (square.area, square.area) == (4.0, 4.0)
    assert calls == [square]
    assert Square.area.__doc__ == "Return the area."
