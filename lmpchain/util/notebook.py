"""Display of values at a prompt (one line) and in a notebook (a table and a picture)."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from html import escape
from inspect import getdoc
from io import BytesIO
from itertools import islice
from typing import Any

import numpy as np

from ..errors import LmpchainError

FEW_VALUES = 4  # Largest number of values that are shown one by one.
STYLE = "text-align:left;vertical-align:top;padding:2px 12px 2px 0"


class Shown:
    """A value with a short `repr` and, in a notebook, a table of fields and a picture."""

    def _fields(self) -> Iterator[tuple[str, Any]]:
        """Yield the names and values to show."""
        # Fields of a record as given, without derived or hidden ones.
        kept = [one.name for one in fields(self) if one.repr] if is_dataclass(self) else vars(self)
        yield from ((name, getattr(self, name)) for name in kept if not name.startswith("_"))

    def _summary(self) -> Iterator[Sequence[str]]:
        """Yield the rows of the table: name, value, meaning."""
        meanings = parse_meanings(getdoc(type(self)) or "")
        for name, value in self._fields():
            yield name, brief(value, letters=90), meanings.get(name, "")

    def _picture(self) -> str:
        """Return the small picture as base64-encoded PNG, or ""."""
        draw = getattr(self, "plot", None)
        if draw is None:
            return ""
        from .plotting import figure

        picture = figure(4.8, 3.0)
        try:
            draw(ax=picture.subplots())
        except LmpchainError:
            # This value has no picture.
            return ""
        buffer = BytesIO()
        picture.savefig(buffer, format="png", dpi=150)
        return base64.b64encode(buffer.getvalue()).decode("ascii")

    def __repr__(self) -> str:
        few = islice(self._fields(), 2 * FEW_VALUES)
        text = ", ".join(f"{name}={brief(value)}" for name, value in few)
        return f"{type(self).__name__}({text})"

    def _repr_html_(self) -> str:
        cells = (
            "".join(f'<td style="{STYLE}">{escape(cell)}</td>' for cell in row)
            for row in self._summary()
        )
        table = f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"
        name = escape(type(self).__name__)
        picture = self._picture()
        if picture:
            style = "width:30em;max-width:100%"
            source = f"data:image/png;base64,{picture}"
            picture = f'<img alt="{name}" style="{style}" src="{source}">'
        return f"<div><b>{name}</b>{table}{picture}</div>"


def brief(value: Any, letters: int = 60) -> str:
    """Return a value in a few letters; for an array, its shape and range.

    Examples
    --------
    >>> brief(np.linspace(0, 1, 101)), brief(np.arange(3)), brief(1 / 3)
    ('(101,) from 0 to 1', '[0 1 2]', '0.333333')
    >>> brief("abc"), brief([1] * 9)
    ("'abc'", '9 values')
    >>> brief({"force:10": 0.12345678})
    "{'force:10': 0.123457}"
    """
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, np.ndarray):
        return _brief_array(value)
    group = isinstance(value, Mapping | list | tuple)
    text = _brief_group(value, letters) if group else repr(value)
    return text if len(text) <= letters else f"{text[: letters - 4]} ..."


def _brief_array(values: np.ndarray) -> str:
    """Return the shape and range of an array, or all values if there are few."""
    if values.ndim == 1 and values.size <= FEW_VALUES:
        return np.array2string(values, precision=5)
    # Complex numbers have no order.
    numbers = np.abs(values) if np.iscomplexobj(values) else values
    # Adding 0 removes the minus of -0.
    numbers = numbers[np.isfinite(numbers)] + 0
    extent = f" from {numbers.min():.4g} to {numbers.max():.4g}" if numbers.size else ""
    return f"{values.shape}{extent}"


def _brief_group(values: Any, letters: int) -> str:
    """Return the fields of a record, a list of few values, or the number of many values."""
    if hasattr(values, "_fields"):
        pairs = zip(values._fields, values, strict=True)
        said = ", ".join(f"{name}={brief(item, letters)}" for name, item in pairs)
        return f"{type(values).__name__}({said})"
    items = values.values() if isinstance(values, Mapping) else values
    if len(values) > FEW_VALUES or any(hasattr(item, "_fields") for item in items):
        return f"{len(values)} values"
    if isinstance(values, Mapping):
        said = ", ".join(f"{name!r}: {brief(item, letters)}" for name, item in values.items())
        return f"{{{said}}}"
    said = ", ".join(brief(item, letters) for item in values)
    return f"({said})" if isinstance(values, tuple) else f"[{said}]"


@cache
def parse_meanings(text: str) -> dict[str, str]:
    """Return the meaning of each attribute or parameter in the docstring of a class.

    If an entry has several names, each name gets one of the parts between semicolons. If there are
    not as many parts as names, the first name gets the whole text.

    Examples
    --------
    >>> parse_meanings("time, speed : float\\n    Of the peak, s; m/s.\\nload : float\\n    In N.")
    {'time': 'Of the peak, s', 'speed': 'm/s', 'load': 'In N'}
    """
    meanings: dict[str, str] = {}
    for group, words in re.findall(r"^(\w[\w, ]*) : .*\n((?:    .*\n?)+)", text, re.MULTILINE):
        names = group.split(", ")
        meaning = " ".join(words.replace("`", "").split()).removesuffix(".")
        shares = meaning.split("; ")
        if len(shares) != len(names):
            shares = [meaning] + [""] * (len(names) - 1)
        meanings |= zip(names, shares, strict=True)
    return meanings
