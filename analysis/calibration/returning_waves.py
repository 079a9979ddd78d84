"""Measure COMES_BACK and NEARBY: when waves come back to contacts that opened, and the run that shows it.

Runs at h, 2h and 4h may agree by chance where contacts open again and again. Random chains of few grains, most of which
rattle for a long time, are run with adaptive steps, without and with one more companion, and the estimates are held
against the true error. COMES_BACK is supported up to the least number of radians a grain at which an estimate without
that companion is below the truth. NEARBY is supported where as many estimates are bounds as with the best ratio, to one
in 50.

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
from lmpchain.engines import error_estimate
from lmpchain.engines.error_estimate import COMES_BACK, NEARBY
from lmpchain.engines.native import Native

RATIOS = (1.25, 1.5, 1.75, 3.0)
REACHES = (0.8, 0.4, 0.2)  # omega h
KNOWN = 0.1  # errors above it obey no order
MISSED = 1 / 50  # of the estimates, by which two ratios may differ


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
        settings = {"COMES_BACK": math.inf} if math.isinf(ratio) else {"COMES_BACK": 0.0, "NEARBY": ratio}
        with mock.patch.multiple(error_estimate, **settings):
            run = answer(engine, case.scene, candidate)
        if run is None or run.lowest > error_estimate.CLOSE_TO_OPENING:
            return None
        found[ratio], error = run.error.total, case.error(run.motion)
    return (error, found) if 10 * case.reference.error < error < KNOWN else None


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
    found = [
        (crossings(case.scene), *each)
        for case in map(Case, scenes)
        if case.known
        for name in ("rkn4", "rkn6", "kahan-li8")
        for reach in REACHES
        if (each := estimates(case, name, reach)) is not None
    ]
    missed = {ratio: np.mean([said[ratio] < error for _, error, said in found]) for ratio in (math.inf, *RATIOS)}
    low = {ratio: np.mean([said[ratio] < error / 3 for _, error, said in found]) for ratio in (math.inf, *RATIOS)}
    first = min((radians for radians, error, said in found if said[math.inf] < error), default=math.inf)
    good = [ratio for ratio in RATIOS if missed[ratio] <= min(missed.values()) + MISSED]
    best = min(RATIOS, key=lambda ratio: missed[ratio])
    kept = [said[NEARBY if radians > COMES_BACK else math.inf] >= error for radians, error, said in found]
    without = f"without it {100 * missed[math.inf]:.1f} % of {len(found)} estimates are below the truth"
    with_it = "; ".join(f"{100 * missed[ratio]:.1f} and {100 * low[ratio]:.1f} % with {ratio:g}" for ratio in RATIOS)
    return [
        Row("COMES_BACK", COMES_BACK, first, 0.0, first, f"{without}, as shipped {100 * (1 - np.mean(kept)):.1f} %"),
        Row("NEARBY", NEARBY, best, min(good), max(good), f"below the truth and below a third of it: {with_it}"),
    ]


if __name__ == "__main__":
    command(main, __doc__)
