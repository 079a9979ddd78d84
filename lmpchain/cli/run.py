"""Commands that solve or plan scenes: run, resume, averages, sweep, plan; and deck."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, LmpchainError, ToleranceNotMet, check_tolerance, either
from ..util import mpi
from ..util.remarks import warn
from ..util.tables import align, counted, finite, number
from .common import (
    STANDARD,
    beside,
    check_numbers,
    check_outputs,
    collect,
    complain,
    keep,
    on_terminal,
    output,
    read_scene,
    write_json,
)

if TYPE_CHECKING:
    from ..engines.base import Engine
    from ..trajectory.trajectory import Trajectory


def _engine_with_options(arguments: argparse.Namespace) -> Engine | None:
    """Return the engine with the options of the command line; None for "auto"."""
    from ..simulation.choice import engine_for

    names = ("integrator", "step", "threads", "diameter", "ranks", "template", "include")
    options = {name: getattr(arguments, name) for name in names}
    options = {name: value for name, value in options.items() if value is not None}
    return engine_for(arguments.engine, **options)


def run(arguments: argparse.Namespace) -> int:
    """Solve a scene and save the trajectory in a file or a run folder."""
    if arguments.scene == STANDARD and not arguments.output:
        raise InputError.at(
            "output",
            "is missing: name the file of the run with -o, because the scene has no file name",
        )
    name = arguments.output or beside(arguments.scene, ".nc")
    # A name that ends in / is a folder, even if it does not exist yet.
    in_folder = run_folder(arguments) is not None
    scene, path, engine, _, numbers = collect(
        lambda: read_scene(arguments.scene),
        lambda: (
            _new_folder(name, arguments.force)
            if in_folder
            else _new_file(name, arguments.scene, arguments.force)
        ),
        lambda: _engine_with_options(arguments),
        lambda: check_tolerance(arguments.tolerance),
        lambda: check_numbers(arguments, arguments.scene),
    )
    from .. import engines
    from ..simulation.api import simulate
    from ..simulation.choice import refusals
    from ..simulation.folder_files import is_run, remove
    from ..stability.pre_run import pre_run_warnings

    if reasons := refusals(scene, engine):
        raise InputError(reasons)
    # An earlier run is removed only now, after all input has been checked.
    if in_folder and is_run(path):
        remove(path)
    for warning in pre_run_warnings(scene, engine, arguments.tolerance):
        warn(warning, stacklevel=1)
    if mpi.count_idle():
        name = engine.name if engine else arguments.engine
        able = either(each for each in engines.names() if engines.class_of(each).ranks_of_mpi)
        warn(
            f"the engine {name} runs on one rank; --engine {able} would use all ranks",
            stacklevel=1,
        )
    return _report(
        lambda: simulate(
            scene,
            engine or arguments.engine,
            arguments.tolerance,
            progress=on_terminal(),
            folder=path if in_folder else None,
            max_wall=arguments.max_wall,
        ),
        arguments.tolerance,
        path,
        numbers,
        save=not in_folder,
    )


def resume(arguments: argparse.Namespace) -> int:
    """Continue the run in a folder."""
    from ..simulation.api import resume
    from ..simulation.run_folder import status
    from ..util.files import expanded

    numbers = check_numbers(arguments, arguments.folder)
    state = status(arguments.folder)
    if state["state"] == "finished":
        print(f"{arguments.folder}: this run is finished; there is nothing left to do")
    elif state["state"] == "killed":
        progress = f"at sample {state['samples_done']} of {state['samples']} or later"
        print(
            f"{arguments.folder}: {state['reason']} {progress}; continuing from its last checkpoint"
        )
    return _report(
        lambda: resume(
            arguments.folder,
            max_wall=arguments.max_wall,
            progress=on_terminal(),
            ranks=arguments.ranks,
        ),
        state["tolerance"],
        expanded(arguments.folder),
        numbers,
    )


def run_folder(arguments: argparse.Namespace) -> str | None:
    """Return the run folder of a command; None if it has none."""
    if "folder" in arguments:
        return arguments.folder
    name = getattr(arguments, "output", None)
    if arguments.command is not run or not name:
        return None
    from ..util.files import expanded

    return name if name.endswith(("/", os.sep)) or expanded(name).is_dir() else None


def _new_folder(name: str, force: bool) -> Path:
    from ..simulation.folder_files import (
        check_new,
        check_replaceable,
        is_run,
        is_sealed,
        resume_command,
    )
    from ..util.files import expanded

    if not (is_run(name) and is_sealed(expanded(name))):
        return check_new(name)
    if not force:
        raise InputError.at(
            name,
            f"contains a run already: continue it, {resume_command(name)}, replace it with "
            "--force, or name another folder",
        )
    return check_replaceable(name)


def _new_file(name: str, scene: str, force: bool) -> Path:
    """Return the path of a new file; an existing run is replaced only with `force`."""
    path = output(name, scene, force=True)
    if path.exists() and not force:
        raise InputError.at(
            name, "already exists: replace it with --force, or name another file with -o"
        )
    return path


def _report(
    answer: Callable[[], Trajectory],
    tolerance: float,
    path: Path,
    numbers: Path | None,
    save: bool = False,
) -> int:
    """Run, print the summary, write its numbers if requested, and return the exit code."""
    from ..simulation.run_folder import Stopped

    missed = ""
    try:
        trajectory = answer()
    except Stopped as stopped:
        # Only --max-wall raises `Stopped` here; signals are handled elsewhere.
        print(stopped, file=sys.stderr)
        # This exit code asks a job scheduler to try again later.
        return os.EX_TEMPFAIL
    except ToleranceNotMet as error:
        if error.trajectory is None:
            raise
        trajectory = error.trajectory
        missed = error.reason
    if save:
        trajectory.save(path, overwrite=True)
    print(_summary(trajectory, tolerance, path))
    # A named engine whose equation differs from Eq. (1) has already warned of its model error.
    met = not missed and trajectory.error_estimate.model <= tolerance
    if numbers:
        write_json(_numbers(trajectory, tolerance, met, path), numbers)
    if missed:
        complain(missed)
    return int(not met)


def _numbers(trajectory: Trajectory, tolerance: float, met: bool, path: Path) -> dict[str, Any]:
    """Return the numbers of the summary of a run for a JSON file."""
    from ..trajectory.gathered import numbers

    cost = trajectory.cost
    error = trajectory.error_estimate
    scene = trajectory.scene
    return {
        "engine": trajectory.engine,
        "equation": trajectory.equation,
        "integrator": cost.integrator,
        "grains": scene.chain.grains,
        "samples": scene.samples,
        "duration_s": scene.duration,
        "tolerance": None if _has_given_step(trajectory) else tolerance,
        "tolerance_met": met,
        "error": finite({"total": error.total, "model": error.model, "solver": error.solver}),
        "cost": finite(cost._asdict()),
        "quantities": numbers(scene, trajectory.gathered),
        "folder" if path.is_dir() else "file": str(path),
    }


def _has_given_step(trajectory: Trajectory) -> bool:
    """Return whether the user gave the step, so that no tolerance was enforced."""
    from ..simulation.choice import GIVEN_STEP

    return trajectory.provenance.get("tolerance") == GIVEN_STEP


def _summary(trajectory: Trajectory, tolerance: float, path: Path) -> str:
    """Return a summary of the run: engine, steps, error and cost."""
    from ..trajectory.gathered import describe_gathered

    cost = trajectory.cost
    error = trajectory.error_estimate
    scene = trajectory.scene
    grains = counted(scene.chain.grains, "grain")
    ranks = f", on {cost.ranks} ranks" if cost.ranks > 1 else ""
    # Eq. (1) has no model error.
    shares = f" = {error.model:.2g} (equation) + {error.solver:.2g} (solver)" if error.model else ""
    given = _has_given_step(trajectory)
    asked = "no tolerance: the step is given" if given else f"tolerance {tolerance:g}"
    lines = {
        "engine": f"{trajectory.engine}, which solves Eq. ({trajectory.equation}){ranks}",
        "scene": f"{grains}, {scene.samples} samples over {scene.duration:g} s",
        "integrator": f"{cost.integrator}, {cost.steps_over(scene.duration)}",
        "estimated error": f"{error.total:.2g}{shares} ({asked}){error.remark}",
        **({"damping": scene.damping_remark} if scene.chain.damped else {}),
        "time spent": f"{cost.integration_s:.3g} s integration, {cost.estimate_s:.3g} s error "
        f"estimate, {cost.setup_s:.3g} s set-up, {cost.compile_s:.3g} s compilation",
        **describe_gathered(scene, trajectory.gathered),
        "folder" if path.is_dir() else "file": str(path),
    }
    return "\n".join(align(lines.items()))


def deck(arguments: argparse.Namespace) -> int:
    """Write a LAMMPS input that `lmp` can run on its own."""
    scene, _ = collect(
        lambda: read_scene(arguments.scene), lambda: check_tolerance(arguments.tolerance)
    )
    from shlex import quote

    from ..engines.lammps.export import write_deck
    from ..util.files import expanded

    folder = expanded(arguments.output)
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
        overwrite=arguments.force,
    )
    print(f"wrote {folder / 'in.column'} and {folder / 'column.data'}; to run them:")
    print(f"  cd {quote(str(folder))} && lmp -in in.column")
    return 0


def sweep(arguments: argparse.Namespace) -> int:
    """Solve the missing scenes of a sweep, and print the number of failures."""
    from ..sweeps.run import sweep

    if mpi.count_idle():
        raise InputError.at(
            "sweep", "does not run under mpirun: use --workers, or --scheduler for several machines"
        )
    folder = arguments.output
    # A batch queue may give this process fewer cores than the machine has.
    cores = len(os.sched_getaffinity(0))
    workers = cores if arguments.workers is None else arguments.workers
    results = sweep(
        arguments.sweep,
        folder,
        workers=workers,
        scheduler=arguments.scheduler,
        progress=on_terminal(),
    )
    reasons = [reason for reason in results["reason"].to_numpy().flat if reason]
    total = results["reason"].size
    print(f"{total - len(reasons)} of {total} scenes are solved in {folder}")
    if reasons:
        complain(f"{len(reasons)} scenes failed, the first because: {reasons[0]}")
    return 1 if reasons else 0


def plan(arguments: argparse.Namespace) -> int:
    """Print the engines' proposals for a scene and the choice; calibrate the cost model."""
    if arguments.scene is None and not arguments.calibrate:
        raise InputError.at("scene", "is missing; name a scene file, or use --calibrate alone")
    if arguments.scene is None and arguments.json:
        raise InputError.at("json", "needs a scene file: name one")
    scene, numbers, _ = collect(
        lambda: arguments.scene and read_scene(arguments.scene),
        lambda: check_numbers(arguments, arguments.scene or ""),
        lambda: check_tolerance(arguments.tolerance),
    )
    # Calibration runs first, so that the proposals below use the new speeds.
    if arguments.calibrate:
        _calibrate()
    if scene:
        from ..simulation.planner import plan

        result = plan(scene, arguments.tolerance, arguments.engine)
        print(result.table())
        keep(result, numbers, None)
    return 0


def _calibrate() -> None:
    from ..engines.cost_model import cache_file, measured
    from ..simulation.planner import calibrate

    try:
        path, seconds = calibrate()
    except OSError as error:
        raise LmpchainError(
            f"{cache_file()}: cannot be written: {error.strerror or error}"
        ) from None
    print(f"measured in {seconds:.2g} s how fast the engines are here: {path}")
    rows = [("engine", "overhead of a run", "cost over the shipped one")]
    rows += [
        (name, number(1e3 * start, unit="ms"), f"{slowness:.2g}")
        for name, (start, slowness) in measured().items()
    ]
    print("\n".join(align(rows)))


def averages(arguments: argparse.Namespace) -> int:
    """Average quantities of a scene over time."""
    scene, picture, numbers = collect(
        lambda: read_scene(arguments.scene),
        *check_outputs(arguments, arguments.scene),
    )
    from ..simulation import time_averages

    result = time_averages.averages(
        scene,
        [name.strip() for name in arguments.of.split(",")],
        time=arguments.time,
        tolerance=arguments.energy_tolerance,
        warm_up=arguments.warm_up,
        copies=arguments.copies,
        progress=on_terminal(),
    )
    print(result.table())
    keep(result, numbers, None)
    # Each average has a panel of its own, so `keep` does not apply.
    if picture:
        from ..util.plotting import PRINTED_WIDTH, figure, letter_panels, save

        pages = figure(PRINTED_WIDTH, 3.0 * len(result.mean))
        panels = pages.subplots(len(result.mean), squeeze=False)[:, 0]
        for ax, name in zip(panels, result.mean, strict=True):
            result.plot(ax, of=name)
        letter_panels(list(panels))
        save(pages, picture, overwrite=True)
        print(f"picture: {picture}")
    return 0
