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
from .record import ATTRIBUTES, DATA_TYPES, DIMENSIONS, Record, read_scene, shapes

if TYPE_CHECKING:
    import h5py


def write_netcdf(record: Record, path: str | PathLike[str], overwrite: bool = False) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.save`."""
    # Importing xarray, which could write the file, takes longer than most runs.
    import h5netcdf

    # HDF5 crashes the process when a disk is full, so it writes to memory.
    memory = BytesIO()
    with h5netcdf.File(memory, "w") as file:
        fine = {TIME: record.gathered[TIME].size} if TIME in record.gathered else {}
        file.dimensions = dict(zip(DIMENSIONS, record.displacement.shape, strict=True)) | fine
        file.attrs.update(record.attributes() | {"history": f"{now()} {command()}"})
        for name, (dimensions, values, attributes) in record.variables().items():
            file.create_variable(name, dimensions, data=values).attrs.update(attributes)
    with write_aside(path, overwrite) as aside, open(aside, "wb") as opened:
        opened.writelines((memory.getbuffer(), seal(memory.getbuffer())))


def read_netcdf(path: Path) -> tuple[dict[str, Any], Scene, dict[str, Array]]:
    """Return the metadata, scene and arrays of a file; raise an error if it is damaged.

    Only plain arrays in the file itself are read, after a check of their declared size.
    """
    import h5py

    check_readable(path, sys.maxsize)
    check_seal(path)
    with h5py.File(path, "r") as file:
        attributes = {name: _attribute(file, name) for name in ATTRIBUTES}
        scene = read_scene(attributes)
        arrays = {name: _array(file, name, shape) for name, shape in shapes(scene, file).items()}
        return attributes, scene, arrays


def _attribute(file: h5py.File, name: str) -> Any:
    """Return a text or a number of the metadata."""
    import h5py

    if not h5py.h5a.exists(file.id, name.encode()):
        raise ValueError(f"it has no {name}")
    attribute = h5py.h5a.open(file.id, name.encode())
    plain = h5py.check_string_dtype(attribute.dtype) or attribute.dtype.kind in "if"
    if attribute.shape not in ((), (1,)) or not plain:
        raise ValueError(f"its {name} is neither text nor a number")
    return np.asarray(file.attrs[name]).item()


def _array(file: h5py.File, name: str, shape: tuple[int, ...]) -> Array:
    """Return an array with this shape that is stored in this file as one block."""
    import h5py

    # A link may refer to any other file of the user.
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"its {name} is missing, or a link")
    array = file[name]
    data_type = DATA_TYPES.get(name, "float64")
    if not isinstance(array, h5py.Dataset) or array.dtype != data_type:
        raise ValueError(f"its {name} does not consist of numbers of the type {data_type}")
    # Chunks may be compressed, and external files may belong to another user.
    layout = array.id.get_create_plist().get_layout()
    if layout not in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) or array.external:
        raise ValueError(f"its {name} is not stored as one block, as lmpchain writes it")
    if array.shape != shape:
        raise ValueError(f"its {name} has the shape {array.shape}, but its scene requires {shape}")
    # A small file could declare an array that fills the memory.
    if array.id.get_storage_size() != array.nbytes:
        raise ValueError(f"its {name} is not stored in the file")
    return array[()]
