"""Trajectories as NetCDF files, sealed by a hash of the content."""

from __future__ import annotations

from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from ..util.files import check_seal, seal, write_aside
from .record import DIMENSIONS, Record

if TYPE_CHECKING:
    import xarray


def write(record: Record, path: str | PathLike[str]) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.save`."""
    import h5netcdf  # xarray writes the same, but its import takes longer than most runs

    memory = BytesIO()  # HDF5 crashes the process when a disk is full
    with h5netcdf.File(memory, "w") as file:
        file.dimensions = dict(zip(DIMENSIONS, record.displacement.shape, strict=True))
        file.attrs.update(record.attributes())
        for name, (dimensions, values, attributes) in record.variables().items():
            file.create_variable(name, dimensions, data=values).attrs.update(attributes)
    with write_aside(path) as aside, open(aside, "wb") as opened:
        opened.writelines((memory.getbuffer(), seal(memory.getbuffer())))


def read(path: Path) -> xarray.Dataset:
    """Return the fields of a file; damaged files raise whatever their readers raise."""
    import xarray

    check_seal(path)
    return xarray.load_dataset(path, engine="h5netcdf", decode_times=False)
