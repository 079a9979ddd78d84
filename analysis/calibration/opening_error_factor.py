"""Measure the parameters of the first step: FIRST_STEP, and OPENING_STEPS.coarse.

Random scenes are answered at several tolerances with other values of each field. The work is that
of all attempts together, in evaluations of the force, in the geometric mean over the scenes. A
value is supported where that is within 10 % of the least. FIRST_STEP.coarse_error and
OPENING_STEPS.coarse are varied in scenes with 101 samples, which hold steps short.
FIRST_STEP.safe_strain is supported up to the bound on the strain of the first scene in ten of those
in which a contact comes near to opening.

    python analysis/calibration/opening_error_factor.py           # a minute
    python analysis/calibration/opening_error_factor.py --quick   # seconds
"""

from __future__ import annotations

import itertools
import math

from common import (
    Job,
    Row,
    answer,
    command,
    label,
    proposal,
    quantile,
    row_of_work,
    with_reach,
)
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.auxiliary_runs import OPENINGS
from lmpchain.engines.stepping.step_choice import FIRST_STEP
from lmpchain.integrators.steps import OPENING_STEPS

TOLERANCES = (1e-3, 1e-6, 1e-9)


def jobs(scenes: list[Scene], *engines: Native, tolerances: tuple = TOLERANCES) -> list[Job]:
    """Return all scenes with all engines and all tolerances."""
    return [Job(*each) for each in itertools.product(engines, scenes, tolerances)]


def main(quick: bool = False) -> list[Row]:
    """Return a row for each field."""
    count = 20 if quick else 100
    strong = drawn(count, 11, lambda s: 0.3 < s.largest_strain < math.inf)
    calm = drawn(count, 12, lambda s: s.largest_strain < 0.3, strength=(-4.0, -0.3))
    unbounded = drawn(count, 13, lambda s: s.largest_strain == math.inf)
    dense = drawn(count, 14, lambda s: s.largest_strain > 0.3, samples=101)
    opening = jobs(strong, Native())
    equal = jobs(strong, Native("verlet", adaptive=False), Native("rkn4", adaptive=False),
                 tolerances=(1e-2, 1e-4))  # fmt: skip
    loose = jobs([*calm, *unbounded], Native(), tolerances=(1e-1, 1e-2, 1e-3))
    tight = jobs(unbounded, Native("rkn6"), tolerances=(1e-7, 1e-9, 1e-11))
    gentle = jobs(strong, Native(), tolerances=(1e-1, 1e-2, 1e-3))
    sampled = jobs(dense, Native())
    bounded = "strains that are bounded"
    return [
        row_of_work(FIRST_STEP, "longest", (0.2, 0.3, 0.4, 0.6), loose, "smooth, 1e-1 to 1e-3"),
        row_of_work(FIRST_STEP, "longest_opening", (0.2, 0.3, 0.6, 0.8), gentle, "1e-1 to 1e-3"),
        row_of_work(FIRST_STEP, "foreseen", (1e-9, 1e-8, 1e-7, 1e-5), tight, "no bound on strains"),
        _safe_strain(quick),
        row_of_work(FIRST_STEP, "opening_error", (0.5, 2.0, 8.0, 16.0), opening, bounded),
        row_of_work(
            FIRST_STEP, "largest_opening_error", (4.0, 10.0, 50.0, 200.0), opening, bounded
        ),
        row_of_work(FIRST_STEP, "equal_error", (3.0, 10.0, 100.0, 300.0), equal, "equal steps"),
        row_of_work(FIRST_STEP, "coarse_error", (1.0, 4.0, 64.0, 256.0), sampled, "101 samples"),
        row_of_work(OPENING_STEPS, "coarse", (0.2, 0.3, 0.6, 0.8), sampled, "101 samples"),
    ]


def _safe_strain(quick: bool) -> Row:
    """Return the row of the strain up to which no contact nearly opens."""
    engine = Native("rkn6", adaptive=False)
    count = 30 if quick else 150
    strains = []
    for scene in drawn(count, 15, lambda s: 0.03 < s.largest_strain < 10, strength=(-2.5, 1.0)):
        candidate = proposal(engine, scene, 1e-5)
        run = answer(engine, scene, with_reach(scene, candidate, 0.5)) if candidate else None
        if run and run.lowest <= OPENINGS.near:
            strains.append(scene.largest_strain)
    low = min(strains, default=math.nan)
    tenth = quantile(strains, 0.1)
    says = (
        f"bounds on the strain of {len(strains)} scenes that come near: least, one in ten "
        f"{tenth:.2g}"
    )
    return Row(label(FIRST_STEP, "safe_strain"), FIRST_STEP.safe_strain, low, 0.0, tenth, says)


if __name__ == "__main__":
    command(main, __doc__)
