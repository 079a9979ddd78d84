"""Results of a sweep as one labelled dataset, and their use by a later sweep in its folder."""

from __future__ import annotations

import itertools
import json
from contextlib import suppress
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from ..chain.chain import Chain
from ..errors import InputError, short
from ..scene.recording import Recording
from ..scene.toml_file import count_grains
from ..util.arrays import Array
from ..util.files import LARGEST_JSON, check_readable, check_tree, path_of
from ..util.remarks import warnings_aside
from .file import FORMAT, Place, Sweep, is_name, read_text
from .store import (
    NAME,
    NOT_DONE,
    SCALARS,
    StoredArray,
    StoreLayout,
    clean,
    forget_damaged,
    open_store,
    read_column,
    read_layout,
    remove_results,
    write_part,
)

# Keys that determine the grains and times that a scene records.
SHAPING = ("chain.grains", "chain.file", "recording")


class Labels(NamedTuple):
    """Samples and grains that the result arrays contain.

    Attributes
    ----------
    samples : int
        Largest number of samples of any scene.
    time : (T,) array or None
        Times, s; None if the times of the scenes differ.
    grains : (G,) array
        Numbers of all recorded grains, in the order of the scenes if all scenes record the same
        grains, otherwise ascending.
    extra : dict
        Further arrays of the store: times if they differ, and numbers drawn for every grain.
    """

    samples: int
    time: Array | None
    grains: np.ndarray
    extra: dict[str, StoredArray]


def make_labels(plan: Sweep) -> Labels:
    """Return the labels of a sweep; invalid scenes contribute none."""
    # Along the other axes all scenes record the same grains and contacts, so the first scene
    # represents them.
    lengths = [
        len(axis) if any(key == "chain" or key.startswith(SHAPING) for key in axis.columns) else 1
        for axis in plan.axes
    ]
    shapes = set()
    for position in itertools.product(*map(range, lengths)):
        # The trial scenes already gave these warnings.
        with suppress(InputError), warnings_aside():
            shapes.add(_find_shape(plan, position))
    times = {(shape.samples, shape.duration) for shape in shapes}
    recordings = {shape.recorded for shape in shapes}
    samples = max(shape.samples for shape in shapes)
    longest = max(shape.grains for shape in shapes)
    extra = {}
    time = None
    if len(times) == 1:
        time = np.linspace(0.0, times.pop()[1], samples)
    else:
        extra["time"] = StoredArray(("sample",), (samples,), "s", "time since the strike")
    for axis in plan.axes:
        for law in axis.arrays:
            name = f"drawn for every {'contact' if law.of_contacts else 'grain'}"
            length = longest - law.of_contacts
            extra[law.key] = StoredArray((f"{law.key}.entry",), (length,), "1", name)
    grains = recordings.pop() if len(recordings) == 1 else sorted(set().union(*recordings))
    return Labels(samples, time, np.array(grains), extra)


def find_recorded(plan: Sweep, position: Place, size: int) -> np.ndarray:
    """Return the grains that a scene records in a chain of this size, (G,)."""
    return _read_recording(json.dumps(plan.tables_at(position).get("recording")), size)[1]


class _Shape(NamedTuple):
    """Samples, duration (s) and grain numbers that a scene records, and the size of its chain."""

    samples: int
    duration: float
    recorded: tuple[int, ...]
    grains: int


def _find_shape(plan: Sweep, position: Place) -> _Shape:
    tables: dict[str, Any] = plan.tables_at(position)
    chain = tables["chain"]
    # The chain itself may be invalid in this scene, but not in others.
    size = count_grains(chain["file"], plan.folder) if "file" in chain else plan.grains(position)
    recording, numbers = _read_recording(json.dumps(tables.get("recording")), size)
    return _Shape(recording.samples, recording.duration, tuple(numbers.tolist()), size)


@lru_cache(maxsize=64)
def _read_recording(table: str, size: int) -> tuple[Recording, np.ndarray]:
    """Return the recording that a table requests, and its grains in a chain of this size."""
    options = json.loads(table)
    options.pop("quantities", None)
    recording = Recording(**options)
    chain = Chain(grains=size, diameter=1e-3, gravity=0.0, bottom="wall")
    if faults := list(recording.faults(chain)):
        raise InputError(faults)
    return recording, recording.numbers(chain)


def load_sweep(folder: str | PathLike[str]) -> xarray.Dataset:
    """Return the results of a sweep so far.

    Parameters
    ----------
    folder : path
        Folder that `sweep` has written.

    Returns
    -------
    xarray.Dataset
        The first dimensions are the axes of the sweep: an axis of a grid has the name of its key, a
        list of cases is `case`, random draws are `draw`, and disorder is `realisation`. The last
        dimensions are `time`, s, and `grain`. If the times of the scenes differ, `sample` replaces
        `time`, and the times are a coordinate. The error of a derived quantity has the name of the
        quantity followed by `_error`. Arrays are read from their files when they are used. If a
        scene has failed or is not done, all its values are NaN and `reason` gives the reason;
        otherwise `reason` is empty. If a scene becomes unpredictable, largest values and arrival
        times that are known before are stored; values with a relative error above 0.1 are NaN.

    Raises
    ------
    InputError
        If the folder contains no sweep, or the sweep is damaged.
    """
    folder = path_of(folder)
    index = _read_json(folder / NAME)
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        index = {}
    if not is_name(index.get("results")):
        raise InputError.at(
            str(folder), "contains no sweep, or a sweep of another version of lmpchain"
        )
    results = folder / index["results"]
    plan, layout = read_results(results)
    coordinates = _read_labels(results, layout)
    data: dict[str, Any] = {}
    swept = tuple(axis.name for axis in plan.axes)
    laws = {law.key for axis in plan.axes for law in axis.arrays}
    for name, column in layout.columns.items():
        attributes = {"units": column.units, "long_name": column.long_name}
        if name in ("reason", *SCALARS):
            values = read_column(results, layout, name, np.arange(layout.count)).reshape(plan.shape)
            data[name] = swept, values.astype(object) if column.dtype is str else values, attributes
            continue
        # Larger arrays stay in their files until they are used.
        array = indexing.LazilyIndexedArray(_Stored(results, layout, name, plan.shape))
        inner = column.dimensions
        # If scenes differ in their times, the dimension is the sample number, and time a
        # coordinate.
        if "time" in layout.columns:
            inner = tuple(key.replace("time", "sample") for key in inner)
        variables = coordinates if name == "time" or name in laws else data
        variables[name] = (*swept, *inner), array, attributes
    return xarray.Dataset(data, coordinates, {"engine": plan.engine, "tolerance": plan.tolerance})


def _read_labels(results: Path, layout: StoreLayout) -> dict[str, Any]:
    """Return the coordinates that are not arrays over the scenes; raise `InputError` if damaged."""
    store = open_store(results)
    try:
        return {
            name: (array.metadata.dimension_names, array[:], dict(array.attrs))
            for name, array in store.arrays()
            if name not in layout.columns
        }
    except Exception as error:
        # A damaged file makes zarr raise many kinds of errors.
        raise InputError.at(
            str(results), f"is damaged ({short(error)}): remove it, and sweep again"
        ) from None


def read_results(results: Path) -> tuple[Sweep, StoreLayout]:
    """Return the sweep of a folder of results, and its layout; raise `InputError` if damaged."""
    path = results / NAME
    try:
        check_tree(results)
        if not _read_json(path):
            raise InputError.at(str(path), "is missing: remove its folder, and sweep again")
        plan = read_text(path.read_text(encoding="utf-8"), results)
    except (OSError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError) and str(path) in str(error):
            raise
        raise InputError.at(
            str(path), f"cannot be read ({short(error)}): remove its folder, and sweep again"
        ) from None
    return plan, read_layout(results, plan)


def _read_json(path: Path) -> Any:
    """Return the content of a JSON file, or None if the file does not exist."""
    try:
        if path.is_symlink():
            raise ValueError
        check_readable(path, LARGEST_JSON)
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        raise InputError.at(
            str(path), "cannot be read: remove its folder, and sweep again"
        ) from None


class _Stored(BackendArray):
    """An array over all scenes, read from files when it is indexed; NaN for missing results."""

    dtype = np.dtype(float)

    def __init__(self, folder: Path, layout: StoreLayout, name: str, swept: tuple[int, ...]):
        self._folder = folder
        self._layout = layout
        self._name = name
        self._swept = swept
        self.shape = (*swept, *layout.columns[name].shape)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Array:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._read
        )

    def _read(self, key: tuple) -> Array:
        chosen = [np.arange(size)[index] for size, index in zip(self.shape, key, strict=True)]
        rows = [np.atleast_1d(indices) for indices in chosen]
        # These are the numbers of the scenes at all combinations of the indices.
        outer = np.ix_(*rows[: len(self._swept)])
        inner = rows[len(self._swept) :]
        numbers = np.ravel_multi_index(outer, self._swept).ravel()
        values = read_column(self._folder, self._layout, self._name, numbers, inner)
        return values.reshape([indices.size for indices in chosen if indices.ndim])


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
    # Equal shapes do not imply that equal columns are of equal grains.
    labels = _read_labels(results, layout), _read_labels(earlier, old_layout)
    if not np.array_equal(*(each["grain"][1] for each in labels)):
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
