"""Communicators of a LAMMPS run: this process alone, or the ranks of an MPI world.

One process leads: it asks for something by name, every rank does it, and the answers of all come
back. The others only follow, so nothing outside this module knows of ranks.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from ...errors import EngineUnavailable, LmpchainError, RunFailed
from ...util import mpi
from .worker import Worker

PATIENCE_S = 2e-3  # how long a follower waits at full speed before it dozes
DOZE_S = 5e-4
SIGNALS = {signal.SIGINT, signal.SIGTERM}


class Communicator(Protocol):
    """Ranks that do what they are asked to, all of them at once."""

    ranks: int

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Let every rank call this method of its `Worker` and return what they answered."""

    def close(self) -> None:
        """End the LAMMPS instances."""


class Serial:
    """This process."""

    ranks = 1

    def __init__(self, log: str):
        self._rank = Worker(mpi.alone(), log)

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Do it."""
        try:
            return [getattr(self._rank, name)(*values)]
        except Exception as error:
            if not _by_lammps(error):
                raise
            raise RunFailed(f"LAMMPS stopped: {error}") from None

    def close(self) -> None:
        """End the LAMMPS instance."""
        self._rank.close()


class MpiRanks:
    """All processes of an MPI world, led by rank 0."""

    def __init__(self, world: Any, log: str):
        self._world = world
        self.ranks = world.size
        self._held: list[Worker] = []
        self.ask("open", log)

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Let every rank do it; none is left behind by a signal."""
        with signals_blocked():
            for rank in range(1, self.ranks):
                self._world.send((name, values), rank)
            answers = self._world.gather(_obey(self._world, self._held, name, values))
        if failed := next((answer for answer in answers if isinstance(answer, Exception)), None):
            if isinstance(failed, LmpchainError):
                raise failed
            raise RunFailed(f"LAMMPS stopped: {failed}") from None
        return answers

    def close(self) -> None:
        """End the LAMMPS instances."""
        self.ask("close")


def worker_loop(world: Any) -> None:
    """Do what rank 0 asks for until it says that that was all."""
    for number in SIGNALS:  # rank 0 takes them, and ends the others
        signal.signal(number, signal.SIG_IGN)
    held: list[Worker] = []
    while True:
        waited = time.perf_counter()
        while not world.iprobe(source=0):
            if time.perf_counter() - waited > PATIENCE_S:
                time.sleep(DOZE_S)
        name, values = world.recv(source=0)
        if name == "shutdown_workers":
            return
        world.gather(_obey(world, held, name, values))


def shutdown_workers(world: Any) -> None:
    """Tell the followers that that was all."""
    for rank in range(1, world.size):
        world.send(("shutdown_workers", ()), rank)


def _obey(world: Any, held: list[Worker], name: str, values: tuple[Any, ...]) -> Any:
    """Call a method on this rank; an error that not all ranks share aborts them all."""
    try:
        if name == "open":
            held[:] = [Worker(world, *values)]
            return None
        if name == "close":
            return held.pop().close() if held else None
        return getattr(held[0], name)(*values)
    except Exception as error:
        alike = type(error) is Exception and _by_lammps(error)  # another class where one rank fails
        if (
            alike
            or isinstance(error, RunFailed)
            or (name == "open" and isinstance(error, EngineUnavailable))
        ):
            return error
        mpi.abort(world, f"rank {world.rank}: {error or type(error).__name__}")


def _by_lammps(error: Exception) -> bool:
    """Say whether LAMMPS raised it, whose messages begin so: the handler of a signal may raise any class."""
    return str(*error.args[:1]).startswith("ERROR")


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Let signals wait, so that Ctrl-C does not come while some ranks know what to do and others do not."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
