"""What attempts cost that miss their tolerance, and runs that cannot be predicted to their end.

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
from pathlib import Path

import numpy as np

from lmpchain import Chain, Impulse, Profile, Scene, ToleranceNotMet, simulate
from lmpchain.engines import Native
from lmpchain.engines.native import companion_run
from lmpchain.engines.native.companion_run import Looks

TABLE = Path(__file__).parent / "tables" / "lost_attempts.md"
COLUMNS = (
    "scene",
    "with looks, s",
    "every attempt to its end, s",
    "the last attempt alone, s",
    "with looks / last",
    "answered to, ms",
)
TOLERANCE = 1e-6


def agitated(grains: int) -> Scene:
    """Return a column of grains that all move at random and fly."""
    velocity = 1e-3 * np.random.default_rng(1).normal(size=grains)
    velocity[-1] = 0.0
    start = Profile(displacement=[0.0] * grains, velocity=velocity.tolist())
    chain = Chain(grains=grains, diameter=1e-3)
    return Scene(chain=chain, excitation=start, duration=1e-3, samples=201)


def springs() -> Scene:
    """Return a chain near that of springs, whose contacts open."""
    chain = Chain(grains=12, diameter=1e-3, exponent=1.05)
    return Scene(chain=chain, excitation=Impulse(velocity=0.05), duration=0.01, samples=501)


@contextmanager
def unseen() -> Iterator[None]:
    """Have every attempt run to its end."""
    looks = companion_run.LOOKS
    companion_run.LOOKS = Looks(begin_s=np.inf)  # type: ignore[misc]
    try:
        yield
    finally:
        companion_run.LOOKS = looks  # type: ignore[misc]


def spend(scene: Scene) -> tuple[float, float, float]:
    """Return the processor time of an answer, s, its last step, s, and when it ends, s."""
    began = time.process_time()
    try:
        answer = simulate(scene, "native", TOLERANCE)
    except ToleranceNotMet as missed:
        answer = missed.trajectory
    return time.process_time() - began, answer.cost.step_s, float(answer.time[-1])


def spend_last(scene: Scene, step_s: float) -> float:
    """Return the processor time of the first attempt that has the steps of the last, s."""
    engine = Native()
    candidate = engine.candidate(scene, TOLERANCE)
    steps = round(candidate.steps_per_landing * candidate.step / step_s)
    run = engine.start([scene], candidate.with_steps(steps))
    began = time.process_time()
    for _ in run.blocks():
        pass
    run.errors()
    run.close()
    return time.process_time() - began


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--grains", type=int, default=5000)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    scenes = {f"{given.grains} grains that all move": agitated(given.grains)}
    scenes["near springs"] = springs()
    for scene in (agitated(100), springs()):
        spend(scene)  # compiles
    lines = [" | ".join(("", *COLUMNS, "")).strip(), "|---" * len(COLUMNS) + "|"]
    for name, scene in scenes.items():
        looked = []
        to_the_end = []
        last = []
        for _ in range(given.repeats):
            spent_s, step_s, end_s = spend(scene)
            looked.append(spent_s)
            with unseen():
                to_the_end.append(spend(scene)[0])
            if end_s == scene.duration:
                last.append(spend_last(scene, step_s))
        least = min(looked)
        alone = f"{min(last):.3g} | {least / min(last):.2f}" if last else "- | -"
        answered = f"{1e3 * end_s:.3g} of {1e3 * scene.duration:.3g}"
        lines.append(f"| {name} | {least:.3g} | {min(to_the_end):.3g} | {alone} | {answered} |")
        print(lines[-1])
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
