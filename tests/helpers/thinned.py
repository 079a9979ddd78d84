"""Parametrised cases, most of which run only with the slow tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def thinned(cases: Iterable[Any], every: int) -> list[Any]:
    """Return the cases as parameters, with all but every n-th case marked as slow."""
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)),
            marks=pytest.mark.slow if number % every else (),
        )
        for number, case in enumerate(cases)
    ]


def fuzzed(quick: int, soak: int) -> Any:
    """Mark a test with its number of cases in the quick suite and in a soak."""
    return pytest.mark.parametrize("count", [quick, pytest.param(soak, marks=pytest.mark.soak)])
