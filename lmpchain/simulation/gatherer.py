"""What is gathered of one realisation: the largest values and fronts of grains, forces of contacts."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.recording import OF_CONTACTS
from ..scene.scene import Scene
from ..trajectory.between import gathering as kernel
from ..trajectory.between.derivatives import KINK
from ..trajectory.between.hermite import FLAT
from ..util.arrays import EPSILON, Array

FRACTION = (
    0.5  # of the largest speed of a grain that the front has at least, as in measure.front.track
)
DROPPED = (
    0.8  # of that: a maximum that is below this is no front, whatever the error of a useful answer
)
ROUNDED = 4  # last digits of a force that its power may cost
PEAK, TRACE = OF_CONTACTS
KEPT = (
    "fast",
    "far",
    "record",
    "log",
    "closest",
    "trace",
    "largest",
    "before",
    "interval",
    "start",
)


class Gatherer:
    """What is gathered of one realisation, block by block.

    Parameters
    ----------
    scene : Scene
        As it was asked for.
    part : Scene
        What is computed of it, at fine times.
    first : int
        Grains of the scene above those of the part.
    linear : bool
        Whether its forces are those of the linearised chain.
    kept : mapping
        Empty, or what `state` returned.
    """

    def __init__(
        self, scene: Scene, part: Scene, first: int, linear: bool, kept: Mapping[str, Array]
    ):
        self._scene, self._part, self._first = scene, part, first
        self._final, self._step = part.samples - 1, part.duration / (part.samples - 1)
        chain, asked = part.chain, scene.quantities
        size = chain.grains
        self._contacts = {kind: _numbers(scene, kind) for kind in OF_CONTACTS}
        places = {kind: numbers - first for kind, numbers in self._contacts.items()}
        self._inside = {
            kind: (numbers >= 0) & (numbers <= size) for kind, numbers in places.items()
        }
        self._numbers = places[PEAK][self._inside[PEAK]]
        self._traced = places[TRACE][self._inside[TRACE]]
        fronts = "arrival_time" in asked
        new = {
            "fast": np.zeros((3, size if fronts or "peak_velocity" in asked else 0)),
            "far": np.zeros((3, size if "peak_displacement" in asked else 0)),
            "record": np.zeros((kernel.ROWS, size if fronts else 0)),
            "log": np.zeros((0, 1 + kernel.ROWS)),
            "closest": np.zeros((3, self._numbers.size)),
            "trace": np.zeros((self._traced.size, part.samples if self._traced.size else 0)),
            "largest": np.zeros(2),
            "before": np.zeros((2, 0, size)),
            "interval": np.zeros((), dtype=np.int64),
            "start": np.zeros(size if fronts else 0),
        }
        self._kept: dict[str, Any] = {
            name: np.array(kept.get(name, values)) for name, values in new.items()
        }
        if any(
            self._kept[name].shape != new[name].shape
            for name in KEPT
            if name not in ("log", "before")
        ):
            raise ValueError("the state that was kept does not fit")
        contacts, inverse_mass = chain.contacts, 1 / chain.masses
        inverse_mass[chain.movable :] = 0.0
        loose = np.where(linear & (chain.exponent > 1.0), 0.0, contacts.constant)
        pressed = contacts.pressed
        length = 1 / np.where(pressed, contacts.overlap, 1.0)
        self._law = (
            np.array([length, np.where(pressed, contacts.force, loose), pressed]),
            inverse_mass,
        )
        self._force = chain.exponent, linear

    def take(self, first: int, u: Array, v: Array) -> None:
        """Take in the samples of a block, (B, N) each, of which `first` is the number of the first."""
        kept, count = self._kept, len(u)
        if not count:
            return
        if first == 0:
            self._begin(u[0], v[0])
        before = kept["before"]
        base, last = first - before.shape[1], first + count - 1
        rows_u, rows_v = (np.concatenate(both) for both in zip(before, (u, v), strict=True))
        begin, end = int(kept["interval"]), self._final if last == self._final else max(last - 1, 0)
        forces = self._forces(base, len(rows_u))
        log = np.concatenate([kept["log"], np.empty((64, 1 + kernel.ROWS))])
        logged = len(kept["log"])
        while begin < end:
            made, logged = kernel.gather(
                rows_u, rows_v, base, begin, end, self._final, self._step, forces, kept["far"], kept["fast"],
                kept["record"], log, logged, self._numbers, kept["closest"],
            )  # fmt: skip
            begin += made
            if begin < end:
                left = self._fronts(log[:logged])
                logged = len(left)
                log = np.concatenate(
                    [left, np.empty((logged + (kernel.PARTS + 1) * u.shape[1], 1 + kernel.ROWS))]
                )
        kept["log"], kept["interval"] = log[:logged].copy(), np.array(begin)
        kept["before"] = np.array([rows_u[-3:], rows_v[-3:]])
        kept["largest"] = np.maximum(kept["largest"], [np.abs(u).max(), np.abs(v).max()])
        for row, number in zip(kept["trace"], self._traced, strict=True):
            row[first : last + 1] = self._closer(
                rows_u[-count:], forces.wall[0, -count:], int(number)
            )

    def _begin(self, u: Array, v: Array) -> None:
        """Start from the motion at t = 0."""
        kept = self._kept
        for name, field in (("fast", v), ("far", u)):
            kept[name][:] = np.abs(field)[: kept[name].shape[1]]
        if kept["start"].size:
            kept["start"][:] = np.abs(v)
            kept["record"][[kernel.TOP, kernel.SINCE]] = np.abs(v)
        wall = self._forces(0, 1).wall[0]
        kept["closest"][:] = [
            float(self._closer(u[None], wall, int(number))[0]) for number in self._numbers
        ]

    @staticmethod
    def _closer(u: Array, wall: Array, number: int) -> Array:
        """Return by how much a contact is closer than at rest, (B,) m."""
        above = u[:, number - 1] if number else wall
        return above - (u[:, number] if number < u.shape[1] else 0.0)

    def _forces(self, base: int, count: int) -> kernel.Forces:
        """Return what acts at so many samples."""
        excitation, chain = self._part.excitation, self._part.chain
        wall, given, pushed, driven = np.zeros((4, count)), np.zeros((3, count)), -1, False
        if wave := excitation.waveform:
            time: Array = self._step * np.arange(base, base + count, dtype=float)
            if excitation.wall:
                wall[:] = [wave.at(time, order) for order in range(4)]
                imposed = wall[2:]
            else:
                driven, pushed = bool(excitation.driven), excitation.reach(chain)[0] - 1
                order, share = (2, 1.0) if driven else (0, 1 / chain.masses[pushed])
                given[:2] = share * wave.at(time, order), share * wave.at(time, order + 1)
                imposed = given[:2]
            corner = np.diff(np.searchsorted(wave.corners, time, side="right")) > 0
            jump, kink = np.abs(np.diff(imposed))
            given[2, :-1] = np.where(
                corner, KINK * self._step * kink + (0.0 if wave.spline else jump), 0.0
            )
        return kernel.Forces(*self._law, *self._force, wall, given, pushed, driven)

    def _fronts(self, log: Array) -> Array:
        """Return those logged maxima that may be a front."""
        least = DROPPED * FRACTION * self._kept["fast"][kernel.LOW]
        return log[log[:, 1 + kernel.TOP] >= least[log[:, 0].astype(int)]]

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        return {name: values.copy() for name, values in self._kept.items()}

    def found(self, error: float) -> dict[str, Array]:
        """Return what was gathered, by name, and its errors, for a relative error of the answer."""
        part, kept, found = self._part, self._kept, dict[str, Array]()
        more = 1 / math.cos(part.highest_frequency * self._step / 2)
        known = error * np.maximum(more * kept["largest"], part.imposed)
        values = {
            "peak_displacement": (kept["far"], known[0]),
            "peak_velocity": (kept["fast"], known[1]),
        }
        for name in self._scene.quantities:
            if name in values:
                found[name], found[f"{name}_error"] = self._of_recorded(
                    *_within(*values[name]), at_rest=0.0
                )
            elif name == "arrival_time":
                found[name], found[f"{name}_error"] = self._of_recorded(
                    *self._arrivals(known[1]), at_rest=np.nan
                )
        for name, number in self._scene.contacts.items():
            kind = name.partition(":")[0]
            row = np.flatnonzero(self._contacts[kind][self._inside[kind]] == number)
            if kind == PEAK:
                closer, off = (
                    _within(kept["closest"][:, row], 2 * known[0]) if row.size else np.zeros((2, 1))
                )
                found[name], found[f"{name}_error"] = (
                    values[0] for values in self._pushes(number, closer, off)
                )
            else:
                closer = kept["trace"][row[0]] if row.size else np.zeros(part.samples)
                found[name], found[f"{name}_error"] = self._pushes(
                    number, closer, 2 * known[0] * bool(row.size)
                )
                found["fine_time"] = part.time
        return found

    def _of_recorded(self, *fields: Array, at_rest: float) -> Array:
        """Return fields of the grains of the part, (N,) each, as those of all recorded grains."""
        every = np.full((len(fields), self._scene.chain.grains), at_rest)
        every[:, self._first : self._first + self._part.chain.grains] = fields
        return every[:, self._scene.recorded - 1]

    def _pushes(self, number: int, closer: Array, off: Array | float) -> tuple[Array, Array]:
        """Return forces of a contact that is closer than at rest by this, m, and their errors, N."""
        contact = self._scene.chain.contacts.of(np.array([number]))
        less, force, most = (
            contact.force_at(contact.overlap + r) for r in (closer - off, closer, closer + off)
        )
        return force, np.maximum(most - force, force - less) + ROUNDED * EPSILON * force

    def _arrivals(self, known: float) -> tuple[Array, Array]:
        """Return when the front passes each grain of the part, (N,) s, and how far off that may be."""
        kept, size = self._kept, self._part.chain.grains
        value, low, high = _bounds(kept["fast"])
        last = np.column_stack([np.arange(size), kept["record"].T])
        every = np.concatenate([self._fronts(kept["log"]), last])
        every = every[np.lexsort((every[:, 1 + kernel.WHEN], every[:, 0]))]
        grain, when, top, off, tilt, bend, since, until = every.T
        of = grain.astype(int)

        def first(level: Array, fall: Array | float) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
            """Return of every grain whether there is a maximum of this size, and which is the first."""
            there = np.flatnonzero((top >= level[of]) & (top - since > fall))
            grains, place = np.unique(of[there], return_index=True)
            some, which = np.zeros(size, dtype=bool), np.zeros(size, dtype=int)
            some[grains], which[grains] = True, there[place]
            return some, which

        seen, which = first(
            FRACTION * value, known + off
        )  # else a polynomial may turn where nothing does
        seen &= (value > known) & (value >= sys.float_info.min) & (kept["start"] < FRACTION * value)
        time, about = when[which], off[which] + known
        swift, step = self._part.highest_frequency * known, self._step
        with np.errstate(divide="ignore", invalid="ignore"):
            # where a grain flies freely, or nearly so, it is of that size for long
            flat = np.maximum(until - when, step) + swift * step**2 / (FLAT * top)
            spread = np.where(
                bend > 0.0, (tilt + swift) / bend, np.minimum(flat, self._part.duration)
            )
        # which other maxima it may be, if values are off by their errors
        sooner, one = first(FRACTION * (low - known) - about, 0.0)
        surely, other = first(FRACTION * (high + known) + about, known + 2 * about[of])
        early, late = (np.abs(when[each] - time) + spread[each] for each in (one, other))
        late = np.where(surely, late, self._part.duration - time)
        late = np.maximum(np.maximum(spread[which], late), np.where(sooner, early, 0.0))
        return np.where(seen, time, np.nan), np.where(seen, late, np.nan)


def _numbers(scene: Scene, kind: str) -> NDArray[np.intp]:
    """Return the contacts of which this is gathered, in the order in which they are asked for."""
    return np.array(
        [number for name, number in scene.contacts.items() if name.partition(":")[0] == kind],
        dtype=int,
    )


def _bounds(tops: Array) -> tuple[Array, Array, Array]:
    """Return the largest values, and between what they lie, (N,) each."""
    value = np.maximum(tops[kernel.BEST], tops[kernel.LOW])
    return value, tops[kernel.LOW], np.maximum(tops[kernel.HIGH], value)


def _within(tops: Array, known: float) -> tuple[Array, Array]:
    """Return the largest values and their errors."""
    value, low, high = _bounds(tops)
    return value, np.maximum(high - value, value - low) + known
