"""The results of a sweep as one labelled dataset; arrays are read from their files when they are used."""

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
from ..util.files import check_readable, check_tree
from .file import FORMAT, Sweep, again, is_name
from .store import NAME, SCALARS, Layout, laid_out, open_store, read

LARGEST_INDEX = 2**30  # bytes


def load_sweep(folder: str | PathLike[str]) -> xarray.Dataset:
    """Return what a sweep has found so far.

    Parameters
    ----------
    folder : path
        Where `sweep` has put it.

    Returns
    -------
    xarray.Dataset
        Its dimensions are what was swept: those of the grid under the names of their keys, `case`
        for a list, `draw` for random draws, `realisation` for disorder; then `time` in s (or
        `sample`, with the times as a coordinate, if scenes differ in them) and `grain`. What is
        read off a motion comes with how far it may be off, under the name with `_error`. Arrays are
        read from their files when they are used. Where a scene has failed or is not done, all
        values are NaN, and `reason` says why; it is empty for the others.

    Raises
    ------
    InputError
        If the folder holds no sweep, or a damaged one.
    """
    folder = Path(folder)
    index = _read(folder / NAME)
    if (
        not isinstance(index, dict)
        or index.get("format") != FORMAT
        or not is_name(index.get("results"))
    ):
        raise InputError.at(str(folder), "holds no sweep, or one of another version of lmpchain")
    results = folder / index["results"]
    plan, made = kept(results)
    store = open_store(results)
    swept = tuple(axis.name for axis in plan.axes)
    try:
        coordinates = {
            name: (array.metadata.dimension_names, array[:], dict(array.attrs))
            for name, array in store.arrays()
            if name not in made.columns
        }
    except Exception as error:  # whatever a damaged file makes zarr raise
        raise InputError.at(
            str(results), f"is damaged ({short(error)}): remove it, and sweep again"
        ) from None
    data: dict[str, Any] = {}
    for name, column in made.columns.items():
        about = {"units": column.units, "long_name": column.long_name}
        if column.shape or name not in ("reason", *SCALARS):
            stored = indexing.LazilyIndexedArray(_Stored(results, made, name, plan.shape))
            into = coordinates if name in plan_coordinates(plan, made) else data
            dimensions = (
                "sample" if key == "time" and "time" in made.columns else key
                for key in column.dimensions
            )
            into[name] = (*swept, *dimensions), stored, about
        else:
            values = read(results, made, name, np.arange(made.count)).reshape(plan.shape)
            data[name] = swept, values.astype(object) if column.dtype is str else values, about
    return xarray.Dataset(data, coordinates, {"engine": plan.engine, "tolerance": plan.tolerance})


def plan_coordinates(plan: Sweep, made: Layout) -> set[str]:
    """Return which arrays over the scenes are coordinates."""
    return {"time"} & made.columns.keys() | {each.key for axis in plan.axes for each in axis.arrays}


def kept(results: Path) -> tuple[Sweep, Layout]:
    """Return the sweep that results are of, and how they are laid out; raises `InputError`."""
    path = results / NAME
    try:
        check_tree(results)
        if not _read(path):
            raise InputError.at(str(path), "is missing: remove its folder, and sweep again")
        plan = again(path.read_text(encoding="utf-8"), results)
    except (OSError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError) and str(path) in str(error):
            raise
        raise InputError.at(
            str(path), f"cannot be read ({short(error)}): remove its folder, and sweep again"
        ) from None
    return plan, laid_out(results, plan)


def _read(path: Path) -> Any:
    """Return what a JSON file holds, or None if there is none."""
    try:
        if path.is_symlink():
            raise ValueError
        check_readable(path, LARGEST_INDEX)
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError):
        raise InputError.at(
            str(path), "cannot be read: remove its folder, and sweep again"
        ) from None


class _Stored(BackendArray):
    """One array of every scene, read from the files when it is indexed, and NaN where there is none."""

    dtype = np.dtype(float)

    def __init__(self, folder: Path, made: Layout, name: str, shape: tuple[int, ...]):
        self._folder = folder
        self._made = made
        self._name = name
        self._swept = shape
        self.shape = (*shape, *made.columns[name].shape)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Array:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._at
        )

    def _at(self, key: tuple) -> Array:
        chosen = [np.arange(size)[part] for size, part in zip(self.shape, key, strict=True)]
        places = [np.atleast_1d(part) for part in chosen]
        outer = places[: len(self._swept)]
        inner = places[len(self._swept) :]
        numbers = np.ravel_multi_index(np.ix_(*outer), self._swept).ravel()
        values = read(self._folder, self._made, self._name, numbers, inner)
        return values.reshape([part.size for part in chosen if part.ndim])
