"""Formats of other programs: recognition by the first bytes of a file, and extended XYZ."""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path

import numpy as np

from ..util.files import write_aside
from .record import Record

HEAD = 2**12  # Number of bytes that are examined.
NUMERAL = rb"[+-]?[\d.]+(?:[eE][+-]?\d+)?"
DECK = rb"(?:units|atom_style|pair_style|pair_coeff|read_data|boundary|timestep|fix|run)[ \t]+\S"
# Formats, and patterns of the first bytes of their files.
OTHER_FORMATS = {
    "a NumPy array (npy)": rb"\x93NUMPY",
    "a ZIP archive, such as npz": rb"PK\x03\x04",
    "a file that gzip has packed": rb"\x1f\x8b",
    "a NetCDF 3 file": rb"CDF[\x01\x02\x05]",
    # HDF5 would hang on some damaged files, so the group name is searched in the bytes.
    "an H5MD file": rb"(?s:\x89HDF.*\bh5md\b)",
    "an extended XYZ file": rb"\s*\d+[ \t\r]*\n[^\n]*Properties=",
    "an XYZ file": rb"\s*\d+[ \t\r]*\n[^\n]*\n\s*\w+(?:[ \t]+" + NUMERAL + rb"){3}",
    "a VTK file": rb"\s*(?:# vtk DataFile|(?:<\?xml[^>]*>\s*)?<VTKFile)",
    "a file that YADE saved": rb"\s*(?:<\?xml[^>]*>\s*)?<(?:!DOCTYPE )?boost_serialization",
    "a text file that YADE exported": rb"\s*#\s*format[ _]",
    "a restart file of MercuryDPM": rb"\s*(?:restart_version|MercuryDPM)\b",
    "a data file of MercuryDPM": rb"\s*\d+(?:[ \t]+"
    + NUMERAL
    + rb"){5,7}[ \t\r]*\n(?:[ \t]*"
    + NUMERAL
    + rb"){8,14}[ \t\r]*(?:\n|$)",
    "a restart file of LAMMPS": rb"LammpS RestartT",
    "a log of LAMMPS": rb"LAMMPS \(",
    "a data file of LAMMPS": rb"[^\n]*\n\s*\d+[ \t]+atoms\b",
    "an input of LAMMPS": rb"(?:[ \t]*(?:#[^\n]*|[^\n]*&)?\n|\w+[ \t][^\n]*\n)*?[ \t]*" + DECK,
}
OTHER_CURES = {
    "an input of LAMMPS": "run it with lmp and give its dump, or give the folder of a deck that "
    "lmpchain wrote to lmpchain check --deck",
    "a file that gzip has packed": "unpack it",
}
READABLE = (
    "lmpchain reads files and folders that it saved, and text dumps of LAMMPS (dump custom) "
    "together with their scene, --scene SCENE.toml"
)


def describe_other_format(path: Path) -> str:
    """Return the format of a foreign file as text, with a remedy; "" if unknown."""
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError:
        return ""
    for name, beginning in OTHER_FORMATS.items():
        if re.match(beginning, head):
            return f"is {name}: {OTHER_CURES.get(name, READABLE)}"
    return ""


# OVITO reads velocities from velo, and ASE from momenta and masses.
PROPERTIES = (
    "species:S:1:pos:R:3:velo:R:3:id:I:1:radius:R:1:masses:R:1:displacement:R:1:momenta:R:3"
)


def write_extxyz(record: Record, path: str | PathLike[str], overwrite: bool = False) -> None:
    """Write a trajectory; see `lmpchain.Trajectory.to_extxyz`."""
    chain = record.scene.chain
    grains = record.grains
    rest = -chain.depths[grains - 1]
    radii = chain.diameters[grains - 1] / 2
    # Viewers need a box: a column with a grain of room around it.
    side = 2 * float(radii.max())
    low = float(rest.min()) - side
    high = float(rest.max()) + side
    box = (
        f'Lattice="{2 * side} 0 0 0 {2 * side} 0 0 0 {high - low}" Origin="{-side} {-side} {low}" '
        f'pbc="F F F" Properties={PROPERTIES}'
    )
    masses = chain.masses[grains - 1]
    named = list(zip(grains.tolist(), radii.tolist(), masses.tolist(), strict=True))
    with write_aside(path, overwrite) as aside, open(aside, "w", encoding="ascii") as out:
        for sample, time in enumerate(record.time.tolist()):
            u = np.asarray(record.displacement[sample])
            v = np.asarray(record.velocity[sample])
            columns = (rest - u, 0.0 - v, u, 0.0 - masses * v)
            rows = zip(*(column.tolist() for column in columns), named, strict=True)
            out.write(f"{grains.size}\n{box} Time={time}\n")
            out.writelines(
                f"X 0 0 {z} 0 0 {vz} {id} {radius} {mass} {moved} 0 0 {pz}\n"
                for z, vz, moved, pz, (id, radius, mass) in rows
            )
