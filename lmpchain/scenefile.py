"""Scene files: TOML in and out, with every fault listed at once under its key."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .chain import MATERIALS, Chain, Material
from .errors import InputError
from .files import write_aside
from .scene import EXCITATIONS, Excitation, Recording, Scene, strike_faults

LARGEST_FILE = 32 * 1024 * 1024
SECTIONS = ("chain", "excitation", "recording")
T = TypeVar("T")


def read(path: str | PathLike[str]) -> Scene:
    """Read a scene file; raises `InputError` with every fault in it."""
    path = Path(path)
    return from_dict(_parse(path), path.parent)


def from_dict(data: dict[str, Any], folder: Path = Path()) -> Scene:
    """Make a scene from the tables of a scene file; `folder` is where its CSV files lie."""
    faults: list[tuple[str, str]] = []

    def attempt(section: str, make: Callable[..., T], keys: dict[str, Any]) -> T | None:
        try:
            return make(**keys)
        except InputError as error:
            faults.extend(error.under(section))
            return None

    for key in data.keys() - set(SECTIONS):
        faults.append((key, f"unknown section; the sections are {', '.join(SECTIONS)}"))
    tables: dict[str, dict[str, Any]] = {}
    for section in SECTIONS:
        table = data.get(section)
        if isinstance(table, dict):
            tables[section] = dict(table)
        elif table is None:
            faults.append((section, f"is missing; add a [{section}] table"))
        else:
            faults.append((section, f"must be a table, [{section}]"))

    chain = attempt("chain", Chain, tables["chain"]) if "chain" in tables else None
    excitation: Excitation | None = None
    if "excitation" in tables:
        excitation = attempt("excitation", _excitation, {"table": tables["excitation"], "folder": folder})
    recording = attempt("recording", Recording, tables["recording"]) if "recording" in tables else None
    counted = chain or _of_this_length(tables.get("chain", {}))
    if counted and excitation:
        found = list(excitation.faults(counted))
        if chain and not found:
            found = list(strike_faults(chain, excitation))
        faults.extend(InputError(found).under("excitation"))
    if counted and recording:
        faults.extend(InputError(recording.faults(counted)).under("recording"))
    if faults:
        raise InputError(faults)
    assert chain
    assert excitation
    assert recording
    return Scene(chain=chain, excitation=excitation, **recording.given())


def _of_this_length(table: dict[str, Any]) -> Chain | None:
    """Return some chain with the grains and the bottom of a faulty one, to check the other tables against."""
    kept = {key: table[key] for key in ("grains", "bottom") if key in table}
    try:
        return Chain(**kept, diameter=1.0, gravity=0.0)
    except InputError:
        return None


def to_dict(scene: Scene) -> dict[str, Any]:
    """Return the tables of a scene file."""
    given = scene.given()
    chain = {key: _toml(value) for key, value in scene.chain.given().items()}
    excitation = {"kind": scene.excitation.kind}
    excitation |= {key: _toml(value) for key, value in scene.excitation.given().items() if value is not None}
    recording = {key: _toml(given[key]) for key in Recording.model_fields if key in given}
    return {"chain": chain, "excitation": excitation, "recording": recording}


def write(scene: Scene, path: str | PathLike[str]) -> None:
    """Write a scene file."""
    with write_aside(path) as aside:
        aside.write_text(dumps(scene), encoding="utf-8")


def dumps(scene: Scene) -> str:
    """Return the text of a scene file."""
    import tomli_w

    return tomli_w.dumps(to_dict(scene))


def loads(text: str) -> Scene:
    """Make a scene from the text of a scene file."""
    return from_dict(tomllib.loads(text))


def _parse(path: Path) -> dict[str, Any]:
    name = str(path)
    if path.is_dir():
        raise InputError([(name, "is a folder; name a scene file (TOML)")])
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError([(name, "is larger than 32 MB, so no scene file; put long profiles in a CSV file")])
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError([(name, "there is no such file")]) from None
    except OSError as error:
        raise InputError([(name, f"cannot be read: {error.strerror}")]) from None
    except UnicodeDecodeError:
        raise InputError([(name, "is not text in UTF-8; a scene file is a TOML text file")]) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError([(name, f"is not valid TOML: {error} (numbers need a digit after the point)")]) from None
    except RecursionError:
        raise InputError([(name, "is not valid TOML: nested too deeply")]) from None


def _excitation(table: dict[str, Any], folder: Path) -> Excitation:
    keys = dict(table)
    kind = keys.pop("kind", None)
    if not isinstance(kind, str) or kind not in EXCITATIONS:
        known = " | ".join(EXCITATIONS)
        raise InputError([("kind", f"must be {known} (got {kind!r})" if kind is not None else f"is missing; {known}")])
    if kind == "profile" and "file" in keys:
        keys |= _profile_csv(folder, keys.pop("file"))
    return EXCITATIONS[kind](**keys)


def _profile_csv(folder: Path, name: Any) -> dict[str, Any]:
    """Read columns `displacement` and `velocity`, one row a grain."""
    if not isinstance(name, str):
        raise InputError([("file", "must be the name of a CSV file")])
    path = folder / name
    try:
        with warnings.catch_warnings(action="ignore"):  # an empty file is a fault, not a warning
            table = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8", dtype=float, ndmin=1)
    except (OSError, ValueError, IndexError) as error:
        reason = str(error).strip().splitlines()[0] if str(error) else "not a table"
        raise InputError([("file", f"{path} cannot be read as CSV: {reason}")]) from None
    known = ("displacement", "velocity")
    columns = table.dtype.names or ()
    if not columns or set(columns) - {*known, "grain"} or not set(columns) & set(known):
        raise InputError([("file", f"{path} must have a header with displacement, velocity or both")])
    if "grain" in columns and not np.array_equal(table["grain"], np.arange(1, len(table) + 1)):
        raise InputError([("file", f"{path}: the column grain must count 1, 2, 3 ...")])
    return {column: table[column] for column in known if column in columns}


def _toml(value: Any) -> Any:
    if isinstance(value, Material):
        standard = MATERIALS.get(value.name)
        return value.name if standard == value else {k: v for k, v in value.given().items() if v != ""}
    if isinstance(value, np.ndarray | tuple):
        return [_toml(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
