"""Trajectories as NetCDF files, sealed by a hash of the content."""

from __future__ import annotations

import sys
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.files import check_readable, check_seal, seal, write_aside
from ..util.provenance import command, now
from .gathered import TIME
from .record import DIMENSIONS, KINDS, TOLD, Record, scene_of, shapes

if TYPE_CHECKING:
    import h5py


def write(record: Record, path: str | PathLike[str]) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.save`."""
    import h5netcdf  # xarray writes the same, but its import takes longer than most runs

    memory = BytesIO()  # HDF5 crashes the process when a disk is full
    with h5netcdf.File(memory, "w") as file:
        fine = {TIME: record.gathered[TIME].size} if TIME in record.gathered else {}
        file.dimensions = dict(zip(DIMENSIONS, record.displacement.shape, strict=True)) | fine
        file.attrs.update(record.attributes() | {"history": f"{now()} {command()}"})
        for name, (dimensions, values, attributes) in record.variables().items():
            file.create_variable(name, dimensions, data=values).attrs.update(attributes)
    with write_aside(path) as aside, open(aside, "wb") as opened:
        opened.writelines((memory.getbuffer(), seal(memory.getbuffer())))


def read(path: Path) -> tuple[dict[str, Any], Scene, dict[str, Array]]:
    """Return metadata, scene and arrays of a file; damaged or foreign ones raise whatever comes first.

    Only plain arrays in this very file are read, and a claim about their size is checked before
    they are.
    """
    import h5py

    check_readable(path, sys.maxsize)
    check_seal(path)
    with h5py.File(path, "r") as file:
        about = {name: _attribute(file, name) for name in TOLD}
        scene = scene_of(about)
        return (
            about,
            scene,
            {name: _array(file, name, shape) for name, shape in shapes(scene).items()},
        )


def _attribute(file: h5py.File, name: str) -> Any:
    """Return a text or a number of the metadata."""
    import h5py

    if not h5py.h5a.exists(file.id, name.encode()):
        raise ValueError(f"it has no {name}")
    kept = h5py.h5a.open(file.id, name.encode())
    if kept.shape not in ((), (1,)) or not (
        h5py.check_string_dtype(kept.dtype) or kept.dtype.kind in "if"
    ):
        raise ValueError(f"its {name} is neither text nor a number")
    return np.asarray(file.attrs[name]).item()


def _array(file: h5py.File, name: str, shape: tuple[int, ...]) -> Array:
    """Return an array that lies in this file, whole and plain, with this shape."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"its {name} is not in the file, or a link")
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.dtype != (kind := KINDS.get(name, "float64")):
        raise ValueError(f"its {name} are not numbers of the kind {kind}")
    layout = found.id.get_create_plist().get_layout()
    if layout not in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) or found.external:
        raise ValueError(f"its {name} does not lie in the file in one piece, as lmpchain writes it")
    if found.shape != shape:
        raise ValueError(f"its {name} has the shape {found.shape}, its scene {shape}")
    if found.id.get_storage_size() != found.nbytes:
        raise ValueError(f"its {name} is not stored in the file")
    return found[()]
