"""Scene files: TOML in and out, with every fault listed at once under its key."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..chain.chain import Chain
from ..chain.impurities import Impurity
from ..chain.materials import MATERIALS, Material
from ..errors import InputError, short, shown
from ..util.files import check_readable
from ..util.suggestions import did_you_mean, not_among
from .base import Excitation
from .excitation import EXCITATIONS, Profile
from .recording import Recording
from .strike import squeezed, strike_faults, surroundings

LARGEST_FILE, LARGEST_TABLE = 2**25, 2**33  # bytes
LONGEST_LINE = 2**20  # of a table, characters
SECTIONS = ("chain", "excitation", "recording")
T = TypeVar("T")


def read(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of a scene from a file; raises `InputError` with every fault in it."""
    path = Path(path)
    return fields(parse(path), path.parent)


def fields(data: dict[str, Any], folder: Path | None = Path()) -> dict[str, Any]:
    """Return the fields of a scene from the tables of its file; its CSV files lie in `folder`."""
    faults: list[tuple[str, str]] = []

    def attempt(section: str, make: Callable[[dict[str, Any]], T]) -> T | None:
        if section not in given:
            return None
        try:
            return make(given[section])
        except InputError as error:
            faults.extend(error.under(section))
            return None

    faults += [(key, _misplaced(key)) for key in data if key not in SECTIONS]
    given: dict[str, dict[str, Any]] = {}
    for section in SECTIONS:
        table = data.get(section)
        if isinstance(table, dict):
            given[section] = dict(table)
        elif table is None:
            faults.append((section, f"is missing; add a [{section}] table"))
        else:
            faults.append((section, f"must be a table, [{section}]"))

    chain = attempt("chain", lambda keys: _chain(keys, folder))
    excitation = attempt("excitation", lambda keys: _excitation(keys, folder))
    recording = attempt("recording", lambda keys: Recording(**keys))
    counted = chain or _of_this_length(given.get("chain", {}))
    if counted and excitation:
        found = list(excitation.faults(counted, recording.duration if recording else 0.0))
        if chain and not found:
            found = list(strike_faults(excitation, *squeezed(*surroundings(chain, excitation))))
        faults.extend(InputError(found).under("excitation"))
    if counted and recording:
        faults.extend(InputError(recording.faults(counted)).under("recording"))
    if faults:
        raise InputError(faults)
    assert chain
    assert excitation
    assert recording
    return {"chain": chain, "excitation": excitation, **recording.given()}


def _misplaced(key: str) -> str:
    """Return what to do about something that is no section."""
    of_excitations = [key for kind in EXCITATIONS.values() for key in kind.arguments]
    fields: dict[str, Iterable[str]] = {
        "recording": Recording.arguments,
        "chain": Chain.arguments,
        "excitation": ["kind", *of_excitations],
    }
    homes = " or ".join(f"[{section}]" for section, keys in fields.items() if key in keys)
    if homes:
        return f"belongs to a section: put it below the line {homes}"
    return f"unknown section{did_you_mean(key, SECTIONS)}; the sections are {', '.join(SECTIONS)}"


def _of_this_length(table: dict[str, Any]) -> Chain | None:
    """Return a sound chain with the grains and ends of a faulty one, to check other tables against."""
    kept = {key: table[key] for key in ("grains", "top", "bottom") if key in table}
    try:
        return Chain(**kept, diameter=1e-3, gravity=0.0)
    except InputError:
        return None


def tables(chain: Chain, excitation: Excitation, recording: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scene file; of `recording`, what is recorded is taken."""
    struck = {"kind": excitation.kind}
    return {
        "chain": {key: _toml(value) for key, value in chain.given().items() if value is not None},
        "excitation": struck
        | {key: _toml(value) for key, value in excitation.given().items() if value is not None},
        "recording": {
            key: _toml(recording[key]) for key in Recording.arguments if key in recording
        },
    }


def parse(path: Path) -> dict[str, Any]:
    """Return what a TOML file holds; raises `InputError` if it cannot be read."""
    name = str(path)
    try:
        check_readable(path, LARGEST_FILE)
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError([(name, "there is no such file")]) from None
    except OSError as error:
        raise InputError(
            [(name, f"cannot be read: {error.strerror}; name a scene file (TOML)")]
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            [(name, "is not text in UTF-8; a scene file is a TOML text file")]
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            [(name, f"is not valid TOML: {error} (numbers need a digit after the point)")]
        ) from None
    except RecursionError:
        raise InputError([(name, "is not valid TOML: nested too deeply")]) from None
    except ValueError as error:  # a number of thousands of digits; a name with a null character
        raise InputError([(name, f"cannot be read: {error}")]) from None


def _chain(keys: dict[str, Any], folder: Path | None) -> Chain:
    if "file" in keys:
        columns = _csv(folder, keys.pop("file"), ("material", "diameter", "mass"))
        if twice := [key for key in columns if key in keys or (key == "mass" and "masses" in keys)]:
            raise InputError(
                [(key, "is in the file already; take it out of one of them") for key in twice]
            )
        if "diameter" not in columns:
            raise InputError([("file", "has no column diameter (m)")])
        if "mass" in columns:
            columns["masses"] = columns.pop("mass")
        keys = {"grains": len(columns["diameter"])} | columns | keys
    return Chain(**keys)


def _excitation(keys: dict[str, Any], folder: Path | None) -> Excitation:
    kind = keys.pop("kind", None)
    if not isinstance(kind, str) or kind not in EXCITATIONS:
        meant = "".join(
            f"; {shown(key)} is unknown{guess}"
            for key in keys
            if (guess := did_you_mean(key, ["kind"]))
        )
        missing = f"is missing; {' | '.join(EXCITATIONS)}{meant}"
        raise InputError([("kind", missing if kind is None else not_among(kind, EXCITATIONS))])
    made = EXCITATIONS[kind]
    _fill(keys, made, folder)
    if isinstance(start := keys.get("start"), dict):
        try:
            keys["start"] = Profile(**_fill(dict(start), Profile, folder))
        except InputError as error:
            raise InputError(error.under("start")) from None
    return made(**keys)


def _fill(keys: dict[str, Any], made: type[Excitation], folder: Path | None) -> dict[str, Any]:
    """Put the columns of a CSV file in the place of its name."""
    if made.columns and "file" in keys:
        columns = _csv(folder, keys.pop("file"), tuple(made.columns))
        keys |= {made.columns[name]: column for name, column in columns.items()}
    return keys


def _csv(folder: Path | None, name: Any, known: Sequence[str]) -> dict[str, Any]:
    """Read the known columns of a CSV file with a header, as lists of numbers, of words for `material`."""
    if not isinstance(name, str):
        raise InputError([("file", "must be the name of a CSV file")])
    if folder is None:
        raise InputError(
            [("file", "a scene without a folder can name no file: give the numbers themselves")]
        )
    path = folder / name
    try:
        check_readable(path, LARGEST_TABLE)
        with open(path, encoding="utf-8-sig", newline="") as opened:
            lines = iter(lambda: opened.readline(LONGEST_LINE), "")
            header, *rows = (
                [cell.strip() for cell in row] for row in csv.reader(lines) if any(row)
            )
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "not a table with a header"
        raise InputError([("file", f"{path} cannot be read as CSV: {reason}")]) from None
    counted = "time" not in known  # a row a grain, so that a column may count them
    if (
        set(header) - {*known, *(["grain"] if counted else [])}
        or not set(header) & set(known)
        or len(set(header)) < len(header)
    ):
        raise InputError([("file", f"{path} must have a header with some of {', '.join(known)}")])
    if bad := next((line for line, row in enumerate(rows, 2) if len(row) != len(header)), 0):
        raise InputError(
            [("file", f"{path}, line {bad}: must have {len(header)} values, as the header has")]
        )
    columns: dict[str, Any] = (
        dict(zip(header, zip(*rows, strict=True), strict=True)) if rows else {}
    )
    if not rows:
        raise InputError([("file", f"{path} has a header and nothing below it")])
    for key in columns.keys() - {"material"}:
        try:
            columns[key] = [float(value) for value in columns[key]]
        except ValueError as error:
            raise InputError(
                [("file", f"{path}: the column {key} must hold numbers ({short(error)})")]
            ) from None
    if columns.pop("grain", None) not in (None, [float(n) for n in range(1, len(rows) + 1)]):
        raise InputError([("file", f"{path}: the column grain must count 1, 2, 3 ...")])
    return columns


def _toml(value: Any) -> Any:
    if isinstance(value, Material):
        standard = MATERIALS.get(value.name)
        return (
            value.name if standard == value else {k: v for k, v in value.given().items() if v != ""}
        )
    if isinstance(value, Impurity | Profile):
        return {k: _toml(v) for k, v in value.given().items() if v is not None}
    if isinstance(value, np.ndarray | tuple):
        return [_toml(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
