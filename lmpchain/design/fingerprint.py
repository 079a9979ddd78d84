"""A hash of all that makes an optimisation: numbers, texts, objects and functions of the user."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import partial
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np


def fingerprint(*values: Any) -> str:
    """Return a hash that differs where any of these values does.

    Of a function it is of what it computes: its code, what that refers to in its own module, its
    defaults and what it has taken from the function around it, but not of its name or its place.
    """
    digest = hashlib.sha256()
    for piece in _pieces(values, ()):
        # The length separates pieces, so that different lists give different hashes.
        digest.update(len(piece).to_bytes(8))
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: Any, around: tuple[int, ...]) -> Iterator[bytes]:
    """Yield all that a value is made of, in order; `around` are the objects that hold it."""
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    # a function may refer to itself
    if id(value) in around:
        return
    inside = (*around, id(value))
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield f"{value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
        return
    if value is None or isinstance(value, str | bytes | int | float | complex | np.generic):
        yield repr(value).encode()
        return
    contents, in_order = _contents(value)
    packed = [b"".join(_pieces(content, inside)) for content in contents]
    yield str(len(packed)).encode()
    yield from packed if in_order else sorted(packed)


def _contents(value: Any) -> tuple[list[Any], bool]:
    """Return the contents of a container, function or object, and whether their order counts."""
    if isinstance(value, Mapping):
        return list(value.items()), False
    if isinstance(value, Set):
        return list(value), False
    if isinstance(value, Sequence | np.ndarray):
        return list(value), True
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords], True
    if hasattr(value, "py_func"):
        # compiled by numba
        return [value.py_func], True
    if isinstance(value, MethodType):
        return [value.__self__, value.__func__], True
    if isinstance(value, CodeType):
        return [value.co_code, value.co_consts, value.co_names], True
    if isinstance(value, FunctionType):
        return _of_function(value), True
    if isinstance(value, ModuleType):
        return [value.__name__], True
    if isinstance(value, type) or not hasattr(value, "__dict__"):
        # A class or a function written in C has no contents to read.
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", repr(value))], True
    return [vars(value)], True


def _of_function(function: FunctionType) -> list[Any]:
    outer = function.__globals__
    # Objects of other modules count by name, because they are part of a package.
    names = [name for name in function.__code__.co_names if name in outer]
    referred = {
        name: outer[name]
        if getattr(outer[name], "__module__", function.__module__) == function.__module__
        else getattr(outer[name], "__name__", name)
        for name in names
    }
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    return [function.__code__, function.__defaults__, function.__kwdefaults__, cells, referred]
