"""Check of the layout of the store of a sweep.

The check reads only plain JSON and file names. No codec is created and no chunk is opened before
the store has passed it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from ..trajectory.zarr_layout import (
    KEYS,
    MOST_SHRUNK,
    codec_names,
    codec_names_in_shards,
    metadata,
)
from ..util.files import check_tree

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
        usual &= _fits_shards(shape, chunk, inner) and array["fill_value"] == FILLS[kind]
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
