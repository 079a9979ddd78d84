"""The command `orbit`: the nonlinear normal mode that a linear one grows into."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .common import check_outputs, gather, keep, on_terminal, read

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..orbits.family import Family


def orbit(arguments: argparse.Namespace) -> int:
    """Follow a mode of the chain of a scene from its linear limit up to an energy."""
    scene, picture, numbers = gather(
        lambda: read(arguments.scene),
        *check_outputs(arguments, arguments.scene),
    )
    from ..orbits.modes import mode_family

    family = mode_family(scene.chain, arguments.mode, arguments.energy, progress=on_terminal())
    print("\n".join(_describe(family)))
    keep(family, numbers, None)
    # both the family and its last orbit, where other commands draw one result
    if picture:
        from ..util.plotting import save

        save(_picture(family), picture)
        print(f"picture: {picture}")
    return 0 if family.reached else 1


def _describe(family: Family) -> list[str]:
    """Return lines about the last orbit and the events on the way to it."""
    last = family[-1]
    state = "stable" if last.stable else f"unstable, largest multiplier {abs(last.unstable[0]):.6g}"
    frequencies = f"{1 / last.period:.6g} Hz; linear: {1 / family[0].period:.6g} Hz"
    lines = [
        f"period: {last.period:.12g} s ({frequencies})",
        f"energy: {last.energy:.6g} J",
        f"largest displacement: {last.amplitude:.6g} m",
        f"residual after a period: {last.residual:.1e}; error of the steps: {last.error:.1e}",
        f"Floquet multipliers: {state}",
    ]
    lines += [
        f"{event.kind}: at {event.value:.6g} J, {1 / event.orbit.period:.6g} Hz"
        for event in family.events
    ]
    if not family.reached:
        lines.append(f"the family does not come to the energy asked for: {family.ended}")
    return lines


def _picture(family: Family) -> Figure:
    from ..util.plotting import COLOURS, figure

    picture = figure(11.0, 4.2)
    first, right = picture.subplots(1, 2)
    for ax in (first, right):
        ax.set_prop_cycle(color=list(COLOURS.values()))
    family.plot(first)
    family[-1].plot(right)
    return picture
