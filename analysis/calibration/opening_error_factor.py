"""Measure how much larger errors are where contacts may open, by which the first step is chosen.

Random scenes are run at the step that the engine proposes. The error estimate of the run over the one expected
without openings, SAFETY error_constant (omega T / 60) (omega h)^order, is the factor that the scene needed. It scatters
over decades, so that the constants of `opening_error_factor` are chosen by what all attempts at a tolerance cost in the
mean, and supported where that is within 10 % of the best. COARSE_ERROR and COARSE_STEP are chosen in the same way in
scenes with 101 samples, which hold steps short.
OPENING_ERROR is the same factor for steps of one length, enough for nine scenes in ten. LONGEST_STEP, the
longest step over the stability limit: one at 1.5 times the step must be stable and runs must not break. A true
error above the tolerance in a run that says it is met (by the Taylor series in extended precision) is counted too.

    python analysis/calibration/opening_error_factor.py           # two minutes
    python analysis/calibration/opening_error_factor.py --quick   # seconds
"""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import dataclass
from types import ModuleType
from unittest import mock

import numpy as np
from common import (
    NINE_IN_TEN,
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

from lmpchain.engines import time_stepping
from lmpchain.engines.base import Run
from lmpchain.engines.native import Native
from lmpchain.engines.richardson import SAFETY
from lmpchain.engines.step_control import run_to_tolerance
from lmpchain.engines.time_stepping import (
    LONGEST_STEP,
    OPENING_ERROR,
    SAFE_STRAIN,
)
from lmpchain.errors import RunFailed, ToleranceNotMet
from lmpchain.integrators import splittings
from lmpchain.integrators.methods import METHODS

TOLERANCES = (1e-3, 1e-6, 1e-9)
TRIED = {
    "ADAPTIVE_ERROR": (0.5, 2.0, 4.0, 16.0, 32.0, 128.0),
    "LEAST_STRAIN": (0.3, 1.0, 10.0, 30.0),
    "MOST_STRAIN": (10.0, 30.0, 300.0, 1000.0),
    "GROWS": (0.0, 0.25, 0.75, 1.0, 1.5),
}


@dataclass(frozen=True)
class Try:
    """A first try: factor that it needed, and whether it met its tolerance.

    `chosen` says whether the factor chose the step, not the sample interval or the stability limit; `wrong`, whether
    the true error exceeds a tolerance that is said to be met.
    """

    needed: float
    met: bool
    wrong: bool
    chosen: bool


def first_try(engine: Native, case: Case, tolerance: float) -> Try | None:
    """Run the proposal of the engine; None where it has none, the run breaks down, or round-off counts."""
    scene = case.scene
    if (candidate := proposal(engine, scene, tolerance)) is None:
        return None
    method = METHODS[candidate.integrator]
    reach = candidate.step * scene.highest_frequency
    chosen = reach < 0.4 * method.stability_limit and candidate.steps_per_landing > 2
    if (run := answer(engine, scene, candidate)) is None or run.error.roundoff > 0.03 * tolerance:
        return None
    periods = max(1.0, scene.highest_frequency * scene.duration / 60)
    plain = SAFETY * method.error_constant * periods * reach**method.order
    met = run.error.total <= tolerance
    wrong = met and case.error(run.motion) > tolerance
    return Try(run.error.truncation / plain, met, wrong, chosen)


def tries(engine: Native, cases: list[Case]) -> list[Try]:
    """Return the first tries of all scenes at some tolerances."""
    return [
        found for case in cases for tol in TOLERANCES if (found := first_try(engine, case, tol))
    ]


def work(
    cases: list[Case], module: ModuleType, name: str, value: float
) -> dict[tuple[int, float], int]:
    """Return the force evaluations of all attempts, by scene and tolerance, with this value of a constant."""
    found: dict[tuple[int, float], int] = {}
    engine = Native()
    with mock.patch.object(module, name, value):
        for (number, case), tolerance in itertools.product(enumerate(cases), TOLERANCES):
            made: list[int] = []

            def collect(run: Run, made: list[int] = made) -> None:
                for _ in run.blocks():
                    pass
                made.append(run.cost().force_evaluations)

            with suppress(ToleranceNotMet, RunFailed):
                if not run_to_tolerance(engine, case.scene, tolerance, collect).missed:
                    found[number, tolerance] = sum(made)
    return found


def row(name: str, shipped: float, values: list[float], says: str) -> Row:
    """Return the row of a factor that nine in ten, and not more than 99 in 100, scenes should need at most."""
    middle, low, high = (quantile(values, part) for part in (0.5, NINE_IN_TEN, 0.99))
    enough = np.mean(np.array(values) <= shipped)
    return Row(
        name,
        shipped,
        low,
        low,
        high,
        f"{says}: half need {middle:.2g}, {100 * enough:.0f} % of {len(values)} enough",
    )


def _interval(part: float, count: int) -> tuple[float, float]:
    """Return the interval of a part of so many draws, two standard deviations wide on either side."""
    wide = 2 * math.sqrt(max(part * (1 - part), 1 / max(count, 1)) / max(count, 1))
    return part - wide, part + wide


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    count = 5 if quick else 70
    strong = [c for c in map(Case, drawn(count, 11, lambda s: s.largest_strain > 0.3)) if c.known]
    gentle = [
        c
        for c in map(
            Case, drawn(count // 2, 12, lambda s: s.largest_strain <= 0.3, strength=(-4, -0.3))
        )
        if c.known
    ]
    engine = Native()
    every = tries(engine, strong)
    dense = list(map(Case, drawn(count, 14, lambda s: s.largest_strain > 0.3, samples=101)))
    rows = [
        *(
            _first(strong, time_stepping, name, values[:: 3 if quick else 1])
            for name, values in TRIED.items()
        ),
        _first(
            dense,
            time_stepping,
            "COARSE_ERROR",
            (4.0, 256.0) if quick else (1.0, 4.0, 64.0, 256.0, 1024.0, 1e9),
        ),
        _first(
            dense, splittings, "COARSE_STEP", (0.3, 0.6) if quick else (0.2, 0.3, 0.5, 0.6, 0.8)
        ),
    ]
    part, wrong = float(np.mean([x.met for x in every])), sum(x.wrong for x in every)
    rows.append(
        Row(
            "part met at first try",
            0.73,
            part,
            *_interval(part, len(every)),
            f"of {len(every)} tries with openings; {wrong} met ones are truly above their tolerance",
        )
    )
    calm = tries(engine, gentle)
    part = float(np.mean([x.met for x in calm])) if calm else math.nan
    need = [x.needed for x in calm if x.chosen]
    listed = ", ".join(f"{quantile(need, p):.2g}" for p in (0.1, 0.5, 0.9))
    rows.append(
        Row(
            "part met, gentle",
            NINE_IN_TEN,
            part,
            *_interval(part, len(calm)),
            f"of {len(calm)} gentle tries; their factors (10, 50, 90 %) are {listed}: error_constants.py",
        )
    )
    for name in ("verlet", "rkn4"):
        steady = tries(Native(name, adaptive=False), strong)
        rows.append(
            row(
                f"OPENING_ERROR ({name})",
                OPENING_ERROR,
                [x.needed for x in steady if x.chosen],
                f"{name} with steps of one length",
            )
        )
    rows += [_gentle(quick), _longest(strong)]
    return rows


def _first(cases: list[Case], module: ModuleType, name: str, values: tuple[float, ...]) -> Row:
    """Return the row of a constant by which the first steps are chosen."""
    shipped = getattr(module, name)
    own = work(cases, module, name, shipped)
    costs = {shipped: 1.0}
    for value in values:
        other = work(cases, module, name, value)
        costs[value] = math.exp(
            np.mean([math.log(other[key] / own[key]) for key in own.keys() & other.keys()])
        )
    listed = ", ".join(f"{value:g}: {costs[value]:.2f}" for value in sorted(costs))
    return Row(
        name,
        shipped,
        *near_best(costs),
        f"force evaluations of all attempts by it: {listed}; {len(own)} runs",
    )


def _gentle(quick: bool) -> Row:
    """Return the row of SAFE_STRAIN: the strain up to which steps of one length keep their order."""
    cases, found = (
        drawn(
            20 if quick else 100, 13, lambda s: 0.03 < s.largest_strain < 10, strength=(-2.5, 1.0)
        ),
        [],
    )
    engine = Native("rkn6", adaptive=False)
    for scene in cases:
        if (candidate := proposal(engine, scene, 1e-5)) is None:
            continue
        if run := answer(engine, scene, with_reach(scene, candidate, 0.5)):
            found.append((scene.largest_strain, run.error.smooth))
    opened = sorted(strain for strain, smooth in found if not smooth)
    low, high = quantile(opened, 0.0), quantile(opened, 0.1)
    parts = [
        np.mean([not smooth for strain, smooth in found if a < strain <= b])
        for a, b in ((0, 0.3), (0.3, 1), (1, 10))
    ]
    listed = ", ".join(f"{100 * part:.0f} %" for part in parts)
    return Row(
        "SAFE_STRAIN",
        SAFE_STRAIN,
        low,
        0.0,
        high,
        f"smallest bound on the strain at which a contact came close to opening; below 0.3, 1, 10: {listed}",
    )


def _longest(cases: list[Case]) -> Row:
    """Return the row of LONGEST_STEP: the part of the stability limit with which runs and their companions hold."""
    parts = {}
    for part in (0.3, 0.45, 0.5, 0.6, 0.65):
        held = []
        for case in cases:
            engine = Native("rkn6")
            candidate = proposal(engine, case.scene, 0.3)
            if candidate is None or case.scene.highest_frequency * case.scene.duration < 10:
                continue
            run = answer(
                engine,
                case.scene,
                with_reach(case.scene, candidate, part * METHODS["rkn6"].stability_limit),
            )
            if run is None:
                held.append(False)
                continue
            held.append(
                len(run.differences) > 1
                or (part * 4 > 1 and run.error.truncation >= case.error(run.motion))
            )
        parts[part] = float(np.mean(held)) if held else math.nan
    good = [part for part, held in parts.items() if held >= NINE_IN_TEN]
    listed = ", ".join(f"{part:g}: {100 * held:.0f}" for part, held in parts.items())
    return Row(
        "LONGEST_STEP",
        LONGEST_STEP,
        max(good, default=0.0),
        0.0,
        max(good, default=0.0),
        f"% of runs that hold, estimate a bound, by part of the stability limit: {listed}",
    )


if __name__ == "__main__":
    command(main, __doc__)
