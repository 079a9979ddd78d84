"""Tables of results along an axis: data frames, and CSV files with units in the header."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from .files import write_aside
from .units import FIELD_UNITS

if TYPE_CHECKING:
    from pandas import DataFrame


class NamedColumn(NamedTuple):
    """A column of a table of results.

    Attributes
    ----------
    name : str
        Name of the quantity.
    unit : str
        Unit of the quantity; empty for text and for numbers without a unit.
    values : (R,) array
        Values of the quantity in all rows.
    """

    name: str
    unit: str
    values: Any

    @property
    def header(self) -> str:
        """Name and unit, for example `time [s]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Tabular:
    """A result along an axis whose values are columns of a table.

    Attributes
    ----------
    _units : dict of str
        Names of the attributes that are columns, and their units; the axis is first. {field} stands
        for the unit of the field that the attribute `field` names.
    _numbers : str
        Name of the attribute with the numbers of the grains or contacts to which the columns of
        (R, C) arrays belong.
    """

    _units: ClassVar[Mapping[str, str]] = {}
    _numbers: ClassVar[str] = ""

    def _columns(self) -> Iterator[NamedColumn]:
        """Yield the columns, the axis first."""
        for name, text in self._units.items():
            values = np.asarray(getattr(self, name))
            unit = text.format(field=FIELD_UNITS.get(getattr(self, "field", ""), ""))
            if values.ndim == 2:
                yield from number_columns(name, unit, getattr(self, self._numbers), values)
            elif np.iscomplexobj(values):
                yield NamedColumn(f"{name}_real", unit, values.real)
                yield NamedColumn(f"{name}_imaginary", unit, values.imag)
            else:
                yield NamedColumn(name, unit, values)

    def to_dataframe(self) -> DataFrame:
        """Return a pandas data frame, one row for each point, with units in the names."""
        from pandas import DataFrame

        return DataFrame({column.header: column.values for column in self._columns()})

    def to_csv(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write a CSV file atomically, with all digits of each number and units in the header.

        `Force(file=)`, `Drive(file=)` and `design.Traces.from_csv` read such files. A file that
        lmpchain did not write is replaced only if `overwrite` is true.

        Raises
        ------
        InputError
            If the file cannot be written or may not be replaced.
        """
        columns = list(self._columns())
        with (
            write_aside(path, overwrite) as aside,
            open(aside, "w", encoding="utf-8", newline="") as opened,
        ):
            writer = csv.writer(opened, lineterminator="\n")
            writer.writerow([column.header for column in columns])
            values = [_plain_list(column.values) for column in columns]
            for row in zip(*values, strict=True):
                writer.writerow([_digits(value) for value in row])


def number_columns(
    name: str, unit: str, numbers: Iterable[Any], values: np.ndarray
) -> Iterator[NamedColumn]:
    """Yield the columns of an (R, C) array, named by the numbers of their grains or contacts."""
    for number, column in zip(numbers, values.T, strict=True):
        label = f"{number:.6g}" if isinstance(number, float) else number
        yield NamedColumn(f"{name}_{label}", unit, column)


def of_rows(rows: Sequence[Mapping[str, Any]]) -> Iterator[NamedColumn]:
    """Yield the columns of records with the same fields."""
    for name in rows[0] if rows else ():
        yield NamedColumn(name, "", [row[name] for row in rows])


def _plain_list(values: Any) -> list[Any]:
    """Return values as Python numbers and words."""
    return values if isinstance(values, list) else np.asarray(values).tolist()


def _digits(value: Any) -> Any:
    """Return a number with all its digits, and other values unchanged."""
    return f"{value:.17g}" if isinstance(value, float) else value
