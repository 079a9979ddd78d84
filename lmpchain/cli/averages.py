"""The command `averages`: time averages of a scene with confidence intervals."""

from __future__ import annotations

import argparse

from .common import check_outputs, collect, keep, on_terminal, read_scene


def averages(arguments: argparse.Namespace) -> int:
    """Average quantities of a scene over time."""
    scene, picture, numbers = collect(
        lambda: read_scene(arguments.scene),
        *check_outputs(arguments, arguments.scene),
    )
    from ..simulation import time_averages

    result = time_averages.averages(
        scene,
        [name.strip() for name in arguments.of.split(",")],
        time=arguments.time,
        tolerance=arguments.energy_tolerance,
        warm_up=arguments.warm_up,
        copies=arguments.copies,
        progress=on_terminal(),
    )
    print(result.table())
    keep(result, numbers, None)
    # Each average has a panel of its own, so `keep` does not apply.
    if picture:
        from ..util.plotting import PRINTED_WIDTH, figure, letter_panels, save

        pages = figure(PRINTED_WIDTH, 3.0 * len(result.mean))
        panels = pages.subplots(len(result.mean), squeeze=False)[:, 0]
        for ax, name in zip(panels, result.mean, strict=True):
            result.plot(ax, of=name)
        letter_panels(list(panels))
        save(pages, picture, overwrite=True)
        print(f"picture: {picture}")
    return 0
