"""Many scenes: which are left to do, and who does them.

The folder of a sweep holds `sweep.json`, which says what is swept and what the folders of the scenes are called, and
`scenes`, where these are (see `sweepwork`). What is there is never done again, whichever sweep asks for it.
"""

from __future__ import annotations

import json
import logging
import re
import shutil
import warnings
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from ..errors import InputError, short, shown
from ..util.files import make_folder, write_aside
from ..util.progress import ProgressBar
from .executors import Here, Processes
from .file import Sweep, name_of, plain, read
from .results import FORMAT, load_sweep
from .tasks import Task, answer, together

if TYPE_CHECKING:
    import xarray

WAITING = 256  # tasks that an executor has at a time
CONNECT_S = 5.0  # for a scheduler to answer
DEATHS = 3  # of the process that is at a task, before it is given up


def sweep(
    source: str | PathLike[str] | Mapping[str, Any],
    folder: str | PathLike[str],
    *,
    workers: int = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> xarray.Dataset:
    """Answer all scenes of a sweep that have not been answered in this folder before.

    The answers are the same, to the last bit, whoever gives them, in what order, and however often the sweep is stopped
    and begun again. A scene that cannot be made, misses its tolerance or breaks down is recorded with its reason. One
    that something else prevents, such as a full disk or a process that dies three times over it, is done when the sweep
    is called again.

    Parameters
    ----------
    source : path or mapping
        A sweep file, or the same keys; `scene` may then be a `Scene`.
    folder : path
        Made if need be. Other processes and machines that answer scenes must see it under the same name.
    workers : int
        Processes of this machine; with 1 all is done in this one. Scripts need ``if __name__ == "__main__":`` for more.
    executor : concurrent.futures.Executor, optional
        Executor that runs the scenes in place of local processes, such as
        ``dask.distributed.Client(address).get_executor(pure=False)``.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    xarray.Dataset
        As `load_sweep`.

    Raises
    ------
    InputError
        With every fault of the sweep; if another process is at this folder, or nothing can be written there.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError([("workers", f"must be a whole number from 1 (got {shown(workers)})")])
    plan = read(source)
    with warnings.catch_warnings(record=True, action="always") as remarks:
        size = min(together(plan.engine, scene) for scene in plan.trials())
    for remark in {re.sub(r"\d\S*", "", text): text for text in (str(w.message) for w in reversed(remarks))}.values():
        warnings.warn(f"{remark}; perhaps in other scenes, too", stacklevel=2)
    folder = make_folder(folder).absolute()
    results = make_folder(folder / "scenes")
    with _alone(folder):
        names = [name_of(plan.asked(place)) for place in plan.places()]
        _write_index(plan, names, folder / "sweep.json")
        scenes = dict(zip(names, plan.places(), strict=True))
        every, done = list(scenes), {path.name for path in results.iterdir()}
        batches = [every[first : first + size] for first in range(0, len(every), size)]
        left = [batch for batch in batches if not done.issuperset(batch)]
        tasks = (Task(tuple(plan.asked(scenes[name]) for name in batch), plan.folder, results) for batch in left)
        executors = nullcontext(executor) if executor else Processes(workers) if workers > 1 else Here()
        before = len(every) - sum(map(len, left))
        with executors as chosen, ProgressBar(len(every), unit=" scenes", done=before, shown=progress) as bar:
            trouble = _answer_all(chosen, tasks, bar, WAITING if executor or workers > 1 else 1)
    if trouble:
        warnings.warn(f"some scenes could not be done this time; of the first: {trouble[0]}", stacklevel=2)
    return load_sweep(folder)


def _write_index(plan: Sweep, names: list[str], path: Path) -> None:
    index = {
        "format": FORMAT,
        "engine": plan.engine,
        "tolerance": plan.tolerance,
        "keep": plan.keep,
        "scene": plan.tables,
        "axes": [{"name": axis.name, "length": len(axis), "coordinates": axis.coordinates()} for axis in plan.axes],
        "names": names,
    }
    with write_aside(path) as aside:
        aside.write_text(json.dumps(index, default=plain), encoding="utf-8")


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock the folder of a sweep, and remove what killed processes have left half done."""
    try:
        with FileLock(folder / ".lock", timeout=0):
            try:
                yield
            finally:
                for left in (folder / "scenes").glob(".*.partial"):
                    shutil.rmtree(left, ignore_errors=True)
    except Timeout:
        raise InputError([(str(folder), "another process sweeps into this folder; wait for it")]) from None


@contextmanager
def dask(address: str) -> Iterator[Executor]:
    """Give an executor whose work is done by the workers of a Dask scheduler.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError([("scheduler", 'needs Dask: pip install "lmpchain[cluster]"')]) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what fails is told by exceptions
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError([("scheduler", f"no Dask scheduler answers at {short(address)} ({short(error)})")]) from None
    with client:
        if not client.nthreads():
            warnings.warn(f"no workers are there yet; start some: dask worker {address} --nthreads 1", stacklevel=3)
        yield client.get_executor(pure=False)


def _answer_all(executor: Executor, tasks: Iterator[Task], bar: ProgressBar, most: int) -> list[str]:
    """Have all tasks answered, so many at a time, and return why some were not, in words."""
    trouble: list[str] = []
    deaths: dict[Task, int] = {}
    pending: dict[Future, Task] = {}
    try:
        while True:
            for task in islice(tasks, most - len(pending)):
                pending[executor.submit(answer, task)] = task
            if not pending:
                return trouble
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                task = pending.pop(future)
                try:
                    future.result()
                except BrokenExecutor:
                    deaths[task] = deaths.get(task, 0) + 1
                    if deaths[task] < DEATHS:
                        pending[executor.submit(answer, task)] = task
                        continue
                    trouble.append(f"the process that was at it died {DEATHS} times")
                except Exception as error:  # of the machine or the cluster, not of the scene
                    trouble.append(f"{type(error).__name__} {error}".strip())
                bar.advance(len(task.asked))
    finally:
        for future in pending:
            future.cancel()
