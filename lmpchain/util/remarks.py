"""Warnings and notes of lmpchain, which one thread can put aside without a word to the others."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Python's own filters are one list for all threads: where two of them change and restore it in
# turns, what one has put aside stays so, for all and for good
_aside: ContextVar[list[str] | None] = ContextVar("warnings that are put aside", default=None)


def warn(text: str, stacklevel: int = 1) -> None:
    """Warn as `warnings.warn` does, unless this thread puts warnings aside."""
    texts = _aside.get()
    if texts is None:
        warnings.warn(text, stacklevel=stacklevel + 1)
    else:
        texts.append(text)


def note(text: str) -> None:
    """Say on stderr, in one line, what was understood; nothing where warnings are put aside."""
    if _aside.get() is None and sys.stderr is not None:
        # a name of a file may hold a line break, or a code that moves the cursor
        letters = (
            letter if letter.isprintable() else letter.encode("unicode_escape").decode()
            for letter in text
        )
        print(f"note: {''.join(letters)}", file=sys.stderr)


@contextmanager
def warnings_aside() -> Iterator[list[str]]:
    """Put the warnings of lmpchain in this thread aside; the list that is yielded has their texts.

    Examples
    --------
    >>> with warnings_aside() as texts:
    ...     warn("far from linear")
    >>> texts
    ['far from linear']
    """
    texts: list[str] = []
    token = _aside.set(texts)
    try:
        yield texts
    finally:
        _aside.reset(token)
