"""Gathering along one realisation: largest values and fronts of grains, forces of contacts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.recording import OF_CONTACTS
from ..scene.scene import Scene
from ..trajectory.between.derivatives import STILL, Block, by_body, derive, imposed_on, law_of
from ..trajectory.between.fronts import Rules, arrivals
from ..trajectory.between.maxima import Largest, Log, Window, approach, events_of, reduce
from ..util.arrays import EPSILON, Array

FRACTION = 0.5  # of the largest speed of a grain, that its front has at least
ROUNDED = 4  # last digits of a force that its power may cost
PEAK, TRACE = OF_CONTACTS


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
            "latest": events_of(np.zeros(size if fronts else 0)),
            "log": events_of(np.zeros(0)),
            "closest": np.full((self._numbers.size, 3), -np.inf),
            "trace": np.zeros((self._traced.size, part.samples if self._traced.size else 0)),
            "largest": np.zeros(2),
            "before": np.zeros((2, 0, size)),
            "interval": np.zeros((), dtype=np.int64),
            "start": np.zeros(size if fronts else 0),
        }
        self._kept: dict[str, Any] = {
            name: np.array(kept.get(name, values)) for name, values in new.items()
        }
        grows = ("log", "before")
        if any(self._kept[name].shape != new[name].shape for name in new if name not in grows):
            raise ValueError("the state that was kept does not fit")
        self._law = law_of(chain, linear)
        self._column = np.arange(-1, size + 1)
        self._column[-1] = STILL

    def take(self, first: int, u: Array, v: Array) -> None:
        """Take in the samples of a block, (B, N) each, which begin with sample number `first`."""
        kept, count = self._kept, len(u)
        if not count:
            return
        if first == 0 and kept["start"].size:
            kept["start"][:] = np.abs(v[0])
            kept["latest"] = events_of(v[0])
        before = kept["before"]
        base, last = first - before.shape[1], first + count - 1
        rows_u, rows_v = (np.concatenate(both) for both in zip(before, (u, v), strict=True))
        imposed = imposed_on(self._part, self._step, base, len(rows_u))
        begin, end = int(kept["interval"]), self._final if last == self._final else max(last - 1, 0)
        if begin < end:
            known = np.ones(self._column.size, dtype=bool)
            block = Block(
                by_body(rows_u), by_body(rows_v), self._column, known, self._step, self._law,
                imposed,
            )  # fmt: skip
            window = Window(base, begin - base, end - base)
            grains = np.arange(1, u.shape[1] + 1)
            derived = derive(block, grains)
            log = reduce(
                block, grains, derived, np.zeros((1, 0)), window,
                (Largest(*kept["far"]), Largest(*kept["fast"])),
                kept["latest"], Log(kept["log"], len(kept["log"])),
            )  # fmt: skip
            for number, closest in zip(self._numbers.tolist(), kept["closest"], strict=True):
                rows = (number - 1, number if number < len(grains) else -1)
                approach(
                    block, number, derived, rows, np.zeros(0), window, Largest(*closest[:, None])
                )
            kept["log"], kept["interval"] = log.events[: log.used].copy(), np.array(end)
        kept["before"] = np.array([rows_u[-3:], rows_v[-3:]])
        kept["largest"] = np.maximum(kept["largest"], [np.abs(u).max(), np.abs(v).max()])
        for row, number in zip(kept["trace"], self._traced, strict=True):
            row[first : last + 1] = self._closer(
                rows_u[-count:], imposed.wall[0, -count:], int(number)
            )

    @staticmethod
    def _closer(u: Array, wall: Array, number: int) -> Array:
        """Return by how much a contact is closer than at rest, (B,) m."""
        above = u[:, number - 1] if number else wall
        return above - (u[:, number] if number < u.shape[1] else 0.0)

    def state(self) -> dict[str, Array]:
        """Return what is needed to go on with the same bits."""
        return {name: values.copy() for name, values in self._kept.items()}

    def found(self, error: float) -> dict[str, Array]:
        """Return what was gathered, by name, and its errors, for a relative error of the answer."""
        part, kept, found = self._part, self._kept, dict[str, Array]()
        more = 1 / math.cos(part.highest_frequency * self._step / 2)
        known = error * np.maximum(more * kept["largest"], part.imposed)
        values = {
            "peak_displacement": Largest(*kept["far"]).estimate(known[0]),
            "peak_velocity": Largest(*kept["fast"]).estimate(known[1]),
        }
        for name in self._scene.quantities:
            if name in values:
                found[name], found[f"{name}_error"] = self._of_recorded(*values[name], at_rest=0.0)
            elif name == "arrival_time":
                found[name], found[f"{name}_error"] = self._of_recorded(
                    *self._arrivals(known[1]), at_rest=np.nan
                )
        for name, number in self._scene.contacts.items():
            kind = name.partition(":")[0]
            row = np.flatnonzero(self._contacts[kind][self._inside[kind]] == number)
            if kind == PEAK:
                closest = Largest(*kept["closest"][row].T if row.size else np.zeros((3, 1)))
                closer, off = closest.estimate(2 * known[0] * bool(row.size))
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
        """Return forces of contacts and their errors, N, from approaches beyond that at rest, m."""
        contact = self._scene.chain.contacts.of(np.array([number]))
        less, force, most = (
            contact.force_at(contact.overlap + r) for r in (closer - off, closer, closer + off)
        )
        return force, np.maximum(most - force, force - less) + ROUNDED * EPSILON * force

    def _arrivals(self, known: float) -> Array:
        """Return when the front passes each grain of the part, and the error of that, (2, N) s."""
        kept, part = self._kept, self._part
        events = np.concatenate([kept["log"], kept["latest"]])
        events = events[np.argsort(events["grain"], kind="stable")]
        bounds = np.searchsorted(events["grain"], np.arange(part.chain.grains + 1))
        rules = Rules(FRACTION, known, known, part.highest_frequency, self._step, part.duration)
        found: Array = arrivals(events, bounds, Largest(*kept["fast"]), kept["start"], rules)
        return found


def _numbers(scene: Scene, kind: str) -> NDArray[np.intp]:
    """Return the contacts of which this is gathered, in the order in which they are asked for."""
    return np.array(
        [number for name, number in scene.contacts.items() if name.partition(":")[0] == kind],
        dtype=int,
    )
