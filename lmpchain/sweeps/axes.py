"""The axes of a sweep: grid, list of cases, Latin hypercube, realisations of disorder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..scene.toml_file import SECTIONS
from ..util.suggestions import did_you_mean
from ..util.validation import Checked, Real, Whole

MOST = 10**6  # scenes in a sweep
Count = Annotated[Whole, Field(ge=1, le=MOST)]
Seed = Annotated[Whole, Field(ge=0)]
INDEX = "disorder.index"


class Range(Checked):
    """Between what numbers a key is drawn: evenly, or with its logarithm even."""

    low: Real
    high: Real
    log: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.low >= self.high:
            yield "high", f"must be above low, {self.low:g} (got {self.high:g})"
        if self.log and self.low <= 0:
            yield "low", f"must be above 0 where log is true (got {self.low:g})"

    def at(self, part: np.ndarray) -> list[float]:
        """Return the numbers that lie at these parts of the range, 0 to 1."""
        if self.log:
            return np.exp(math.log(self.low) + part * math.log(self.high / self.low)).tolist()
        return (self.low + part * (self.high - self.low)).tolist()


class Draws(Checked):
    """How many points of a Latin hypercube, and which."""

    draws: Count
    seed: Seed


class Realisations(Checked):
    """How many disordered chains."""

    realisations: Count


@dataclass(frozen=True)
class Axis:
    """One dimension of a sweep: its name, and the values that each of its keys takes along it."""

    name: str
    columns: Mapping[str, list[Any]]
    drawn: bool = False  # so that no single value is the user's to correct

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def coordinates(self) -> dict[str, list[Any]]:
        """Return what the places along the axis are called, by name of the coordinate."""
        columns: dict[str, list[Any]] = {} if self.name in self.columns else {self.name: list(range(len(self)))}
        for key, values in self.columns.items():
            numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
            if key != INDEX:
                columns[key] = values if numbers else [_label(value) for value in values]
        return columns


def _label(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)


def axes(parts: Mapping[str, Any]) -> list[Axis]:
    """Return the axes that these tables of a sweep file stand for; the values themselves are not checked.

    Raises
    ------
    InputError
        With every fault found.
    """
    faults: list[tuple[str, str]] = []
    made: list[Axis] = []
    for part, table in parts.items():
        try:
            if not isinstance(table, dict):
                raise InputError([("", f"must be a table, [{part}]")])
            made += MAKERS[part](table)
        except InputError as error:
            faults += error.under(part)
    sections = (*SECTIONS, *(["disorder"] if "disorder" in parts else []))
    keys = [key for axis in made for key in axis.columns]
    for place, key in enumerate(keys):
        if key.partition(".")[0] not in sections:
            meant = did_you_mean(key.partition(".")[0], sections)
            there = f"they begin with {', '.join(sections)}, as chain.gravity does"
            faults.append((key, f"is no key of a scene{meant}; {there}"))
        for other in keys[:place]:
            if f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}."):
                faults.append((key, "is swept twice" if key == other else f"overlaps {other}: sweep one of them"))
    if (count := math.prod(len(axis) for axis in made)) > MOST:
        faults.append(("grid", f"these are {count} scenes; sweep {MOST} at most"))
    if not made and not faults:
        faults.append(("grid", f"nothing is swept: add a table {', '.join(f'[{part}]' for part in MAKERS)}"))
    if faults:
        raise InputError(faults)
    return made


def _grid(table: dict[str, Any]) -> list[Axis]:
    return [Axis(key, {key: values}) for key, values in _lists(table).items()]


def _list(table: dict[str, Any]) -> list[Axis]:
    made = _lists(table)
    first, *others = made
    count = len(made[first])
    if unlike := [key for key in others if len(made[key]) != count]:
        raise InputError(
            [(key, f"must have as many values as {first}, {count}, not {len(made[key])}") for key in unlike]
        )
    return [Axis("case", made)]


def _lists(table: dict[str, Any]) -> dict[str, list[Any]]:
    made = {key: list(value) if isinstance(value, tuple | np.ndarray) else value for key, value in _leaves(table)}
    faults = [
        (key, "must be a list of values, and not empty") for key, v in made.items() if not isinstance(v, list) or not v
    ]
    if faults or not made:
        raise InputError(faults or [("", "is empty: name a key, such as chain.gravity = [1.62, 9.81]")])
    return {key: [v.item() if isinstance(v, np.generic) else v for v in values] for key, values in made.items()}


def _random(table: dict[str, Any]) -> list[Axis]:
    from scipy.stats import qmc

    faults: list[tuple[str, str]] = []
    ranges: dict[str, Range] = {}
    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    try:
        asked = Draws(**{key: value for key, value in table.items() if key not in tables})
    except InputError as error:
        faults += error.faults
    for key, value in _leaves(tables):
        try:
            if not isinstance(value, dict):
                raise InputError([("", "must be a range, such as {low = 1.0, high = 10.0}")])
            ranges[key] = Range(**value)
        except InputError as error:
            faults += error.under(key)
    if faults or not ranges:
        raise InputError(faults or [("", "name a key, such as chain.gravity = {low = 1.0, high = 10.0}")])
    parts = qmc.LatinHypercube(len(ranges), seed=np.random.default_rng(asked.seed)).random(asked.draws)
    made = {key: value.at(part) for (key, value), part in zip(ranges.items(), parts.T, strict=True)}
    return [Axis("draw", made, drawn=True)]


def _disorder(table: dict[str, Any]) -> list[Axis]:
    count = Realisations(**{key: value for key, value in table.items() if key == "realisations"}).realisations
    return [Axis("realisation", {INDEX: list(range(count))}, drawn=True)]


MAKERS = {"grid": _grid, "list": _list, "random": _random, "disorder": _disorder}


def _leaves(table: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and their values; ranges are values."""
    for key, value in table.items():
        if isinstance(value, dict) and not value.keys() & {"low", "high"}:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
