"""Sweep files: of which scenes a sweep is made, and what is asked of each; its name follows from that."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
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
from ..util.files import check_readable
from ..util.suggestions import did_you_mean
from ..util.validation import Checked, Positive, Whole
from .axes import MAKERS, Axis, Seed, axes
from .quantities import QUANTITIES

KEYS = ("scene", "engine", "tolerance", "keep", *MAKERS)
WHOLE = ["displacement", "velocity"]
Place = tuple[int, ...]


class Disorder(Checked):
    """A chain with random contacts, as for `disorder.realisation`."""

    m: Positive
    seed: Seed
    index: Whole
    law: Law = "dyson"
    of: Of = "stiffness"


@dataclass
class Sweep:
    """What a sweep file says.

    Attributes
    ----------
    tables : dict
        The tables of the scene that all start from, which may lack what is swept, and that of the disorder.
    folder : Path
        Where the CSV files lie that they name.
    engine : str
    tolerance : float
    keep : list of str
        Names of `quantities.QUANTITIES`.
    axes : list of Axis
    """

    tables: dict[str, Any]
    folder: Path
    engine: str
    tolerance: float
    keep: list[str]
    axes: list[Axis]
    _digests: dict[str, str] = field(default_factory=dict)

    def places(self) -> Iterator[Place]:
        """Yield all places of the sweep, the last axis fastest."""
        return itertools.product(*(range(len(axis)) for axis in self.axes))

    def asked(self, place: Place) -> str:
        """Return one scene of the sweep as JSON, with all that shapes its answer and what is kept of it."""
        tables = self.tables
        for axis, index in zip(self.axes, place, strict=True):
            for key, values in axis.columns.items():
                tables = _with(tables, key.split("."), values[index], key)
        files = (table.get("file") for table in tables.values() if isinstance(table, dict))
        asked = {
            "scene": {name: table for name, table in tables.items() if name != "disorder"},
            "disorder": tables.get("disorder"),
            "files": {name: self._digest(name) for name in files if isinstance(name, str)},
            "engine": self.engine,
            "tolerance": self.tolerance,
            "keep": self.keep,
        }
        return json.dumps(asked, sort_keys=True, default=plain)

    def _digest(self, name: str) -> str:
        """Return the hash of a file; one that cannot be read is reported when its scene is made."""
        if name not in self._digests:
            try:
                check_readable(self.folder / name, LARGEST_TABLE)
                with open(self.folder / name, "rb") as opened:
                    self._digests[name] = hashlib.file_digest(opened, "sha256").hexdigest()
            except (OSError, ValueError):
                self._digests[name] = ""
        return self._digests[name]

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
        for place in self.places():
            values = {(n, 0 if self.axes[n].drawn else index) for n, index in enumerate(place)}
            if values <= good:
                continue
            try:
                scene = scene_of(json.loads(self.asked(place)), self.folder)
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


def name_of(asked: str) -> str:
    """Return the name of the folder of a scene, which follows from what is asked."""
    return hashlib.sha256(asked.encode()).hexdigest()[:32]


def scene_of(asked: Mapping[str, Any], folder: Path) -> Scene:
    """Make the scene that is asked for; `folder` is where its CSV files lie."""
    scene = _ordered(json.dumps((asked["scene"], asked["files"])), folder)
    if asked["disorder"] is None:
        return scene
    try:
        return realisation(scene, **Disorder(**asked["disorder"]).given())
    except InputError as error:
        raise InputError(error.under("disorder")) from None


@lru_cache(maxsize=1)  # realisations of one chain follow one another
def _ordered(text: str, folder: Path) -> Scene:
    return Scene.from_dict(json.loads(text)[0], folder)


def read(source: str | PathLike[str] | Mapping[str, Any]) -> Sweep:
    """Read a sweep file, or the same as a mapping.

    Raises
    ------
    InputError
        With every fault in it; those of the values come with `Sweep.trials`.
    """
    if isinstance(source, Mapping):
        data, folder = dict(source), Path()
    else:
        data, folder = parse(Path(source)), Path(source).parent
    there = f"the keys here are {', '.join(KEYS)}"
    faults = [(key, f"unknown key{did_you_mean(key, KEYS)}; {there}") for key in data if key not in KEYS]
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
    if "disorder" in parts:
        tables |= {"disorder": {key: value for key, value in parts["disorder"].items() if key != "realisations"}}
    return Sweep(tables, folder.absolute(), engine, float(tolerance), keep, swept)


def _base(given: Any, folder: Path) -> tuple[dict[str, Any], Path]:
    """Return the tables that all scenes start from, and the folder of the CSV files that they name."""
    if isinstance(given, Scene):
        return given.to_dict(), folder
    if isinstance(given, str):
        path = folder / given
        given, folder = parse(path), path.parent
    if not isinstance(given, dict):
        raise InputError([("scene", "name a scene file, or give its tables: [scene.chain], [scene.excitation] ...")])
    if unknown := [key for key in given if key not in SECTIONS]:
        there = f"they are {', '.join(SECTIONS)}"
        meant = {key: did_you_mean(key, SECTIONS) for key in unknown}
        raise InputError([(f"scene.{key}", f"unknown section{meant[key]}; {there}") for key in unknown])
    return dict(given), folder


def _engine(name: Any) -> str:
    if not isinstance(name, str):
        raise InputError([("engine", f"must be the name of an engine (got {shown(name)})")])
    if name == "auto":  # one engine for all: small scenes go together, and bits do not hang on how fast a machine is
        return "native"
    return engines.get(name).name


def _keep(names: Any) -> list[str]:
    known = ", ".join(QUANTITIES)
    if not isinstance(names, list) or not names:
        raise InputError([("keep", f"must be a list of some of {known}")])
    if wrong := [name for name in names if not isinstance(name, str) or name not in QUANTITIES]:
        meant = [(name, did_you_mean(name, QUANTITIES)) for name in wrong]
        raise InputError([("keep", f"there is no {shown(name)}{other}; use {known}") for name, other in meant])
    return sorted(set(names))


def _with(table: Any, path: list[str], value: Any, key: str) -> Any:
    """Return the table with a value set at a path; the name of a material becomes its constants."""
    if not path:
        return value
    first, rest = path[0], path[1:]
    if isinstance(table, str) and table in MATERIALS:
        table = {name: getattr(MATERIALS[table], name) for name in ("density", "youngs_modulus", "poissons_ratio")}
    if isinstance(table, list):
        if not (first.isdecimal() and int(first) < len(table)):
            raise InputError([(key, f"there is no entry {first}: the scene has {len(table)}, counted from 0")])
        place = int(first)
        return [*table[:place], _with(table[place], rest, value, key), *table[place + 1 :]]
    if not isinstance(table, dict | None):
        raise InputError([(key, "is no key of a scene: what should hold it is not a table")])
    table = table or {}
    return table | {first: _with(table.get(first), rest, value, key)}


def plain(value: Any) -> Any:
    """Return what JSON can hold in place of what it cannot."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
