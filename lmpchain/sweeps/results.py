"""The results of a sweep as one labelled dataset; arrays are read from their files when they are used."""

from __future__ import annotations

import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from ..errors import InputError
from ..util.arrays import Array
from .quantities import QUANTITIES

FORMAT = 1
ERRORS = {"model_error": "of the equation that was solved", "solver_error": "of its solution"}
NOT_DONE: dict[str, Any] = {"failed": "not done"}
Labels = Mapping[str, np.ndarray]  # along dimensions: numbers of samples, or of grains


def load_sweep(folder: str | PathLike[str]) -> xarray.Dataset:
    """Return what a sweep has found so far.

    Parameters
    ----------
    folder : path
        Where `sweep` has put it.

    Returns
    -------
    xarray.Dataset
        Its dimensions are what was swept: those of the grid under the names of their keys, `case` for a list, `draw`
        for random draws, `realisation` for disorder; then `time` in s (or `sample`, with the times as a coordinate,
        if scenes differ in them) and `grain`. Arrays are read from their files when they are used. Where a scene has
        failed or is not done, all values are NaN, and `reason` says why; it is empty for the others.

    Raises
    ------
    InputError
        If the folder holds no sweep, or a damaged one.
    """
    folder = Path(folder)
    index = _read(folder / "sweep.json")
    if not index or index["format"] != FORMAT:
        raise InputError([(str(folder), "holds no sweep, or one of another version of lmpchain")])
    axes = index["axes"]
    swept = tuple(axis["name"] for axis in axes)
    names = np.array(index["names"], dtype=object).reshape([axis["length"] for axis in axes])
    results = {name: _read(folder / "scenes" / name / "result.json") or NOT_DONE for name in index["names"]}
    good = {name: result for name, result in results.items() if "failed" not in result}

    def numbers(key: str) -> tuple[tuple[str, ...], Array]:
        values = [good.get(name, {}).get(key, np.nan) for name in names.flat]
        return swept, np.array(values, dtype=float).reshape(names.shape)

    reasons = np.array([results[name].get("failed", "") for name in names.flat], dtype=object).reshape(names.shape)
    data: dict[str, Any] = {"reason": (swept, reasons, {"long_name": "why there is no answer"})}
    for key, what in ERRORS.items():
        data[key] = *numbers(key), {"units": "1", "long_name": f"estimated relative error {what}"}
    coordinates: dict[str, Any] = {
        key: (axis["name"], values) for axis in axes for key, values in axis["coordinates"].items()
    }
    labels = _labels(good)
    every = _union(labels)
    if good:
        when, coordinates["time"] = _times(good, names, swept, every["time"])
        coordinates["grain"] = "grain", every["grain"], {"units": "1", "long_name": "number of the grain, from the top"}
    for key in index["keep"]:
        kept = QUANTITIES[key]
        about = {"units": kept.units, "long_name": kept.long_name}
        if not kept.dimensions:
            data[key] = *numbers(key), about
        elif good:
            stored = _Stored(folder / "scenes", key, names, labels, {name: every[name] for name in kept.dimensions})
            dimensions = *swept, *(when if name == "time" else name for name in kept.dimensions)
            data[key] = dimensions, indexing.LazilyIndexedArray(stored), about
    return xarray.Dataset(data, coordinates, {key: index[key] for key in ("engine", "tolerance")})


def _read(path: Path) -> dict[str, Any] | None:
    """Return what a JSON file holds, or None if there is none."""
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        raise InputError([(str(path), "cannot be read: delete its folder, and sweep again")]) from None


def _labels(good: Mapping[str, dict[str, Any]]) -> dict[str, Labels]:
    """Return the samples and grains of the arrays of every scene; scenes recorded alike share them."""
    known: dict[str, Labels] = {}
    shared = {}
    for name, result in good.items():
        samples, grains = result["samples"], result["grains"]
        key = f"{samples} {grains}"
        if key not in known:
            first, last = map(int, grains.split(":")) if isinstance(grains, str) else (1, 0)
            numbers = np.arange(first, last + 1) if isinstance(grains, str) else np.array(grains)
            known[key] = {"time": np.arange(samples), "grain": numbers}
        shared[name] = known[key]
    return shared


def _union(labels: Mapping[str, Labels]) -> Labels:
    """Return all labels that there are, in the order of the scenes if that is one order."""
    different = list({id(each): each for each in labels.values()}.values())
    if len(different) < 2:
        return different[0] if different else {}
    return {name: np.unique(np.concatenate([each[name] for each in different])) for name in ("time", "grain")}


def _times(good: Mapping[str, dict[str, Any]], names: np.ndarray, swept: tuple[str, ...], samples: np.ndarray) -> Any:
    """Return the name of the dimension of time, and the coordinate."""
    about = {"units": "s", "long_name": "time since the strike"}
    different = {(result["duration"], result["samples"]) for result in good.values()}
    if len(different) == 1:
        return "time", ("time", np.linspace(0.0, *different.pop()), about)
    times = np.full((*names.shape, samples.size), np.nan)
    for place, name in np.ndenumerate(names):
        if name in good:
            count = good[name]["samples"]
            times[place][:count] = np.linspace(0.0, good[name]["duration"], count)
    return "sample", ((*swept, "sample"), times, about)


class _Stored(BackendArray):
    """One array of every scene, read from the files when it is indexed, and NaN where there is none.

    Parameters
    ----------
    folder, key : where the folders of the scenes are; name of the array
    names : array of str, of the scenes
    labels : those of every scene that has an answer
    every : those of the whole array, by dimension after those of `names`
    """

    dtype = np.dtype(float)

    def __init__(self, folder: Path, key: str, names: np.ndarray, labels: Mapping[str, Labels], every: Labels):
        self._folder, self._key, self._names, self._labels, self._every = folder, key, names, labels, every
        self.shape = (*names.shape, *(values.size for values in every.values()))

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Array:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._at)

    def _at(self, key: tuple) -> Array:
        chosen = [np.arange(size)[part] for size, part in zip(self.shape, key, strict=True)]
        places = [np.atleast_1d(part) for part in chosen]
        values = np.full([part.size for part in places], np.nan)
        outer, inner = places[: self._names.ndim], places[self._names.ndim :]
        wanted = [every[part] for every, part in zip(self._every.values(), inner, strict=True)]
        for place, name in np.ndenumerate(self._names[np.ix_(*outer)]):
            if name in self._labels:
                pairs = [_match(each, self._labels[name][d]) for d, each in zip(self._every, wanted, strict=True)]
                stored = np.load(self._folder / name / f"{self._key}.npy", mmap_mode="r")
                values[place][np.ix_(*(to for to, _ in pairs))] = stored[np.ix_(*(of for _, of in pairs))]
        return values.reshape([part.size for part in chosen if part.ndim])


def _match(wanted: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where in `wanted` labels stand that there are, and where in `labels` those are."""
    order = np.argsort(labels)
    nearest = order[np.searchsorted(labels, wanted, sorter=order).clip(max=labels.size - 1)]
    there = np.flatnonzero(labels[nearest] == wanted)
    return there, nearest[there]
