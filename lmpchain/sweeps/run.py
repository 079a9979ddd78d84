"""Many scenes: which are left to do, and who does them; how results are kept stands in `store`."""

from __future__ import annotations

import json
import logging
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, nullcontext
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from filelock import FileLock, Timeout

from ..errors import InputError, short, shown
from ..util.files import check_tree, make_folder, write_aside
from ..util.progress import ProgressBar
from .executors import Here, Processes
from .file import FORMAT, Sweep, read
from .labels import Labels, labels
from .results import load_sweep
from .store import (
    NAME,
    PARTS,
    RESULTS,
    Layout,
    clean,
    complete,
    create,
    gather,
    layout,
    whole_parts,
)
from .take_over import drop, others, take_over
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

    The answers are the same, to the last bit, whoever gives them, in what order, and however often
    the sweep is stopped and begun again. A scene that cannot be made, misses its tolerance or
    breaks down is recorded with its reason. One that something else prevents, such as a full disk
    or a process that dies three times over it, is done when the sweep is called again.

    Parameters
    ----------
    source : path or mapping
        A sweep file, or the same keys; `scene` may then be a `Scene`.
    folder : path
        Made if need be. Other processes and machines that answer scenes must see it under the same
        name.
    workers : int
        Processes of this machine; with 1 all is done in this one. Scripts need ``if __name__ ==
        "__main__":`` for more.
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
        With every fault of the sweep; if another process is at this folder, or nothing can be
        written there.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InputError.at("workers", f"must be a whole number from 1 (got {shown(workers)})")
    plan = read(source)
    with warnings.catch_warnings(record=True, action="always") as remarks:
        size = min(together(plan.engine, scene) for scene in plan.trials())
    for remark in {
        re.sub(r"\d\S*", "", text): text for text in (str(w.message) for w in reversed(remarks))
    }.values():
        warnings.warn(f"{remark}; perhaps in other scenes, too", stacklevel=2)
    folder = make_folder(folder).absolute()
    with _alone(folder):
        results, made, grains = _prepare(plan, folder, size)
        there = whole_parts(results).keys()
        missing = {
            shard: set(made.batches(shard)) - there
            for shard in range(made.shards)
            if not complete(results, shard)
        }
        before = made.count - sum(_scenes(made, firsts) for firsts in missing.values())
        executors = (
            nullcontext(executor) if executor else Processes(workers) if workers > 1 else Here()
        )
        with (
            executors as chosen,
            ProgressBar(made.count, unit=" scenes", done=before, shown=progress) as bar,
        ):
            work = _Work(results, made, missing)
            every = (first for firsts in missing.values() for first in sorted(firsts))
            tasks = (Task(results, plan.folder, made, grains, first) for first in every)
            trouble = work.do(chosen, tasks, bar, WAITING if executor or workers > 1 else 1)
        clean(results, made)  # of workers that died on the way
    if trouble:
        warnings.warn(
            f"some scenes could not be done this time; of the first: {trouble[0]}", stacklevel=2
        )
    return load_sweep(folder)


def _prepare(plan: Sweep, folder: Path, size: int) -> tuple[Path, Layout, np.ndarray]:
    """Make the folder of the results; return it, how it is laid out, and the grains."""
    found = labels(plan)
    made = layout(plan.keep, plan.count, size, found.samples, found.grains.size, found.extra)
    results = folder / plan.name
    _check(results, plan)
    if not (results / NAME).exists():
        (results / PARTS).mkdir(parents=True, exist_ok=True)
        if not (results / RESULTS).exists():
            swept = {axis.name: len(axis) for axis in plan.axes}
            create(results, made, _coordinates(plan, found), swept)
        for before in others(folder, results):
            take_over(plan, made, results, before)
        _write(results / NAME, plan.text)
    clean(results, made)
    _write(folder / NAME, json.dumps({"format": FORMAT, "results": plan.name}))
    for before in others(folder, results):
        drop(plan, before)
    return results, made, found.grains


def _check(results: Path, plan: Sweep) -> None:
    """Raise `InputError` if a folder of results that is there is not one of this sweep."""
    try:
        if results.exists():
            check_tree(results)
            if (results / NAME).exists() and (results / NAME).read_text(
                encoding="utf-8"
            ) != plan.text:
                raise ValueError("its sweep.json is of another sweep")
    except (OSError, ValueError) as error:
        raise InputError.at(
            str(results), f"is damaged ({short(error)}): remove it, and sweep again"
        ) from None


def _write(path: Path, text: str) -> None:
    if path.is_symlink() or not path.is_file() or path.read_text(encoding="utf-8") != text:
        with write_aside(path) as aside:
            aside.write_text(text, encoding="utf-8")


def _coordinates(
    plan: Sweep, found: Labels
) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
    """Return what the axes, times and grains are called, with dimensions and metadata."""
    made: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]] = {}
    for axis in plan.axes:
        for key, values in axis.coordinates().items():
            dimensions = (axis.name, f"{key}.entry") if np.ndim(values) == 2 else (axis.name,)
            made[key] = dimensions, values, {}
    if found.time is not None:
        made["time"] = ("time",), found.time, {"units": "s", "long_name": "time since the strike"}
    made["grain"] = (
        ("grain",),
        found.grains,
        {"units": "1", "long_name": "number of the grain, from the top"},
    )
    return made


def _scenes(made: Layout, firsts: Iterable[int]) -> int:
    """Return how many scenes these batches are."""
    return sum(min(made.batch, made.count - first) for first in firsts)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Lock the folder of a sweep."""
    lock = folder / ".lock"
    if lock.is_symlink() or (lock.exists() and not lock.is_file()):
        raise InputError.at(
            str(lock), "is a link, a device or a pipe, which lmpchain never writes: remove it"
        )
    try:
        with FileLock(lock, timeout=0):
            yield
    except Timeout:
        raise InputError.at(
            str(folder), "another process sweeps into this folder; wait for it"
        ) from None


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
        raise InputError.at("scheduler", 'needs Dask: pip install "lmpchain[cluster]"') from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what fails is told by exceptions
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError.at(
            "scheduler", f"no Dask scheduler answers at {short(address)} ({short(error)})"
        ) from None
    with client:
        if not client.nthreads():
            warnings.warn(
                f"no workers are there yet; start some: dask worker {address} --nthreads 1",
                stacklevel=3,
            )
        yield client.get_executor(pure=False)


class _Work:
    """What is left to do: batches of scenes to answer, and shards to gather when all of theirs are there."""

    def __init__(self, folder: Path, made: Layout, missing: Mapping[int, set[int]]):
        self._folder = folder
        self._made = made
        self._missing = {shard: set(each) for shard, each in missing.items()}

    def do(
        self, executor: Executor, tasks: Iterator[Task], bar: ProgressBar, most: int
    ) -> list[str]:
        """Have all tasks done, so many at a time, and return why some were not, in words."""
        trouble: list[str] = []
        deaths: dict[Any, int] = {}
        pending: dict[Future, Task | int] = {}

        def submit(what: Task | int) -> None:
            if isinstance(what, Task):
                pending[executor.submit(answer, what)] = what
            else:
                pending[executor.submit(gather, self._folder, self._made, what)] = what

        try:
            for shard in [shard for shard, missing in self._missing.items() if not missing]:
                submit(shard)
            while True:
                for task in islice(tasks, max(most - len(pending), 0)):
                    submit(task)
                if not pending:
                    return trouble
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    what = pending.pop(future)
                    failed = True
                    try:
                        future.result()
                        failed = False
                    except BrokenExecutor:
                        deaths[what] = deaths.get(what, 0) + 1
                        if deaths[what] < DEATHS:
                            submit(what)
                            continue
                        trouble.append(f"the process that was at it died {DEATHS} times")
                    except Exception as error:  # of the machine or the cluster, not of the scene
                        trouble.append(f"{type(error).__name__} {error}".strip())
                    if isinstance(what, Task):
                        bar.advance(what.count)
                        missing = self._missing[what.first // self._made.shard]
                        if not failed:
                            missing.discard(what.first)
                            if not missing:
                                submit(what.first // self._made.shard)
        finally:
            for future in pending:
                future.cancel()
