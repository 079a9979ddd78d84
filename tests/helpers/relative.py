"""Comparison of numbers at the relative accuracy that a test states."""

from typing import Any

import pytest

_approx = pytest.approx


def approx(
    expected: Any, rel: float | None = None, abs: float | None = None, nan_ok: bool = False
) -> Any:
    """Compare like `pytest.approx`, but without an absolute tolerance unless one is given.

    With pytest's default, 1e-12, any two energies of a weak wave are equal. A value that ought to
    be 0 needs `abs`: only the test knows the scale of what it is compared with.
    """
    if abs is None:
        rel = 1e-6 if rel is None else rel
        abs = 0.0
    return _approx(expected, rel=rel, abs=abs, nan_ok=nan_ok)
