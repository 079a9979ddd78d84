"""Layout of a run folder's arrays in their Zarr store, and its check.

The check reads only plain JSON and file names. No codec is created and no chunk is opened before
the check has passed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

from ..scene.scene import Scene
from ..util.files import LARGEST_JSON, check_readable
from .record import DATA_TYPES, FIELDS, shapes

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
