"""The command `orbit`: the nonlinear normal mode that a linear one grows into."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .common import PICTURES, gather, on_terminal, output, read, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..orbits.family import Family


def orbit(arguments: argparse.Namespace) -> int:
    """Follow a mode of the chain of a scene from its linear limit up to an energy."""
    scene, picture, numbers = gather(
        lambda: read(arguments.scene),
        lambda: arguments.output and output(arguments.output, arguments.scene, PICTURES),
        lambda: arguments.json and output(arguments.json, arguments.scene),
    )
    from ..orbits.modes import mode_family

    family = mode_family(scene.chain, arguments.mode, arguments.energy, progress=on_terminal())
    print("\n".join(_told(family)))
    if numbers:
        write_json(family.to_json(), numbers)
        print(f"numbers: {numbers}")
    if picture:
        from ..util.plotting import save

        save(_picture(family), picture)
        print(f"picture: {picture}")
    return 0 if family.reached else 1


def _told(family: Family) -> list[str]:
    """Return what there is to say of the last orbit and of what happened on the way."""
    last = family[-1]
    state = "stable" if last.stable else f"unstable, largest multiplier {abs(last.unstable[0]):.6g}"
    lines = [
        (
            f"period: {last.period:.12g} s ({1 / last.period:.6g} Hz; linear: "
            f"{1 / family[0].period:.6g} Hz)"
        ),
        f"energy: {last.energy:.6g} J",
        f"largest displacement: {last.amplitude:.6g} m",
        f"residual after a period: {last.residual:.1e}; error of the steps: {last.error:.1e}",
        f"Floquet multipliers: {state}",
    ]
    lines += [
        f"{event.kind}: at {event.value:.6g} J, {1 / event.orbit.period:.6g} Hz"
        for event in family.events
    ]
    return (
        lines
        if family.reached
        else [*lines, f"the family does not come to the energy asked for: {family.ended}"]
    )


def _picture(family: Family) -> Figure:
    from ..util.plotting import COLOURS, figure

    picture = figure(11.0, 4.2)
    left, right = picture.subplots(1, 2)
    for ax in (left, right):
        ax.set_prop_cycle(color=list(COLOURS.values()))
    family.plot(left)
    family[-1].plot(right)
    return picture
