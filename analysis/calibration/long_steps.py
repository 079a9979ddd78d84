"""Measure the error and cost of samples that are interpolated between steps.

The results are INTERPOLATION and ROUNDING.interpolated.

In random scenes some samples lie between steps: how much further off they are than those on which
steps end is the error of the polynomial where steps are long, and rounding where they are short.
INTERPOLATION.error is supported within the middle nine tenths, INTERPOLATION.order within the
quartiles of the slope between two steps. ROUNDING.interpolated, a bound, is supported from where
nine in ten runs stay below it to ten times that. In columns an interpolated sample is timed against
an evaluation of the force, supported within a factor of three, and whole answers against the least
number of steps between two landings, supported within 10 % of the least time.

    python analysis/calibration/long_steps.py           # a minute
    python analysis/calibration/long_steps.py --quick   # seconds
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from common import Case, Row, answer, best, changed, command, label, near_best, proposal, quantile
from scenes import drawn

from lmpchain import Chain, Profile, Scene
from lmpchain.engines.base import Proposal
from lmpchain.engines.native import Native
from lmpchain.engines.stepping.rounding import ROUNDING, interpolation_loss
from lmpchain.engines.stepping.step_choice import INTERPOLATION
from lmpchain.integrators.steps import Steps

STEPS = 8  # Number of steps between landings on samples.
REPEATS = 7  # Number of repetitions, of which the shortest time counts.


def errors(case: Case, passed: int) -> tuple[float, float, float] | None:
    """Return omega h, the error of samples between steps, and its ratio to the rounding law.

    None where it is no larger than that of the samples on which steps end.
    """
    scene = case.scene
    proposed = proposal(Native("rkn6"), scene, 1e-6)
    step = passed * scene.time[1]
    reach = step * scene.highest_frequency
    stride = STEPS * passed
    if proposed is None or reach > 1.5:
        return None
    candidate = proposed.with_steps(Steps(STEPS, stride, step, dense=1))
    run = answer(Native("rkn6"), scene, candidate)
    if run is None:
        return None
    farthest, fastest = np.abs(case.motion).max((1, 2))
    landed = np.abs(run.motion - case.motion)[:, ::stride].max((1, 2)) / (farthest, fastest)
    error = case.error(run.motion)
    if error < 3 * landed.max() + 10 * case.reference.error:
        return None
    law = interpolation_loss(run.steps, fastest * scene.duration / farthest)
    return reach, error, error / law


def samples(cases: list[Case]) -> Iterator[Row]:
    """Yield the rows of the errors of samples between steps."""
    steep = []
    slopes = []
    digits = []
    for case in cases:
        found = [each for passed in (3, 8, 25, 50, 75) if (each := errors(case, passed))]
        digits += [ROUNDING.interpolated * law for reach, _, law in found if reach < 0.03]
        long = [(reach, error) for reach, error, _ in found if reach > 0.3]
        steep += [error / reach**INTERPOLATION.order for reach, error in long]
        if len(long) > 1:
            slopes.append(float(np.polyfit(*np.log(long).T, 1)[0]))
    low, middle, high = (quantile(steep, part) for part in (0.05, 0.5, 0.95))
    name = label(INTERPOLATION, "error")
    yield Row(name, INTERPOLATION.error, middle, low, high, f"of {len(steep)} runs: 5 to 95 %")
    low, middle, high = (quantile(slopes, part) for part in (0.25, 0.5, 0.75))
    name = label(INTERPOLATION, "order")
    yield Row(name, INTERPOLATION.order, middle, low, high, f"slopes of {len(slopes)} scenes")
    nine = quantile(digits, 0.9)
    name = label(ROUNDING, "interpolated")
    says = f"last digits of {len(digits)} runs, nine in ten"
    yield Row(name, ROUNDING.interpolated, nine, nine, 10 * nine, says)


def column(grains: int, samples: int) -> Scene:
    """Return a column in which all grains move slightly, recorded for some hundred radians."""
    chain = Chain(grains=grains, diameter=1e-3)
    velocity = 1e-6 * np.random.default_rng(34).normal(size=grains)
    velocity[chain.movable :] = 0.0
    duration = 300 / chain.band_edge
    return Scene(
        chain=chain, excitation=Profile(velocity=velocity), duration=duration, samples=samples
    )


def least_times(works: Sequence[Callable[[], object]]) -> list[float]:
    """Return the shortest time of each candidate, s; candidates run alternately."""
    rounds = [[best(work, 1) for work in works] for _ in range(REPEATS)]
    return np.min(rounds, axis=0).tolist()


def go_through(engine: Native, scene: Scene, candidate: Proposal) -> None:
    """Run a candidate without storing it."""
    run = engine.start([scene], candidate)
    for _ in run.blocks():
        pass
    run.close()


def evaluations(sizes: Sequence[int]) -> Row:
    """Return the row of the cost of a sample between steps."""
    engine = Native("rkn6")
    over = []
    for grains in sizes:
        few, many = (column(grains, samples) for samples in (401, 4001))
        candidate = engine.propose(few, 1e-6)
        works = []
        for scene, steps in ((few, 400), (few, 800), (many, 400)):
            stride = (scene.samples - 1) // 10
            every = candidate.with_steps(Steps.spread(scene.time[1], steps // 10, stride))
            works.append(partial(go_through, engine, scene, every))
        usual, shorter, denser = least_times(works)
        force = (shorter - usual) / (400 * engine.methods(scene)[0].evaluations)
        over.append((denser - usual) / 3600 / force)
    middle = quantile(over, 0.5)
    listed = ", ".join(f"{grains}: {value:.2g}" for grains, value in zip(sizes, over, strict=True))
    says = f"time of a sample over that of a force evaluation, by grains: {listed}"
    name = label(INTERPOLATION, "evaluations")
    return Row(name, INTERPOLATION.evaluations, middle, middle / 3, 3 * middle, says)


def landings(sizes: Sequence[int]) -> Row:
    """Return the row of the least number of steps between landings."""
    engine = Native("rkn6")
    values = (2, 4, 8, 16, 32)
    times = []
    for grains, samples in itertools.product(sizes, (1001, 4001)):
        scene = column(grains, samples)
        works = []
        for value in values:
            with changed(INTERPOLATION, steps=value):
                works.append(partial(go_through, engine, scene, engine.propose(scene, 1e-6)))
        times.append(least_times(works))
    over = np.exp(np.log(times).mean(0))
    costs = dict(
        zip(values, (over / over[values.index(INTERPOLATION.steps)]).tolist(), strict=True)
    )
    listed = ", ".join(f"{value}: {cost:.2f}" for value, cost in costs.items())
    name = label(INTERPOLATION, "steps")
    says = f"time of {len(times)} answers by it: {listed}"
    return Row(name, INTERPOLATION.steps, *near_best(costs), says)


def main(quick: bool = False) -> list[Row]:
    """Return a row for each constant."""
    dense = drawn(
        8 if quick else 60,
        33,
        lambda s: s.chain.compressed and not s.excitation.does_work,
        strength=(-4.0, 1.0),
        samples=601,
    )
    sizes = (12, 120) if quick else (12, 120, 1000)
    known = [case for case in map(Case, dense) if case.known]
    return [*samples(known), evaluations(sizes), landings(sizes)]


if __name__ == "__main__":
    command(main, __doc__)
