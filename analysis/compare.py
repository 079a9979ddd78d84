"""Picture of the README: the paper's scene at g in every engine, by `lmpchain compare`."""

from figures import HERE, arguments, finish, say, shorter

import lmpchain
from lmpchain.benchmark.comparison import compare
from lmpchain.benchmark.reference import reference

RUNS = 5  # The first run loads code, and others may wait for the processor.


def main() -> None:
    """Run the scene several times in every engine, and draw the fastest run of each."""
    given = arguments(__file__, __doc__)
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / "fig5_1g.toml")
    if given.quick:
        scene = shorter(scene, 60)
    found = [
        min(
            (lmpchain.simulate(scene, name, on_miss="warn") for _ in range(RUNS)),
            key=lambda run: run.cost.integration_s,
        )
        for name in lmpchain.engines.names()
    ]
    comparison = compare(found, reference(scene))
    for row in comparison.rows:
        say(f"error of {row.engine}", row.error)
    finish(comparison.plot().figure.figure, given.output)


if __name__ == "__main__":
    main()
