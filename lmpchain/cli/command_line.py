"""The command line: one function a verb, in `commands`.

Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 the time of --max-wall was over
before the run was, 130 after Ctrl-C, 143 after SIGTERM.
"""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from ..errors import InputError, LmpchainError
from ..util import mpi
from . import commands
from .common import complain


class _Terminated(BaseException):
    """SIGTERM arrived. Not an Exception, so that nothing on the way out takes it for a fault."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; under mpirun, rank 0 does and the others help it.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the name of the program; those of the process by default.
    """
    if mpi.launched() == 1:
        return _main(argv)
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
        return _main(argv)
    finally:
        shutdown_workers(world)


def _main(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as asked:  # --help, --version, or arguments that argparse refused and explained
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
    except OSError as error:  # such as a full disk behind stdout
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
    """Say what is left of a command that was stopped."""
    from ..simulation.task import is_run, resume_command

    if arguments.command is commands.sweep:
        return f"what is done is kept in {arguments.output}; the same command goes on from there"
    folder = commands.run_folder(arguments)
    if folder and is_run(folder):
        return f"to go on: {resume_command(folder)}"
    hint = (
        "; with -o FOLDER/ what is done is kept, and can be gone on with" if arguments.command is commands.run else ""
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


class _Parser(argparse.ArgumentParser):
    """Complain in the form of all other faults, without the usage in between."""

    def error(self, message: str) -> NoReturn:
        named = message.removeprefix("argument ")
        complain(f"{'arguments: ' if named == message else ''}{named}; see {self.prog} --help")
        sys.exit(2)


class _ShowVersion(argparse.Action):
    """Look the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"lmpchain {version('lmpchain')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="lmpchain",
        description="Waves in columns of Hertzian grains: LAMMPS and a native integrator, side by side, each with an "
        "estimate of its own error. All quantities are in SI units.",
        epilog="Exit codes: 0 done, 1 the run failed or missed its tolerance, 2 the input is wrong, 75 the time of "
        "--max-wall was over before the run was, 130 after Ctrl-C, 143 after SIGTERM.",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show the version and exit")
    verbs = parser.add_subparsers(metavar="COMMAND", required=True)

    run = verbs.add_parser("run", help="answer a scene and save the trajectory, in a file or a run folder")
    _scene(run, commands.run)
    run.add_argument(
        "-o",
        "--output",
        metavar="RUN.nc|FOLDER/",
        help="NetCDF file to write (default: SCENE.nc beside the scene); or, with a / at its end, a run folder, in "
        "which the output grows on the disk and the run can be gone on with after a stop of any kind",
    )
    run.add_argument("--engine", metavar="E", default="auto", help="which engine answers (default: auto)")
    _tolerance(run)
    run.add_argument("--integrator", metavar="I", help="rkn6, kahan-li6 or verlet (default: what the engine prefers)")
    run.add_argument("--step", metavar="S", type=float, help="longest time step, s; then no tolerance is enforced")
    run.add_argument(
        "--diameter",
        choices=["auto", "physical", "gauge"],
        help="LAMMPS only: positions from the real diameters, or from a far smaller one that leaves more digits",
    )

    run.add_argument(
        "--ranks", metavar="P", type=int, help="LAMMPS only: MPI processes that share the chain (not under mpirun)"
    )

    _own(run)

    _max_wall(run)

    resume = verbs.add_parser("resume", help="go on with the run in a folder, to the same bits as without the stop")
    resume.add_argument("folder", metavar="FOLDER", help="folder that lmpchain run -o FOLDER/ made")
    _max_wall(resume)
    resume.set_defaults(command=commands.resume)

    compare = verbs.add_parser("compare", help="answer a scene with several engines and compare with the truth")
    _scene(compare, commands.compare)
    compare.add_argument("--engines", metavar="A,B,...", help="which engines (default: all that can do the scene)")
    _tolerance(compare)
    compare.add_argument("-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)")
    compare.add_argument("--json", metavar="FILE", help="file for the numbers")

    plan = verbs.add_parser("plan", help="say which engine answers a scene at the least cost, and why")
    plan.add_argument("scene", metavar="SCENE.toml", nargs="?", help="scene file")
    plan.set_defaults(command=commands.plan)
    _tolerance(plan)
    plan.add_argument("--json", metavar="FILE", help="file for the numbers")
    plan.add_argument(
        "--calibrate",
        action="store_true",
        help="measure how fast the engines are here, and keep it for all plans",
    )

    deck = verbs.add_parser("deck", help="write a LAMMPS input that runs by itself")
    _scene(deck, commands.deck)
    deck.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder for in.column and column.data")
    _tolerance(deck)
    deck.add_argument("--step", metavar="S", type=float, help="longest time step, s (default: from the tolerance)")
    deck.add_argument("--diameter", choices=["physical", "gauge", "auto"], default="physical")
    deck.add_argument("--integrator", choices=["verlet", "kahan-li6"], default="verlet")
    deck.add_argument("--pair-style", choices=["granular", "gran/hertz/history"], default="granular")
    _own(deck)

    dyson = verbs.add_parser("dyson", help="weigh a run over depth as Eq. (22) does; average over random chains")
    _saved(dyson, commands.dyson)
    dyson.add_argument("--m", metavar="M,M,...", required=True, help="orders of Dyson's distribution, such as 1,2,5,20")
    dyson.add_argument("--realisations", metavar="R", type=int, default=200, help="random chains each (default: 200)")
    dyson.add_argument("--seed", metavar="S", type=int, default=1, help="which random chains (default: 1)")
    dyson.add_argument("-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)")
    dyson.add_argument("--json", metavar="FILE", help="file for the numbers")

    fit = verbs.add_parser("fit", help="fit the theory to a saved run or a LAMMPS dump: modes, speeds, the front")
    _saved(fit, commands.fit)
    fit.add_argument("--json", metavar="FILE", help="file for the numbers")

    report = verbs.add_parser("report", help="write a page about a saved run: pictures, fits, errors, provenance")
    _saved(report, commands.report)
    report.add_argument(
        "-o", "--output", metavar="REPORT.html", help="file to write (default: RUN.html beside the run)"
    )

    workprec = verbs.add_parser("workprec", help="chart speed against accuracy: every engine and integrator on a scene")
    _scene(workprec, commands.workprec)
    workprec.add_argument(
        "--budget", metavar="S", type=float, default=60.0, help="about how long it may take, s (default: 60)"
    )
    workprec.add_argument(
        "-o", "--output", metavar="CHART.png", help="picture to write (.png, .pdf or .svg), with its numbers beside it"
    )
    workprec.add_argument("--json", metavar="FILE", help="file for the numbers (default: CHART.json)")

    stability = verbs.add_parser(
        "stability", help="find where methods fail on a scene: steps, round-off, chaos, theories"
    )
    _scene(stability, commands.stability)
    stability.add_argument("-o", "--output", metavar="CHART.png", help="picture to write (.png, .pdf or .svg)")
    stability.add_argument("--json", metavar="FILE", help="file for the numbers")

    sweep = verbs.add_parser("sweep", help="answer many scenes: a grid, a list, random draws, disordered chains")
    sweep.add_argument("sweep", metavar="SWEEP.toml", help="sweep file")
    sweep.add_argument("-o", "--output", metavar="FOLDER", required=True, help="folder for the results")
    by = sweep.add_mutually_exclusive_group()
    by.add_argument("--workers", metavar="P", type=int, help="processes of this machine (default: one a core)")
    by.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler whose workers answer the scenes")
    sweep.set_defaults(command=commands.sweep)

    doctor = verbs.add_parser("doctor", help="say what works here: LAMMPS, MPI, versions, cores, engines")
    doctor.add_argument("--json", metavar="FILE", help="file for the findings")
    doctor.set_defaults(command=commands.doctor)
    return parser


def _scene(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="scene file")
    parser.set_defaults(command=command)


def _own(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--template", metavar="FILE", help="LAMMPS only: your own deck, with placeholders (Jinja2)")
    parser.add_argument("--include", metavar="FILE", help="LAMMPS only: your own fixes, computes and dumps")


def _max_wall(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--max-wall",
        metavar="H:MM:SS",
        type=_duration,
        help="run folders only: after this time (or so many seconds), keep what is done and stop with exit code 75; "
        "lmpchain resume goes on. Leave some seconds to the limit of the queue",
    )


def _duration(text: str) -> float:
    """Return H:MM:SS, or seconds, as seconds."""
    found = re.fullmatch(r"(?:(\d+):([0-5]\d):)?(\d+(?:\.\d+)?)", text, re.ASCII)
    hours, minutes, seconds = found.groups() if found else (None, None, 0)
    total = 3600 * int(hours or 0) + 60 * int(minutes or 0) + float(seconds)
    if not total or (hours and float(seconds) >= 60):
        raise argparse.ArgumentTypeError(f"must be a time above 0, as H:MM:SS or in seconds (got {text!r})")
    return total


def _saved(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument(
        "run", metavar="RUN.nc", help="file that lmpchain run saved, or a dump such as column.lammpstrj"
    )
    parser.add_argument("--scene", metavar="SCENE.toml", help="for a dump: the scene that it was made for")
    parser.set_defaults(command=command)


def _tolerance(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--tolerance", metavar="X", type=float, default=1e-6, help="largest relative error (default: 1e-6)"
    )


if __name__ == "__main__":
    sys.exit(main())
