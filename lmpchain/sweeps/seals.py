"""Seals of a sweep's store, which verify that its shards and coordinates are complete.

    store.json              seal of the descriptions of all arrays, and of the coordinates
    shards/0000003.json     seal of one shard of every array

A seal lists files with their sizes and hashes, and is written when these files are on the disk. A
shard without a seal counts as not done, because it may be empty or missing after a power cut or an
interrupted copy. Zarr would read such a shard as one that was never written.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..util.files import flush_to_disk, read_sealed_json, replacing, sealed_json
from ..util.provenance import checksum

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
