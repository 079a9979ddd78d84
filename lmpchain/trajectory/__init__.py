"""Trajectories and their formats: NetCDF, Zarr, LAMMPS dump, extended XYZ, MDAnalysis."""

from ..util.lazy import attributes

__all__ = ["Cost", "ErrorEstimate", "Trajectory"]
__getattr__ = attributes(__name__, names={"trajectory": "Trajectory", "record": "Cost ErrorEstimate"})
