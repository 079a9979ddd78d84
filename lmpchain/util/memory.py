"""Memory of this process."""

from __future__ import annotations

import ctypes
from functools import cache

# of mallopt(3), and bytes: arrays up to this size come from the heap, of which so much may stay free
HEAP, FREE = (-3, 2**25), (-1, 2**27)


@cache
def keep_freed() -> None:
    """Have this process keep what is freed, up to 128 MB, for arrays to come, if its C library is glibc.

    A fresh page from the system costs more time than the numbers that go into it.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    for option in (HEAP, FREE):
        mallopt(*option)
