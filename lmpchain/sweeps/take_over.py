"""Results of an earlier sweep in a folder, for a sweep with some of the same scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .file import Sweep, is_name
from .results import read_results
from .store import (
    NAME,
    NOT_DONE,
    StoreLayout,
    clean,
    forget_damaged,
    read_column,
    remove_results,
    write_part,
)


def list_earlier(folder: Path, results: Path) -> list[Path]:
    """Return the folders of the results of other sweeps in a folder."""
    return sorted(
        path
        for path in folder.iterdir()
        if is_name(path.name) and (path / NAME).exists() and path != results
    )


def take_over(plan: Sweep, layout: StoreLayout, results: Path, earlier: Path) -> None:
    """Copy the results of an earlier sweep for these scenes, if both have the same arrays."""
    try:
        old_plan, old_layout = read_results(earlier)
    except InputError:
        # The results are damaged or belong to another version.
        return
    clean(earlier, old_layout)
    forget_damaged(earlier, old_layout)
    if _shapes(layout) != _shapes(old_layout) or old_plan.keep != plan.keep:
        return
    keys, old_numbers = _done(old_plan, old_layout, earlier)
    if not keys.size:
        return
    # Equal keys imply equal results, independent of the position in both sweeps.
    new_keys = np.array([plan.key(number) for number in range(plan.count)])
    spots = np.searchsorted(keys, new_keys).clip(max=keys.size - 1)
    present = keys[spots] == new_keys
    for shard in range(layout.shards):
        begin = shard * layout.shard
        numbers = begin + np.flatnonzero(present[begin : begin + layout.shard])
        if not numbers.size:
            continue
        # Reading is faster in the order of the store.
        numbers = numbers[np.argsort(old_numbers[spots[numbers]])]
        columns = {
            name: read_column(earlier, old_layout, name, old_numbers[spots[numbers]])
            for name in layout.columns
        }
        for first in layout.batches(shard):
            end = min(first + layout.batch, layout.count)
            rows = (numbers >= first) & (numbers < end)
            if rows.any():
                batch = {name: values[rows] for name, values in columns.items()}
                _write(results, first, end, numbers[rows], batch)


def _shapes(layout: StoreLayout) -> dict[str, tuple[int, ...]]:
    return {name: column.shape for name, column in layout.columns.items()}


def _write(results: Path, first: int, end: int, numbers: np.ndarray, batch: dict[str, Any]) -> None:
    """Write a part with the results of some of its scenes, `numbers`."""
    columns = {}
    for name, values in batch.items():
        text = name == "reason"
        shape = (end - first, *values.shape[1:])
        column: Any = np.full(shape, NOT_DONE if text else np.nan, object if text else float)
        column[numbers - first] = values
        columns[name] = column.astype(str) if text else column
    write_part(results, first, columns, whole=len(numbers) == end - first)


def _done(plan: Sweep, layout: StoreLayout, results: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the sorted keys of the finished scenes, and their numbers."""
    reasons = read_column(results, layout, "reason", np.arange(layout.count))
    numbers = np.flatnonzero(reasons != NOT_DONE)
    keys = np.array([plan.key(int(number)) for number in numbers], dtype="S32")
    order = np.argsort(keys)
    return keys[order], numbers[order]


def drop(plan: Sweep, earlier: Path) -> None:
    """Remove the results of another sweep if this sweep has all of its finished scenes."""
    try:
        old_plan, old_layout = read_results(earlier)
    except InputError:
        return
    keys, _ = _done(old_plan, old_layout, earlier)
    new_keys = [plan.key(number) for number in range(plan.count)]
    if old_plan.keep == plan.keep and np.isin(keys, new_keys).all():
        remove_results(earlier)
