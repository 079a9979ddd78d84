"""Results of a sweep as one labelled dataset, whose arrays are read when they are used."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from ..errors import InputError, short
from ..util.arrays import Array
from ..util.files import LARGEST_JSON, check_readable, check_tree, expanded
from .file import FORMAT, Sweep, is_name, read_text
from .store import NAME, SCALARS, StoreLayout, open_store, read_column, read_layout


def load_sweep(folder: str | PathLike[str]) -> xarray.Dataset:
    """Return the results of a sweep so far.

    Parameters
    ----------
    folder : path
        That `sweep` has made.

    Returns
    -------
    xarray.Dataset
        Its dimensions are what was swept: those of the grid under the names of their keys, `case`
        for a list, `draw` for random draws, `realisation` for disorder; then `time` in s (or
        `sample`, with the times as a coordinate, if scenes differ in them) and `grain`. What is
        read off a motion comes with its error, under the name with `_error`. Arrays are
        read from their files when they are used. Where a scene has failed or is not done, all
        values are NaN, and `reason` says why; it is empty for the others. Of a scene that cannot be
        predicted to its end, largest values and fronts stay that are settled before; what samples
        do not show to a tenth is NaN, too.

    Raises
    ------
    InputError
        If the folder holds no sweep, or a damaged one.
    """
    folder = expanded(folder)
    index = _read_json(folder / NAME)
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        index = {}
    if not is_name(index.get("results")):
        raise InputError.at(str(folder), "holds no sweep, or one of another version of lmpchain")
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
        # larger arrays stay in their files until they are used
        array = indexing.LazilyIndexedArray(_Stored(results, layout, name, plan.shape))
        inner = column.dimensions
        # where scenes differ in their times, samples are numbered and the times a coordinate
        if "time" in layout.columns:
            inner = tuple(key.replace("time", "sample") for key in inner)
        variables = coordinates if name == "time" or name in laws else data
        variables[name] = (*swept, *inner), array, attributes
    return xarray.Dataset(data, coordinates, {"engine": plan.engine, "tolerance": plan.tolerance})


def _read_labels(results: Path, layout: StoreLayout) -> dict[str, Any]:
    """Return the coordinates that are no arrays over the scenes; raises `InputError`."""
    store = open_store(results)
    try:
        return {
            name: (array.metadata.dimension_names, array[:], dict(array.attrs))
            for name, array in store.arrays()
            if name not in layout.columns
        }
    except Exception as error:
        # whatever a damaged file makes zarr raise
        raise InputError.at(
            str(results), f"is damaged ({short(error)}): remove it, and sweep again"
        ) from None


def read_results(results: Path) -> tuple[Sweep, StoreLayout]:
    """Return the sweep of a folder of results, and their layout; raises `InputError`."""
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
    """Return the content of a JSON file, or None if there is none."""
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
    """Array over all scenes, read from the files when it is indexed, and NaN where none are."""

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
        # numbers of the scenes at all combinations of the indices
        outer = np.ix_(*rows[: len(self._swept)])
        inner = rows[len(self._swept) :]
        numbers = np.ravel_multi_index(outer, self._swept).ravel()
        values = read_column(self._folder, self._layout, self._name, numbers, inner)
        return values.reshape([indices.size for indices in chosen if indices.ndim])
