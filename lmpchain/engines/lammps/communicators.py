"""Communicators of a LAMMPS run: a single process, or the ranks of an MPI world.

The first process calls a method of the worker by name. Every rank calls this method of its own
worker, and the first process collects the return values of all ranks. Code outside this module
uses the ranks as if they were a single process.
"""

from __future__ import annotations

import signal
import time
from typing import Any

from ...errors import EngineUnavailable, LmpchainError, RunFailed
from ...util import mpi
from .library import SIGNALS, signals_blocked
from .worker import Worker

# A follower polls at full speed for the first time, s, and then at intervals of the second, s.
POLLING_S = 2e-3
PAUSE_S = 5e-4


class Serial:
    """Communicator of a single process."""

    ranks = 1

    def __init__(self, log: str):
        self._rank = Worker(mpi.alone(), log)

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Call a method of the only worker."""
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
        self._workers: list[Worker] = []
        self.ask("open", log)

    def ask(self, name: str, *values: Any) -> list[Any]:
        """Call a method of all workers without interruption by signals."""
        # A signal between two messages would leave some ranks waiting forever.
        with signals_blocked():
            for rank in range(1, self.ranks):
                self._world.send((name, values), rank)
            answers = self._world.gather(_obey(self._world, self._workers, name, values))
        for answer in answers:
            if isinstance(answer, LmpchainError):
                raise answer
            if isinstance(answer, Exception):
                raise RunFailed(f"LAMMPS stopped: {answer}") from None
        return answers

    def close(self) -> None:
        """End the LAMMPS instances."""
        self.ask("close")


def worker_loop(world: Any) -> None:
    """Execute the calls of rank 0 until it shuts the workers down."""
    for number in SIGNALS:
        # Rank 0 handles signals and ends the other ranks.
        signal.signal(number, signal.SIG_IGN)
    workers: list[Worker] = []
    while True:
        began = time.perf_counter()
        while not world.iprobe(source=0):
            if time.perf_counter() - began > POLLING_S:
                time.sleep(PAUSE_S)
        name, values = world.recv(source=0)
        if name == "shutdown_workers":
            return
        world.gather(_obey(world, workers, name, values))


def shutdown_workers(world: Any) -> None:
    """End the loops of the other ranks."""
    for rank in range(1, world.size):
        world.send(("shutdown_workers", ()), rank)


def _obey(world: Any, workers: list[Worker], name: str, values: tuple[Any, ...]) -> Any:
    """Call a method on this rank; an error that does not occur on all ranks aborts them all."""
    try:
        if name == "open":
            workers[:] = [Worker(world, *values)]
            return None
        if name == "close":
            return workers.pop().close() if workers else None
        return getattr(workers[0], name)(*values)
    except Exception as error:
        # LAMMPS raises a different class if a single rank fails.
        shared = type(error) is Exception and _by_lammps(error)
        if shared or isinstance(error, EngineUnavailable | RunFailed):
            return error
        # The other ranks are waiting inside LAMMPS for this rank.
        mpi.abort(world, f"rank {world.rank}: {str(error) or type(error).__name__}")


def _by_lammps(error: Exception) -> bool:
    """Return whether LAMMPS raised an error, by its text, as signal handlers raise any class."""
    return str(*error.args[:1]).startswith("ERROR")
