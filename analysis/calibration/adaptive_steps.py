"""Measure the constants of adaptive steps: ADAPTIVE_STEP, CROSSING_STEP, LEAST_CROSSING, and those of DOP853.

Random scenes whose contacts open are run at some longest steps with each constant changed, and the other as it is.
What counts is the work for a given true error (by the Taylor series in extended precision): steps times error^(1 /
order), in the geometric mean over scenes and steps. A value is supported where that is within 10 % of the best, one of
ADAPTIVE_STEP and CROSSING_STEP where the estimate, which trusts the order of the method only if these steps leave
little, is at least half of the true error in all but one of 400 runs.
STEP_ERROR_MIN and LEAST_CROSSING end what is only round-off: supported where the error left is within twice the least
and steps are at most half again as many.

    python analysis/calibration/adaptive_steps.py           # two minutes
    python analysis/calibration/adaptive_steps.py --quick   # seconds
"""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
from common import Case, Row, answer, command, near_best, proposal, with_reach
from scenes import drawn

from lmpchain.engines.native import Native
from lmpchain.integrators import dop853, splittings
from lmpchain.integrators.methods import METHODS

REACHES = {
    "rkn4": (0.8, 0.4, 0.2),
    "rkn6": (1.6, 0.8, 0.4),
    "kahan-li8": (0.8, 0.4),
    "dop853": (1.0, 0.5),
}
RARELY = 1 / 400  # runs whose estimate may be below half of the error
CLEAR, KNOWN = 30.0, 1e-2  # times round-off, and largest error, between which errors count


def work(cases: list[Case], name: str) -> dict[tuple[int, float], tuple[float, float]]:
    """Return steps error^(1 / order), and the estimate over the error, by scene and step."""
    engine, order, found = Native(name), METHODS[name].order, {}
    for number, case in enumerate(cases):
        if (proposed := proposal(engine, case.scene, 1e-6)) is None or not proposed.adaptive:
            continue
        for reach in REACHES[name]:
            run = answer(engine, case.scene, with_reach(case.scene, proposed, reach))
            if run is None:
                continue
            error = case.error(run.motion)
            if CLEAR * run.error.roundoff + 10 * case.reference.error < error < KNOWN:
                found[number, reach] = run.steps * error ** (1 / order), run.error.total / error
    return found


def row(
    name: str, values: tuple[float, ...], cases: list[Case], methods: tuple[str, ...], what: str
) -> Row:
    """Return the row of a constant: work with other values of it, over that with its own."""
    module = dop853 if methods == ("dop853",) else splittings
    shipped = getattr(module, name)
    costs, low = {}, {}
    own = {method: work(cases, method) for method in methods}
    for value in sorted({*values, shipped}):
        ratios, estimates = [], []
        with mock.patch.object(module, name, value):
            for method in methods:
                now = work(cases, method)
                ratios += [
                    math.log(now[key][0] / cost)
                    for key, (cost, _) in own[method].items()
                    if key in now
                ]
                estimates += [estimate for _, estimate in now.values()]
        costs[value] = float(np.exp(np.mean(ratios))) if ratios else math.inf
        low[value] = float(np.mean(np.array(estimates) < 0.5)) if estimates else math.inf
    best, least, most = near_best(costs)
    listed = ", ".join(f"{value:g}: {cost:.2f}" for value, cost in costs.items())
    if module is splittings:
        good = [value for value in costs if low[value] <= RARELY]
        best, least, most = min(good, key=lambda value: costs[value]), min(good), max(good)
        listed += "; % of estimates below half: " + ", ".join(
            f"{value:g}: {100 * low[value]:.1f}" for value in costs
        )
    return Row(
        name, shipped, best, least, most, f"{what}: {listed}; {sum(map(len, own.values()))} runs"
    )


def floor(
    cases: list[Case], name: str, method: str, reach: float, factors: tuple[float, ...]
) -> Row:
    """Return the row of a least step or step error: the work near round-off, and what error is left."""
    module = dop853 if method == "dop853" else splittings
    engine, costs, errors, own = Native(method), {}, {}, getattr(module, name)
    for value in (own * factor for factor in factors):
        steps, left = [], []
        with mock.patch.object(module, name, value):
            for case in cases:
                if (
                    proposed := proposal(engine, case.scene, 1e-11)
                ) is not None and proposed.adaptive:
                    run = answer(engine, case.scene, with_reach(case.scene, proposed, reach))
                    if run is not None:
                        steps.append(run.steps)
                        left.append(max(case.error(run.motion), 1e-16))
        costs[value] = float(np.exp(np.mean(np.log(steps))))
        errors[value] = float(np.exp(np.mean(np.log(left))))
    good = [
        value
        for value in costs
        if errors[value] < 2 * min(errors.values()) and costs[value] < 1.5 * costs[own]
    ]
    listed = ", ".join(
        f"{value:.0e}: {costs[value]:.0f} steps, {errors[value]:.1e}" for value in costs
    )
    return Row(
        name,
        own,
        max(good),
        min(good),
        max(good),
        f"omega h = {reach:g}; steps and error left: {listed}",
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 5 if quick else 60
    hard = drawn(
        count,
        61,
        lambda s: s.largest_strain > 3,
        strength=(0.0, 3.0),
        exponents=(1.25, 1.5, 1.5, 2.0, 3.0),
        grains=(2, 3, 5, 12, 30),
        driven=0.0,
    )
    calm = drawn(
        count // 2,
        62,
        lambda s: s.largest_strain < 0.3,
        strength=(-3.0, -0.5),
        grains=(2, 3, 5, 12, 30),
        driven=0.0,
    )
    cases, smooth = ([case for case in map(Case, scenes) if case.known] for scenes in (hard, calm))
    splittings = ("rkn6",) if quick else ("rkn4", "rkn6", "kahan-li8")
    return [
        row(
            "ADAPTIVE_STEP",
            (0.1, 0.2, 0.3, 0.4, 0.6, 0.8),
            cases,
            splittings,
            "work for a given error over that with 0.2",
        ),
        row(
            "CROSSING_STEP",
            (0.003, 0.01, 0.03, 0.1, 0.3),
            cases,
            splittings,
            "work for a given error over that with 0.03",
        ),
        row(
            "STEP_ERROR",
            (1e-11, 1e-10, 1e-9, 1e-8, 1e-7),
            [*cases, *smooth],
            ("dop853",),
            "work for a given error over that with 1e-9",
        ),
        floor(
            cases[: 4 if quick else 20],
            "STEP_ERROR_MIN",
            "dop853",
            0.1,
            (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0),
        ),
        floor(
            cases[: 4 if quick else 20],
            "LEAST_CROSSING",
            "kahan-li8",
            0.02,
            (0.01, 0.1, 1.0, 10.0, 100.0),
        ),
    ]


if __name__ == "__main__":
    command(main, __doc__)
