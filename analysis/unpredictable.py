"""CPU time of an unpredictable scene, relative to its predictable part alone.

    python analysis/unpredictable.py [--repeats 3]

Processor time of `simulate` with the native engine at 1e-6, the least of some repeats, in turn in
one process: up to the verdict that no step helps; of all, with the answer as long as it is
predictable and its estimate; and of a scene that is recorded no longer than that. Writes
tables/unpredictable.md, which docs/speed.md shows.
"""

import argparse
import time
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

from figures import TABLES, write_table
from lost_attempts import TOLERANCE, Watched, agitated, springs

from lmpchain import Chain, Impulse, Scene, ToleranceNotMet, simulate

COLUMNS = (
    "scene",
    "recorded, ms",
    "predictable for, ms",
    "up to the verdict, s",
    "all, s",
    "recorded so long alone, s",
    "all over alone",
)


class Ending(NamedTuple):
    """The predictable part of a scene's solution, and the times of the table, s."""

    answer: Any  # A trajectory.
    verdict_s: float
    all_s: float


def end(scene: Scene) -> Ending:
    """Run an unpredictable scene to its predictability horizon."""
    engine = Watched()
    began = time.process_time()
    try:
        simulate(scene, engine, TOLERANCE)
    except ToleranceNotMet as missed:
        all_s = time.process_time() - began
        answer = missed.trajectory
    # The second run covers only the predictable part.
    return Ending(answer, engine.begun[1] - began, all_s)


def time_alone(scene: Scene) -> float:
    """Return the time of a predictable scene, s."""
    began = time.process_time()
    simulate(scene, "native", TOLERANCE)
    return time.process_time() - began


def measure(count: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table, each with this number of repeats."""
    column = Chain(grains=300, diameter=1e-3)
    scenes = {
        "near springs": springs(),
        "300 grains, struck at 0.1 m/s": Scene(
            chain=column, excitation=Impulse(velocity=0.1), duration=0.02, samples=1001
        ),
        "300 grains that all move": agitated(300).replace(duration=4e-3),
        "1000 grains that all move": agitated(1000).replace(duration=4e-3),
    }
    end(springs())  # This call compiles.
    for name, scene in scenes.items():
        endings = []
        alone_s = []
        for _ in range(count):
            endings.append(end(scene))
            alone_s.append(time_alone(endings[0].answer.scene))
        predictable = endings[0].answer.scene.duration
        verdict_s = min(ending.verdict_s for ending in endings)
        all_s = min(ending.all_s for ending in endings)
        times = (f"{each:.2g}" for each in (verdict_s, all_s, min(alone_s)))
        lengths = (f"{1e3 * each:.3g}" for each in (scene.duration, predictable))
        yield name, *lengths, *times, f"{all_s / min(alone_s):.2f}"


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    write_table(TABLES / "unpredictable.md", COLUMNS, measure(given.repeats))


if __name__ == "__main__":
    main()
