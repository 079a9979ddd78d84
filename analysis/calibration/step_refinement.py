"""Measure the literals of `refine`, by which a step is shortened after a run that missed.

Random scenes are run from a step that is a few times too long until they meet their tolerance, with each literal
changed and the others as they are. The cost is the number of steps of all tries; its geometric mean over the scenes
decides. A value is supported where that mean is within 10 % of the best. For literals that say when to give up, or
what a run that breaks down costs, the same holds. The rule is written here once more and held against `refine`
itself.

    python analysis/calibration/step_refinement.py           # half a minute
    python analysis/calibration/step_refinement.py --quick   # seconds
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from common import Row, answer, command, near_best, proposal
from scenes import drawn

from lmpchain import Scene
from lmpchain.engines.base import Candidate, ErrorBudget
from lmpchain.engines.companions import KINKED_BELOW
from lmpchain.engines.native import Native
from lmpchain.engines.time_stepping import REFINEMENT
from lmpchain.integrators.methods import METHODS

MOST_TRIES = 12
FINEST = 100_000  # steps between two samples that are not tried


@dataclass(frozen=True)
class Rule:
    """The literals of `refine`."""

    aim: float  # of the room left by round-off
    most: float  # factor at once, and where the error is far off
    most_far: float
    far: float  # error from which it is
    least: float  # factor, and where the error is erratic
    least_erratic: float
    broken: float  # factor after a run that broke down
    hopeless: float  # round-off over the tolerance, from which nothing helps
    room: float  # least part of the tolerance that is aimed at
    at_kinks: float  # order where steps adapt to openings at which the force has kinks

    def factor(
        self, order: int, error: ErrorBudget | None, tolerance: float, adaptive: bool
    ) -> float | None:
        """Return by how much the step is shortened; None to give up."""
        if error and error.roundoff > self.hopeless * tolerance:
            return None
        if error is None or not math.isfinite(error.truncation):
            return self.broken
        power = (
            order
            if error.smooth
            else min(order, self.at_kinks if adaptive else REFINEMENT.order_at_openings)
        )
        room = max(tolerance - error.roundoff, tolerance * self.room)
        most = self.most if error.truncation < self.far else self.most_far
        least = self.least if error.smooth else self.least_erratic
        return min(max((error.truncation / (self.aim * room)) ** (1 / power), least), most)


def shipped() -> Rule:
    """Return the literals of the code, found from outside: what `refine` makes of errors that bring out each."""
    engine = Native("rkn6")
    base = Candidate(
        step=1.0,
        active_grains=1,
        model_error=0.0,
        solver_error=0.0,
        cost_s=0.0,
        steps_per_landing=10**6,
        integrator="rkn6",
    )

    def factor(
        truncation: float, roundoff: float = 0.0, smooth: bool = True, adaptive: bool = False
    ) -> float:
        own = base._replace(adaptive=adaptive)
        refined = engine.refine(own, ErrorBudget(truncation, roundoff, smooth, np.zeros(1)), 1e-9)
        return refined.steps_per_landing / base.steps_per_landing if refined else 0.0

    def threshold(low: float, high: float, above: object) -> float:
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (low, middle) if above(middle) else (middle, high)  # type: ignore[operator]
        return high

    aimed = 1e-9 * 1.5**6
    aim = aimed / factor(aimed) ** 6 / 1e-9
    kinked = aim * 1e-9 * 3.0**4
    broken = engine.refine(base, None, 1e-9)
    assert broken
    return Rule(
        aim=aim,
        most=factor(0.0999999),
        most_far=factor(1e3),
        far=threshold(0.0, 1.0, lambda error: factor(error) < 0.5 * factor(0.0999999)),
        least=factor(0.0),
        least_erratic=factor(0.0, smooth=False),
        broken=broken.steps_per_landing / base.steps_per_landing,
        hopeless=threshold(0.5, 1.5, lambda part: factor(aimed, part * 1e-9) == 0.0),
        room=aimed / aim / factor(aimed, 0.89e-9) ** 6 / 1e-9,
        at_kinks=math.log(81.0) / math.log(factor(kinked, smooth=False, adaptive=True)),
    )


class Walk:
    """A scene, and what its runs with so many steps between two samples come to: each is made once."""

    def __init__(self, engine: Native, scene: Scene, tolerance: float, begin: float):
        self.engine, self.scene, self.tolerance = engine, scene, tolerance
        proposed = proposal(engine, scene, tolerance)
        self.first = (
            proposed.with_steps(max(1, round(proposed.steps_per_landing / begin)))
            if proposed
            else None
        )
        self.seen: dict[int, ErrorBudget | None] = {}
        self.order = METHODS[engine.methods[0].name].order

    def error(self, steps: int) -> ErrorBudget | None:
        """Return the error of a run."""
        if steps not in self.seen:
            assert self.first
            run = answer(self.engine, self.scene, self.first.with_steps(steps))
            self.seen[steps] = run.error if run else None
        return self.seen[steps]

    def cost(self, rule: Rule) -> float:
        """Return the steps of all tries over those of the first; infinite if the tolerance is not met."""
        assert self.first
        steps, spent = self.first.steps_per_landing, 0
        for _ in range(MOST_TRIES):
            spent += steps
            error = self.error(steps)
            if error and error.total <= self.tolerance:
                return spent / self.first.steps_per_landing
            factor = rule.factor(self.order, error, self.tolerance, self.first.adaptive)
            if factor is None or steps * factor > FINEST:
                return math.inf
            steps = math.ceil(steps * factor)
        return math.inf


def walks(
    scenes: list[Scene], name: str, adaptive: bool, tolerances: tuple[float, ...], begin: float
) -> list[Walk]:
    """Return walks that the shipped rule brings to an end after a first try that misses."""
    engine, rule, found = Native(name, adaptive=adaptive), shipped(), []
    for place, scene in enumerate(scenes):
        walk = Walk(engine, scene, tolerances[place % len(tolerances)], begin)
        if (
            walk.first
            and walk.first.steps_per_landing * begin < FINEST
            and 1 < walk.cost(rule) < math.inf
        ):
            found.append(walk)
    return found


def best_of(name: str, field: str, values: tuple[float, ...], found: list[Walk], what: str) -> Row:
    """Return the row of a literal: what the tries cost with other values of it."""
    rule = shipped()
    own = getattr(rule, field)
    own = float(f"{own:.3g}")
    values = tuple(sorted({*values, own}))
    each = {
        value: [walk.cost(replace(rule, **{field: value})) for walk in found] for value in values
    }
    ended = np.all([np.isfinite(costs) for costs in each.values()], axis=0)
    costs = {
        value: float(np.exp(np.mean(np.log(np.array(costs)[ended]))))
        for value, costs in each.items()
    }
    best, low, high = near_best(costs)
    answered = {value: sum(map(math.isfinite, each[value])) for value in values}
    listed = ", ".join(
        f"{value:g}: {cost:.2f} ({answered[value]})" for value, cost in costs.items()
    )
    return Row(
        name,
        own,
        best,
        low,
        high,
        f"{what}; cost over that of the first try (and walks that end): {listed}",
    )


def main(quick: bool = False) -> list[Row]:
    """Return a row for each literal."""
    count, tolerances = (8 if quick else 60), (1e-4, 1e-7, 1e-10)
    calm = drawn(
        count, 21, lambda s: s.largest_strain < 0.3, strength=(-4.0, -0.3), spans=(5.0, 30.0)
    )
    hard = drawn(count, 22, lambda s: s.largest_strain > 1, strength=(0.0, 3.0))
    smooth = [
        *walks(calm, "rkn6", True, tolerances, 3.0),
        *walks(calm, "rkn4", True, tolerances, 3.0),
        *walks(hard, "rkn6", True, tolerances, 3.0),
    ]
    springy = [scene for scene in hard if scene.chain.exponent < KINKED_BELOW]
    kinked = walks(springy, "rkn6", True, tolerances, 10.0)
    erratic = walks(hard, "rkn6", False, (1e-3, 1e-4), 3.0) + walks(
        hard, "kahan-li6", False, (1e-3, 1e-4), 3.0
    )
    near = walks(calm, "verlet", True, (1e-2, 1e-3), 1.3) + walks(
        calm, "rkn6", True, (1e-6, 1e-9), 1.15
    )
    wide = walks(calm, "rkn6", True, (1e-8, 1e-10), 40.0) + walks(
        calm, "rkn4", True, (1e-8, 1e-10), 40.0
    )
    lost = walks(hard, "rkn4", True, (1e-5, 1e-8), 60.0) + walks(
        hard, "rkn6", True, (1e-8, 1e-10), 60.0
    )
    floor = walks(calm, "rkn6", True, (5e-15, 1e-14, 2e-14), 2.0) + walks(
        calm, "rkn4", True, (1e-13,), 2.0
    )
    return [
        best_of(
            "refine: 0.7 (aim)",
            "aim",
            (0.2, 0.35, 0.5, 0.7, 0.85, 0.95),
            smooth,
            "part of the room aimed at",
        ),
        best_of(
            "refine: 4 (kinks)",
            "at_kinks",
            (2.5, 3.0, 4.0, 5.0, 6.0),
            kinked,
            "order there, where the force has kinks",
        ),
        best_of(
            "refine: 16 (most)",
            "most",
            (4.0, 8.0, 16.0, 32.0, 64.0),
            wide,
            "largest factor at once",
        ),
        best_of(
            "refine: 4 (most, far off)",
            "most_far",
            (2.0, 4.0, 8.0, 16.0),
            lost,
            "largest factor where the error is large",
        ),
        best_of(
            "refine: 0.1 (far off)",
            "far",
            (0.01, 0.03, 0.1, 0.3, 1.0),
            lost,
            "error that counts as large",
        ),
        best_of(
            "refine: 1.3 (least)", "least", (1.01, 1.1, 1.2, 1.3, 1.5, 2.0), near, "smallest factor"
        ),
        best_of(
            "refine: 2 (least, erratic)",
            "least_erratic",
            (1.1, 1.5, 2.0, 3.0, 4.0),
            erratic,
            "smallest factor where errors are erratic",
        ),
        best_of(
            "refine: 4 (broken down)",
            "broken",
            (2.0, 4.0, 8.0, 16.0),
            _breaking(hard),
            "factor after a breakdown",
        ),
        best_of(
            "refine: 0.9 (hopeless)",
            "hopeless",
            (0.5, 0.7, 0.8, 0.9, 0.95, 1.0),
            floor,
            "round-off from which nothing helps",
        ),
        best_of(
            "refine: / 4 (room)",
            "room",
            (0.05, 0.125, 0.25, 0.5),
            floor,
            "least part of the tolerance aimed at",
        ),
    ]


def _breaking(scenes: list[Scene]) -> list[Walk]:
    """Return walks whose first tries break down: steps far beyond what is stable."""
    found = walks(scenes, "verlet", True, (1e-2, 1e-3), 100.0) + walks(
        scenes, "rkn6", False, (1e-1, 1e-2), 30.0
    )
    return [walk for walk in found if walk.seen and next(iter(walk.seen.values())) is None]


if __name__ == "__main__":
    command(main, __doc__)
