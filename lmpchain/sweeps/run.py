"""Runs of a sweep: the remaining scenes, and the processes and executors that solve them."""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager, nullcontext
from itertools import islice
from multiprocessing import current_process, get_context, resource_tracker
from multiprocessing.connection import Connection
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, LmpchainError, RunFailed, short, shown
from ..util.files import (
    check_tree,
    describe_holder,
    make_folder,
    read_sealed_json,
    sealed_json,
    take_lock,
    write_aside,
)
from ..util.progress import ProgressBar
from ..util.remarks import warn, warnings_aside
from ..util.validation import check_whole
from .file import FORMAT, Sweep, read_sweep
from .results import Labels, drop, list_earlier, load_sweep, make_labels, take_over
from .store import (
    NAME,
    NOT_DONE,
    PARTS,
    Coordinates,
    StoreLayout,
    clean,
    complete,
    create_results,
    forget_damaged,
    intact,
    join_parts,
    make_layout,
    whole_parts,
)
from .tasks import TASKS, SweepTask, announce_work, answer, count_scenes

if TYPE_CHECKING:
    import xarray

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


def sweep(
    source: str | PathLike[str] | Mapping[str, Any],
    folder: str | PathLike[str],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    executor: Executor | None = None,
    progress: bool = False,
) -> xarray.Dataset:
    """Simulate the scenes of a sweep; those that are already in the folder are skipped.

    The results are the same, to the last bit, for any number of workers, any order of the scenes
    and any number of interruptions. A scene that is not valid, misses its tolerance or breaks down
    is recorded with its reason. A scene that fails for another reason, such as a full disk or a
    process that dies three times, is solved when `sweep` is called again.

    Parameters
    ----------
    source : path or mapping
        Sweep file, or a mapping with the same keys, in which `scene` may be a `Scene`.
    folder : path
        Folder of the results, which is created if necessary. Other processes and machines that
        solve scenes must see it under the same path.
    workers : int
        Number of processes on this machine; with 1, this process solves all scenes. With more, a
        script must call `sweep` below ``if __name__ == "__main__":``.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``"tcp://127.0.0.1:8786"``, whose workers solve the
        scenes in place of local processes.
    executor : concurrent.futures.Executor, optional
        Any other executor that runs the scenes in place of local processes.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    xarray.Dataset
        See `load_sweep`.

    Raises
    ------
    InputError
        If the sweep is not valid (the error lists every fault), another process uses the folder,
        the folder cannot be written, the processes cannot start, or no scheduler answers.
    RunFailed
        If the connection to the scheduler is lost; results that were computed are kept.
    """
    workers = check_whole("workers", workers, 1)
    if scheduler is not None and executor is not None:
        raise InputError.at("scheduler", "cannot be combined with an executor: give one of the two")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InputError.at("executor", f"must have a method submit (got {shown(executor)})")
    local = scheduler is None and executor is None
    if workers > 1 and local:
        end_if_imported()
    plan = read_sweep(source)
    batch = _try_scenes(plan)
    folder = make_folder(folder).absolute()
    with _lock(folder):
        results, layout, grains = _prepare(plan, folder, batch)
        work = _Work(results, layout)
        pending = 1 if local and workers == 1 else TASKS.pending
        with warnings_aside():
            tried = list(islice(plan.trials(), TASKS.priced))
        with (
            announce_work(plan, tried, layout.count - work.scenes, workers),
            _executor(workers, scheduler, executor) as chosen,
            ProgressBar(layout.count, unit=" scenes", done=work.scenes, shown=progress) as bar,
        ):
            tasks = (
                SweepTask(results, plan.folder, layout, grains, first) for first in work.firsts
            )
            faults = work.do(chosen, tasks, bar, pending)
        # Workers that died may have left incomplete files.
        clean(results, layout)
    answers = load_sweep(folder)
    if faults:
        warn(f"some scenes could not be solved this time; the first: {faults[0]}", stacklevel=2)
        cause = f"{NOT_DONE}: {faults[0]}"
        answers["reason"] = answers["reason"].where(answers["reason"] != NOT_DONE, cause)
    return answers


def _executor(
    workers: int, scheduler: str | None, executor: Executor | None
) -> AbstractContextManager[Executor]:
    """Return the executor of a sweep; an executor given by the user stays open."""
    if scheduler is not None:
        return dask(scheduler)
    if executor is not None:
        return nullcontext(executor)
    return Processes(workers) if workers > 1 else Here()


def _try_scenes(plan: Sweep) -> int:
    """Make a scene with each value, with warnings; return the number of scenes in a batch."""
    with warnings_aside() as texts:
        batch = min(count_scenes(plan.engine, scene) for scene in plan.trials())
    # Only the first warning of each kind is shown, because they differ in numbers alone.
    remarks = {re.sub(r"\d\S*", "", text): text for text in reversed(texts)}
    for remark in remarks.values():
        warn(f"{remark}; other scenes may be affected as well", stacklevel=3)
    return batch


def _prepare(plan: Sweep, folder: Path, batch: int) -> tuple[Path, StoreLayout, np.ndarray]:
    """Make the folder of the results; return its path, its layout, and the grains."""
    labels = make_labels(plan)
    layout = make_layout(
        plan.keep, plan.count, batch, labels.samples, labels.grains.size, labels.extra
    )
    results = folder / plan.name
    _check_same_sweep(results, plan)
    _check_index(folder / NAME)
    (results / PARTS).mkdir(parents=True, exist_ok=True)
    if not intact(results):
        swept = {axis.name: len(axis) for axis in plan.axes}
        try:
            create_results(results, layout, _coordinates(plan, labels), swept)
        except (IsADirectoryError, NotADirectoryError, FileExistsError) as error:
            cause = f"{short(error.filename2 or error.filename)}: {error.strerror}"
            raise InputError.at(
                str(results), f"is damaged ({cause}): remove it, and sweep again"
            ) from None
    if not (results / NAME).exists():
        for earlier in list_earlier(folder, results):
            take_over(plan, layout, results, earlier)
        _write(results / NAME, plan.text)
    clean(results, layout)
    forget_damaged(results, layout)
    _write(folder / NAME, sealed_json({"format": FORMAT, "results": plan.name}))
    for earlier in list_earlier(folder, results):
        drop(plan, earlier)
    return results, layout, labels.grains


def _check_same_sweep(results: Path, plan: Sweep) -> None:
    """Raise `InputError` if a folder of results belongs to another sweep."""
    path = results / NAME
    try:
        if results.exists():
            check_tree(results)
            if path.exists() and path.read_text(encoding="utf-8") != plan.text:
                raise ValueError("its sweep.json belongs to another sweep")
    except (OSError, ValueError) as error:
        raise InputError.at(
            str(results), f"is damaged ({short(error)}): remove it, and sweep again"
        ) from None


def _check_index(path: Path) -> None:
    """Raise `InputError` if a user's own file has the name of the index of a folder."""
    # Earlier versions wrote this text.
    older = rb'{"format": [12], "results": "[0-9a-f]{16}"}'
    foreign = path.is_symlink() or (
        path.is_file()
        and path.stat().st_size
        and read_sealed_json(path) is None
        and not re.fullmatch(older, path.read_bytes())
    )
    if foreign:
        raise InputError.at(
            str(path),
            "was not written by lmpchain: move it, or choose another folder for the sweep",
        )


def _write(path: Path, text: str) -> None:
    if path.is_symlink() or not path.is_file() or path.read_text(encoding="utf-8") != text:
        with write_aside(path, overwrite=True) as aside:
            aside.write_text(text, encoding="utf-8")


def _coordinates(plan: Sweep, labels: Labels) -> Coordinates:
    """Return dimensions, values and metadata of axes, times and grains."""
    coordinates: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]] = {}
    for axis in plan.axes:
        for key, values in axis.coordinates().items():
            dimensions = (axis.name, f"{key}.entry") if np.ndim(values) == 2 else (axis.name,)
            coordinates[key] = dimensions, values, {}
    if labels.time is not None:
        attributes = {"units": "s", "long_name": "time since the strike"}
        coordinates["time"] = ("time",), labels.time, attributes
    attributes = {"units": "1", "long_name": "number of the grain, from the top"}
    coordinates["grain"] = ("grain",), labels.grains, attributes
    return coordinates


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """Lock the folder of a sweep."""
    lock = take_lock(folder)
    if lock is None:
        raise InputError.at(
            str(folder), f"{describe_holder(folder)} is sweeping into this folder: wait for it"
        )
    try:
        yield
    finally:
        lock.release()


@contextmanager
def dask(address: str) -> Iterator[Executor]:
    """Return an executor that uses the workers of a Dask scheduler.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError.at("scheduler", 'requires Dask: pip install "lmpchain[cluster]"') from None
    # Exceptions report failures. Dask sets the levels of some of its loggers one by one.
    for name in ("distributed", "tornado", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=TASKS.scheduler_s)
    except (OSError, ValueError, TypeError) as error:
        raise InputError.at(
            "scheduler", f"no Dask scheduler answers at {short(address)} ({short(error)})"
        ) from None
    with client:
        if not client.nthreads():
            warn(
                f"the scheduler has no workers yet; start some: dask worker {address} --nthreads 1",
                stacklevel=3,
            )
        yield client.get_executor(pure=False)


LOST = (
    "the connection to the Dask scheduler is lost, but the results so far are stored; start the "
    "scheduler and its workers again, then repeat the command to continue"
)


class _Work:
    """Batches of scenes to solve, and shards to write after the last of their batches."""

    def __init__(self, folder: Path, layout: StoreLayout):
        present = whole_parts(folder).keys()
        self._folder = folder
        self._layout = layout
        self._missing = {
            shard: set(layout.batches(shard)) - present
            for shard in range(layout.shards)
            if not complete(folder, shard)
        }
        # First scene of each missing batch, and scenes that are done.
        self.firsts = [first for firsts in self._missing.values() for first in sorted(firsts)]
        missing = sum(min(layout.batch, layout.count - first) for first in self.firsts)
        self.scenes = layout.count - missing

    def do(
        self, executor: Executor, tasks: Iterator[SweepTask], bar: ProgressBar, limit: int
    ) -> list[str]:
        """Execute all tasks, at most `limit` at a time; return the faults that prevented some."""
        faults: list[str] = []
        deaths: Counter[SweepTask | int] = Counter()
        pending: dict[Future, SweepTask | int] = {}
        try:
            for shard in [shard for shard, firsts in self._missing.items() if not firsts]:
                self._submit(executor, shard, pending)
            while True:
                for task in islice(tasks, max(limit - len(pending), 0)):
                    self._submit(executor, task, pending)
                if not pending:
                    return faults
                for future in _wait(executor, pending):
                    job = pending.pop(future)
                    error = _find_error(future)
                    died = isinstance(error, BrokenExecutor)
                    deaths[job] += died
                    # The cause may be temporary, for example a lack of memory.
                    if died and deaths[job] < TASKS.deaths:
                        self._submit(executor, job, pending)
                        continue
                    if error is not None:
                        faults.append(_describe_machine_fault(error))
                    if isinstance(job, SweepTask):
                        bar.advance(job.count)
                        # A shard is written after all of its batches are on the disk.
                        if error is None and self._completes_shard(job):
                            self._submit(executor, job.first // self._layout.shard, pending)
        finally:
            for future in pending:
                future.cancel()

    def _submit(self, executor: Executor, job: SweepTask | int, pending: dict[Future, Any]) -> None:
        """Solve the scenes of a task, or join the batches of a shard."""
        if isinstance(job, SweepTask):
            pending[executor.submit(answer, job)] = job
        else:
            pending[executor.submit(join_parts, self._folder, self._layout, job)] = job

    def _completes_shard(self, task: SweepTask) -> bool:
        """Mark a batch as done; return whether it was the last one of its shard."""
        firsts = self._missing[task.first // self._layout.shard]
        firsts.discard(task.first)
        return not firsts


def _wait(executor: Executor, pending: Iterable[Future]) -> set[Future]:
    """Return the futures that are done after some time.

    Raises
    ------
    RunFailed
        If the executor has lost the connection to its Dask scheduler, because no future would ever
        end.
    """
    done = wait(pending, timeout=TASKS.scheduler_s, return_when=FIRST_COMPLETED).done
    client = getattr(executor, "_client", None)
    if client is not None and client.status != "running":
        raise RunFailed(LOST)
    return done


def _find_error(future: Future) -> Exception | None:
    try:
        future.result()
    except Exception as error:
        return error
    return None


def _describe_machine_fault(error: Exception) -> str:
    """Return a sentence about a fault of the machine or the cluster, not of a scene."""
    if isinstance(error, BrokenExecutor):
        return f"the process that solved it died {TASKS.deaths} times"
    if isinstance(error, LmpchainError):
        return str(error)
    return f"{type(error).__name__} {error}".strip()
