"""Commands of the user that watch a run and leave its motion alone, so that it can be resumed."""

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
PACKED = (".gz", ".bz2", ".lz4", ".lzma", ".xz", ".zst")  # another program packs these
FIXES = {"ave/time", "ave/chunk", "ave/histo", "print"}
VARIABLES = {"atom", "equal", "format", "index", "string", "vector"}
# a compute with one of these words compares with the positions or velocities where it was made
REFERRING = ("msd", "vacf", "displace", "fep", "born")
ACCUMULATING = {"running", "window"}
OUTPUTS = "output-{}"  # in a run folder: one folder for each start of LAMMPS
TOKEN = re.compile(r"\"[^\"]*\"|'[^']*'|\S+")
NAME = re.compile(r"[\w.*%+-]*\w[\w.*%+-]*", re.ASCII)
# names that the set-up gives to its own fixes, groups, regions and variables
OURS = {
    *("at_bottom", "at_top", "bottom", "drag", "drive", "driven", "mobile", "motion", "out"),
    *("press", "push", "pushed", "rest", "struck", "top", "weight"),
    *("amplitude", "cycles", "data", "drive_vz", "drive_z", "dt", "end", "envelope", "every"),
    *("frequency", "g", "load", "now", "omega", "phi", "samples", "time", "v0", "wall_at"),
    *("wall_z", "c0", "c1", "c2", "c3", "begin"),
}
CURE = (
    "in a run folder, commands may only watch the run: compute, dump, group, print, thermo, "
    "variable, and fix ave/time, ave/chunk, ave/histo and print; leave the others out"
)


def find_fault(text: str) -> str:
    """Return the first command that may do more than watch, and why, or nothing."""
    for number, line in enumerate(_join(text).split("\n"), 1):
        words = _words(line)
        if words and (fault := _fault(words)):
            return f"line {number} ({short(line.strip())}) {fault}; {CURE}"
    return ""


def move_outputs(text: str, folder: Path) -> str:
    """Return commands without a fault, with their files in a folder."""
    lines = []
    for line in _join(text).split("\n"):
        words = _words(line)
        for place in _files(words):
            words[place] = f'"{folder / words[place]}"'
        lines.append(" ".join(words))
    return "\n".join(lines)


def make_outputs(run_folder: Path) -> Path:
    """Make and return a new folder for the files of this start of LAMMPS."""
    for number in count(1):
        folder = run_folder / OUTPUTS.format(number)
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError


def _join(text: str) -> str:
    """Return commands with the lines joined that LAMMPS joins."""
    return re.sub(r"&[ \t]*\n", " ", text)


def _words(line: str) -> list[str]:
    """Return the words of a command without its comment; a quoted text is a word."""
    words: list[str] = []
    for word in TOKEN.findall(line):
        if word.startswith("#"):
            break
        words.append(word)
    return words


def _fault(words: list[str]) -> str:
    """Return why a command may do more than watch, or nothing."""
    command, *arguments = words
    if command not in COMMANDS | {"fix"}:
        return f"has the command {short(command)}"
    if any(word.count('"') % 2 or word.count("'") % 2 or '""' in word for word in words):
        return "has quotes that are not closed, or three"
    given = [word for word in arguments if "$" in word and word[0] not in "\"'"]
    if command in ("dump", "fix", "print") and given:
        return f"gives a word by a variable, {short(given[0])}: write it out"
    if command in ("compute", "fix", "group", "variable") and arguments[:1]:
        name = arguments[0]
        if name in OURS or "$" in name:
            return f"has the name {short(name)}, which the set-up has, too: choose another"
    style = (arguments[2:3] if command in ("compute", "fix") else arguments[1:2]) or [""]
    if command == "dump" and arguments[2:3] and arguments[2] not in DUMPS:
        return f"has the dump {short(arguments[2])}"
    if command == "fix" and style[0] not in FIXES:
        return f"has the fix {short(style[0])}"
    if command == "compute" and any(part in style[0] for part in REFERRING):
        return f"has the compute {style[0]}, which refers to where the run was when it was set"
    if command == "variable" and (style[0] not in VARIABLES or "$(" in " ".join(words)):
        return "sets a variable from a file, another program, or the state at the start"
    if command == "thermo_modify" and "lost" in arguments:
        return "changes what happens to lost grains"
    if command == "fix" and ACCUMULATING & set(arguments):
        return "averages over the whole run, which a stop interrupts: use ave one"
    for place in _files(words):
        if not NAME.fullmatch(words[place]) or words[place].endswith(PACKED):
            return f"writes to {short(words[place])}: give a plain file name, not packed"
    return ""


def _files(words: list[str]) -> list[int]:
    """Return where the names of files stand in a command."""
    if words[:1] == ["dump"]:
        return [5] if len(words) > 5 else []
    if words[:1] in (["fix"], ["print"]):
        places = zip(words, range(1, len(words)), strict=False)
        return [place for word, place in places if word.strip("\"'") in ("file", "append")]
    return []
