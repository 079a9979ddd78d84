"""The command line: one function a verb, in `commands`.

Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 the time of
--max-wall was over before the run was, 130 after Ctrl-C, 143 after SIGTERM.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from ..errors import InputError, LmpchainError, shown
from ..util import mpi
from . import commands
from .common import complain
from .parser import Parser, ShowVersion

Command = Callable[[argparse.Namespace], int]
Add = Callable[[str, Command, str], argparse.ArgumentParser]  # name of a verb, and its summary


class _Terminated(BaseException):
    """SIGTERM arrived; no `Exception`, so that no handler of faults catches it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; under mpirun, rank 0 runs it.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the name of the program; those of the process by default.
    """
    if mpi.count_processes() == 1:
        return _run(argv)
    try:
        world = mpi.join()
    except LmpchainError as error:
        complain(str(error))
        return 1
    from ..engines.lammps.communicators import shutdown_workers, worker_loop

    if world.rank > 0:
        worker_loop(world)
        return 0
    try:
        return _run(argv)
    finally:
        shutdown_workers(world)


def _run(argv: Sequence[str] | None) -> int:
    """Run the command line; end in silence where no one reads on, as behind `| head`."""
    try:
        code = _main(argv)
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # as it is where it was closed
                stream.flush()
        return code
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):  # what is left in them is flushed at exit
            with suppress(AttributeError, OSError, ValueError):
                os.dup2(nowhere, stream.fileno())
        return 128 + signal.SIGPIPE  # as a shell says of a tool that SIGPIPE ends
    except OSError as error:  # such as a full disk behind stdout
        with suppress(OSError, ValueError):
            sys.stdout.close()
        complain(str(error))
        return 1


def _main(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(argv)
    # --help, --version, or arguments that argparse refused and explained
    except SystemExit as end:
        return int(end.code or 0)
    before = _on_sigterm(_raise_terminated)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning  # type: ignore[assignment]
            return arguments.command(arguments)
    except InputError as error:
        for key, message in error.faults:
            complain(f"{key if key.strip() else repr(key)}: {message}")
        return 2
    except LmpchainError as error:
        complain(str(error))
        return 1
    except BrokenPipeError:
        raise
    except OSError as error:
        complain(str(error))
        return 1
    except KeyboardInterrupt:
        print(f"stopped by Ctrl-C; {_describe_rest(arguments)}", file=sys.stderr)
        return 130
    except _Terminated:
        print(f"stopped by SIGTERM; {_describe_rest(arguments)}", file=sys.stderr)
        return 143
    finally:
        _on_sigterm(before)


def _describe_rest(arguments: argparse.Namespace) -> str:
    """Return in words what a stopped command has left on the disk."""
    from ..simulation.task import is_run, resume_command

    if arguments.command is commands.sweep:
        return f"what is done is kept in {arguments.output}; the same command continues from there"
    folder = commands.run_folder(arguments)
    if folder and is_run(folder):
        return f"to go on: {resume_command(folder)}"
    hint = (
        "; with -o FOLDER/ what is done is kept and can be resumed"
        if arguments.command is commands.run
        else ""
    )
    return f"nothing unfinished was kept{hint}"


def _raise_terminated(*_: Any) -> None:
    raise _Terminated


def _on_sigterm(handler: Any) -> Any:
    """Install a handler and return the one before; other threads than the main one may not."""
    if threading.current_thread() is not threading.main_thread():
        return None
    before = signal.getsignal(signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.SIG_DFL if handler is None else handler)
    return before


def _show_warning(message: Warning | str, *_: Any) -> None:
    complain(str(message), "warning")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="lmpchain",
        description="Waves in columns of Hertzian grains: LAMMPS and a native integrator, side by "
        "side, each with an estimate of its own error. All quantities are in SI units.",
        epilog="Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is "
        "wrong, 75 the time of --max-wall was over before the run was, 130 after Ctrl-C, 143 after "
        "SIGTERM.",
    )
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="show the version and exit")
    verbs = parser.add_subparsers(metavar="COMMAND", required=True)

    def add(name: str, command: Command, summary: str) -> argparse.ArgumentParser:
        verb = verbs.add_parser(name, help=summary)
        verb.set_defaults(command=command)
        return verb

    _add_runs(add)
    _add_comparisons(add)
    _add_orbits(add)
    _add_deck(add)
    _add_readers(add)
    _add_charts(add)
    _add_sweep(add)
    doctor = add(
        "doctor",
        commands.doctor,
        "check the installation: LAMMPS, MPI, versions, cores, engines",
    )
    _option(doctor, "--json", "FILE", "file for the findings")
    add("docs", commands.docs, "open the pages of the documentation")
    return parser


def _option(
    parser: argparse._ActionsContainer, name: str, metavar: str, text: str, **options: Any
) -> None:
    """Add an option; those for output files have a short form."""
    names = ("-o", name) if name == "--output" else (name,)
    parser.add_argument(*names, metavar=metavar, help=text, **options)


def _add_runs(add: Add) -> None:
    run = add(
        "run", commands.run, "solve a scene and save the trajectory, in a file or a run folder"
    )
    _add_scene(run)
    _option(
        run,
        "--output",
        "RUN.nc|FOLDER/",
        "NetCDF file to write (default: SCENE.nc beside the scene); or, with a / at its end, a run "
        "folder, in which the output grows on the disk and which `lmpchain resume` continues after "
        "a stop of any kind",
    )
    run.add_argument(
        "--force", action="store_true", help="replace the file or the run that is there already"
    )
    _option(run, "--engine", "E", "engine (default: auto)", default="auto")
    _add_tolerance(run)
    methods = "rkn6, kahan-li6 or verlet (default: what the engine prefers)"
    _option(run, "--integrator", "I", methods)
    _option(run, "--step", "S", "longest time step, s; then no tolerance is enforced", type=float)
    run.add_argument(
        "--diameter",
        choices=["auto", "physical", "gauge"],
        help="LAMMPS only: positions from the real diameters, or from a far smaller one, which "
        "reduces round-off",
    )
    _option(run, "--threads", "P", "native only: threads that share a long chain", type=int)
    _add_ranks(run)
    _add_templates(run)
    _add_max_wall(run)
    resume = add(
        "resume",
        commands.resume,
        "continue the run in a folder, bit-identical to a run without the stop",
    )
    resume.add_argument("folder", metavar="FOLDER", help="folder that lmpchain run -o FOLDER/ made")
    _add_ranks(resume)
    _add_max_wall(resume)


def _add_comparisons(add: Add) -> None:
    compare = add(
        "compare",
        commands.compare,
        "solve a scene with several engines, compare with a reference",
    )
    _add_scene(compare)
    _option(compare, "--engines", "A,B,...", "engines (default: all that can solve the scene)")
    _add_tolerance(compare)
    _add_outputs(compare, "PICTURE.png")
    plan = add(
        "plan", commands.plan, "show which engine solves a scene at the lowest cost, and why"
    )
    plan.add_argument("scene", metavar="SCENE.toml", nargs="?", help="scene file")
    _add_tolerance(plan)
    _option(plan, "--json", "FILE", "file for the numbers")
    plan.add_argument(
        "--calibrate",
        action="store_true",
        help="measure the speed of the engines on this machine and store it for the cost model",
    )


def _add_orbits(add: Add) -> None:
    orbit = add(
        "orbit",
        commands.orbit,
        "periodic orbit of the chain: a linear mode followed up to an energy",
    )
    _add_scene(orbit)
    _option(orbit, "--mode", "K", "number of the mode, the lowest is 1", type=int, required=True)
    _option(orbit, "--energy", "E", "energy above rest, J", type=float, required=True)
    _add_outputs(orbit, "PICTURE.png")
    sensitivity = add(
        "sensitivity",
        commands.sensitivity,
        "what an answer of a saved run depends on, grain by grain",
    )
    sensitivity.add_argument("run", metavar="RUN.nc", help="saved run, or a scene file")
    _option(
        sensitivity,
        "--of",
        "ANSWER",
        "peak_force:CONTACT, momentum:GRAINS, energy:GRAINS, kinetic_energy:GRAINS (such as 3-9) "
        "or arrival_time:GRAIN@VELOCITY",
        required=True,
    )
    for name in commands.UNCERTAIN:
        uncertainty = f"uncertainty of each {name}, as a part of it"
        _option(sensitivity, f"--{name}", "PART", uncertainty, type=float)
    of_derivatives = "of the derivatives (default: 1e-4)"
    _option(sensitivity, "--tolerance", "X", of_derivatives, type=float, default=1e-4)
    _add_outputs(sensitivity, "PICTURE.png", "picture along the chain (.png, .pdf or .svg)")


def _add_deck(add: Add) -> None:
    deck = add("deck", commands.deck, "write a LAMMPS input that runs by itself")
    _add_scene(deck)
    _option(deck, "--output", "FOLDER", "folder for in.column and column.data", required=True)
    _add_tolerance(deck)
    step = "longest time step, s (default: from the tolerance)"
    _option(deck, "--step", "S", step, type=float)
    deck.add_argument("--diameter", choices=["physical", "gauge", "auto"], default="physical")
    deck.add_argument("--integrator", choices=["verlet", "kahan-li6"], default="verlet")
    deck.add_argument(
        "--pair-style", choices=["granular", "gran/hertz/history"], default="granular"
    )
    _add_templates(deck)


def _add_readers(add: Add) -> None:
    dyson = add(
        "dyson",
        commands.dyson,
        "weighted velocities of Eq. (22), beside the mean over random chains",
    )
    _add_run(dyson)
    orders = "orders of Dyson's distribution, such as 1,2,5,20"
    _option(dyson, "--m", "M,M,...", orders, required=True)
    chains = "random chains each (default: 200)"
    _option(dyson, "--realisations", "R", chains, type=int, default=200)
    _option(dyson, "--seed", "S", "seed of the random chains (default: 1)", type=int, default=1)
    _add_outputs(dyson, "PICTURE.png")
    fit = add(
        "fit",
        commands.fit,
        "fit the theory to a saved run or a LAMMPS dump: modes, speeds, the front",
    )
    _add_run(fit)
    _option(fit, "--json", "FILE", "file for the numbers")
    report = add(
        "report",
        commands.report,
        "write a page about a saved run: pictures, fits, errors, provenance",
    )
    _add_run(report)
    page = "file to write (default: RUN.html beside the run)"
    _option(report, "--output", "REPORT.html", page)


def _add_charts(add: Add) -> None:
    workprec = add(
        "workprec",
        commands.workprec,
        "work-precision chart of every engine and integrator on a scene",
    )
    _add_scene(workprec)
    budget = "about how long it may take, s (default: 60)"
    _option(workprec, "--budget", "S", budget, type=float, default=60.0)
    chart = "picture to write (.png, .pdf or .svg), with its numbers beside it"
    _option(workprec, "--output", "CHART.png", chart)
    _option(workprec, "--json", "FILE", "file for the numbers (default: CHART.json)")
    stability = add(
        "stability",
        commands.stability,
        "find where methods fail on a scene: steps, round-off, chaos, theories",
    )
    _add_scene(stability)
    _add_outputs(stability, "CHART.png")


def _add_sweep(add: Add) -> None:
    sweep = add(
        "sweep",
        commands.sweep,
        "solve many scenes: a grid, a list, random draws, disordered chains",
    )
    sweep.add_argument("sweep", metavar="SWEEP.toml", help="sweep file")
    _option(sweep, "--output", "FOLDER", "folder for the results", required=True)
    executor = sweep.add_mutually_exclusive_group()
    processes = "processes of this machine (default: one a core)"
    _option(executor, "--workers", "P", processes, type=int)
    scheduler = "of a Dask scheduler whose workers solve the scenes"
    _option(executor, "--scheduler", "ADDRESS", scheduler)


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file")


def _add_outputs(
    parser: argparse.ArgumentParser,
    metavar: str,
    text: str = "picture to write (.png, .pdf or .svg)",
) -> None:
    _option(parser, "--output", metavar, text)
    _option(parser, "--json", "FILE", "file for the numbers")


def _add_ranks(parser: argparse.ArgumentParser) -> None:
    text = "LAMMPS only: MPI processes that share the chain (not under mpirun)"
    _option(parser, "--ranks", "P", text, type=int)


def _add_templates(parser: argparse.ArgumentParser) -> None:
    deck = "LAMMPS only: your own deck, with placeholders (Jinja2)"
    _option(parser, "--template", "FILE", deck)
    _option(parser, "--include", "FILE", "LAMMPS only: your own fixes, computes and dumps")


def _add_max_wall(parser: argparse.ArgumentParser) -> None:
    _option(
        parser,
        "--max-wall",
        "H:MM:SS",
        "run folders only: after this time (or so many seconds), save and stop with exit code 75; "
        "lmpchain resume continues. Leave some seconds to the time limit of the queue",
        type=_duration,
    )


def _duration(text: str) -> float:
    """Return H:MM:SS, or seconds, as seconds."""
    match = re.fullmatch(r"(?:(\d+):([0-5]\d):)?(\d+(?:\.\d+)?)", text, re.ASCII)
    hours, minutes, seconds = match.groups() if match else (None, None, 0)
    total = 3600 * int(hours or 0) + 60 * int(minutes or 0) + float(seconds)
    if not total or (hours and float(seconds) >= 60):
        raise argparse.ArgumentTypeError(
            f"must be a time above 0, as H:MM:SS or in seconds (got {shown(text)})"
        )
    return total


def _add_run(parser: argparse.ArgumentParser) -> None:
    run = "file that lmpchain run saved, or a dump such as column.lammpstrj"
    parser.add_argument("run", metavar="RUN.nc", help=run)
    scene = "for a dump: the scene that it was made for"
    _option(parser, "--scene", "SCENE.toml", scene)
    parser.add_argument(
        "--axis",
        choices=["x", "y", "z"],
        help="for a dump: along which the column stands (default: seen)",
    )


def _add_tolerance(parser: argparse.ArgumentParser) -> None:
    text = "largest relative error (default: 1e-6)"
    _option(parser, "--tolerance", "X", text, type=float, default=1e-6)
