"""Measure the step lengths near openings: OPENING_STEPS.

Random scenes whose contacts open are run at some longest steps with other values of each field.
What counts is the work for a given true error (by the Taylor series in extended precision): steps
times error^(1 / order), in the geometric mean over scenes and steps. OPENING_STEPS.shortened and
OPENING_STEPS.crossing are supported where the estimate, which trusts the order of the method only
if these steps leave little, is at least half of the true error in all but one of 400 runs, and the
work is at most a quarter more than the least of such values. OPENING_STEPS.least_crossing ends what
is only round-off: supported where the error left is within twice the least and steps are at most
half again as many.

    python analysis/calibration/adaptive_steps.py           # a minute
    python analysis/calibration/adaptive_steps.py --quick   # seconds
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from common import Case, Row, answer, changed, command, label, proposal, with_reach
from scenes import drawn

from lmpchain.engines.native import Native
from lmpchain.integrators.methods import METHODS
from lmpchain.integrators.steps import OPENING_STEPS

REACHES = {
    "rkn4": (0.8, 0.4, 0.2),
    "rkn6": (1.6, 0.8, 0.4),
    "kahan-li8": (0.8, 0.4),
    "dop853": (1.6, 0.8),
}
RARELY = 1 / 400  # Fraction of runs whose estimate may be below half of the error.
MORE = 1.25  # Factor on the least work.
# Multiple of the rounding error, and largest error, between which errors count.
CLEAR, KNOWN = 30.0, 1e-2


class Look(NamedTuple):
    """One run: its steps times error^(1 / order), and the ratio of estimate and true error."""

    work: float
    ratio: float


def looks(cases: list[Case], name: str) -> dict[tuple[int, float], Look]:
    """Return the runs of a method with known errors, by scene and step."""
    engine = Native(name)
    order = METHODS[name].order
    found = {}
    for number, case in enumerate(cases):
        proposed = proposal(engine, case.scene, 1e-6)
        for reach in REACHES[name] if proposed and proposed.steps.adaptive else ():
            run = answer(engine, case.scene, with_reach(case.scene, proposed, reach))
            error = case.error(run.motion) if run else math.inf
            if run and CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN:
                found[number, reach] = Look(
                    run.steps * error ** (1 / order), run.error.total / error
                )
    return found


def length(
    field: str, values: tuple[float, ...], cases: list[Case], methods: tuple[str, ...]
) -> Row:
    """Return the row of the table for a field that limits the length of steps.

    The row has the work with other values of the field, relative to the work with its own value.
    """
    shipped = getattr(OPENING_STEPS, field)
    usual = {name: looks(cases, name) for name in methods}
    costs = {}
    low = {}
    for value in sorted({*values, shipped}):
        works = []
        ratios = []
        with changed(OPENING_STEPS, **{field: value}):
            for name in methods:
                found = looks(cases, name)
                both = found.keys() & usual[name].keys()
                works += [math.log(found[key].work / usual[name][key].work) for key in both]
                ratios += [each.ratio for each in found.values()]
        costs[value] = math.exp(np.mean(works))
        low[value] = float(np.mean(np.array(ratios) < 0.5))
    sure = [value for value in costs if low[value] <= max(RARELY, min(low.values()))]
    best = min(sure, key=lambda value: costs[value])
    good = [value for value in sure if costs[value] <= MORE * costs[best]]
    listed = ", ".join(
        f"{value:g}: {cost:.2f} ({100 * low[value]:.1f})" for value, cost in costs.items()
    )
    runs = sum(map(len, usual.values()))
    says = f"work of {runs} runs for an error (% of estimates below half of it): {listed}"
    return Row(label(OPENING_STEPS, field), shipped, best, min(good), max(good), says)


def least(cases: list[Case], factors: tuple[float, ...]) -> Row:
    """Return the row of the shortest step that crosses an opening.

    Steps near round-off, and the error left.
    """
    engine = Native("kahan-li8")
    shipped = OPENING_STEPS.least_crossing
    steps = {}
    errors = {}
    for value in (shipped * factor for factor in factors):
        runs = []
        with changed(OPENING_STEPS, least_crossing=value):
            for case in cases:
                proposed = proposal(engine, case.scene, 1e-11)
                if proposed and proposed.steps.adaptive:
                    run = answer(engine, case.scene, with_reach(case.scene, proposed, 0.02))
                    runs += [(run.steps, max(case.error(run.motion), 1e-16))] if run else []
        steps[value], errors[value] = np.exp(np.log(runs).mean(0)).tolist()
    good = [
        value
        for value in steps
        if errors[value] < 2 * min(errors.values()) and steps[value] < 1.5 * steps[shipped]
    ]
    listed = ", ".join(f"{value:g}: {steps[value]:.0f}, {errors[value]:.1e}" for value in steps)
    says = f"omega h = 0.02; steps and error left: {listed}"
    name = label(OPENING_STEPS, "least_crossing")
    return Row(name, shipped, max(good), min(good), max(good), says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each field."""
    few = {"exponents": (1.25, 1.5, 1.5, 2.0, 3.0), "grains": (2, 3, 5, 12, 30), "driven": 0.0}
    count = 8 if quick else 60
    scenes = drawn(count, 61, lambda s: s.largest_strain > 3, strength=(0.0, 3.0), **few)
    cases = [case for case in map(Case, scenes) if case.known]
    methods = ("rkn6", "dop853") if quick else tuple(REACHES)
    return [
        length("shortened", (0.1, 0.3, 0.4, 0.6, 0.8), cases, methods),
        length("crossing", (0.003, 0.01, 0.1, 0.3), cases, methods),
        least(cases[: 4 if quick else 20], (0.01, 0.1, 1.0, 10.0, 100.0)),
    ]


if __name__ == "__main__":
    command(main, __doc__)
