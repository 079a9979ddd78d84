"""Tables of results as text, and their rows for JSON."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

LINE_WIDTH = 80  # Number of letters that fit on every terminal.
GAP = 2  # Number of letters between the columns of a table.


def line_width() -> int:
    """Return the width of a line in letters: the terminal's width, at least 80."""
    on_terminal = sys.stdout is not None and sys.stdout.isatty()
    return max(LINE_WIDTH, shutil.get_terminal_size().columns if on_terminal else 0)


def align(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table with left-aligned columns and wrapped wide cells.

    Examples
    --------
    >>> align([("engine", "step"), ("native", "1 s")])
    ['engine  step', 'native  1 s']
    """
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [(" " * GAP).join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return lines if max(map(len, lines), default=0) <= line_width() else _wrap_cells(rows, widths)


def _wrap_cells(rows: Sequence[Sequence[str]], widths: list[int]) -> list[str]:
    """Return a table whose widest columns are narrowed until it fits; words are not broken."""
    # A word, such as a path to copy, stays whole, even if the line becomes longer.
    longest = [max(map(len, " ".join(column).split(" "))) for column in zip(*rows, strict=True)]
    space = line_width() - GAP * (len(widths) - 1)
    # Columns of names stay whole if a long word makes the line too long in any case.
    fits = sum(longest) <= space
    while sum(widths) > space:
        places = [n for n, width in enumerate(widths) if width > longest[n] or not fits]
        widest = max(places, key=widths.__getitem__)
        if widths[widest] == longest[widest]:
            break
        widths[widest] -= 1
    lines = []
    for row in rows:
        cells = (
            textwrap.wrap(cell, width or 1, break_long_words=False, break_on_hyphens=False)
            for cell, width in zip(row, widths, strict=True)
        )
        for pieces in zip_longest(*cells, fillvalue=""):
            lines.append((" " * GAP).join(map(str.ljust, pieces, widths)).rstrip())
    return lines


def wrap(*sentences: str) -> list[str]:
    """Return sentences in lines of the terminal's width, with continuation lines indented.

    Examples
    --------
    >>> first, second, third = wrap("word " * 20, "and another")
    >>> len(first), second, third
    (79, '  word word word word', 'and another')
    """
    fold = textwrap.TextWrapper(line_width(), subsequent_indent="  ", break_on_hyphens=False)
    return [line for sentence in sentences for line in fold.wrap(sentence)]


def number(
    value: float, form: str = ".3g", unit: str = "", *, missing: str = "", infinite: str = "inf"
) -> str:
    """Return a number with its unit, or a word without a unit for NaN and infinity.

    Examples
    --------
    >>> number(0.0012345, unit="s"), number(math.nan), number(math.inf, infinite="none")
    ('0.00123 s', '', 'none')
    """
    if not math.isfinite(value):
        return missing if math.isnan(value) else infinite
    return f"{value:{form}} {unit}".rstrip()


def duration(seconds: float, missing: str = "-") -> str:
    """Return a time in a suitable unit.

    Examples
    --------
    >>> duration(7.23e-5), duration(0.5), duration(90.0), duration(math.nan)
    ('72.3 us', '500 ms', '90 s', '-')
    """
    if not math.isfinite(seconds):
        return missing
    # The unit belongs to the rounded time: 0.9996 s is 1 s, not 1e+03 ms.
    seconds = float(f"{seconds:.3g}")
    factor, unit = (1, "s") if seconds >= 1 else (1e3, "ms") if seconds >= 1e-3 else (1e6, "us")
    return f"{factor * seconds:.3g} {unit}"


def counted(count: int, thing: str) -> str:
    """Return a number of items as text, in the singular for one.

    Examples
    --------
    >>> counted(1, "step"), counted(20, "grain")
    ('1 step', '20 grains')
    """
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def finite(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row in which None, JSON's null, replaces NaN and infinity."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }
