"""Assignment of the columns of a file to quantities, by the header or by the user's choice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError, shown
from ..util.number_tables import NumberTable
from ..util.units import unit_of

# Names of columns in the files of instruments: times, and counters of samples.
TIMES = ("time", "t", "x", "x-axis", "x_value")
COUNTER = re.compile(r"(sequence|samples?|index|nr|no|points?|#)[\s_.]*(#|nr|no|number|index)?\.?")
# Names of the sampling interval and of the sampling rate in files without times.
INTERVALS = (
    *("increment", "sample interval", "delta_x", "sampling interval", "tinc", "hresolution"),
    *("xinc", "tinterval", "dt", "sampling period", "sample period"),
)
RATES = ("sample rate", "samplerate", "sampling rate", "sampling frequency", "fs")
# Names of the units of all columns in files of Tektronix, LabVIEW and Yokogawa.
VALUE_UNITS = ("vertical units", "y_unit_label", "vunit")
TIME_UNITS = ("horizontal units", "x_unit_label", "hunit", "xunits")
# Largest relative deviation of a time step from the mean interval.
OFF_GRID = 0.01
# Column names that only tables of this package use: forces above rest, and contact forces.
OWN_NAMES = re.compile(r"(change_(force|contact)|force_contact)_\d+")


class ColumnMeaning(NamedTuple):
    """The expected content of a column: its name in a header, its SI unit, and preferred names."""

    name: str
    unit: str
    others: tuple[str, ...] = ()

    def check_not_another(self, column: str) -> None:
        """Raise `InputError` if the name of a column denotes another kind of force."""
        if not self.others or column in (self.name, *self.others) or not OWN_NAMES.match(column):
            return
        of = "a contact" if "contact" in column else "a grain, the mean of its two contacts"
        rest = "above" if column.startswith("change_") else "including"
        fault = f"{column} is the force of {of}, {rest} its value at rest, not {self.others[0]}"
        raise InputError.at(
            "columns", f"{fault}: choose the column {self.others[0]}, or the matching field"
        )


INSTANT = ColumnMeaning("time", "s")


def time_factor(table: NumberTable, place: int) -> float:
    """Return the unit of time, s, that a file states for a column without its own unit."""
    unit = unit_of(table.word(place, *TIME_UNITS))
    return unit.factor if unit and unit.base == "s" else 1.0


def interval_of(table: NumberTable, place: int) -> float | None:
    """Return the sampling interval that a file states for a column, s, or None."""
    if (interval := table.fact(place, *INTERVALS)) is not None:
        return time_factor(table, place) * interval
    rate = table.fact(place, *RATES)
    return 1 / rate if rate else None


def is_counter(table: NumberTable, place: int) -> bool:
    """Return whether a column counts samples, and therefore has no unit of time.

    A column is a counter if its name or unit shows it, or if it contains consecutive integers and
    neither its name nor a unit denotes times.
    """
    column = table.columns[place]
    if _in_seconds(table, place) or _is_named_counter(table, place):
        return not _in_seconds(table, place)
    if column.name.lower() in ("time", "t") or column.unit:
        return False
    if table.word(place, *TIME_UNITS) and interval_of(table, place) is None:
        return False
    values = table.values([place])[:, 0]
    return bool((np.diff(values) == 1).all() and values[0] == np.floor(values[0]))


def _is_named_counter(table: NumberTable, place: int) -> bool:
    """Return whether the name or the unit of a column denotes a counter of samples."""
    return any(COUNTER.fullmatch(word.lower()) for word in table.columns[place][:2])


def _in_seconds(table: NumberTable, place: int) -> bool:
    """Return whether the header of a column has a unit of time."""
    unit = unit_of(table.columns[place].unit)
    return unit is not None and unit.base == "s"


def find_columns(
    table: NumberTable, quantities: Sequence[ColumnMeaning], columns: Any
) -> list[int | None]:
    """Return the columns of quantities, named by `columns` or the header; None for others."""
    if columns is None:
        return [_by_name(table, *quantity.others, quantity.name) for quantity in quantities]
    names = [quantity.name for quantity in quantities]
    if isinstance(columns, dict):
        if strange := columns.keys() - set(names):
            known = ", ".join(names)
            raise InputError.at("columns", f"{shown(min(strange))} is not one of {known}")
        return [_place(table, columns[name]) if name in columns else None for name in names]
    if len(columns) != len(names):
        message = f"must name {len(names)} columns: {', '.join(names)}"
        raise InputError.at("columns", f"{message} (got {len(columns)})")
    return [_place(table, column) for column in columns]


def find_time_and_columns(
    table: NumberTable, quantities: Sequence[ColumnMeaning], columns: Any
) -> list[int | None]:
    """Return the column of times, or None, and the columns of all quantities.

    Raises
    ------
    InputError
        If columns are ambiguous or missing.
    """
    everything = [INSTANT, *quantities]
    if columns is None:
        return _find_by_header(table, everything)
    # Times may be computed from the sampling interval.
    alone = not isinstance(columns, dict) and len(columns) == len(quantities)
    places = find_columns(table, quantities if alone else everything, columns)
    places = [None, *places] if alone else places
    for quantity, place in zip(quantities, places[1:], strict=True):
        if place is None:
            raise InputError.at("columns", f"has no entry for {quantity.name}: add it")
    if places[0] is None:
        places[0] = _own_times(table, [place for place in places[1:] if place is not None])
    return places


def _own_times(table: NumberTable, values: Sequence[int]) -> int | None:
    """Return the time column if columns were named without it; None if no column fits.

    The column of times is the nearest column to the left with a name or unit of time, with a
    counter of samples, or with steps equal to the stated sampling interval.

    Raises
    ------
    InputError
        If the columns have different times.
    """
    times = _times_among(table, [place for place in table.numeric if place not in values])
    nearest = [max((t for t in times if t < place), default=None) for place in values]
    if len(times) > 1 and len({*nearest}) > 1:
        used = table.values([t for t in nearest if t is not None])
        if None in nearest or (used != used[:, :1]).any():
            fault = f"{table.path}: these columns have different times"
            raise InputError.at("columns", f"{fault}: read them one by one, or name one for all")
    return nearest[0] if nearest[0] is not None else next(iter(times), None)


def _times_among(table: NumberTable, places: Sequence[int]) -> list[int]:
    """Return the time columns among these: by name, otherwise by unit, otherwise by numbers."""
    for kind in (_named_times, _in_seconds, _on_grid):
        if times := [place for place in places if kind(table, place)]:
            return times
    return []


def _named_times(table: NumberTable, place: int) -> bool:
    """Return whether a column has the name of times, and a unit of time or no unit."""
    column = table.columns[place]
    fits = _in_seconds(table, place) or not unit_of(column.unit)
    return fits and column.name.lower() in TIMES


def _on_grid(table: NumberTable, place: int) -> bool:
    """Return whether a column counts samples, or has the stated sampling interval."""
    column = table.columns[place]
    if unit_of(column.unit):
        return False
    if is_counter(table, place):
        return True
    interval = interval_of(table, place)
    steps = np.diff(table.values([place])[:, 0])
    return bool(interval and (np.abs(steps - interval) < OFF_GRID * interval).all())


def _find_by_header(table: NumberTable, quantities: Sequence[ColumnMeaning]) -> list[int | None]:
    """Return the columns of time and quantities by the header or by elimination."""
    places = find_columns(table, quantities, None)
    if places[0] is None:
        places[0] = _time_place(table)
    missing = [k for k, place in enumerate(places) if place is None]
    rest = [place for place in table.numeric if place not in places]
    if places[0] is not None:
        rest = [place for place in rest if not _is_named_counter(table, place)]
    elif _has_interval(table, rest, len(missing)):
        missing = missing[1:]
    if missing and len(rest) != len(missing):
        raise ambiguous(table, quantities)
    for k, place in zip(missing, rest, strict=False):
        places[k] = place
    return places


def _has_interval(table: NumberTable, rest: Sequence[int], missing: int) -> bool:
    """Return whether a file states the sampling interval instead of times."""
    names = [table.columns[place].name for place in rest]
    interval = interval_of(table, table.numeric[-1])
    return interval is not None and (len(rest) < missing or any(names))


def _by_name(table: NumberTable, *names: str) -> int | None:
    """Return the only column with the first of these names that occurs."""
    for name in names:
        places = [
            place
            for place in table.numeric
            if name.lower()
            in (table.columns[place].name.lower(), table.columns[place].cell.lower())
        ]
        if len(places) > 1:
            cure = "choose one by its number in columns"
            raise InputError.at("columns", f"{table.path} has {len(places)} columns {name}: {cure}")
        if places:
            return places[0]
    return None


def _time_place(table: NumberTable) -> int | None:
    """Return the only column of times or counts by its name or its unit."""
    named = _by_name(table, *TIMES)
    if named is not None:
        return named
    units = [(place, unit_of(table.columns[place].unit)) for place in table.numeric]
    timed = [place for place, unit in units if unit and unit.base == "s"]
    timed = timed or [place for place in table.numeric if _is_named_counter(table, place)]
    return timed[0] if len(timed) == 1 else None


def _place(table: NumberTable, column: int | str) -> int:
    """Return the position of a column given by its number or its name."""
    place = _by_name(table, column) if isinstance(column, str) else column - 1
    if place is None or place not in table.numeric:
        raise InputError.at(
            "columns", f"{table.path} has no column {shown(column)} of numbers: {_list(table)}"
        )
    return place


def _list(table: NumberTable) -> str:
    """Return a description of the numeric columns of a table."""
    return "it has " + ", ".join(map(table.describe, table.numeric))


def ambiguous(table: NumberTable, quantities: Sequence[ColumnMeaning]) -> InputError:
    """Return the error for a file with columns that cannot be identified."""
    names = ", ".join(quantity.name for quantity in quantities)
    cure = f"name {names} by columns = [number or name, ...]"
    return InputError.at("columns", f"{table.path} is ambiguous: {_list(table)}; {cure}")
