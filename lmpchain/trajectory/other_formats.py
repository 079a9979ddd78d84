"""Formats of other programs, recognised by the first bytes of a file."""

from __future__ import annotations

import re
from pathlib import Path

HEAD = 2**12  # bytes that are looked at
NUMERAL = rb"[+-]?[\d.]+(?:[eE][+-]?\d+)?"
DECK = rb"(?:units|atom_style|pair_style|pair_coeff|read_data|boundary|timestep|fix|run)[ \t]+\S"
# Each format, and how its files begin.
OTHER_FORMATS = {
    "a NumPy array (npy)": rb"\x93NUMPY",
    "a ZIP archive, such as npz": rb"PK\x03\x04",
    "a file that gzip has packed": rb"\x1f\x8b",
    "a NetCDF 3 file": rb"CDF[\x01\x02\x05]",
    # HDF5 would hang on some damaged files, so the name of the group is sought in the bytes.
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
    """Return the format of another program's file, with a remedy, in words; "" if unknown."""
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError:
        return ""
    for name, beginning in OTHER_FORMATS.items():
        if re.match(beginning, head):
            return f"is {name}: {OTHER_CURES.get(name, READABLE)}"
    return ""
