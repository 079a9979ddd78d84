"""The command `check`: the true error of a run or dump, or the expected error of a deck."""

from __future__ import annotations

import argparse

from ..errors import InputError, check_tolerance
from .common import check_numbers, collect, keep, on_terminal, read_scene


def check(arguments: argparse.Namespace) -> int:
    """Print the true error of a run, its causes and cures; exit code 1 if it misses a tolerance."""
    subject = arguments.run or arguments.deck
    if not subject or (arguments.run and arguments.deck):
        raise InputError.at("run", "give either a dump or saved run, or --deck FOLDER")
    scene, numbers, _ = collect(
        lambda: arguments.scene and read_scene(arguments.scene),
        lambda: check_numbers(arguments, arguments.scene or subject),
        lambda: check_tolerance(0.5 if arguments.tolerance is None else arguments.tolerance),
    )
    from ..benchmark.own_run import check, check_deck

    if arguments.deck and arguments.units:
        raise InputError.at("units", "is only for a LAMMPS dump: leave it out for a deck")
    if arguments.deck:
        result = check_deck(subject, scene, progress=on_terminal())
    else:
        result = check(subject, scene, units=arguments.units, progress=on_terminal())
    print(result.table())
    keep(result, numbers, None)
    return int(arguments.tolerance is not None and result.exceeds(arguments.tolerance))
