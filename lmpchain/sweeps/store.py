"""Results of a sweep on disk: shards of a Zarr store, and parts of unfinished shards.

    sweep.json              name of the results of the current sweep
    0123456789abcdef/       results, named by a hash of all options that determine them
        sweep.json          options of this sweep
        results.zarr        arrays over all scenes, in shards that are written once and whole
        parts/0000064.npz   results of the scenes from this number on, until their shard is complete
        parts/0000064.some.npz  results of some of them, from an earlier sweep

A file gets its name only when it is complete and on the disk. `reason` is empty for scenes with a
result, and "not done" for scenes without a sealed shard or a part, even if a damaged file exists.

The layout is checked before use, by plain JSON and file names. No codec is created and no chunk is
opened before the store has passed this check. Seals verify that shards and coordinates are
complete:

    store.json              seal of the descriptions of all arrays, and of the coordinates
    shards/0000003.json     seal of one shard of every array

A seal lists files with their sizes and hashes, and is written when these files are on the disk. A
shard without a seal counts as not done, because it may be empty or missing after a power cut or an
interrupted copy. Zarr would read such a shard as one that was never written.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, short
from ..trajectory.gathered import file_name
from ..trajectory.zarr_store import KEYS, MOST_SHRUNK, codec_names, codec_names_in_shards, metadata
from ..util.arrays import Array
from ..util.files import (
    check_tree,
    flush_to_disk,
    read_sealed_json,
    replacing,
    sealed_json,
    unpack_one,
)
from ..util.lazy import cached_property
from ..util.provenance import checksum
from .file import Sweep
from .quantities import quantity

# Data types, and their codecs.
KINDS = {"float64": "bytes", "int64": "bytes", "string": "vlen-utf8"}
FILLS = {"float64": "NaN", "string": "not done"}  # Fill values for scenes without a result.
ENCODING = {"name": "default", "configuration": {"separator": "/"}}


class StoreSizes(NamedTuple):
    """Sizes of the files of a store.

    Attributes
    ----------
    shard_scenes : int
        Number of scenes in a shard divided by the number of arrays, so that 10^4 scenes need fewer
        than 100 files.
    shard_bytes : int
        Largest size of a shard, unless one batch is larger.
    chunk_bytes : int
        Largest piece of a shard that is read at once, unless one scene is larger.
    plain_bytes : int
        Largest size of an array without shards, which is read at once. A larger array is accepted
        if its compressed file is large enough for it.
    """

    shard_scenes: int = 160
    shard_bytes: int = 2**27
    chunk_bytes: int = 2**18
    plain_bytes: int = 2**26


STORE = StoreSizes()


def check_store(store: Path) -> tuple[int, dict[str, dict[str, Any]]]:
    """Return the scenes in a batch, and the metadata of every array by name.

    `OSError`, `ValueError`, `KeyError` or `TypeError` is raised if the store is not one that
    lmpchain writes.
    """
    check_tree(store)
    group = metadata(store)
    batch = group["attributes"].get("batch")
    if group.get("node_type") != "group" or type(batch) is not int or batch < 1:
        raise ValueError("it was not written by lmpchain")
    arrays = {}
    for node in sorted(store.iterdir()):
        if node.is_dir():
            arrays[node.name] = metadata(node)
            _check_array(node, arrays[node.name])
        elif node.name != "zarr.json":
            raise ValueError(f"{node.name} does not belong there")
    return batch, arrays


def _check_array(node: Path, array: dict[str, Any]) -> None:
    """Raise `ValueError` unless lmpchain stores an array in this way."""

    def require(condition: object, fault: str) -> None:
        if not condition:
            raise ValueError(f"{node.name} {fault}")

    strange = array.keys() - KEYS or array.get("storage_transformers")
    require(
        array["node_type"] == "array" and not strange,
        "is stored in a way that lmpchain does not use",
    )
    shape = array["shape"]
    dimensions = array["dimension_names"]
    sizes = shape and all(type(length) is int and length > 0 for length in shape)
    require(sizes and len(shape) == len(dimensions), "has a shape that lmpchain does not use")
    # Labels are written to pages and tables.
    labels = (*dimensions, *array["attributes"].values())
    require(
        all(isinstance(label, str) for label in labels), "has labels that lmpchain does not use"
    )
    kind = array["data_type"]
    require(kind in KINDS, "has a type of data that lmpchain does not use")
    grid = array["chunk_grid"]
    chunk = grid["configuration"]["chunk_shape"]
    usual = grid["name"] == "regular" and array["chunk_key_encoding"] == ENCODING
    if dimensions[0] == "scene":
        inner = array["codecs"][0]["configuration"]["chunk_shape"]
        codecs = codec_names_in_shards(array["codecs"], tuple(inner))
        usual &= _fits_shards(shape, chunk, inner) and array["fill_value"] == FILLS.get(kind)
    else:
        codecs = codec_names(array["codecs"])
        usual &= chunk == shape and _fits_file(shape, node)
    require(usual, "has chunks that lmpchain does not use, or claims more data than its file has")
    require(
        codecs == [KINDS[kind], "zstd", "crc32c"],
        "is stored with codecs that lmpchain does not use",
    )


def _fits_shards(shape: list[int], shard: list[int], chunk: list[int]) -> bool:
    """Return whether a shard consists of whole chunks of whole scenes, none of them too large."""
    scene_bytes = 8 * math.prod(shape[1:])
    return (
        chunk[0] > 0
        and shard[0] % chunk[0] == 0
        and shard[1:] == shape[1:] == chunk[1:]
        and chunk[0] * scene_bytes <= max(STORE.chunk_bytes, scene_bytes)
    )


def _fits_file(shape: list[int], node: Path) -> bool:
    """Return whether an array is small, or its compressed file large enough for its size."""
    stored = sum(path.stat().st_size for path in (node / "c").rglob("*") if path.is_file())
    return 8 * math.prod(shape) <= max(STORE.plain_bytes, MOST_SHRUNK * stored)


OF_STORE = "store.json"
OF_SHARDS = "shards"


def of_shard(folder: Path, shard: int) -> Path:
    """Return the path of the seal of a shard."""
    return folder / OF_SHARDS / f"{shard:07d}.json"


def write_seal(folder: Path, seal: Path, files: Iterable[Path]) -> None:
    """Seal files below a folder, once they are on the disk."""
    files = sorted(files)
    flush_to_disk(files)
    listed = {
        path.relative_to(folder).as_posix(): [path.stat().st_size, checksum(path)] for path in files
    }
    seal.parent.mkdir(exist_ok=True)
    with replacing(seal) as aside:
        aside.write_text(sealed_json({"files": listed}), encoding="utf-8")


def is_whole(folder: Path, seal: Path, thorough: bool = False) -> bool:
    """Return whether all listed files exist with their size and, if `thorough`, their hash."""
    record = read_sealed_json(seal)
    if record is None:
        return False
    try:
        return all(
            (folder / name).stat().st_size == size
            and (not thorough or checksum(folder / name) == digest)
            for name, (size, digest) in record["files"].items()
        )
    except (OSError, LookupError, TypeError, ValueError, AttributeError):
        return False


NAME = "sweep.json"
PARTS = "parts"
RESULTS = "results.zarr"
NOT_DONE = "not done"
SCALARS = {"model_error": "of the equation that was solved", "solver_error": "of its solution"}
# All names in a folder of results.
OWN = re.compile(
    rf"{re.escape(NAME)}|{PARTS}/[0-9]{{7}}(\.some)?\.npz|"
    rf"{OF_STORE}|{OF_SHARDS}/[0-9]+\.json|"
    rf"{re.escape(RESULTS)}/([^/]+/)?zarr\.json|{re.escape(RESULTS)}/[^/]+/c(/[0-9]+)+"
)
HALF_WRITTEN = re.compile(r"[^/]+\.[0-9a-f]{32}\.partial|\.[0-9]{7}(\.some)?\..*partial(\.npz)?")
# Dimensions, values and metadata by name.
Coordinates = Mapping[str, tuple[tuple[str, ...], Any, Mapping[str, str]]]


@dataclass(frozen=True)
class StoredArray:
    """An array over the scenes: its other dimensions and their lengths, type, unit and name."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    units: str
    long_name: str
    fill: Any = math.nan
    dtype: Any = "f8"


@dataclass(frozen=True)
class StoreLayout:
    """Shapes of the arrays and files in the store of a sweep.

    Attributes
    ----------
    count : int
        Number of scenes.
    batch : int
        Number of scenes in a part.
    columns : dict
        Arrays by name; `reason` is the last one.
    """

    count: int
    batch: int
    columns: Mapping[str, StoredArray]

    @cached_property
    def shard(self) -> int:
        """Scenes in a shard, a whole number of batches."""
        largest = 8 * max(math.prod(column.shape) for column in self.columns.values())
        # Few large files are written, because file systems of clusters are slow with small ones.
        scenes = min(STORE.shard_scenes * len(self.columns), max(1, STORE.shard_bytes // largest))
        return self.batch * math.ceil(min(scenes, self.count) / self.batch)

    @property
    def shards(self) -> int:
        """Number of shards of an array."""
        return math.ceil(self.count / self.shard)

    def batches(self, shard: int) -> range:
        """Return the first scene of each batch of a shard."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.count), self.batch)


def make_layout(
    keep: Sequence[str],
    count: int,
    batch: int,
    samples: int,
    grains: int,
    extra: Mapping[str, StoredArray],
) -> StoreLayout:
    """Return the layout of a store for these quantities, scenes, and lengths of the arrays."""
    lengths = {"time": samples, "grain": grains}
    columns = dict(extra)
    for key in keep:
        kind = quantity(key)
        name = file_name(key)
        shape = tuple(lengths[dimension] for dimension in kind.dimensions)
        columns[name] = StoredArray(kind.dimensions, shape, kind.units, kind.long_name)
        if not kind.recorded:
            error = f"uncertainty of {name} by sampling and by the error of the solution"
            columns[f"{name}_error"] = StoredArray(kind.dimensions, shape, kind.units, error)
    for name, cause in SCALARS.items():
        columns[name] = StoredArray((), (), "1", f"estimated relative error {cause}")
    columns["reason"] = StoredArray((), (), "1", "why there is no result", NOT_DONE, str)
    return StoreLayout(count, batch, columns)


def read_layout(folder: Path, plan: Sweep) -> StoreLayout:
    """Return the layout of the store of a sweep on the disk.

    Raises
    ------
    InputError
        If the store is missing, damaged, or does not have the layout of this sweep.
    """
    with _open_checked(folder) as (batch, arrays):
        if not intact(folder):
            raise ValueError("coordinates or descriptions were changed")
        laws = {law.key for axis in plan.axes for law in axis.arrays}
        extra = {}
        for name, array in arrays.items():
            inner = "sample" if name == "time" else f"{name}.entry"
            if (name == "time" or name in laws) and array["dimension_names"] == ["scene", inner]:
                extra[name] = StoredArray((inner,), (array["shape"][1],), **array["attributes"])
        samples = extra["time"].shape[0] if "time" in extra else arrays["time"]["shape"][0]
        grains = arrays["grain"]["shape"][0]
        layout = make_layout(plan.keep, plan.count, batch, samples, grains, extra)
        for name, column in layout.columns.items():
            _check_column(arrays[name], name, column, layout)
        labels = {"time", "grain"}
        labels |= {key for axis in plan.axes for key in (axis.name, *axis.columns)}
        if strange := arrays.keys() - layout.columns.keys() - labels:
            raise ValueError(f"{min(strange)} does not belong there")
    return layout


def _check_column(
    array: Mapping[str, Any], name: str, column: StoredArray, layout: StoreLayout
) -> None:
    """Raise `ValueError` unless an array on the disk matches this column of the layout."""
    expected = {
        "shape": [layout.count, *column.shape],
        "dimension_names": ["scene", *column.dimensions],
        "data_type": "string" if column.dtype is str else "float64",
    }
    shard = array["chunk_grid"]["configuration"]["chunk_shape"]
    fits = shard == [layout.shard, *column.shape]
    if not fits or any(array[key] != value for key, value in expected.items()):
        raise ValueError(f"{name} does not match its sweep")


def create_results(
    folder: Path, layout: StoreLayout, coordinates: Coordinates, swept: Mapping[str, int]
) -> None:
    """Make an empty store, or repair its metadata and keep its results."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    aside = folder / f".{RESULTS}.{token_hex(4)}.partial"
    pack: Any = [ZstdCodec(level=1), Crc32cCodec()]
    shard = layout.shard
    try:
        group = zarr.open_group(
            aside, mode="w", attributes={"batch": layout.batch, "swept": dict(swept)}
        )
        for name, column in layout.columns.items():
            scene_bytes = 8 * math.prod(column.shape)
            fits = max(STORE.chunk_bytes, scene_bytes)
            chunks = next(
                count
                for count in range(1, shard + 1)
                if shard % count == 0 and shard // count * scene_bytes <= fits
            )
            group.create_array(
                name,
                shape=(layout.count, *column.shape),
                chunks=(shard // chunks, *column.shape),
                shards=(shard, *column.shape),
                dtype=column.dtype,
                fill_value=column.fill,
                compressors=pack,
                dimension_names=("scene", *column.dimensions),
                attributes={"units": column.units, "long_name": column.long_name},
            )
        for name, (dimensions, values, attributes) in coordinates.items():
            array = np.asarray(values)
            text = array.dtype.kind == "U"
            group.create_array(
                name,
                shape=array.shape,
                chunks=array.shape,
                dtype=str if text else array.dtype,
                compressors=pack,
                dimension_names=dimensions,
                attributes=dict(attributes),
            )[:] = array.astype(object) if text else array
        # A kill before this line leaves a folder that `clean` removes.
        files = [path for path in aside.rglob("*") if path.is_file()]
        places = [folder / RESULTS / path.relative_to(aside) for path in files]
        if not (folder / RESULTS).exists():
            os.replace(aside, folder / RESULTS)
        else:
            for path, place in zip(files, places, strict=True):
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(path, place)
        write_seal(folder, folder / OF_STORE, places)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def open_store(folder: Path, writing: bool = False) -> Any:
    """Open the store of a sweep, if this package has written all of it.

    Raises
    ------
    InputError
        If the store is missing, damaged, or contains anything that this package would not write.
    """
    import zarr

    with _open_checked(folder):
        return zarr.open_group(
            folder / RESULTS, mode="r+" if writing else "r", zarr_format=3, use_consolidated=False
        )


@contextmanager
def _open_checked(folder: Path) -> Iterator[tuple[int, dict[str, dict[str, Any]]]]:
    """Check a store, yield batch and metadata; raise `InputError` if damage is found later."""
    try:
        yield check_store(folder / RESULTS)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        LookupError,
        RecursionError,
    ) as error:
        at = str(folder / RESULTS)
        raise InputError.at(at, f"is damaged ({short(error)}): sweep again") from None


def intact(folder: Path) -> bool:
    """Return whether the metadata and coordinates of a store are unchanged."""
    return is_whole(folder, folder / OF_STORE, thorough=True)


def complete(folder: Path, shard: int) -> bool:
    """Return whether a shard of every array exists."""
    return is_whole(folder, of_shard(folder, shard))


def part_of(folder: Path, first: int, whole: bool = True) -> Path:
    """Return the path of the part with this first scene; parts not `whole` lack some scenes."""
    return folder / PARTS / f"{first:07d}{'' if whole else '.some'}.npz"


def write_part(folder: Path, first: int, columns: Mapping[str, Array], whole: bool = True) -> None:
    """Write the results of some scenes; if `whole`, of all scenes of their batch."""
    with replacing(part_of(folder, first, whole)) as aside, open(aside, "wb") as opened:
        rows: Any = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        np.savez(opened, allow_pickle=False, **rows)
    if whole:
        part_of(folder, first, whole=False).unlink(missing_ok=True)


def read_part(path: Path, name: str, column: StoredArray) -> Array:
    """Return one array of a part; raise `InputError` if it is damaged."""
    try:
        values: Array = unpack_one(path, name)
        if values.shape[1:] != column.shape or values.dtype.kind not in (
            "U" if column.dtype is str else "f"
        ):
            raise ValueError("an array has another shape")
        return values
    except FileNotFoundError:
        raise
    except Exception as error:
        # A damaged file makes numpy and zipfile raise many kinds of errors.
        raise InputError.at(str(path), f"cannot be read ({error}): sweep again") from None


def join_parts(folder: Path, layout: StoreLayout, shard: int) -> None:
    """Write a shard of every array from its parts, and remove these."""
    parts = [part_of(folder, first) for first in layout.batches(shard)]
    if not complete(folder, shard):
        try:
            _write_shard(folder, layout, shard, parts)
        except FileNotFoundError:
            # Another process may have written the shard meanwhile.
            if not complete(folder, shard):
                raise
    # The parts are removed only after the shard is whole.
    for path in parts:
        path.unlink(missing_ok=True)


def _write_shard(folder: Path, layout: StoreLayout, shard: int, parts: Sequence[Path]) -> None:
    """Write a shard of every array from its parts, and seal it when it is on the disk."""
    store = open_store(folder, writing=True)
    for name, column in layout.columns.items():
        values: Any = np.concatenate([read_part(path, name, column) for path in parts])
        values = values.astype(object) if column.dtype is str else values
        store[name][shard * layout.shard : shard * layout.shard + len(values)] = values
    # Zarr writes no shard for scenes without any results.
    files = [path for name in layout.columns for path in _shard_files(folder, name, shard)]
    write_seal(folder, of_shard(folder, shard), files)


def _shard_files(folder: Path, name: str, shard: int) -> list[Path]:
    """Return the file of a shard of an array, if it exists."""
    place = folder / RESULTS / name / "c" / str(shard)
    return [path for path in (place, *place.rglob("*")) if path.is_file()]


def parts_of(folder: Path) -> dict[int, Path]:
    """Return the parts on the disk, whole or not, by their first scene."""
    return _parts(folder, ".some") | whole_parts(folder)


def whole_parts(folder: Path) -> dict[int, Path]:
    """Return the parts that are whole, by their first scene."""
    return _parts(folder, "")


def _parts(folder: Path, kind: str) -> dict[int, Path]:
    pattern = re.compile(rf"([0-9]{{7}}){re.escape(kind)}\.npz")
    paths = sorted((folder / PARTS).glob("*.npz"))
    matches = ((pattern.fullmatch(path.name), path) for path in paths)
    return {int(match[1]): path for match, path in matches if match}


def clean(folder: Path, layout: StoreLayout) -> None:
    """Remove incomplete files of killed processes."""
    for place in (folder / PARTS, folder / RESULTS):
        for path in place.rglob("*.partial*"):
            if HALF_WRITTEN.fullmatch(path.name):
                path.unlink(missing_ok=True)
    for path in folder.glob(f".{RESULTS}.*.partial"):
        shutil.rmtree(path, ignore_errors=True)
    for first, path in parts_of(folder).items():
        if complete(folder, first // layout.shard):
            path.unlink(missing_ok=True)


def forget_damaged(folder: Path, layout: StoreLayout) -> None:
    """Delete damaged results, so that they are computed again."""
    for shard in range(layout.shards):
        seal = of_shard(folder, shard)
        if not is_whole(folder, seal, thorough=True):
            seal.unlink(missing_ok=True)
            # Zarr would read the old file before it writes the shard anew.
            for name in layout.columns:
                for path in _shard_files(folder, name, shard):
                    path.unlink()
    for path in parts_of(folder).values():
        try:
            for name, column in layout.columns.items():
                read_part(path, name, column)
        except (InputError, FileNotFoundError):
            path.unlink(missing_ok=True)


def remove_results(folder: Path) -> None:
    """Remove a folder of results unless it contains foreign files."""
    names = [path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir()]
    if all(OWN.fullmatch(name.as_posix()) for name in names):
        shutil.rmtree(folder, ignore_errors=True)


def read_column(
    folder: Path,
    layout: StoreLayout,
    name: str,
    numbers: np.ndarray,
    entries: Sequence[np.ndarray] = (),
) -> Array:
    """Return an array at these scenes and entries, NaN for missing results."""
    array = open_store(folder)[name]
    column = layout.columns[name]
    shards = numbers // layout.shard
    whole = [shard for shard in np.unique(shards).tolist() if complete(folder, shard)]
    spots = np.flatnonzero(np.isin(shards, whole))
    lengths = [entry.size for entry in entries] if entries else column.shape
    values: Array = np.full((numbers.size, *lengths), column.fill, array.dtype)
    rows: Any = numbers[spots]
    if spots.size and (np.diff(rows) == 1).all():
        # Slices are read much faster.
        rows = slice(int(rows[0]), int(rows[0]) + spots.size)
    try:
        if spots.size:
            values[spots] = array.oindex[(rows, *entries)] if entries else array.oindex[rows]
    except Exception as error:
        # A damaged file makes zarr raise many kinds of errors.
        raise InputError.at(
            str(folder / RESULTS / name), f"is damaged ({error}): sweep again"
        ) from None
    batches = set(np.unique(numbers // layout.batch * layout.batch).tolist())
    for first, path in parts_of(folder).items():
        if first in batches and first // layout.shard not in whole:
            results = read_part(path, name, column)
            spots = np.flatnonzero((numbers >= first) & (numbers < first + len(results)))
            results = results[numbers[spots] - first]
            for axis, entry in enumerate(entries, 1):
                results = np.take(results, entry, axis)
            values[spots] = results
    return values
