"""Measure COMES_BACK and NEARBY: when waves come back to contacts that opened, and the run that shows it.

Runs at h, 2h and 4h may agree by chance where contacts open again and again. Random chains of few grains, most of which
rattle for a long time, are run with adaptive steps, without and with one more companion, and the estimates are held
against the true error. COMES_BACK is supported up to the least number of radians a grain at which an estimate without
that companion is below the truth. NEARBY is supported where as many estimates are bounds as with the best ratio, to one
in 50. Springs, whose force has a kink at an opening, are run for a shorter time than COMES_BACK: NEARBY_AT_KINKS is
supported where as many estimates are bounds as with the best ratio, to one in 1000.

    python analysis/calibration/returning_waves.py           # twenty minutes
    python analysis/calibration/returning_waves.py --quick   # seconds
"""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
from common import Case, Row, answer, command, proposal, with_reach
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines import companions
from lmpchain.engines.companions import COMES_BACK, KINKED_BELOW, NEARBY, NEARBY_AT_KINKS
from lmpchain.engines.native import Native

RATIOS = (1.25, 1.5, 1.75, 3.0)
REACHES = (0.8, 0.4, 0.2)  # omega h
KNOWN = 0.1  # errors above it obey no order
MISSED, MISSED_AT_KINKS = 1 / 50, 1 / 1000  # of the estimates, by which two ratios may differ
Found = list[
    tuple[float, float, dict[float, float]]
]  # radians a grain, true errors, estimates by ratio


def crossings(scene: Scene) -> float:
    """Return the radians a grain, of a chain that something acts on all the time altogether."""
    radians = scene.highest_frequency * scene.duration
    return radians if scene.excitation.does_work else radians / scene.chain.grains


def estimates(case: Case, name: str, reach: float) -> tuple[float, dict[float, float]] | None:
    """Return the true error of a run and its estimates, by the ratio of one more companion; infinite for none."""
    engine = Native(name, adaptive=True)
    proposed = proposal(engine, case.scene, 1e-3)
    if proposed is None or not proposed.adaptive:
        return None
    candidate, found, error = with_reach(case.scene, proposed, reach), {}, 0.0
    for ratio in (math.inf, *RATIOS):
        one_more = mock.Mock(return_value=math.isfinite(ratio))
        bare = {"NEARBY": ratio, "NEARBY_AT_KINKS": ratio}
        with mock.patch.multiple(companions, _scatters=one_more, **bare):
            run = answer(engine, case.scene, candidate)
        if run is None or run.lowest > companions.CLOSE_TO_OPENING:
            return None
        found[ratio], error = run.error.total, case.error(run.motion)
    return (error, found) if 10 * case.reference.error < error < KNOWN else None


def compared(scenes: list[Scene], names: tuple[str, ...]) -> Found:
    """Return what came of every scene by each of these integrators and all reaches."""
    return [
        (crossings(case.scene), *each)
        for case in map(Case, scenes)
        if case.known
        for name in names
        for reach in REACHES
        if (each := estimates(case, name, reach)) is not None
    ]


def nearby(name: str, shipped: float, found: Found, apart: float) -> Row:
    """Return the row of a ratio."""
    missed = {
        ratio: np.mean([said[ratio] < error for _, error, said in found])
        for ratio in (math.inf, *RATIOS)
    }
    low = {
        ratio: np.mean([said[ratio] < error / 3 for _, error, said in found])
        for ratio in (math.inf, *RATIOS)
    }
    good = [ratio for ratio in RATIOS if missed[ratio] <= min(missed.values()) + apart]
    with_it = "; ".join(
        f"{100 * missed[ratio]:.2f} and {100 * low[ratio]:.2f} % {'without' if math.isinf(ratio) else ratio}"
        for ratio in missed
    )
    says = f"of {len(found)} estimates are below the truth and below a third of it: {with_it}"
    return Row(
        name, shipped, min(RATIOS, key=lambda ratio: missed[ratio]), min(good), max(good), says
    )


def springs(quick: bool = False) -> list[Row]:
    """Return the rows of springs that open, before waves come back."""
    scenes = drawn(
        6 if quick else 300,
        12,
        lambda scene: (
            min(scene.largest_strain, scene.linear_strain) > 0.5 and crossings(scene) < COMES_BACK
        ),
        exponents=(1.0, 1.0, 1.1),
        strength=(-0.5, 3.0),
        grains=(2, 3, 4, 6, 10, 20),
        spans=(2.0, 80.0),
    )
    found = compared(scenes, ("rkn4", "rkn6", "kahan-li6", "kahan-li8"))
    return [nearby("NEARBY_AT_KINKS", NEARBY_AT_KINKS, found, MISSED_AT_KINKS)]


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    scenes = drawn(
        6 if quick else 150,
        11,
        lambda scene: scene.largest_strain > 0.5,
        strength=(-0.5, 2.0),
        grains=(2, 3, 4, 6),
        spans=(5.0, 40.0) if quick else (5.0, 400.0),
    )
    hertz = [scene for scene in scenes if scene.chain.exponent >= KINKED_BELOW]
    found = compared(hertz, ("rkn4", "rkn6", "kahan-li8"))
    first = min(
        (radians for radians, error, said in found if said[math.inf] < error), default=math.inf
    )
    missed = np.mean(
        [
            said[NEARBY if radians > COMES_BACK else math.inf] < error
            for radians, error, said in found
        ]
    )
    return [
        Row(
            "COMES_BACK",
            COMES_BACK,
            first,
            0.0,
            first,
            f"as shipped {100 * missed:.1f} % of estimates are too low",
        ),
        nearby("NEARBY", NEARBY, found, MISSED),
        *springs(quick),
    ]


if __name__ == "__main__":
    command(main, __doc__)
