"""The command `sensitivity`: what an answer of a saved run depends on."""

from __future__ import annotations

import argparse
from typing import Any

from ..errors import InputError
from .common import PICTURES, gather, keep, output

UNCERTAIN = {
    "diameter": "diameters",
    "modulus": "youngs_moduli",
    "mass": "masses",
    "constant": "contact_constants",
}


def add(verbs: Any) -> None:
    """Add the command to those of the command line."""
    parser = verbs.add_parser(
        "sensitivity", help="what an answer of a saved run depends on, grain by grain"
    )
    parser.add_argument("run", metavar="RUN.nc", help="saved run, or a scene file")
    parser.add_argument(
        "--of",
        metavar="ANSWER",
        required=True,
        help="peak_force:CONTACT, momentum:GRAINS, energy:GRAINS, kinetic_energy:GRAINS (such as "
        "3-9) or arrival_time:GRAIN@VELOCITY",
    )
    for name in UNCERTAIN:
        parser.add_argument(
            f"--{name}",
            metavar="PART",
            type=float,
            help=f"uncertainty of each {name}, as a part of it",
        )
    parser.add_argument(
        "--tolerance",
        metavar="X",
        type=float,
        default=1e-4,
        help="of the derivatives (default: 1e-4)",
    )
    parser.add_argument(
        "-o", "--output", metavar="PICTURE.png", help="picture along the chain (.png, .pdf or .svg)"
    )
    parser.add_argument("--json", metavar="FILE", help="file for the numbers")
    parser.set_defaults(command=sensitivity)


def sensitivity(arguments: argparse.Namespace) -> int:
    """Rank what an answer of a saved run depends on."""
    from ..design.sensitivities import objective

    scene, picture, numbers, _ = gather(
        lambda: _scene(arguments.run),
        lambda: arguments.output and output(arguments.output, arguments.run, PICTURES),
        lambda: arguments.json and output(arguments.json, arguments.run),
        lambda: objective(arguments.of),
    )
    from ..design.sensitivities import sensitivity as found

    uncertain = {field: getattr(arguments, name) for name, field in UNCERTAIN.items()}
    given = {field: share for field, share in uncertain.items() if share is not None}
    result = found(scene, arguments.of, given, arguments.tolerance)
    print(result.table())
    keep(result, numbers, picture)
    return 0


def _scene(path: str) -> Any:
    """Return the scene of a saved run, or of a scene file."""
    if path.endswith(".toml"):
        from .common import read

        return read(path)
    from ..trajectory.lammps_dump import is_dump
    from ..trajectory.trajectory import Trajectory

    if is_dump(path):
        raise InputError.at(path, "is a LAMMPS dump: give its scene, SCENE.toml, in its place")
    return Trajectory.load(path).scene
