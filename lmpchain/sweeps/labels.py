"""Labels of the results of a sweep, whose scenes may record different samples and grains."""

from __future__ import annotations

import itertools
import json
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.recording import Recording
from ..util.arrays import Array
from ..util.remarks import warnings_aside
from .file import Place, Sweep
from .store import StoredArray

# Keys that determine the grains and times that a scene records.
SHAPING = ("chain.grains", "chain.file", "recording")


class Labels(NamedTuple):
    """Samples and grains that the arrays have places for.

    Attributes
    ----------
    samples : int
        The most of any scene.
    time : (T,) array or None
        s; None if scenes differ in them.
    grains : (G,) array
        Numbers of the grains that any scene records; in the order of the scenes if that is one
        order.
    extra : dict
        Further arrays of the store: times that differ, and what is drawn for every grain.
    """

    samples: int
    time: Array | None
    grains: np.ndarray
    extra: dict[str, StoredArray]


def make_labels(plan: Sweep) -> Labels:
    """Return the labels of a sweep; invalid scenes contribute none."""
    # Along the other axes all scenes record the same, so the first one represents them.
    lengths = [
        len(axis) if any(key == "chain" or key.startswith(SHAPING) for key in axis.columns) else 1
        for axis in plan.axes
    ]
    shapes = set()
    for position in itertools.product(*map(range, lengths)):
        # The trial scenes already gave these warnings.
        with suppress(InputError), warnings_aside():
            shapes.add(_find_shape(plan, position))
    times = {(shape.samples, shape.duration) for shape in shapes}
    recordings = {shape.recorded for shape in shapes}
    samples = max(shape.samples for shape in shapes)
    longest = max(shape.grains for shape in shapes)
    extra = {}
    time = None
    if len(times) == 1:
        time = np.linspace(0.0, times.pop()[1], samples)
    else:
        extra["time"] = StoredArray(("sample",), (samples,), "s", "time since the strike")
    for axis in plan.axes:
        for law in axis.arrays:
            name = f"drawn for every {'contact' if law.of_contacts else 'grain'}"
            length = longest - law.of_contacts
            extra[law.key] = StoredArray((f"{law.key}.entry",), (length,), "1", name)
    grains = recordings.pop() if len(recordings) == 1 else sorted(set().union(*recordings))
    return Labels(samples, time, np.array(grains), extra)


def find_recorded(plan: Sweep, position: Place, size: int) -> np.ndarray:
    """Return the grains that a scene records in a chain of this size, (G,)."""
    return _read_recording(json.dumps(plan.tables_at(position).get("recording")), size)[1]


class _Shape(NamedTuple):
    """Samples, duration (s) and grain numbers that a scene records, and the size of its chain."""

    samples: int
    duration: float
    recorded: tuple[int, ...]
    grains: int


def _find_shape(plan: Sweep, position: Place) -> _Shape:
    tables: dict[str, Any] = plan.tables_at(position)
    size = plan.scene(position).chain.grains if "file" in tables["chain"] else plan.grains(position)
    recording, numbers = _read_recording(json.dumps(tables.get("recording")), size)
    return _Shape(recording.samples, recording.duration, tuple(numbers.tolist()), size)


@lru_cache(maxsize=64)
def _read_recording(table: str, size: int) -> tuple[Recording, np.ndarray]:
    """Return the recording that a table requests, and its grains in a chain of this size."""
    options = json.loads(table)
    options.pop("quantities", None)
    recording = Recording(**options)
    chain = Chain(grains=size, diameter=1e-3, gravity=0.0, bottom="wall")
    if faults := list(recording.faults(chain)):
        raise InputError(faults)
    return recording, recording.numbers(chain)
