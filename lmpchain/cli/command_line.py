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
from . import commands, sensitivity
from .common import complain
from .parser import Parser, ShowVersion

NO_READER = 128 + signal.SIGPIPE  # what a shell says of tools that SIGPIPE ends


class _Terminated(BaseException):
    """SIGTERM arrived; no `Exception`, so that no handler of faults catches it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; under mpirun, rank 0 runs it.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the name of the program; those of the process by default.
    """
    if mpi.launched() == 1:
        return _piped(argv)
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
        return _piped(argv)
    finally:
        shutdown_workers(world)


def _piped(argv: Sequence[str] | None) -> int:
    """Run the command line; where nobody reads on, as behind `| head`, end without a word."""
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
        return NO_READER
    except OSError as error:  # such as a full disk behind stdout
        with suppress(OSError, ValueError):
            sys.stdout.close()
        complain(str(error))
        return 1


def _main(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(argv)
    # --help, --version, or arguments that argparse refused and explained
    except SystemExit as asked:
        return int(asked.code or 0)
    before = _on_sigterm(_terminated)
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
        print(f"stopped by Ctrl-C; {_kept(arguments)}", file=sys.stderr)
        return 130
    except _Terminated:
        print(f"stopped by SIGTERM; {_kept(arguments)}", file=sys.stderr)
        return 143
    finally:
        _on_sigterm(before)


def _kept(arguments: argparse.Namespace) -> str:
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


def _terminated(*_: Any) -> None:
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
        description="Waves in columns of Hertzian grains: LAMMPS and a native integrator, side by side, each "
        "with an estimate of its own error. All quantities are in SI units.",
        epilog="Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 "
        "the time of --max-wall was over before the run was, 130 after Ctrl-C, 143 after SIGTERM.",
    )
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="show the version and exit")
    verbs = parser.add_subparsers(metavar="COMMAND", required=True)

    run = verbs.add_parser(
        "run", help="solve a scene and save the trajectory, in a file or a run folder"
    )
    _scene(run, commands.run)
    run.add_argument(
        "-o",
        "--output",
        metavar="RUN.nc|FOLDER/",
        help="NetCDF file to write (default: SCENE.nc beside the scene); or, with a / at its end, a "
        "run folder, in which the output grows on the disk and which `lmpchain resume` continues "
        "after a stop of any kind",
    )
    run.add_argument(
        "--force", action="store_true", help="replace the file or the run that is there already"
    )
    run.add_argument("--engine", metavar="E", default="auto", help="engine (default: auto)")
    _tolerance(run)
    run.add_argument(
        "--integrator",
        metavar="I",
        help="rkn6, kahan-li6 or verlet (default: what the engine prefers)",
    )
    run.add_argument(
        "--step",
        metavar="S",
        type=float,
        help="longest time step, s; then no tolerance is enforced",
    )
    run.add_argument(
        "--diameter",
        choices=["auto", "physical", "gauge"],
        help="LAMMPS only: positions from the real diameters, or from a far smaller one, which "
        "reduces round-off",
    )
    run.add_argument(
        "--threads", metavar="P", type=int, help="native only: threads that share a long chain"
    )
    _ranks(run)
    _own(run)
    _max_wall(run)

    resume = verbs.add_parser(
        "resume", help="continue the run in a folder, bit-identical to a run without the stop"
    )
    resume.add_argument("folder", metavar="FOLDER", help="folder that lmpchain run -o FOLDER/ made")
    _ranks(resume)
    _max_wall(resume)
    resume.set_defaults(command=commands.resume)

    compare = verbs.add_parser(
        "compare", help="solve a scene with several engines, compare with a reference"
    )
    _scene(compare, commands.compare)
    compare.add_argument(
        "--engines", metavar="A,B,...", help="engines (default: all that can solve the scene)"
    )
    _tolerance(compare)
    compare.add_argument(
        "-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)"
    )
    compare.add_argument("--json", metavar="FILE", help="file for the numbers")

    plan = verbs.add_parser(
        "plan", help="show which engine solves a scene at the lowest cost, and why"
    )
    plan.add_argument("scene", metavar="SCENE.toml", nargs="?", help="scene file")
    plan.set_defaults(command=commands.plan)
    _tolerance(plan)
    plan.add_argument("--json", metavar="FILE", help="file for the numbers")
    plan.add_argument(
        "--calibrate",
        action="store_true",
        help="measure the speed of the engines on this machine and store it for the cost model",
    )

    orbit = verbs.add_parser(
        "orbit", help="periodic orbit of the chain: a linear mode followed up to an energy"
    )
    _scene(orbit, commands.orbit)
    orbit.add_argument(
        "--mode", metavar="K", type=int, required=True, help="number of the mode, the lowest is 1"
    )
    orbit.add_argument(
        "--energy", metavar="E", type=float, required=True, help="energy above rest, J"
    )
    orbit.add_argument(
        "-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)"
    )
    orbit.add_argument("--json", metavar="FILE", help="file for the numbers")
    sensitivity.add(verbs)
    deck = verbs.add_parser("deck", help="write a LAMMPS input that runs by itself")
    _scene(deck, commands.deck)
    deck.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        required=True,
        help="folder for in.column and column.data",
    )
    _tolerance(deck)
    deck.add_argument(
        "--step", metavar="S", type=float, help="longest time step, s (default: from the tolerance)"
    )
    deck.add_argument("--diameter", choices=["physical", "gauge", "auto"], default="physical")
    deck.add_argument("--integrator", choices=["verlet", "kahan-li6"], default="verlet")
    deck.add_argument(
        "--pair-style", choices=["granular", "gran/hertz/history"], default="granular"
    )
    _own(deck)

    dyson = verbs.add_parser(
        "dyson", help="weighted velocities of Eq. (22), beside the mean over random chains"
    )
    _saved(dyson, commands.dyson)
    dyson.add_argument(
        "--m",
        metavar="M,M,...",
        required=True,
        help="orders of Dyson's distribution, such as 1,2,5,20",
    )
    dyson.add_argument(
        "--realisations",
        metavar="R",
        type=int,
        default=200,
        help="random chains each (default: 200)",
    )
    dyson.add_argument(
        "--seed", metavar="S", type=int, default=1, help="seed of the random chains (default: 1)"
    )
    dyson.add_argument(
        "-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)"
    )
    dyson.add_argument("--json", metavar="FILE", help="file for the numbers")
    fit = verbs.add_parser(
        "fit", help="fit the theory to a saved run or a LAMMPS dump: modes, speeds, the front"
    )
    _saved(fit, commands.fit)
    fit.add_argument("--json", metavar="FILE", help="file for the numbers")
    report = verbs.add_parser(
        "report", help="write a page about a saved run: pictures, fits, errors, provenance"
    )
    _saved(report, commands.report)
    report.add_argument(
        "-o",
        "--output",
        metavar="REPORT.html",
        help="file to write (default: RUN.html beside the run)",
    )

    workprec = verbs.add_parser(
        "workprec", help="work-precision chart of every engine and integrator on a scene"
    )
    _scene(workprec, commands.workprec)
    workprec.add_argument(
        "--budget",
        metavar="S",
        type=float,
        default=60.0,
        help="about how long it may take, s (default: 60)",
    )
    workprec.add_argument(
        "-o",
        "--output",
        metavar="CHART.png",
        help="picture to write (.png, .pdf or .svg), with its numbers beside it",
    )
    workprec.add_argument(
        "--json", metavar="FILE", help="file for the numbers (default: CHART.json)"
    )

    stability = verbs.add_parser(
        "stability", help="find where methods fail on a scene: steps, round-off, chaos, theories"
    )
    _scene(stability, commands.stability)
    stability.add_argument(
        "-o", "--output", metavar="CHART.png", help="picture to write (.png, .pdf or .svg)"
    )
    stability.add_argument("--json", metavar="FILE", help="file for the numbers")

    sweep = verbs.add_parser(
        "sweep", help="solve many scenes: a grid, a list, random draws, disordered chains"
    )
    sweep.add_argument("sweep", metavar="SWEEP.toml", help="sweep file")
    sweep.add_argument(
        "-o", "--output", metavar="FOLDER", required=True, help="folder for the results"
    )
    by = sweep.add_mutually_exclusive_group()
    by.add_argument(
        "--workers", metavar="P", type=int, help="processes of this machine (default: one a core)"
    )
    by.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask scheduler whose workers solve the scenes"
    )
    sweep.set_defaults(command=commands.sweep)

    doctor = verbs.add_parser(
        "doctor", help="check the installation: LAMMPS, MPI, versions, cores, engines"
    )
    doctor.add_argument("--json", metavar="FILE", help="file for the findings")
    doctor.set_defaults(command=commands.doctor)

    verbs.add_parser("docs", help="open the pages of the documentation").set_defaults(
        command=commands.docs
    )
    return parser


def _scene(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file")
    parser.set_defaults(command=command)


def _ranks(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ranks",
        metavar="P",
        type=int,
        help="LAMMPS only: MPI processes that share the chain (not under mpirun)",
    )


def _own(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--template", metavar="FILE", help="LAMMPS only: your own deck, with placeholders (Jinja2)"
    )
    parser.add_argument(
        "--include", metavar="FILE", help="LAMMPS only: your own fixes, computes and dumps"
    )


def _max_wall(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--max-wall",
        metavar="H:MM:SS",
        type=_duration,
        help="run folders only: after this time (or so many seconds), save and stop with exit code "
        "75; lmpchain resume continues. Leave some seconds to the time limit of the queue",
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


def _saved(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument(
        "run",
        metavar="RUN.nc",
        help="file that lmpchain run saved, or a dump such as column.lammpstrj",
    )
    parser.add_argument(
        "--scene", metavar="SCENE.toml", help="for a dump: the scene that it was made for"
    )
    parser.add_argument(
        "--axis",
        choices=["x", "y", "z"],
        help="for a dump: along which the column stands (default: seen)",
    )
    parser.set_defaults(command=command)


def _tolerance(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--tolerance",
        metavar="X",
        type=float,
        default=1e-6,
        help="largest relative error (default: 1e-6)",
    )
