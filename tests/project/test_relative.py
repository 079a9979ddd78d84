"""The comparison that all tests use."""

import pytest


@pytest.mark.parametrize("value", [1e-300, 1e-20, 1e-12, 1.0, 1e20])
@pytest.mark.parametrize("rel", [1e-12, 1e-6, 1e-2])
def test_approx_compares_small_and_large_numbers_alike(value: float, rel: float):
    assert value * (1 + 0.9 * rel) == pytest.approx(value, rel=rel)
    assert value * (1 + 1.1 * rel) != pytest.approx(value, rel=rel)
    assert value != pytest.approx(0.0, rel=rel)
    assert [value, 2 * value] != pytest.approx([value, 2 * value * (1 + 1.1 * rel)], rel=rel)


def test_an_absolute_tolerance_must_be_requested():
    assert pytest.approx(0.0, abs=1e-12) == 1e-13
    assert pytest.approx(0.0, abs=1e-12) != 1.1e-12
