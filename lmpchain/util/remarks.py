"""Warnings and notes of lmpchain, which each thread can suppress separately."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Python's warning filters are shared by all threads. If two threads change and restore the list in
# turn, warnings may stay suppressed for all threads.
_aside: ContextVar[list[str] | None] = ContextVar("warnings that are put aside", default=None)


def warn(text: str, stacklevel: int = 1) -> None:
    """Warn as `warnings.warn` does, unless this thread suppresses warnings."""
    texts = _aside.get()
    if texts is None:
        warnings.warn(text, stacklevel=stacklevel + 1)
    else:
        texts.append(text)


def note(text: str) -> None:
    """Print a note in one line on stderr, unless this thread suppresses warnings."""
    if _aside.get() is None and sys.stderr is not None:
        # A file name may contain a line break, or a code that moves the cursor.
        letters = (
            letter if letter.isprintable() else letter.encode("unicode_escape").decode()
            for letter in text
        )
        print(f"note: {''.join(letters)}", file=sys.stderr)


@contextmanager
def warnings_aside() -> Iterator[list[str]]:
    """Suppress the warnings of lmpchain in this thread; yield the list of their texts.

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
