"""The command `new`: write a commented example scene."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from ..errors import InputError
from .common import beside, output

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


DEFAULT_EXAMPLE = "column"
# Options that a run of LAMMPS may leave open.
OF_RUNS = (
    *("material", "young", "poisson", "density", "diameter", "timestep", "duration", "samples"),
    "units",
)


def new(arguments: argparse.Namespace) -> int:
    """Write a commented scene, or the scene of a run of LAMMPS."""
    name = arguments.scene
    path = output(name, arguments.run[0] if arguments.run else "", (".toml",), force=True)
    if path.exists() and not arguments.force:
        raise InputError.at(name, "is there already: name another file, or add --force")
    if arguments.run and arguments.example:
        raise InputError.at("example", "does not go with --from; leave one of them out")
    if arguments.run:
        return _from_run(arguments, path)
    if given := [key for key in OF_RUNS if getattr(arguments, key) is not None]:
        raise InputError([(key, "goes with --from; leave it out") for key in given])
    # The name stands in comments, which a line break would end.
    if not name.isprintable():
        raise InputError.at("scene", "must be a name of letters that can be printed")
    from ..util.files import write_aside
    from ..util.templates import render

    quoted = shlex.quote(name)
    stem = shlex.quote(beside(name, ""))
    example = arguments.example or DEFAULT_EXAMPLE
    text = render(f"examples/{example}.toml", scene=quoted, stem=stem)
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    print(f"scene: {path} ({EXAMPLES[example]})")
    print(f"next: lmpchain compare {quoted} -o {shlex.quote(beside(name, '.png'))}")
    print(f"      lmpchain run {quoted}")
    print("other examples: " + ", ".join(key for key in EXAMPLES if key != example))
    return 0


def _from_run(arguments: argparse.Namespace, path: Path) -> int:
    """Write the scene of a user's own run of LAMMPS, and say what was understood."""
    from ..scene.lammps_column import RunOptions
    from ..scene.scene import Scene
    from ..trajectory.dump_frames import is_dump
    from ..trajectory.dumped_grains import scene_of_run

    options = RunOptions(**{key: getattr(arguments, key) for key in RunOptions._fields})
    understood = scene_of_run(arguments.run, options, arguments.units)
    scene = Scene(**understood.fields)
    scene.to_toml(path, overwrite=arguments.force)
    for fact, text in understood.facts:
        print(f"{fact}: {text}")
    print(f"scene: {path}")
    quoted = shlex.quote(str(arguments.scene))
    dumps = [run for run in arguments.run if is_dump(run)]
    if dumps:
        units = understood.units if arguments.units is None else arguments.units
        option = f" --units {units}" if units not in (None, "si") else ""
        print(f"next: lmpchain check {shlex.quote(dumps[0])} --scene {quoted}{option}")
    print(f"{'     ' if dumps else 'next:'} lmpchain run {quoted}")
    return 0
