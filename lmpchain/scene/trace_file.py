"""Traces and profiles from files of instruments: columns, units, calibration, pre-trigger."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import InputError, shown
from ..util.arrays import Array, numbers
from ..util.files import path_of
from ..util.number_tables import NumberTable, read_table
from ..util.tables import counted
from ..util.units import unit_of
from ..util.validation import NOT_GIVEN, Checked, Positive, Real, Whole
from .file_columns import (
    COUNTERS,
    INTERVALS,
    Quantity,
    ambiguous,
    find_columns,
    find_time_and_columns,
)

# what a file says of the sampling in place of a column: first time, first sample
BEGINS = ("start", "x0", "t0", "hoffset")
TRIGGER_POINTS = ("trigger point",)
# names of the units of all columns, in the files of Tektronix, LabVIEW and Yokogawa
VALUE_UNITS = ("vertical units", "y_unit_label", "vunit")
TIME_UNITS = ("horizontal units", "x_unit_label", "hunit")
# a sample as near to the trigger, in intervals, is at t = 0: the rest is round-off
SAME_TIME = 1e-6


@dataclass(frozen=True, eq=False)
class Reading:
    """What a file says, in SI units.

    Attributes
    ----------
    time : (R,) array
        s; empty where rows are no instants.
    values : (R, K) array
    text : str
        What was understood, in a line.
    names : list of str
        Of the K quantities.
    """

    time: Array
    values: Array
    text: str
    names: list[str]


def _file(value: Any) -> Path:
    try:
        return path_of(value)
    except InputError as error:
        raise ValueError("must be the name of a CSV file") from error


def _columns(value: Any) -> Any:
    """Return columns as a list of numbers and names, or as such a mapping."""
    columns = [value] if isinstance(value, int | str) else value
    if not isinstance(columns, list | tuple | dict):
        raise ValueError(f"must be numbers, from 1, or names of columns (got {shown(value)})")
    entries = list(columns.values() if isinstance(columns, dict) else columns)
    for entry in entries:
        if isinstance(entry, bool) or not isinstance(entry, int | str):
            raise ValueError(f"must be numbers, from 1, or names of columns (got {shown(entry)})")
        if isinstance(entry, int) and entry < 1:
            raise ValueError(f"are counted from 1 (got {entry})")
    if not entries or len(set(entries)) < len(entries):
        raise ValueError("must be different columns, one or more")
    return columns


def _each(value: Any) -> Array:
    """Return a number, or one for each column, as an array."""
    array = np.atleast_1d(numbers(value))
    if array.ndim != 1 or not array.size or not np.isfinite(array).all():
        raise ValueError("must be a finite number, or one for each column of values")
    return array


def _scale(value: Any) -> Array:
    array = _each(value)
    if not array.all():
        raise ValueError("must not be 0: it is what one unit of the file stands for")
    return array


def _two_times(value: Any) -> Array:
    array = _each(value)
    if array.size != 2 or not array[0] < array[1]:
        raise ValueError(f"must be two times, s, the first before the second (got {shown(value)})")
    return array


class TableFile(Checked):
    """A text file with a column for each quantity, of any layout.

    Parameters
    ----------
    file : path
        Text: delimiter, decimal comma, lines above the table and units in its header are
        recognised.
    columns : list of int or str, or mapping, optional
        Numbers, from 1, or names of the columns, in the order of the quantities, or by their names;
        needed where headers do not tell.
    skip : int
        Lines at the beginning that are not looked at.
    scale : float or (K,) sequence, optional
        What one unit of a column stands for: of volts N/V, m/V or (m/s)/V, else a factor.
    offset : float or (K,) sequence, optional
        Taken off the columns before, in their unit (V of mV).
    """

    file: Annotated[Path, BeforeValidator(_file)]
    columns: Annotated[Any, BeforeValidator(_columns)] = NOT_GIVEN
    skip: Annotated[Whole, Field(ge=0)] = 0
    scale: Annotated[Array, BeforeValidator(_scale)] = NOT_GIVEN
    offset: Annotated[Array, BeforeValidator(_each)] = NOT_GIVEN

    def read(self, quantities: Sequence[Quantity]) -> Reading:
        """Return the columns of some of these quantities, those that the file has.

        Raises
        ------
        InputError
            If it cannot be read, or does not tell which columns these are.
        """
        table = read_table(self.file, self.skip)
        places = find_columns(table, quantities, self.columns)
        if not any(place is not None for place in places):
            raise ambiguous(table, quantities)
        present = [
            (quantity, place)
            for quantity, place in zip(quantities, places, strict=True)
            if place is not None
        ]
        counts = [
            place for place, column in enumerate(table.columns) if column.name.lower() == "grain"
        ]
        if counts and not (table.values(counts)[:, 0] == np.arange(len(table.lines)) + 1).all():
            raise InputError.at("file", f"{self.file}: the column grain must count 1, 2, 3 ...")
        values, words = self._calibrate_columns(table, present)
        return Reading(np.empty(0), values, self._text(table, words), [q.name for q, _ in present])

    def _calibrate_columns(
        self, table: NumberTable, present: Sequence[tuple[Quantity, Any]], base: Array | None = None
    ) -> tuple[Array, list[str]]:
        """Return the values of columns in SI units, and in words how they came about."""
        values = table.values([place for _, place in present])
        scales = _spread(self.scale, len(present), "scale")
        offsets = _spread(self.offset, len(present), "offset")
        words = []
        for k, (quantity, place) in enumerate(present):
            quantity.check_not_another(table.columns[place].name.lower())
            calibration = _calibrate(table, place, quantity, scales[k])
            values[:, k] *= calibration.unit
            less = offsets[k]
            words.append(f"{quantity.name}: {table.describe(place)}")
            if base is not None:
                less = values[base, k].mean()
            if less is not None:
                values[:, k] -= less
                what = f"{less:.6g} {calibration.base}".rstrip()
                words[-1] += f", less {what}" + (", its baseline" if base is not None else "")
            if calibration.scale != 1 or calibration.per:
                values[:, k] *= calibration.scale
                words[-1] += f", times {calibration.scale:g} {calibration.per}".rstrip()
        return values, words

    def _text(self, table: NumberTable, words: Sequence[str]) -> str:
        """Return what was understood in a line."""
        rows = f"{counted(len(table.lines), 'row')} from line {table.lines[0][0]}"
        layout = f", {table.layout.words}" if len(table.numeric) > 1 else ""
        return "; ".join([f"{self.file.name}: {rows}{layout}", *words])


class TraceFile(TableFile):
    """A text file with values over time, as an instrument writes it.

    Parameters
    ----------
    time_scale : float, optional
        s for each unit of the column of times, by default what its header says, or 1; between two
        samples where there is no such column.
    baseline : (2,) sequence, optional
        Times of the file, s, between which the mean is taken off, in place of an offset.
    trigger : float, optional
        Time of the file, s, that is t = 0. What is before is dropped.
    """

    time_scale: Positive = NOT_GIVEN
    baseline: Annotated[Array, BeforeValidator(_two_times)] = NOT_GIVEN
    trigger: Real = NOT_GIVEN

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.baseline is not None and self.offset is not None:
            yield "baseline", "is an offset that the trace tells: take one of both out"

    def read(self, quantities: Sequence[Quantity], from_zero: bool = False) -> Reading:
        """Return the times and the values of all quantities.

        Parameters
        ----------
        quantities : K Quantity
        from_zero : bool
            Whether the trace is to begin at t = 0 if `trigger` is between two samples: then with
            the value on the line between them.

        Raises
        ------
        InputError
            If it cannot be read, or does not tell which columns these are.
        """
        table = read_table(self.file, self.skip, 1 + len(quantities))
        if len(table.lines) < 2:
            names = ", ".join(["time", *(quantity.name for quantity in quantities)])
            raise InputError.at("file", f"{self.file} has not two lines of numbers: {names}")
        time_place, *places = find_time_and_columns(table, quantities, self.columns)
        time, word = self._time(table, time_place)
        present = list(zip(quantities, places, strict=True))
        values, words = self._calibrate_columns(table, present, self._window(time))
        words = [word, *words]
        if self.trigger is not None:
            time, values, before = self._from_trigger(time, values, from_zero)
            words.append(f"t = 0 at {self.trigger:g} s, {counted(before, 'row')} before it dropped")
        text = self._text(table, words)
        return Reading(time, values, text, [quantity.name for quantity in quantities])

    def _time(self, table: NumberTable, place: int | None) -> tuple[Array, str]:
        """Return the times of a trace, s, and in words where they are from."""
        column = None if place is None else table.columns[place]
        counts = column is None or {column.name.lower(), column.unit.lower()} & set(COUNTERS)
        samples = np.arange(float(len(table.lines)))
        if place is not None:
            samples = table.values([place])[:, 0]
        if counts:
            step = table.fact(*INTERVALS) if self.time_scale is None else self.time_scale
            if step is None:
                cure = "give the column of the times by columns, or the interval as time_scale"
                raise InputError.at("time_scale", f"{self.file} has no times: {cure}")
            begin = table.fact(*BEGINS)
            if begin is None:
                begin = 0.0 - step * (table.fact(*TRIGGER_POINTS) or 0.0)
            time = begin + step * samples
            word = f"time: from {begin:g} s by intervals of {step:g} s"
        else:
            assert place is not None
            factor = self._time_unit(table, place)
            time = factor * samples
            # the unit in the header says it already
            word = f"time: {table.describe(place)}"
            if self.time_scale is not None or not table.columns[place].unit:
                word += f", times {factor:g} s" if factor != 1 else " in s"
        back = np.flatnonzero(np.diff(time) <= 0)
        if back.size:
            line = table.lines[back[0] + 1][0]
            cure = "sort the lines, or save the times with more digits, and one trace a file"
            raise InputError.at("file", f"{self.file}, line {line}: time does not increase: {cure}")
        return time, word

    def _time_unit(self, table: NumberTable, place: int) -> float:
        """Return how many seconds one unit of the column of times is."""
        text = table.columns[place].unit or next(filter(None, map(table.facts.get, TIME_UNITS)), "")
        unit = unit_of(text)
        header = f"the header of {self.file} says {shown(text)}"
        if self.time_scale is None:
            if not text:
                return 1.0
            if unit is None or unit.base != "s":
                cure = "give time_scale, in s, or the column of the times by columns"
                raise InputError.at("time_scale", f"{header}, which is no time: {cure}")
            return unit.factor
        if unit and unit.base == "s" and not np.isclose(unit.factor, self.time_scale, 1e-9):
            cure = "leave time_scale out, or the header by skip"
            raise InputError.at("time_scale", f"{header}, not {self.time_scale:g} s: {cure}")
        return self.time_scale

    def _window(self, time: Array) -> Array | None:
        """Return which samples are in the window of the baseline; None without one."""
        if self.baseline is None:
            return None
        inside = (time >= self.baseline[0]) & (time <= self.baseline[1])
        if not inside.any():
            extent = f"which goes from {time[0]:g} to {time[-1]:g} s"
            raise InputError.at("baseline", f"has no sample of the trace in it, {extent}")
        return inside

    def _from_trigger(
        self, time: Array, values: Array, from_zero: bool
    ) -> tuple[Array, Array, int]:
        """Return times and values since the trigger, and how many rows are before it."""
        if not time[0] <= self.trigger < time[-1]:
            extent = f"which goes from {time[0]:g} to {time[-1]:g} s"
            raise InputError.at("trigger", f"must be within the trace, {extent}")
        slack = SAME_TIME * np.diff(time).min()
        # of the first row behind the trigger, and the last one before it or at it
        first = int(np.argmax(time > self.trigger + slack))
        last = first - 1
        since = time[first:] - self.trigger
        if self.trigger - time[last] <= slack:
            return np.append(0.0, since), values[last:], last
        if not from_zero:
            return since, values[first:], first
        share = (self.trigger - time[last]) / (time[first] - time[last])
        begin = values[last] + share * (values[first] - values[last])
        return np.append(0.0, since), np.vstack([begin, values[first:]]), first


class Calibration(NamedTuple):
    """From the numbers of a column to SI: its unit, what that is in SI, and what one of it is."""

    unit: float
    base: str
    scale: float
    per: str


def _calibrate(
    table: NumberTable, place: int, quantity: Quantity, scale: float | None
) -> Calibration:
    """Return how the numbers in a column become those of a quantity."""
    text = table.columns[place].unit or next(filter(None, map(table.facts.get, VALUE_UNITS)), "")
    unit = unit_of(text)
    same = unit is not None and unit.base == quantity.unit
    header = f"{table.path} has {quantity.name} in {shown(text)}"
    if scale is None:
        if not text or (unit and same):
            return Calibration(unit.factor if unit else 1.0, quantity.unit, 1.0, "")
        base = unit.base if unit else text
        raise InputError.at("scale", f"{header}: give it in {quantity.unit} for each {base}")
    if not unit:
        return Calibration(1.0, "", scale, quantity.unit)
    if not same:
        # (m/s)/V
        name = f"({quantity.unit})" if "/" in quantity.unit else quantity.unit
        return Calibration(unit.factor, unit.base, scale, f"{name}/{unit.base}")
    if unit.factor != 1 and not np.isclose(unit.factor, scale, 1e-9):
        cure = "leave scale out, or the header by skip"
        raise InputError.at("scale", f"{header}, to which it would come on top: {cure}")
    return Calibration(1.0, unit.base, scale, "")


def _spread(values: Array | None, count: int, key: str) -> list[float | None]:
    """Return a number for each of so many columns."""
    if values is None:
        return [None] * count
    if values.size not in (1, count):
        raise InputError.at(key, f"must be one number, or {count}, one a column of values")
    return np.broadcast_to(values, count).tolist()
