"""Measure the number of attempts after which shorter steps are abandoned: PATIENCE.

Short columns, weakly to strongly struck, for up to hundreds of periods, so that some make more of a
last digit than any tolerance allows: each is tried at ever shorter steps until round-off is too
much. PATIENCE.attempts is supported from the most that a scene took that could be answered,
PATIENCE.stalls from what 95 in 100 of these took in a row that did not help to two more than any
took, and PATIENCE.stalled from where 95 in 100 of these are not given up to 1, from where on steps
made the error larger.

    python analysis/calibration/chaos_test.py           # a minute
    python analysis/calibration/chaos_test.py --quick   # seconds
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from common import Row, answer, command, label, proposal, quantile
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.native import Native
from lmpchain.engines.step_control import PATIENCE

MOST_STEPS = 200_000  # Largest number of steps of a run.
PATIENT = 20  # Number of attempts, larger than in PATIENCE.
TOLERANCES = (1e-4, 1e-6, 1e-8)


class Story(NamedTuple):
    """The attempts at a scene: their truncation errors, and whether one met the tolerance."""

    truncations: list[float]
    met: bool

    @property
    def ratios(self) -> list[float]:
        """Ratio of each error to the error of the previous attempt."""
        return [after / before for before, after in pairwise(self.truncations)]

    @property
    def turn(self) -> float:
        """The largest PATIENCE.stalled at which these attempts would be stopped."""
        ends = len(self.ratios) - PATIENCE.stalls + 1
        return max((min(self.ratios[k : k + PATIENCE.stalls]) for k in range(ends)), default=0.0)

    @property
    def stall(self) -> int:
        """Longest sequence of attempts that did not reduce the error."""
        longest = length = 0
        for ratio in self.ratios:
            length = length + 1 if ratio > PATIENCE.stalled else 0
            longest = max(longest, length)
        return longest


def story(scene: Scene, tolerance: float) -> Story | None:
    """Try a scene until it is solved, rounding dominates, or there are too many steps."""
    engine = Native("rkn6")
    candidate = proposal(engine, scene, tolerance)
    truncations: list[float] = []
    while candidate and len(truncations) < PATIENT:
        if candidate.steps.total(scene.samples - 1) >= MOST_STEPS:
            break
        run = answer(engine, scene, candidate)
        if run is not None:
            truncations.append(run.error.truncation)
            if run.error.total <= tolerance:
                return Story(truncations, True)
        candidate = engine.refine(candidate, run.error if run else None, tolerance)
    return Story(truncations, False) if len(truncations) > PATIENCE.stalls else None


def main(quick: bool = False) -> list[Row]:
    """Return a row for each field."""
    short, long = (8, 20) if quick else (150, 250)
    ranges = {"grains": (3, 5, 8, 12, 20), "strength": (-2.0, 3.0), "samples": 21}
    scenes = drawn(short, 31, spans=(2.0, 60.0), **ranges)
    scenes += drawn(long, 32, spans=(60.0, 400.0), **ranges)
    stories = [
        found
        for number, scene in enumerate(scenes)
        if (found := story(scene, TOLERANCES[number % 3]))
    ]
    can = [found for found in stories if found.met]
    cannot = [found for found in stories if not found.met]
    needed = [len(found.truncations) for found in can]
    stalls = [found.stall for found in can]
    harmless = quantile([found.turn for found in can], 0.95)
    hopeless = quantile([found.turn for found in cannot], 0.5)
    given_up = sum(found.turn > PATIENCE.stalled for found in can)
    says = f"in {len(can)} scenes that can be answered"
    lost = f"95 % of {len(can)} that can be answered stay below, {given_up} are given up; "
    lost += f"half of {len(cannot)} others come to {hopeless:.2g}"
    attempts = max(needed)
    enough = quantile(stalls, 0.95)
    return [
        Row(label(PATIENCE, "attempts"), PATIENCE.attempts, attempts, attempts, PATIENT, says),
        Row(label(PATIENCE, "stalls"), PATIENCE.stalls, enough, enough, max(stalls) + 2, says),
        Row(label(PATIENCE, "stalled"), PATIENCE.stalled, harmless, harmless, 1.0, lost),
    ]


if __name__ == "__main__":
    command(main, __doc__)
