"""The results of a sweep on the disk: shards of a Zarr store, and parts of unfinished ones.

    sweep.json              which sweep the folder is about
    0123456789abcdef/       the results of a sweep, under a hash of all that shapes them
        sweep.json          that sweep
        results.zarr        arrays over all scenes, in shards that are written once and whole
        parts/0000064.npz   what has been found for the scenes from this one on, until their shard is complete
        parts/0000064.some.npz  the same if only some of them are known, from an earlier sweep

Every file appears under its name when it is whole. The shards of `reason` are written last: it is
empty for scenes that have an answer, and stays "not done" where there is no shard.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np

from ..errors import InputError, short
from ..trajectory.gathered import stored
from ..util.arrays import Array
from ..util.cached import cached_property
from ..util.files import unpack_one
from .file import Sweep
from .quantities import quantity
from .store_check import CHUNK_BYTES, described

NAME = "sweep.json"
PARTS = "parts"
RESULTS = "results.zarr"
NOT_DONE = "not done"
SCENES_A_FILE = 160  # at least, in a shard, for every array: 100 files hold 10^4 scenes,
SHARD_BYTES = 2**27  # unless a shard would be larger than this
SCALARS = {"model_error": "of the equation that was solved", "solver_error": "of its solution"}


# dimensions, values and metadata
Coordinates = Mapping[str, tuple[tuple[str, ...], Any, Mapping[str, str]]]


@dataclass(frozen=True)
class Column:
    """An array over the scenes: its other dimensions and their lengths, type, unit and name."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    units: str
    long_name: str
    fill: Any = math.nan
    dtype: Any = "f8"


@dataclass(frozen=True)
class Layout:
    """What the store of a sweep looks like.

    Attributes
    ----------
    count : int
        Scenes.
    batch : int
        Of these, in a part.
    columns : dict
        The arrays, `reason` last.
    """

    count: int
    batch: int
    columns: Mapping[str, Column]

    @cached_property
    def shard(self) -> int:
        """Scenes in a shard, a whole number of batches."""
        largest = 8 * max(math.prod(column.shape) for column in self.columns.values())
        wanted = min(SCENES_A_FILE * len(self.columns), max(1, SHARD_BYTES // largest))
        return self.batch * math.ceil(min(wanted, self.count) / self.batch)

    @property
    def shards(self) -> int:
        """How many shards an array has."""
        return math.ceil(self.count / self.shard)

    def batches(self, shard: int) -> range:
        """Return the first scene of every part of a shard."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.count), self.batch)


def layout(
    keep: Sequence[str],
    count: int,
    batch: int,
    samples: int,
    grains: int,
    extra: Mapping[str, Column],
) -> Layout:
    """Return what the store looks like for these quantities, scenes, and lengths of the arrays."""
    lengths = {"time": samples, "grain": grains}
    columns = dict(extra)
    for name in keep:
        kept = quantity(name)
        name = stored(name)
        shape = tuple(lengths[key] for key in kept.dimensions)
        columns[name] = Column(kept.dimensions, shape, kept.units, kept.long_name)
        if not kept.whole:
            error = f"how far {name} may be off, by sampling and by the error of the solution"
            columns[f"{name}_error"] = Column(kept.dimensions, shape, kept.units, error)
    for name, what in SCALARS.items():
        columns[name] = Column((), (), "1", f"estimated relative error {what}")
    columns["reason"] = Column((), (), "1", "why there is no answer", NOT_DONE, str)
    return Layout(count, batch, columns)


def laid_out(folder: Path, plan: Sweep) -> Layout:
    """Return what the store of a sweep that is there looks like.

    Raises
    ------
    InputError
        If it is not there, damaged, or not laid out as this package does it for this sweep.
    """
    with _checked(folder) as (batch, arrays):
        drawn = {each.key: f"{each.key}.entry" for axis in plan.axes for each in axis.arrays}
        extra = {}
        for name, about in arrays.items():
            if about["dimension_names"] == [
                "scene",
                drawn.get(name, "sample" if name == "time" else None),
            ]:
                extra[name] = Column(
                    (about["dimension_names"][1],), (about["shape"][1],), **about["attributes"]
                )
        samples = extra["time"].shape[0] if "time" in extra else arrays["time"]["shape"][0]
        made = layout(plan.keep, plan.count, batch, samples, arrays["grain"]["shape"][0], extra)
        for name, column in made.columns.items():
            about = arrays[name]
            size = about["shape"], about["chunk_grid"]["configuration"]["chunk_shape"]
            kind = "string" if column.dtype is str else "float64"
            if (*size, about["dimension_names"], about["data_type"]) != (
                [made.count, *column.shape],
                [made.shard, *column.shape],
                ["scene", *column.dimensions],
                kind,
            ):
                raise ValueError(f"{name} is not that of its sweep")
        labels = {"time", "grain"} | {
            key for axis in plan.axes for key in (axis.name, *axis.columns)
        }
        if strange := arrays.keys() - made.columns.keys() - labels:
            raise ValueError(f"{min(strange)} does not belong there")
    return made


def create(folder: Path, made: Layout, coordinates: Coordinates, swept: Mapping[str, int]) -> None:
    """Make a store without results; it appears under its name when it is whole."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    aside = folder / f".{RESULTS}.{token_hex(4)}.partial"
    pack: Any = [ZstdCodec(level=1), Crc32cCodec()]
    try:
        group = zarr.open_group(
            aside, mode="w", attributes={"batch": made.batch, "swept": dict(swept)}
        )
        for name, column in made.columns.items():
            width = 8 * math.prod(column.shape)
            fits = max(CHUNK_BYTES, width)
            parts = next(
                n
                for n in range(1, made.shard + 1)
                if made.shard % n == 0 and made.shard // n * width <= fits
            )
            group.create_array(
                name,
                shape=(made.count, *column.shape),
                chunks=(made.shard // parts, *column.shape),
                shards=(made.shard, *column.shape),
                dtype=column.dtype,
                fill_value=column.fill,
                compressors=pack,
                dimension_names=("scene", *column.dimensions),
                attributes={"units": column.units, "long_name": column.long_name},
            )
        for name, (dimensions, values, about) in coordinates.items():
            array = np.asarray(values)
            text = array.dtype.kind == "U"
            stored = group.create_array(
                name,
                shape=array.shape,
                chunks=array.shape,
                dtype=str if text else array.dtype,
                compressors=pack,
                dimension_names=dimensions,
                attributes=dict(about),
            )
            stored[:] = array.astype(object) if text else array
        os.replace(aside, folder / RESULTS)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def open_store(folder: Path, writing: bool = False) -> Any:
    """Open the store of a sweep, if it is one that this package has written.

    Raises
    ------
    InputError
        If it is not there, damaged, or has anything in it that this package would not write.
    """
    import zarr

    with _checked(folder):
        return zarr.open_group(
            folder / RESULTS, mode="r+" if writing else "r", zarr_format=3, use_consolidated=False
        )


@contextmanager
def _checked(folder: Path) -> Iterator[tuple[int, dict[str, dict[str, Any]]]]:
    """Yield what `described` says of the store; raises `InputError` for any damage found meanwhile."""
    try:
        yield described(folder / RESULTS)
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
        raise InputError.at(
            at, f"is damaged ({short(error)}): remove {folder}, and sweep again"
        ) from None


def complete(folder: Path, shard: int) -> bool:
    """Say whether a shard is there."""
    return (folder / RESULTS / "reason" / "c" / str(shard)).exists()


def part_of(folder: Path, first: int, whole: bool = True) -> Path:
    """Return the path of the part that begins with a scene; some lack in one that is not whole."""
    return folder / PARTS / f"{first:07d}{'' if whole else '.some'}.npz"


def write_part(folder: Path, first: int, columns: Mapping[str, Array], whole: bool = True) -> None:
    """Write what has been found for some scenes."""
    path = part_of(folder, first, whole)
    aside = path.with_name(f".{path.stem}.{token_hex(4)}.partial")
    try:
        with open(aside, "wb") as opened:
            whole_rows: Any = {
                name: np.ascontiguousarray(values) for name, values in columns.items()
            }
            np.savez(opened, allow_pickle=False, **whole_rows)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    if whole:
        part_of(folder, first, whole=False).unlink(missing_ok=True)


def read_part(path: Path, name: str, column: Column) -> Array:
    """Return one array of a part; raises `InputError` if it is damaged."""
    try:
        values: Array = unpack_one(path, name)
        if values.shape[1:] != column.shape or values.dtype.kind not in (
            "U" if column.dtype is str else "f"
        ):
            raise ValueError("an array has another shape")
        return values
    except FileNotFoundError:
        raise
    except Exception as error:  # whatever a damaged file makes numpy and zipfile raise
        raise InputError.at(
            str(path), f"cannot be read ({error}): remove it, and sweep again"
        ) from None


def gather(folder: Path, made: Layout, shard: int) -> None:
    """Write a shard of every array from its parts, and remove these."""
    parts = [part_of(folder, first) for first in made.batches(shard)]
    if not complete(folder, shard):
        try:
            store = open_store(folder, writing=True)
            for name, column in made.columns.items():  # reason is the last
                values: Any = np.concatenate([read_part(path, name, column) for path in parts])
                values = values.astype(object) if column.dtype is str else values
                store[name][shard * made.shard : shard * made.shard + len(values)] = values
        except FileNotFoundError:  # another process was faster
            if not complete(folder, shard):
                raise
    for path in parts:
        path.unlink(missing_ok=True)


def parts_of(folder: Path) -> dict[int, Path]:
    """Return the parts that there are, whole or not, by their first scene."""
    return _parts(folder, ".some") | whole_parts(folder)


def whole_parts(folder: Path) -> dict[int, Path]:
    """Return the parts that are whole, by their first scene."""
    return _parts(folder, "")


def _parts(folder: Path, kind: str) -> dict[int, Path]:
    pattern = re.compile(rf"([0-9]{{7}}){re.escape(kind)}\.npz")
    found = (
        (pattern.fullmatch(path.name), path) for path in sorted((folder / PARTS).glob("*.npz"))
    )
    return {int(name[1]): path for name, path in found if name}


def clean(folder: Path, made: Layout) -> None:
    """Remove what killed processes have left half done."""
    for left in [*(folder / PARTS).glob(".*.partial"), *(folder / RESULTS).rglob("*.partial*")]:
        left.unlink(missing_ok=True)
    for left in folder.glob(f".{RESULTS}.*.partial"):
        shutil.rmtree(left, ignore_errors=True)
    for first, path in parts_of(folder).items():
        if complete(folder, first // made.shard):
            path.unlink(missing_ok=True)


def read(
    folder: Path, made: Layout, name: str, numbers: np.ndarray, of: Sequence[np.ndarray] = ()
) -> Array:
    """Return what an array holds for these scenes, from shards and from parts; NaN where there is nothing."""
    column = made.columns[name]
    array = open_store(folder)[name]
    try:
        first, last = (int(numbers[0]), int(numbers[-1])) if numbers.size else (0, -1)
        whole = numbers.size == last - first + 1 and bool((np.diff(numbers) == 1).all())
        rows = slice(first, last + 1) if whole else numbers  # a slice is read much faster
        found = np.array(array.oindex[(rows, *of)] if of else array.oindex[rows])
    except Exception as error:  # whatever a damaged file makes zarr raise
        raise InputError.at(
            str(folder / RESULTS / name), f"is damaged ({error}): remove it, and sweep again"
        ) from None
    wanted = set(np.unique(numbers // made.batch * made.batch).tolist())
    for first, path in parts_of(folder).items():
        if first in wanted and not complete(folder, first // made.shard):
            values = read_part(path, name, column)
            mine = np.flatnonzero((numbers >= first) & (numbers < first + len(values)))
            chosen = values[numbers[mine] - first]
            for axis, part in enumerate(of, 1):
                chosen = np.take(chosen, part, axis)
            found[mine] = chosen
    return found
