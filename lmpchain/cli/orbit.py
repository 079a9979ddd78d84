"""The command `orbit`: a nonlinear normal mode, or the response of a chain to a drive."""

from __future__ import annotations

import argparse
from contextlib import suppress
from typing import TYPE_CHECKING

from ..errors import InputError, shown
from .common import check_outputs, collect, keep, on_terminal, read_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..orbits.family import Family
    from ..scene.scene import Scene


def orbit(arguments: argparse.Namespace) -> int:
    """Continue a nonlinear normal mode up to an energy, or a driven response up to a value."""
    scene, (name, until), picture, numbers = collect(
        lambda: read_scene(arguments.scene),
        lambda: _read_goal(arguments),
        *check_outputs(arguments, arguments.scene),
    )
    if name:
        family = _answers(scene, name, until)
    else:
        from ..orbits.modes import mode_family

        family = mode_family(scene.chain, arguments.mode, arguments.energy, progress=on_terminal())
    if arguments.draw not in ("", "energy"):
        family[0].response(arguments.draw)
    print("\n".join(_describe(family)))
    keep(family, numbers, None)
    # This command draws two results: the family and its last orbit.
    if picture:
        from ..util.plotting import save

        save(_picture(family, arguments.draw), picture, overwrite=True)
        print(f"picture: {picture}")
    return 0 if family.reached else 1


def _read_goal(arguments: argparse.Namespace) -> tuple[str, float]:
    """Return the continuation parameter and its final value; the name is empty for a mode."""
    mode, energy = arguments.mode is not None, arguments.energy is not None
    if mode != energy or mode == (arguments.follow is not None):
        cure = "give --mode and --energy, or --follow drive.frequency=1.2e4"
        raise InputError.at("orbit", f"needs a mode or a drive to follow, not both: {cure}")
    if mode:
        return "", 0.0
    name, _, value = arguments.follow.partition("=")
    # An empty name would stand for a mode.
    with suppress(ValueError):
        if name:
            return name, float(value)
    example = f"drive.frequency=1.2e4 (got {shown(arguments.follow)})"
    raise InputError.at("--follow", f"must be a number and its last value, as {example}")


def _answers(scene: Scene, name: str, until: float) -> Family:
    """Return the periodic responses to a drive, continued in a parameter up to a value."""
    from .. import orbits

    first = orbits.find(scene.chain, drive=scene.excitation)
    return orbits.follow(first, name, until, progress=on_terminal())


def _describe(family: Family) -> list[str]:
    """Return lines about the last orbit and the bifurcations before it."""
    last = family[-1]
    state = "stable" if last.stable else f"unstable, largest multiplier {abs(last.unstable[0]):.6g}"
    driven = last.drive is not None
    first = "at the start" if driven else "linear"
    frequencies = f"{1 / last.period:.6g} Hz; {first}: {1 / family[0].period:.6g} Hz"
    lines = [
        f"period: {last.period:.12g} s ({frequencies})",
        f"energy: {last.energy:.6g} J",
        f"largest displacement: {last.amplitude:.6g} m",
        f"residual after a period: {last.residual:.1e}; error of the steps: {last.error:.1e}",
        f"Floquet multipliers: {state}",
    ]
    unit = f"of {family.parameter}" if driven else "J"
    lines += [
        f"{event.kind}: at {event.value:.6g} {unit}, {1 / event.orbit.period:.6g} Hz"
        for event in family.events
    ]
    if not family.reached:
        goal = f"requested {family.parameter}"
        lines.append(f"the family does not reach the {goal}: {family.ended}")
    return lines


def _picture(family: Family, of: str) -> Figure:
    from ..util.plotting import PRINTED_WIDTH, figure, letter_panels

    picture = figure(PRINTED_WIDTH, 3.6)
    first, right = picture.subplots(1, 2)
    family.plot(first, of)
    family[-1].plot(right)
    letter_panels([first, right])
    return picture
