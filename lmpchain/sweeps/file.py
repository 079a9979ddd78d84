"""Sweep files: the scenes of a sweep, and the quantities to store for each scene."""

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
from ..chain.materials import Material, named
from ..chain.patterns import write_out
from ..disorder.draws import Law, Of, realisation
from ..errors import InputError, check_tolerance, did_you_mean, short, shown, unknown_key
from ..scene.scene import Scene
from ..scene.toml_file import FILE_SIZES, SECTIONS, parse
from ..util.arrays import Array
from ..util.files import check_readable, expanded, path_of
from ..util.lazy import cached_property
from ..util.validation import Checked, Positive, Whole
from .axes import MAKERS, Axis, Fault, Seed, make_axes
from .quantities import QUANTITIES, of_contact, with_gathered

FORMAT = 3  # Version of the format of result files.
KEYS = ("scene", "engine", "tolerance", "keep", *MAKERS)
MOST_GRAINS = 10**8  # Largest number of grains of a chain; more would exceed the memory.
MOST_DIGITS = 10  # Largest number of digits of an entry's index.
DRAWS_TRIED = 32  # Number of trials without a valid scene after which a sweep is rejected.
Place = tuple[int, ...]


class Disorder(Checked):
    """A chain with random contacts, as `disorder.realisation` makes it."""

    m: Positive
    seed: Seed
    index: Whole
    law: Law = "dyson"
    of: Of = "stiffness"


@dataclass(frozen=True)
class Sweep:
    """A sweep: the tables of its scenes, its axes, and the quantities to store.

    Attributes
    ----------
    tables : dict
        Tables that all scenes share, which may lack the swept keys, and the table of random
        contacts.
    folder : Path
        Folder of the CSV files that the tables name.
    engine : str
        Name of the engine.
    tolerance : float
        Tolerance of each run.
    keep : list of str
        Names of the quantities to store, from `quantities.QUANTITIES`.
    axes : list of Axis
        Axes of the sweep.
    source : dict
        Content of the sweep file with the tables of the scene, and hashes of the CSV files.
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
        """Lengths of the axes."""
        return tuple(map(len, self.axes))

    @property
    def count(self) -> int:
        """Number of scenes."""
        return math.prod(self.shape)

    @cached_property
    def text(self) -> str:
        """All options that determine the results, as JSON."""
        # Keys are not sorted, because the order of the axes matters.
        return json.dumps({"format": FORMAT, **self.source}, default=as_json)

    @property
    def name(self) -> str:
        """Name of the results: a hash of all options that determine them."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    def place(self, number: int) -> Place:
        """Return the index of a scene along each axis; the last axis varies fastest."""
        return tuple(int(index) for index in np.unravel_index(number, self.shape))

    def key(self, number: int) -> bytes:
        """Return a hash of all options that determine the stored quantities of one scene."""
        position = self.place(number)
        laws = [
            (law.key, type(law.law).__name__, law.law.given(), law.seed, index)
            for axis, index in zip(self.axes, position, strict=True)
            for law in axis.arrays
        ]
        options = (self.engine, self.tolerance, self.keep)
        causes = (self.tables_at(position), laws, self.source["files"], options)
        text = json.dumps(causes, sort_keys=True, default=as_json)
        return hashlib.sha256(text.encode()).digest()[:16]

    def tables_at(self, position: Place) -> dict[str, Any]:
        """Return the tables of one scene, without the numbers drawn for each grain."""
        tables = self.tables
        for axis, index in zip(self.axes, position, strict=True):
            for key, values in axis.columns.items():
                tables = _set_value(tables, key.split("."), values[index], key)
        return tables

    def draw_values(self, position: Place, grains: int) -> dict[str, Array]:
        """Return the numbers that are drawn for each grain of one scene, by key."""
        return {
            law.key: law.values(index, grains)
            for axis, index in zip(self.axes, position, strict=True)
            for law in axis.arrays
        }

    def grains(self, position: Place) -> int:
        """Return the number of grains of a scene; raise `InputError` if its table is invalid."""
        tables = self.tables_at(position)
        chain = tables.get("chain")
        count = chain.get("grains") if isinstance(chain, dict) else None
        if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_GRAINS:
            raise InputError.at(
                "chain.grains",
                "must be a whole number from 1, because values are drawn for every grain",
            )
        return count

    def regular_scene(self, position: Place) -> Scene:
        """Make a scene without the random contacts of its chain; raise `InputError` if invalid."""
        tables = self.tables_at(position)
        if any(axis.arrays for axis in self.axes):
            grains = self.grains(position)
            for key, values in self.draw_values(position, grains).items():
                tables = _set_each_grain(tables, key, values)
        tables = {key: table for key, table in tables.items() if key != "disorder"}
        return _make_scene(json.dumps((tables, self.source["files"]), default=as_json), self.folder)

    def scene(self, position: Place) -> Scene:
        """Return the scene at a position; raise `InputError` if its options are invalid."""
        scene = self.regular_scene(position)
        disorder = self.disorder(position)
        if not disorder:
            return scene
        try:
            return realisation(scene, **disorder.given())
        except InputError as error:
            raise InputError(error.under("disorder")) from None

    def disorder(self, position: Place) -> Disorder | None:
        """Return the options of random contacts, if any; raise `InputError` if invalid."""
        table = self.tables_at(position).get("disorder")
        try:
            return None if table is None else Disorder(**table)
        except InputError as error:
            raise InputError(error.under("disorder")) from None

    def trials(self) -> Iterator[Scene]:
        """Yield scenes until each value was in one of them; drawn values count as one value.

        Raises
        ------
        InputError
            After the last scene, if no scene with a certain value is valid; the error lists the
            faults of all such values.
        """
        count = sum(1 if axis.drawn else len(axis) for axis in self.axes)
        lengths = (min(len(axis), DRAWS_TRIED) if axis.drawn else len(axis) for axis in self.axes)
        usable: set[tuple[int, int]] = set()
        faults: dict[tuple[int, int], list[Fault]] = {}
        for position in itertools.product(*map(range, lengths)):
            if len(usable) == count:
                break
            # Drawn values count as one value, because the user cannot correct a single one.
            values = {(n, 0 if self.axes[n].drawn else index) for n, index in enumerate(position)}
            if values <= usable:
                continue
            try:
                scene = self._trial(position)
            except InputError as error:
                for value in values:
                    faults.setdefault(value, error.faults)
                continue
            usable |= values
            yield scene
        unusable = sorted(faults.keys() - usable)
        if unusable:
            raise InputError(dict.fromkeys(fault for value in unusable for fault in faults[value]))

    def _trial(self, position: Place) -> Scene:
        """Make a scene that the engine can solve; raise `InputError` otherwise."""
        engine = engines.get(self.engine)
        scene = with_gathered(self.scene(position), self.keep, engine.moves_grains)
        if reasons := engines.obstacles(engine, scene):
            raise InputError(reasons)
        return scene


# Realisations of one chain follow one another.
@lru_cache(maxsize=4)
def _make_scene(text: str, folder: Path) -> Scene:
    return Scene.from_dict(json.loads(text)[0], folder)


def _hash_files(tables: Mapping[str, Any], axes: Sequence[Axis], folder: Path) -> dict[str, str]:
    """Return the hashes of the CSV files; an unreadable file is reported with its scene."""
    sections = [table for table in tables.values() if isinstance(table, dict)]
    # The start of a drive is a nested table.
    inner = [table for section in sections for table in section.values() if isinstance(table, dict)]
    names = [table.get("file") for table in (*sections, *inner)]
    for axis in axes:
        for key, values in axis.columns.items():
            if key.endswith(".file"):
                names += values
    hashes = {}
    for name in sorted({name for name in names if isinstance(name, str)}):
        try:
            check_readable(folder / expanded(name), FILE_SIZES.table)
            with open(folder / expanded(name), "rb") as opened:
                hashes[name] = hashlib.file_digest(opened, "sha256").hexdigest()
        except (OSError, ValueError):
            hashes[name] = ""
    return hashes


def read_sweep(source: str | PathLike[str] | Mapping[str, Any]) -> Sweep:
    """Read a sweep from a file or a mapping.

    Raises
    ------
    InputError
        If the sweep is not valid; the error lists every fault. Faults of values are raised by
        `Sweep.trials`.
    """
    if isinstance(source, Mapping):
        return _plan(dict(source), Path())
    path = path_of(source, "source")
    return _plan(parse(path), path.parent)


def read_text(text: str, folder: Path) -> Sweep:
    """Return the sweep with this `Sweep.text`; its CSV files are in `folder`."""
    data = json.loads(text)
    if not isinstance(data["scene"], dict):
        raise InputError.at(
            "scene", "must be tables: a stored sweep does not refer to a scene file"
        )
    files = data.pop("files")
    data.pop("format", None)
    return _plan(data, folder, files)


def is_name(text: Any) -> bool:
    """Return whether a text may be the name of results (see `Sweep.name`)."""
    return isinstance(text, str) and bool(re.fullmatch("[0-9a-f]{16}", text))


def _plan(data: dict[str, Any], folder: Path, files: Any = None) -> Sweep:
    """Return the sweep for the tables of a sweep file; raise `InputError` with all faults."""
    faults = [(str(key), unknown_key(str(key), KEYS)) for key in data if key not in KEYS]
    kinds = {kind: data[kind] for kind in MAKERS if kind in data}
    tolerance = data.get("tolerance", 1e-6)
    results: list[Any] = []
    for take in (
        lambda: _take_scene(data.get("scene"), folder),
        lambda: _take_engine(data.get("engine", "auto")),
        lambda: check_tolerance(tolerance),
        lambda: _take_names(data.get("keep", ["displacement", "velocity"])),
        lambda: make_axes(kinds),
    ):
        try:
            results.append(take())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    # All checks run, so that every fault is reported at once.
    (tables, folder), engine, _, keep, axes = results
    folder = folder.absolute()
    tolerance = float(tolerance)
    source = {"scene": tables, "engine": engine, "tolerance": tolerance, "keep": keep, **kinds}
    source["files"] = _hash_files(tables, axes, folder) if files is None else files
    if any(key.startswith("disorder.") for axis in axes for key in axis.columns):
        # These are the options of random contacts, without their number and the laws of grains.
        options = {
            key: value
            for key, value in kinds["disorder"].items()
            if key != "realisations" and not isinstance(value, dict)
        }
        tables = tables | {"disorder": options}
    return Sweep(tables, folder, engine, tolerance, keep, axes, source)


def _take_scene(source: Any, folder: Path) -> tuple[dict[str, Any], Path]:
    """Return the common tables of all scenes, and the folder of their CSV files."""
    if isinstance(source, Scene):
        return source.to_dict(), folder
    if isinstance(source, str):
        path = folder / expanded(source)
        source = parse(path)
        folder = path.parent
    if not isinstance(source, dict):
        raise InputError.at(
            "scene", "name a scene file, or give its tables: [scene.chain], [scene.excitation] ..."
        )
    cure = f"use {', '.join(SECTIONS)}"
    if faults := [
        (f"scene.{key}", f"unknown section{did_you_mean(key, SECTIONS)}; {cure}")
        for key in source
        if key not in SECTIONS
    ]:
        raise InputError(faults)
    return dict(source), folder


def _take_engine(name: Any) -> str:
    if not isinstance(name, str):
        raise InputError.at("engine", f"must be the name of an engine (got {shown(name)})")
    # One engine for all scenes allows batches, and makes results independent of the machine's
    # speed.
    return engines.get(engines.DEFAULT if name == "auto" else name).name


def _take_names(names: Any) -> list[str]:
    options = ", ".join((*QUANTITIES, "peak_force:40"))
    if not isinstance(names, list) or not names:
        raise InputError.at("keep", f"must be a list of names among {options}")
    if faults := [
        ("keep", f"there is no {shown(name)}{did_you_mean(name, QUANTITIES)}; use {options}")
        for name in names
        if not isinstance(name, str) or not (name in QUANTITIES or of_contact(name))
    ]:
        raise InputError(faults)
    return sorted(set(names))


def _set_value(table: Any, path: list[str], value: Any, key: str) -> Any:
    """Return the table with a value set at a path; material names are replaced by constants."""
    if not path:
        return value
    first = path[0]
    rest = path[1:]
    # A single constant of a named material can be swept.
    if material := table if isinstance(table, Material) else named(table):
        table = {
            name: getattr(material, name)
            for name in ("density", "youngs_modulus", "poissons_ratio")
        }
    if isinstance(table, list):
        # Python refuses to convert numbers of thousands of digits.
        if not (first.isdecimal() and len(first) < MOST_DIGITS and int(first) < len(table)):
            raise InputError.at(
                key,
                f"there is no entry {short(first)}: the scene has entries 0 to {len(table) - 1}",
            )
        entry = int(first)
        return [*table[:entry], _set_value(table[entry], rest, value, key), *table[entry + 1 :]]
    if not isinstance(table, dict | None):
        raise InputError.at(key, "is not a key of a scene: its parent is not a table")
    table = table or {}
    return table | {first: _set_value(table.get(first), rest, value, key)}


def _set_each_grain(tables: dict[str, Any], key: str, values: Array) -> dict[str, Any]:
    """Return the tables with one value per grain, in separate materials if necessary."""
    path = key.split(".")
    if path[1] != "material":
        return _set_value(tables, path, values.tolist(), key)
    try:
        # A unit cell has fewer entries than the chain has grains.
        chain = write_out(tables.get("chain") or {})
    except InputError as error:
        raise InputError(error.under("chain")) from None
    material = chain.get("material", "glass")
    materials = material if isinstance(material, list | tuple) else [material] * len(values)
    changed = [
        _set_value(material, path[2:], value, key)
        for material, value in zip(materials, values.tolist(), strict=False)
    ]
    return tables | {"chain": chain | {"material": changed}}


def as_json(value: Any) -> Any:
    """Return arrays as lists and other values as text, for JSON."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
