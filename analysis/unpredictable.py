"""Where runs end that cannot be predicted to their end, and what they take until then.

    python analysis/unpredictable.py [--repeats 2]

Processor time of `simulate` with the native engine at 1e-6, the least of some repeats: up to the
verdict that no step helps, and of all, with the answer as long as it is predictable and its
estimate. The same with looks nearer to each other, in turn in one process. Writes
tables/unpredictable.md, which docs/speed.md shows.
"""

import argparse
import time
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

from figures import TABLES, write_table
from lost_attempts import TOLERANCE, agitated, springs

from lmpchain import Chain, Impulse, Scene, ToleranceNotMet, simulate
from lmpchain.engines import Native
from lmpchain.engines.native import companion_run
from lmpchain.engines.native.companion_run import Looks

NEARER = 1.03  # time of a look over that of the one before
COLUMNS = (
    "scene",
    "predictable for, ms",
    "ends at, over that",
    f"the same, looks {100 * (NEARER - 1):.0f} % apart",
    "up to the verdict, s",
    "all, s",
    f"all, looks {100 * (NEARER - 1):.0f} % apart, s",
)


class Watched(Native):
    """The native engine, with the scenes and runs that it began, and when, s."""

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[tuple[float, Any, Any]] = []

    def start(self, scenes, *arguments):
        """Start a run."""
        began = time.process_time()
        run = super().start(scenes, *arguments)
        self.begun.append((began, scenes[0], run))
        return run


class Ending(NamedTuple):
    """Until when a scene is predictable and when its run ended, s; and times as in the table, s."""

    predictable: float
    ended: float
    verdict_s: float
    all_s: float


def end(scene: Scene) -> Ending:
    """Run a scene that cannot be predicted to its end."""
    engine = Watched()
    began = time.process_time()
    try:
        simulate(scene, engine, TOLERANCE)
    except ToleranceNotMet as missed:
        predictable = float(missed.trajectory.time[-1])
    else:
        raise ValueError("this scene can be predicted to its end")
    all_s = time.process_time() - began
    whole = [n for n, (_, part, _) in enumerate(engine.begun) if part.duration == scene.duration]
    start_s, _, run = engine.begun[whole[-1]]
    # the next run is that of the beginning
    verdict_s = engine.begun[whole[-1] + 1][0] - start_s
    ended = int(run.state()["sample"]) * scene.duration / (scene.samples - 1)
    return Ending(predictable, ended, verdict_s, all_s)


def measure(count: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table, of so many repeats."""
    strike = Impulse(velocity=0.1)
    column = Chain(grains=300, diameter=1e-3)
    scenes = {
        "near springs": springs(),
        "300 grains, struck at 0.1 m/s": Scene(
            chain=column, excitation=strike, duration=0.02, samples=1001
        ),
        "300 grains that all move": agitated(300).replace(duration=4e-3),
        "1000 grains that all move": agitated(1000).replace(duration=4e-3),
    }
    usual = companion_run.LOOKS
    end(springs())  # compiles
    for name, scene in scenes.items():
        endings: dict[Looks, list[Ending]] = {usual: [], Looks(apart=NEARER): []}
        for _ in range(count):
            for looks, repeats in endings.items():
                companion_run.LOOKS = looks  # type: ignore[misc]
                repeats.append(end(scene))
        companion_run.LOOKS = usual  # type: ignore[misc]
        # when a run ends is the same in all repeats
        first, nearer = (repeats[0] for repeats in endings.values())
        verdict_s = min(ending.verdict_s for ending in endings[usual])
        times = [min(ending.all_s for ending in repeats) for repeats in endings.values()]
        late = (f"{each.ended / each.predictable:.2f}" for each in (first, nearer))
        spent = (f"{verdict_s:.2g}", *(f"{all_s:.3g}" for all_s in times))
        yield name, f"{1e3 * first.predictable:.3g}", *late, *spent


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    write_table(TABLES / "unpredictable.md", COLUMNS, measure(given.repeats))


if __name__ == "__main__":
    main()
