"""Compilation by numba, once per machine, with the result kept for later processes."""

from __future__ import annotations

import re
import secrets
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core.bytecode import FunctionIdentity
from numba.core.event import Event, Listener, register

BESIDE = re.compile(r"^from \.(\w+) import", re.MULTILINE)
# numba counts from 1 what each process compiles, to tell functions of one name apart. What two
# processes have kept may then have the same names, and one that loads both calls one for the other:
# a force of another exponent, or a step of another method
# (https://github.com/numba/numba/issues/10486). Random numbers differ in forks, too.
FunctionIdentity._unique_ids = iter(partial(secrets.randbits, 64), -1)  # type: ignore[assignment]

_messages: dict[Callable, str] = {}  # for the compilation of each function
_announced: set[str] = set()


class _Announcer(Listener):
    """Announce compilations that take long; loading a kept result is silent."""

    def on_start(self, event: Event) -> None:
        message = _messages.get(event.data["dispatcher"].py_func)
        if message is not None and message not in _announced:
            _announced.add(message)
            print(message, file=sys.stderr, flush=True)

    def on_end(self, event: Event) -> None:
        pass


class _Stopwatch(Listener, threading.local):
    """Add up, thread by thread, how long compilations and the loading of kept results take."""

    def __init__(self) -> None:
        self.depth = 0
        self.total_s = 0.0

    def on_start(self, event: Event) -> None:
        if self.depth == 0:
            self.began = time.perf_counter()
        self.depth += 1

    def on_end(self, event: Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            self.total_s += time.perf_counter() - self.began


_stopwatch = _Stopwatch()
register("numba:compile", _Announcer())
register("numba:compiler_lock", _stopwatch)


def compiled_s() -> float:
    """Return the time that this thread has compiled or loaded kept results so far, s."""
    return _stopwatch.total_s


def clock() -> float:
    """Return a time, s, that stands still while this thread compiles or loads kept results."""
    return time.perf_counter() - _stopwatch.total_s


@cache
def _sources(module: Path) -> str:
    """Return a hash of a module, of its imports from its folder at any depth, and of this one."""
    sources = {}
    waiting = [module, Path(__file__)]
    while waiting:
        path = waiting.pop()
        if path not in sources and path.exists():
            sources[path] = path.read_bytes()
            names = BESIDE.findall(sources[path].decode())
            waiting += (path.with_name(f"{name}.py") for name in names)
    return sha256(b"".join(sources[path] for path in sorted(sources))).hexdigest()


def compiled_once(what: str, seconds: int, **options: Any) -> Callable[[Callable], Any]:
    """Return a decorator for `numba.njit` with a persistent cache and a message on stderr.

    The result is kept beside the source; if that folder may not be written to, in the user's cache
    or in NUMBA_CACHE_DIR. It is used until the module changes, or one beside it that it imports.
    Where nothing can be kept, every process compiles anew.

    Parameters
    ----------
    what : str
        What is compiled; functions with the same text are announced once a process.
    seconds : int
        About how long all of it takes.
    **options
        For `numba.njit`.
    """

    def decorate(function: Callable) -> Any:
        when = "once for this machine"
        try:
            dispatcher = numba.njit(cache=True, **options)(function)
            # numba checks only the source of this module, but a function may call modules beside
            # it. The version is looked at before the rest of the file is read, which may name
            # records that are no longer there.
            file: Any = dispatcher._cache._cache_file
            file._version = f"{file._version} {_sources(Path(function.__code__.co_filename))}"
        except RuntimeError:
            when = "in every process, for there is no folder to keep it in (see lmpchain doctor)"
            dispatcher = numba.njit(**options)(function)
        _messages[function] = f"compiling {what}, {when}: about {seconds} s"
        return dispatcher

    return decorate
