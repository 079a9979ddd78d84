"""Measure when a cut at the light cone is worthwhile: CUT.share, and WINDOW_MIN.

CUT.share: the time to answer a scene with the grains that the wave reaches over that with all of
them, for cuts that leave more and more; the largest part that saves anything is measured.
WINDOW_MIN: chains up to which computing all grains is no slower than following the wave.

    python analysis/calibration/light_cone.py           # a minute
    python analysis/calibration/light_cone.py --quick   # seconds
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from unittest import mock

from common import Row, best, command

from lmpchain import Chain, Impulse, Scene
from lmpchain.engines.base import Engine, Proposal
from lmpchain.engines.lammps.engine import Lammps
from lmpchain.engines.linear.engine import Modes
from lmpchain.engines.native import Native
from lmpchain.integrators import batch
from lmpchain.integrators.kernels.splitting import PAD
from lmpchain.scene import facts
from lmpchain.scene.facts import CUT


def struck(grains: int, periods: float, strike_number: float = 0.01, samples: int = 11) -> Scene:
    """Return a column with a strike on top."""
    chain = Chain(grains=grains, diameter=1e-3)
    velocity = strike_number * chain.length_scale / chain.time_scale
    duration = periods * chain.time_scale
    return Scene(
        chain=chain, excitation=Impulse(velocity=velocity), duration=duration, samples=samples
    )


def through(engine: Engine, scene: Scene, candidate: Proposal) -> None:
    """Run a scene without storing it."""
    run = engine.start([scene], candidate)
    for _ in run.blocks():
        pass
    run.close()


def _cut(engine: Engine, quick: bool) -> Row:
    """Return the row of CUT.share of the light cone for one engine."""
    repeats = 3 if quick else 9
    ratios = {}
    periods = 20.0
    needed = struck(3000, periods).reached.chain.grains
    for part in (0.3, 0.7, 0.97) if quick else (0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97):
        scene = struck(math.ceil(needed / part), periods)
        times = []
        for worth in (1.1, 0.0):  # The chain is always cut, then never.
            with mock.patch.object(facts, "CUT", dataclasses.replace(CUT, share=worth)):
                run = partial(fresh, engine, scene)
                times.append(best(run, repeats))
        ratios[part] = times[0] / times[1]
    saving = [part for part, ratio in ratios.items() if ratio < 0.97]
    harmless = [part for part, ratio in ratios.items() if ratio < 1.05]
    listed = ", ".join(f"{part:g}: {ratio:.2f}" for part, ratio in ratios.items())
    says = (
        f"{needed} grains; time with the cut over that without, by the part that is left: {listed}"
    )
    return Row(
        f"CUT.share (light cone, {engine.name})",
        CUT.share,
        max(saving, default=0.0),
        0.0,
        max(harmless, default=0.0),
        says,
    )


def fresh(engine: Engine, scene: Scene) -> None:
    """Solve a scene for which nothing is cached."""
    new = Scene(**scene.given())
    part = engine.part(new)
    through(engine, part, engine.propose(part, 1e-4))


def _short(quick: bool) -> Row:
    """Return the row of WINDOW_MIN.

    Time with the window over that without, by the number of bodies.
    """
    ratios = {}
    repeats = 5 if quick else 25
    for bodies in (4, 8, 11, 14, 20, 30, 60):
        scene = struck(max(2, bodies * PAD - 2 * PAD), 12.0)
        candidate = Native().propose(scene, 1e-6)
        times = []
        for short in (0, 10**6):
            with mock.patch.object(batch, "WINDOW_MIN", short):
                times.append(
                    best(
                        lambda scene=scene, candidate=candidate: through(
                            Native(), scene, candidate
                        ),
                        repeats,
                    )
                )  # type: ignore[misc]
        ratios[bodies * PAD] = times[0] / times[1]
    good = [bodies for bodies, ratio in ratios.items() if ratio > 0.97]
    listed = ", ".join(f"{bodies}: {ratio:.2f}" for bodies, ratio in ratios.items())
    harmless = [bodies for bodies, ratio in ratios.items() if ratio > 1 / 1.1]
    return Row(
        "WINDOW_MIN",
        batch.WINDOW_MIN,
        max(good, default=0),
        4 * PAD,
        max(harmless, default=0),
        f"time with the window over that without, by bodies: {listed}",
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    return [
        *(_cut(engine, quick) for engine in (Native(), Modes(), Lammps())),
        _short(quick),
    ]


if __name__ == "__main__":
    command(main, __doc__)
