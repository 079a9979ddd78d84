"""Exceptions, each with a message that states the fault and the remedy, and suggested names."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

SHOWN_LETTERS = 80  # Largest number of letters of a value in a message.


def short(text: object) -> str:
    """Return a text for a message, shortened if it is long.

    Examples
    --------
    >>> short("gravity"), len(short("g" * 1000))
    ('gravity', 80)
    """
    text = str(text)
    return text if len(text) <= SHOWN_LETTERS else f"{text[: SHOWN_LETTERS - 3]}..."


def shown(value: object) -> str:
    """Return the Python representation of a value for a message, shortened if it is long.

    Examples
    --------
    >>> shown(1.5), shown("a"), shown(list(range(10**6)))
    ('1.5', "'a'", '[0, 1, 2, 3, 4, 5, ...]')
    """
    # The representation must be lazy, because a list may contain a million numbers.
    brief = reprlib.Repr()
    brief.maxstring = brief.maxlong = brief.maxother = SHOWN_LETTERS
    try:
        return short(brief.repr(value))
    # Numbers with thousands of digits and objects with a faulty representation raise exceptions
    # here.
    except Exception:
        return f"a {type(value).__name__} too long to show"


class LmpchainError(Exception):
    """Base class of all errors of this package."""


class InputError(LmpchainError, ValueError):
    """The input is invalid.

    Parameters
    ----------
    faults : iterable of (key, message)
        Each fault is given by its key and a message, which states what is wrong and how to correct
        it.
    """

    def __init__(self, faults: Iterable[tuple[str, str]]):
        # Paths are not shortened.
        self.faults = [
            (key if "/" in key[:SHOWN_LETTERS] else short(key), message) for key, message in faults
        ]
        super().__init__("\n".join(f"{key}: {message}" for key, message in self.faults))

    @classmethod
    def at(cls, key: str, message: str) -> InputError:
        """Return the error for a single key.

        Examples
        --------
        >>> raise InputError.at("gravity", "must not be below 0")
        Traceback (most recent call last):
        lmpchain.errors.InputError: gravity: must not be below 0
        """
        return cls([(key, message)])

    def under(self, prefix: str) -> list[tuple[str, str]]:
        """Return the faults with `prefix` added to their keys."""
        return [(f"{prefix}.{key}" if key else prefix, message) for key, message in self.faults]


class EngineUnavailable(LmpchainError):
    """The engine cannot run on this machine; the message states the remedy."""


class RunFailed(LmpchainError):
    """The run broke down (a value was NaN, a grain passed through another, or energy grew)."""


class ToleranceNotMet(LmpchainError):
    """The tolerance cannot be met.

    Attributes
    ----------
    trajectory : Trajectory or None
        The computed trajectory with its error estimate; None if no run was made.
    reason : str
        Why the tolerance was missed and how to proceed.
    known_until : float
        Predictability horizon, s: the time at which amplified rounding errors exceed the tolerance;
        infinite if the tolerance was missed for another reason.
    """

    def __init__(self, reason: str, trajectory: Any = None, known_until: float = math.inf):
        self.reason = reason
        self.trajectory = trajectory
        self.known_until = known_until
        super().__init__(reason)


def check_tolerance(tolerance: object) -> None:
    """Raise `InputError` unless the tolerance is a number between 0 and 1."""
    if isinstance(tolerance, bool) or not (
        isinstance(tolerance, int | float) and 0 < tolerance < 1
    ):
        raise InputError.at("tolerance", f"must be between 0 and 1 (got {shown(tolerance)})")


# Symbols that physicists write for these quantities.
SYMBOLS = {"E": "youngs_modulus", "nu": "poissons_ratio", "rho": "density", "g": "gravity"}


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return " (did you mean 'glass'?)" if a name resembles a known one, else "".

    Examples
    --------
    >>> did_you_mean("Glas", ["glass", "steel"])
    " (did you mean 'glass'?)"
    >>> did_you_mean("E", ["density", "youngs_modulus"])
    " (did you mean 'youngs_modulus'?)"
    >>> did_you_mean("wood", ["glass", "steel"])
    ''
    """
    names = {candidate.lower(): candidate for candidate in known}
    if name == "radius" and "diameter" in names:
        return " (give the diameter, twice the radius)"
    if isinstance(name, str) and SYMBOLS.get(name) in names:
        return f" (did you mean {SYMBOLS[name]!r}?)"
    close = get_close_matches(name.lower(), names, 1) if isinstance(name, str) else []
    return f" (did you mean {names[close[0]]!r}?)" if close else ""


def unknown_key(key: object, known: Iterable[str], elsewhere: Iterable[str] = ()) -> str:
    """Return the fault of an unknown key, with suggestions; `elsewhere` are further names.

    Examples
    --------
    >>> unknown_key("grain", ["grains", "diameter"])
    "unknown key (did you mean 'grains'?); the keys here are grains, diameter"
    """
    names = list(known)
    guess = did_you_mean(key, [*names, *elsewhere])
    return f"unknown key{guess}; the keys here are {', '.join(names)}"


def either(names: Iterable[str]) -> str:
    """Return names as alternatives in a text.

    Examples
    --------
    >>> either(["glass", "steel", "brass"])
    'glass, steel or brass'
    """
    *others, last = names
    return " or ".join(filter(None, (", ".join(others), last)))


def not_among(name: object, known: Iterable[str]) -> str:
    """Return the fault of a name that is not among the known ones.

    Examples
    --------
    >>> not_among("Glas", ["glass", "steel"])
    "must be glass | steel (got 'Glas') (did you mean 'glass'?)"
    """
    names = list(known)
    return f"must be {' | '.join(names)} (got {shown(name)}){did_you_mean(name, names)}"
