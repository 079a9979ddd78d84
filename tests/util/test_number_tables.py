"""Tables of numbers in text and in binary files, and units, against what was written."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers.instrument_files import ARRAYS, FILES, OTHER, TIME, VOLTS, push, universal
from scipy import constants
from scipy.io import savemat

from lmpchain import InputError
from lmpchain.util.array_files import Arrays, NamedArray, read_arrays
from lmpchain.util.number_tables import read_table
from lmpchain.util.units import KNOWN_UNITS, STYLES, read_units


def columns_of(path: Path) -> list[np.ndarray]:
    """Return all columns of numbers of a file."""
    table = read_table(path, fewest=1)
    return list(table.values(table.numeric).T)


def contains(columns: list[np.ndarray], wanted: np.ndarray, rel: float) -> bool:
    """Return whether a column equals these numbers, possibly in thousandths."""
    size = np.abs(wanted).max()
    return any(
        column.shape == wanted.shape
        and np.abs(column - factor * wanted).max() < rel * factor * size
        for column in columns
        for factor in (1.0, 1e3)
    )


@pytest.mark.parametrize("text", [text for text, _ in FILES.values()], ids=FILES)
def test_all_rows_of_an_instrument_are_numbers(text: str, tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text(text)
    columns = columns_of(path)
    assert contains(columns, push(TIME), 1e-8) or contains(columns, VOLTS, 1e-8)
    # Every number of the last line of the table is in a column, in the order of the line.
    line = [row for row in text.splitlines() if row.strip(",;\x1a")][-1].replace("\t", ",")
    cells = [cell for cell in line.split(",") if cell]
    assert [column[-1] for column in columns] == [float(cell) for cell in cells]


# Numbers and units that a file states for a column, by the names under which it states them.
FACTS: dict[str, tuple[int, dict[str, float], tuple[str, str]]] = {
    "Tektronix, second channel in V": (2, {"sample interval": 1e-6}, ("vertical units", "V")),
    "Tektronix, first channel in mV": (1, {"probe attenuation": 10.0}, ("vertical units", "mV")),
    "Tektronix TDS, channels side by side": (10, {"trigger point": 20.0}, ("vertical units", "V")),
    "LabVIEW, no times, intervals that differ": (
        2, {"x0": -2e-5, "delta_x": 1e-6}, ("y_unit_label", "Volts")
    ),
    "LabVIEW, one column of times": (1, {"delta_x": 1e-6}, ("y_unit_label", "mV")),
    "Yokogawa, empty first cells": (
        1, {"hresolution": 2e-6, "hoffset": 0.0}, ("vunit", "mV")
    ),
    "Yokogawa, no empty cells": (1, {"hresolution": 1e-6, "hoffset": -2e-5}, ("vunit", "V")),
    "Siglent": (1, {"sample interval": 1e-6}, ("vertical units", "mV")),
    "Rigol, cropped": (1, {"start": -4e-5, "increment": 1e-6}, ("", "Volt")),
    "Rigol, no times, facts behind the names": (1, {"t0": -2e-5, "tinc": 1e-6}, ("", "mV")),
    "a rate": (0, {"sample rate": 1e6, "t0": -2e-5}, ("", "N")),
    "a remark behind a unit, below it, and none": (1, {}, ("", "mV")),
}  # fmt: skip


@pytest.mark.parametrize("name", FACTS)
def test_facts_of_a_channel_are_those_above_it(name: str, tmp_path: Path):
    place, numbers, (key, unit) = FACTS[name]
    path = tmp_path / "scope.csv"
    path.write_text(FILES[name][0])
    table = read_table(path, fewest=2)
    assert {fact: table.fact(place, fact) for fact in numbers} == numbers
    assert table.unit(place, key) == unit
    assert table.fact(place, "weather") is None


# Names and units of the columns of a file, and the line of its first row.
HEADERS: dict[str, tuple[str, list[tuple[str, str]], int]] = {
    "Tektronix": (FILES["Tektronix, times in ms"][0], [("TIME", ""), ("CH1", ""), ("CH2", "")], 12),
    "Tektronix TDS": (FILES["Tektronix TDS, channels side by side"][0], [("", "")] * 11, 1),
    "LabVIEW": (
        FILES["LabVIEW, one column of times"][0],
        [("X_Value", ""), ("A", ""), ("Hammer", "Trigger")], 15,
    ),
    "Yokogawa": (
        FILES["Yokogawa, empty first cells"][0], [("", ""), ("CH1", ""), ("CH2", "")], 9
    ),
    "Keysight": (
        FILES["Keysight, times not named"][0],
        [("x-axis", "second"), ("1", "Volt"), ("2", "Volt")], 3,
    ),
    "Rigol": (
        FILES["Rigol, cropped"][0], [("X", "Sequence"), ("CH1", "Volt"), ("CH2", "Volt")], 3
    ),
    "remarks": (
        FILES["a remark behind a unit, below it, and none"][0],
        [("Time", "us"), ("Hammer (Trigger)", "mV"), ("Count", "")], 3,
    ),
    "NumPy": ("# t[s]   F[mN]\n0 1\n1e-6 2\n", [("t", "s"), ("F", "mN")], 2),
    "units alone": ("ms,N\n0,1\n1,2\n", [("", "ms"), ("", "N")], 2),
    "wide gaps": (
        "Elapsed time (s)   Force\n0   1\n1   2\n", [("Elapsed time", "s"), ("Force", "")], 2
    ),
    "decimal commas": ("t (s) F\n0,5 1,0\n1,0 2,5\n", [("t", "s"), ("F", "")], 2),
    "quotes": ('"t, s";"F ""N"""\n"0";"1"\n"1";"2"\n', [("t, s", ""), ('F "N"', "")], 2),
    "lines above": ("made: today\n\nt,F\n0,1\n1,2\n\n,\n", [("t", ""), ("F", "")], 4),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_columns_have_the_names_and_units_of_their_header(name: str, tmp_path: Path):
    text, columns, line = HEADERS[name]
    path = tmp_path / "scope.csv"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
        table = read_table(path, fewest=2)
        assert [column[:2] for column in table.columns] == columns
        assert table.numbers[0] == line
        # Rows that are skipped are counted.
        assert read_table(path, skip=line, fewest=2).numbers[0] == line + 1


def test_labels_of_rows_and_words_within_remarks_are_no_facts(tmp_path: Path):
    path = tmp_path / "scope.csv"
    path.write_text("Vertical Units: mV\ncoupling: AC,probe = 10,9\nF\nfirst,0,1\nsecond,1,2\n")
    table = read_table(path, fewest=2)
    assert table.fact(1, "first") is table.fact(1, "second") is table.fact(1, "coupling") is None
    assert table.fact(2, "probe") == 10.0
    assert table.unit(1, "vertical units") == "mV"


@pytest.mark.parametrize("write", [write for write, _ in ARRAYS.values()], ids=ARRAYS)
def test_all_arrays_of_a_file_are_columns(
    write: Callable[[Path], Any], tmp_path: Path, request: pytest.FixtureRequest
):
    path = tmp_path / request.node.callspec.id.split(",")[0]
    write(path)
    columns = columns_of(path)
    assert {column.size for column in columns} == {81}
    assert contains(columns, push(TIME), 1e-5) or contains(columns, VOLTS, 1e-5)
    # The columns of a single matrix of NumPy have no names.
    assert (read_table(path).describe(0) == "column 1") == (path.suffix == ".npy")


def test_facts_and_units_of_arrays_are_those_of_the_file(tmp_path: Path):
    path = tmp_path / "a.h5"
    ARRAYS["g.h5"][0](path)
    table = read_table(path)
    assert [column.name for column in table.columns] == [
        "Waveforms/Channel 1/data", "Waveforms/Channel 2/data",
    ]  # fmt: skip
    assert [table.fact(place, "xinc") for place in (0, 1)] == [1e-6, None]
    assert (table.unit(0), table.unit(1)) == ("mV", "")
    np.testing.assert_array_equal(table.values([1, 0]), np.column_stack([OTHER, VOLTS * 1e3]))
    assert table.describe(0) == "column 1 (Waveforms/Channel 1/data) in mV"
    with h5py.File(path, "w") as file:
        file["levels"] = np.arange(5, dtype=np.int16)
        file["levels"].attrs.update({"YInc": 0.02, "Range": [1.0, 2.0], "Phase": 1j})
        file["counts"] = np.arange(5)
        file["signal"] = np.arange(5.0)
        file["signal"].attrs["YInc"] = 0.02
        file["words"] = "words"
        file["nothing"] = h5py.Empty("f8")
        file["rows"] = np.arange(15.0).reshape(5, 3)
    table = read_table(path)
    assert [table.unit(place) for place in (0, 1, 5)] == ["", "level of 0.02", ""]
    # Arrays and complex numbers are not facts.
    assert table.facts.keys() == {"yinc"}
    names = ["counts", "levels", "rows_1", "rows_2", "rows_3", "signal"]
    assert [column.name for column in table.columns] == names
    np.testing.assert_array_equal(table.values([3]).ravel(), [1.0, 4.0, 7.0, 10.0, 13.0])
    savemat(tmp_path / "b.mat", {"x": np.arange(4.0), "y": [1.0, 2.0, np.inf, 4.0], "Length": 4})
    table = read_table(tmp_path / "b.mat", skip=1)
    assert table.fact(0, "length") == 4.0
    assert list(table.numbers) == [2, 3, 4]
    with pytest.raises(InputError, match=r"inf in row 2 of column 2 \(y\) is not a number"):
        table.values([0, 1])


def test_the_table_is_the_longest_one_with_enough_columns(tmp_path: Path):
    arrays = {"long": np.arange(9.0), "a": np.arange(4.0), "b": -np.arange(4.0)}
    np.savez(tmp_path / "a.npz", **arrays)
    for fewest, names in {1: ["long"], 2: ["a", "b"], 3: ["long"]}.items():
        table = read_table(tmp_path / "a.npz", fewest=fewest)
        assert [column.name for column in table.columns] == names
        wanted = np.column_stack([arrays[name] for name in names])
        np.testing.assert_array_equal(table.values(table.numeric), wanted)
    # Columns of a matrix have no names; a file without enough rows has no table.
    np.save(tmp_path / "b.npy", np.arange(6.0).reshape(3, 2))
    table = read_table(tmp_path / "b.npy", skip=2)
    assert [table.describe(place) for place in table.numeric] == ["column 1", "column 2"]
    np.testing.assert_array_equal(table.values([0, 1]), [[4.0, 5.0]])
    with pytest.raises(InputError, match="contains no table of numbers"):
        read_table(tmp_path / "b.npy", skip=3)


def damaged(old: str, new: str, kind: int = 2, even: bool = True) -> str:
    text = universal(kind, even)
    assert old in text
    return text.replace(old, new)


def shorter() -> str:
    """Return a universal file whose second record lacks its last line of three numbers."""
    lines = universal(2, even=True).splitlines()
    before, _, after = "\n".join([*lines[:-2], lines[-1]]).rpartition(f"{2:10d}{81:10d}")
    return f"{before}{2:10d}{78:10d}{after}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (damaged("\n    1         0", "\n    4         0"), "type 4 is not a time response"),
        (damaged("\n         2        81", "\n         5        81"), "ordinates are of type 5"),
        (damaged("\n         2        81", "\n         2        90"), "it has 81 numbers, not 90"),
        (damaged("    58\n", "   58b\n"), "dataset 58b is binary: export it as ASCII"),
        (damaged("    58\n", "    15\n"), "it has no time response"),
        (damaged("Time                 s", "Time                 Hz"), "abscissa is in Hz"),
        (shorter(), "its records are of different lengths: export one of them"),
    ],
)
def test_universal_files_without_a_time_response_are_refused(
    text: str, message: str, tmp_path: Path
):
    path = tmp_path / "a.uff"
    path.write_text(text)
    with pytest.raises(InputError, match=f"cannot be read as a file of UFF: .*{message}"):
        read_table(path)


def records_of(text: str) -> list[NamedArray]:
    """Return the arrays of a universal file."""
    arrays = read_arrays(Path("a.uff"), text.encode(), 2**20)
    assert isinstance(arrays, Arrays)
    return arrays.columns


@pytest.mark.parametrize("even", [True, False])
def test_records_of_universal_files_have_names_times_and_units(even: bool):
    text = universal(4, even)
    found = records_of(text)
    assert [(a.name, a.unit) for a in found] == [("time", "s"), ("1:3", "mV"), ("2:3", "N")]
    for array, written in zip(found, (TIME, OTHER * 1e3, push(TIME)), strict=True):
        np.testing.assert_allclose(array.values, written, rtol=1e-9, atol=1e-12)
    # Numbers may fill their columns; a last record without an end is left out.
    wide = re.sub(
        r" +(-?\d\.\d+)(E[+-]\d\d)", lambda n: n[1].ljust(len(n[0]) - 4, "0") + n[2], text
    )
    assert re.search(r"E[+-]\d{2}-?\d\.", wide)
    for array, same in zip(records_of(wide), found, strict=True):
        np.testing.assert_array_equal(array.values, same.values)
    for cut in (
        "    -1\n" + text.split("    -1\n")[3] + "    -1\n",
        text.rpartition("    -1\n")[0],
    ):
        (alone,) = records_of(cut)[1:]
        np.testing.assert_array_equal(alone.values, found[1].values)
    # The shortest record has two numbers.
    lines = text.split("    -1\n")[3].splitlines()
    lines[7:] = [*lines[7:12], lines[12][: 40 if even else 66]]
    short = "\n".join(["    -1", *lines, "    -1\n"]).replace(f"{81:10d}", f"{2:10d}")
    for array, same in zip(records_of(short), found[:2], strict=True):
        np.testing.assert_array_equal(array.values, same.values[:2])
    shorter = short.replace(lines[-1], lines[-1][: len(lines[-1]) // 2])
    with pytest.raises(InputError, match="it has a single sample"):
        records_of(shorter.replace(f"{2:10d}{int(even):10d}", f"{1:10d}{int(even):10d}"))
    # Units without a label are those of dataset 164; records may have different times.
    other = "    -1\n   164\n         5mm(milli-newton)\n    -1\n" + text.replace("mV", "  ")
    other = other.replace(f"{-2e-5:13.5E}", f"{-3e-5:13.5E}", 1 if even else 2)
    found = records_of(other)
    assert [a.name for a in found] == ["time", "1:3", "time", "2:3"]
    assert found[1].unit == "units of dataset 164"


@pytest.mark.parametrize(
    ("name", "library"), [("a.mat, PicoScope", "scipy.io"), ("g.h5", "h5py"), ("e.npz", None)]
)
def test_arrays_need_memory_and_a_library(
    name: str, library: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / name.split(",")[0]
    ARRAYS[name][0](path)
    content = path.read_bytes()
    assert isinstance(read_arrays(path, content, 2**20), Arrays)
    with pytest.raises(InputError, match="its arrays are larger than 0 MB"):
        read_arrays(path, content, 1000)
    if library is None:
        return
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=f"which {library} reads: install it, or") as caught:
        read_arrays(path, content, 2**20)
    # The recipe is valid Python.
    recipe = str(caught.value).partition("\n")[2]
    assert f'("{path.name}")' in recipe
    compile("\n".join(line.strip() for line in recipe.splitlines()), "recipe", "exec")


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"\x93NUMPY...", "NumPy"), (b"PK\x03\x04...", "NumPy"), (b"PK\x03\x04 xl/ ...", "Excel"),
        (b"\x89HDF\r\n\x1a\n...", "HDF5"), (b"MATLAB 5.0 MAT-file...", "MATLAB"),
        (b"\xd0\xcf\x11\xe0...", "Excel"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused(content: bytes, kind: str, tmp_path: Path):
    path = tmp_path / "a.dat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"^file: .* cannot be read as a file of {kind}: "):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,F\n0,1\n1,2\npause\n2,3\n3,3\n", "line 4: 'pause' in column 1 is not a number"),
        ("t;F\n0;1\n1;\n2;3\n3;3\n", "line 3: '' in column 2 is not a number"),
        ("t,F\n0,1\n1,1e400\n2,3\n", "line 3: '1e400' in column 2 is not a number"),
        ("time (us) CH 1 (V)\n0,1\n1,2\n", "has units, but not a name for each column"),
        ("words\nand words\n", "contains no table of numbers"),
        ("a\0b\n", "is not a text file"),
    ],
)
def test_texts_without_a_table_are_refused(text: str, message: str, tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_table(path, fewest=2).values([0, 1])


def test_files_that_cannot_be_read_are_refused(tmp_path: Path):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match=f"^file: {path} cannot be read: "):
            read_table(path)


@pytest.mark.parametrize(
    ("header", "described"),
    [
        ("t,F\ns,N\n", ["column 1 (t) in s", "column 2 (F) in N"]),
        ("t,F\ns,-\n", ["column 1 (t) in s", "column 2 (F)"]),
        # Names below a title are not units, and nor are dashes alone.
        ("run,1\nV,depth\n", ["column 1 (V)", "column 2 (depth)"]),
        ("t,F\n-,-\n", ["column 1 (-)", "column 2 (-)"]),
        ("s,N\n", ["column 1 in s", "column 2 in N"]),
        ("s,-\n", ["column 1 (s)", "column 2 (-)"]),
        ("ms,depth\n", ["column 1 (ms) in ms", "column 2 (depth)"]),
        ("t,F,remark\ns,N\n", ["column 1 (t) in s", "column 2 (F) in N"]),
    ],
)
def test_a_line_of_units_is_below_the_names_or_alone(
    header: str, described: list[str], tmp_path: Path
):
    path = tmp_path / "a.csv"
    path.write_text(header + "0,1\n1,2\n2,3\n")
    table = read_table(path, fewest=2)
    assert [table.describe(place) for place in table.numeric] == described
    # A table with fewer columns than wanted is recognised if there is no other.
    assert read_table(path, fewest=3).numeric == (0, 1)


def test_a_colon_names_a_fact_alone_on_a_line_or_before_a_number(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("unit: mV\nt0 = 2.5,note: made by x\nt,F\n0,1\n1,2\n2,3\n")
    table = read_table(path, fewest=2)
    assert (table.word(1, "unit"), table.fact(0, "t0"), table.word(1, "note")) == ("mV", 2.5, "")
    # A name with a number beside the first row, and a header with too few names.
    path.write_text("t,F\nT0,2.5,0,1\n,,1,2\n,,2,3\n,,3,4\n")
    table = read_table(path, fewest=2)
    assert [table.fact(place, "t0") for place in table.numeric] == [2.5, 2.5]
    path.write_text("t,F\n0,1,2\n1,2,3\n2,3,4\n")
    table = read_table(path, fewest=2)
    assert [table.describe(place) for place in (0, 1, 2)] == ["column 1", "column 2", "column 3"]


def test_semicolons_in_half_of_the_lines_are_no_delimiters(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("t,F,remark\n0,1\n1,2,a;b\n2,3\n3,4,a;b\n4,5\n5,6,a;b\n6,7\n")
    table = read_table(path, fewest=2)
    assert (table.layout.words, table.numeric) == ("commas between columns", (0, 1))
    assert table.values([0, 1]).tolist() == [[n, n + 1] for n in range(7)]


def test_units_of_lammps_are_those_of_codata():
    u, a0 = constants.atomic_mass, constants.physical_constants["Bohr radius"][0]
    written = {
        "si": (1.0, 1.0, 1.0, 1.0), "cgs": (1e-2, 1.0, 1e-3, 1e-2),
        "micro": (1e-6, 1e-6, 1e-15, 1.0), "nano": (1e-9, 1e-9, 1e-21, 1.0),
        "real": (1e-10, 1e-15, u, 1e5), "metal": (1e-10, 1e-12, u, 1e2),
        "electron": (a0, 1e-15, u, a0 / 1.03275e-15),
    }  # fmt: skip
    assert STYLES.keys() == written.keys()
    for name, units in written.items():
        assert read_units(name) == pytest.approx(units, rel=1e-8)
        assert read_units(None, name) == read_units(name, name) == read_units(name)
    assert read_units(None) == (1.0, 1.0, 1.0, 1.0)
    for scales in ("0.5,4,8", (0.5, 4.0, 8.0)):
        given = read_units(scales)
        assert given == (0.5, 4.0, 8.0, 0.125)
        assert (given.force, given.pressure) == (0.25, 1.0)
    for wrong in ("lj", "imperial", "1,2,x", (1.0, 0.0, 1.0), (1.0, 1.0, np.inf), (1.0, 2.0)):
        with pytest.raises(InputError, match=r"^units: "):
            read_units(wrong)
    with pytest.raises(InputError, match="si contradicts ITEM: UNITS of the dump, micro"):
        read_units("si", "micro")


def test_prefixes_of_units():
    for text, (base, factor) in {
        "us": ("s", 1e-6), "µs": ("s", 1e-6), "μs": ("s", 1e-6), "ns": ("s", 1e-9),
        "ps": ("s", 1e-12), "mV": ("V", 1e-3), "kN": ("N", 1e3), "millivolts": ("V", 1e-3),
        "micrometre": ("m", 1e-6), "nanoseconds": ("s", 1e-9), "mm/s": ("m/s", 1e-3),
        "msec": ("s", 1e-3), "kilonewtons": ("N", 1e3),
    }.items():  # fmt: skip
        assert KNOWN_UNITS[text] == (base, pytest.approx(factor, rel=1e-15))
