"""Scene files: TOML in and out, with every fault listed at once under its key."""

from __future__ import annotations

import csv
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..chain.chain import Chain
from ..chain.damping import Damping
from ..chain.law import Law
from ..chain.materials import MATERIALS, Impurity, Material
from ..chain.patterns import IN_FILES, write_out
from ..errors import InputError, did_you_mean, not_among, short, shown, unknown_key
from ..util.files import check_readable, expanded
from ..util.validation import Checked, make_unchecked
from .base import Excitation
from .excitation import EXCITATIONS, Profile
from .facts import SceneFacts
from .recording import Recording
from .trace_file import Measured


@dataclass(frozen=True)
class FileSizes:
    """Limits on the sizes of files.

    Attributes
    ----------
    scene : int
        Largest size of a scene file or sweep file, bytes.
    table : int
        Largest size of a CSV file, bytes.
    line : int
        Largest length of a line of a CSV file, characters.
    """

    scene: int = 2**25
    table: int = 2**33
    line: int = 2**20


FILE_SIZES = FileSizes()
SECTIONS = ("chain", "excitation", "recording")
# Keys of [chain]: arguments of a chain in Python, of patterns, and a file with a row for each
# grain.
CHAIN_KEYS = (*Chain.arguments, *IN_FILES, "file")
# Options of a run, which are not part of a scene.
OF_RUNS = ("engine", "tolerance", "integrator", "step", "threads", "ranks")
# Patterns of lines that are not valid TOML, with the remedy; the first match is used.
CURES = (
    (r"[\u2018\u2019\u201c\u201d]", 'use straight quotes, "'),
    (r"^\s*[\w.-]+\s*:", "write key = value"),
    (r"=\s*(True|False)\b", "write true or false, in small letters"),
    (r"=\s*\[?\s*[A-Za-z]", 'text needs quotes, as in kind = "impulse"'),
    (r"=[^\"']*\d,\d+\s*$", "numbers have a point, not a comma"),
    (r"=[^\"']*\.(\D|$)", "numbers need a digit after the point"),
    (r"=[^\"']*(^|\D)\.\d", "numbers need a digit before the point"),
    (r"=\s*[-+.\deE]+\s*[A-Za-zµ]", "give the number alone, in SI units"),
    (r"=\s*$", "give a value"),
    (r"^\s*\[[^\]]*$", "close the bracket"),
    (r"=\s*\"[^\"]*$", "close the quotes"),
)


def read_fields(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of a scene from a file; raise `InputError` with all of its faults."""
    path = expanded(path)
    return fields(parse(path), path.parent)


def fields(data: dict[str, Any], folder: Path | None = Path()) -> dict[str, Any]:
    """Return the fields of a scene from tables; CSV files are in `folder`."""
    faults = list(_section_faults(data))
    chain = _section(data, "chain", lambda keys: _chain(keys, folder), faults)
    excitation = _section(data, "excitation", lambda keys: _excitation(keys, folder), faults)
    recording = _section(data, "recording", lambda keys: Recording(**keys), faults)
    faults += _misfits(data, chain, excitation, recording)
    # A section without an object has reported a fault.
    if faults:
        raise InputError(faults)
    return {"chain": chain, "excitation": excitation, **recording.given()}


def _section(
    data: dict[str, Any],
    section: str,
    make: Callable[[dict[str, Any]], Any],
    faults: list[tuple[str, str]],
) -> Any:
    """Return the object that a section describes; None after adding its faults to the others."""
    table = data.get(section)
    if not isinstance(table, dict):
        return None
    try:
        # The table is copied, because its keys are removed in `make`.
        return make(dict(table))
    except InputError as error:
        faults += error.under(section)
        return None


def _misfits(
    data: dict[str, Any],
    chain: Chain | None,
    excitation: Excitation | None,
    recording: Recording | None,
) -> Iterator[tuple[str, str]]:
    """Yield the faults of an excitation and a recording that do not match the chain."""
    # Even if the chain has faults, its length and ends may be valid.
    stand_in = chain or _of_this_length(data.get("chain"))
    if not stand_in:
        return
    if excitation:
        duration = recording.duration if recording else 0.0
        # The cut-off frequency of a packet is not known without the chain itself.
        faults = [
            (key, text)
            for key, text in excitation.faults(stand_in, duration)
            if chain or key != "frequency"
        ]
        if chain and not faults:
            facts = {"chain": chain, "excitation": excitation, "duration": duration}
            faults = list(make_unchecked(SceneFacts, **facts).strike_faults())
        yield from InputError(faults).under("excitation")
    if recording:
        yield from InputError(recording.faults(stand_in)).under("recording")


def _section_faults(data: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield faults of unknown sections, missing sections, and sections that are not tables."""
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
    """Return the remedy for a key that is not a section."""
    fields: dict[str, Iterable[str]] = {
        "recording": Recording.arguments,
        "chain": CHAIN_KEYS,
        "excitation": [key for kind in EXCITATIONS.values() for key in _excitation_keys(kind)],
    }
    homes = " or ".join(f"[{section}]" for section, keys in fields.items() if key in keys)
    if homes:
        return f"belongs to a section: put it below the line {homes}"
    if option := next((name for name in OF_RUNS if did_you_mean(key, [name])), ""):
        guess = did_you_mean(key, [option]) if option != key else ""
        cure = f"the scene is run with lmpchain run SCENE.toml --{option} ..."
        return f"belongs to a run, not to its scene{guess}: take it out; {cure}"
    return f"unknown section{did_you_mean(key, SECTIONS)}; the sections are {', '.join(SECTIONS)}"


def _excitation_keys(kind: type[Excitation]) -> list[str]:
    """Return the keys of the table of an excitation of this kind."""
    return ["kind", *kind.arguments, *kind.other_arguments]


def _make(
    make: Callable[[dict[str, Any]], Any], keys: Mapping[str, Any], known: Sequence[str]
) -> Any:
    """Return the object of the known keys; raise `InputError` with all its faults."""
    faults = [(key, unknown_key(key, known)) for key in keys if key not in known]
    try:
        made = make({key: value for key, value in keys.items() if key in known})
    except InputError as error:
        faults += error.faults
    if faults:
        raise InputError(faults)
    return made


def _of_this_length(table: Any) -> Chain | None:
    """Return a valid chain of this length and ends, to check other tables with."""
    keys = table.keys() & {"grains", "top", "bottom"} if isinstance(table, dict) else ()
    try:
        given = {key: table[key] for key in keys}
        # A packet requires a load, which a chain with a free bottom cannot carry.
        load = 0.0 if given.get("bottom") == "free" else 1.0
        return Chain(**given, diameter=1e-3, gravity=0.0, top_load=load)
    except InputError:
        return None


def tables(chain: Chain, excitation: Excitation, recording: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scene file; `recording` supplies the options of a recording."""
    law = chain.given().get("law")
    if law is not None and not isinstance(law, Law):
        chain = chain.replace(law=None, exponent=law.power_of("a scene file"))
    return {
        "chain": _table(chain),
        "excitation": {"kind": excitation.kind} | _table(excitation),
        "recording": {
            key: _toml(recording[key]) for key in Recording.arguments if key in recording
        },
    }


def parse(path: Path) -> dict[str, Any]:
    """Parse a TOML file into tables; raise `InputError` if it cannot be read."""
    name = str(path)
    try:
        check_readable(path, FILE_SIZES.scene)
        # Editors on Windows begin a file with a byte-order mark, which utf-8-sig removes.
        text = path.read_bytes().decode("utf-8-sig")
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
    # The name contains a null character.
    except ValueError as error:
        raise InputError.at(name, f"cannot be read: {error}") from None
    return parse_text(text, name)


def parse_text(text: str, name: str) -> dict[str, Any]:
    """Return the tables of the text of a scene file; `name` is the file name in messages."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError.at(name, f"is not valid TOML: {error}{_cure(text, error)}") from None
    except RecursionError:
        raise InputError.at(name, "is not valid TOML: nested too deeply") from None
    # A number has thousands of digits.
    except ValueError as error:
        raise InputError.at(name, f"cannot be read: {error}") from None


def _cure(text: str, error: tomllib.TOMLDecodeError) -> str:
    """Return the remedy for the line that an error names, in brackets; empty if unknown."""
    if "overwrite" in str(error) or "twice" in str(error):
        return " (give each key and each table once)"
    number = re.search(r"at line (\d+)", str(error))
    if not number:
        return ""
    # In tomllib, lines end at \n only.
    line = text.split("\n")[int(number[1]) - 1]
    cures = (cure for pattern, cure in CURES if re.search(pattern, line))
    cure = next(cures, "")
    return f" ({cure})" if cure else ""


def _chain(keys: dict[str, Any], folder: Path | None) -> Chain:
    return _make(lambda known: _known_chain(known, folder), keys, CHAIN_KEYS)


def _known_chain(keys: dict[str, Any], folder: Path | None) -> Chain:
    if "file" in keys:
        if patterns := [key for key in IN_FILES if key in keys]:
            cure = "the file describes every grain already; remove this key or the file"
            raise InputError([(key, cure) for key in patterns])
        path = _file(folder, keys.pop("file"))
        columns = _csv(path, ("material", "diameter", "mass"))
        # If a column is also in the table, its meaning is ambiguous.
        if twice := [key for key in columns if key in keys or (key == "mass" and "masses" in keys)]:
            raise InputError(
                [(key, "is in the file already; remove it from one of them") for key in twice]
            )
        if "diameter" not in columns:
            raise InputError.at("file", "has no column diameter (m)")
        if "mass" in columns:
            columns["masses"] = columns.pop("mass")
        keys = {"grains": len(columns["diameter"])} | columns | keys
    return Chain(**write_out(keys))


def _excitation(keys: dict[str, Any], folder: Path | None) -> Excitation:
    kind = keys.pop("kind", None)
    if not isinstance(kind, str) or kind not in EXCITATIONS:
        # A misspelling such as "kid" may be meant for it.
        guesses = "".join(
            f"; {shown(key)} is unknown{guess}"
            for key in keys
            if (guess := did_you_mean(key, ["kind"]))
        )
        missing = f"is missing; {' | '.join(EXCITATIONS)}{guesses}"
        raise InputError.at("kind", missing if kind is None else not_among(kind, EXCITATIONS))
    excitation = EXCITATIONS[kind]
    if isinstance(start := keys.get("start"), dict):
        try:
            keys["start"] = Profile(**_beside(start, folder))
        except InputError as error:
            raise InputError(error.under("start")) from None
    if issubclass(excitation, Measured):
        keys = _beside(keys, folder)
    return _make(lambda known: excitation(**known), keys, _excitation_keys(excitation))


def _beside(keys: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    """Return keys in which the names of files in a folder are replaced by their paths."""
    return {**keys, "file": _file(folder, keys["file"])} if "file" in keys else dict(keys)


def _file(folder: Path | None, name: Any) -> Path:
    """Return the path of a file that a scene in a folder refers to."""
    if not isinstance(name, str):
        raise InputError.at("file", "must be the name of a CSV file")
    if folder is None:
        cure = "give the numbers themselves"
        raise InputError.at("file", f"a scene without a folder cannot name a file: {cure}")
    return folder / expanded(name)


def count_grains(name: Any, folder: Path) -> int:
    """Return the number of grains in the CSV file of a chain; raise `InputError` if invalid."""
    _, rows = _read_table(_file(folder, name))
    return len(rows)


def _csv(path: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return columns from a CSV file: lists of numbers, or of words for `material`."""
    header, lines = _read_table(path)
    # A row is a grain, and a column may number the grains.
    _check_header(path, header, names, {"grain"})
    _check_rows(path, lines, len(header))
    rows = list(lines.values())
    columns: dict[str, Any] = dict(zip(header, zip(*rows, strict=True), strict=True))
    for key in columns.keys() - {"material"}:
        try:
            columns[key] = [float(value) for value in columns[key]]
        except ValueError as error:
            message = f"{path}: the column {key} must contain numbers ({short(error)})"
            raise InputError.at("file", message) from None
    count = [float(number) for number in range(1, len(rows) + 1)]
    if columns.pop("grain", count) != count:
        raise InputError.at("file", f"{path}: the column grain must count 1, 2, 3 ...")
    return columns


def _read_table(path: Path) -> tuple[list[str], dict[int, list[str]]]:
    """Return the header and the rows of a CSV file, by the numbers of their lines from 1."""
    try:
        check_readable(path, FILE_SIZES.table)
        # Spreadsheets begin a file with a byte-order mark, which utf-8-sig removes.
        with open(path, encoding="utf-8-sig", newline="") as opened:
            # A file with a single endless line would fill the memory.
            reader = csv.reader(iter(lambda: opened.readline(FILE_SIZES.line), ""))
            lines = ((reader.line_num, _cells(row)) for row in reader)
            rows = {line: cells for line, cells in lines if cells}
            header = rows.pop(min(rows))
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "not a table with a header"
        raise InputError.at("file", f"{path} cannot be read as CSV: {reason}") from None
    return header, rows


def _cells(row: Sequence[str]) -> list[str]:
    """Return the cells of a row without the empty cells that spreadsheets append."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _check_header(
    path: Path, header: Sequence[str], names: Sequence[str], counters: set[str]
) -> None:
    """Raise `InputError` unless a header consists of some of these names and counters only."""
    columns = set(header)
    strange = columns - {*names, *counters}
    if strange or columns.isdisjoint(names) or len(columns) < len(header):
        message = f"{path} must have a header with some of {', '.join(names)}"
        raise InputError.at("file", message)


def _check_rows(path: Path, rows: Mapping[int, Sequence[str]], length: int) -> None:
    """Raise `InputError` unless there are rows, all of this length."""
    for line, row in rows.items():
        if len(row) != length:
            message = f"{path}, line {line}: must have {length} values, as the header has"
            raise InputError.at("file", message)
    if not rows:
        raise InputError.at("file", f"{path} has a header but no rows below it")


def _table(options: Checked) -> dict[str, Any]:
    """Return options as a TOML table, without values of None."""
    return {key: _toml(value) for key, value in options.given().items() if value is not None}


def _toml(value: Any) -> Any:
    """Return a value in TOML types: materials by name, arrays as lists, Python numbers."""
    if isinstance(value, Material):
        # The name is sufficient if it denotes this material in the package.
        if MATERIALS.get(value.name) == value:
            return value.name
        return {key: constant for key, constant in value.given().items() if constant != ""}
    if isinstance(value, Damping | Impurity | Profile):
        return _table(value)
    if isinstance(value, Law):
        return value.table()
    if isinstance(value, np.ndarray | tuple):
        return [_toml(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
