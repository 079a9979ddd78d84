"""What was made lately, by its fields: a loop that makes one chain anew derives its arrays once."""

from __future__ import annotations

from typing import Any, TypeVar

KEPT = 16
Made = TypeVar("Made")

_recent: dict[tuple[Any, ...], Any] = {}  # the latest one last


def made_before(fields: tuple[Any, ...], made: Made) -> Made:
    """Return what was made first, lately, with these fields: `made` itself if nothing was.

    It must be all that follows from the fields, and never change.
    """
    first = _recent[fields] = _recent.pop(fields, made)
    if len(_recent) > KEPT:
        _recent.pop(next(iter(_recent)), None)
    return first
