"""What the commands of the command line do."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import mpi
from .errors import EngineUnavailable, InputError, RunFailed, ToleranceNotMet, check_tolerance

# what computes is imported inside the functions, so that wrong input is answered at once
if TYPE_CHECKING:
    from .engines.base import Engine
    from .reference import Reference
    from .scene import Scene
    from .trajectory import Trajectory

PICTURES = (".png", ".pdf", ".svg")
PAGES = (".html", ".htm")
REFERENCE_S = 60.0  # longest expected time for the independent reference; the native engine takes over beyond it
TO_BE_RESUMED = 75  # exit code after --max-wall: EX_TEMPFAIL of sysexits.h, "try again later"
TIGHTEST = 1e-11  # tolerance that the native engine reaches on every ordinary scene


def complain(text: str) -> None:
    """Say on stderr, in one line, what is wrong."""
    print(f"error: {' '.join(text.split())}", file=sys.stderr)


def _gather(*checks: Callable[[], Any]) -> list[Any]:
    """Return what the checks return; raise one `InputError` with the faults of all of them."""
    results, faults = [], []
    for check in checks:
        try:
            results.append(check())
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return results


def _read(path: str) -> Scene:
    from .scene import Scene

    return Scene.from_toml(path)


def _output(name: str, scene: str, suffixes: Sequence[str] = ()) -> Path:
    """Return the path of a file to write, once it is clear that it can be written."""
    path = Path(name)
    if path.is_dir() or name.endswith(("/", os.sep)):
        raise InputError([(name, f"is a folder; name a file, such as {path / 'run.nc' if not suffixes else path}")])
    if path.exists() and not path.is_file():
        raise InputError([(name, "is a device or a pipe, not a file; name a file")])
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError([(name, f"must end in {', '.join(suffixes[:-1])} or {suffixes[-1]}")])
    if path.exists() and Path(scene).exists() and path.samefile(scene):
        raise InputError([(name, "is the file that is read; name another file")])
    if not path.parent.is_dir():
        raise InputError([(name, f"there is no folder {path.parent}; make it first")])
    if not os.access(path.parent, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise InputError([(name, "you may not write there; choose another place")])
    return path


def _engine(arguments: argparse.Namespace) -> Engine:
    """Return the engine with the options given for it."""
    from . import engines

    given = {key: getattr(arguments, key) for key in ("integrator", "step", "diameter", "ranks", "template", "include")}
    return engines.get(arguments.engine, **{key: value for key, value in given.items() if value is not None})


def run(arguments: argparse.Namespace) -> int:
    """Answer a scene and save the trajectory, in a file or in a run folder."""
    name = arguments.output or str(Path(arguments.scene).with_suffix(".nc"))
    whole = run_folder(arguments) is not None
    scene, path, engine, _ = _gather(
        lambda: _read(arguments.scene),
        lambda: _new_folder(name) if whole else arguments.output and _output(name, arguments.scene),
        lambda: _engine(arguments),
        lambda: check_tolerance(arguments.tolerance),
    )
    path = path or _output(name, arguments.scene)
    from .simulation import simulate

    if mpi.joined() and engine.name != "lammps":
        warnings.warn(f"the engine {engine.name} runs on one rank; --engine lammps would use them all", stacklevel=1)
    return _told(
        lambda: simulate(
            scene,
            engine,
            arguments.tolerance,
            progress=sys.stderr.isatty(),
            folder=path if whole else None,
            max_wall=arguments.max_wall,
        ),
        arguments.tolerance,
        path,
        save=not whole,
    )


def resume(arguments: argparse.Namespace) -> int:
    """Go on with the run in a folder."""
    from .runfolder import status
    from .simulation import resume

    found = status(arguments.folder)
    if found["state"] == "finished":
        print(f"{arguments.folder}: this run is finished; there is nothing left to do")
    return _told(
        lambda: resume(arguments.folder, max_wall=arguments.max_wall, progress=sys.stderr.isatty()),
        found["tolerance"],
        Path(arguments.folder),
    )


def run_folder(arguments: argparse.Namespace) -> str | None:
    """Return the run folder that a command works in, if it does in one."""
    if "folder" in arguments:
        return arguments.folder
    name = getattr(arguments, "output", None)
    in_folder = arguments.command is run and name and (name.endswith(("/", os.sep)) or Path(name).is_dir())
    return name if in_folder else None


def _new_folder(name: str) -> Path:
    from .tasks import check_new

    return check_new(name)


def _told(answer: Callable[[], Trajectory], tolerance: float, path: Path, save: bool = False) -> int:
    """Get an answer and say how good it is; return the exit code."""
    from .stopping import Stopped

    missed = ""
    try:
        trajectory = answer()
    except Stopped as stopped:  # by --max-wall: a signal goes its own way
        print(stopped, file=sys.stderr)
        return TO_BE_RESUMED
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        trajectory, missed = error.trajectory, error.reason
    if save:
        trajectory.save(path)
    print(_summary(trajectory, tolerance, path))
    if missed:
        complain(missed)
    return 1 if missed else 0


def _summary(trajectory: Trajectory, tolerance: float, path: Path) -> str:
    """Return in a few lines what was done, how well and at what cost."""
    cost, error, scene = trajectory.cost, trajectory.error_estimate, trajectory.scene
    ranks = f", on {cost.ranks} ranks" if cost.ranks > 1 else ""
    parts = f" = {error.model:.2g} (equation) + {error.solver:.2g} (solver)" if error.model else ""
    lines = {
        "engine": f"{trajectory.engine}, which solves Eq. ({trajectory.equation}){ranks}",
        "scene": f"{scene.chain.grains} grains, {scene.samples} samples over {scene.duration:g} s",
        "integrator": f"{cost.integrator}, {cost.steps} steps of {cost.step_s:.4g} s",
        "estimated error": f"{error.total:.2g}{parts} (tolerance {tolerance:g})",
        "time spent": f"{cost.integration_s:.3g} s integration, {cost.estimate_s:.3g} s error estimate, "
        f"{cost.setup_s:.3g} s set-up",
        "folder" if path.is_dir() else "file": str(path),
    }
    return "\n".join(f"{key:<16} {value}" for key, value in lines.items())


def compare(arguments: argparse.Namespace) -> int:
    """Answer a scene with several engines and set them beside the truth."""
    names, scene, picture, numbers, _ = _gather(
        lambda: _names(arguments.engines),
        lambda: _read(arguments.scene),
        lambda: arguments.output and _output(arguments.output, arguments.scene, PICTURES),
        lambda: arguments.json and _output(arguments.json, arguments.scene),
        lambda: check_tolerance(arguments.tolerance),
    )
    from . import engines
    from .measure.compare import compare as side_by_side

    able: list[str] = []
    refusals: list[tuple[str, str]] = []
    for name in names:
        reasons = engines.get(name).refuses(scene)
        refusals += [(key, f"{name}: {reason}") for key, reason in reasons]
        if not reasons:
            able.append(name)
    if not able:
        raise InputError(refusals)
    trajectories, failures = _answers(scene, able, arguments.tolerance)
    if trajectories:
        comparison = side_by_side(trajectories, _reference(scene, arguments.tolerance))
        print(comparison.table())
    for key, reason in refusals:
        print(f"left out: {reason} ({key})")
    if trajectories and numbers:
        _write_json(comparison.to_json(), numbers)
        print(f"numbers: {numbers}")
    if trajectories and picture:
        from .plotting import save

        save(comparison.plot(), picture)
        print(f"picture: {picture}")
    for failure in failures:
        complain(failure)
    return 1 if failures else 0


def _names(given: str | None) -> list[str]:
    from . import engines

    if given is None:
        return list(engines.names())
    chosen = list(dict.fromkeys(name.strip() for name in given.split(",") if name.strip()))
    known = ", ".join(engines.names())
    if faults := [("engines", f"no engine is called {n!r}; use {known}") for n in chosen if n not in engines.names()]:
        raise InputError(faults)
    if not chosen:
        raise InputError([("engines", f"names none; use {known}")])
    return chosen


def _answers(scene: Scene, names: list[str], tolerance: float) -> tuple[list[Trajectory], list[str]]:
    """Run every engine; return the answers and what went wrong, in words."""
    from .simulation import simulate

    trajectories, failures = [], []
    for name in names:
        try:
            with warnings.catch_warnings(action="ignore"):  # how far off an answer is stands in the table
                trajectories.append(simulate(scene, name, tolerance, progress=sys.stderr.isatty()))
        except ToleranceNotMet as error:
            failures.append(f"{name}: {error.reason}")
            if error.trajectory is not None:
                trajectories.append(error.trajectory)
        except (RunFailed, EngineUnavailable) as error:
            failures.append(f"{name}: {error}")
    return trajectories, failures


def _reference(scene: Scene, tolerance: float) -> Reference:
    """Return the truth: from an integrator apart, or from the native engine where that would take too long."""
    from .reference import Reference, expected_seconds, reference
    from .scene import Scene
    from .simulation import simulate

    if expected_seconds(scene) <= REFERENCE_S:
        return reference(scene)
    tight = max(tolerance / 100, TIGHTEST)
    everywhere = Scene(chain=scene.chain, excitation=scene.excitation, duration=scene.duration, samples=scene.samples)
    try:
        truth = simulate(everywhere, "native", tight, progress=sys.stderr.isatty())
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        truth = error.trajectory
    method = f"the native engine at a tolerance of {tight:g} (too long a scene for an integrator apart)"
    return Reference(truth.time, truth.displacement, truth.velocity, truth.error_estimate.total, method)


def _write_json(data: dict[str, Any], path: Path) -> None:
    import json

    from .files import write_aside

    with write_aside(path) as aside:
        aside.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def deck(arguments: argparse.Namespace) -> int:
    """Write a LAMMPS input that runs by itself."""
    scene, _ = _gather(lambda: _read(arguments.scene), lambda: check_tolerance(arguments.tolerance))
    from shlex import quote

    from .engines.lammps.export import write_deck

    folder = Path(arguments.output)
    write_deck(
        scene,
        folder,
        tolerance=arguments.tolerance,
        step=arguments.step,
        diameter=arguments.diameter,
        integrator=arguments.integrator,
        pair_style=arguments.pair_style,
        template=arguments.template,
        include=arguments.include,
    )
    print(f"wrote {folder / 'in.column'} and {folder / 'column.data'}; to run them:")
    print(f"  cd {quote(str(folder))} && lmp -in in.column")
    return 0


def dyson(arguments: argparse.Namespace) -> int:
    """Weight a run over depth as Eq. (22) does, and average its scene over random chains."""
    from .disorder import at_the_end
    from .measure.dyson import orders, sums

    run, picture, numbers, m = _gather(
        lambda: _run_or_dump(arguments.run, arguments.scene),
        lambda: arguments.output and _output(arguments.output, arguments.run, PICTURES),
        lambda: arguments.json and _output(arguments.json, arguments.run),
        lambda: orders(arguments.m),
    )
    found = sums(run, m)
    chains = at_the_end(run.scene, m, arguments.realisations, arguments.seed, progress=sys.stderr.isatty())
    print(found.table(*chains))
    if numbers:
        _write_json(found.to_json(*chains), numbers)
        print(f"numbers: {numbers}")
    if picture:
        from .plotting import save

        save(found.plot(*chains), picture)
        print(f"picture: {picture}")
    return 0


def fit(arguments: argparse.Namespace) -> int:
    """Say what a saved run, or a dump of LAMMPS, shows of the theory."""
    trajectory, path = _gather(
        lambda: _run_or_dump(arguments.run, arguments.scene),
        lambda: arguments.json and _output(arguments.json, arguments.scene or arguments.run),
    )
    if path and path.exists() and path.samefile(arguments.run):
        raise InputError([(arguments.json, "is the run itself; name another file")])
    from .measure.fit import summary

    found = summary(trajectory)
    print(found.table())
    if path:
        _write_json(found.to_json(), path)
        print(f"numbers: {path}")
    return 0


def _run_or_dump(path: str, scene: str | None) -> Trajectory:
    """Read a saved run, or a dump if the scene is given that it was made for."""
    from .dumps import is_dump

    dumped = is_dump(path)
    if scene is None and dumped:
        raise InputError([(path, "is a LAMMPS dump: give its scene as well, --scene SCENE.toml")])
    if scene is not None and not dumped and Path(path).is_file():
        raise InputError([("scene", f"goes with a LAMMPS dump, which {path} is not; leave it out for a saved run")])
    from .trajectory import Trajectory

    return Trajectory.load(path) if scene is None else Trajectory.from_dump(path, _read(scene))


def report(arguments: argparse.Namespace) -> int:
    """Write a page about a saved run, or a dump of LAMMPS."""
    page = arguments.output or str(Path(arguments.run).with_suffix(".html"))
    trajectory, path = _gather(
        lambda: _run_or_dump(arguments.run, arguments.scene), lambda: _output(page, arguments.run, PAGES)
    )
    from .htmlreport import write

    write(trajectory, path)
    print(f"page: {path}")
    return 0


def workprec(arguments: argparse.Namespace) -> int:
    """Chart the speed of every engine and integrator against its accuracy on a scene."""
    beside = arguments.json or (arguments.output and str(Path(arguments.output).with_suffix(".json")))
    scene, picture, numbers = _gather(
        lambda: _read(arguments.scene),
        lambda: arguments.output and _output(arguments.output, arguments.scene, PICTURES),
        lambda: beside and _output(beside, arguments.scene),
    )
    from .workprecision import work_precision

    found = work_precision(scene, arguments.budget, progress=sys.stderr.isatty())
    print(found.table())
    for reason in found.left_out:
        print(f"left out: {reason}")
    if numbers:
        _write_json(found.to_json(), numbers)
        print(f"numbers: {numbers}")
    if picture:
        from .plotting import save

        save(found.plot(), picture)
        print(f"picture: {picture}")
    return 0


def sweep(arguments: argparse.Namespace) -> int:
    """Answer the scenes of a sweep that are not done yet, and say how many failed."""
    from .sweeps import dask, sweep

    if mpi.joined():
        raise InputError([("sweep", "does not run under mpirun: use --workers, or --scheduler for several machines")])
    folder, cores = arguments.output, len(os.sched_getaffinity(0))
    workers = cores if arguments.workers is None else arguments.workers
    try:
        with dask(arguments.scheduler) if arguments.scheduler else nullcontext() as executor:
            found = sweep(arguments.sweep, folder, workers=workers, executor=executor, progress=sys.stderr.isatty())
    except BaseException as stop:
        if not isinstance(stop, Exception):
            print(f"what is done is kept in {folder}; the same command goes on from there", file=sys.stderr)
        raise
    reasons = [reason for reason in found["reason"].to_numpy().flat if reason]
    print(f"{found['reason'].size - len(reasons)} of {found['reason'].size} scenes are answered in {folder}")
    if reasons:
        complain(f"{len(reasons)} scenes have no answer, the first because: {reasons[0]}")
    return 1 if reasons else 0


def doctor(arguments: argparse.Namespace) -> int:
    """Say what works here, finding by finding; a fault makes it fail."""
    path = arguments.json and _output(arguments.json, "")
    from .doctor import diagnose

    diagnosis = diagnose(tell=lambda finding: print(finding, flush=True))
    print(diagnosis.summary)
    if path:
        _write_json(diagnosis.to_json(), path)
        print(f"findings: {path}")
    return 1 if diagnosis.counts["fault"] else 0
