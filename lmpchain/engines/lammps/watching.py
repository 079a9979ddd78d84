"""User commands that only observe a run and do not change its motion, so that it can be resumed."""

from __future__ import annotations

import re
from itertools import count
from pathlib import Path

from ...errors import short

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
# Names of the fixes, groups, regions and variables of the set-up.
OURS = {
    *("at_bottom", "at_top", "bottom", "drag", "drive", "driven", "mobile", "motion", "out"),
    *("press", "push", "pushed", "rest", "struck", "top", "weight"),
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
    checks |= {"variable": _variable_fault}
    fault = checks[command](words[1:]) if command in checks else ""
    if command == "thermo_modify" and "lost" in words:
        fault = "changes the treatment of lost grains"
    return _name_fault(words) or fault or _file_fault(words)


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


def _variable_fault(arguments: list[str]) -> str:
    if "".join(arguments[1:2]) in VARIABLES and "$(" not in " ".join(arguments):
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
