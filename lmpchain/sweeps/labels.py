"""What the results of a sweep are labelled by, where scenes may differ in what they record."""

from __future__ import annotations

import itertools
import json
import warnings
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..chain.chain import Chain
from ..errors import InputError
from ..scene.recording import Recording
from ..util.arrays import Array
from .axes import Axis
from .file import Place, Sweep
from .laws import ARRAYS
from .store import Column

SHAPING = ("chain.grains", "chain.file", "recording")  # keys that what is recorded follows from


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
    extra: dict[str, Column]


def labels(plan: Sweep) -> Labels:
    """Return the labels of a sweep; scenes that cannot be made have none."""
    swept = [range(len(axis)) if _shapes(axis) else range(1) for axis in plan.axes]
    kinds = set()
    for place in itertools.product(*swept):
        with suppress(InputError), warnings.catch_warnings(action="ignore"):  # said of the trials
            kinds.add(_kind(plan, place))
    times = {(samples, duration) for samples, duration, _, _ in kinds}
    numbers = {recorded for _, _, recorded, _ in kinds}
    samples = max(count for count, _ in times)
    grains = np.array(next(iter(numbers)) if len(numbers) == 1 else sorted(set().union(*numbers)))
    longest = max(size for _, _, _, size in kinds)
    extra = {}
    if len(times) > 1:
        extra["time"] = Column(("sample",), (samples,), "s", "time since the strike")
    for axis in plan.axes:
        for each in axis.arrays:
            about = f"drawn for every {'contact' if ARRAYS[each.key] else 'grain'}"
            extra[each.key] = Column(
                (f"{each.key}.entry",), (longest - ARRAYS[each.key],), "1", about
            )
    return Labels(
        samples,
        np.linspace(0.0, times.pop()[1], samples) if len(times) == 1 else None,
        grains,
        extra,
    )


def recorded(plan: Sweep, place: Place, size: int) -> np.ndarray:
    """Return the grains that a scene records, (G,); `size` is how many it has."""
    shaping = tuple(
        index if _shapes(axis) else 0 for axis, index in zip(plan.axes, place, strict=True)
    )
    if (shaping, size) not in plan.recorded:
        plan.recorded[shaping, size] = _recorded(
            json.dumps(plan.asked(place).get("recording")), size
        )[1]
    return plan.recorded[shaping, size]


def _shapes(axis: Axis) -> bool:
    return any(key == "chain" or key.startswith(SHAPING) for key in axis.columns)


def _kind(plan: Sweep, place: Place) -> tuple[int, float, tuple[int, ...], int]:
    """Return samples, duration and grains of what a scene records, and how many grains it has."""
    tables: dict[str, Any] = plan.asked(place)
    size = plan.scene(place).chain.grains if "file" in tables["chain"] else plan.grains(place)
    what, numbers = _recorded(json.dumps(tables.get("recording")), size)
    return what.samples, what.duration, tuple(numbers.tolist()), size


@lru_cache(maxsize=64)
def _recorded(table: str, size: int) -> tuple[Recording, np.ndarray]:
    """Return what a table asks to record, and the numbers of the grains of a chain of this size."""
    what = Recording(
        **{key: value for key, value in json.loads(table).items() if key != "quantities"}
    )
    chain = Chain(grains=size, diameter=1e-3, gravity=0.0, bottom="wall")
    if faults := list(what.faults(chain)):
        raise InputError(faults)
    return what, what.numbers(chain)
