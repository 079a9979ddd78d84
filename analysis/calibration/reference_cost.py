"""Measure the cost of the independent reference: the constants of `expected_seconds`.

Steps of the Taylor series are counted and timed in random scenes with and without openings. The
first two are times between steps in units of the fastest contact; the others are the time of a step
and of a grain in it, on the machine at hand.

    python analysis/calibration/reference_cost.py           # a minute
    python analysis/calibration/reference_cost.py --quick   # seconds
"""

from __future__ import annotations

import time
from unittest import mock

import numpy as np
from common import Row, command, quantile
from scenes import drawn
from scipy.optimize import nnls

from lmpchain import Scene
from lmpchain.benchmark.reference import ANSWER, COST, _Motion, expected_seconds

FACTOR = 3.0  # Factor within which a time is supported, because machines differ.


def solved(scene: Scene) -> tuple[int, float, float, float]:
    """Return the reference's steps, their mean length, the grains in one, and the time, s."""
    motion = _Motion(scene)
    seen = []
    own = _Motion._step

    def counted(self: _Motion, x: np.ndarray, *others: object) -> object:
        seen.append(x.shape[1])
        return own(self, x, *others)  # type: ignore[arg-type]

    with mock.patch.object(_Motion, "_step", counted):
        began = time.perf_counter()
        motion.solve(ANSWER)
        took = time.perf_counter() - began
    return len(seen), float(motion.instants[-1]) / len(seen), float(np.mean(seen)), took


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 10 if quick else 50
    weak = drawn(
        count,
        95,
        lambda s: s.strike_number < 1,
        strength=(-4.0, 0.0),
        kinds=("gravity", "load"),
        driven=0.0,
    )
    strong = drawn(count, 96, lambda s: s.strike_number >= 1, strength=(0.0, 3.0), driven=0.0)
    rows = []
    features = []
    times = []
    told = []
    for name, shipped, scenes in (
        ("COST.smooth", COST.smooth, weak),
        ("COST.broken", COST.broken, strong),
    ):
        lengths = []
        for scene in scenes:
            steps, length, grains, took = solved(scene)
            lengths.append(length)
            features.append((steps, steps * grains))
            times.append(took)
            told.append(expected_seconds(scene) / 2)
        low, middle, high = (quantile(lengths, part) for part in (0.1, 0.5, 0.9))
        rows.append(
            Row(
                name,
                shipped,
                middle,
                low,
                high,
                f"mean step, in units of the fastest contact, of {len(lengths)} scenes: median, 10 "
                "to 90 %",
            )
        )
    scaled = np.array(features, dtype=float) / np.array(times)[:, None]
    size = scaled.max(0)
    step, grain = nnls(scaled / size, np.ones(len(times)))[0] / size
    ratios = np.array(times) / np.array(told)
    says = (
        f"time over expected: 10 to 90 % {quantile(ratios, 0.1):.2g} "
        f"to {quantile(ratios, 0.9):.2g}, half {quantile(ratios, 0.5):.2g}"
    )
    for name, shipped, value, meaning in (
        ("COST.step_s", COST.step_s, step, f"s a step; {says}"),
        ("COST.grain_s", COST.grain_s, grain, "s a grain and step"),
    ):
        rows.append(Row(name, shipped, value, value / FACTOR, value * FACTOR, meaning))
    return rows


if __name__ == "__main__":
    command(main, __doc__)
