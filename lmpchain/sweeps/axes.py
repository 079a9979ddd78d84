"""The axes of a sweep: grid, list of cases, Latin hypercube, realisations of disorder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import Field

from ..errors import InputError
from ..scene.toml_file import SECTIONS
from ..util.arrays import Array
from ..util.suggestions import did_you_mean
from ..util.validation import Checked, Whole
from .laws import ALWAYS, MARKS, Drawn, Normal, Uniform, drawn, law

MOST = 10**6  # scenes in a sweep
Count = Annotated[Whole, Field(ge=1, le=MOST)]
Seed = Annotated[Whole, Field(ge=0)]
INDEX = "disorder.index"
T = TypeVar("T")


class Draws(Checked):
    """How many points of a Latin hypercube, and which."""

    draws: Count
    seed: Seed


class Seeded(Checked):
    """Which of all sequences of random numbers."""

    seed: Seed


class Realisations(Checked):
    """How many disordered chains."""

    realisations: Count


@dataclass(frozen=True)
class Axis:
    """One dimension of a sweep.

    Attributes
    ----------
    name : str
    length : int
    columns : mapping
        The values that each key takes along it.
    drawn : bool
        Whether values are drawn, so that no single one is the user's to correct.
    arrays : tuple of Drawn
        Keys of which every grain gets a number of its own.
    """

    name: str
    length: int
    columns: Mapping[str, Sequence[Any]]
    drawn: bool = False
    arrays: tuple[Drawn, ...] = ()

    def __len__(self) -> int:
        return self.length

    def coordinates(self) -> dict[str, Array | list[str]]:
        """Return what the places along the axis are called, by name of the coordinate: (L,) or (L, E) each."""
        columns: dict[str, Any] = (
            {} if self.name in self.columns else {self.name: np.arange(self.length)}
        )
        for key, values in self.columns.items():
            if key != INDEX:
                columns[key] = (
                    _numbers(values) if _numeric(values) else [_label(value) for value in values]
                )
        return columns


def _numeric(values: Sequence[Any]) -> bool:
    """Say whether these are numbers, or lists of numbers."""
    kinds = {type(value) for value in values}
    if kinds == {list}:
        return all(map(_numeric, values))
    return kinds <= {int, float} and bool(kinds)


def _numbers(values: Sequence[Any]) -> Array:
    """Return numbers as an array, lists of them as its rows, filled up with NaN."""
    if not isinstance(values[0], list):
        return np.array(values)
    rows = np.full((len(values), max(map(len, values))), np.nan)
    for row, value in zip(rows, values, strict=True):
        row[: len(value)] = value
    return rows


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
                raise InputError.at("", f"must be a table, [{part}]")
            made += MAKERS[part](table)
        except InputError as error:
            faults += error.under(part)
    if any(key.startswith("disorder.") for axis in made for key in axis.columns):
        made = [_indexed(axis) if axis.name == "realisation" else axis for axis in made]
    sections = (*SECTIONS, *(["disorder"] if "disorder" in parts else []))
    keys = [key for axis in made for key in (*axis.columns, *(each.key for each in axis.arrays))]
    for place, key in enumerate(keys):
        if key.partition(".")[0] not in sections:
            meant = did_you_mean(key.partition(".")[0], sections)
            there = f"they begin with {', '.join(sections)}, as chain.gravity does"
            faults.append((key, f"is no key of a scene{meant}; {there}"))
        for other in keys[:place]:
            if f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}."):
                faults.append(
                    (
                        key,
                        "is swept twice"
                        if key == other
                        else f"overlaps {other}: sweep one of them",
                    )
                )
    if (count := math.prod(len(axis) for axis in made)) > MOST:
        faults.append(("grid", f"these are {count} scenes; sweep {MOST} at most"))
    if not made and not faults:
        faults.append(
            ("grid", f"nothing is swept: add a table {', '.join(f'[{part}]' for part in MAKERS)}")
        )
    if faults:
        raise InputError(faults)
    return made


def _grid(table: dict[str, Any]) -> list[Axis]:
    return [Axis(key, len(values), {key: values}) for key, values in _lists(table).items()]


def _list(table: dict[str, Any]) -> list[Axis]:
    made = _lists(table)
    first, *others = made
    count = len(made[first])
    if unlike := [key for key in others if len(made[key]) != count]:
        raise InputError(
            [
                (key, f"must have as many values as {first}, {count}, not {len(made[key])}")
                for key in unlike
            ]
        )
    return [Axis("case", count, made)]


def _lists(table: dict[str, Any]) -> dict[str, list[Any]]:
    made = {
        key: list(value) if isinstance(value, tuple | np.ndarray) else value
        for key, value in _leaves(table)
    }
    faults = [
        (key, "must be a list of values, and not empty")
        for key, v in made.items()
        if not isinstance(v, list) or not v
    ]
    if faults or not made:
        raise InputError(
            faults or [("", "is empty: name a key, such as chain.gravity = [1.62, 9.81]")]
        )
    return {
        key: [v.item() if isinstance(v, np.generic) else v for v in values]
        for key, values in made.items()
    }


def _random(table: dict[str, Any]) -> list[Axis]:
    from scipy.stats import qmc

    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    asked, laws = _checked(
        Draws, {key: value for key, value in table.items() if key not in tables}, tables
    )
    if not laws:
        raise InputError.at("", "name a key, such as chain.gravity = {low = 1.0, high = 10.0}")
    by_grain = {key: each for key, each in laws.items() if each.per_grain or key in ALWAYS}
    ranges = {key: each for key, each in laws.items() if key not in by_grain}
    made = {}
    if ranges:
        parts = qmc.LatinHypercube(len(ranges), seed=np.random.default_rng(asked.seed)).random(
            asked.draws
        )
        made = {
            key: each.at(part).tolist()
            for (key, each), part in zip(ranges.items(), parts.T, strict=True)
        }
    return [Axis("draw", asked.draws, made, drawn=True, arrays=drawn(by_grain, asked.seed))]


def _disorder(table: dict[str, Any]) -> list[Axis]:
    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    count, laws = _checked(Realisations, _only(table, "realisations"), tables)
    made = drawn(laws, Seeded(**_only(table, "seed")).seed) if laws else ()
    axis = Axis("realisation", count.realisations, {}, drawn=True, arrays=made)
    return [axis if made and "m" not in table else _indexed(axis)]


def _only(table: dict[str, Any], key: str) -> dict[str, Any]:
    return {key: table[key]} if key in table else {}


def _indexed(axis: Axis) -> Axis:
    """Return the axis of disorder with contacts that are drawn anew for each realisation."""
    return replace(axis, columns={INDEX: range(len(axis))})


def _checked(
    kind: type[T], table: dict[str, Any], tables: dict[str, Any]
) -> tuple[T, dict[str, Uniform | Normal]]:
    """Return what plain keys say, and the laws that tables stand for, with every fault at once."""
    faults: list[tuple[str, str]] = []
    laws: dict[str, Uniform | Normal] = {}
    try:
        made = kind(**table)
    except InputError as error:
        faults += error.faults
    for key, value in _leaves(tables):
        try:
            laws[key] = law(value)
        except InputError as error:
            faults += error.under(key)
    if faults:
        raise InputError(faults)
    return made, laws


MAKERS = {"grid": _grid, "list": _list, "random": _random, "disorder": _disorder}


def _leaves(table: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and their values; laws are values."""
    for key, value in table.items():
        if isinstance(value, dict) and not value.keys() & MARKS:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
