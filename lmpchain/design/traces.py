"""Measured traces, and the corresponding values in a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal, get_args

import numpy as np

from ..errors import InputError, shown
from ..integrators.adjoint import Inputs
from ..integrators.differentiation import AnyRun
from ..scene.file_columns import ColumnMeaning
from ..scene.scene import Scene
from ..scene.trace_file import TraceFile
from ..util.arrays import Array, check_flags, numbers, whole_numbers
from ..util.notebook import Shown
from ..util.remarks import note
from ..util.tabular import NamedColumn, Tabular, number_columns
from ..util.units import FIELD_UNITS
from .differences import FixedRun
from .objectives import Seen, contact_force

Field = Literal["velocity", "displacement", "force", "contact"]
OF_FILES = TraceFile.arguments.keys() - {"file"}


@dataclass(frozen=True, eq=False, repr=False)
class Traces(Shown, Tabular):
    """Values measured at the same times at some grains or contacts.

    Parameters
    ----------
    time : (T,) array
        Increasing times, s.
    places : (G,) integers
        Numbers of grains, or of contacts: 0 is at the top wall, N at the bottom wall.
    values : (T, G) array
        Measured values, in m/s, m or N. Velocity and displacement are positive downward.
    field : "velocity", "displacement", "force" or "contact"
        Measured quantity. "force" is the force that a sensor in a grain shows, the mean of its two
        contacts, and "contact" the force of a contact; both are relative to rest.
    noise : float or (G,) array, optional
        Standard deviation of the noise, in the unit of the values; by default it is estimated from
        the residuals of the fit.
    trigger, gain, offset : bool
        Whether the time of the strike is unknown; whether a factor of all values is unknown;
        whether a constant added to each trace is unknown.

    Raises
    ------
    InputError
        With all faults found.
    """

    time: Array
    places: Sequence[int]
    values: Array
    field: Field = "velocity"
    noise: float | Array | None = None
    trigger: bool = False
    gain: bool = False
    offset: bool = False

    def __post_init__(self) -> None:
        check_flags(trigger=self.trigger, gain=self.gain, offset=self.offset)
        time = numbers(self.time, "time")
        values = numbers(self.values, "values")
        values = values[:, None] if values.ndim == 1 else values
        places = np.atleast_1d(whole_numbers(self.places, "places"))
        shape = time.size, places.size
        missing = (~np.isfinite(values)).sum()
        noise = np.ones(()) if self.noise is None else numbers(self.noise, "noise")
        increasing = time.ndim == 1 and time.size >= 2 and np.isfinite(time).all()
        faults = []
        if not increasing or not (np.diff(time) > 0).all():
            faults.append(("time", "must be two or more increasing numbers"))
        if values.shape != shape:
            message = f"must be of shape {shape}, times and places, not {values.shape}"
            faults.append(("values", message))
        elif missing:
            message = f"must be finite: leave out the times of {missing} that are not"
            faults.append(("values", message))
        if self.field not in get_args(Field):
            message = f"must be one of {', '.join(get_args(Field))} (got {shown(self.field)})"
            faults.append(("field", message))
        if not places.size:
            faults.append(("places", "must name a grain or a contact"))
        if noise.shape not in ((), places.shape):
            faults.append(("noise", f"must be one number or {places.size}, one for each place"))
        elif not ((noise > 0) & np.isfinite(noise)).all():
            faults.append(("noise", f"must be above 0 (got {shown(self.noise)})"))
        if faults:
            raise InputError(faults)
        for name, value in (("time", time), ("values", values), ("places", places)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_csv(cls, path: str | PathLike[str], places: Sequence[int], **options: Any) -> Traces:
        """Read the times and one column per place from an instrument's file.

        Delimiter, decimal comma, lines above the table and units in its header are detected, and
        a line of text describes them.

        Parameters
        ----------
        path : path
            Path of the file.
        places : (G,) integers
            Numbers of grains or contacts. Columns that `lmpchain export` names after them, such as
            force_10, are found by their names.
        options
            Options of `Traces`, and of `TraceFile`: columns, skip, time_scale, scale, offset or
            baseline, trigger, lowpass, every. If `offset` or `trigger` is True, it is fitted.

        Raises
        ------
        InputError
            If the file cannot be read, or if its columns are ambiguous.

        Examples
        --------
        >>> path = getfixture("tmp_path") / "scope.csv"
        >>> _ = path.write_text("t (us);CH1 (mV)\\n-0,5;10\\n0;10\\n0,5;30\\n")
        >>> traces = Traces.from_csv(path, [4], scale=2.0, baseline=(-1e-6, 0), trigger=0.0)
        >>> traces.time.tolist(), traces.values.round(9).tolist()
        ([0.0, 5e-07], [[0.0], [0.04]])
        """
        fitted = {key for key in ("offset", "trigger") if isinstance(options.get(key), bool)}
        of_file = {key: options.pop(key) for key in OF_FILES if key in options.keys() - fitted}
        field = options.get("field", "velocity")
        unit = FIELD_UNITS.get(field, "")
        quantities = [
            ColumnMeaning(f"{field}_{place}", unit, (f"change_{field}_{place}",))
            for place in np.atleast_1d(whole_numbers(places, "places"))
        ]
        reading = TraceFile(**of_file | {"file": path}).read(quantities)
        note(reading.text)
        return cls(reading.time, places, reading.values, **options)

    def grains(self, scene: Scene) -> list[int]:
        """Return the grains that the traces need; raise `InputError` if the chain lacks one."""
        grains = scene.chain.grains
        existing = np.arange(grains) + 1
        if self.field == "contact":
            existing = np.flatnonzero(scene.chain.contacts.exists)
        for place in self.places:
            if place not in existing:
                ends = f"{existing[0]} to {existing[-1]}"
                raise InputError.at("places", f"the chain has no {place}: use {ends}")
        offsets = {"force": (-1, 0, 1), "contact": (0, 1)}.get(self.field, (0,))
        near = {int(place) + offset for place in self.places for offset in offsets}
        return sorted(near & set(range(1, grains + 1)))

    def _columns(self) -> Iterator[NamedColumn]:
        yield NamedColumn("time", "s", self.time)
        yield from number_columns(self.field, FIELD_UNITS[self.field], self.places, self.values)


def model(
    scene: Scene,
    run: AnyRun | FixedRun,
    traces: Traces,
    change: Inputs | None,
    motion: tuple[Array, Array] | None,
) -> tuple[Array, Array]:
    """Return trace values of a run at all its times, (T, G), and their changes, (D, T, G).

    Parameters
    ----------
    change : Inputs, optional
        D changes of the inputs.
    motion : pair of (D, T, grains) arrays, optional
        Changes of the displacements and of the velocities due to these changes of the inputs.
    """
    view = Seen(scene, run.time, run.grains, run.displacement, run.velocity)
    if traces.field in ("velocity", "displacement"):
        columns = [view.column(int(place)) for place in traces.places]
        rates = np.empty((0, run.time.size, len(columns)))
        if motion is not None:
            rates = motion[int(traces.field == "velocity")][..., columns]
        return getattr(run, traces.field)[:, columns], rates
    count = 0 if change is None else len(change.masses)
    values = np.zeros((run.time.size, len(traces.places)))
    rates = np.zeros((count, *values.shape))
    rest = scene.chain.contacts.force
    for column, place in enumerate(traces.places):
        contacts = [place] if traces.field == "contact" else [place - 1, place]
        share = 1.0 / len(contacts)
        for contact in (int(number) for number in contacts if scene.chain.contacts.exists[number]):
            force = contact_force(view, contact)
            # A sensor inside a grain measures the mean force of its two contacts.
            values[:, column] += share * (force.value - rest[contact])
            if change is None or motion is None:
                continue
            rates[:, :, column] += share * np.outer(change.constants[:, contact], force.by_constant)
            rates[:, :, column] += share * np.outer(
                change.forces[:, contact], force.by_force - (rest[contact] > 0)
            )
            rates[:, :, column] += share * np.outer(
                change.viscosity[:, contact], force.by_viscosity
            )
            for grain in force.grains:
                closer, closing = (moved[..., view.column(grain)] for moved in motion)
                closed = force.by_closer * closer + force.by_closing * closing
                rates[:, :, column] += share * (1 if grain == contact else -1) * closed
    return values, rates
