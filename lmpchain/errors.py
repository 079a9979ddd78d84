"""Exceptions, each with a message that names the fault and the cure."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from typing import Any

SHOWN_LETTERS = 80  # letters of a value that an error line shows


def short(text: object) -> str:
    """Return a text for an error line, cut short where it is long.

    Examples
    --------
    >>> short("gravity"), len(short("g" * 1000))
    ('gravity', 80)
    """
    text = str(text)
    return text if len(text) <= SHOWN_LETTERS else f"{text[: SHOWN_LETTERS - 3]}..."


def shown(value: object) -> str:
    """Return a value for an error line, as Python writes it, cut short where it is long.

    Examples
    --------
    >>> shown(1.5), shown("a"), shown(list(range(10**6)))
    ('1.5', "'a'", '[0, 1, 2, 3, 4, 5, ...]')
    """
    # lists of a million numbers must not be written out to show six
    brief = reprlib.Repr()
    brief.maxstring = brief.maxlong = brief.maxother = SHOWN_LETTERS
    try:
        return short(brief.repr(value))
    # of a number with thousands of digits, or of an object that cannot say what it is
    except Exception:
        return f"a {type(value).__name__} too long to show"


class LmpchainError(Exception):
    """Base class of all errors of this package."""


class InputError(LmpchainError, ValueError):
    """The input is wrong.

    Parameters
    ----------
    faults : iterable of (key, message)
        Every fault found: which key, what is wrong with it and what to do.
    """

    def __init__(self, faults: Iterable[tuple[str, str]]):
        # or a path
        self.faults = [
            (key if "/" in key[:SHOWN_LETTERS] else short(key), message) for key, message in faults
        ]
        super().__init__("\n".join(f"{key}: {message}" for key, message in self.faults))

    @classmethod
    def at(cls, key: str, message: str) -> InputError:
        """Return the error of a single key.

        Examples
        --------
        >>> raise InputError.at("gravity", "must not be below 0")
        Traceback (most recent call last):
        lmpchain.errors.InputError: gravity: must not be below 0
        """
        return cls([(key, message)])

    def under(self, prefix: str) -> list[tuple[str, str]]:
        """Return the faults with their keys moved below `prefix`."""
        return [(f"{prefix}.{key}" if key else prefix, message) for key, message in self.faults]


class EngineUnavailable(LmpchainError):
    """The engine cannot run on this machine; the text names the cure."""


class RunFailed(LmpchainError):
    """The run broke down (not a number, a grain passed through another, energy grew)."""


class ToleranceNotMet(LmpchainError):
    """The tolerance cannot be met.

    Attributes
    ----------
    trajectory : Trajectory or None
        What was computed, with its error estimate; None if nothing was run.
    reason : str
        Why the tolerance was missed and what to do.
    known_until : float
        Time at which round-off that the scene amplifies exceeds the tolerance, s; infinite if that
        is not the reason.
    """

    def __init__(self, reason: str, trajectory: Any = None, known_until: float = math.inf):
        self.reason = reason
        self.trajectory = trajectory
        self.known_until = known_until
        super().__init__(reason)


def check_tolerance(tolerance: object) -> None:
    """Raise `InputError` unless this is a number between 0 and 1."""
    if isinstance(tolerance, bool) or not (
        isinstance(tolerance, int | float) and 0 < tolerance < 1
    ):
        raise InputError.at("tolerance", f"must be between 0 and 1 (got {shown(tolerance)})")
