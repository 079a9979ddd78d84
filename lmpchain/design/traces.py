"""Measured traces, and what a run says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ..errors import InputError, shown
from ..integrators.adjoint import DifferentiableRun, Inputs
from ..scene.scene import Scene
from ..util.arrays import Array
from .seen import Seen, contact_force

Field = Literal["velocity", "displacement", "force", "contact"]
LARGEST = 2**28  # bytes of a file


@dataclass(frozen=True, eq=False)
class Traces:
    """What was measured at the same times at some grains or contacts.

    Parameters
    ----------
    time : (T,) array
        Increasing, s.
    places : (G,) integers
        Numbers of grains, or of contacts: 0 at the top wall, N at the bottom one.
    values : (T, G) array
        m/s, m or N, velocity and displacement positive downward.
    field : "velocity", "displacement", "force" or "contact"
        A force is what a sensor in a grain shows above that at rest, the mean of its two contacts; a contact's is its
        own above that at rest.
    noise : float or (G,) array, optional
        Standard deviation, in the unit of the values; without it, what the fit leaves is taken for it.
    trigger, gain, offset : bool
        Whether the time of the strike, a factor of all values, and a constant added to each trace are not known.

    Raises
    ------
    InputError
        With every fault found.
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
        time, values = np.asarray(self.time, dtype=float), np.asarray(self.values, dtype=float)
        values = values[:, None] if values.ndim == 1 else values
        places = np.atleast_1d(np.asarray(self.places))
        faults = []
        if (
            time.ndim != 1
            or time.size < 2
            or not np.isfinite(time).all()
            or not (np.diff(time) > 0).all()
        ):
            faults.append(("time", "must be two or more increasing numbers"))
        if values.shape != (time.size, places.size):
            wanted = time.size, places.size
            faults.append(
                ("values", f"must be of shape {wanted}, times and places, not {values.shape}")
            )
        elif not np.isfinite(values).all():
            faults.append(
                (
                    "values",
                    f"must be finite: leave out the times of {(~np.isfinite(values)).sum()} that are not",
                )
            )
        if self.field not in get_args(Field):
            faults.append(
                ("field", f"must be one of {', '.join(get_args(Field))} (got {shown(self.field)})")
            )
        if self.noise is not None and not (np.asarray(self.noise) > 0).all():
            faults.append(("noise", f"must be above 0 (got {shown(self.noise)})"))
        if faults:
            raise InputError(faults)
        for name, value in (("time", time), ("values", values), ("places", places)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_csv(cls, path: str | PathLike[str], places: Sequence[int], **known: Any) -> Traces:
        """Read lines of time, s, and one value a place, as oscilloscopes write them; skip others.

        Raises
        ------
        InputError
            If the file cannot be read, or has no such table.
        """
        from ..util.files import check_readable

        columns, rows = len(places) + 1, []
        try:
            check_readable(Path(path), LARGEST)
            lines = Path(path).read_text(encoding="utf-8-sig", errors="replace").splitlines()
        except OSError as error:
            raise InputError([(str(path), error.strerror or "cannot be read")]) from error
        for line in lines:
            parts = line.replace(";", ",").replace("\t", ",").split(",")
            try:
                rows.append([float(part) for part in parts[:columns]])
            except ValueError:
                continue
        rows = [row for row in rows if len(row) == columns]
        if len(rows) < 2:
            raise InputError(
                [
                    (
                        str(path),
                        f"has not two lines of {columns} numbers, time and {columns - 1} values",
                    )
                ]
            )
        table = np.array(rows)
        return cls(table[:, 0], places, table[:, 1:], **known)

    def grains(self, scene: Scene) -> list[int]:
        """Return the grains that must be looked at; raises `InputError` if the chain has no such place."""
        least, most = (
            (0, scene.chain.grains) if self.field == "contact" else (1, scene.chain.grains)
        )
        exists = scene.chain.contacts.exists
        for place in self.places:
            if not least <= place <= most or (self.field == "contact" and not exists[place]):
                raise InputError([("places", f"the chain has no {place}: use {least} to {most}")])
        around = {"force": (-1, 0, 1), "contact": (0, 1)}.get(self.field, (0,))
        return sorted(
            {int(p) + k for p in self.places for k in around if 1 <= p + k <= scene.chain.grains}
        )


def model(
    scene: Scene,
    run: DifferentiableRun,
    traces: Traces,
    change: Inputs | None,
    moved: tuple[Array, Array] | None,
) -> tuple[Array, Array]:
    """Return what a run says of traces at all looks, (T, G), and its changes, (D, T, G)."""
    seen = Seen(scene, run.time, run.grains, run.displacement, run.velocity)
    columns = (
        [seen.column(int(place)) for place in traces.places]
        if traces.field in ("velocity", "displacement")
        else []
    )
    count = 0 if change is None else len(change.masses)
    if columns:
        which = int(traces.field == "velocity")
        rates = (
            np.empty((0, run.time.size, len(columns)))
            if moved is None
            else moved[which][..., columns]
        )
        return getattr(run, traces.field)[:, columns], rates
    values, rates = (
        np.zeros((run.time.size, len(traces.places))),
        np.zeros((count, run.time.size, len(traces.places))),
    )
    carried = scene.chain.contacts.force
    for column, place in enumerate(traces.places):
        both = [place] if traces.field == "contact" else [place - 1, place]
        for contact in (int(c) for c in both if scene.chain.contacts.exists[c]):
            share = 1.0 / len(both)
            force, stiffness, by_force, by_constant, ends = contact_force(seen, contact)
            values[:, column] += share * (force - carried[contact])
            if change is None or moved is None:
                continue
            rates[:, :, column] += share * np.outer(change.constants[:, contact], by_constant)
            rates[:, :, column] += share * np.outer(
                change.forces[:, contact], by_force - (carried[contact] > 0)
            )
            for grain in ends:
                closer = moved[0][..., seen.column(grain)] * (1 if grain == contact else -1)
                rates[:, :, column] += share * stiffness * closer
    return values, rates
