"""The command `plan`: which engine solves a scene at which cost, and how fast the engines are here."""

from __future__ import annotations

import argparse

from ..errors import InputError, LmpchainError, check_tolerance
from ..util.tables import aligned, number
from .common import gather, output, read, write_json


def plan(arguments: argparse.Namespace) -> int:
    """Print what every engine proposes for a scene and which one is chosen; calibrate the cost model."""
    if arguments.scene is None and not arguments.calibrate:
        raise InputError.at("scene", "is missing; name a scene file, or use --calibrate alone")
    if arguments.scene is None and arguments.json:
        raise InputError.at("json", "goes with a scene file; name one")
    scene, numbers, _ = gather(
        lambda: arguments.scene and read(arguments.scene),
        lambda: arguments.json and output(arguments.json, arguments.scene or ""),
        lambda: check_tolerance(arguments.tolerance),
    )
    if arguments.calibrate:
        _calibrate()
    if scene:
        from ..simulation.planner import plan

        chosen = plan(scene, arguments.tolerance)
        print(chosen.table())
        if numbers:
            write_json(chosen.to_json(), numbers)
            print(f"numbers: {numbers}")
    return 0


def _calibrate() -> None:
    from ..engines.cost_model import cache_file, measured
    from ..simulation.calibration import calibrate

    try:
        path, took = calibrate()
    except OSError as error:
        raise LmpchainError(
            f"{cache_file()}: cannot be written: {error.strerror or error}"
        ) from None
    print(f"measured in {took:.2g} s how fast the engines are here: {path}")
    rows = [("engine", "overhead of a run", "cost over the shipped one")]
    rows += [
        (name, number(1e3 * start, unit="ms"), f"{slowness:.2g}")
        for name, (start, slowness) in measured().items()
    ]
    print("\n".join(aligned(rows)))
