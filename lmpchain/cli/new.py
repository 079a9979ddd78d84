"""The command `new`: write a commented example scene."""

from __future__ import annotations

import argparse
import shlex

from ..errors import InputError
from .common import STDOUT, beside, output, written

# Examples, and what each of them shows.
EXAMPLES = {
    "column": "glass beads under gravity, struck on the top one",
    "striker": "a ball of PTFE strikes a precompressed row of steel balls",
    "dimer": "steel and aluminium in turn, pressed together: a gap between two bands",
    "driven": "a burst of a piezo travels down a precompressed row",
    "disorder": "balls of random diameters scatter a wave",
    "law": "a Toda chain, by a contact law of its own",
    "lammps": "steel balls on a wall, as a LAMMPS deck and in LAMMPS",
}


def new(arguments: argparse.Namespace) -> int:
    """Write a commented scene."""
    name = arguments.new_scene
    path = output(name, "", (".toml",), force=True, stream=True)
    if path != STDOUT and path.exists() and not arguments.force:
        raise InputError.at(name, "is there already: name another file, or add --force")
    # The name stands in comments, which a line break would end.
    if not name.isprintable():
        raise InputError.at("scene", "must be a name of letters that can be printed")
    from ..util.files import write_aside
    from ..util.templates import render

    if path == STDOUT:
        # The comments name the file that the reader of the text will make.
        name = "scene.toml"
    quoted = shlex.quote(name)
    stem = shlex.quote(beside(name, ""))
    text = render(f"examples/{arguments.example}.toml", scene=quoted, stem=stem)
    with written(path) as file, write_aside(file, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    print(f"scene: {'standard output' if path == STDOUT else path} ({EXAMPLES[arguments.example]})")
    print(f"next: lmpchain compare {quoted} -o {shlex.quote(beside(name, '.png'))}")
    print(f"      lmpchain run {quoted}")
    print("other examples: " + ", ".join(key for key in EXAMPLES if key != arguments.example))
    return 0
