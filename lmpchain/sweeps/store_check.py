"""The check that the store of a sweep is laid out as lmpchain does it.

It reads plain JSON and file names only: no codec is made and no chunk opened before it has passed.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..trajectory.zarr_layout import KEYS, codec_names, codec_names_in_shards, metadata
from ..util.files import check_tree

CHUNK_BYTES = 2**18  # of a shard, read at a time
KINDS = {
    "float64": "bytes",
    "int64": "bytes",
    "string": "vlen-utf8",
}  # types of data, and what writes them
FILLS = {"float64": "NaN", "string": "not done"}  # where a scene has no answer
PLAIN_BYTES = 2**26  # of an array that is read whole, whatever its file is like;
MOST_SHRUNK = 1000  # times, that larger ones are by their codecs
ENCODING = {"name": "default", "configuration": {"separator": "/"}}


def described(store: Path) -> tuple[int, dict[str, dict[str, Any]]]:
    """Return the scenes in a batch, and the metadata of every array by name.

    Raises `OSError`, `ValueError`, `KeyError` or `TypeError` unless they are such as lmpchain
    writes.
    """
    check_tree(store)
    group = metadata(store)
    batch = group["attributes"].get("batch")
    if group.get("node_type") != "group" or type(batch) is not int or batch < 1:
        raise ValueError("it is no store of lmpchain")
    arrays = {}
    for node in sorted(store.iterdir()):
        if node.is_dir():
            arrays[node.name] = metadata(node)
            _check(node, arrays[node.name])
        elif node.name != "zarr.json":
            raise ValueError(f"{node.name} does not belong there")
    return batch, arrays


def _check(node: Path, about: dict[str, Any]) -> None:
    """Raise unless an array is stored in the way of lmpchain."""
    name = node.name
    shape = about["shape"]
    dimensions = about["dimension_names"]
    if about["node_type"] != "array" or about.keys() - KEYS or about.get("storage_transformers"):
        raise ValueError(f"{name} is stored in a way that lmpchain does not use")
    if (
        not shape
        or len(shape) != len(dimensions)
        or not all(type(length) is int and length > 0 for length in shape)
    ):
        raise ValueError(f"{name} has a shape that lmpchain does not use")
    if not all(isinstance(text, str) for text in (*dimensions, *about["attributes"].values())):
        raise ValueError(f"{name} has labels that lmpchain does not use")
    if about["data_type"] not in KINDS:
        raise ValueError(f"{name} holds a type of data that lmpchain does not use")
    chunk = about["chunk_grid"]["configuration"]["chunk_shape"]
    plain = about["chunk_grid"]["name"] == "regular" and about["chunk_key_encoding"] == ENCODING
    if dimensions[0] == "scene":
        inner = about["codecs"][0]["configuration"]["chunk_shape"]
        codecs = codec_names_in_shards(about["codecs"], tuple(inner))
        width = 8 * math.prod(shape[1:])
        plain &= inner[0] > 0 and chunk[0] % inner[0] == 0 and chunk[1:] == shape[1:] == inner[1:]
        plain &= (
            inner[0] * width <= max(CHUNK_BYTES, width)
            and about["fill_value"] == FILLS[about["data_type"]]
        )
    else:
        codecs = codec_names(about["codecs"])
        held = sum(path.stat().st_size for path in (node / "c").rglob("*") if path.is_file())
        plain &= chunk == shape and 8 * math.prod(shape) <= max(PLAIN_BYTES, MOST_SHRUNK * held)
    if not plain:
        raise ValueError(
            f"{name} is in pieces that lmpchain does not use, or claims to hold more than it does"
        )
    if codecs != [KINDS[about["data_type"]], "zstd", "crc32c"]:
        raise ValueError(f"{name} is stored with codecs that lmpchain does not use")
