"""Measure the constants of the test for chaos and of the number of attempts.

Short columns, weakly to strongly struck, for up to hundreds of periods, so that some are chaotic: each is tried at
ever shorter steps, without the test. It can be answered if a try meets the tolerance and agrees with another
integrator, kahan-li8, to the tolerance; no integrator shares its steps. Beside it two runs begin a last digit
(LAST_DIGIT) apart. CHAOS_DIVERGENCE must lie between what scenes that can be answered and those that cannot make of
that digit; a first miss beyond CHAOS_MISS tolerances should be rare among the former. ROUNDING_ULPS and SEED: what
all rounding of a run makes of it, against the same steps in extended precision, over what a last digit at t = 0
becomes.

    python analysis/calibration/chaos_test.py           # two minutes
    python analysis/calibration/chaos_test.py --quick   # seconds
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from common import NATIVE, Answer, Row, answer, command, distance, proposal, quantile, with_reach
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.amplification import LAST_DIGIT
from lmpchain.engines.native import Native
from lmpchain.engines.perturbation import divergence
from lmpchain.engines.step_control import (
    ATTEMPTS,
    CHAOS_DIVERGENCE,
    CHAOS_ERROR,
    CHAOS_MISS,
    ERRATIC,
    ROUNDING_ULPS,
    STALLED,
    STALLS,
    WORSE,
)  # fmt: skip
from lmpchain.errors import RunFailed
from lmpchain.stability.predictability import SEED
from lmpchain.stability.roundoff import STEP, measured_floor
from lmpchain.stability.roundoff import floor as predicted_floor

MOST_STEPS = 400_000  # of one run
PATIENT = 16  # tries, more than ATTEMPTS
TOLERANCES = (1e-4, 1e-6, 1e-8)


@dataclass(frozen=True)
class Story:
    """The tries of a scene: their estimated errors over the tolerance and in all, and how a last digit grows."""

    tolerance: float
    errors: tuple[float, ...]
    roundoff: float
    met: bool
    right: bool
    grown: float

    @property
    def first(self) -> float:
        """Error of the first try over the tolerance."""
        return self.errors[0] / self.tolerance


def story(scene: Scene, tolerance: float) -> Story | None:
    """Try a scene until it is answered, or the steps become too many."""
    engine = Native("rkn6")
    candidate, errors, met = proposal(engine, scene, tolerance), [], False
    if candidate is None:
        return None
    first, run = candidate, None
    while candidate and len(errors) < PATIENT and candidate.steps(scene.samples) < MOST_STEPS:
        run = answer(engine, scene, candidate)
        if run is not None:
            errors.append(run.error.truncation)
            met = run.error.total <= tolerance
            if met:
                break
        candidate = engine.refine(candidate, run.error if run else None, tolerance)
    if run is None or (len(errors) < 3 and not met):
        return None
    try:
        grown = float(divergence(scene, first, LAST_DIGIT).max())
    except RunFailed:
        return None
    right = met and _agrees(scene, run, tolerance)
    return Story(tolerance, tuple(errors), run.error.roundoff, met, right, grown)


def _agrees(scene: Scene, run: Answer, tolerance: float) -> bool:
    """Say whether kahan-li8, left to itself, finds the same."""
    other = proposal(Native("kahan-li8"), scene, tolerance)
    if other is None:
        return True
    other = other.sampled
    finer = other.with_steps(max(other.steps_per_landing, run.candidate.sampled.steps_per_landing))
    second = answer(Native("kahan-li8"), scene, finer)
    return second is None or distance(second.motion, run.motion) < 3 * (
        tolerance + second.error.total
    )


def rounding(scene: Scene) -> tuple[float, float] | None:
    """Return what rounding makes of a run, over what a last digit at t = 0 becomes, and over the law of a random walk.

    The run is held against the same steps in extended precision, so that only rounding is left.
    """
    floor, law = measured_floor(scene), predicted_floor(scene)
    candidate = NATIVE.candidate(scene, 0.1).sampled._replace(integrator="rkn6", adaptive=False)
    try:
        grown = float(divergence(scene, with_reach(scene, candidate, STEP), LAST_DIGIT).max())
    except RunFailed:
        return None
    return (floor / grown, floor / law) if max(floor, grown) < 0.1 else None


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    short, long = (4, 28) if quick else (80, 80)
    ranges = {"grains": (3, 5, 8, 12, 20), "strength": (-2.0, 3.0), "samples": 21}
    scenes = drawn(short, 31, spans=(2.0, 60.0), **ranges) + drawn(
        long, 32, spans=(60.0, 400.0), **ranges
    )
    told = [found for k, scene in enumerate(scenes) if (found := story(scene, TOLERANCES[k % 3]))]
    can, cannot = [x for x in told if x.right], [x for x in told if not x.met]
    wrong = len(told) - len(can) - len(cannot)
    suspects = [x for x in can if x.errors[0] > min(CHAOS_MISS * x.tolerance, CHAOS_ERROR)]
    harmless, lost = [x.grown / x.tolerance for x in can], [x.grown / x.tolerance for x in cannot]
    worst, least = max(harmless, default=math.nan), quantile(lost, 0.25)
    accused = sum(x.grown >= CHAOS_DIVERGENCE * x.tolerance for x in suspects)
    rows = [
        Row(
            "CHAOS_DIVERGENCE",
            CHAOS_DIVERGENCE,
            worst,
            quantile(harmless, 0.95),
            max(least, worst),
            (
                f"last digit grown, in tolerances: at most {worst:.2g} (95 "
                f"%: {quantile(harmless, 0.95):.2g}) in {len(can)} scenes "
                "that can be answered, "
                f"a quarter below {least:.2g} in {len(cannot)} that cannot; "
                f"{accused} of {len(suspects)} suspects accused wrongly; {wrong} "
                "met ones differ"
            ),
        ),
        Row(
            "CHAOS_MISS",
            CHAOS_MISS,
            quantile([x.first for x in can], 0.95),
            quantile([x.first for x in can], 0.9),
            quantile([x.first for x in cannot], 0.75),
            (
                f"first error in tolerances: 90 % {quantile([x.first for x in can], 0.9):.2g} "
                "of those that can be answered, "
                f"{quantile([x.first for x in cannot], 0.5):.2g} half of the others"
            ),
        ),
        Row(
            "CHAOS_ERROR",
            CHAOS_ERROR,
            quantile([x.errors[0] for x in cannot], 0.25),
            quantile([x.errors[0] for x in can], 0.75),
            quantile([x.errors[0] for x in cannot], 0.9),
            "first error: three quarters of those that can be answered are below, one in ten of the others above",
        ),
    ]
    stalls = [_longest_stall(x.errors) for x in can]
    some = quantile(stalls, 0.95)
    rows.append(
        Row(
            "STALLS",
            STALLS,
            some,
            some,
            max(some, 3.0),
            f"tries in a row that hardly helped, in scenes that can be answered: 95 %; most {max(stalls):.0f}",
        )
    )
    for name, shipped, turn in (
        ("STALLED", STALLED, _least_helpful),
        ("WORSE", WORSE, _worst_turn),
    ):
        rows.append(
            _falling(name, shipped, [turn(x.errors) for x in can], [turn(x.errors) for x in cannot])
        )
    needed = [len(x.errors) for x in can]
    rows.append(
        Row(
            "ATTEMPTS",
            ATTEMPTS,
            max(needed),
            max(needed),
            PATIENT,
            "most tries that a scene took that could be answered; 99 "
            f"%: {quantile(needed, 0.99):.0f}, half {quantile(needed, 0.5):.0f}",
        )
    )
    few = drawn(
        12 if quick else 80,
        33,
        strength=(-2.0, 3.0),
        grains=(3, 5, 8, 12),
        spans=(10.0, 150.0),
        samples=21,
        driven=0.0,
    )
    made = [found for scene in few if (found := rounding(scene))]
    ratios, walks = [ratio for ratio, _ in made], [walk for _, walk in made]
    low, middle, high = (quantile(ratios, part) for part in (0.5, 0.9, 1.0))
    says = f"half {low:.2g}, 9 in 10 {middle:.2g}, most {high:.2g} of {len(made)} runs"
    rows.append(
        Row(
            "ROUNDING_ULPS",
            ROUNDING_ULPS,
            middle,
            low,
            max(high, middle),
            f"rounding of a run over what {LAST_DIGIT:g} at t = 0 becomes: {says}",
        )
    )
    least, median, most = (LAST_DIGIT * quantile(ratios, part) for part in (0.05, 0.5, 0.95))
    rows.append(
        Row(
            "SEED",
            SEED,
            median,
            least,
            most,
            "change at t = 0 that does as much as rounding: median, 5 to 95 %",
        )
    )
    stuck = [x.errors[-1] / x.roundoff for x in cannot]
    worst, far = quantile(walks, 0.95), quantile(stuck, 0.25)
    says = (
        f"error over expected round-off: 95 % of ordinary runs {worst:.2g}; "
        f"a quarter of those that nothing helps {far:.2g}"
    )
    rows.append(Row("ERRATIC", ERRATIC, math.sqrt(worst * far), worst, far, says))
    return rows


def _least_helpful(errors: tuple[float, ...]) -> float:
    """Return the error over that of the try before, of the STALLS tries in a row that helped least; 0 of fewer."""
    ratios = [after / before for before, after in itertools.pairwise(errors)]
    return max((min(ratios[k : k + STALLS]) for k in range(len(ratios) - STALLS + 1)), default=0.0)


def _worst_turn(errors: tuple[float, ...]) -> float:
    """Return the largest error over that of the try before; 0 of one try."""
    return max((after / before for before, after in itertools.pairwise(errors)), default=0.0)


def _falling(name: str, shipped: float, can: list[float], cannot: list[float]) -> Row:
    """Return the row of a ratio of errors that few scenes exceed that can be answered, and most others do."""
    low, high = quantile(can, 0.95), quantile(cannot, 0.25)
    beyond = sum(x > shipped for x in can)
    says = f"95 % of {len(can)} scenes that can be answered stay below {low:.2g}, {beyond} exceed {shipped:g}; "
    says += f"three quarters of {len(cannot)} others reach {high:.2g}"
    return Row(name, shipped, low, low, max(low, high), says)


def _longest_stall(errors: tuple[float, ...]) -> int:
    longest = here = 0
    for before, after in itertools.pairwise(errors):
        here = here + 1 if after > STALLED * before else 0
        longest = max(longest, here)
    return longest


if __name__ == "__main__":
    command(main, __doc__)
