"""Sweep files: of which scenes a sweep is made, and what is asked of each; its name follows from that."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .. import engines
from ..chain.materials import MATERIALS
from ..disorder.draws import Law, Of, realisation
from ..errors import InputError, check_tolerance, shown
from ..scene.scene import Scene
from ..scene.toml_file import LARGEST_TABLE, SECTIONS, parse
from ..util.arrays import Array
from ..util.cached import cached_property
from ..util.files import check_readable
from ..util.suggestions import did_you_mean
from ..util.validation import Checked, Positive, Whole
from .axes import MAKERS, Axis, Seed, axes
from .quantities import QUANTITIES, of_contact, with_forces

FORMAT = 2
KEYS = ("scene", "engine", "tolerance", "keep", *MAKERS)
MOST_GRAINS = 10**8
DRAWS_TRIED = 32  # before a sweep is refused because none of them makes a scene
WHOLE = ["displacement", "velocity"]
Place = tuple[int, ...]


class Disorder(Checked):
    """A chain with random contacts, as for `disorder.realisation`."""

    m: Positive
    seed: Seed
    index: Whole
    law: Law = "dyson"
    of: Of = "stiffness"


@dataclass(frozen=True)
class Sweep:
    """What a sweep file says.

    Attributes
    ----------
    tables : dict
        The tables of the scene that all start from, which may lack what is swept, and that of the
        disorder.
    folder : Path
        Where the CSV files lie that they name.
    engine : str
    tolerance : float
    keep : list of str
        Names of `quantities.QUANTITIES`.
    axes : list of Axis
    source : dict
        The same as a sweep file with the tables of the scene in it, and the hashes of CSV files.
    """

    tables: dict[str, Any]
    folder: Path
    engine: str
    tolerance: float
    keep: list[str]
    axes: list[Axis]
    source: dict[str, Any]

    @cached_property
    def shape(self) -> Place:
        """How long the axes are."""
        return tuple(map(len, self.axes))

    @cached_property
    def recorded(self) -> dict[tuple[Place, int], np.ndarray]:
        """What `labels.recorded` has found so far: grains, by place along the axes that shape them and length."""
        return {}

    @property
    def count(self) -> int:
        """How many scenes these are."""
        return math.prod(self.shape)

    @cached_property
    def text(self) -> str:
        """All that shapes the answers, and what is kept of them, as JSON."""
        # in order: that of the axes is in it
        return json.dumps({"format": FORMAT, **self.source}, default=plain)

    @property
    def name(self) -> str:
        """What the results are called, a hash of all that shapes them."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    def place(self, number: int) -> Place:
        """Return the place of a scene; the last axis is the fastest."""
        return tuple(
            number // math.prod(self.shape[axis + 1 :]) % size
            for axis, size in enumerate(self.shape)
        )

    def key(self, number: int) -> bytes:
        """Return a hash of all that shapes the answer to one scene, and of what is kept of it."""
        place = self.place(number)
        drawn = [
            (each.key, type(each.law).__name__, each.law.given(), each.seed, index)
            for axis, index in zip(self.axes, place, strict=True)
            for each in axis.arrays
        ]
        files = self.source["files"]
        others = (self.engine, self.tolerance, self.keep)
        asked = json.dumps((self.asked(place), drawn, files, others), sort_keys=True, default=plain)
        return hashlib.sha256(asked.encode()).digest()[:16]

    def asked(self, place: Place) -> dict[str, Any]:
        """Return the tables of one scene, without what is drawn for every grain."""
        tables = self.tables
        for axis, index in zip(self.axes, place, strict=True):
            for key, values in axis.columns.items():
                tables = _with(tables, key.split("."), values[index], key)
        return tables

    def drawn(self, place: Place, grains: int) -> dict[str, Array]:
        """Return what is drawn for every grain of one scene, by key."""
        return {
            each.key: each.values(index, grains)
            for axis, index in zip(self.axes, place, strict=True)
            for each in axis.arrays
        }

    def grains(self, place: Place) -> int:
        """Return how many grains the chain of a scene has, as its table says."""
        tables = self.asked(place)
        chain = tables.get("chain")
        count = chain.get("grains") if isinstance(chain, dict) else None
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_GRAINS:
            raise InputError.at(
                "chain.grains",
                "must be a whole number from 1 where values of every grain are drawn",
            )
        return count

    def ordered(self, place: Place) -> Scene:
        """Make a scene with all but the random contacts of its chain; raises `InputError`."""
        tables = self.asked(place)
        if any(axis.arrays for axis in self.axes):
            grains = self.grains(place)
            for key, values in self.drawn(place, grains).items():
                tables = _of_every_grain(tables, key, values)
        asked = {key: table for key, table in tables.items() if key != "disorder"}
        return _scene(json.dumps((asked, self.source["files"]), default=plain), self.folder)

    def scene(self, place: Place) -> Scene:
        """Make a scene; raises `InputError`."""
        ordered = self.ordered(place)
        disorder = self.disorder(place)
        if not disorder:
            return ordered
        try:
            return realisation(ordered, **disorder.given())
        except InputError as error:
            raise InputError(error.under("disorder")) from None

    def disorder(self, place: Place) -> Disorder | None:
        """Return how the contacts of a scene are drawn, if they are; raises `InputError`."""
        table = self.asked(place).get("disorder")
        try:
            return None if table is None else Disorder(**table)
        except InputError as error:
            raise InputError(error.under("disorder")) from None

    def trials(self) -> Iterator[Scene]:
        """Yield scenes until every value has been in one; drawn values count as one.

        Raises
        ------
        InputError
            At the end, with what is wrong with values that were in none.
        """
        engine = engines.get(self.engine)
        good: set[tuple[int, int]] = set()
        faults: dict[tuple[int, int], list[tuple[str, str]]] = {}
        every = sum(1 if axis.drawn else len(axis) for axis in self.axes)
        tried = (
            range(min(len(axis), DRAWS_TRIED) if axis.drawn else len(axis)) for axis in self.axes
        )
        for place in itertools.product(*tried):
            if len(good) == every:
                break
            values = {(n, 0 if self.axes[n].drawn else index) for n, index in enumerate(place)}
            if values <= good:
                continue
            try:
                scene = with_forces(self.scene(place), self.keep)
                if reasons := engine.refuses(scene):
                    raise InputError(reasons)
            except InputError as error:
                for value in values:
                    faults.setdefault(value, error.faults)
                continue
            good |= values
            yield scene
        if bad := [fault for value in sorted(faults.keys() - good) for fault in faults[value]]:
            raise InputError(dict.fromkeys(bad))


@lru_cache(maxsize=4)  # realisations of one chain follow one another
def _scene(text: str, folder: Path) -> Scene:
    return Scene.from_dict(json.loads(text)[0], folder)


def _digests(tables: Mapping[str, Any], swept: Sequence[Axis], folder: Path) -> dict[str, str]:
    """Return the hashes of the CSV files; one that cannot be read is reported with its scene."""
    names = [table.get("file") for table in tables.values() if isinstance(table, dict)]
    columns = [column for axis in swept for column in axis.columns.items()]
    names += [name for key, values in columns if key.endswith(".file") for name in values]
    found = {}
    for name in sorted({name for name in names if isinstance(name, str)}):
        try:
            check_readable(folder / name, LARGEST_TABLE)
            with open(folder / name, "rb") as opened:
                found[name] = hashlib.file_digest(opened, "sha256").hexdigest()
        except (OSError, ValueError):
            found[name] = ""
    return found


def read(source: str | PathLike[str] | Mapping[str, Any]) -> Sweep:
    """Read a sweep file, or the same as a mapping.

    Raises
    ------
    InputError
        With every fault in it; those of the values come with `Sweep.trials`.
    """
    if isinstance(source, Mapping):
        return _plan(dict(source), Path())
    return _plan(parse(Path(source)), Path(source).parent)


@lru_cache(maxsize=2)  # tasks of one sweep follow one another
def again(text: str, folder: Path) -> Sweep:
    """Return the sweep whose `text` this is; `folder` is where its CSV files lie."""
    kept = json.loads(text)
    if not isinstance(kept["scene"], dict):
        raise InputError.at("scene", "must be tables: a sweep that is kept names no other file")
    return _plan(
        {key: value for key, value in kept.items() if key not in ("format", "files")},
        folder,
        kept["files"],
    )


def is_name(text: Any) -> bool:
    """Say whether results may be called so, as `Sweep.name`."""
    return isinstance(text, str) and bool(re.fullmatch("[0-9a-f]{16}", text))


def _plan(data: dict[str, Any], folder: Path, files: Any = None) -> Sweep:
    """Return what the tables of a sweep file say, with the hashes of `files`; raises `InputError`."""
    there = f"the keys here are {', '.join(KEYS)}"
    faults = [
        (key, f"unknown key{did_you_mean(key, KEYS)}; {there}") for key in data if key not in KEYS
    ]
    parts = {part: data[part] for part in MAKERS if part in data}
    tolerance = data.get("tolerance", 1e-6)
    results: list[Any] = []
    for take in (
        lambda: _base(data.get("scene"), folder),
        lambda: _engine(data.get("engine", "auto")),
        lambda: check_tolerance(tolerance),
        lambda: _keep(data.get("keep", WHOLE)),
        lambda: axes(parts),
    ):
        try:
            results.append(take())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    (tables, folder), engine, _, keep, swept = results
    folder = folder.absolute()
    source = {
        "scene": tables,
        "engine": engine,
        "tolerance": float(tolerance),
        "keep": keep,
        **parts,
    }
    source["files"] = _digests(tables, swept, folder) if files is None else files
    if "disorder" in parts and any(
        key.startswith("disorder.") for axis in swept for key in axis.columns
    ):
        own = {key: value for key, value in parts["disorder"].items() if key != "realisations"}
        tables = tables | {
            "disorder": {key: value for key, value in own.items() if not isinstance(value, dict)}
        }
    return Sweep(tables, folder, engine, float(tolerance), keep, swept, source)


def _base(given: Any, folder: Path) -> tuple[dict[str, Any], Path]:
    """Return the tables that all scenes start from, and the folder of the CSV files that they name."""
    if isinstance(given, Scene):
        return given.to_dict(), folder
    if isinstance(given, str):
        path = folder / given
        given = parse(path)
        folder = path.parent
    if not isinstance(given, dict):
        raise InputError.at(
            "scene", "name a scene file, or give its tables: [scene.chain], [scene.excitation] ..."
        )
    if unknown := [key for key in given if key not in SECTIONS]:
        there = f"they are {', '.join(SECTIONS)}"
        meant = {key: did_you_mean(key, SECTIONS) for key in unknown}
        raise InputError(
            [(f"scene.{key}", f"unknown section{meant[key]}; {there}") for key in unknown]
        )
    return dict(given), folder


def _engine(name: Any) -> str:
    if not isinstance(name, str):
        raise InputError.at("engine", f"must be the name of an engine (got {shown(name)})")
    # one engine for all: small scenes go together, and bits do not hang on how fast a machine is
    if name == "auto":
        return "native"
    return engines.get(name).name


def _keep(names: Any) -> list[str]:
    known = ", ".join((*QUANTITIES, "peak_force:40"))
    if not isinstance(names, list) or not names:
        raise InputError.at("keep", f"must be a list of some of {known}")
    if wrong := [
        name
        for name in names
        if not isinstance(name, str) or not (name in QUANTITIES or of_contact(name))
    ]:
        meant = [(name, did_you_mean(name, QUANTITIES)) for name in wrong]
        raise InputError(
            [("keep", f"there is no {shown(name)}{other}; use {known}") for name, other in meant]
        )
    return sorted(set(names))


def _with(table: Any, path: list[str], value: Any, key: str) -> Any:
    """Return the table with a value set at a path; the name of a material becomes its constants."""
    if not path:
        return value
    first = path[0]
    rest = path[1:]
    if isinstance(table, str) and table in MATERIALS:
        table = {
            name: getattr(MATERIALS[table], name)
            for name in ("density", "youngs_modulus", "poissons_ratio")
        }
    if isinstance(table, list):
        if not (first.isdecimal() and int(first) < len(table)):
            raise InputError.at(
                key, f"there is no entry {first}: the scene has {len(table)}, counted from 0"
            )
        place = int(first)
        return [*table[:place], _with(table[place], rest, value, key), *table[place + 1 :]]
    if not isinstance(table, dict | None):
        raise InputError.at(key, "is no key of a scene: what should hold it is not a table")
    table = table or {}
    return table | {first: _with(table.get(first), rest, value, key)}


def _of_every_grain(tables: dict[str, Any], key: str, values: Array) -> dict[str, Any]:
    """Return the tables with a value for every grain; that of a material makes one material a grain."""
    path = key.split(".")
    if len(path) == 2:
        return _with(tables, path, values.tolist(), key)
    material = (tables.get("chain") or {}).get("material", "glass")
    each = material if isinstance(material, list) else [material] * len(values)
    made = [
        _with(one, path[2:], value, key) for one, value in zip(each, values.tolist(), strict=False)
    ]
    return _with(tables, path[:2], made, key)


def plain(value: Any) -> Any:
    """Return what JSON can hold in place of what it cannot."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
