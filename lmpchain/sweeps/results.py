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
        A folder that `sweep` has written.

    Returns
    -------
    xarray.Dataset
        The dimensions are the axes of the sweep: those of a grid have the names of their keys, a
        list of cases is `case`, random draws are `draw`, and disorder is `realisation`. Then
        follow `time` in s (or `sample`, with the times as a coordinate, if scenes differ in them)
        and `grain`. A derived quantity has its error under its name with `_error`. Arrays are
        read from their files when they are used. If a scene has failed or is not done, all its
        values are NaN and `reason` gives the reason; it is empty for the others. If a scene
        becomes unpredictable, largest values and arrival times that are known before are stored,
        and quantities with an error above a tenth are NaN.

    Raises
    ------
    InputError
        If the folder contains no sweep, or a damaged one.
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
