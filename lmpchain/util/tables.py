"""Tables of results as text, and their rows for JSON."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

LINE_WIDTH = 80  # letters, which every terminal has


def align(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return one line per row of a table, with its columns aligned on the left.

    Examples
    --------
    >>> align([("engine", "step"), ("native", "1 s")])
    ['engine  step', 'native  1 s']
    """
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def wrap(*sentences: str) -> list[str]:
    """Return sentences in lines of 80 letters, the further ones of each indented.

    Examples
    --------
    >>> first, second, third = wrap("word " * 20, "and another")
    >>> len(first), second, third
    (79, '  word word word word', 'and another')
    """
    fold = textwrap.TextWrapper(LINE_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return [line for sentence in sentences for line in fold.wrap(sentence)]


def number(
    value: float, form: str = ".3g", unit: str = "", *, missing: str = "", infinite: str = "inf"
) -> str:
    """Return a number with its unit, or the words for NaN and infinity, which have none.

    Examples
    --------
    >>> number(0.0012345, unit="s"), number(math.nan), number(math.inf, infinite="none")
    ('0.00123 s', '', 'none')
    """
    if not math.isfinite(value):
        return missing if math.isnan(value) else infinite
    return f"{value:{form}} {unit}".rstrip()


def duration(seconds: float, missing: str = "-") -> str:
    """Return a time in the unit that suits it.

    Examples
    --------
    >>> duration(7.23e-5), duration(0.5), duration(90.0), duration(math.nan)
    ('72.3 us', '500 ms', '90 s', '-')
    """
    if not math.isfinite(seconds):
        return missing
    factor, unit = (1, "s") if seconds >= 1 else (1e3, "ms") if seconds >= 1e-3 else (1e6, "us")
    return f"{factor * seconds:.3g} {unit}"


def counted(count: int, thing: str) -> str:
    """Return how many there are of a thing, in the singular for one.

    Examples
    --------
    >>> counted(1, "step"), counted(20, "grain")
    ('1 step', '20 grains')
    """
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def finite(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with None, JSON's null, in place of numbers that are not finite."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }
