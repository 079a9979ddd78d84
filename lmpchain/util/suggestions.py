"""Suggestions for misspelt names."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from ..errors import shown

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
