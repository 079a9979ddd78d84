"""The command `new`: write a commented example scene, and its file of an instrument if any."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..util.tables import wrap
from .common import STDOUT, beside, collect, output, written

# Examples, and what each of them shows.
EXAMPLES = {
    "column": "glass beads under gravity, struck on the top one",
    "striker": "a ball of PTFE strikes a precompressed row of steel balls",
    "dimer": "steel and aluminium in turn, pressed together: a gap between two bands",
    "driven": "a burst of a piezo travels down a precompressed row",
    "hammer": "the force of an impact hammer, from the file of an oscilloscope, on steel balls",
    "vibrometer": "a shaker drives a row of PTFE balls by a measured motion",
    "disorder": "balls of random diameters scatter a wave",
    "law": "a Toda chain, by a contact law of its own",
    "lammps": "steel balls on a wall, as a LAMMPS deck and in LAMMPS",
}


# Examples with a file of an instrument, which is written beside the scene.
WITH_DATA = ("hammer", "vibrometer")


def new(arguments: argparse.Namespace) -> int:
    """Write a commented scene, and the file of an instrument that it names, if any."""
    example = arguments.example
    name = arguments.new_scene
    path, data = collect(
        lambda: _new(name, ".toml", arguments.force),
        lambda: (
            _new(beside(name, ".csv"), ".csv", arguments.force) if example in WITH_DATA else None
        ),
    )
    # The name stands in comments, which a line break would end.
    if not name.isprintable():
        raise InputError.at("scene", "must be a name of letters that can be printed")
    if data and path == STDOUT:
        raise InputError.at(name, f"{example} has a file beside its scene: name a file")
    from ..util.files import write_aside
    from ..util.templates import render

    if path == STDOUT:
        # The comments name the file that the reader of the text will make.
        name = "scene.toml"
    quoted = shlex.quote(name)
    names: dict[str, Any] = {"scene": quoted, "stem": shlex.quote(beside(name, ""))}
    if data:
        # The file lies in the folder of the scene. TOML quotes texts as JSON does.
        names |= {"data": data.name, "quoted_data": json.dumps(data.name, ensure_ascii=False)}
        with write_aside(data, overwrite=True) as aside:
            aside.write_text(render(f"examples/{example}.csv"), encoding="utf-8")
    with written(path) as file, write_aside(file, overwrite=True) as aside:
        aside.write_text(render(f"examples/{example}.toml", **names), encoding="utf-8")
    print(f"scene: {'standard output' if path == STDOUT else path} ({EXAMPLES[example]})")
    if data:
        print(f"data: {data}")
    print(f"next: lmpchain compare {quoted} -o {shlex.quote(beside(name, '.png'))}")
    print(f"      lmpchain run {quoted}")
    print(
        "\n".join(wrap("other examples: " + ", ".join(key for key in EXAMPLES if key != example)))
    )
    return 0


def _new(name: str, suffix: str, force: bool) -> Path:
    """Return the path of a file to write; a file that is there is replaced only by force."""
    path = output(name, "", (suffix,), force=True, stream=True)
    if path != STDOUT and path.exists() and not force:
        raise InputError.at(name, "is there already: name another file, or add --force")
    return path
