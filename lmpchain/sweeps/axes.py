"""The axes of a sweep: grid, cases, Latin hypercube, realisations of disorder, random laws."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..errors import InputError, did_you_mean
from ..scene.toml_file import SECTIONS
from ..util.arrays import Array, plain
from ..util.validation import Checked, Positive, Real, Whole

MARKS = {"low", "high", "mean", "deviation"}  # Keys that mark a table as a law.
CONTACT_CONSTANTS = "chain.contact_constants"
VISCOSITY = "chain.damping.viscoelastic"
BETWEEN_GRAINS = (CONTACT_CONSTANTS, VISCOSITY)
DAMPING = (VISCOSITY, "chain.damping.drag")
# Keys of a scene file with a number for each grain, or for each contact (`BETWEEN_GRAINS`).
GRAIN_KEYS = (
    "chain.masses",
    "chain.diameter",
    CONTACT_CONSTANTS,
    "chain.material.density",
    "chain.material.youngs_modulus",
    "chain.material.poissons_ratio",
    *DAMPING,
)
ALWAYS = ("chain.masses", CONTACT_CONSTANTS)  # Keys that never have one number for all grains.


class Uniform(Checked):
    """Uniform distribution between two numbers, of a value or of its logarithm."""

    low: Real
    high: Real
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.low >= self.high:
            yield "high", f"must be above low, {self.low:g} (got {self.high:g})"
        if self.log and self.low <= 0:
            yield "low", f"must be above 0 where log is true (got {self.low:g})"

    def at(self, share: Array) -> Array:
        """Return the quantiles of the distribution at these probabilities."""
        if self.log:
            return np.exp(math.log(self.low) + share * math.log(self.high / self.low))
        return self.low + share * (self.high - self.low)


class Normal(Checked):
    """Normal distribution of a value or its logarithm; mean and deviation of the value."""

    mean: Real
    deviation: Positive
    log: bool = False
    per_grain: bool = False

    def _faults(self) -> Iterator[tuple[str, str]]:
        if self.log and self.mean <= 0:
            yield "mean", f"must be above 0 where log is true (got {self.mean:g})"

    def at(self, share: Array) -> Array:
        """Return the quantiles of the distribution at these probabilities."""
        from scipy.special import ndtri

        if self.log:
            # These are the parameters of the normal distribution of the logarithm.
            variance = math.log1p((self.deviation / self.mean) ** 2)
            return self.mean * np.exp(math.sqrt(variance) * ndtri(share) - variance / 2)
        return self.mean + self.deviation * ndtri(share)


def make_law(table: Any) -> Uniform | Normal:
    """Return the law that a table describes; raise `InputError` if the table is invalid."""
    if not isinstance(table, Mapping):
        cure = "such as {low = 1.0, high = 10.0} or {mean = 5.0, deviation = 1.0}"
        raise InputError.at("", f"must be a range or a distribution, {cure}")
    return Normal(**table) if table.keys() & {"mean", "deviation"} else Uniform(**table)


@dataclass(frozen=True)
class GrainLaw:
    """A key with a random number for each grain, drawn anew for every scene.

    The numbers of scene i are drawn by `numpy.random.default_rng(SeedSequence(seed, spawn_key=(i,
    k)))`, where k is the first four bytes of the SHA-256 of the key. They therefore do not depend
    on any other random number.
    """

    key: str
    law: Uniform | Normal
    seed: int

    @property
    def of_contacts(self) -> bool:
        """Whether each contact has a number; there is one contact fewer than grains."""
        return self.key in BETWEEN_GRAINS

    def values(self, index: int, grains: int) -> Array:
        """Return the random numbers of a scene, one for each grain or contact."""
        # Numbers of one key depend on no other key, nor on the order of the axes.
        mark = int.from_bytes(hashlib.sha256(self.key.encode()).digest()[:4], "big")
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index, mark)))
        return self.law.at(rng.random(grains - self.of_contacts))


def bind_laws(laws: Mapping[str, Uniform | Normal], seed: int) -> tuple[GrainLaw, ...]:
    """Return the laws of numbers for each grain; raise `InputError` for other keys."""
    cure = f"use one of {', '.join(GRAIN_KEYS)}"
    fault = f"has no separate value for each grain: {cure}"
    if faults := [(key, fault) for key in laws if key not in GRAIN_KEYS]:
        raise InputError(faults)
    return tuple(GrainLaw(key, law, seed) for key, law in laws.items())


MOST_SCENES = 10**6
Count = Annotated[Whole, Field(ge=1, le=MOST_SCENES)]
Seed = Annotated[Whole, Field(ge=0)]
INDEX = "disorder.index"
Fault = tuple[str, str]  # Key and message.


class Draws(Checked):
    """Number of points of a Latin hypercube, and seed of its random numbers."""

    draws: Count
    seed: Seed


class Seeded(Checked):
    """Seed of a sequence of random numbers."""

    seed: Seed


class Realisations(Checked):
    """Number of disordered chains."""

    realisations: Count


@dataclass(frozen=True)
class Axis:
    """One dimension of a sweep.

    Attributes
    ----------
    name : str
        Name of the axis.
    length : int
        Number of values along the axis.
    columns : mapping
        Values of each key along the axis.
    drawn : bool
        Whether values are drawn at random, so that the user cannot correct a single value.
    arrays : tuple of GrainLaw
        Laws of the keys that have a separate random number for each grain.
    """

    name: str
    length: int
    columns: Mapping[str, Sequence[Any]]
    drawn: bool = False
    arrays: tuple[GrainLaw, ...] = ()

    def __len__(self) -> int:
        return self.length

    @property
    def keys(self) -> list[str]:
        """Keys that change along the axis."""
        return [*self.columns, *(law.key for law in self.arrays)]

    def coordinates(self) -> dict[str, Array | list[str]]:
        """Return the coordinates along the axis by name, (L,) or (L, E) each."""
        columns: dict[str, Any] = {}
        if self.name not in self.columns:
            columns[self.name] = np.arange(self.length)
        for key, values in self.columns.items():
            if key != INDEX:
                columns[key] = _coordinate(values)
        return columns


def _numeric(values: Sequence[Any]) -> bool:
    """Return whether all values are numbers, or lists of numbers."""
    kinds = {type(value) for value in values}
    if kinds == {list}:
        return all(map(_numeric, values))
    return kinds <= {int, float} and bool(kinds)


def _coordinate(values: Sequence[Any]) -> Array | list[str]:
    """Return numbers as an array, lists of numbers as rows padded with NaN, the rest as text."""
    if not _numeric(values):
        return [
            value if isinstance(value, str) else json.dumps(value, default=str) for value in values
        ]
    if isinstance(values[0], list):
        return np.array(list(itertools.zip_longest(*values, fillvalue=np.nan)), float).T
    return np.array(values)


def make_axes(tables: Mapping[str, Any]) -> list[Axis]:
    """Return the axes that the tables of a sweep file describe; their values are not checked yet.

    Raises
    ------
    InputError
        If a table is not valid; the error lists every fault.
    """
    faults: list[Fault] = []
    axes: list[Axis] = []
    for kind, table in tables.items():
        try:
            if not isinstance(table, dict):
                raise InputError.at("", f"must be a table, [{kind}]")
            axes += MAKERS[kind](table)
        except InputError as error:
            faults += error.under(kind)
    if any(key.startswith("disorder.") for axis in axes for key in axis.columns):
        axes = [_number(axis) if axis.name == "realisation" else axis for axis in axes]
    keys = [key for axis in axes for key in axis.keys]
    faults += _section_faults(keys, (*SECTIONS, "disorder") if "disorder" in tables else SECTIONS)
    faults += _overlap_faults(keys)
    if axes or not faults:
        faults += _count_faults(axes)
    if faults:
        raise InputError(faults)
    return axes


def _count_faults(axes: Sequence[Axis]) -> Iterator[Fault]:
    """Yield a fault of a sweep with no scenes or with too many."""
    count = math.prod(len(axis) for axis in axes)
    if not axes:
        kinds = ", ".join(f"[{kind}]" for kind in MAKERS)
        yield "grid", f"nothing is swept: add a table {kinds}"
    elif count > MOST_SCENES:
        yield "grid", f"{count} scenes are too many: sweep at most {MOST_SCENES}"


def _section_faults(keys: Sequence[str], sections: Sequence[str]) -> Iterator[Fault]:
    """Yield the keys that are not in a section of a scene file."""
    for key in keys:
        section = key.partition(".")[0]
        if section not in sections:
            cure = f"keys begin with {', '.join(sections)}, as chain.gravity does"
            yield key, f"is not a key of a scene{did_you_mean(section, sections)}; {cure}"


def _overlap_faults(keys: Sequence[str]) -> Iterator[Fault]:
    """Yield a fault for each key that is swept twice, or that contains another one."""
    for first, second in itertools.combinations(keys, 2):
        if first == second:
            yield second, "is swept twice"
        elif f"{second}.".startswith(f"{first}.") or f"{first}.".startswith(f"{second}."):
            yield second, f"overlaps {first}: sweep one of them"


def _grid(table: dict[str, Any]) -> list[Axis]:
    return [Axis(key, len(values), {key: values}) for key, values in _lists(table).items()]


def _list(table: dict[str, Any]) -> list[Axis]:
    columns = _lists(table)
    first = next(iter(columns))
    count = len(columns[first])
    faults = [
        (key, f"must have {count} values, as many as {first} (got {len(values)})")
        for key, values in columns.items()
        if len(values) != count
    ]
    if faults:
        raise InputError(faults)
    return [Axis("case", count, columns)]


def _lists(table: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the lists of values of a table by key, as Python numbers."""
    lists = {
        key: list(value) if isinstance(value, tuple | np.ndarray) else value
        for key, value in _leaves(table)
    }
    if not lists:
        raise InputError.at("", "is empty: name a key, such as chain.gravity = [1.62, 9.81]")
    faults = [
        (key, "must be a list of one or more values")
        for key, values in lists.items()
        if not isinstance(values, list) or not values
    ]
    if faults:
        raise InputError(faults)
    return {key: [plain(value) for value in values] for key, values in lists.items()}


def _random(table: dict[str, Any]) -> list[Axis]:
    from scipy.stats import qmc

    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    numbers = {key: value for key, value in table.items() if key not in tables}
    options, laws = _check_axes(Draws, numbers, tables)
    if not laws:
        raise InputError.at("", "name a key, such as chain.gravity = {low = 1.0, high = 10.0}")
    by_grain = {key: law for key, law in laws.items() if law.per_grain or key in ALWAYS}
    ranges = {key: law for key, law in laws.items() if key not in by_grain}
    columns = {}
    if ranges:
        # Latin hypercube: each range is divided into equal parts, and each part is sampled once.
        rng = np.random.default_rng(options.seed)
        shares = qmc.LatinHypercube(len(ranges), seed=rng).random(options.draws)
        columns = {
            key: law.at(share).tolist()
            for (key, law), share in zip(ranges.items(), shares.T, strict=True)
        }
    arrays = bind_laws(by_grain, options.seed)
    return [Axis("draw", options.draws, columns, drawn=True, arrays=arrays)]


def _disorder(table: dict[str, Any]) -> list[Axis]:
    tables = {key: value for key, value in table.items() if isinstance(value, dict)}
    options, laws = _check_axes(Realisations, _only(table, "realisations"), tables)
    arrays = bind_laws(laws, Seeded(**_only(table, "seed")).seed) if laws else ()
    axis = Axis("realisation", options.realisations, {}, drawn=True, arrays=arrays)
    return [axis if arrays and "m" not in table else _number(axis)]


def _only(table: dict[str, Any], key: str) -> dict[str, Any]:
    return {key: table[key]} if key in table else {}


def _number(axis: Axis) -> Axis:
    """Return the axis of disorder, with contacts drawn anew for each realisation."""
    return replace(axis, columns={INDEX: range(len(axis))})


def _check_axes(
    kind: type[Checked], table: dict[str, Any], tables: dict[str, Any]
) -> tuple[Any, dict[str, Uniform | Normal]]:
    """Return options and laws of random numbers; raise `InputError` with all faults."""
    faults: list[Fault] = []
    laws: dict[str, Uniform | Normal] = {}
    try:
        options = kind(**table)
    except InputError as error:
        faults += error.faults
    for key, value in _leaves(tables):
        try:
            laws[key] = make_law(value)
        except InputError as error:
            faults += error.under(key)
    if faults:
        raise InputError(faults)
    return options, laws


MAKERS = {"grid": _grid, "list": _list, "random": _random, "disorder": _disorder}


def _leaves(table: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and their values; laws are values."""
    for key, value in table.items():
        if isinstance(value, dict) and not value.keys() & MARKS:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
