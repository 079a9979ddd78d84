"""Compilation by numba, once per machine, with a cache for later processes."""

from __future__ import annotations

import gc
import pickle
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.event import Event, Listener, register
from numba.core.runtime import rtsys
from numba.core.targetconfig import TargetConfig

from .progress import PERCENT, ProgressBar
from .remarks import warn

BESIDE = re.compile(r"^from \.(\w+) import", re.MULTILINE)
KERNELS = Path(__file__).parents[1] / "integrators" / "kernels"
OF_KERNELS = re.compile(r"^from \.\.\.integrators\.kernels\.(\w+) import", re.MULTILINE)
# Numba numbers the functions that a process compiles, from 1, to distinguish functions of equal
# name. Functions that two processes have cached may then have the same names. A process that loads
# both calls the wrong one: a force with another exponent, or a step of another method
# (https://github.com/numba/numba/issues/10486). Random numbers are unique, also in forks.
FunctionIdentity._unique_ids = iter(partial(secrets.randbits, 64), -1)  # type: ignore[assignment]


def _equal_flags(one: Flags, other: object) -> bool:
    """Return whether two sets of flags are equal, without reading each flag of identical sets."""
    given = isinstance(other, Flags) and one._values == other._values
    return given or TargetConfig.__eq__(one, other)


# Numba compares flags some 50,000 times in a first run, which takes 7 % of the compilation.
Flags.__eq__ = _equal_flags  # type: ignore[assignment,method-assign]

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    # The kernels use records that Python does not have.
    warn("NUMBA_DISABLE_JIT is ignored, because kernels must be compiled: unset it")
    numba.config.DISABLE_JIT = 0  # type: ignore[attr-defined]

BLAS = "scipy.linalg.cython_blas"
if BLAS not in sys.modules:
    # Numba would import scipy.linalg to check that it exists, which takes a fifth of a command's
    # time.
    sys.modules[BLAS] = None  # type: ignore[assignment]
    from numba.np import arraymath

    arraymath._HAVE_BLAS = True  # type: ignore[attr-defined]
    del sys.modules[BLAS]

LONG_S = 3  # Longer compilations are announced with a progress bar.
# Number of new objects between two searches for garbage during a compilation. Numba makes millions
# of objects; with Python's 700, the searches take 10 % of the time.
GARBAGE = 500_000


class _Job(NamedTuple):
    """A compilation: its text in messages, and the expected time of all with that text, s."""

    message: str
    seconds: int


_jobs: dict[Callable, _Job] = {}  # Compilation jobs by function.
_announced: set[str] = set()
_complained: set[Path] = set()
DIGEST = sha256().digest_size


class _Announcer(Listener):
    """Announcer of long compilations; loading a cached result is silent.

    During a compilation, Python collects garbage less often, which saves time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.garbage = gc.get_threshold()
        self.bar: ProgressBar | None = None
        self.silent = False

    def on_start(self, event: Event) -> None:
        job = _jobs.get(event.data["dispatcher"].py_func)
        if job is not None and job.seconds >= LONG_S:
            if job.message not in _announced and not self.silent:
                _announced.add(job.message)
                print(job.message, file=sys.stderr, flush=True)
            if self.depth == 0:
                on_terminal = sys.stderr.isatty()
                self.bar = ProgressBar(
                    job.seconds, "compiling", layout=PERCENT, delay_s=LONG_S, shown=on_terminal
                )
                self.began = time.perf_counter()
        if self.depth == 0:
            self.garbage = gc.get_threshold()
            gc.set_threshold(max(GARBAGE, self.garbage[0]), *self.garbage[1:])
        self.depth += 1

    def on_end(self, event: Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            gc.set_threshold(*self.garbage)
        if self.bar is not None:
            # Compilations are nested, so only the clock shows the remaining time.
            self.bar.reach(min(time.perf_counter() - self.began, self.bar.total))
            if self.depth == 0:
                self.bar.close()
                self.bar = None


class _Stopwatch(Listener, threading.local):
    """Stopwatch of the time that each thread spends on compiling and loading cached results."""

    def __init__(self) -> None:
        self.depth = 0
        self.total_s = 0.0
        self.cpu_s = 0.0

    def on_start(self, event: Event) -> None:
        if self.depth == 0:
            self.began = time.perf_counter(), time.thread_time()
        self.depth += 1

    def on_end(self, event: Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            began, cpu_began = self.began
            self.total_s += time.perf_counter() - began
            self.cpu_s += time.thread_time() - cpu_began


_stopwatch = _Stopwatch()
_announcer = _Announcer()
register("numba:compile", _announcer)
register("numba:compiler_lock", _stopwatch)


def compiled_s() -> float:
    """Return the time that this thread has spent on compiling or loading cached results, s."""
    return _stopwatch.total_s


def compiled_cpu_s() -> float:
    """Return the CPU time that this thread has spent on compiling or loading cached results, s."""
    return _stopwatch.cpu_s


def clock() -> float:
    """Return a time, s, that stops while this thread compiles or loads cached results."""
    return time.perf_counter() - _stopwatch.total_s


@cache
def _sources(module: Path) -> str:
    """Return a hash of the source of a module, of its relative imports, and of this module."""
    sources = {}
    waiting = [module, Path(__file__)]
    while waiting:
        path = waiting.pop()
        if path not in sources and path.exists():
            sources[path] = path.read_bytes()
            text = sources[path].decode()
            waiting += (path.with_name(f"{name}.py") for name in BESIDE.findall(text))
            waiting += (KERNELS / f"{name}.py" for name in OF_KERNELS.findall(text))
    return sha256(b"".join(sources[path] for path in sorted(sources))).hexdigest()


class _Unplaced:
    """Stand-in for the memory of compiled code that is never executed in place."""

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing, because no environment of Python is needed."""


class _Ingredients(JITCodeLibrary):
    """Compiled code that becomes part of other code, which LLVM optimises and emits."""

    codegen = _Unplaced()

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0, because the code has no address."""
        return 0


class Ingredient(Compiler):
    """Compiler for functions that only compiled functions call, for `numba.njit`.

    Without this class, Numba would also optimise and emit each function separately, which takes a
    ninth of the total time, and would create wrappers for calls from Python and C.
    """

    def __init__(
        self,
        typing: Any,
        target: Any,
        _library: Any,
        args: Any,
        result: Any,
        flags: Any,
        names: Any,
    ):
        flags.no_cpython_wrapper = True
        flags.no_cfunc_wrapper = True
        library = _Ingredients(target.codegen(), "ingredient")
        super().__init__(typing, target, library, args, result, flags, names)


class _KeptFile(IndexDataCacheFile):
    """A cache file of compiled code with its hash; a damaged file counts as missing.

    The cache of Numba would raise any error of pickle, or execute code from a manipulated file.
    """

    def load(self, key: Any) -> Any:
        """Return the cached value of a key, or None."""
        try:
            return super().load(key)
        except OSError as error:
            _complain(error.filename or self._index_path, error)
            return None

    def save(self, key: Any, data: Any) -> None:
        """Store compiled code if there is disk space."""
        try:
            super().save(key, data)
        except OSError as error:
            _complain(error.filename or self._index_path, error)

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except Exception as error:
            # A damaged file makes pickle raise any kind of error.
            _complain(self._index_path, error)
            return {}

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        content = path.read_bytes()
        if sha256(content[DIGEST:]).digest() != content[:DIGEST]:
            _complain(path, "it was changed after it was written")
            return None
        return pickle.loads(content[DIGEST:])

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as opened:
            opened.write(sha256(content).digest() + content)


class _KeptCode(FunctionCache):
    """The cache of a function; functions of one factory are distinguished by their `kind`.

    The cache of Numba distinguishes such functions by their closures, which differ between
    processes.
    """

    kind = ""

    def _index_key(self, sig: Any, codegen: Any) -> tuple:
        return sig, codegen.magic_tuple(), self.kind

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code for a signature, or None."""
        # Numba would first read its own functions, an eighth of a command's time. Only compilation
        # needs these functions, and reads them itself. Compiled code needs only the memory of the
        # runtime.
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def _complain(path: str | PathLike[str], reason: object) -> None:
    """Warn, once for each folder, that compiled code cannot be used or stored."""
    folder = Path(path).parent
    if folder not in _complained:
        _complained.add(folder)
        why = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
        warn(
            f"{path}: compiled code cannot be used or stored there ({why}), and compiling it takes "
            f"minutes: free space in {folder}, remove damaged files, or set NUMBA_CACHE_DIR",
            stacklevel=2,
        )


def announce_nothing() -> None:
    """Suppress all later announcements of compilations in this process."""
    _announcer.silent = True


def compiled_once(
    what: str, seconds: int, kind: str = "", **options: Any
) -> Callable[[Callable], Any]:
    """Return a decorator for `numba.njit` with a persistent cache and a message on stderr.

    The compiled code is stored in the folder of the source, or, if this folder is not writable, in
    the cache of the user or in NUMBA_CACHE_DIR. It is used until the module changes, or a module of
    the same folder that it imports. Damaged files are compiled again. If no folder is writable,
    every process compiles again.

    Parameters
    ----------
    what : str
        Name of the compiled functions in the message. Functions with the same name are announced
        once in each process.
    seconds : int
        Approximate time for all functions of this name, s. Below 3 s there is no message.
    kind : str, optional
        Text that distinguishes functions of the same factory.
    **options
        Options of `numba.njit`.
    """

    # Kernels are never passed as C functions.
    compiler: Any = partial(numba.njit, no_cfunc_wrapper=True, **options)

    def decorate(function: Callable) -> Any:
        when = "once for this machine"
        try:
            dispatcher = compiler(cache=True)(function)
            # Numba checks only the source of this module, but a function may call modules beside
            # it. The version is checked before the rest of the file is read, which may refer to
            # records that no longer exist.
            code: Any = dispatcher._cache
            code.__class__ = _KeptCode
            code.kind = kind
            file: Any = code._cache_file
            file._version = (
                f"{file._version} {_sources(Path(str(sys.modules[function.__module__].__file__)))}"
            )
            file.__class__ = _KeptFile
        except RuntimeError:
            when = "in every process, because no folder is writable (see lmpchain doctor)"
            dispatcher = compiler()(function)
        _jobs[function] = _Job(f"compiling {what}, {when}: about {seconds} s", seconds)
        return dispatcher

    return decorate
