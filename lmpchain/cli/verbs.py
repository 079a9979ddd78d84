"""Verbs of the command line with their arguments in the form of `argparse`."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from ..errors import shown
from .common import STANDARD
from .compare import check, compare, doctor, stability, workprec
from .new import EXAMPLES, docs, new
from .orbit import orbit
from .read import UNCERTAIN, dyson, explore, export, fit, report, sensitivity
from .run import averages, deck, plan, resume, run, sweep


def _duration(text: str) -> float:
    """Convert H:MM:SS, or a number of seconds, to seconds."""
    match = re.fullmatch(r"(?:(\d+):([0-5]\d):)?(\d+(?:\.\d+)?)", text, re.ASCII)
    hours, minutes, seconds = match.groups() if match else (None, None, 0)
    total = 3600 * int(hours or 0) + 60 * int(minutes or 0) + float(seconds)
    # A plain 90 is a time in seconds, but 0:00:90 is a typing error.
    if not total or (hours and float(seconds) >= 60):
        raise argparse.ArgumentTypeError(
            f"must be a time above 0, as H:MM:SS or in seconds (got {shown(text)})"
        )
    return total


# Names and options in the form of `add_argument` of argparse.
Argument = tuple[tuple[str, ...], dict[str, Any]]


class Verb(NamedTuple):
    """A command with its summary and an example.

    At most one of the arguments in `choice` may be given. `renamed` maps earlier spellings of
    options, which are still accepted, to the present ones.
    """

    command: Callable[[argparse.Namespace], int]
    summary: str
    example: str
    arguments: Sequence[Argument]
    choice: Sequence[Argument] = ()
    renamed: Mapping[str, str] = MappingProxyType({})


def _argument(*names: str, **options: Any) -> Argument:
    """Return the names and the options of an argument."""
    return names, options


# Arguments that several commands share.
SCENE = _argument("scene", metavar="SCENE.toml", help="scene file, or - for standard input")
TOLERANCE = _argument(
    "--tolerance",
    metavar="X",
    type=float,
    default=1e-6,
    help="largest relative error (default: 1e-6)",
)
PICTURE = _argument(
    "-o", "--output", metavar="PICTURE.png", help="picture to write (.png, .pdf or .svg)"
)
NUMBERS = _argument(
    "--json",
    metavar="FILE",
    nargs="?",
    const=STANDARD,
    help="write the numbers as JSON: to a file, or without its name to standard output, and the "
    "text to standard error",
)
FORCE = _argument("--force", action="store_true", help="replace files that lmpchain did not write")
RANKS = _argument(
    "--ranks",
    metavar="P",
    type=int,
    help="LAMMPS only: MPI processes that share the chain (not under mpirun)",
)
MAX_WALL = _argument(
    "--max-wall",
    metavar="H:MM:SS",
    type=_duration,
    help="run folders only: after this time (or so many seconds), save and stop with exit code 75; "
    "lmpchain resume continues the run. Stay some seconds below the time limit of the queue",
)
TEMPLATES = (
    _argument(
        "--template", metavar="FILE", help="LAMMPS only: your own deck, with placeholders (Jinja2)"
    ),
    _argument("--include", metavar="FILE", help="LAMMPS only: your own fixes, computes and dumps"),
)
DUMP_UNITS = _argument(
    "--units",
    metavar="STYLE",
    help="for a dump: LAMMPS unit style, or the units LENGTH,TIME,MASS in m, s, kg (default: "
    "those named in the dump, or si)",
)
# Information that a dump or an input may lack, for `new --from`.
OF_A_RUN = (
    _argument("--material", metavar="NAME", help="with --from: material of the grains"),
    *(
        _argument(f"--{key}", metavar="X", type=float, help=f"with --from: {text}")
        for key, text in {
            "young": "Young's modulus in Pa, instead of a material",
            "poisson": "Poisson's ratio, instead of a material",
            "density": "density in kg/m3, if the run has no masses",
            "timestep": "time step in s, if the run does not have it",
            "duration": "duration in s, if the run does not have it",
        }.items()
    ),
    _argument(
        "--grain-diameter",
        dest="diameter",
        metavar="X",
        type=float,
        help="with --from: diameter of the grains in m, if the run has no radii",
    ),
    _argument(
        "--samples", metavar="N", type=int, help="with --from: number of samples of the scene"
    ),
    DUMP_UNITS,
)
# Arguments for a saved run, or for a dump with its scene.
RUN = (
    _argument(
        "run",
        metavar="RUN.nc",
        help="file that lmpchain run saved, or a dump such as column.lammpstrj",
    ),
    _argument("--scene", metavar="SCENE.toml", help="for a dump: the scene that it was made for"),
    _argument(
        "--axis",
        choices=["x", "y", "z"],
        help="for a dump: axis of the column (default: detected)",
    ),
    DUMP_UNITS,
)
VERBS = {
    "new": Verb(
        new,
        "write a commented example scene, as input of the other commands",
        "new striker.toml --example striker",
        (
            _argument(
                "new_scene", metavar="SCENE.toml", help="file to write, or - for standard output"
            ),
            _argument(
                "--example",
                metavar="NAME",
                choices=list(EXAMPLES),
                help="; ".join(f"{key}: {text}" for key, text in EXAMPLES.items())
                + " (default: column)",
            ),
            _argument(
                "--from",
                dest="run",
                metavar="FILE",
                nargs="+",
                help="make a scene from your own LAMMPS run: its dump, its input or data "
                "file, or a dump and its input; files are read and never executed",
            ),
            *OF_A_RUN,
            _argument("--force", action="store_true", help="replace the file if it is there"),
        ),
    ),
    "run": Verb(
        run,
        "solve a scene and save the trajectory, in a file or a run folder",
        "run scene.toml --engine lammps --tolerance 1e-6 -o run.nc",
        (
            SCENE,
            _argument(
                "-o",
                "--output",
                metavar="RUN.nc|FOLDER/",
                help="NetCDF file to write (default: SCENE.nc beside the scene); or, with a / at "
                "its end, a run folder, in which the output grows on the disk and which `lmpchain "
                "resume` continues after a stop of any kind",
            ),
            _argument(
                "--force",
                action="store_true",
                help="replace an existing file or run",
            ),
            _argument("--engine", metavar="E", default="auto", help="engine (default: auto)"),
            TOLERANCE,
            _argument(
                "--integrator",
                metavar="I",
                help="rkn6, kahan-li6 or verlet; of native also auto, rkn4, kahan-li8, dop853 and "
                "gear4 (default: what the engine prefers)",
            ),
            _argument(
                "--step",
                metavar="S",
                type=float,
                help="longest time step, s; without enforcing a tolerance",
            ),
            _argument(
                "--diameter",
                choices=["auto", "physical", "gauge"],
                help="LAMMPS only: positions from the real diameters, or from a far smaller one, "
                "which reduces round-off",
            ),
            _argument(
                "--threads",
                metavar="P",
                type=int,
                help="native only: threads that share a long chain",
            ),
            RANKS,
            *TEMPLATES,
            MAX_WALL,
            NUMBERS,
        ),
    ),
    "resume": Verb(
        resume,
        "continue the run in a folder, bit-identical to a run without the stop",
        "resume job/ --max-wall 0:25:00",
        (
            _argument("folder", metavar="FOLDER", help="folder that lmpchain run -o FOLDER/ made"),
            RANKS,
            MAX_WALL,
            NUMBERS,
            FORCE,
        ),
    ),
    "compare": Verb(
        compare,
        "solve a scene with several engines, compare with a reference",
        "compare scene.toml --engines lammps,native -o compare.png",
        (
            SCENE,
            _argument(
                "--engines",
                metavar="A,B,...",
                help="engines (default: all that can solve the scene)",
            ),
            TOLERANCE,
            _argument(
                "--budget",
                metavar="S",
                type=float,
                default=30.0,
                help="longest expected time of an engine, s; beyond it, its tolerance is relaxed "
                "(default: 30)",
            ),
            PICTURE,
            NUMBERS,
            FORCE,
        ),
    ),
    "plan": Verb(
        plan,
        "show which engine solves a scene at the lowest cost, and why",
        "plan scene.toml --tolerance 1e-9",
        (
            _argument(
                "scene",
                metavar="SCENE.toml",
                nargs="?",
                help="scene file, or - for standard input",
            ),
            TOLERANCE,
            _argument(
                "--engine",
                metavar="E",
                help="show the cost of this engine, such as lammps, for each of its "
                "integrators (default: all engines)",
            ),
            NUMBERS,
            FORCE,
            _argument(
                "--calibrate",
                action="store_true",
                help="measure the speed of the engines on this machine and store it for the cost "
                "model",
            ),
        ),
    ),
    "averages": Verb(
        averages,
        "compute time averages with confidence intervals, for chaotic chains",
        "averages box.toml --of temperature,force:10 --time 10 -o averages.png",
        (
            SCENE,
            _argument(
                "--of",
                metavar="A,B,...",
                required=True,
                help="kinetic_energy, potential_energy, temperature, equipartition, force:CONTACT, "
                "kinetic_energy:GRAIN, velocity:GRAIN, displacement:GRAIN",
            ),
            _argument(
                "--time",
                metavar="S",
                type=float,
                help="total time, s, including the warm-up (default: the duration of the scene)",
            ),
            _argument(
                "--warm-up",
                metavar="S",
                type=float,
                help="time left out at the beginning, s (default: a fifth of the total)",
            ),
            _argument(
                "--copies",
                metavar="R",
                type=int,
                default=1,
                help="number of slightly different chains that are averaged together, on all cores "
                "(default: 1)",
            ),
            _argument(
                "--energy-tolerance",
                metavar="X",
                type=float,
                default=1e-4,
                help="largest relative error of the energy (default: 1e-4)",
            ),
            PICTURE,
            NUMBERS,
            FORCE,
        ),
        renamed={"--tolerance": "--energy-tolerance"},
    ),
    "orbit": Verb(
        orbit,
        "find periodic orbits: a linear mode up to an energy, or the response to a drive",
        "orbit scene.toml --mode 1 --energy 1e-9 -o orbit.png",
        (
            SCENE,
            _argument(
                "--mode",
                metavar="K",
                type=int,
                help="number of the mode, counted from 1 by frequency",
            ),
            _argument("--energy", metavar="E", type=float, help="energy above rest, J"),
            _argument(
                "--follow",
                metavar="NUMBER=UNTIL",
                help="follow the response to the drive of the scene up to this value of "
                "drive.frequency, drive.amplitude, damping.drag, chain.top_load ...",
            ),
            _argument(
                "--draw",
                metavar="SIZE",
                default="",
                help="size of the motion in the picture: amplitude, displacement:GRAIN, "
                "force:CONTACT or energy (default: amplitude, and energy for a mode)",
            ),
            PICTURE,
            NUMBERS,
            FORCE,
        ),
        renamed={"--of": "--draw"},
    ),
    "sensitivity": Verb(
        sensitivity,
        "rank the influence of each grain on a quantity of a saved run",
        "sensitivity run.nc --answer peak_force:10 --sigma-diameter 0.01 -o sensitivity.png",
        (
            _argument("run", metavar="RUN.nc|SCENE.toml", help="saved run, or a scene file"),
            _argument(
                "--answer",
                metavar="ANSWER",
                required=True,
                help="peak_force:CONTACT, momentum:GRAINS, energy:GRAINS, kinetic_energy:GRAINS "
                "(such as 3-9) or arrival_time:GRAIN@VELOCITY",
            ),
            # Each uncertain parameter has an option.
            *(
                _argument(
                    f"--sigma-{name}",
                    metavar="PART",
                    type=float,
                    help=f"relative uncertainty of each {quantity}, 0.01 for 1 %%",
                )
                for name, (_, quantity) in UNCERTAIN.items()
            ),
            _argument(
                "--derivative-tolerance",
                metavar="X",
                type=float,
                default=1e-4,
                help="largest relative error of the derivatives (default: 1e-4)",
            ),
            PICTURE,
            NUMBERS,
            FORCE,
        ),
        renamed={"--of": "--answer", "--tolerance": "--derivative-tolerance"}
        | {f"--{name}": f"--sigma-{name}" for name in UNCERTAIN},
    ),
    "deck": Verb(
        deck,
        "write a LAMMPS input that runs by itself",
        "deck scene.toml -o deck",
        (
            SCENE,
            _argument(
                "-o",
                "--output",
                metavar="FOLDER",
                required=True,
                help="folder for in.column and column.data",
            ),
            TOLERANCE,
            _argument(
                "--step",
                metavar="S",
                type=float,
                help="longest time step, s (default: from the tolerance)",
            ),
            _argument("--diameter", choices=["physical", "gauge", "auto"], default="physical"),
            _argument("--integrator", choices=["verlet", "kahan-li6"], default="verlet"),
            _argument(
                "--pair-style", choices=["granular", "gran/hertz/history"], default="granular"
            ),
            FORCE,
            *TEMPLATES,
        ),
    ),
    "dyson": Verb(
        dyson,
        "compute the weighted velocities of Eq. (22) and their mean over random chains",
        "dyson run.nc --m 1,5,20 -o dyson.png",
        (
            *RUN,
            _argument(
                "--m",
                metavar="M,M,...",
                required=True,
                help="orders of Dyson's distribution, such as 1,2,5,20",
            ),
            _argument(
                "--realisations",
                metavar="R",
                type=int,
                default=200,
                help="random chains each (default: 200)",
            ),
            _argument(
                "--seed",
                metavar="S",
                type=int,
                default=1,
                help="seed of the random chains (default: 1)",
            ),
            PICTURE,
            NUMBERS,
            FORCE,
        ),
    ),
    "export": Verb(
        export,
        "write traces of a saved run as a CSV file: forces, velocities, energies",
        "export run.nc -o traces.csv --contact-force 10,wall --velocity 1",
        (
            *RUN,
            _argument(
                "-o",
                "--output",
                metavar="TRACE.csv",
                required=True,
                help="file to write, or - for standard output",
            ),
            FORCE,
            _argument(
                "--contact-force",
                metavar="N,wall",
                help="force of a sensor in each of these grains (mean of its two contacts) "
                "or walls: wall (the bottom one, if there is one), top, bottom",
            ),
            _argument("--velocity", metavar="N,N,...", help="velocity of these grains"),
            _argument("--displacement", metavar="N,N,...", help="displacement of these grains"),
            _argument(
                "--energies",
                action="store_true",
                help="kinetic and total energy, work of a drive, energy dissipated",
            ),
            _argument(
                "--above-rest",
                action="store_true",
                help="write forces relative to rest, as piezoelectric sensors do",
            ),
        ),
        renamed={"--energy": "--energies"},
    ),
    "check": Verb(
        check,
        "measure the true error of a run or deck, its causes and its cures",
        "check column.lammpstrj --scene scene.toml --tolerance 1e-3",
        (
            _argument(
                "run",
                metavar="DUMP_OR_RUN",
                nargs="?",
                help="LAMMPS dump, or file or folder of lmpchain run",
            ),
            _argument(
                "--scene",
                metavar="SCENE.toml",
                help="scene of the dump; a saved run contains its scene",
            ),
            DUMP_UNITS,
            _argument(
                "--deck",
                metavar="FOLDER",
                help="instead of a run: folder of lmpchain deck, edited or not, before its run",
            ),
            _argument(
                "--tolerance",
                metavar="X",
                type=float,
                help="return exit code 1 if the error is larger (default: never)",
            ),
            NUMBERS,
            FORCE,
        ),
    ),
    "fit": Verb(
        fit,
        "fit the theory to a saved run or a LAMMPS dump: modes, speeds, the front",
        "fit run.nc",
        (*RUN, NUMBERS, FORCE),
    ),
    "report": Verb(
        report,
        "write a page about a saved run: pictures, fits, errors, provenance",
        "report run.nc -o report.html",
        (
            *RUN,
            _argument(
                "-o",
                "--output",
                metavar="REPORT.html",
                help="file to write (default: RUN.html beside the run)",
            ),
            FORCE,
        ),
    ),
    "explore": Verb(
        explore,
        "write a page with sliders over precomputed runs of a scene",
        "explore scene.toml --over excitation.velocity=1e-6:1e-1:25:log -o explore.html",
        (
            SCENE,
            _argument(
                "--over",
                metavar="KEY=LOW:HIGH[:N][:log]",
                action="append",
                required=True,
                help="a slider: key of the scene file, range in SI units, number of runs "
                "(15 if left out), and log for equal ratios; repeat for more sliders",
            ),
            _argument(
                "-o",
                "--output",
                metavar="PAGE.html",
                required=True,
                help="page to write, up to 2 MB",
            ),
            FORCE,
            TOLERANCE,
        ),
    ),
    "workprec": Verb(
        workprec,
        "draw a work-precision chart of all engines and integrators on a scene",
        "workprec scene.toml --budget 30 -o chart.png",
        (
            SCENE,
            _argument(
                "--budget",
                metavar="S",
                type=float,
                default=60.0,
                help="approximate total time, s (default: 60)",
            ),
            _argument(
                "-o",
                "--output",
                metavar="CHART.png",
                help="picture to write (.png, .pdf or .svg), with its numbers beside it as .json",
            ),
            NUMBERS,
            FORCE,
        ),
    ),
    "stability": Verb(
        stability,
        "find where methods fail on a scene: steps, round-off, chaos, theories",
        "stability scene.toml -o stability.png",
        (SCENE, PICTURE, NUMBERS, FORCE),
    ),
    "sweep": Verb(
        sweep,
        "solve many scenes: a grid, a list, random draws, disordered chains",
        "sweep sweep.toml -o results --workers 4",
        (
            _argument("sweep", metavar="SWEEP.toml", help="sweep file"),
            _argument(
                "-o", "--output", metavar="FOLDER", required=True, help="folder for the results"
            ),
        ),
        (
            _argument(
                "--workers",
                metavar="P",
                type=int,
                help="number of processes on this machine (default: one per core)",
            ),
            _argument(
                "--scheduler",
                metavar="ADDRESS",
                help="address of a Dask scheduler whose workers solve the scenes",
            ),
        ),
    ),
    "doctor": Verb(
        doctor,
        "check the installation: LAMMPS, MPI, versions, cores, engines",
        "doctor",
        (
            NUMBERS,
            FORCE,
            _argument(
                "--compile",
                action="store_true",
                help="compile everything that runs need: for clusters and images",
            ),
        ),
    ),
    "docs": Verb(docs, "open the pages of the documentation", "docs", ()),
}

# Groups of commands in the help.
GROUPS = {
    "begin": ("new", "docs", "doctor"),
    "solve scenes": ("run", "resume", "sweep", "averages", "orbit"),
    "choose an engine": ("plan", "compare", "workprec", "stability"),
    "evaluate a run": ("check", "fit", "sensitivity", "dyson", "report", "explore", "export"),
    "write LAMMPS input": ("deck",),
}
