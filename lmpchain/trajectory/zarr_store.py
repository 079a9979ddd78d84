"""Trajectories as Zarr stores that can be read while they grow, in whole shards.

The length of every array is fixed beforehand, and all values are NaN until they are written. The
time of a sample is written last, so that a sample with a time is complete. Zarr writes every file
under another name and renames it, so that a killed run leaves no incomplete file.

The layout is checked before use, by plain JSON and file names. No codec is created and no chunk is
opened before the check has passed.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from secrets import token_hex
from types import EllipsisType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ..errors import InputError
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import LARGEST_JSON, check_readable, check_tree
from . import gathered
from .record import (
    DATA_TYPES,
    DIMENSIONS,
    FIELDS,
    LABELS,
    Block,
    Cost,
    ErrorEstimate,
    read_scene,
    shapes,
    verdict,
)

if TYPE_CHECKING:
    import xarray

MOST_SHRUNK = 1000  # Largest factor by which a codec compresses consecutive numbers.
SHRUNK = ["bytes", "blosc", "crc32c"]
SHRUNK_ONCE = ["bytes", "zstd"]  # Codecs of the grain numbers in older stores.
INDEX = ["bytes", "crc32c"]
KEYS = {
    "shape",
    "data_type",
    "chunk_grid",
    "chunk_key_encoding",
    "fill_value",
    "codecs",
    "attributes",
    "dimension_names",
    "zarr_format",
    "node_type",
    "storage_transformers",
}
# Options of the codecs that lmpchain writes.
CODECS: dict[str, set[str]] = {
    "bytes": {"endian"},
    "zstd": {"level", "checksum"},
    "crc32c": set(),
    "vlen-utf8": set(),
    "blosc": {"typesize", "cname", "clevel", "shuffle", "blocksize"},
}
Piece = tuple[int, ...]


class ChunkSizes(NamedTuple):
    """Sizes of the chunks of a run folder.

    Attributes
    ----------
    samples : int
        Number of samples in a shard. If a chain has few grains, a multiple of it fills the chunks.
    grains : int
        Largest number of grains in a chunk. With this size, the trace of a grain or a snapshot is
        read in about 20 ms.
    times : int
        Smallest number of times in a chunk.
    """

    samples: int = 16
    grains: int = 12_500
    times: int = 65_536


CHUNKS = ChunkSizes()


def file_shapes(samples: int, grains: int) -> dict[str, Piece]:
    """Return the shapes of the files of each array, and of a chunk of the fields."""
    count = math.ceil(grains / CHUNKS.grains)
    width = math.ceil(grains / count)
    rows = CHUNKS.samples * math.ceil(min(samples / CHUNKS.samples, CHUNKS.grains / grains))
    # All times of a shard are in one chunk, which is replaced atomically.
    times = rows * math.ceil(CHUNKS.times / rows)
    return {
        "time": (min(times, samples),),
        "grain": (grains,),
        **dict.fromkeys(FIELDS, (rows, width * count)),
        "chunk": (rows, width),
    }


def stores(scene: Scene, present: Collection[str]) -> dict[str, Piece]:
    """Return the file shapes of each array of a scene; see `pieces` and `shapes`."""
    return shapes(scene, present) | file_shapes(scene.samples, scene.count(scene.chain))


def metadata(node: Path) -> dict[str, Any]:
    """Return the metadata of a Zarr 3 array or group; raise `ValueError` for other content."""
    path = node / "zarr.json"
    if path.exists():
        check_readable(path, LARGEST_JSON)
        data = json.loads(path.read_bytes())
        current = isinstance(data, dict) and data.get("zarr_format") == 3
        if current and isinstance(data.get("attributes"), dict):
            return data
    raise ValueError(f"{node.name} is not in Zarr format 3")


def check_layout(store: Path, scene: Scene) -> None:
    """Raise `ValueError` unless the arrays have the sizes of this scene and lmpchain's layout."""
    names = {path.name for path in store.iterdir() if path.is_dir()}
    arrays = shapes(scene, names)
    sizes = stores(scene, names)
    chunk = sizes["chunk"]
    if metadata(store).get("node_type") != "group" or names - arrays.keys():
        raise ValueError("it was not written by lmpchain, or contains further data")
    for name, shape in arrays.items():
        array = metadata(store / name)
        expected = {
            "node_type": "array",
            "shape": list(shape),
            "data_type": DATA_TYPES.get(name, "float64"),
            "chunk_grid": _configure("regular", chunk_shape=list(sizes[name])),
            "chunk_key_encoding": _configure("default", separator="/"),
            "fill_value": 0 if name == "grain" else "NaN",
        }
        for key, value in expected.items():
            if array.get(key) != value:
                raise ValueError(f"the {key} of {name} differs from that of its scene")
        if array.keys() - KEYS or array.get("storage_transformers"):
            raise ValueError(f"{name} is stored in a way that lmpchain does not use")
        nested = array["codecs"]
        codecs = codec_names_in_shards(nested, chunk) if name in FIELDS else codec_names(nested)
        if codecs != SHRUNK and not (name == "grain" and codecs == SHRUNK_ONCE):
            raise ValueError(f"{name} is stored with codecs that lmpchain does not use")
        # Chunks within a shard would have to be located first.
        if name not in FIELDS:
            _check_claims(store / name / "c", math.prod(sizes[name]), blosc=codecs == SHRUNK)


def _check_claims(chunks: Path, length: int, blosc: bool) -> None:
    """Raise `ValueError` if a chunk declares more numbers than it can contain."""
    for path in chunks.glob("[0-9]*"):
        # A file that is being written has a name with letters other than digits.
        if not path.name.isdecimal():
            continue
        with open(path, "rb") as opened:
            head = opened.read(8)
        # The header of blosc contains the unpacked size.
        claim = int.from_bytes(head[4:], "little") if blosc else 8 * length
        if claim != 8 * length or claim > MOST_SHRUNK * path.stat().st_size:
            raise ValueError("it declares more numbers than it can contain")


def _configure(name: str, **configuration: Any) -> dict[str, Any]:
    return {"name": name, "configuration": configuration}


def codec_names(codecs: Any) -> list[str]:
    """Return the names of codecs that contain no other codec."""
    for codec in codecs:
        if codec["name"] not in CODECS or codec.keys() - {"name", "configuration"}:
            raise ValueError("it is stored with codecs that lmpchain does not use")
        if codec.get("configuration", {}).keys() - CODECS[codec["name"]]:
            raise ValueError("its codecs have options that lmpchain does not use")
    return [codec["name"] for codec in codecs]


def codec_names_in_shards(codecs: Any, chunk: Piece) -> list[str]:
    """Return the names of the codecs inside the shard codec with chunks of this shape."""
    (outer,) = codecs
    inside = outer["configuration"]
    if outer["name"] != "sharding_indexed" or inside["chunk_shape"] != list(chunk):
        raise ValueError("its shards differ from those that lmpchain writes")
    if codec_names(inside["index_codecs"]) != INDEX or inside.get("index_location", "end") != "end":
        raise ValueError("its shards differ from those that lmpchain writes")
    return codec_names(inside["codecs"])


NAME = "trajectory.zarr"
SO_FAR = "error_so_far"  # Attribute of an unfinished run.


def create_zarr(folder: Path, scene: Scene, attributes: Mapping[str, Any]) -> None:
    """Make an empty store, replacing an existing one."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    group = zarr.open_group(folder / NAME, mode="w", zarr_format=3, attributes=dict(attributes))
    samples = scene.samples
    grains = scene.recorded.size
    sizes = file_shapes(samples, grains)
    shrink: Any = [BloscCodec(cname="zstd", clevel=1, shuffle="shuffle"), Crc32cCodec()]

    def make(name: str, dimensions: tuple[str, ...], labels: Any, **options: Any) -> None:
        labelled: Any = {"dimension_names": dimensions, "attributes": labels}
        group.create_array(name, compressors=shrink, **labelled, **options)

    # Values are NaN until they are written, so that a missing sample is not mistaken for rest.
    unknown: Any = {"dtype": "f8", "fill_value": math.nan}
    fields = {"shape": (samples, grains), "chunks": sizes["chunk"]} | unknown
    for name in FIELDS:
        make(name, DIMENSIONS, LABELS[name], shards=sizes[name], **fields)
    make("time", ("time",), LABELS["time"], shape=(samples,), chunks=sizes["time"], **unknown)
    make("grain", ("grain",), LABELS["grain"], data=scene.recorded, chunks=sizes["grain"])
    for name, layout in gathered.arrays(scene).items():
        shape = {"shape": layout.shape, "chunks": layout.shape}
        make(gathered.file_name(name), layout.dimensions, layout.labels, **shape, **unknown)
    _consolidate(folder / NAME)


def _consolidate(store: Path) -> None:
    """Copy the metadata of all arrays to the group, where xarray looks first.

    `zarr.consolidate_metadata` does the same, but warns that such metadata are not a standard yet.
    The warning cannot be suppressed in one thread only, because all threads share the filters of
    Python.
    """
    described = {
        path.parent.name: json.loads(path.read_bytes()) for path in store.glob("*/zarr.json")
    }
    group = json.loads((store / "zarr.json").read_bytes())
    gathered_in = {"kind": "inline", "must_understand": False}
    group["consolidated_metadata"] = gathered_in | {"metadata": dict(sorted(described.items()))}
    # The name matches zarr's pattern for files that are being written.
    aside = store / f"zarr.{token_hex(16)}.partial"
    aside.write_text(json.dumps(group, indent=2), encoding="utf-8")
    os.replace(aside, store / "zarr.json")


class Writer:
    """Writer that appends samples to a store, from a given sample on, shard by shard."""

    def __init__(self, folder: Path, scene: Scene, sample: int = 0):
        import zarr

        self._group: Any = zarr.open_group(folder / NAME, mode="r+")
        self._fields: list[Any] = [self._group[name] for name in FIELDS]
        self._times = scene.time
        self._rows = self._fields[0].shards[0]
        self._buffers = np.empty((len(FIELDS), self._rows, scene.recorded.size))
        times: Any = self._group["time"]
        self._stored = int(np.isfinite(times[:]).sum())
        self._go_to(sample - sample % self._rows)
        self._end = sample

    def _go_to(self, first: int) -> None:
        """Begin a shard with its stored samples, so that readers never lose a sample."""
        self._first = self._end = first
        self._buffers.fill(math.nan)
        if first < self._stored:
            with suppress(ValueError):
                # Damaged samples are written again.
                for buffer, array in zip(self._buffers, self._fields, strict=True):
                    samples = array[first : first + self._rows]
                    buffer[: len(samples)] = samples

    def put(self, block: Block) -> None:
        """Append samples; write complete shards to disk."""
        fields = block.displacement[0], block.velocity[0]
        written = 0
        count = len(fields[0])
        # A block may end within a shard, or span several shards.
        while written < count:
            row = self._end - self._first
            rows = slice(row, min(self._rows, row + count - written))
            size = rows.stop - row
            for buffer, values in zip(self._buffers, fields, strict=True):
                # Grains that the wave has not reached are at rest.
                buffer[rows] = 0.0
                buffer[rows, block.columns] = values[written : written + size]
            written += size
            self._end += size
            if rows.stop == self._rows:
                self.flush()
                self._go_to(self._end)

    def flush(self) -> None:
        """Write all pending samples to disk, and their times last."""
        if self._end > self._first:
            last = min(self._first + self._rows, self._times.size)
            for array, buffer in zip(self._fields, self._buffers, strict=True):
                array[self._first : last] = buffer[: last - self._first]
            # Readers treat a sample as complete when its time is stored.
            self._group["time"][self._first : self._end] = self._times[self._first : self._end]

    def note(self, error: ErrorEstimate) -> None:
        """Store the error estimate of the samples so far, if it is finite."""
        if math.isfinite(error.total):
            self._group.attrs[SO_FAR] = {"samples": self._end} | asdict(error)

    def conclude(self, error: ErrorEstimate, cost: Cost, quantities: Mapping[str, Array]) -> None:
        """Store the error estimate, the cost and the accumulated quantities."""
        for name, values in quantities.items():
            self._group[gathered.file_name(name)][...] = values
        self._group.attrs.update(verdict(error, cost) | {SO_FAR: None})


def usable(folder: Path, scene: Scene, samples: Any) -> bool:
    """Return whether the first samples are complete, and the shard of the next is readable."""
    import zarr

    if isinstance(samples, bool) or not isinstance(samples, int):
        return False
    if not 0 <= samples <= scene.samples:
        return False
    if not samples:
        return True
    try:
        check_layout(folder / NAME, scene)
        group: Any = zarr.open_group(folder / NAME, mode="r", zarr_format=3)
        first = samples - samples % group[FIELDS[0]].shards[0]
        arrays = (group["time"][:samples], *(group[name][first:samples] for name in FIELDS))
        return all(bool(np.isfinite(array).all()) for array in arrays)
    except Exception:
        # Damaged files make zarr raise any kind of error.
        return False


def read_zarr(folder: Path) -> tuple[dict[str, Any], Scene, dict[str, Any]]:
    """Return metadata, scene and arrays of the complete samples; fields are read on demand.

    For an unfinished run, the error is the last stored estimate, or infinite if samples were
    written after it. If the store is damaged or was not written by lmpchain, an exception of any
    kind is raised before any array is opened.
    """
    import xarray

    check_tree(folder / NAME)
    attributes = metadata(folder / NAME)["attributes"]
    scene = read_scene(attributes)
    check_layout(folder / NAME, scene)
    data = xarray.open_dataset(
        folder / NAME,
        engine="zarr",
        chunks=None,
        cache=False,
        decode_cf=False,
        zarr_format=3,
        consolidated=False,
    )
    finished = "solver_error" in attributes
    complete = int(np.isfinite(data["time"].to_numpy()).sum())
    if finished and complete < scene.samples:
        raise ValueError("the run was finished, but samples are missing")
    data = data.isel(time=slice(0, complete))
    names = ["time", "grain"]
    if finished:
        names += map(gathered.file_name, gathered.arrays(scene))
        # Some engines do not accumulate energies.
        energies = gathered.energies(scene)
        names = [n for n in names if n not in energies or (n in data and data[n].notnull().all())]
    arrays: dict[str, Any] = {name: data[name].to_numpy() for name in names}
    arrays |= {name: OnDisk(data[name].variable) for name in FIELDS}
    no_cost = Cost(0.0, 0.0, 0.0, 0, 0, data.sizes["grain"], "unknown", 0.0, 1)
    result = verdict(_error_so_far(attributes, complete), no_cost) | attributes
    return result, scene, arrays


def _error_so_far(attributes: Mapping[str, Any], samples: int) -> ErrorEstimate:
    """Return the stored estimate of an unfinished run; infinite if it covers fewer samples."""
    stored = attributes.get(SO_FAR)
    if stored and stored["samples"] >= samples:
        return ErrorEstimate(stored["model"], stored["solver"])
    return ErrorEstimate(0.0, math.inf)


class OnDisk(NDArrayOperatorsMixin):
    """An array on disk with the interface of a NumPy array, read on demand.

    Indexing reads only the selected values. All other operations of NumPy read the whole array.
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
        plain = int | np.integer | slice | EllipsisType
        indices = [index for index in keys if not isinstance(index, plain)]
        # Rules of xarray and numpy differ.
        if len(indices) > 1 or any(np.ndim(index) != 1 for index in indices):
            return np.asarray(self)[key]
        return self._read(self.variable[key])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.asarray(self._read(self.variable), dtype)

    def _read(self, variable: xarray.Variable) -> Any:
        try:
            values = variable.to_numpy()
        except (ValueError, RuntimeError, OSError) as error:
            fault = str(error)
        else:
            if np.isfinite(values).all():
                return values
            fault = "samples are missing"
        raise InputError.at(NAME, f"was damaged and cannot be read: {fault}; run the scene anew")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if any(isinstance(value, OnDisk) for value in options.get("out", ())):
            cure = "change a copy, numpy.array(...), of the array"
            raise InputError.at(NAME, f"is a result, which is not changed: {cure}")
        read = (np.asarray(value) if isinstance(value, OnDisk) else value for value in inputs)
        return getattr(ufunc, method)(*read, **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "variable":
            # Python asks for these attributes during construction.
            raise AttributeError(name)
        return getattr(np.asarray(self), name)
