"""Executors that solve the scenes of a sweep on this machine."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from multiprocessing import current_process, get_context, resource_tracker
from multiprocessing.connection import Connection
from typing import Any

from ..errors import InputError

UNGUARDED = (
    "several processes cannot start: the script must be a file, and call sweep below "
    'if __name__ == "__main__":'
)
IMPORT_FAILED = 1  # Exit code of a process whose script fails or ends it.
SPAWN = get_context("spawn")  # Forks would share LAMMPS, MPI and threads.


class Here(Executor):
    """Executor that calls functions at once in this process."""

    def submit(self, function: Callable[..., Any], /, *values: Any, **named: Any) -> Future:
        """Call the function and return a future that is done; Ctrl-C is not caught."""
        future: Future = Future()
        try:
            future.set_result(function(*values, **named))
        except Exception as error:
            future.set_exception(error)
        return future


class Processes(Executor):
    """Executor with one pool per process, so that a dying process loses only its own task.

    The task of a dead process ends with `BrokenExecutor`, and a new process replaces the dead one.
    All processes end when the main process ends, even if it is killed.
    """

    def __init__(self, workers: int):
        self._local = threading.local()
        self._pools: list[ProcessPoolExecutor] = []
        self._child_end, self._parent_end = SPAWN.Pipe(duplex=False)
        # The start of a process unblocks Ctrl-C in the thread that starts it.
        resource_tracker.ensure_running()
        # Processes inherit the blocked Ctrl-C of their thread: only the main process handles it.
        block = signal.SIG_BLOCK, {signal.SIGINT}
        self._threads = ThreadPoolExecutor(
            workers, initializer=signal.pthread_sigmask, initargs=block
        )

    def __enter__(self) -> Processes:
        """Start a process; raise `InputError` if none can start, or its script ends it."""
        try:
            self.submit(os.getpid).result()
        except OSError as error:
            # Semaphores of processes are files in shared memory.
            self.shutdown(cancel_futures=True)
            cause = f"{error.strerror or error}; is there a writable /dev/shm?"
            raise InputError.at(
                "workers", f"processes cannot start here ({cause}): use --workers 1"
            ) from None
        except BrokenExecutor:
            # A process may be killed without a fault of the script, for example if memory runs out.
            if _fails_on_import():
                self.shutdown()
                raise InputError.at("workers", UNGUARDED) from None
        except BaseException:
            self.shutdown(cancel_futures=True)
            raise
        return self

    def submit(self, function: Callable[..., Any], /, *values: Any, **named: Any) -> Future:
        """Call the function in one of the processes."""
        return self._threads.submit(self._run, function, values, named)

    def _run(self, function: Callable[..., Any], values: tuple, named: dict[str, Any]) -> Any:
        pool = getattr(self._local, "pool", None)
        if pool is None:
            pool = ProcessPoolExecutor(1, SPAWN, _end_with, (self._child_end,))
            self._local.pool = pool
            self._pools.append(pool)
        try:
            return pool.submit(function, *values, **named).result()
        except BrokenExecutor:
            # A broken pool cannot recover, so the next task of this thread starts a new one.
            self._local.pool = None
            self._pools.remove(pool)
            pool.shutdown()
            raise

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """End the processes: at once after an error or a stop, otherwise after their tasks."""
        self.shutdown(cancel_futures=kind is not None)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, and interrupt their tasks if futures are to be cancelled."""
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        if cancel_futures:
            self._parent_end.close()
        self._threads.shutdown()
        for pool in self._pools:
            pool.shutdown()
        self._parent_end.close()
        self._child_end.close()


def _fails_on_import() -> bool:
    """Return whether a process ends itself when it imports the script of this process."""
    process = SPAWN.Process(target=os.getpid)
    process.start()
    process.join()
    return process.exitcode == IMPORT_FAILED


def end_if_imported() -> None:
    """End a process that is about to start others while it imports the script of its parent."""
    if getattr(current_process(), "_inheriting", False):
        # The parent reports the fault.
        sys.exit(IMPORT_FAILED)


def _end_with(line: Connection) -> None:
    """End this process when the parent closes its end of the pipe, or dies."""

    def wait() -> None:
        line.poll(None)
        # The process ends even during a run, because no parent waits for its result.
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
