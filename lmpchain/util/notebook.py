"""What a prompt and a notebook show of a value: one line; a table and a small picture."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from html import escape
from inspect import getdoc
from io import BytesIO
from itertools import islice
from typing import Any

import numpy as np

from ..errors import LmpchainError

# letters of a value in a line and in a table; values that are shown one by one
LINE = 60
CELL = 90
FEW = 4
STYLE = "text-align:left;vertical-align:top;padding:2px 12px 2px 0"


class Shown:
    """A value with a short `repr` and, in a notebook, a table of what it holds and its picture."""

    def _fields(self) -> Iterator[tuple[str, Any]]:
        """Yield the names and values to show."""
        yield from ((name, value) for name, value in vars(self).items() if not name.startswith("_"))

    def _summary(self) -> Iterator[Sequence[str]]:
        """Yield the rows of the table: name, value, meaning."""
        meanings = described(getdoc(type(self)) or "")
        for name, value in self._fields():
            yield name, brief(value, CELL), meanings.get(name, "")

    def _picture(self) -> str:
        """Return the small picture as PNG in base64; empty if there is none."""
        draw = getattr(self, "plot", None)
        if draw is None:
            return ""
        from .plotting import figure

        picture = figure(4.8, 3.0)
        try:
            draw(ax=picture.subplots())
        except LmpchainError:  # not for this one
            return ""
        buffer = BytesIO()
        picture.savefig(buffer, format="png", dpi=150)
        return base64.b64encode(buffer.getvalue()).decode("ascii")

    def __repr__(self) -> str:
        names = ", ".join(
            f"{name}={brief(value)}" for name, value in islice(self._fields(), 2 * FEW)
        )
        return f"{type(self).__name__}({names})"

    def _repr_html_(self) -> str:
        cells = (
            "".join(f'<td style="{STYLE}">{escape(cell)}</td>' for cell in row)
            for row in self._summary()
        )
        table = f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"
        name = escape(type(self).__name__)
        drawn = self._picture()
        picture = (
            f'<img alt="{name}" style="width:30em;max-width:100%" '
            f'src="data:image/png;base64,{drawn}">'
        )
        return f"<div><b>{name}</b>{table}{picture if drawn else ''}</div>"


def brief(value: Any, most: int = LINE) -> str:
    """Return a value in few letters; of an array its shape, and the range of its values.

    Examples
    --------
    >>> brief(np.linspace(0, 1, 101)), brief(np.arange(3)), brief(1 / 3), brief("abc"), brief([1] * 9)
    ('(101,) from 0 to 1', '[0 1 2]', '0.333333', "'abc'", '9 values')
    """
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= FEW:
            return np.array2string(value, precision=5)
        known = np.abs(value) if np.iscomplexobj(value) else value
        known = known[np.isfinite(known)]
        return (
            f"{value.shape} from {known.min():.4g} to {known.max():.4g}"
            if known.size
            else f"{value.shape}"
        )
    if isinstance(value, Mapping | list | tuple) and (
        len(value) > FEW or any(hasattr(each, "_fields") for each in value)
    ):
        return f"{len(value)} values"
    if isinstance(value, tuple):
        return f"({', '.join(brief(each, most) for each in value)})"
    text = repr(value)
    return text if len(text) <= most else f"{text[: most - 4]} ..."


@cache
def described(text: str) -> dict[str, str]:
    """Return what the docstring of a class, its `text`, says of each of its attributes or parameters."""
    found: dict[str, str] = {}
    for names, said in re.findall(r"^(\w[\w, ]*) : .*\n((?:    .*\n?)+)", text, re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), " ".join(said.split()))
    return found
