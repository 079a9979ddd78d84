"""Reading of tables of numbers in text files of any layout, from instruments or spreadsheets."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, shown
from .array_files import BY_POINTS, Arrays, read_arrays
from .arrays import Array
from .files import check_readable
from .units import BRACKETS, split_unit, unit_of

LARGEST_FILE = 2**28  # Bytes.
SAMPLED_LINES = 400  # Number of lines from which the layout is recognised.


class TableLayout(NamedTuple):
    """Text layout of the lines of a table.

    Attributes
    ----------
    delimiter : str
        Separator of columns; a blank stands for any number of blanks.
    decimal : "." or ","
        Decimal separator of numbers.
    """

    delimiter: str
    decimal: str

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line, without trailing empty ones."""
        if self.delimiter == " ":
            cells = line.split()
        else:
            # A cell in quotes may contain the delimiter.
            cells = [cell.strip() for cell in next(csv.reader([line], delimiter=self.delimiter))]
        while cells and not cells[-1]:
            cells.pop()
        return cells

    def is_number(self, cell: str) -> bool:
        """Return whether a cell contains a finite number in this number format."""
        # A number such as 1e400 would be infinite.
        return bool(CELLS[self.decimal].fullmatch(cell)) and math.isfinite(self.number(cell))

    def numeric(self, cells: Sequence[str]) -> tuple[int, ...]:
        """Return the positions of the cells with numbers."""
        return tuple(place for place, cell in enumerate(cells) if self.is_number(cell))

    def number(self, cell: str) -> float:
        """Return the value of a cell."""
        return float(cell.replace(",", ".") if self.decimal == "," else cell)

    def rows(self, numeric: Sequence[int]) -> re.Pattern[str]:
        """Return a pattern for lines with numbers in these columns and no words in others."""
        number = DIGITS.format(re.escape(self.decimal))
        if self.delimiter == " ":
            return re.compile(rf"\s*{number}(\s+{number}){{{numeric[-1]},}}\s*", re.ASCII)
        cells = [
            rf"\s*{number}\s*" if place in numeric else rf"\s*({number})?\s*"
            for place in range(numeric[-1] + 1)
        ]
        rest = rf"({self.delimiter}\s*({number})?\s*)*"
        return re.compile(self.delimiter.join(cells) + rest, re.ASCII)

    @property
    def words(self) -> str:
        """The layout as text."""
        names = {" ": "blanks", "\t": "tabs", ";": "semicolons", ",": "commas"}
        if self.delimiter not in names:
            return self.delimiter
        between = names[self.delimiter]
        return f"{between} between columns" + (", decimal commas" if self.decimal == "," else "")


DIGITS = r"[+-]?(\d+({0}\d*)?|{0}\d+)([eE][+-]?\d+)?"
CELLS = {mark: re.compile(DIGITS.format(re.escape(mark)), re.ASCII) for mark in ".,"}
EMPTY = re.compile(r'[\s,;"\x1a]*')
NAMED_VALUE = re.compile(r"([^\W\d][^:=]*?)\s*[:=]\s*(.+)")
NO_UNIT = ("", "-", "--", "1")
# A column name, with a unit in brackets that may follow a blank.
NAME_AND_UNIT = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")


class ColumnHeader(NamedTuple):
    """Name and unit of a column from its header; empty if the header has none.

    Attributes
    ----------
    name : str
        Name of the quantity.
    unit : str
        Unit of the quantity.
    cell : str
        Whole text of the header, with name and unit.
    """

    name: str
    unit: str
    cell: str = ""


# Facts about the columns of a file, by lower-case name and then by the position of the column.
Facts = dict[str, dict[int, str]]


@dataclass(frozen=True, eq=False)
class NumberTable:
    """A table of numbers, and the text above it.

    Attributes
    ----------
    path : Path
        Path of the file.
    columns : list of ColumnHeader
        Headers of all columns up to the last column of numbers.
    numeric : tuple of int
        Indices of the columns of numbers.
    facts : dict
        Values by name and column, from the lines above or beside the table.
    numbers : sequence of int
        Line number in the file of each row, or row number in the arrays.
    lines : list of str
        Lines of the table as text; empty if a library read the file.
    layout : TableLayout
        Delimiter and decimal separator of the lines.
    arrays : (R, C) array, optional
        All columns, if a library read the file.
    """

    path: Path
    columns: list[ColumnHeader]
    numeric: tuple[int, ...]
    facts: Facts
    numbers: Sequence[int]
    lines: list[str]
    layout: TableLayout
    arrays: Array | None = None

    def values(self, places: Sequence[int]) -> Array:
        """Return columns (R, C); raise `InputError` with the first cell without a number."""
        if self.arrays is not None:
            values = self.arrays[:, places]
            if (wrong := np.argwhere(~np.isfinite(values))).size:
                row, place = wrong[0]
                cell = f"row {row + 1} of {self.describe(places[place])}"
                fault = f"{values[row, place]} in {cell} is not a number: correct or remove it"
                raise InputError.at("file", f"{self.path}: {fault}")
            return values
        layout = self.layout
        try:
            return self._read_quickly(places)
        except ValueError:
            # The lines contain quotes, decimal commas between commas, or a cell without a number.
            values = np.empty((len(self.lines), len(places)))
        for row, line in enumerate(zip(self.numbers, self.lines, strict=True)):
            cells = layout.cells(line[1])
            try:
                if not all(layout.is_number(cells[place]) for place in places):
                    raise IndexError
            except IndexError:
                raise _no_number(self.path, line, layout, places) from None
            values[row] = [layout.number(cells[place]) for place in places]
        return values

    def _read_quickly(self, places: Sequence[int]) -> Array:
        """Return columns (R, C) by numpy's reader; raise `ValueError` at cells without numbers."""
        delimiter, decimal = self.layout
        if delimiter == decimal:
            raise ValueError(delimiter)
        texts = (text.replace(decimal, ".") for text in self.lines)
        between = None if delimiter == " " else delimiter
        values = np.loadtxt(texts, delimiter=between, usecols=places, comments=None, ndmin=2)
        if not np.isfinite(values).all():
            raise ValueError("not finite")
        return values

    def word(self, place: int, *names: str) -> str:
        """Return the file's text about a column, under the first of these names that occurs."""
        words = (self.facts.get(name, {}).get(place, "") for name in names)
        # Siglent begins a value with the name of its channel.
        return next(filter(None, words), "").rpartition(":")[2].strip()

    def fact(self, place: int, *names: str) -> float | None:
        """Return the file's number for a column under one of these names, or None."""
        for cell in (self.word(place, name) for name in names):
            # Headers may have decimal points in a table with decimal commas.
            for layout in (self.layout, TableLayout(",", ".")):
                if layout.is_number(cell):
                    return layout.number(cell)
        return None

    def unit(self, place: int, *names: str) -> str:
        """Return the unit of a column from its header, or from the file under these names.

        If there is no known unit, another text in the place of a unit is returned, for example a
        remark in brackets.
        """
        texts = [self.columns[place].unit, self.word(place, *names)]
        return next(filter(unit_of, texts), "") or next(filter(None, texts), "")

    def describe(self, place: int) -> str:
        """Return the number and header of a column as text."""
        column = self.columns[place]
        name = f" ({column.name})" if column.name else ""
        return f"column {place + 1}{name}" + (f" in {column.unit}" if column.unit else "")


def read_table(path: Path, skip: int = 0, fewest: int = 1) -> NumberTable:
    """Read the table of numbers in a text file or a binary file.

    Parameters
    ----------
    path : Path
        Path of the file.
    skip : int
        Number of lines, or of rows, at the beginning that are ignored.
    fewest : int
        Smallest number of columns of numbers in the table.

    Raises
    ------
    InputError
        If the file cannot be read, or does not contain such a table.

    Examples
    --------
    >>> path = getfixture("tmp_path") / "scope.csv"
    >>> _ = path.write_text("Model;2014\\nt (ms);CH1\\n-0,5;1,25\\n0;1e-1\\n")
    >>> table = read_table(path, fewest=2)
    >>> table.describe(0), table.layout.words
    ('column 1 (t) in ms', 'semicolons between columns, decimal commas')
    >>> table.values([0, 1]).tolist()
    [[-0.5, 1.25], [0.0, 0.1]]
    """
    text = _read_text(path)
    if isinstance(text, Arrays):
        return _table_of(path, text, skip, fewest)
    numbered = enumerate(re.split(r"\r\n|\r|\n", text), 1)
    lines = [(number, line) for number, line in numbered if number > skip and line.strip()]
    # Spreadsheets end with rows of empty cells.
    while lines and EMPTY.fullmatch(lines[-1][1]):
        lines.pop()
    try:
        layout, numeric = _recognise(path, lines, fewest)
        first = _first_row(path, lines, layout, numeric)
        above = [line for _, line in lines[max(first - 2, 0) : first]][::-1]
        header = _header(path, above, layout, numeric, len(layout.cells(lines[first][1])))
        cells = [layout.cells(line) for _, line in lines[: first + SAMPLED_LINES]]
    except csv.Error as error:
        raise InputError.at("file", f"{path} cannot be read as a table: {error}") from None
    facts = _facts(cells[:first], cells[first:], numeric)
    if names := facts.get("tracename"):
        # Yokogawa has no header directly above the numbers.
        traces = [names.get(place, "") for place in range(numeric[-1] + 1)]
        columns = [ColumnHeader(name, "", name) for name in traces]
    else:
        columns = _columns(header, numeric)
        if len(header) == 2:
            _note_below(facts, header[1], header[0], numeric)
    numbers, rows = map(list, zip(*lines[first:], strict=True))
    return NumberTable(path, columns, numeric, facts, numbers, rows, layout)


def _table_of(path: Path, arrays: Arrays, skip: int, fewest: int) -> NumberTable:
    """Return a table of the most equally long arrays of a file, or of the longest one."""
    lengths = Counter(len(array.values) for array in arrays.columns if len(array.values) > skip)
    if not lengths:
        raise InputError.at("file", f"{path} contains no table of numbers: name another file")
    length = max(lengths, key=lambda length: (lengths[length] >= fewest, length))
    chosen = [array for array in arrays.columns if len(array.values) == length]
    columns = []
    facts: Facts = {}
    for place, array in enumerate(chosen):
        name, unit = split_unit(array.name)
        columns.append(ColumnHeader(name, array.unit or unit, array.name))
        for fact, value in (arrays.facts | array.facts).items():
            facts.setdefault(fact.lower(), {})[place] = value
    values = np.column_stack([array.values[skip:] for array in chosen]).astype(float)
    numeric = tuple(range(len(chosen)))
    rows = range(skip + 1, length + 1)
    return NumberTable(
        path, columns, numeric, facts, rows, [], TableLayout(arrays.kind, "."), values
    )


def _read_text(path: Path) -> str | Arrays:
    """Return the text of a file in an encoding that instruments use, or the arrays in it."""
    try:
        check_readable(path, LARGEST_FILE)
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError.at("file", f"{path} cannot be read: {reason}") from None
    found = read_arrays(path, content, LARGEST_FILE)
    if found:
        return found
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        # Every byte is a letter in this encoding, including the micro sign.
        text = content.decode("latin-1")
    if "\0" in text:
        cure = f"save it as text (CSV), or read it in Python and {BY_POINTS}"
        raise InputError.at("file", f"{path} is not a text file: {cure}")
    return text


def _recognise(
    path: Path, lines: Sequence[tuple[int, str]], fewest: int
) -> tuple[TableLayout, tuple[int, ...]]:
    """Return the layout in which most lines have numbers, and the columns with numbers."""
    # A table fills the later half of its file at least, or all lines with the same number of
    # columns.
    later = lines[len(lines) // 2 :]
    later = later[:: len(later) // SAMPLED_LINES + 1]
    best = (False, 0, 0, 0)
    recognised = None
    # Layouts that fit the same number of lines are equivalent, so the first one is used.
    for layout in _layouts([line for _, line in later]):
        rows = [layout.cells(line) for _, line in later]
        columns = [layout.numeric(cells) for cells in rows]
        for numeric, count in Counter(filter(None, columns)).items():
            words = sum(
                sum(map(bool, cells)) - len(numeric)
                for cells, places in zip(rows, columns, strict=True)
                if places == numeric
            )
            score = (len(numeric) >= fewest, count, -words, len(numeric))
            if score > best:
                best = score
                recognised = layout, numeric
    if recognised is None:
        raise InputError.at("file", f"{path} contains no table of numbers: name another file")
    return recognised


def _layouts(lines: Sequence[str]) -> list[TableLayout]:
    """Return the possible layouts of lines, only with tabs or semicolons if there are any."""
    marks = [mark for mark in "\t;" if 2 * sum(mark in line for line in lines) > len(lines)]
    return [
        TableLayout(delimiter, decimal) for delimiter in (marks[:1] or ", ") for decimal in ".,"
    ]


def _first_row(
    path: Path, lines: Sequence[tuple[int, str]], layout: TableLayout, numeric: tuple[int, ...]
) -> int:
    """Return the index of the first line of a table; raise `InputError` if it is interrupted."""
    places = set(numeric)
    plain = layout.rows(numeric)
    first = len(lines)
    kinds: set[tuple[int, ...]] = set()
    for index in reversed(range(len(lines))):
        line = lines[index][1]
        # This test is faster, and nearly all of a million lines pass it.
        no_words = plain.fullmatch(line) is not None
        numbers, words = (places, ()) if no_words else _numbers_and_words(layout, line)
        if places <= numbers:
            first = index
            kinds.add(words)
        elif first < len(lines):
            break
    _check_above(path, lines[:first], layout, numeric, kinds)
    return first


def _numbers_and_words(layout: TableLayout, line: str) -> tuple[set[int], tuple[int, ...]]:
    """Return the positions of the numbers, and of the other non-empty cells, in a line."""
    cells = layout.cells(line)
    numbers = set(layout.numeric(cells))
    return numbers, tuple(n for n, cell in enumerate(cells) if cell and n not in numbers)


def _check_above(
    path: Path,
    above: Sequence[tuple[int, str]],
    layout: TableLayout,
    numeric: tuple[int, ...],
    kinds: set[tuple[int, ...]],
) -> None:
    """Raise `InputError` if lines above a table contain rows of the same form.

    The line directly above the table must be a header, which has no numbers in the columns of the
    table.
    """
    places = set(numeric)
    rows = [_numbers_and_words(layout, line) for _, line in above]
    if any(places <= numbers and words in kinds for numbers, words in rows[:-1]) or (
        rows and places & rows[-1][0]
    ):
        raise _no_number(path, above[-1], layout, numeric)


def _no_number(
    path: Path, line: tuple[int, str], layout: TableLayout, places: Sequence[int]
) -> InputError:
    """Return the error for the first of these cells without a number."""
    cells = layout.cells(line[1])
    texts = [(place, cells[place] if place < len(cells) else "") for place in places]
    place, text = next((place, text) for place, text in texts if not layout.is_number(text))
    cure = "correct it or remove the line (lines above the table: skip = N)"
    message = f"{shown(text)} in column {place + 1} is not a number: {cure}"
    return InputError.at("file", f"{path}, line {line[0]}: {message}")


def _header(
    path: Path, above: Sequence[str], layout: TableLayout, numeric: tuple[int, ...], width: int
) -> list[list[str]]:
    """Return the cells of at most two lines above a table, from the last one upward."""
    header: list[list[str]] = []
    for line in above:
        # NumPy begins a header with a comment mark.
        cells = _header_cells(line.lstrip("#% "), layout, width)
        if len(cells) <= numeric[-1]:
            break
        header.append(cells)
    if above and not header:
        units = [match[2] for match in BRACKETS.finditer(above[0]) if unit_of(match[2])]
        if units:
            line = f"the line {shown(above[0])} has units, but not a name for each column"
            cure = "skip it with skip = N, and give columns, time_scale and scale"
            raise InputError.at("file", f"{path}: {line}: {cure}")
    return header


def _header_cells(line: str, layout: TableLayout, width: int) -> list[str]:
    """Return the cells of a header line; none if their number differs from the table's width."""
    cells = layout.cells(line)
    if layout.delimiter != " " or len(cells) == width:
        return cells
    # Names may contain blanks.
    for split in (NAME_AND_UNIT.findall(line), re.split(r"\s{2,}|\t", line)):
        if len(split) == width:
            return split
    return []


def _facts(
    above: Sequence[Sequence[str]], beside: Sequence[Sequence[str]], numeric: Sequence[int]
) -> Facts:
    """Return the facts in the lines above a table, or beside its first rows (Tektronix)."""
    facts: Facts = {}
    for cells in above:
        _note_above(facts, cells, numeric)
    for cells in beside:
        _note_beside(facts, cells, numeric)
    return facts


def _note_above(facts: Facts, cells: Sequence[str], numeric: Sequence[int]) -> None:
    """Store a fact from a line above a table: a name and a value, or a value for each column.

    The first cell is the name. Each following value is above its column, or one cell to the right
    if the first column of the table contains numbers. A single value belongs to all columns.
    """
    for cell in cells:
        # The text has a colon, or a name and a number as Rigol writes behind the column names.
        pair = NAMED_VALUE.fullmatch(cell)
        if pair and (len(cells) == 1 or CELLS["."].fullmatch(pair[2])):
            facts[pair[1].lower()] = dict.fromkeys(numeric, pair[2])
    values = cells[1:]
    if not any(values) or not cells[0][:1].isalpha():
        return
    shift = 1 if numeric[0] == 0 and len(cells) > numeric[-1] + 1 else 0
    alone = values[0] if len({*values} - {""}) == 1 else ""
    # The first cell is the name.
    own = {place: "".join(["", *values][place + shift : place + shift + 1]) for place in numeric}
    facts[cells[0].lower()] = {place: own[place] or alone for place in numeric}


def _note_below(
    facts: Facts, names: Sequence[str], cells: Sequence[str], numeric: Sequence[int]
) -> None:
    """Store the facts of two lines: names, and below them numbers, as Rigol writes them."""
    for name, cell in zip(names, cells, strict=False):
        if CELLS["."].fullmatch(cell):
            facts[name.lower()] = dict.fromkeys(numeric, cell)


def _note_beside(facts: Facts, cells: Sequence[str], numeric: Sequence[int]) -> None:
    """Store a fact to the left of a row of numbers: a name and a value."""
    for place, (name, value) in enumerate(pairwise(cells)):
        if name[:1].isalpha() and place + 1 not in numeric:
            later = (column for column in numeric if column > place)
            facts.setdefault(name.lower(), {}).update(dict.fromkeys(later, value))


def _columns(header: Sequence[Sequence[str]], numeric: tuple[int, ...]) -> list[ColumnHeader]:
    """Return names and units of columns from the lines of a header, the last one first."""
    width = numeric[-1] + 1
    if not header:
        return [ColumnHeader("", "")] * width
    cells = list(header[0][:width])
    units = [cell.strip("()[] ") for cell in cells]
    # The line of units is below the line of names.
    if _are_units([cells[place] for place in numeric], len(header) == 2):
        names = header[1][:width] if len(header) == 2 else [""] * width
        units = ["" if unit in NO_UNIT else unit for unit in units]
        # The name may also have a unit, or a remark in brackets.
        return [ColumnHeader(n, unit, n) for n, unit in zip(names, units, strict=True)]
    return [ColumnHeader(*split_unit(cell), cell) for cell in cells]


def _are_units(cells: Sequence[str], below: bool) -> bool:
    """Return whether cells contain units; below names, a dash or an empty cell is allowed too."""
    if not below:
        return all(map(_is_unit, cells))
    return any(map(_is_unit, cells)) and all(_is_unit(cell) or cell in NO_UNIT for cell in cells)


def _is_unit(cell: str) -> bool:
    """Return whether a cell contains a unit without a name."""
    match = BRACKETS.fullmatch(cell)
    bracketed = match is not None and not match[1]
    return bracketed or unit_of(cell) is not None or cell.lower() == "sequence"
