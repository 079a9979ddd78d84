"""Commands that evaluate saved runs: fit, dyson, export, report, sensitivity; and explore."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..errors import InputError, shown
from .common import (
    STANDARD,
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
    if arguments.above_rest and not force:
        cure = "add --contact-force, or leave it out"
        raise InputError.at("above-rest", f"is only for forces: {cure}")
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
    from ..report.document import origin

    write(trajectory, path, progress=on_terminal(), origin=origin(arguments.run), overwrite=True)
    print(f"page: {path}")
    return 0


RUNS_OF_KEY = 15  # Number of values of a key for which none is given.
FORM = "KEY=LOW:HIGH[:N][:log], such as excitation.velocity=1e-6:1e-1:25:log"


def explore(arguments: argparse.Namespace) -> int:
    """Write a page with sliders that select among precomputed runs of a scene."""
    scene, path, *axes = collect(
        lambda: read_scene(arguments.scene),
        lambda: output(arguments.output, arguments.scene, PAGES, force=arguments.force),
        *((lambda text=text: read_axis(text)) for text in arguments.over),
    )
    from ..report.exploration import explore

    keys = [key for key, _ in axes]
    if twice := [key for key in dict.fromkeys(keys) if keys.count(key) > 1]:
        raise InputError.at(twice[0], "has two sliders: name each key once")
    # The file is passed on because a key may be absent from the file and have a default.
    known = scene if arguments.scene == STANDARD else arguments.scene
    source = {"scene": known, "over": dict(axes), "tolerance": arguments.tolerance}
    explore(source, path, progress=on_terminal(), overwrite=True)
    runs = math.prod(len(values) for _, values in axes)
    size = path.stat().st_size
    print(f"page: {path} ({runs} runs, {size / 1e6:.2g} MB)")
    return 0


def read_axis(text: str) -> tuple[str, list[Any]]:
    """Return the key and the values of a slider, from KEY=LOW:HIGH[:N][:log]."""
    key, _, span = text.partition("=")
    words = span.split(":")
    log = words[-1] == "log"
    bounds = words[:-1] if log else words
    if not key or len(bounds) not in (2, 3):
        raise InputError.at("over", f"must be {FORM} (got {shown(text)})")
    low, high = (_number(key, word) for word in bounds[:2])
    count = _count(key, bounds[2]) if len(bounds) == 3 else RUNS_OF_KEY
    if not low < high:
        raise InputError.at(key, f"the range must ascend (got {low:g}:{high:g})")
    if log and low <= 0:
        raise InputError.at(key, f"a range in equal ratios must begin above 0 (got {low:g})")
    # NumPy is imported late, because the help does not need it.
    import numpy as np

    values = (np.geomspace if log else np.linspace)(low, high, count)
    # A range with two integer ends gets integer values.
    if all(word.lstrip("+-").isdecimal() for word in bounds[:2]):
        whole = np.unique(values.round().astype(int)).tolist()
        if log or len(whole) < count or np.allclose(values, whole):
            return key, whole
    return key, values.tolist()


def _count(key: str, word: str) -> int:
    # A number with more digits is rejected later in any case.
    count = int(word[:9]) if word.isdecimal() else 0
    if count < 2:
        raise InputError.at(key, f"the number of runs must be 2 or more (got {shown(word)})")
    return count


def _number(key: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError.at(key, f"the ends of the range must be numbers (got {shown(word)})")
    return value


# Uncertain parameters: option after --sigma-, name of the parameter, description.
UNCERTAIN = {
    "diameter": ("diameters", "diameter"),
    "youngs-modulus": ("youngs_modulus", "Young's modulus"),
    "mass": ("masses", "mass"),
    "constant": ("contact_constants", "constant of a contact"),
    "viscoelastic": ("damping.viscoelastic", "viscous time of a contact"),
    "drag": ("damping.drag", "rate of drag"),
}


def sensitivity(arguments: argparse.Namespace) -> int:
    """Rank the parameters of a saved run by their influence on a result."""
    from ..design import sensitivities

    scene, picture, numbers, _ = collect(
        lambda: _scene(arguments.run),
        *check_outputs(arguments, arguments.run),
        lambda: sensitivities.objective(arguments.answer),
    )
    uncertainties = {
        field: getattr(arguments, f"sigma_{key.replace('-', '_')}")
        for key, (field, _) in UNCERTAIN.items()
    }
    shares = {field: share for field, share in uncertainties.items() if share is not None}
    result = sensitivities.sensitivity(
        scene, arguments.answer, shares, arguments.derivative_tolerance
    )
    print(result.table())
    keep(result, numbers, picture)
    return 0


def _scene(path: str) -> Any:
    """Return the scene of a saved run, or of a scene file."""
    if path == STANDARD or path.endswith(".toml"):
        return read_scene(path)
    from ..trajectory.dump_frames import is_dump
    from ..trajectory.trajectory import Trajectory

    if is_dump(path):
        raise InputError.at(path, "is a LAMMPS dump: give its scene, SCENE.toml, in its place")
    return Trajectory.load(path).scene
