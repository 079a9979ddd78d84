"""What one sweep of a folder has found serves the next one that asks for the same scenes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .file import Sweep, is_name
from .results import kept
from .store import NAME, NOT_DONE, Layout, read, write_part


def others(folder: Path, results: Path) -> list[Path]:
    """Return where the results of other sweeps of the folder lie."""
    return sorted(
        path
        for path in folder.iterdir()
        if is_name(path.name) and (path / NAME).exists() and path != results
    )


def take_over(plan: Sweep, made: Layout, results: Path, before: Path) -> None:
    """Write what another sweep has found of these scenes, if both record the same grains and times."""
    try:
        old, laid = kept(before)
    except InputError:  # damaged, or of another version
        return
    shapes = [
        {name: column.shape for name, column in each.columns.items()} for each in (made, laid)
    ]
    if shapes[0] != shapes[1] or old.keep != plan.keep:
        return
    keys, places = _done(old, laid, before)
    wanted = np.array([plan.key(number) for number in range(plan.count)])
    spots = np.searchsorted(keys, wanted).clip(max=max(keys.size - 1, 0))
    there = keys[spots] == wanted if keys.size else np.zeros(plan.count, dtype=bool)
    for shard in range(made.shards):
        first = shard * made.shard
        last = min((shard + 1) * made.shard, made.count)
        known = first + np.flatnonzero(there[first:last])
        if not known.size:
            continue
        order = np.argsort(places[spots[known]])
        numbers = known[order]
        found = {name: read(before, laid, name, places[spots[numbers]]) for name in made.columns}
        for begin in made.batches(shard):
            end = min(begin + made.batch, made.count)
            mine = (numbers >= begin) & (numbers < end)
            if mine.any():
                _write(
                    results,
                    begin,
                    end,
                    numbers[mine],
                    {name: values[mine] for name, values in found.items()},
                )


def _write(results: Path, begin: int, end: int, numbers: np.ndarray, found: dict[str, Any]) -> None:
    """Write a part of which these scenes are known."""
    columns = {}
    for name, values in found.items():
        text = name == "reason"
        column: Any = np.full(
            (end - begin, *values.shape[1:]),
            NOT_DONE if text else np.nan,
            object if text else float,
        )
        column[numbers - begin] = values
        columns[name] = column.astype(str) if text else column
    write_part(results, begin, columns, whole=len(numbers) == end - begin)


def _done(plan: Sweep, made: Layout, results: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the keys of the scenes that are done, in order, and their numbers."""
    reasons = read(results, made, "reason", np.arange(made.count))
    numbers = np.flatnonzero(reasons != NOT_DONE)
    keys = np.array([plan.key(int(number)) for number in numbers], dtype="S32")
    order = np.argsort(keys)
    return keys[order], numbers[order]


def drop(plan: Sweep, before: Path) -> None:
    """Remove the results of another sweep if this one asks for all that is done of it."""
    try:
        old, laid = kept(before)
    except InputError:
        return
    keys, _ = _done(old, laid, before)
    if (
        old.keep == plan.keep
        and np.isin(keys, [plan.key(number) for number in range(plan.count)]).all()
    ):
        shutil.rmtree(before, ignore_errors=True)
