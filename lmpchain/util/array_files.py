"""Reading of arrays from NumPy, MATLAB, HDF5, Excel and universal (UFF) files."""

from __future__ import annotations

import io
import math
import re
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .arrays import Array

BY_POINTS = "give its points by Force(times=, force=)"
MATLAB = b"MATLAB 5.0 MAT-file"
MATLAB_HDF5 = b"MATLAB 7.3 MAT-file"
HDF5 = b"\x89HDF\r\n\x1a\n"
ZIP = b"PK\x03\x04"
NUMPY = b"\x93NUMPY"
OLE = b"\xd0\xcf\x11\xe0"
# A universal file begins with a mark and the number of its first dataset, in fixed columns.
UNIVERSAL = re.compile(rb"[\r\n]*    -1 *\r?\n {0,4}(15|18|55|58b?|82|151|164|24\d\d)\s")
# Classes of MATLAB arrays with numbers, without cells, structures, objects and functions.
MATLAB_NUMBERS = {"double", "single", "logical"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
# Attributes of HDF5 files that contain the unit of a data set.
UNIT_ATTRIBUTES = ("units", "unit", "yunits")
# Records of dataset 58 by type of ordinate: widths of the numbers, and of the abscissae.
TIME_RESPONSE = 1
SINGLE, DOUBLE = 2, 4
WIDTHS = {(SINGLE, 1): (13,), (SINGLE, 0): (13, 13), (DOUBLE, 1): (20,), (DOUBLE, 0): (13, 20)}
HEADER_LINES = 11
SI_UNITS = 1  # Code of SI units in dataset 164.
# Python library for each kind of file, and the line that loads the file.
RECIPES = {
    "MATLAB": ("scipy.io", 'data = scipy.io.loadmat("{name}")'),
    "HDF5": ("h5py", 'data = h5py.File("{name}")'),
    "Excel": ("pandas", 'data = pandas.read_excel("{name}")'),
}


@dataclass
class NamedArray:
    """Values of one quantity, with its name, its unit and further facts from the file."""

    name: str
    values: Array
    unit: str = ""
    facts: dict[str, str] = field(default_factory=dict)


@dataclass
class Arrays:
    """Arrays of a file, and single numbers in it that describe all of them."""

    kind: str
    columns: list[NamedArray] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, values: Any, unit: str = "", **facts: str) -> None:
        """Add a vector, the columns of a matrix, or a single number; skip anything else."""
        array = np.asarray(values)
        if array.dtype.kind not in "biuf" or array.ndim > 2:
            return
        if array.size == 1:
            self.facts[name.rpartition("/")[2]] = repr(float(array.item()))
            return
        # MATLAB and HDF5 may store vectors as rows as well.
        array = array.ravel() if 1 in array.shape else array
        if array.ndim == 1:
            self.columns.append(NamedArray(name, array, unit, facts))
            return
        for place, column in enumerate(array.T, 1):
            self.columns.append(NamedArray(f"{name}_{place}", column, unit, facts))


def read_arrays(path: Path, content: bytes, largest: int) -> Arrays | str | None:
    """Return the arrays of a binary file, or a worksheet as text; None for plain text.

    No content of a file is executed: objects of NumPy, objects and functions of MATLAB, and links
    of HDF5 to other files are ignored.

    Parameters
    ----------
    path : Path
        Path of the file, for its type and for messages.
    content : bytes
        Content of the file.
    largest : int
        Largest size of the arrays in memory, bytes.

    Raises
    ------
    InputError
        If the file is damaged, or the library that reads it is not installed.
    """
    kind, read = _reader(path, content)
    if read is None:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(content, largest)
    except ImportError:
        library, load = RECIPES[kind]
        # The command line prints these three lines as one, so they must be valid Python in one
        # line.
        recipe = f"import {library};\n  {load.format(name=path.name)};\n  "
        recipe += 'lmpchain.Force(grain=1, times=data["time"], force=data["force"])'
        fault = f"{path} is a file of {kind}, which {library} reads: install it, or {BY_POINTS}"
        raise InputError.at("file", f"{fault}:\n  {recipe}") from None
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        fault = f"{path} cannot be read as a file of {kind}: {reason}"
        raise InputError.at("file", fault) from None


def _reader(path: Path, content: bytes) -> tuple[str, Callable[[bytes, int], Any] | None]:
    """Return the type of a file, from its first bytes, and the function that reads it."""
    if content.startswith(NUMPY):
        return "NumPy", _read_npy
    if content.startswith(ZIP):
        return ("Excel", _read_excel) if b"xl/" in content else ("NumPy", _read_npz)
    if content.startswith(OLE):
        return "Excel", _read_excel
    if content.startswith((HDF5, MATLAB_HDF5)):
        return "HDF5", _read_hdf5
    # Files of version 4 have no signature.
    if content.startswith(MATLAB) or (path.suffix.lower() == ".mat" and b"\0" in content):
        return "MATLAB", _read_matlab
    if UNIVERSAL.match(content):
        return "UFF", _read_universal
    return "", None


def _check_size(size: float, largest: int) -> None:
    """Raise `ValueError` if arrays would exceed their memory limit."""
    if size > largest:
        raise ValueError(f"its arrays are larger than {largest / 2**20:.0f} MB")


def _check_unpacked(content: bytes, largest: int) -> None:
    """Raise `ValueError` if the members of an archive are too large."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        _check_size(sum(member.file_size for member in archive.infolist()), largest)


def _read_npy(content: bytes, largest: int) -> Arrays:
    arrays = Arrays("an array of NumPy")
    arrays.add("array", np.load(io.BytesIO(content), allow_pickle=False))
    # The columns of a single matrix are identified by their numbers.
    for column in arrays.columns:
        column.name = ""
    return arrays


def _read_npz(content: bytes, largest: int) -> Arrays:
    _check_unpacked(content, largest)
    arrays = Arrays("arrays of NumPy")
    with np.load(io.BytesIO(content), allow_pickle=False) as members:
        for name in members.files:
            arrays.add(name, members[name])
    return arrays


def _read_matlab(content: bytes, largest: int) -> Arrays:
    io_of = import_module("scipy.io")
    listed = io_of.whosmat(io.BytesIO(content))
    names = [(name, shape) for name, shape, kind in listed if kind in MATLAB_NUMBERS]
    _check_size(sum(8.0 * math.prod(shape) for _, shape in names), largest)
    arrays = Arrays("arrays of MATLAB")
    if names:
        wanted = [name for name, _ in names]
        data = io_of.loadmat(io.BytesIO(content), variable_names=wanted, struct_as_record=True)
        for name in wanted:
            arrays.add(name, data[name])
    return arrays


def _read_hdf5(content: bytes, largest: int) -> Arrays:
    h5py = import_module("h5py")
    arrays = Arrays("data sets of HDF5")
    found: list[tuple[str, Any]] = []

    def visit(name: str, node: Any) -> None:
        # Links to other files are not followed. Parts of data sets may also be in other files.
        if isinstance(node, h5py.Dataset) and not (
            name.startswith("#refs#") or node.is_virtual or node.external
        ):
            found.append((name, node))

    with h5py.File(io.BytesIO(content), "r") as file:
        file.visititems(visit)
        _check_size(sum(8.0 * math.prod(node.shape or ()) for _, node in found), largest)
        for name, node in found:
            if node.shape is None or node.dtype.kind not in "biuf":
                continue
            words = dict(_attributes(node.parent)) | dict(_attributes(node))
            unit = next((words[key] for key in UNIT_ATTRIBUTES if key in words), "")
            values = node[()]
            # An oscilloscope stores converter levels, with their unit as an attribute.
            if node.dtype.kind in "iu" and "yinc" in words:
                unit = f"level of {words['yinc']}"
            # MATLAB stores the rows of a matrix as columns.
            arrays.add(name, values.T if "MATLAB_class" in node.attrs else values, unit, **words)
    return arrays


def _attributes(node: Any) -> Iterator[tuple[str, str]]:
    """Yield the texts and numbers among the attributes of a group or data set of HDF5."""
    for name, value in node.attrs.items():
        if isinstance(value, bytes):
            yield name.lower(), value.decode("latin-1")
        elif np.size(value) == 1 and np.asarray(value).dtype.kind in "biufUO":
            yield name.lower(), str(np.asarray(value).item())


def _read_excel(content: bytes, largest: int) -> str:
    """Return the first worksheet as text, with tabs between its cells."""
    if content.startswith(ZIP):
        _check_unpacked(content, largest)
    pandas = import_module("pandas")
    sheet = pandas.read_excel(io.BytesIO(content), header=None, dtype=object)
    rows = sheet.astype(object).where(sheet.notna(), "").to_numpy()
    return "\n".join("\t".join(" ".join(str(cell).split()) for cell in row) for row in rows)


def _read_universal(content: bytes, largest: int) -> Arrays:
    """Return the time responses of dataset 58, with separate abscissae if these differ."""
    records = []
    scaled = False
    lines = content.decode("latin-1").splitlines()
    for number, block in _datasets(lines):
        if number == "164":
            scaled = int(block[0][:10]) != SI_UNITS
        elif number == "58":
            records.append(_time_response(block))
        elif number == "58b":
            raise ValueError("dataset 58b is binary: export it as ASCII (dataset 58)")
    if not records:
        raise ValueError("it has no time response (dataset 58)")
    if len({record[1].size for record in records}) > 1:
        raise ValueError("its records are of different lengths: export one of them")
    arrays = Arrays("dataset 58")
    alike = all(np.array_equal(time, records[0][1]) for _, time, _, _ in records)
    for place, (name, time, values, unit) in enumerate(records):
        if not (alike and place):
            arrays.add("time", time, "s")
        # Without a label, numbers are in the units of the file.
        arrays.add(name, values, unit or ("units of dataset 164" if scaled else ""))
    return arrays


def _datasets(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the number and lines of each dataset, which is enclosed by two lines with -1."""
    marks = [index for index, line in enumerate(lines) if line.strip() == "-1"]
    for begin, end in zip(marks[::2], marks[1::2], strict=False):
        if end > begin + 1:
            yield lines[begin + 1].split()[0], lines[begin + 2 : end]


def _time_response(lines: list[str]) -> tuple[str, Array, Array, str]:
    """Return the name, times, values and unit of a record of dataset 58."""
    head = lines[5]
    if int(head[:5]) != TIME_RESPONSE:
        raise ValueError(f"its function of type {int(head[:5])} is not a time response (type 1)")
    kind, count, even = (int(lines[6][place : place + 10]) for place in (0, 10, 20))
    begin, step = (float(lines[6][place : place + 13]) for place in (30, 43))
    if (kind, even) not in WIDTHS:
        raise ValueError(f"its ordinates are of type {kind}, not real (2 or 4)")
    widths = WIDTHS[kind, even]
    numbers = list(_fixed(lines[HEADER_LINES:], widths, count * len(widths)))
    if len(numbers) != count * len(widths):
        raise ValueError(f"it has {len(numbers)} numbers, not {count * len(widths)}")
    if count < 2:
        raise ValueError("it has a single sample: at least two are needed")
    table = np.array(numbers, float).reshape(count, len(widths))
    time = np.asarray(begin + step * np.arange(count), float) if even else table[:, 0]
    unit = lines[8][47:67].strip()
    label = lines[7][47:67].strip()
    if label.lower() not in ("", "none", "s", "sec", "seconds"):
        raise ValueError(f"its abscissa is in {label}, not in s")
    node, direction = head[41:51].strip(), head[51:55].strip()
    # Node 0 means that there is none.
    name = lines[0].strip() if node in ("", "0") else f"{node}:{direction}"
    return name, time, table[:, -1], "" if unit.lower() == "none" else unit


def _fixed(lines: Iterable[str], widths: tuple[int, ...], count: int) -> Iterator[float]:
    """Yield `count` numbers, or one more, of fixed widths that need no blanks between them."""
    for line in lines:
        place = 0
        while line[place:].strip() and count >= 0:
            for width in widths:
                yield float(line[place : place + width])
                count -= 1
                place += width
