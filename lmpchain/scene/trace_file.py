"""Traces and profiles from files of instruments: columns, units, calibration, pre-trigger."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import InputError, shown
from ..util.arrays import Array, numbers
from ..util.files import path_of
from ..util.number_tables import NumberTable, read_table
from ..util.remarks import note
from ..util.tables import counted
from ..util.units import unit_of
from ..util.validation import NOT_GIVEN, Checked, Positive, Real, Whole
from .base import Excitation
from .file_columns import (
    OFF_GRID,
    TIME_UNITS,
    VALUE_UNITS,
    ColumnMeaning,
    ambiguous,
    find_columns,
    find_time_and_columns,
    interval_of,
    is_counter,
    time_factor,
)

# Facts about the sampling in the header, in files without times: first time, number of the trigger
# sample.
BEGINS = ("start", "x0", "t0", "hoffset", "xorg", "tstart")
TRIGGER_POINTS = ("trigger point",)
FILTER_ORDER = 4  # Order of the low-pass filter, which is applied forward and backward.
# A sample closer to the trigger than this fraction of an interval is at t = 0, because the rest is
# rounding error.
SAME_TIME = 1e-6


@dataclass(frozen=True, eq=False)
class Reading:
    """The content of a file, in SI units.

    Attributes
    ----------
    time : (R,) array
        Times, s; empty if rows are not times.
    values : (R, K) array
        Values of the K quantities.
    text : str
        Description of how the file was read, in one line.
    names : list of str
        Names of the K quantities.
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
    """Check columns: a list of numbers and names, or a mapping to these."""
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
        raise ValueError("must name one or more different columns")
    return columns


def _each(value: Any) -> Array:
    """Return a number, or a sequence with one number for each column, as an array."""
    array = np.atleast_1d(numbers(value))
    if array.ndim != 1 or not array.size or not np.isfinite(array).all():
        raise ValueError("must be a finite number, or one for each column of values")
    return array


def _scale(value: Any) -> Array:
    array = _each(value)
    if not array.all():
        raise ValueError("must not be 0: it is the value of one unit of the file")
    return array


def _two_times(value: Any) -> Array:
    array = _each(value)
    if array.size != 2 or not array[0] < array[1]:
        raise ValueError(f"must be two times, s, the first before the second (got {shown(value)})")
    return array


class TableFile(Checked):
    """A text file with a column for each quantity, in any layout.

    Parameters
    ----------
    file : path
        A text file. Its delimiter, a decimal comma, lines above the table and units in its header
        are detected. Files with arrays of NumPy, MATLAB, HDF5 or Excel, and universal files
        (dataset 58), can be read, too.
    columns : list of int or str, or mapping, optional
        Numbers (from 1) or names of the columns: a list in the order of the quantities, or a
        mapping from the names of the quantities. Required if the header is ambiguous.
    skip : int
        Number of lines at the beginning that are ignored.
    scale : float or (K,) sequence, optional
        Value of one unit of a column: N/V, m/V or (m/s)/V for volts, otherwise a factor.
    offset : float or (K,) sequence, optional
        Value that is subtracted from a column before scaling, in the unit of the column without its
        prefix (V for a column in mV).
    """

    file: Annotated[Path, BeforeValidator(_file)]
    columns: Annotated[Any, BeforeValidator(_columns)] = NOT_GIVEN
    skip: Annotated[Whole, Field(ge=0)] = 0
    scale: Annotated[Array, BeforeValidator(_scale)] = NOT_GIVEN
    offset: Annotated[Array, BeforeValidator(_each)] = NOT_GIVEN

    def read(self, quantities: Sequence[ColumnMeaning]) -> Reading:
        """Return the columns of those quantities that the file contains.

        Raises
        ------
        InputError
            If the file cannot be read, or if its columns are ambiguous.
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
        if counts and not (table.values(counts)[:, 0] == np.arange(len(table.numbers)) + 1).all():
            raise InputError.at("file", f"{self.file}: the column grain must count 1, 2, 3 ...")
        values, words = self._calibrate_columns(table, present)
        return Reading(np.empty(0), values, self._text(table, words), [q.name for q, _ in present])

    def _calibrate_columns(
        self,
        table: NumberTable,
        present: Sequence[tuple[ColumnMeaning, Any]],
        base: Array | None = None,
    ) -> tuple[Array, list[str]]:
        """Return the values of columns in SI units, and a description of the conversion."""
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
        """Return a description of how the file was read, in one line."""
        line = "row" if table.arrays is not None else "line"
        rows = f"{counted(len(table.numbers), 'row')} from {line} {table.numbers[0]}"
        layout = f", {table.layout.words}" if len(table.numeric) > 1 else ""
        return "; ".join([f"{self.file.name}: {rows}{layout}", *words])


class TraceFile(TableFile):
    """A text file with values over time, as written by an instrument.

    Parameters
    ----------
    time_scale : float, optional
        Length of one unit of the column of times, s; by default the unit in its header, or 1 s. If
        the file has no times or only a counter of samples, `time_scale` is the sampling interval,
        s.
    baseline : (2,) sequence, optional
        Two times of the file, s. The mean of the samples between them is subtracted, in place of an
        offset.
    trigger : float, optional
        Time of the file, s, that becomes t = 0. Earlier samples are dropped.
    lowpass : float, optional
        Cut-off frequency, Hz, of a Butterworth filter of fourth order, applied forward and backward
        without delay. It halves the amplitude at this frequency.
    every : int, optional
        Keep the first sample and every n-th sample after it, for a trace that is sampled more
        densely than the motion requires.
    """

    time_scale: Positive = NOT_GIVEN
    baseline: Annotated[Array, BeforeValidator(_two_times)] = NOT_GIVEN
    trigger: Real = NOT_GIVEN
    lowpass: Positive = NOT_GIVEN
    every: Annotated[Whole, Field(ge=1)] = 1

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.baseline is not None and self.offset is not None:
            yield "baseline", "cannot be combined with offset: remove one of them"

    def read(self, quantities: Sequence[ColumnMeaning], from_zero: bool = False) -> Reading:
        """Return the times and the values of all quantities.

        Parameters
        ----------
        quantities : sequence of K ColumnMeaning
            Quantities to read, all of them required.
        from_zero : bool
            Whether a sample at t = 0 is interpolated linearly if `trigger` is between two samples.

        Raises
        ------
        InputError
            If the file cannot be read, or if its columns are ambiguous.
        """
        table = read_table(self.file, self.skip, 1 + len(quantities))
        if len(table.numbers) < 2:
            names = ", ".join(["time", *(quantity.name for quantity in quantities)])
            raise InputError.at("file", f"{self.file} needs two lines of numbers: {names}")
        time_place, *places = find_time_and_columns(table, quantities, self.columns)
        time, word = self._time(table, time_place, [place for place in places if place is not None])
        present = list(zip(quantities, places, strict=True))
        values, words = self._calibrate_columns(table, present, self._window(time))
        words = [word, *words]
        if self.lowpass is not None:
            values = smooth(time, values, self.lowpass)
            words.append(f"low pass of {self.lowpass:g} Hz")
        if self.trigger is not None:
            time, values, before = self._from_trigger(time, values, from_zero)
            words.append(f"t = 0 at {self.trigger:g} s, {counted(before, 'row')} before it dropped")
        if self.every > 1:
            if not len(time) > self.every:
                fault = f"must be below {len(time)}, the number of samples"
                raise InputError.at("every", f"{fault} (got {self.every})")
            time, values = time[:: self.every], values[:: self.every]
            words.append(f"1 of {self.every} samples kept, {len(time)} in total")
        text = self._text(table, words)
        return Reading(time, values, text, [quantity.name for quantity in quantities])

    def _time(
        self, table: NumberTable, place: int | None, values: Sequence[int]
    ) -> tuple[Array, str]:
        """Return the times of a trace, s, and a description of their origin."""
        scale: float | None = self.time_scale
        if place is not None and scale is not None and not self._names_times(len(values)):
            place, scale = self._times_beside(table, place)
        samples = np.arange(float(len(table.numbers)))
        if place is not None:
            samples = table.values([place])[:, 0]
        # A column with its own factor contains times, unless its header denotes a counter.
        if place is None or is_counter(table, place):
            time, word = self._counted_times(table, place, values, samples, scale)
        else:
            factor = self._time_unit(table, place, scale)
            time = factor * samples
            # A unit in the header is already part of the description.
            word = f"time: {table.describe(place)}"
            if scale is not None or not table.columns[place].unit:
                word += f", times {factor:g} s" if factor != 1 else " in s"
        back = np.flatnonzero(~(np.diff(time) > 0))
        if back.size:
            line = table.numbers[back[0] + 1]
            cure = "sort the lines, or save the times with more digits, and one trace a file"
            raise InputError.at("file", f"{self.file}, line {line}: time does not increase: {cure}")
        return time, word

    def _counted_times(
        self,
        table: NumberTable,
        place: int | None,
        values: Sequence[int],
        samples: Array,
        scale: float | None,
    ) -> tuple[Array, str]:
        """Return the times of counted samples, s, from the sampling interval; and a description."""
        step = scale or _step(table, values)
        if step is None:
            cure = "give the column of the times by columns, or the interval as time_scale"
            fault = f"{self.file} has no times"
            if place is not None:
                fault += f": {table.describe(place)} counts the samples, and has no unit"
            raise InputError.at("time_scale", f"{fault}: {cure}")
        if place is None and len(set(np.diff(table.numbers))) > 1:
            after = table.numbers[int(np.argmax(np.diff(table.numbers)))]
            fault = f"{self.file}, line {after + 1}: is empty, but lines are counted as samples"
            raise InputError.at("file", f"{fault}: fill it in or remove it")
        factor = time_factor(table, values[0])
        begin = table.fact(values[0], *BEGINS)
        if begin is None:
            begin = 0.0 - step * (table.fact(values[0], *TRIGGER_POINTS) or 0.0)
        else:
            begin *= factor
        time = begin + step * samples
        return time, f"time: from {time[0]:g} s by intervals of {step:g} s"

    def _names_times(self, values: int) -> bool:
        """Return whether `columns` names the time column, or leaves it to the header."""
        if self.columns is None or isinstance(self.columns, dict):
            return self.columns is None or "time" in self.columns
        return len(self.columns) > values

    def _times_beside(self, table: NumberTable, place: int) -> tuple[int | None, float | None]:
        """Return the time column beside a value that was named alone, and its scale, s.

        The given scale may be the sampling interval, as for files without times. A column whose
        steps equal this interval needs no scale. A column is ignored if the unit of time in its
        header contradicts the scale.
        """
        unit = unit_of(table.unit(place, *TIME_UNITS))
        factor = unit.factor if unit and unit.base == "s" else None
        steps = np.diff(table.values([place])[:, 0]) * (factor or 1.0)
        if (np.abs(steps - self.time_scale) < OFF_GRID * self.time_scale).all():
            return place, self.time_scale if is_counter(table, place) else None
        if factor is not None and not math.isclose(factor, self.time_scale):
            return None, self.time_scale
        return place, self.time_scale

    def _time_unit(self, table: NumberTable, place: int, scale: float | None) -> float:
        """Return the length of one unit of the time column, s."""
        text = table.unit(place, *TIME_UNITS)
        unit = unit_of(text)
        header = f"the header of {self.file} says {shown(text)}"
        if scale is None:
            if not text:
                return 1.0
            if unit is None or unit.base != "s":
                cure = "give time_scale, in s, or the column of the times by columns"
                raise InputError.at("time_scale", f"{header}, which is not a unit of time: {cure}")
            return unit.factor
        if unit and unit.base == "s" and not math.isclose(unit.factor, scale):
            cure = "omit time_scale, or skip the header"
            raise InputError.at("time_scale", f"{header}, not {scale:g} s: {cure}")
        return scale

    def _window(self, time: Array) -> Array | None:
        """Return a mask of the samples in the window of the baseline; None without a baseline."""
        if self.baseline is None:
            return None
        inside = (time >= self.baseline[0]) & (time <= self.baseline[1])
        if not inside.any():
            extent = f"which covers {time[0]:g} to {time[-1]:g} s"
            raise InputError.at("baseline", f"contains no sample of the trace, {extent}")
        return inside

    def _from_trigger(
        self, time: Array, values: Array, from_zero: bool
    ) -> tuple[Array, Array, int]:
        """Return times and values since the trigger, and the number of rows before it."""
        slack = SAME_TIME * np.diff(time).min()
        if not time[0] - slack <= self.trigger < time[-1] - slack:
            extent = f"which covers {time[0]:g} to {time[-1]:g} s"
            raise InputError.at("trigger", f"must be within the trace, {extent}")
        # Index of the first row after the trigger, and of the last row at or before it.
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


def smooth(time: Array, values: Array, lowpass: float) -> Array:
    """Return values (R, K) without frequencies above the cut-off, Hz, and without delay.

    Raises
    ------
    InputError
        If the samples are too few, too far apart, or not evenly spaced.
    """
    from scipy.signal import butter, sosfiltfilt

    steps = np.diff(time)
    step = steps.mean()
    if not (np.abs(steps - step) < OFF_GRID * step).all():
        fault = f"needs evenly spaced times (they are {steps.min():g} to {steps.max():g} s apart)"
        raise InputError.at("lowpass", f"{fault}: leave it out")
    if not lowpass < 0.5 / step:
        fault = f"must be below {0.5 / step:g} Hz, half the sampling rate"
        raise InputError.at("lowpass", f"{fault} (got {lowpass:g})")
    # The two passes halve the amplitude at the cut-off.
    sections = butter(FILTER_ORDER, 2 * step * lowpass, output="sos")
    fewest = 3 * (2 * len(sections) + 1)
    if len(time) <= fewest:
        raise InputError.at("lowpass", f"needs more than {fewest} samples (got {len(time)})")
    return np.asarray(sosfiltfilt(sections, values, axis=0))


def _step(table: NumberTable, values: Sequence[int]) -> float | None:
    """Return the sampling interval of these columns, s; None if the file does not state it."""
    steps = {interval_of(table, place) for place in values}
    if len(steps) > 1:
        fault = f"{table.path} has columns with different intervals"
        raise InputError.at("columns", f"{fault}: read them one by one")
    return steps.pop()


class Calibration(NamedTuple):
    """Conversion of a column to SI: factor of its unit, SI unit, scale, and unit of the scale."""

    unit: float
    base: str
    scale: float
    per: str


def _calibrate(
    table: NumberTable, place: int, quantity: ColumnMeaning, scale: float | None
) -> Calibration:
    """Return the conversion of a column to a quantity in SI units."""
    text = table.unit(place, *VALUE_UNITS)
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
        # The unit of the scale is written as (m/s)/V.
        name = f"({quantity.unit})" if "/" in quantity.unit else quantity.unit
        return Calibration(unit.factor, unit.base, scale, f"{name}/{unit.base}")
    if unit.factor == 1:
        return Calibration(1.0, unit.base, scale, "")
    if not math.isclose(unit.factor, scale):
        cure = "omit scale, or skip the header"
        raise InputError.at("scale", f"{header}, and scale would be a second factor: {cure}")
    # The scale repeats the prefix in the header, and an offset has no prefix.
    return Calibration(unit.factor, unit.base, 1.0, "")


def _spread(values: Array | None, count: int, key: str) -> list[float | None]:
    """Return one number for each of `count` columns."""
    if values is None:
        return [None] * count
    if values.size not in (1, count):
        raise InputError.at(key, f"must be one number, or {count} numbers, one for each column")
    return np.broadcast_to(values, count).tolist()


class Measured(Excitation):
    """An excitation with arrays that may be read from a file, and a record of the reading.

    Attributes
    ----------
    file_kind : type
        Class that reads the file: a `TableFile` with its options.
    source : str, optional
        Description of the reading; ignored when excitations are compared.
    """

    file_kind: ClassVar[type[TableFile]]
    if TYPE_CHECKING:
        source: str

    def __init_subclass__(cls, **options: Any) -> None:
        """Add the options of the file to the arguments of the class."""
        super().__init_subclass__(**options)
        if "file_kind" in vars(cls):
            cls.other_arguments = tuple(cls.file_kind.arguments)

    def __init__(self, *values: Any, **data: Any):
        options = {key: data.pop(key) for key in self.other_arguments if key in data}
        reading = self._read(options, data) if options else None
        super().__init__(*values, **data)
        if reading:
            note(reading.text)

    def _read(self, options: dict[str, Any], data: dict[str, Any]) -> Reading:
        """Add the arrays of a file, and a description of how it was read, to the data."""
        if unknown := [key for key in data if key not in self.arguments]:
            raise InputError((key, self._unknown(key)) for key in unknown)
        if options.get("file") is None:
            raise InputError((key, "requires a file: give file") for key in options)
        file = self.file_kind(**{key: value for key, value in options.items() if value is not None})
        reading, arrays = self._arrays(file)
        if twice := [key for key in (*arrays, "source") if data.get(key) is not None]:
            cure = "is in the file already; remove it from one of them"
            raise InputError((key, cure) for key in twice)
        data |= arrays | {"source": reading.text}
        return reading

    @classmethod
    def _arrays(cls, file: Any) -> tuple[Reading, dict[str, Any]]:
        """Read a file, and return the fields that its columns define."""
        raise NotImplementedError

    def replace(self, **changes: Any) -> Self:
        """Return a checked copy with these fields changed.

        The copy has no `source` if its arrays differ from those in the file.
        """
        described = {"grain", "start", "interpolation", "source"}
        source = {} if changes.keys() <= described else {"source": None}
        return super().replace(**source | changes)

    def _compared(self) -> Iterable[str]:
        return [key for key in self.arguments if key != "source"]
