"""Commands that evaluate a saved run: `fit`, `dyson`, `export`, `report`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import InputError, shown
from .common import (
    STDOUT,
    beside,
    check_numbers,
    check_outputs,
    collect,
    keep,
    on_terminal,
    output,
    read_scene,
    written,
)

if TYPE_CHECKING:
    from ..measure.traces import TraceTable
    from ..trajectory.trajectory import Trajectory

PAGES = (".html", ".htm")
TABLES = (".csv", ".txt")


def dyson(arguments: argparse.Namespace) -> int:
    """Print Eq. (22) for a run, and its mean over chains with random stiffness."""
    from ..disorder.averages import at_the_end
    from ..measure.dyson import orders, sums

    run, picture, numbers, m = collect(
        lambda: _run_or_dump(arguments),
        *check_outputs(arguments, arguments.run),
        lambda: orders(arguments.m),
    )
    result = sums(run, m)
    chains = at_the_end(
        run.scene, m, arguments.realisations, arguments.seed, progress=on_terminal()
    )
    print(result.table(*chains))
    keep(result, numbers, picture, *chains)
    return 0


def export(arguments: argparse.Namespace) -> int:
    """Write traces of a run as a CSV file."""
    run, path, force, velocity, displacement = collect(
        lambda: _run_or_dump(arguments),
        lambda: output(arguments.output, arguments.run, TABLES, force=arguments.force, stream=True),
        lambda: _places(arguments.contact_force, "contact-force", ("wall", "top", "bottom")),
        lambda: _places(arguments.velocity, "velocity"),
        lambda: _places(arguments.displacement, "displacement"),
    )
    # Without a selection all recorded grains are exported.
    source: Trajectory | TraceTable = run
    if force or velocity or displacement or arguments.energies:
        from ..measure.traces import gather as gather_traces

        source = gather_traces(
            run,
            force=force,
            velocity=velocity,
            displacement=displacement,
            energy=arguments.energies,
            above_rest=arguments.above_rest,
        )
    with written(path) as file:
        source.to_csv(file, overwrite=True)
    if path != STDOUT:
        print(f"traces: {path}")
    return 0


def _places(text: str | None, key: str, words: Sequence[str] = ()) -> list[int | str]:
    """Return grain numbers and names from `words` in a text such as "1,5"."""
    places: list[int | str] = []
    for entry in filter(None, map(str.strip, (text or "").split(","))):
        if entry not in words and not entry.isdecimal():
            kinds = " or ".join(["numbers of grains", *([", ".join(words)] if words else [])])
            raise InputError.at(key, f"must be {kinds}, with commas between (got {shown(entry)})")
        places.append(entry if entry in words else int(entry))
    return places


def fit(arguments: argparse.Namespace) -> int:
    """Fit the theory to a saved run or a LAMMPS dump."""
    trajectory, path = collect(
        lambda: _run_or_dump(arguments),
        lambda: check_numbers(arguments, arguments.scene or arguments.run),
    )
    if path and path.exists() and path.samefile(arguments.run):
        raise InputError.at(arguments.json, "is the run itself; name another file")
    from ..measure.fit.overview import summary

    result = summary(trajectory)
    print(result.table())
    keep(result, path, None)
    return 0


def _run_or_dump(arguments: argparse.Namespace) -> Trajectory:
    """Read a saved run, or a dump together with its scene."""
    path = arguments.run
    scene = arguments.scene
    axis = arguments.axis
    # Likely mistakes are reported before any heavy module is loaded.
    from ..trajectory.dump_frames import is_dump
    from ..util.files import expanded

    dump = is_dump(path)
    if scene is None and dump:
        raise InputError.at(path, "is a LAMMPS dump: give its scene as well, --scene SCENE.toml")
    if scene is not None and not dump and expanded(path).is_file():
        raise InputError.at(
            "scene", f"is only for a LAMMPS dump, which {path} is not: leave it out for a saved run"
        )
    for key in ("axis", "units"):
        if getattr(arguments, key) and scene is None:
            raise InputError.at(
                key, "is only for a LAMMPS dump and its scene: leave it out for a saved run"
            )
    from ..trajectory.trajectory import Trajectory

    load = Trajectory.load
    if scene is None:
        run = load(path)
    else:
        run = Trajectory.from_dump(path, read_scene(scene), axis=axis, units=arguments.units)
    # A run folder has no samples yet if its run has just started.
    if run.time.size < 2:
        raise InputError.at(
            path, "has too few samples so far: continue the run, or run the scene again"
        )
    return run


def report(arguments: argparse.Namespace) -> int:
    """Write an HTML page about a saved run or a LAMMPS dump."""
    page = arguments.output or beside(arguments.run, ".html")
    trajectory, path = collect(
        lambda: _run_or_dump(arguments),
        lambda: output(page, arguments.run, PAGES, force=arguments.force),
    )
    from ..report import write
    from ..report.origin import origin

    write(trajectory, path, progress=on_terminal(), origin=origin(arguments.run), overwrite=True)
    print(f"page: {path}")
    return 0
