"""Picture of the README: the paper's scene at g in every engine, by `lmpchain compare`."""

from figures import HERE, arguments, finish, say, shorter

import lmpchain
from lmpchain.benchmark.comparison import compare
from lmpchain.benchmark.reference import reference


def main() -> None:
    """Run the scene in every engine, twice to exclude loading times, and draw the comparison."""
    given = arguments(__file__, __doc__)
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / "fig5_1g.toml")
    if given.quick:
        scene = shorter(scene, 60)
    found = [
        lmpchain.simulate(scene, name, on_miss="warn")
        for name in lmpchain.engines.names()
        for _ in range(2)
    ][1::2]
    comparison = compare(found, reference(scene))
    for row in comparison.rows:
        say(f"error of {row.engine}", row.error)
    finish(comparison.plot().figure.figure, given.output)


if __name__ == "__main__":
    main()
