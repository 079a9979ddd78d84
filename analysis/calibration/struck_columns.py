"""Measure which steps and companions columns need that are struck on their top: GENTLE to GENTLE_ERROR, FAR_IN_COLUMNS.

Columns of 20 to 200 grains under weak and strong gravity are struck gently or hard, and asked for at tolerances of 1e-2
to 1e-9. GENTLE and LESS_GENTLE, bounds on the strain up to which steps of one length come first, and the factor on
their error are supported where all attempts together take within 10 % of the least time. FAR_IN_COLUMNS, the step of
the first companion over that of the answer, is supported as far as 99 estimates in 100 are at least half of the error
in columns. LEAST_PART is what the error is at least of what one more companion differs by in scenes in which waves come
back: supported as far as that holds for these.

    python analysis/calibration/struck_columns.py           # four minutes
    python analysis/calibration/struck_columns.py --quick   # seconds
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count as forever
from unittest import mock

import numpy as np
from common import ALL_BUT_ONE, Case, Row, answer, best, command, near_best, quantile
from scenes import drawn

from lmpchain import Chain, Impulse, Scene, ToleranceNotMet, simulate
from lmpchain.engines import companions, time_stepping
from lmpchain.engines.native import Native

STRAINS, FACTORS = (0.3, 2.0, 4.5, 7.5, 10.0, 30.0), (2.5, 5.0, 10.0, 20.0, 40.0)
RATIOS, PARTS = (2, 3, 4), (0.3, 0.5, 0.7, 1.0)
CLEAR = 30.0  # times round-off and the doubt about the truth, above which an error counts
HALF = 0.5  # of an error, that estimates are to be at least


def columns(count: int, strongest: float) -> list[tuple[Scene, float]]:
    """Return columns in which contacts may open, and tolerances."""
    found: list[tuple[Scene, float]] = []
    seeds = forever()
    while len(found) < count:
        rng = np.random.default_rng([41, next(seeds)])
        chain = Chain(
            grains=int(rng.integers(20, 200)), diameter=1e-3, gravity=10 ** rng.uniform(-1, 2)
        )
        strike, tolerance = Impulse(velocity=10 ** rng.uniform(-4.5, -1)), 10 ** rng.uniform(-9, -2)
        samples = int(rng.choice((2, 11, 101)))
        scene = Scene(
            chain=chain, excitation=strike, duration=10 ** rng.uniform(-4.5, -3.5), samples=samples
        )
        if companions.SAFE_STRAIN < scene.reached.largest_strain < strongest:
            found.append((scene, tolerance))
    return found


def taken(scene: Scene, tolerance: float) -> float:
    """Return how long an answer takes, with its estimate and all attempts, s."""
    times = []
    for _ in range(3):
        cost = simulate(scene, "native", tolerance, on_miss="warn").cost
        times.append(cost.integration_s + cost.estimate_s)
    return min(times)


def cheapest(
    every: list[tuple[Scene, float]], name: str, values: tuple[float, ...], shipped: float
) -> Row:
    """Return the row of a constant of `time_stepping` that is to cost least."""
    costs: dict[float, list[float]] = {value: [] for value in values}
    for scene, tolerance in every:
        for value in values:
            made = (value, *time_stepping.GENTLE_ERROR[1:]) if name == "GENTLE_ERROR" else value
            with mock.patch.object(time_stepping, name, made):
                costs[value].append(math.log(taken(scene, tolerance)))
    mean = {
        value: math.exp(np.mean(each) - np.mean(costs[values[0]])) for value, each in costs.items()
    }
    least, low, high = near_best(mean)
    listed = ", ".join(f"{value:g}: {cost:.2f}" for value, cost in mean.items())
    return Row(
        name, shipped, least, low, high, f"time over the first, {len(every)} columns: {listed}"
    )


def trusted(cases: list[tuple[Case, float]]) -> Iterator[Row]:
    """Yield the rows of what estimates trust where contacts open."""
    kinds: list[tuple[str, float, tuple[float, ...], bool]] = [
        ("FAR_IN_COLUMNS", companions.FAR_IN_COLUMNS[0], RATIOS, True),
        ("LEAST_PART", companions.LEAST_PART, PARTS, False),
    ]
    for name, shipped, values, far in kinds:
        found: dict[float, list[float]] = {value: [] for value in values}
        for case, tolerance in cases:
            try:
                candidate = Native("rkn6").candidate(case.scene, tolerance)
            except ToleranceNotMet:
                continue
            run = companions.Companions(Native("rkn6").methods[0], [case.scene], candidate)
            if not candidate.adaptive or (
                run.schedules[0].ratio != 3 if far else not run.scatters[0]
            ):
                continue
            for value in values:
                with mock.patch.object(companions, name, (value,) if far else value):
                    made = answer(Native("rkn6"), case.scene, candidate)
                if made is None:
                    continue
                error, unclear = (
                    case.error(made.motion),
                    CLEAR * made.error.roundoff + 10 * case.reference.error,
                )
                if error > unclear:
                    found[value].append(made.error.total / error)
        low = {value: quantile(said, 1 - ALL_BUT_ONE) for value, said in found.items()}
        good = [value for value in values if low[value] >= HALF]
        bounds = (
            (values[0], max(good, default=math.nan))
            if far
            else (min(good, default=math.nan), math.inf)
        )
        listed = "; ".join(
            f"{v:g}: 1 % below {low[v]:.2f}, half below {quantile(found[v], 0.5):.1f}"
            for v in values
        )
        says = f"estimate over truth of {len(found[values[0]])} runs: {listed}"
        yield Row(name, shipped, bounds[1] if far else bounds[0], *bounds, says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 6 if quick else 120
    gentle, loose = columns(count, 30.0), time_stepping.LOOSE
    strict = [(scene, loose * tolerance**0.6) for scene, tolerance in gentle]  # down to 4e-12
    lax = [(scene, max(tolerance, loose)) for scene, tolerance in gentle]
    strong = [(Case(scene), tolerance) for scene, tolerance in columns(count, math.inf)]
    tolerances = 10 ** np.random.default_rng(42).uniform(-9, -2, count)
    random = drawn(count, 43, lambda s: s.largest_strain > companions.SAFE_STRAIN)
    cases = [*strong, *zip(map(Case, random), tolerances, strict=True)]
    weak = [(s, t) for s, t in gentle if s.reached.largest_strain <= time_stepping.GENTLE]
    best(lambda: taken(*gentle[0]), 1)  # compiles
    return [
        cheapest(strict, "GENTLE", STRAINS, time_stepping.GENTLE),
        cheapest(lax, "LESS_GENTLE", STRAINS, time_stepping.LESS_GENTLE),
        cheapest(weak, "GENTLE_ERROR", FACTORS, time_stepping.GENTLE_ERROR[0]),
        *trusted([(case, tolerance) for case, tolerance in cases if case.known]),
    ]


if __name__ == "__main__":
    command(main, __doc__)
