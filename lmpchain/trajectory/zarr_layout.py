"""How the arrays of a run folder lie in their Zarr store, and the check that a store is laid out so.

The check reads plain JSON and file names only: no codec is made and no chunk opened before it has
passed.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from ..scene.scene import Scene
from ..util.files import check_readable
from .record import FIELDS, KINDS, shapes

SAMPLES = 16  # in a shard, or a multiple that fills a chunk
# grains in a chunk at most: one grain's trace and one snapshot are then both read in some 20 ms
WIDTH = 12_500
TIMES = 65_536  # in a chunk at least
LARGEST_METADATA = 2**30  # bytes
MOST_SHRUNK = 1000  # times, that numbers which count up are by their codecs
SHRUNK = ["bytes", "blosc", "crc32c"]
SHRUNK_ONCE = ["bytes", "zstd"]  # the numbers of the grains in older stores
INDEX = ["bytes", "crc32c"]
KEYS = {
    "shape",
    "data_type",
    "chunk_grid",
    "chunk_key_encoding",
    "fill_value",
    "codecs",
    "attributes",
} | {"dimension_names", "zarr_format", "node_type", "storage_transformers"}
Piece = tuple[int, ...]


def pieces(samples: int, grains: int) -> dict[str, Piece]:
    """Return the shapes of the files of each array; under "chunk", that inside those of the fields."""
    parts = math.ceil(grains / WIDTH)
    width = math.ceil(grains / parts)
    rows = SAMPLES * math.ceil(min(samples / SAMPLES, WIDTH / grains))
    # so that the times of a shard lie in one chunk, replaced atomically
    times = rows * math.ceil(TIMES / rows)
    shard = (rows, width * parts)
    return {
        "time": (min(times, samples),),
        "grain": (grains,),
        **dict.fromkeys(FIELDS, shard),
        "chunk": (rows, width),
    }


def stores(scene: Scene) -> dict[str, Piece]:
    """Return the shapes of the files of each array of a scene; see `pieces`."""
    return shapes(scene) | pieces(scene.samples, scene.count(scene.chain))


def metadata(node: Path) -> dict[str, Any]:
    """Return the metadata of an array or a group in Zarr format 3; raises `ValueError` or `OSError`."""
    path = node / "zarr.json"
    if not path.exists():
        raise ValueError(f"{node.name} is not in Zarr format 3")
    check_readable(path, LARGEST_METADATA)
    about = json.loads(path.read_bytes())
    if (
        not isinstance(about, dict)
        or about.get("zarr_format") != 3
        or not isinstance(about.get("attributes"), dict)
    ):
        raise ValueError(f"{node.name} is not in Zarr format 3")
    return about


def check(store: Path, scene: Scene) -> None:
    """Raise unless the arrays are those of this scene, laid out as lmpchain does it."""
    every = shapes(scene)
    sizes = stores(scene)
    if (
        metadata(store).get("node_type") != "group"
        or {p.name for p in store.iterdir() if p.is_dir()} - every.keys()
    ):
        raise ValueError("it is no store of lmpchain, or holds more than that")
    for name, shape in every.items():
        about = metadata(store / name)
        wanted = {
            "node_type": "array",
            "shape": list(shape),
            "data_type": KINDS.get(name, "float64"),
            "chunk_grid": _named("regular", chunk_shape=list(sizes[name])),
            "chunk_key_encoding": _named("default", separator="/"),
            "fill_value": 0 if name == "grain" else "NaN",
        }
        if wrong := [key for key, value in wanted.items() if about.get(key) != value]:
            raise ValueError(f"the {wrong[0]} of {name} is not that of its scene")
        if about.keys() - KEYS or about.get("storage_transformers"):
            raise ValueError(f"{name} is stored in a way that lmpchain does not use")
        codecs = (
            codec_names_in_shards(about["codecs"], sizes["chunk"])
            if name in FIELDS
            else codec_names(about["codecs"])
        )
        if codecs not in ([SHRUNK, SHRUNK_ONCE] if name == "grain" else [SHRUNK]):
            raise ValueError(f"{name} is stored with codecs that lmpchain does not use")
        if name not in FIELDS:
            _check_claims(store / name / "c", math.prod(sizes[name]), blosc=codecs == SHRUNK)


def _check_claims(chunks: Path, length: int, blosc: bool) -> None:
    """Raise `ValueError` if a chunk claims to hold more numbers than it should, or than so many bytes can."""
    for path in chunks.glob("[0-9]*"):
        if not path.name.isdecimal():  # being written
            continue
        with open(path, "rb") as opened:
            head = opened.read(8)
        claimed = int.from_bytes(head[4:], "little") if blosc else 8 * length
        if claimed != 8 * length or claimed > MOST_SHRUNK * path.stat().st_size:
            raise ValueError("it claims to hold more than it does")


def _named(name: str, **configuration: Any) -> dict[str, Any]:
    return {"name": name, "configuration": configuration}


def codec_names(codecs: Any) -> list[str]:
    """Return the names of codecs that hold no other codec."""
    plain = {
        "bytes": {"endian"},
        "zstd": {"level", "checksum"},
        "crc32c": set(),
        "vlen-utf8": set(),
    }
    plain["blosc"] = {"typesize", "cname", "clevel", "shuffle", "blocksize"}
    for codec in codecs:
        if codec["name"] not in plain or codec.keys() - {"name", "configuration"}:
            raise ValueError("it is stored with codecs that lmpchain does not use")
        if codec.get("configuration", {}).keys() - plain[codec["name"]]:
            raise ValueError("its codecs have options that lmpchain does not use")
    return [codec["name"] for codec in codecs]


def codec_names_in_shards(codecs: Any, chunk: Piece) -> list[str]:
    """Return the names of the codecs inside the one of a shard."""
    (outer,) = codecs
    inside = outer["configuration"]
    if outer["name"] != "sharding_indexed" or inside["chunk_shape"] != list(chunk):
        raise ValueError("it is not in shards of lmpchain")
    if codec_names(inside["index_codecs"]) != INDEX or inside.get("index_location", "end") != "end":
        raise ValueError("it is not in shards of lmpchain")
    return codec_names(inside["codecs"])
