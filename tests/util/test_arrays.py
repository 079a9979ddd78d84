"""Arrays: slices, magnitudes, and what is computed once."""

from functools import cached_property

import numpy as np

from lmpchain.util.arrays import EPSILON, MAGNITUDE, as_slice, read_only


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
