"""LAMMPS input from the templates, and checks of the commands that a user adds to it."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ...chain.materials import Material
from ...errors import InputError, short
from ...integrators.methods import Splitting
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.files import check_not_foreign, expanded, write_aside
from .column import LammpsColumn, placeholders
from .worker import deck_steps

RUN_COMMAND = re.compile(r"""(?:^|["'])\s*(run|rerun|minimize|clear|quit)(?=["'\s]|$)""")
# Names of materials are the only free text of a scene. Text of a scene file must not enter decks.
CLOSED = (Material,)
STEPS_OF_A_RUN = 2**31 - 1  # Largest number of steps of a LAMMPS run.
LINES = 2**14  # Number of lines of a data file that are formatted at once.


def read_user_text(key: str, path: str | PathLike[str]) -> str:
    """Return the text of a user's file; raise `InputError` with `key` if it is unreadable."""
    path = expanded(path)
    if not path.is_file():
        raise InputError.at(key, f"there is no file {path}")
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError.at(key, f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise InputError.at(key, f"{path} is not text in UTF-8")
    return text


def read_include(include: str | PathLike[str]) -> str:
    """Return the commands in a file; a text with a line break is itself a text of commands."""
    text = os.fspath(include)
    if "\n" not in text:
        text = read_user_text("include", include)
    return text if text.endswith("\n") or not text else f"{text}\n"


def refuse_run(key: str, text: str, cure: str) -> None:
    """Raise `InputError` if user commands run the column or end LAMMPS."""
    for number, line in enumerate(text.splitlines(), 1):
        if match := RUN_COMMAND.search(line):
            raise InputError.at(
                key, f"the command {match[1]} (line {number}) cannot be used here: {cure}"
            )


def setup(column: LammpsColumn, data: str, step: float, splitting: Splitting, done: int = 0) -> str:
    """Return the commands that set up the column at time step `done`, from a data file."""
    refuse_run(
        "template",
        column.template,
        'use {% include "run.column" %} instead, which runs the column',
    )
    return _fill(column, step, splitting, done, data=f'"{data}"', alone=False)


def check_template(column: LammpsColumn, splitting: Splitting) -> None:
    """Raise `InputError` if the user's template cannot be filled in."""
    _fill(column, column.scene.duration, splitting, data="column.data", alone=True)


def script(column: LammpsColumn, step: float, splitting: Splitting) -> str:
    """Return the complete input script."""
    return _fill(column, step, splitting, data="column.data", alone=True)


def write_deck(column: LammpsColumn, path: Path, step: float, splitting: Splitting) -> Path:
    """Write the complete input script."""
    if splitting.order > 2 and (column.scene.excitation.does_work or column.chain.ground_in_time):
        acting = "a time-dependent ground" if column.chain.ground_in_time else "a drive or a force"
        raise InputError.at("integrator", f"must be verlet in a deck with {acting}")
    text = script(column, step, splitting)
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(f"{text.rstrip()}\n\n{_seal(text)}\n", encoding="utf-8")
    return path


def check_folder(folder: Path) -> None:
    """Raise `InputError` if a folder contains a deck or deck files that lmpchain did not write.

    The other files in the folder of a deck that lmpchain wrote belong to that deck.
    """
    path = folder / "in.column"
    if not path.exists():
        for name in ("column.data", "column.lammpstrj", "log.lammps"):
            check_not_foreign(folder / name, overwrite=False)
        return
    text, _, seal = read_user_text("folder", path).rstrip().rpartition("\n")
    if seal != _seal(text):
        cure = "choose another folder, or replace it (--force, or overwrite=True in Python)"
        raise InputError.at("folder", f"{path} was edited, or not written by lmpchain: {cure}")


def _seal(text: str) -> str:
    digest = hashlib.sha256(text.rstrip().encode()).hexdigest()
    return f"# as lmpchain wrote it: {digest[:16]} (an edited deck is not overwritten)"


def dump(path: str, every: int) -> str:
    """Return the commands of a complete deck that dump every `every`-th step."""
    # Jinja2 is imported only where text is filled in, because "auto" loads this module.
    from ...util.templates import render

    return render("dump.column", path=f'"{path}"', every=every)


def carries(splitting: Splitting) -> bool:
    """Return whether a deck can express this splitting with kicks by LAMMPS alone."""
    return splitting.order == 2 or bool(splitting.substeps)


def kicks_by_force(scene: Scene, splitting: Splitting) -> bool:
    """Return whether an external force is applied at the drift times of a splitting method."""
    excitation = scene.excitation
    force = excitation.does_work and not excitation.driven and excitation.wall is None
    return splitting.order > 2 and force


def check_carried(splitting: Splitting, key: str) -> None:
    """Raise `InputError` under this key if a deck cannot express the splitting."""
    if not carries(splitting):
        raise InputError.at(
            key, f"a deck cannot contain the kicks of {splitting.name}: use verlet or kahan-li6"
        )


def write_data(column: LammpsColumn, path: str | PathLike[str]) -> None:
    """Write the data file of a column."""
    with write_aside(path, overwrite=True) as aside, open(aside, "wb") as file:
        _write_data(column, file, whole=True)


@contextmanager
def data_file(column: LammpsColumn, folder: Path | None) -> Iterator[Path]:
    """Yield the path of a data file, in a folder or in memory; after a kill no file remains."""
    if folder is not None:
        write_data(column, path := folder / "column.data")
        yield path
        return
    with open(os.memfd_create("column.data"), "wb") as memory:
        _write_data(column, memory, whole=holds_motion(column, folder))
        memory.flush()
        yield Path(f"/proc/{os.getpid()}/fd/{memory.fileno()}")


def holds_motion(column: LammpsColumn, folder: Path | None) -> bool:
    """Return whether the data file contains velocities and heights at rest, for users.

    Otherwise the velocities are passed to LAMMPS in memory, which is much faster.
    """
    return folder is not None or not column.bare or bool(column.ground or column.viscosity)


def _write_data(column: LammpsColumn, file: BinaryIO, whole: bool) -> None:
    """Write the data file; only a `whole` file contains velocities and heights at rest."""
    from ...util.templates import render_pieces

    z, speeds = column.start
    if column.strike:
        # The deck applies the strike, so that its speed can be set on the command line.
        speeds = 0.0 * speeds
    types = np.array(column.types)
    atoms = "%d %d %s %s 0 0 %r\n"
    columns: tuple[Array, ...] = types, column.diameters, column.densities, z
    if column.predicts or column.formula:
        # Positions come first. The molecule of atom_style bond and the columns of sph come last.
        last = " 0" * bool(column.formula) + " 0 0 0" * column.predicts
        atoms = f"%d %d 0 0 %r %s %s{last}\n"
        columns = types, z, column.diameters, column.densities
    pieces = render_pieces(
        "column.data",
        CLOSED,
        column=column,
        whole=whole,
        atoms=_lines(atoms, *columns),
        speeds=_lines("%d 0 0 %r 0 0 0\n", speeds),
        heights=_lines("%d %r\n", column.heights),
        bonds=_bond_lines(column.bonds[0]) if column.formula else (),
        own=_own_lines(column),
    )
    file.writelines(piece.encode("ascii") for piece in pieces)


def _lines(line: str, *columns: Array) -> Iterator[str]:
    """Yield lines of a data file, many grains at a time: the number and these values.

    Values with %s are equal for many grains, so that each different value is converted once.
    """
    shared = [field == "s" for field in re.findall("%(.)", line)[1:]]
    for begin in range(0, columns[0].size, LINES):
        grains = slice(begin, begin + LINES)
        values = [
            _as_text(column[grains]) if alike else column[grains].tolist()
            for column, alike in zip(columns, shared, strict=True)
        ]
        rows = zip(range(begin + 1, begin + 1 + LINES), *values, strict=False)
        yield "".join(line % row for row in rows)


def _bond_lines(types: list[int]) -> Iterator[str]:
    """Yield the lines of the bonds: number, type and the two grains."""
    for number, bond_type in enumerate(types, 1):
        yield f"{number} {bond_type} {number} {number + 1}\n"


def _own_lines(column: LammpsColumn) -> Iterator[str]:
    """Yield the lines of the parameters that each grain has."""
    if own := column.own:
        yield from _lines(f"%d{' %r' * len(own)}\n", *own.values())


def _as_text(values: Array) -> list[str]:
    """Return numbers as text with all digits."""
    distinct, places = np.unique(values, return_inverse=True)
    texts: list[str] = np.array(list(map(repr, distinct.tolist())), object)[places].tolist()
    return texts


def _fill(
    column: LammpsColumn, step: float, splitting: Splitting, done: int = 0, **values: Any
) -> str:
    """Return the commands of the built-in deck or of the user's template."""
    from ...util.templates import render, render_text

    scene = column.scene
    # LAMMPS applies the kicks of velocity Verlet and its compositions; other kicks come from
    # outside.
    kicks = carries(splitting) and not kicks_by_force(scene, splitting)
    every = round(scene.sampling_interval / step)
    count = every * scene.intervals * deck_steps(splitting)
    if values["alone"] and count > STEPS_OF_A_RUN:
        most = f"{count} steps are more than LAMMPS counts in a run, {STEPS_OF_A_RUN}"
        raise InputError.at(
            "duration", f"{most}: use a shorter duration or longer steps, or lmpchain run"
        )
    values |= {
        "column": column,
        "step": step,
        "every": every,
        "samples": scene.intervals,
        "integrator": splitting.name,
        "substeps": splitting.substeps,
        "stride": f"$(v_every*{len(splitting.substeps)})" if splitting.substeps else "${every}",
        "fix": "mvv/dpd 1.0" if column.predicts else "nve" if kicks else "nve/noforce",
        "steps_a_step": deck_steps(splitting),
        "first_step": done * deck_steps(splitting),
        "start_time": done * step,
        # The command fix move requires equal steps; otherwise the velocities are set from outside.
        "moves": splitting.order == 2,
        "include": column.include,
        **placeholders(scene.excitation, scene.duration),
    }
    if not column.template:
        return render("in.column", CLOSED, **values)
    text = render_text(column.template, "template", CLOSED, **values)
    # Without this check, the user's commands could be missing from the deck without a message.
    if column.include not in text:
        raise InputError.at(
            "include", "the template does not contain {{ include }}: insert it where it belongs"
        )
    return text


COMMANDS = {
    "compute",
    "compute_modify",
    "dump",
    "dump_modify",
    "group",
    "print",
    "thermo",
    "thermo_modify",
    "thermo_style",
    "variable",
}
DUMPS = {"atom", "cfg", "custom", "grid", "image", "local", "xyz"}
PACKED = (".gz", ".bz2", ".lz4", ".lzma", ".xz", ".zst")  # Another program compresses these files.
FIXES = {"ave/time", "ave/chunk", "ave/histo", "print"}
VARIABLES = {"atom", "equal", "format", "index", "string", "vector"}
# A compute with one of these names compares with the positions or velocities at its creation.
REFERRING = ("msd", "vacf", "displace", "fep", "born")
ACCUMULATING = {"running", "window"}
OUTPUTS = "output-{}"  # One folder for each start of LAMMPS in a run folder.
TOKEN = re.compile(r"\"[^\"]*\"|'[^']*'|\S+")
FILE_NAME = re.compile(r"[\w.*%+-]*\w[\w.*%+-]*", re.ASCII)
# Names of the computes, fixes, groups, regions and variables of the set-up.
OURS = {
    *("even", "odd", "of_even", "of_odd", "sum_even", "sum_odd", "ground", "own", "viscous"),
    *("now_at", "side", "side_u", "side_v", "top_z", "wall_on", "wall_vz"),
    *("at_bottom", "at_top", "bottom", "drag", "drive", "driven", "mobile", "motion", "out"),
    *("friction", "press", "push", "pushed", "rest", "struck", "top", "weight"),
    *("top_at", "top_f", "top_k", "top_o"),
    *("amplitude", "cycles", "data", "drive_vz", "drive_z", "dt", "end", "envelope", "every"),
    *("frequency", "g", "load", "now", "omega", "phi", "samples", "time", "v0", "wall_at"),
    *("wall_z", "c0", "c1", "c2", "c3", "begin"),
}
WATCHERS = (
    "in a run folder, commands may only watch the run: compute, dump, group, print, thermo, "
    "variable, and fix ave/time, ave/chunk, ave/histo and print; leave the others out"
)


def find_fault(text: str) -> str:
    """Return the first command that may change the motion and the reason, or an empty text."""
    for number, line in enumerate(_join(text).split("\n"), 1):
        words = _words(line)
        if words and (fault := _fault(words)):
            return f"line {number} ({short(line.strip())}) {fault}; {WATCHERS}"
    return ""


def move_outputs(text: str, folder: Path) -> str:
    """Return fault-free commands with their output files moved to a folder."""
    lines = []
    for line in _join(text).split("\n"):
        words = _words(line)
        for place in _files(words):
            words[place] = f'"{folder / words[place]}"'
        lines.append(" ".join(words))
    return "\n".join(lines)


def make_outputs(run_folder: Path) -> Path:
    """Create and return a new folder for the files of this start of LAMMPS."""
    for number in count(1):
        folder = run_folder / OUTPUTS.format(number)
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError


def _join(text: str) -> str:
    """Return commands with continuation lines joined, as LAMMPS joins them."""
    return re.sub(r"&[ \t]*\n", " ", text)


def _words(line: str) -> list[str]:
    """Return the words of a command without its comment; a quoted text is one word."""
    words: list[str] = []
    for word in TOKEN.findall(line):
        if word.startswith("#"):
            break
        words.append(word)
    return words


def _fault(words: list[str]) -> str:
    """Return the reason why a command may change the motion; empty if it cannot."""
    command = words[0]
    if command not in COMMANDS | {"fix"}:
        return f"has the command {short(command)}"
    if any(word.count('"') % 2 or word.count("'") % 2 or '""' in word for word in words):
        return "has quotes that are not closed, or triple quotes"
    checks = {"compute": _compute_fault, "dump": _dump_fault, "fix": _fix_fault}
    checks |= {"group": _group_fault, "variable": _variable_fault}
    # LAMMPS removes quotes.
    bare = [word.strip("\"'") for word in words]
    fault = checks[command](bare[1:]) if command in checks else ""
    if command == "thermo_modify" and any(word.startswith("lost") for word in bare):
        fault = "changes the treatment of lost grains"
    return _name_fault(bare) or fault or _file_fault(words)


def _name_fault(words: list[str]) -> str:
    """Return whether a command uses a name of the set-up."""
    named = words[0] in ("compute", "fix", "group", "variable")
    for name in words[1:2] if named else []:
        if name in OURS or "$" in name:
            return f"has the name {short(name)}, which the set-up uses: choose another"
    return ""


def _compute_fault(arguments: list[str]) -> str:
    for style in arguments[2:3]:
        if any(part in style for part in REFERRING):
            return f"has the compute {style}, which refers to the state in which it was defined"
    if "once" in arguments:
        return "has the word once, which refers to the state at the start"
    return ""


def _dump_fault(arguments: list[str]) -> str:
    unknown = [style for style in arguments[2:3] if style not in DUMPS]
    return f"has the dump {short(unknown[0])}" if unknown else ""


def _fix_fault(arguments: list[str]) -> str:
    style = "".join(arguments[2:3])
    if style not in FIXES:
        return f"has the fix {short(style)}"
    if ACCUMULATING & set(arguments):
        return "averages over the whole run, which a stop interrupts: use ave one"
    return ""


def _group_fault(arguments: list[str]) -> str:
    if "".join(arguments[1:2]) in ("region", "variable"):
        return "selects grains by the state at the start"
    return ""


def _variable_fault(arguments: list[str]) -> str:
    # LAMMPS replaces ${name} by the value at the definition.
    if "".join(arguments[1:2]) in VARIABLES and "$" not in " ".join(arguments):
        return ""
    return "sets a variable from a file, another program, or the state at the start"


def _file_fault(words: list[str]) -> str:
    """Return whether a command may write a file outside the run folder."""
    given = [word for word in words if "$" in word and word[0] not in "\"'"]
    if words[0] in ("dump", "fix", "print") and given:
        return f"contains the variable {short(given[0])}: write its value"
    for place in _files(words):
        if not FILE_NAME.fullmatch(words[place]) or words[place].endswith(PACKED):
            return f"writes to {short(words[place])}: give a plain file name, not packed"
    return ""


def _files(words: list[str]) -> list[int]:
    """Return the positions of file names in a command."""
    if words[:1] == ["dump"]:
        return [5] if len(words) > 5 else []
    if words[:1] in (["fix"], ["print"]):
        places = zip(words, range(1, len(words)), strict=False)
        return [place for word, place in places if word.strip("\"'") in ("file", "append")]
    return []
