"""Commands for a first use: `new` writes an example scene, `docs` opens the documentation."""

from __future__ import annotations

import argparse
import json
import shlex
import webbrowser
from pathlib import Path
from typing import Any

from ..errors import InputError, LmpchainError
from ..util.tables import wrap
from .common import STDOUT, beside, collect, output, written

# Names of the examples and their summaries.
EXAMPLES = {
    "column": "glass beads under gravity, struck on the top one",
    "striker": "a ball of PTFE strikes a precompressed row of steel balls",
    "dimer": "steel and aluminium in turn, pressed together: a gap between two bands",
    "driven": "a burst of a piezo travels down a precompressed row",
    "hammer": "the force of an impact hammer, from the file of an oscilloscope, on steel balls",
    "vibrometer": "a shaker drives a row of PTFE balls by a measured motion",
    "disorder": "balls of random diameters scatter a wave",
    "law": "a Toda chain, with a contact law given by a formula",
    "lammps": "steel balls on a wall, as a LAMMPS deck and in LAMMPS",
}


DEFAULT_EXAMPLE = "column"
# Examples with measured data, which are written to a file beside the scene.
WITH_DATA = ("hammer", "vibrometer")
# Options for information that a LAMMPS run may lack.
OF_RUNS = (
    *("material", "young", "poisson", "density", "diameter", "timestep", "duration", "samples"),
    "units",
)


def new(arguments: argparse.Namespace) -> int:
    """Write a commented example with its data file, or the scene of a LAMMPS run."""
    name = arguments.new_scene
    if arguments.run:
        if arguments.example:
            raise InputError.at("example", "cannot be combined with --from: leave one of them out")
        return _from_run(arguments, _new(name, ".toml", arguments.force))
    if given := [key for key in OF_RUNS if getattr(arguments, key) is not None]:
        raise InputError([(key, "is only for --from: leave it out") for key in given])
    example = arguments.example or DEFAULT_EXAMPLE
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
    _write_example(example, path, data, name)
    return 0


def _write_example(example: str, path: Path, data: Path | None, name: str) -> None:
    """Write an example and its data file, if any, and print the next steps."""
    from ..util.files import write_aside
    from ..util.templates import render

    if path == STDOUT:
        # The comments name the file to which the reader will save the text.
        name = "scene.toml"
    quoted = shlex.quote(name)
    names: dict[str, Any] = {"scene": quoted, "stem": shlex.quote(beside(name, ""))}
    if data:
        # The file is in the folder of the scene. TOML quotes strings as JSON does.
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


def _from_run(arguments: argparse.Namespace, path: Path) -> int:
    """Write the scene of a user's own LAMMPS run, and print how the run was interpreted."""
    from ..scene.lammps_column import RunOptions
    from ..scene.scene import Scene
    from ..trajectory.dump_frames import is_dump
    from ..trajectory.lammps_dump import scene_of_run
    from ..util.files import expanded

    if path.resolve() in [expanded(run).resolve() for run in arguments.run]:
        raise InputError.at(str(path), "is a file of the run itself: name another file")
    options = RunOptions(**{key: getattr(arguments, key) for key in RunOptions._fields})
    understood = scene_of_run(arguments.run, options, arguments.units)
    scene = Scene(**understood.fields)
    scene.to_toml(path, overwrite=arguments.force)
    for fact, text in understood.facts:
        print(f"{fact}: {text}")
    print(f"scene: {path}")
    quoted = shlex.quote(str(arguments.new_scene))
    dumps = [run for run in arguments.run if is_dump(run)]
    if dumps:
        units = understood.units if arguments.units is None else arguments.units
        option = f" --units {units}" if units not in (None, "si") else ""
        print(f"next: lmpchain check {shlex.quote(dumps[0])} --scene {quoted}{option}")
    print(f"{'     ' if dumps else 'next:'} lmpchain run {quoted}")
    return 0


def _new(name: str, suffix: str, force: bool) -> Path:
    """Return the path of a new file; an existing file is replaced only with `force`."""
    path = output(name, "", (suffix,), force=True, stream=True)
    if path != STDOUT and path.exists() and not force:
        raise InputError.at(name, "already exists: name another file, or add --force")
    return path


SOURCES = Path(__file__).parent.parent.parent / "docs"  # Only in a checkout.


def docs(arguments: argparse.Namespace) -> int:
    """Open the built documentation in a browser, and print its location."""
    page = SOURCES / "build" / "index.html"
    if not page.is_file():
        build = f"pip install -e '.[docs]' && sphinx-build {SOURCES} {SOURCES / 'build'}"
        raise LmpchainError(
            f"the pages are not built: {build}; or read {SOURCES / 'index.md'}"
            if SOURCES.is_dir()
            else "this installation has no pages: they are in the folder docs of the source code"
        )
    print(page.as_uri())
    webbrowser.open(page.as_uri())
    return 0
