"""Trajectories as Zarr stores that can be read while they grow, in whole shards.

The length of every array is fixed beforehand, and its values are NaN until they are known. A sample
is complete when its time is there, which is written last. Zarr moves every file into place, so a
kill leaves none half written.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ..errors import InputError
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import check_tree
from . import gathered
from .record import FIELDS, LABELS, Block, Cost, ErrorEstimate, scene_of, verdict
from .zarr_layout import check, metadata, pieces

if TYPE_CHECKING:
    import xarray

NAME = "trajectory.zarr"
SO_FAR = "error_so_far"  # attribute of a run that is not finished


def create(folder: Path, scene: Scene, attributes: Mapping[str, Any]) -> None:
    """Make an empty store, in place of one that is there."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    group = zarr.open_group(folder / NAME, mode="w", zarr_format=3, attributes=dict(attributes))
    samples = scene.samples
    grains = scene.recorded.size
    sizes = pieces(samples, grains)
    shrunk: Any = {
        "compressors": [BloscCodec(cname="zstd", clevel=1, shuffle="shuffle"), Crc32cCodec()]
    }
    unknown: Any = {"dtype": "f8", "fill_value": math.nan} | shrunk
    for name in FIELDS:
        group.create_array(
            name,
            shape=(samples, grains),
            chunks=sizes["chunk"],
            shards=sizes[name],
            dimension_names=("time", "grain"),
            attributes=LABELS[name],
            **unknown,
        )
    group.create_array(
        "time",
        shape=(samples,),
        chunks=sizes["time"],
        dimension_names=("time",),
        attributes=LABELS["time"],
        **unknown,
    )
    group.create_array(
        "grain",
        data=scene.recorded,
        chunks=sizes["grain"],
        dimension_names=("grain",),
        attributes=LABELS["grain"],
        **shrunk,
    )
    for name, kind in gathered.arrays(scene).items():
        group.create_array(
            gathered.stored(name),
            shape=kind.shape,
            chunks=kind.shape,
            dimension_names=kind.dimensions,
            attributes=kind.labels,
            **unknown,
        )
    # consolidated metadata, which xarray reads first
    with warnings.catch_warnings(action="ignore"):
        zarr.consolidate_metadata(folder / NAME)


class Writer:
    """Appends samples to a store, from a given one on, shard by shard."""

    def __init__(self, folder: Path, scene: Scene, sample: int = 0):
        import zarr

        self._group: Any = zarr.open_group(folder / NAME, mode="r+")
        self._fields: list[Any] = [self._group[name] for name in FIELDS]
        self._times = scene.time
        self._rows = self._fields[0].shards[0]
        self._buffers = np.empty((len(FIELDS), self._rows, scene.recorded.size))
        times: Any = self._group["time"]
        self._known = int(np.isfinite(times[:]).sum())
        self._go_to(sample - sample % self._rows)
        self._end = sample

    def _go_to(self, first: int) -> None:
        """Begin a shard. What the store holds of it stays, so that no reader sees a sample vanish."""
        self._first = self._end = first
        self._buffers.fill(math.nan)
        if first < self._known:
            with suppress(ValueError):  # damaged samples to come are written anew
                for buffer, array in zip(self._buffers, self._fields, strict=True):
                    known = array[first : first + self._rows]
                    buffer[: len(known)] = known

    def put(self, block: Block) -> None:
        """Append samples; full shards are written to the disk."""
        fields = block.displacement[0], block.velocity[0]
        done = 0
        count = len(fields[0])
        while done < count:
            row = self._end - self._first
            taken = min(self._rows - row, count - done)
            for buffer, values in zip(self._buffers, fields, strict=True):
                buffer[row : row + taken] = 0.0
                buffer[row : row + taken, block.columns] = values[done : done + taken]
            done += taken
            self._end += taken
            if row + taken == self._rows:
                self.flush()
                self._go_to(self._end)

    def flush(self) -> None:
        """Write all pending samples to the disk, their times last."""
        if self._end > self._first:
            last = min(self._first + self._rows, self._times.size)
            for array, buffer in zip(self._fields, self._buffers, strict=True):
                array[self._first : last] = buffer[: last - self._first]
            self._group["time"][self._first : self._end] = self._times[self._first : self._end]

    def note(self, error: ErrorEstimate) -> None:
        """Store the error estimate of the samples so far, if it is finite."""
        if math.isfinite(error.total):
            self._group.attrs[SO_FAR] = {"samples": self._end} | asdict(error)

    def conclude(self, error: ErrorEstimate, cost: Cost, found: Mapping[str, Array]) -> None:
        """Store the error estimate, the cost, and what was gathered."""
        for name, values in found.items():
            self._group[gathered.stored(name)][...] = values
        self._group.attrs.update(verdict(error, cost) | {SO_FAR: None})


def usable(folder: Path, scene: Scene, samples: Any) -> bool:
    """Say whether so many samples are complete and readable, up to the shard of the next one."""
    import zarr

    if (
        isinstance(samples, bool)
        or not isinstance(samples, int)
        or not 0 <= samples <= scene.samples
    ):
        return False
    if not samples:
        return True
    try:
        check(folder / NAME, scene)
        group: Any = zarr.open_group(folder / NAME, mode="r", zarr_format=3)
        first = samples - samples % group[FIELDS[0]].shards[0]
        parts = (group["time"][:samples], *(group[name][first:samples] for name in FIELDS))
        return all(bool(np.isfinite(part).all()) for part in parts)
    except Exception:  # whatever damaged files make zarr raise
        return False


def read(folder: Path) -> tuple[dict[str, Any], Scene, dict[str, Any]]:
    """Return metadata, scene and arrays of the complete samples of a store; fields are read on demand.

    Of a run that is not finished, the error is the estimate so far, or infinite if more samples are
    there than it is of. Foreign or damaged stores raise whatever comes first, before any of their
    arrays is opened.
    """
    import xarray

    check_tree(folder / NAME)
    about = metadata(folder / NAME)["attributes"]
    scene = scene_of(about)
    check(folder / NAME, scene)
    data = xarray.open_dataset(
        folder / NAME,
        engine="zarr",
        chunks=None,
        cache=False,
        decode_cf=False,
        zarr_format=3,
        consolidated=False,
    )
    complete = int(np.isfinite(data["time"].to_numpy()).sum())
    if "solver_error" in about and complete < scene.samples:
        raise ValueError("the run was finished, but samples are not there")
    data = data.isel(time=slice(0, complete))
    nothing = Cost(0.0, 0.0, 0.0, 0, 0, data.sizes["grain"], "unknown", 0.0, 1)
    noted = about.get(SO_FAR) or {"samples": -1}
    error = (noted["model"], noted["solver"]) if noted["samples"] >= complete else (0.0, math.inf)
    arrays = {name: data[name].to_numpy() for name in ("time", "grain")}
    fields = {name: OnDisk(data[name].variable) for name in FIELDS}
    if "solver_error" in about:
        arrays |= {
            name: data[name].to_numpy() for name in map(gathered.stored, gathered.arrays(scene))
        }
    return verdict(ErrorEstimate(*error), nothing) | about, scene, arrays | fields


class OnDisk(NDArrayOperatorsMixin):
    """An array on disk with the interface of a NumPy array, read on demand.

    Anything else that numpy can do with an array reads all of it.
    """

    def __init__(self, variable: xarray.Variable):
        self.variable = variable
        self.shape = variable.shape
        self.dtype = variable.dtype
        self.ndim = variable.ndim
        self.size = variable.size

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        keys = key if isinstance(key, tuple) else (key,)
        fancy = [
            part for part in keys if not isinstance(part, int | np.integer | slice | EllipsisType)
        ]
        # rules of xarray and numpy differ
        if len(fancy) > 1 or any(np.ndim(part) != 1 for part in fancy):
            return np.asarray(self)[key]
        return self._read(self.variable[key])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.asarray(self._read(self.variable), dtype)

    def _read(self, part: xarray.Variable) -> Any:
        try:
            values = part.to_numpy()
        except (ValueError, RuntimeError, OSError) as error:
            why = str(error)
        else:
            if np.isfinite(values).all():
                return values
            why = "samples are not there"
        raise InputError.at(NAME, f"was damaged and cannot be read: {why}; run the scene anew")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        read = (np.asarray(value) if isinstance(value, OnDisk) else value for value in inputs)
        return getattr(ufunc, method)(*read, **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "variable":  # asked for during construction
            raise AttributeError(name)
        return getattr(np.asarray(self), name)
