"""Names imported on first use, and properties computed on first use."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any


def attributes(
    package: str, submodules: Collection[str] = (), names: Mapping[str, str] | None = None
) -> Callable[[str], Any]:
    """Return a `__getattr__` for a package that imports its names on first use.

    Parameters
    ----------
    package : str
        Full name of the package.
    submodules : collection of str
        Names of modules in the package.
    names : mapping, optional
        Names that the package exports, separated by spaces, for each module that defines them.

    Examples
    --------
    >>> find = attributes("lmpchain", ["theory"], {"chain.chain": "Chain"})
    >>> find("Chain").__module__
    'lmpchain.chain.chain'
    """
    modules = {name: module for module, words in (names or {}).items() for name in words.split()}

    def find(name: str) -> Any:
        if name in submodules:
            return import_module(f".{name}", package)
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f".{modules[name]}", package), name)
        # Later accesses find the name without this function.
        setattr(sys.modules[package], name, value)
        return value

    return find


def listed(module: str) -> Callable[[], list[str]]:
    """Return a `__dir__` for a module that lists only its public names.

    The public names are its `__all__`, or the functions and classes that it defines.

    Examples
    --------
    >>> from lmpchain.util import tables
    >>> listed(tables.__name__)()
    ['align', 'counted', 'duration', 'finite', 'line_width', 'number', 'wrap']
    """

    def names() -> list[str]:
        namespace = vars(sys.modules[module])
        # An imported name was defined in another module.
        defined = (
            name
            for name, value in namespace.items()
            if callable(value)
            and getattr(value, "__module__", "") == module
            and not name.startswith("_")
        )
        return sorted(namespace.get("__all__", defined))

    return names


if TYPE_CHECKING or sys.version_info >= (3, 12):
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):
        """A property computed once, like `functools.cached_property` of Python 3.12.

        The property of Python 3.11 has a lock that is shared by all objects. If a process is forked
        while another thread holds the lock, the new process waits for the lock forever. This class
        has no lock, so that two threads may compute a value twice.
        """

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            # Python calls this method only if the instance has no value yet.
            values = instance.__dict__
            values[self.attrname] = self.func(instance)
            return values[self.attrname]
