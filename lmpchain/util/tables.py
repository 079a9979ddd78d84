"""Rows of results, as text and for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def aligned(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a line for each row, with columns that stand below each other.

    Examples
    --------
    >>> aligned([("engine", "step"), ("native", "1 s")])
    ['engine  step', 'native  1 s']
    """
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def finite(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with None, JSON's null, in place of numbers that are not finite."""
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()}
