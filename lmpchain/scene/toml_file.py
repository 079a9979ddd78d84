"""Scene files: TOML in and out, with every fault listed at once under its key."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class FileSizes:
    """Largest files that are read.

    Attributes
    ----------
    scene, table : int
        Of a scene or sweep, and of a CSV file, bytes.
    line : int
        Of a CSV file, characters.
    """

    scene: int = 2**25
    table: int = 2**33
    line: int = 2**20


FILE_SIZES = FileSizes()
SECTIONS = ("chain", "excitation", "recording")
T = TypeVar("T")


def read(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of a scene from a file; raises `InputError` with every fault in it."""
    path = Path(path)
    return fields(parse(path), path.parent)


def fields(data: dict[str, Any], folder: Path | None = Path()) -> dict[str, Any]:
    """Return the fields of a scene from the tables of its file; its CSV files lie in `folder`."""
    faults = list(_section_faults(data))
    given = {key: dict(data[key]) for key in SECTIONS if isinstance(data.get(key), dict)}

    def attempt(section: str, make: Callable[[dict[str, Any]], T]) -> T | None:
        if section not in given:
            return None
        try:
            return make(given[section])
        except InputError as error:
            faults.extend(error.under(section))
            return None

    chain = attempt("chain", lambda keys: _chain(keys, folder))
    excitation = attempt("excitation", lambda keys: _excitation(keys, folder))
    recording = attempt("recording", lambda keys: Recording(**keys))
    counted = chain or _of_this_length(given.get("chain", {}))
    if counted and excitation:
        duration = recording.duration if recording else 0.0
        misfits = list(excitation.faults(counted, duration))
        if chain and not misfits:
            misfits = list(strike_faults(excitation, *squeezed(*surroundings(chain, excitation))))
        faults.extend(InputError(misfits).under("excitation"))
    if counted and recording:
        faults.extend(InputError(recording.faults(counted)).under("recording"))
    if faults or not (chain and excitation and recording):
        raise InputError(faults)
    return {"chain": chain, "excitation": excitation, **recording.given()}


def _section_faults(data: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield keys that are no sections, and sections that are missing or no tables."""
    for key in data:
        if key not in SECTIONS:
            yield key, _misplaced(key)
    for section in SECTIONS:
        table = data.get(section)
        if table is None:
            yield section, f"is missing; add a [{section}] table"
        elif not isinstance(table, dict):
            yield section, f"must be a table, [{section}]"


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
    """Return a sound chain of this length and ends, to check other tables against."""
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
        check_readable(path, FILE_SIZES.scene)
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError.at(name, "there is no such file") from None
    except OSError as error:
        raise InputError.at(
            name, f"cannot be read: {error.strerror}; name a scene file (TOML)"
        ) from None
    except UnicodeDecodeError:
        raise InputError.at(
            name, "is not text in UTF-8; a scene file is a TOML text file"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError.at(
            name, f"is not valid TOML: {error} (numbers need a digit after the point)"
        ) from None
    except RecursionError:
        raise InputError.at(name, "is not valid TOML: nested too deeply") from None
    except ValueError as error:  # a number of thousands of digits; a name with a null character
        raise InputError.at(name, f"cannot be read: {error}") from None


def _chain(keys: dict[str, Any], folder: Path | None) -> Chain:
    if "file" in keys:
        columns = _csv(folder, keys.pop("file"), ("material", "diameter", "mass"))
        if twice := [key for key in columns if key in keys or (key == "mass" and "masses" in keys)]:
            raise InputError(
                [(key, "is in the file already; take it out of one of them") for key in twice]
            )
        if "diameter" not in columns:
            raise InputError.at("file", "has no column diameter (m)")
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
        raise InputError.at("kind", missing if kind is None else not_among(kind, EXCITATIONS))
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
    """Return known columns of a CSV file: lists of numbers, of words for `material`."""
    if not isinstance(name, str):
        raise InputError.at("file", "must be the name of a CSV file")
    if folder is None:
        cure = "give the numbers themselves"
        raise InputError.at("file", f"a scene without a folder can name no file: {cure}")
    path = folder / name
    header, rows = _read_table(path)
    # where a row is a grain, a column may count the grains
    counters = set() if "time" in known else {"grain"}
    _check_table(path, header, rows, known, counters)
    columns: dict[str, Any] = dict(zip(header, zip(*rows, strict=True), strict=True))
    for key in columns.keys() - {"material"}:
        try:
            columns[key] = [float(value) for value in columns[key]]
        except ValueError as error:
            message = f"{path}: the column {key} must hold numbers ({short(error)})"
            raise InputError.at("file", message) from None
    count = [float(number) for number in range(1, len(rows) + 1)]
    if columns.pop("grain", count) != count:
        raise InputError.at("file", f"{path}: the column grain must count 1, 2, 3 ...")
    return columns


def _read_table(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows of a CSV file."""
    try:
        check_readable(path, FILE_SIZES.table)
        with open(path, encoding="utf-8-sig", newline="") as opened:
            lines = iter(lambda: opened.readline(FILE_SIZES.line), "")
            filled = (row for row in csv.reader(lines) if any(row))
            header, *rows = ([cell.strip() for cell in row] for row in filled)
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "not a table with a header"
        raise InputError.at("file", f"{path} cannot be read as CSV: {reason}") from None
    return header, rows


def _check_table(
    path: Path,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    known: Sequence[str],
    counters: set[str],
) -> None:
    """Raise `InputError` unless a table has known columns and full rows."""
    names = set(header)
    if names - {*known, *counters} or not names & {*known} or len(names) < len(header):
        message = f"{path} must have a header with some of {', '.join(known)}"
        raise InputError.at("file", message)
    for line, row in enumerate(rows, 2):
        if len(row) != len(header):
            message = f"{path}, line {line}: must have {len(header)} values, as the header has"
            raise InputError.at("file", message)
    if not rows:
        raise InputError.at("file", f"{path} has a header and nothing below it")


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
