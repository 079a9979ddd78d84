"""The command `plan`: expected cost and error of each engine, and calibration of this machine."""

from __future__ import annotations

import argparse

from ..errors import InputError, LmpchainError, check_tolerance
from ..util.tables import align, number
from .common import check_numbers, collect, keep, read_scene


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
    from ..simulation.calibration import calibrate

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
