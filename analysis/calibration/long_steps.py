"""Measure how long steps may be that show an error or pass over samples: FAR, SMALL, PILOT, BETWEEN, INTERPOLATED.

In random scenes where no contact comes near to opening, companions run at steps so many times as long: FAR is supported
as far as 99 estimates in 100 are bounds. SMALL, up to which one companion alone is trusted, is supported up to the
smallest difference of which that does not hold. In scenes whose motion nothing bounds, answers are found after a pilot
whose steps are so many times as long: PILOT is supported where all attempts together cost within 10 % of the least, in
evaluations of the force for the answer. BETWEEN and LOST_BETWEEN are held against what samples between steps are
further off than those on which steps end, where the polynomial or rounding makes it: within the middle nine tenths.
INTERPOLATED, a bound on what rounding makes, is supported from where nine in ten runs stay below it to ten times that.

    python analysis/calibration/long_steps.py           # three minutes
    python analysis/calibration/long_steps.py --quick   # seconds
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from unittest import mock

import numpy as np
from common import (
    ALL_BUT_ONE,
    Case,
    Row,
    answer,
    command,
    near_best,
    proposal,
    quantile,
    with_reach,
)
from scenes import drawn

from lmpchain import RunFailed, Scene
from lmpchain.engines import companions, native
from lmpchain.engines.base import Run
from lmpchain.engines.native import Native
from lmpchain.engines.richardson import SMALL
from lmpchain.engines.round_off import INTERPOLATED, between_loss
from lmpchain.engines.step_control import run_to_tolerance
from lmpchain.engines.time_stepping import BETWEEN, LOST_BETWEEN, ORDER_BETWEEN

RATIOS, PILOTS = (2, 3, 4, 6), (1.0, 2.0, 4.0, 6.0, 8.0)
TOLERANCES = 1e-6, 1e-8, 1e-10
CLEAR = 30.0  # times round-off and the doubt about the truth, above which an error counts
STEPS = 8  # from one sample on which one ends to the next


def far(calm: list[Case]) -> Iterator[Row]:
    """Yield the rows of companions where nothing opens."""
    found: dict[int, list[float]] = {ratio: [] for ratio in RATIOS}
    alone = []
    for case in calm:
        for name in ("rkn4", "rkn6"):
            if (proposed := proposal(Native(name), case.scene, 1e-3)) is None:
                continue
            for reach in (0.1, 0.2, 0.35, 0.9, 1.4):
                candidate = with_reach(case.scene, proposed, reach)._replace(solver_error=1.0)
                for ratio in RATIOS if reach < 0.5 else (2,):
                    with mock.patch.object(companions, "FAR", (ratio,)):
                        run = answer(Native(name), case.scene, candidate)
                    if run is None:
                        continue
                    error = case.error(run.motion)
                    if error < CLEAR * run.error.roundoff + 10 * case.reference.error:
                        continue
                    if reach < 0.5:
                        found[ratio].append(run.error.total / error)
                    elif len(run.differences) == 1:
                        alone.append((run.differences[0], run.error.total / error))
    low = {ratio: quantile(said, 1 - ALL_BUT_ONE) for ratio, said in found.items()}
    good = [ratio for ratio in RATIOS if low[ratio] >= 1]
    listed = "; ".join(
        f"{r}: 1 % below {low[r]:.2f}, half below {quantile(found[r], 0.5):.2f}" for r in RATIOS
    )
    yield Row(
        "FAR",
        companions.FAR[0],
        max(good, default=2),
        2,
        max(good, default=2),
        f"estimate over truth: {listed}",
    )
    wrong = min((size for size, part in alone if size <= SMALL and part < 1), default=math.inf)
    least = min((part for size, part in alone if size <= SMALL), default=math.nan)
    says = f"of {len(alone)} differences of one companion; the least estimate up to SMALL is {least:.2f} of the truth"
    yield Row("SMALL", SMALL, wrong, 0.0, wrong, says)


def pilots(unbounded: list[Scene]) -> Row:
    """Return the row of the first run at longer steps."""
    costs: dict[float, list[float]] = {ratio: [] for ratio in PILOTS}
    for scene in unbounded:
        for tolerance in TOLERANCES:
            each = {}
            for ratio in PILOTS:
                spent = 0

                def collect(run: Run) -> None:
                    nonlocal spent
                    for _ in run.blocks():
                        pass
                    spent += run.cost().force_evaluations

                try:
                    with mock.patch.object(native, "PILOT", ratio):
                        if not run_to_tolerance(Native("rkn6"), scene, tolerance, collect).missed:
                            each[ratio] = spent
                except RunFailed:
                    break
            if len(each) == len(PILOTS):
                for ratio in PILOTS:
                    costs[ratio].append(math.log(each[ratio] / each[1.0]))
    mean = {ratio: math.exp(np.mean(each)) if each else math.nan for ratio, each in costs.items()}
    best, low, high = near_best(mean)
    listed = ", ".join(f"{ratio:g}: {cost:.2f}" for ratio, cost in mean.items())
    return Row(
        "PILOT",
        native.PILOT,
        best,
        low,
        high,
        f"cost over that without, {len(costs[1.0])} answers: {listed}",
    )


def between(cases: list[Case]) -> Iterator[Row]:
    """Yield the rows of samples between steps."""
    steep, lost, digits = [], [], []
    for case in cases:
        scene = case.scene
        if (proposed := proposal(Native("rkn6"), scene, 1e-6)) is None:
            continue
        for passed in (3, 8, 25, 75):  # samples a step
            step = passed * scene.time[1]
            reach, stride = step * scene.highest_frequency, STEPS * passed
            if not reach < 1.5:
                continue
            candidate = proposed.sampled._replace(steps_per_landing=STEPS, stride=stride, step=step)
            if (run := answer(Native("rkn6"), scene, candidate)) is None:
                continue
            error = case.error(run.motion)
            landed = np.abs(run.motion - case.motion)[:, ::stride].max((1, 2)) / np.abs(
                case.motion
            ).max((1, 2))
            if error > 3 * landed.max() + 10 * case.reference.error:
                if reach > 0.3:
                    steep.append(error / reach**ORDER_BETWEEN)
                elif reach < 0.03:
                    lost.append(error / candidate.steps(scene.samples))
                    farthest, fastest = np.abs(case.motion).max((1, 2))
                    digits.append(
                        INTERPOLATED
                        * error
                        / between_loss(run.steps, farthest / (fastest * scene.duration))
                    )
    for name, shipped, found, what in (
        ("BETWEEN", BETWEEN, steep, "error at omega h = 1"),
        ("LOST_BETWEEN", LOST_BETWEEN, lost, "error a step"),
    ):
        low, middle, high = (quantile(found, part) for part in (0.05, 0.5, 0.95))
        most = max(high, middle) if name == "BETWEEN" else math.inf  # rounding is to be excluded
        yield Row(
            name,
            shipped,
            middle,
            low,
            most,
            f"{what} of {len(found)} runs: {low:.2g} ... {high:.2g}",
        )
    nine = quantile(digits, 0.9)
    yield Row(
        "INTERPOLATED",
        INTERPOLATED,
        nine,
        nine,
        10 * nine,
        f"last digits of {len(digits)} runs, nine in ten",
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 6 if quick else 60
    calm = drawn(
        count, 31, lambda s: s.largest_strain < 0.3 and s.excitation.smooth, strength=(-4.0, -0.3)
    )
    unbounded = drawn(count, 32, lambda s: s.largest_strain == math.inf, spans=(5.0, 60.0))
    dense = drawn(
        count,
        33,
        lambda s: s.chain.compressed and not s.excitation.does_work,
        strength=(-4.0, 1.0),
        samples=601,
    )
    return [
        *far([case for case in map(Case, calm) if case.known]),
        pilots(unbounded),
        *between([case for case in map(Case, dense) if case.known]),
    ]


if __name__ == "__main__":
    command(main, __doc__)
