"""Measure the shortening of a step after a missed tolerance: STEP_CONTROL.

Random scenes are answered from a first step that is a few or many times too long, with other values
of each field. The work is that of all attempts together, in evaluations of the force, in the
geometric mean over the scenes. A value is supported where that is within 10 % of the least.

    python analysis/calibration/step_refinement.py           # a minute
    python analysis/calibration/step_refinement.py --quick   # seconds
"""

from __future__ import annotations

import itertools

from common import Job, Row, command, row_of_work
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.step_choice import STEP_CONTROL


def jobs(
    scenes: list[Scene], names: tuple[str, ...], tolerances: tuple[float, ...], longer: float
) -> list[Job]:
    """Return all scenes with all methods, each at one of the tolerances."""
    return [
        Job(Native(name), scene, tolerance, longer)
        for name in names
        for scene, tolerance in zip(scenes, itertools.cycle(tolerances), strict=False)
    ]


def main(quick: bool = False) -> list[Row]:
    """Return a row for each field."""
    count = 6 if quick else 50
    weak = {"strength": (-4.0, -0.3), "spans": (5.0, 30.0)}
    calm = drawn(count, 21, lambda s: s.largest_strain < 0.3, **weak)
    hard = drawn(count, 22, lambda s: s.largest_strain > 1, strength=(0.0, 3.0))
    high = ("rkn4", "rkn6")
    tight = (1e-4, 1e-7, 1e-10)
    off = jobs([*calm, *hard], high, tight, 3.0)
    near = jobs(calm, ("verlet",), (1e-2, 1e-3), 1.2) + jobs([*calm, *hard], high, tight, 1.1)
    far = jobs([*calm, *hard], high, (1e-6, 1e-8, 1e-10), 40.0)
    return [
        row_of_work(
            STEP_CONTROL, "target", (0.2, 0.35, 0.5, 0.85, 0.95), off, "first 3 times as long"
        ),
        row_of_work(STEP_CONTROL, "least", (1.01, 1.1, 1.5, 2.0, 3.0), near, "1.1 or 1.2 times"),
        row_of_work(STEP_CONTROL, "most", (2.0, 4.0, 16.0, 32.0), far, "40 times"),
    ]


if __name__ == "__main__":
    command(main, __doc__)
