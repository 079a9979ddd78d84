"""Cost of attempts that miss their tolerance.

    python analysis/lost_attempts.py [--repeats 3] [--grains 5000]

Processor time of `simulate` with the native engine at 1e-6, the least of some repeats, beside the
same where every attempt runs to its end, in turn in one process; and beside the last attempt alone.
Writes tables/lost_attempts.md, which docs/speed.md shows.
"""

import argparse
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from figures import TABLES, write_table

from lmpchain import Chain, Impulse, Profile, Scene, simulate
from lmpchain.engines import Native
from lmpchain.engines.stepping import monitor
from lmpchain.engines.stepping.monitor import JudgingTimes

COLUMNS = (
    "scene",
    "first attempt lost at, of the way",
    "with looks, s",
    "every attempt to its end, s",
    "the last attempt alone, s",
    "with looks / last",
)
TOLERANCE = 1e-6


def agitated(grains: int) -> Scene:
    """Return a column of flying grains that all move at random."""
    velocity = 1e-3 * np.random.default_rng(1).normal(size=grains)
    velocity[-1] = 0.0
    start = Profile(displacement=[0.0] * grains, velocity=velocity.tolist())
    chain = Chain(grains=grains, diameter=1e-3)
    return Scene(chain=chain, excitation=start, duration=1e-3, samples=201)


def springs() -> Scene:
    """Return a chain of nearly linear springs whose contacts open."""
    chain = Chain(grains=12, diameter=1e-3, exponent=1.05)
    return Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=0.01, samples=501)


@contextmanager
def unseen() -> Iterator[None]:
    """Make every attempt run to its end."""
    looks = monitor.JUDGING
    monitor.JUDGING = JudgingTimes(begin_s=np.inf)  # type: ignore[misc]
    try:
        yield
    finally:
        monitor.JUDGING = looks  # type: ignore[misc]


class Watched(Native):
    """The native engine, with its started runs and their times, s."""

    def __init__(self) -> None:
        super().__init__()
        self.runs: list[Any] = []
        self.begun: list[float] = []

    def start(self, *arguments: Any) -> Any:
        """Start a run."""
        self.begun.append(time.process_time())
        self.runs.append(super().start(*arguments))
        return self.runs[-1]


class Spent(NamedTuple):
    """CPU time of a solution, s, its last step, s, and the end of its first attempt."""

    answer_s: float
    step_s: float
    first: float


def spend(scene: Scene) -> Spent:
    """Solve a scene and measure the cost."""
    engine = Watched()
    began = time.process_time()
    answer = simulate(scene, engine, TOLERANCE)
    answer_s = time.process_time() - began
    return Spent(answer_s, answer.cost.step_s, engine.runs[0].progress)


def spend_last(scene: Scene, step_s: float) -> float:
    """Return the CPU time of a first attempt with the final steps, s."""
    engine = Native()
    candidate = engine.propose(scene, TOLERANCE)
    steps = round(candidate.steps.per_landing * candidate.step / step_s)
    run = engine.start([scene], candidate.with_steps(candidate.steps.shorten(steps)))
    began = time.process_time()
    for _ in run.blocks():
        pass
    run.errors()
    run.close()
    return time.process_time() - began


def measure(scene: Scene, count: int) -> tuple[str, ...]:
    """Return a row of the table for this number of repeats."""
    looked = []
    to_the_end = []
    last = []
    for _ in range(count):
        looked.append(spend(scene))
        with unseen():
            to_the_end.append(spend(scene).answer_s)
        last.append(spend_last(scene, looked[0].step_s))
    answer_s = min(spent.answer_s for spent in looked)
    times = (f"{each:.3g}" for each in (answer_s, min(to_the_end), min(last)))
    return f"{looked[0].first:.0%}", *times, f"{answer_s / min(last):.2f}"


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--grains", type=int, default=5000)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    spend(agitated(100))  # This call compiles.
    row = measure(agitated(given.grains), given.repeats)
    name = f"{given.grains} grains that all move"
    write_table(TABLES / "lost_attempts.md", COLUMNS, [(name, *row)])


if __name__ == "__main__":
    main()
