"""Lazy import of names on first use."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any


def attributes(
    package: str, submodules: Iterable[str] = (), names: Mapping[str, str] | None = None
) -> Callable[[str], Any]:
    """Return a `__getattr__` for a package that imports its names on first use.

    Parameters
    ----------
    package : str
        Its full name.
    submodules : names of modules in it
    names : mapping, optional
        For a module below the package, the names that it hands on, separated by spaces.

    Examples
    --------
    >>> find = attributes("lmpchain", ["theory"], {"chain.chain": "Chain"})
    >>> find("Chain").__module__
    'lmpchain.chain.chain'
    """
    known = set(submodules)
    where = {name: module for module, given in (names or {}).items() for name in given.split()}

    def find(name: str) -> Any:
        if name in known:
            return import_module(f".{name}", package)
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f".{where[name]}", package), name)
        setattr(sys.modules[package], name, value)  # found at once from now on
        return value

    return find


def listed(module: str) -> Callable[[], list[str]]:
    """Return a `__dir__` for a module that lists what it offers and nothing else.

    That is its `__all__`, or the functions and classes that it defines.

    Examples
    --------
    >>> from lmpchain.util import tables
    >>> listed(tables.__name__)()
    ['align', 'finite', 'number']
    """

    def names() -> list[str]:
        own = vars(sys.modules[module])
        return sorted(
            own.get(
                "__all__", [name for name, value in own.items() if _offered(name, value, module)]
            )
        )

    return names


def _offered(name: str, value: Any, module: str) -> bool:
    return (
        callable(value) and getattr(value, "__module__", "") == module and not name.startswith("_")
    )
