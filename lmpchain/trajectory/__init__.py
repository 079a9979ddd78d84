"""Trajectories and their formats: NetCDF, Zarr, LAMMPS dump, extended XYZ, MDAnalysis."""

from ..util.lazy import attributes, listed

__all__ = ["Cost", "ErrorEstimate", "Trajectory"]
__getattr__ = attributes(
    __name__, names={"trajectory": "Trajectory", "record": "Cost ErrorEstimate"}
)
__dir__ = listed(__name__)
