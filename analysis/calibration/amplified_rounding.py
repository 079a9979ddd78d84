"""Measure GROWTH, the allowance for amplified rounding errors, and SEED, their initial size.

Random grains between walls, whose contacts open again and again, are run with rkn6 at omega h = 0.3
in double and in extended precision: what these differ by is the rounding of the run with all that
the scene makes of it. A field is supported where the estimate of round-off is at least a third of
that in nine scenes of ten, or in as many as with the best value, to one in 50. GROWTH.rate is
supported from what 99 in 100 scenes stay below to five times that, beyond which runs are made for
nothing. SEED: the change at t = 0 that grows to as much, in the middle nine tenths of scenes.

    python analysis/calibration/amplified_rounding.py           # two minutes
    python analysis/calibration/amplified_rounding.py --quick   # seconds
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from common import ALL_BUT_ONE, NINE_IN_TEN, Row, changed, command, label, quantile
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.stepping.rounding import GROWTH, amplify_rounding, native_floor
from lmpchain.errors import RunFailed
from lmpchain.integrators.methods import RKN6
from lmpchain.stability.predictability import SEED
from lmpchain.stability.roundoff import STEP, measured_floor

ENOUGH = 1 / 3  # Fraction of the true rounding error.
MUCH = 1e-13, 0.01  # True rounding errors that are amplified, but not saturated.
RARE = 1 / 50  # Fraction of the scenes by which two values may differ.
CHANGES = (*GROWTH.changes, -0.5, 2.0, -2.0)


class Look(NamedTuple):
    """A scene, the force evaluations in its run, and the amplification of their rounding errors."""

    scene: Scene
    evaluations: int
    rounding: float

    @property
    def radians(self) -> float:
        """Phase of the fastest motion."""
        return self.scene.highest_frequency * self.scene.duration

    @property
    def ratio(self) -> float:
        """Ratio of estimated and true rounding error, with the current constants."""
        amplified = float(amplify_rounding(self.scene, self.evaluations).max())
        return (amplified + native_floor(self.evaluations, self.radians)) / self.rounding


def look(scene: Scene) -> Look | None:
    """Measure the rounding error of a run; None if it is not amplified, or too much."""
    try:
        rounding = measured_floor(scene, force="exact")
    except RunFailed:
        return None
    intervals = scene.samples - 1
    phase = scene.highest_frequency * scene.duration / intervals
    evaluations = RKN6.evaluations * intervals * math.ceil(phase / STEP)
    return Look(scene, evaluations, rounding) if MUCH[0] < rounding < MUCH[1] else None


def field(name: str, values: tuple, found: list[Look]) -> Row:
    """Return the row of a field: the fraction of scenes with a sufficient estimate."""
    shipped = getattr(GROWTH, name)
    number = len if name == "changes" else float
    parts = {}
    for value in (*values, *[shipped] * (shipped not in values)):
        with changed(GROWTH, **{name: value}):
            ratios = np.array([each.ratio for each in found])
        parts[number(value)] = float(np.mean(ratios >= ENOUGH)), float(np.median(ratios))
    most = max(part for part, _ in parts.values())
    good = [value for value, (part, _) in parts.items() if part >= min(NINE_IN_TEN, most - RARE)]
    listed = ", ".join(
        f"{value:g}: {100 * part:.0f} ({middle:.2g})"
        for value, (part, middle) in sorted(parts.items())
    )
    says = f"% of {len(found)} estimates above a third of the truth (median over it): {listed}"
    best = max(good, key=lambda value: parts[value][0])
    return Row(label(GROWTH, name), number(shipped), best, min(good), max(good), says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 40 if quick else 300
    few = {"grains": (2, 3, 5, 8), "spans": (10.0, 60.0 if quick else 150.0), "driven": 0.0}
    scenes = drawn(count, 111, lambda s: s.largest_strain > 1, strength=(0.0, 3.0), **few)
    found = [each for scene in scenes if (each := look(scene))]
    digits = [float(amplify_rounding(each.scene, 1.0).max()) for each in found]
    rates = [
        math.log(digit / GROWTH.digit) / each.radians
        for digit, each in zip(digits, found, strict=True)
        if digit > 0
    ]
    seeds = [
        GROWTH.digit * each.rounding / digit
        for digit, each in zip(digits, found, strict=True)
        if digit > 0
    ]
    rate = quantile(rates, ALL_BUT_ONE)
    low, middle, high = (quantile(seeds, part) for part in (0.05, 0.5, 0.95))
    says = (
        f"exponent a radian: half {quantile(rates, 0.5):.2g}, 99 % {rate:.2g}, all {max(rates):.2g}"
    )
    return [
        field("digit", (1e-17, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12), found),
        field("changes", tuple(CHANGES[:many] for many in range(1, 1 + len(CHANGES))), found),
        field("reach", (0.05, 0.1, 0.2, 0.4, 0.8, 1.6), found),
        Row(label(GROWTH, "rate"), GROWTH.rate, rate, rate, 5 * rate, says),
        Row("SEED", SEED, middle, low, high, f"of {len(seeds)} scenes: median, 5 to 95 %"),
    ]


if __name__ == "__main__":
    command(main, __doc__)
